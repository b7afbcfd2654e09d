"""YAML and JSON files of users, read without trust: plain values only, refused with the file and the key.

Refused are what makes a program run, hang or misread: tags of objects, keys that stand twice, aliases that unfold into
millions of values, deep nesting, integers beyond 64 bits, NaN, keys that are no text, dates that do not exist.
A date, or a time such as 10:30, stays text.
"""

from __future__ import annotations

import json
import math
import os
from collections.abc import Collection, Hashable, Mapping
from pathlib import Path
from typing import Any, NoReturn

import yaml

from torchweather.core.exceptions import TorchweatherError
from torchweather.core.file_names import check_no_device

__all__ = ["dump_yaml", "parse_json", "parse_yaml", "read_json", "read_yaml"]

MAX_BYTES = 4 * 2**20
MAX_DEPTH = 50
TOO_DEEP = f"it is nested more than {MAX_DEPTH} levels deep"
MAX_ALIASED = 100_000  # values that aliases may unfold into
MAX_INTEGER = 2**64  # a seed has 64 bits
TAG = "tag:yaml.org,2002:"
MERGE = TAG + "merge"
SCALARS = frozenset(TAG + name for name in ("null", "bool", "int", "float", "str", "timestamp"))
PLAIN: dict[type[yaml.Node], frozenset[str]] = {
    yaml.ScalarNode: SCALARS,
    yaml.SequenceNode: frozenset({TAG + "seq"}),
    yaml.MappingNode: frozenset({TAG + "map"}),
}
Path_ = tuple[str | int, ...]


class _Refused(Exception):
    """A problem, the key that has it, and its place."""

    def __init__(self, problem: str, path: Path_, at: Any) -> None:
        super().__init__(f"{problem} (line {at.start_mark.line + 1})")
        self.path = path


def read_yaml(
    path: str | os.PathLike[str],
    what: str,
    *,
    max_bytes: int = MAX_BYTES,
    number_keys: Collection[str] = (),
) -> Any:
    """Plain values of a YAML file.

    Args:
        path: the file.
        what: its content, for messages, such as ``the fields of a camera``.
        max_bytes: longest file that is read.
        number_keys: dotted keys of mappings whose keys may be whole numbers, such as ``classes``.

    Raises:
        TorchweatherError: with the file and, where one is at fault, the key and the line.

    Example:
        >>> import tempfile
        >>> file = Path(tempfile.mkdtemp()) / "a.yaml"
        >>> _ = file.write_text("fog: {mor_m: 30.0, mor_m: 50.0}")
        >>> try:
        ...     read_yaml(file, "a weather")
        ... except TorchweatherError as error:
        ...     print(str(error).removeprefix(f"{file}: "))
        fog.mor_m: expected YAML with a weather; the key 'mor_m' stands twice (line 1).
    """
    return parse_yaml(_text(path, f"YAML with {what}", max_bytes), str(path), what, number_keys=number_keys)


def _text(path: str | os.PathLike[str], wanted: str, max_bytes: float) -> str:
    file = Path(path)
    check_no_device(file)
    try:
        if (size := file.stat().st_size) > max_bytes:
            raise TorchweatherError(f"{file}: expected {wanted}, {max_bytes} bytes at most; got {size} bytes.")
        return file.read_text(encoding="utf-8")
    except (FileNotFoundError, NotADirectoryError) as error:
        raise TorchweatherError(f"{file}: no such file; expected {wanted}.") from error
    except (OSError, UnicodeDecodeError) as error:
        raise TorchweatherError(f"{file}: expected {wanted}; it cannot be read: {error}.") from error


