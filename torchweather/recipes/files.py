"""Files of recipes: where the ready-made ones are, and how one is found by its name."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

import torchweather
from torchweather.core.errors import InputTypeError, InputValueError, TorchweatherError, nearest_name
from torchweather.core.plugins import find_recipe, kind_of_file, plugins, recipe_name, recipe_names

__all__ = ["KINDS", "SUFFIXES", "find", "name_of", "ready_made", "recipes_folder"]

KINDS = ("transform", "multi_sensor", "suite")
"""A weather on one sensor; on several, or one of several weathers; weathers of five severities."""
SUFFIXES = (".yaml", ".yml")


def recipes_folder() -> Path:
    """Folder of the ready-made recipes: inside the installed package, or that of the checkout."""
    package = Path(torchweather.__file__).parent
    for folder in (package / "_recipes", package.parent / "transforms"):
        if folder.is_dir():
            return folder
    raise TorchweatherError(f"{package / '_recipes'}: the ready-made recipes are missing; install torchweather again.")


def _check_kinds(kinds: object) -> None:
    if not isinstance(kinds, (list, tuple, set, frozenset)) or not all(isinstance(one, str) for one in kinds):
        raise InputTypeError(f"torchweather: kind must be one of {', '.join(KINDS)}, or several; got {kinds!r}.")


def ready_made(kinds: Sequence[str] = KINDS) -> dict[str, Path]:
    """Files of the ready-made recipes by name, kind by kind."""
    _check_kinds(kinds)
    found: dict[str, dict[str, Path]] = {kind: {} for kind in kinds}
    for path in sorted(recipes_folder().rglob("*.yaml")):
        kind = kind_of_file(path)
        if kind in found:
            found[kind][name_of(path)] = path
    return {name: path for files in found.values() for name, path in files.items()}


def find(name_or_path: str | os.PathLike[str], kinds: Sequence[str] = KINDS) -> Path:
    """The file of a name, or of a path; where a short name is of several kinds, the first of ``kinds`` is meant.

    Recipes that packages add have their whole names alone.

    Raises:
        ValueError: no recipe of the name and the kinds, or several of one kind.
    """
    _check_kinds(kinds)
    if isinstance(name_or_path, os.PathLike) or str(name_or_path).endswith(SUFFIXES):
        return Path(name_or_path)
    wanted = str(name_or_path)
    added = find_recipe(wanted, ready_made()) if plugins("recipes") else None
    if added is not None:
        return added
    for kind in kinds:
        found = {name: path for name, path in ready_made([kind]).items() if wanted in (name, name.rpartition("/")[2])}
        if len(found) == 1:
            return next(iter(found.values()))
        if found:
            raise InputValueError(f"torchweather: recipe {wanted!r} could be {', '.join(found)}; give the whole name.")
    for kind in KINDS:
        if wanted in ready_made([kind]):
            raise InputValueError(
                f"torchweather: recipe {wanted!r} is of kind {kind}; expected {' or '.join(kinds)} (see torchweather "
                "list)."
            )
    names = sorted([*ready_made(kinds), *recipe_names(kinds)])
    near = nearest_name(wanted, [*names, *(name.rpartition("/")[2] for name in names)])
    raise InputValueError(
        f"torchweather: recipe must be one of {', '.join(names)}, or a file ending in .yaml; got {wanted!r}.{near}"
    )


def name_of(path: Path) -> str:
    """Path below the recipes' folder without its ending, or the name of a file elsewhere.

    A file in a package that adds recipes has the whole name that finds it.
    """
    added = recipe_name(path)
    if added is not None:
        return added
    folder = recipes_folder()
    inside = path.is_relative_to(folder)
    return (path.relative_to(folder) if inside else Path(path.name)).with_name(path.stem).as_posix()
