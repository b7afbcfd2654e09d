"""Files of recipes, suites and pipelines: where the ready-made ones are, and how one is found, read and written."""

from __future__ import annotations

import os
import re
import tempfile
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import yaml

import torchweather
from torchweather.core.errors import InputValueError, TorchweatherError, nearest_name

__all__ = [
    "PIPELINE",
    "RECIPE",
    "SUFFIXES",
    "SUITE",
    "check_format",
    "files_of",
    "find",
    "format_of",
    "name_of",
    "read_yaml",
    "recipes_folder",
    "refuse_unknown",
    "write_yaml",
]

# What the format of a file begins with: a transform in a weather, conditions of several severities, several sensors.
RECIPE, SUITE, PIPELINE = "torchweather-recipe/", "torchweather-suite/", "torchweather-pipeline/"
SUFFIXES = (".yaml", ".yml")
FORMAT_LINE = re.compile(r"^format: *([a-z0-9/-]+) *$", re.MULTILINE)


def recipes_folder() -> Path:
    """Folder of the ready-made recipes: inside the installed package, or that of the checkout."""
    package = Path(torchweather.__file__).parent
    for folder in (package / "_recipes", package.parent / "transforms"):
        if folder.is_dir():
            return folder
    raise TorchweatherError(f"{package / '_recipes'}: the ready-made recipes are missing; install torchweather again.")


def files_of(*formats: str) -> list[Path]:
    """Ready-made files of some formats."""
    files = [path for path in recipes_folder().rglob("*") if path.suffix in SUFFIXES]
    return [path for path in files if format_of(path).startswith(formats)]


def format_of(path: Path) -> str:
    """What a file says that it is; empty where it cannot be read, which reading it will report."""
    try:
        text = path.read_text(encoding="utf-8")
        said = FORMAT_LINE.search(text)
        if said is not None:  # a name is looked up among all files: parsing each of them takes a third of a second
            return said[1]
        values = yaml.safe_load(text)
    except (OSError, UnicodeDecodeError, yaml.YAMLError):
        return ""
    return str(values.get("format", "")) if isinstance(values, Mapping) else ""


def find(name_or_path: str | os.PathLike[str], what: str = "recipe", *formats: str) -> Path:
    """The file of a name, or of a path."""
    if isinstance(name_or_path, os.PathLike) or str(name_or_path).endswith(SUFFIXES):
        return Path(name_or_path)
    files: dict[str, Path] = {}
    for one in formats or (RECIPE,):  # where a name stands for files of two formats, the first format's is meant
        own = {name_of(path): path for path in files_of(one)}
        found = [path for name, path in own.items() if str(name_or_path) in (name, name.rpartition("/")[2])]
        if len(found) == 1:
            return found[0]
        if found:
            several = ", ".join(sorted(name_of(path) for path in found))
            raise InputValueError(
                f"torchweather: {what} {str(name_or_path)!r} could be {several}; give the whole name."
            )
        files |= own
    others = [name_of(path) for path in files_of(*({RECIPE, SUITE, PIPELINE} - set(formats or (RECIPE,))))]
    if str(name_or_path) in others:
        is_a = format_of(recipes_folder() / f"{name_or_path}.yaml").partition("/")[0].removeprefix("torchweather-")
        raise InputValueError(
            f"torchweather: {str(name_or_path)!r} is a {is_a}, where a {what} is wanted (see torchweather list)."
        )
    short = [name.rpartition("/")[2] for name in files]
    raise InputValueError(
        f"torchweather: {what} must be one of {', '.join(sorted(files))}, or a file ending in .yaml; got "
        f"{str(name_or_path)!r}.{nearest_name(str(name_or_path), [*files, *short])}"
    )


def name_of(path: Path) -> str:
    """Path below the recipes' folder without its ending, or the name of a file elsewhere."""
    folder = recipes_folder()
    inside = path.is_relative_to(folder)
    return (path.relative_to(folder) if inside else Path(path.name)).with_name(path.stem).as_posix()


def read_yaml(path: Path, what: str) -> Any:
    """The plain values of a file."""
    try:
        return yaml.safe_load(path.read_text(encoding="utf-8"))
    except FileNotFoundError as error:
        raise TorchweatherError(f"{path}: no such file.") from error
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        reason = " ".join(str(error).split())
        raise TorchweatherError(f"{path}: wanted a {what} in YAML; it cannot be read ({reason}).") from error


def write_yaml(values: Mapping[str, Any], path: str | os.PathLike[str], *, owner: str) -> None:
    """Write plain values, whole or not at all."""
    target = Path(path)
    if target.suffix not in SUFFIXES:
        raise InputValueError(f"{owner}: the file must end in .yaml; got {target.name!r}.")
    handle, temporary = tempfile.mkstemp(dir=target.parent, prefix=f".{target.name}.")
    try:
        with os.fdopen(handle, "w", encoding="utf-8") as file:
            yaml.safe_dump(values, file, sort_keys=False)
        os.replace(temporary, target)
    except BaseException:
        Path(temporary).unlink(missing_ok=True)
        raise


def check_format(
    values: Any, path: Path, what: str, form: str, *, required: Sequence[str], known: Sequence[str]
) -> None:
    """Raise unless the plain values of a file are of a format, with the keys that it needs and no others.

    Args:
        values: of the file.
        path: for messages.
        what: a recipe, a suite, ...
        form: what its ``format`` must say.
        required, known: keys.
    """
    if not isinstance(values, Mapping) or values.get("format") != form:
        got = values.get("format") if isinstance(values, Mapping) else type(values).__name__
        raise TorchweatherError(f"{path}: wanted a {what} of format {form!r}; got {got!r}.")
    refuse_unknown(values, known, path, "key")
    for key in required:
        if key not in values:
            raise TorchweatherError(f"{path}: the {what} lacks {key!r}; wanted {', '.join(required)}.")


def refuse_unknown(values: Mapping[str, Any], known: Iterable[str], path: Path, what: str) -> None:
    """Raise for a key that is not known, with the nearest one that is."""
    names = list(known)
    for key in values:
        if key not in names:
            raise TorchweatherError(
                f"{path}: unknown {what} {key!r}; known are {', '.join(names)}.{nearest_name(key, names)}"
            )