def parse_yaml(
    text: str | bytes,
    file: str,
    what: str,
    *,
    number_keys: Collection[str] = (),
    tags: Mapping[str, str] | None = None,
    allow_nan: bool = False,
) -> Any:
    """Plain values of a YAML text.

    Args:
        text: of the file.
        file: its name, for messages.
        what, number_keys: as in ``read_yaml``.
        tags: tags that stand for a plain one, ``map`` or ``seq``, such as OpenCV's matrix for ``map``.
        allow_nan: for files of other programs, whose numbers are checked where they are used.
    """
    loader = None
    try:
        loader = _Loader(text)
        node = loader.get_single_node()
        return None if node is None else _Values(loader, number_keys, tags or {}, allow_nan).of(node, ())
    except _Refused as found:
        at = f" {dotted(found.path)}:" if found.path else ""
        raise TorchweatherError(f"{file}:{at} expected YAML with {what}; {found}.") from None
    except yaml.YAMLError as error:
        raise TorchweatherError(f"{file}: expected YAML with {what}; it cannot be read: {_reason(error)}.") from error
    finally:
        if loader is not None:
            loader.dispose()


def read_json(path: str | os.PathLike[str], what: str) -> Any:
    """Plain values of a JSON file, as ``parse_json`` gives them."""
    return parse_json(_text(path, f"JSON with {what}", math.inf), str(path), what)


