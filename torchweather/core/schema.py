"""Tables of keys for mappings out of a file: unknown, missing and wrong keys are refused by their dotted name."""

from __future__ import annotations

import numbers
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, fields, replace
from typing import Any

from torchweather.core.errors import InputValueError, TorchweatherError, nearest_name

__all__ = [
    "ANY",
    "DRAWN",
    "FLAG",
    "MAPPING",
    "NUMBER",
    "NUMBERS",
    "ROWS",
    "SHARE",
    "TEXT",
    "WHOLE",
    "Key",
    "check_format",
    "check_keys",
    "check_value",
    "field_keys",
    "is_number",
    "is_whole",
    "one_of",
    "refuse_unknown",
]


@dataclass(frozen=True)
class Key:
    """One key of a mapping.

    Args:
        takes: its values in words, for messages.
        fits: whether it takes a value.
        required: it must be there.
        names: its values, where they are names; the nearest is suggested.
        null: it may stand without a value.
    """

    takes: str
    fits: Callable[[Any], bool]
    required: bool = False
    names: tuple[str, ...] = ()
    null: bool = False

    @property
    def needed(self) -> Key:
        """The same key, which must be there."""
        return replace(self, required=True)

    @property
    def or_null(self) -> Key:
        """The same key, which may stand without a value."""
        return replace(self, null=True)


def is_number(value: object) -> bool:
    """Check whether a value is a number; true and false are none."""
    return isinstance(value, numbers.Real) and not isinstance(value, bool)


def is_whole(value: object) -> bool:
    """Check whether a value is a whole number."""
    return isinstance(value, int) and not isinstance(value, bool)


def _is_number_or_list(value: object) -> bool:
    return is_number(value) or NUMBERS.fits(value)


def one_of(names: Iterable[str]) -> Key:
    """A key that takes one of several names."""
    known = tuple(names)
    takes = f"one of {', '.join(known)}" if len(known) > 1 else known[0]
    return Key(takes, lambda value: isinstance(value, str) and value in known, names=known)


TEXT = Key("text", lambda value: isinstance(value, str))
FLAG = Key("true or false", lambda value: isinstance(value, bool))
NUMBER = Key("a number", is_number)
SHARE = Key("a number in [0, 1]", lambda value: is_number(value) and 0 <= value <= 1)
WHOLE = Key("a whole number", is_whole)
DRAWN = Key(
    "a number, or {uniform: [low, high]}, {log_uniform: [low, high]} or {choice: [...]}",
    lambda value: (
        is_number(value) or (isinstance(value, Mapping) and bool(set(value) & {"uniform", "log_uniform", "choice"}))
    ),
)
NUMBERS = Key("a list of numbers", lambda value: isinstance(value, list) and all(map(_is_number_or_list, value)))
ANY = Key("a value", lambda value: True)
MAPPING = Key("keys with values", lambda value: isinstance(value, Mapping))
ROWS = Key(
    "a list of entries with keys", lambda value: isinstance(value, (list, tuple)) and all(map(MAPPING.fits, value))
)


def check_format(values: Any, form: str, file: str, what: str) -> None:
    """Raise unless the values of a file are a mapping whose ``format`` is ``form``."""
    got = values.get("format") if isinstance(values, Mapping) else type(values).__name__
    if not isinstance(values, Mapping) or got != form:
        raise TorchweatherError(f"{file}: format must be {form!r}; got {got!r}. Expected {what}.")


def check_keys(values: Any, keys: Mapping[str, Key], file: str, at: str = "") -> None:
    """Raise unless ``values`` is a mapping with the keys that it needs and no others, each with a value that fits.

    Args:
        values: of the file.
        keys: by name.
        file, at: the file and the dotted key of the mapping, for messages.

    Example:
        >>> try:
        ...     check_keys({"kind": "fgo"}, {"kind": one_of(["rain", "fog"])}, "a.yaml", "weather")
        ... except TorchweatherError as error:
        ...     print(error)
        a.yaml: weather.kind must be one of rain, fog; got 'fgo'. Did you mean 'fog'?
    """
    check_value(values, Key(f"{MAPPING.takes}: {', '.join(keys)}", MAPPING.fits), file, at or "it")
    refuse_unknown(values, keys, at, file)
    for name, key in keys.items():
        where, value = f"{at}.{name}" if at else name, values.get(name)
        if name not in values:
            if key.required:
                raise TorchweatherError(f"{file}: {where} is missing; expected {key.takes}.")
        else:
            check_value(value, key, file, where)


def check_value(value: Any, key: Key, file: str, at: str) -> None:
    """Raise unless a key takes the value."""
    if key.fits(value) or (key.null and value is None):
        return
    advice = nearest_name(value, key.names)
    if isinstance(value, str) and key.takes.startswith(("a number", "a whole")):  # YAML 1.1 takes 1e-3 for text
        advice = " It is text; a number has a point: 1.0e-3, not 1e-3."
    raise InputValueError(f"{file}: {at} must be {key.takes}; got {_short(value)}.{advice}")


def field_keys(kind: type) -> dict[str, Key]:
    """Keys of a dataclass's fields after their annotations, none of which must be there.

    Args:
        kind: a dataclass of numbers, text, true or false, and tuples or tensors of numbers.
    """
    by_type = {"tuple": NUMBERS, "Tensor": NUMBERS, "str": TEXT, "bool": FLAG, "int": WHOLE}
    found = {}
    for one in fields(kind):
        annotation = str(one.type)
        number = DRAWN if one.name in getattr(kind, "drawable", ()) else NUMBER
        key = by_type.get(annotation.partition("[")[0].partition(" ")[0], number)
        found[one.name] = key.or_null if "None" in annotation else key
    return found


def refuse_unknown(values: Mapping[str, Any], known: Iterable[str], at: str, file: str) -> None:
    """Raise for a key that is none of the known ones, with the nearest of them."""
    names = list(known)
    for name in values:
        if name not in names:
            where = f"{at}.{name}" if at else str(name)
            raise TorchweatherError(
                f"{file}: unknown key {where!r}; known are {', '.join(names)}.{nearest_name(name, names)}"
            )


def _short(value: object) -> str:
    shown = repr(value)
    return shown if len(shown) <= 200 else f"{shown[:197]}..."