def parse_json(text: str, file: str, what: str) -> Any:
    """Plain values of a JSON text; keys that stand twice, deep nesting and long integers are refused.

    Raises:
        TorchweatherError: with the file, and the key where one is at fault.

    Example:
        >>> parse_json('{"fx": 700.0}', "camera.json", "a camera")
        {'fx': 700.0}
    """

    def refuse(problem: str) -> NoReturn:
        raise TorchweatherError(f"{file}: expected JSON with {what}; {problem}.")

    def mapping(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        values: dict[str, Any] = {}
        for key, value in pairs:
            if key in values:
                refuse(f"the key {key!r} stands twice")
            values[key] = value
        return values

    def integer(digits: str) -> int:
        return int(digits) if len(digits) <= 20 else refuse(f"an integer has {len(digits)} digits, 64 bits at most")

    try:
        return json.loads(text, object_pairs_hook=mapping, parse_int=integer)
    except RecursionError:
        refuse("it is nested too deep")
    except ValueError as error:
        refuse(f"it cannot be read: {error}")


def dump_yaml(values: Mapping[str, Any]) -> str:
    """Plain values as YAML, in their order."""
    text: str = yaml.safe_dump(values, sort_keys=False, allow_unicode=True, width=120)
    return text


def dotted(path: Path_) -> str:
    """A key as messages name it: ``conditions[2].weather.mor_m``; of a deep one the beginning."""
    shown = "".join(f"[{key}]" if isinstance(key, int) else f".{key}" for key in path[:8])
    return shown.removeprefix(".") + ("..." if len(path) > 8 else "")


class _Loader(yaml.SafeLoader):
    """PyYAML's nodes, nested no deeper than a file of a user needs; the composer would run out of stack."""

    def __init__(self, text: str | bytes) -> None:
        super().__init__(text)
        self.path: list[str | int] = []

    def compose_node(self, parent: yaml.Node | None, index: Any) -> yaml.Node | None:
        key = index.value if isinstance(index, yaml.ScalarNode) else index if isinstance(index, int) else "?"
        self.path.append(key)
        if len(self.path) > MAX_DEPTH:
            raise _Refused(TOO_DEEP, tuple(self.path[1:]), self.peek_event())  # type: ignore[no-untyped-call]
        node = super().compose_node(parent, index)
        self.path.pop()
        return node


class _Values:
    """Turns nodes into plain values."""

    def __init__(self, loader: _Loader, number_keys: Collection[str], tags: Mapping[str, str], nan: bool) -> None:
        self.loader, self.number_keys, self.tags, self.nan = loader, number_keys, tags, nan
        self.seen: set[int] = set()
        self.open: set[int] = set()
        self.aliased = 0

    def of(self, node: yaml.Node, path: Path_) -> Any:
        """The value of a node."""
        tag = TAG + self.tags[node.tag] if node.tag in self.tags else node.tag
        if tag not in PLAIN[type(node)]:
            name = tag.replace(TAG, "!!")
            raise _Refused(f"the tag {name} is none of plain values; leave it out", path, node)
        if isinstance(node, yaml.ScalarNode):
            return self.scalar(node, path)
        if id(node) in self.open:
            raise _Refused("an alias holds itself", path, node)
        if len(path) > MAX_DEPTH:  # by aliases of aliases
            raise _Refused(TOO_DEEP, path, node)
        if id(node) in self.seen:
            self.aliased += 1 + len(node.value)
            if self.aliased > MAX_ALIASED:
                raise _Refused(f"its aliases unfold into more than {MAX_ALIASED} values", path, node)
        self.seen.add(id(node))
        self.open.add(id(node))
        if isinstance(node, yaml.MappingNode):
            values: Any = self.mapping(node, path)
        else:
            values = [self.of(one, (*path, place)) for place, one in enumerate(node.value)]
        self.open.discard(id(node))
        return values

    def mapping(self, node: yaml.MappingNode, path: Path_) -> dict[Any, Any]:
        """Keys and values; those merged by ``<<`` come first and give way to the mapping's own."""
        merged: dict[Any, Any] = {}
        own: dict[Any, Any] = {}
        for key_node, value_node in node.value:
            if key_node.tag == MERGE:
                parts = self.of(value_node, (*path, "<<"))
                for part in reversed(parts if isinstance(parts, list) else [parts]):
                    if not isinstance(part, dict):
                        raise _Refused("<< merges mappings only", (*path, "<<"), value_node)
                    merged.update(part)
                continue
            key = self.key(key_node, path)
            if key in own:
                raise _Refused(f"the key {key!r} stands twice", (*path, str(key)), key_node)
            own[key] = self.of(value_node, (*path, str(key)))
        return merged | own

    def key(self, node: yaml.Node, path: Path_) -> Hashable:
        """A key: text, or a whole number where the mapping may have such."""
        if not isinstance(node, yaml.ScalarNode):
            raise _Refused("a key must be text; got a list or a mapping", path, node)
        key = self.of(node, (*path, node.value))
        if isinstance(key, str) or (type(key) is int and dotted(path) in self.number_keys):
            return key
        raise _Refused(f"a key must be text; got {node.value!r}, put it in quotes", (*path, node.value), node)

    def scalar(self, node: yaml.ScalarNode, path: Path_) -> Any:
        """Text, a number, true, false or nothing; a date stays text."""
        text = node.value
        try:
            if node.tag == TAG + "int" and len(text) > 100:  # before Python's own limit, or minutes of arithmetic
                raise OverflowError
            value = self.loader.construct_object(node)
        except OverflowError:
            value = math.inf
        except (ValueError, LookupError, AttributeError):
            name = "date" if node.tag.endswith("timestamp") else node.tag.removeprefix(TAG)
            raise _Refused(f"{text[:40]!r} is no {name}; put it in quotes if it is text", path, node) from None
        if node.tag == TAG + "int" and not abs(value) < MAX_INTEGER:
            raise _Refused(f"expected an integer of 64 bits at most; got {len(text)} digits", path, node)
        if isinstance(value, float) and (
            (math.isnan(value) and not self.nan) or (math.isinf(value) and "inf" not in text.lower())
        ):
            raise _Refused(f"expected a number; got {text[:40]}", path, node)
        times = node.tag == TAG + "timestamp" or (":" in text and not isinstance(value, str))  # 10:30 is no 630
        return text if times else value


def _reason(error: yaml.YAMLError) -> str:
    """PyYAML's reason on one line."""
    if not isinstance(error, yaml.MarkedYAMLError):
        return " ".join(str(error).split())
    mark = error.problem_mark or error.context_mark
    said = ", ".join(part for part in (error.context, error.problem) if part)
    return f"{said} (line {mark.line + 1})" if mark is not None else said
