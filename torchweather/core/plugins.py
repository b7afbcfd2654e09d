"""Names that other installed packages add by entry points, each loaded when it is asked for.

A package lists its names in ``pyproject.toml``, below ``[project.entry-points."torchweather.GROUP"]``. The groups are
``sensors``, ``weathers``, ``effects`` and ``recipes`` (``docs/how-to/write-a-package.md``). Reading the names imports
nothing of the package and no torch.
"""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Collection
from dataclasses import dataclass
from functools import lru_cache
from importlib.metadata import EntryPoint, entry_points
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from torchweather.core.exceptions import InputValueError, TorchweatherError

__all__ = [
    "GROUPS",
    "Plugin",
    "find_plugin",
    "find_recipe",
    "kind_of_file",
    "plugin_names",
    "plugins",
    "recipe_files",
    "recipe_name",
    "recipe_names",
    "refusal",
]

GROUPS = ("sensors", "weathers", "effects", "recipes")
LIBRARY = "torchweather"
# Among many files the kind is read as text: parsing each of them takes a third of a second.
KIND_LINE = re.compile(r"^kind: *(\w+) *$", re.MULTILINE)


@dataclass(frozen=True)
class Plugin:
    """A name that an installed package adds.

    Args:
        name: such as ``lidar.acme-32``.
        package: distribution that it comes from.
        entry: its entry point.
    """

    name: str
    package: str
    entry: EntryPoint

    def __str__(self) -> str:
        return f"package {self.package}, entry point {self.name} = {self.entry.value} of {self.entry.group}"

    def load(self) -> Any:
        """The object of the entry point; importing it runs the package's own code.

        Raises:
            TorchweatherError: that code fails; the message names the package and the entry point.
        """
        try:
            return self.entry.load()
        except Exception as error:
            raise self.error(f"cannot be loaded: {type(error).__name__}: {error}") from error

    def error(self, text: str) -> TorchweatherError:
        """An error that names the package and the entry point."""
        return TorchweatherError(
            f"{self}: {text.removesuffix('.')}. Mend or uninstall the package; other names work without it."
        )


def plugins(group: str) -> dict[str, tuple[Plugin, ...]]:
    """Names of a group, each with the packages that add it; several are refused when the name is asked for.

    Example:
        >>> all(len(owners) == 1 for owners in plugins("sensors").values())
        True
    """
    return dict(_installed(group, tuple(sys.path)))


@lru_cache(maxsize=32)
def _installed(group: str, path: tuple[str, ...]) -> tuple[tuple[str, tuple[Plugin, ...]], ...]:
    """By name in the order of the alphabet; kept until the path on which packages are found changes."""
    found: dict[str, list[Plugin]] = {}
    for entry in entry_points(group=f"{LIBRARY}.{group}"):
        package = "of no name" if entry.dist is None else entry.dist.name
        found.setdefault(entry.name, []).append(Plugin(entry.name, package, entry))
    return tuple((name, tuple(sorted(found[name], key=lambda one: one.package))) for name in sorted(found))


def plugin_names(group: str, prefix: str = "") -> list[str]:
    """Names of a group that begin with a prefix, without it."""
    return [name.removeprefix(prefix) for name in plugins(group) if name.startswith(prefix)]


def find_plugin(group: str, name: str, own: Collection[str]) -> Plugin | None:
    """The package's entry of a name; ``None`` where the name is the library's, or nobody's.

    Args:
        group: of ``GROUPS``.
        name: as the entry point has it.
        own: names of the library.

    Raises:
        InputValueError: the name has two owners.
    """
    owners = plugins(group).get(name, ())
    said = refusal(name, owners, own)
    if said is not None:
        raise InputValueError(f"torchweather: {said}")
    return owners[0] if owners else None


def refusal(name: str, owners: Collection[object], own: Collection[str]) -> str | None:
    """A sentence on a name that has several owners; ``None`` where it has one."""
    every = [*([LIBRARY] if name in own else []), *map(str, owners)]
    if len(every) < 2:
        return None
    return f"{name!r} has {len(every)} owners: {'; '.join(every)}. Rename the entry point, or uninstall a package."


def recipe_names(kinds: Collection[str]) -> list[str]:
    """Whole names of the recipes of some kinds that packages add, ``PREFIX/PATH``; none of a package without folder."""
    whole = [plugin for owners in plugins("recipes").values() for plugin in owners if _folder(plugin) is not None]
    return sorted(
        {
            f"{plugin.name}/{name}"
            for plugin in whole
            for name, path in recipe_files(plugin).items()
            if kind_of_file(path) in kinds
        }
    )


def find_recipe(name: str, own: Collection[str]) -> Path | None:
    """File of a recipe that a package adds; ``None`` where the name is the library's, or nobody's.

    Args:
        name: whole, ``PREFIX/PATH``.
        own: names of the library.

    Raises:
        InputValueError: the name has two owners.
        TorchweatherError: the package of the prefix has no such folder.
    """
    found: list[tuple[Plugin, Path]] = []
    for prefix, owners in plugins("recipes").items():
        for plugin in owners if name.startswith(f"{prefix}/") else ():
            if name in own and _folder(plugin) is None:
                continue  # a broken package leaves the library's names alone
            path = recipe_files(plugin).get(name.removeprefix(f"{prefix}/"))
            found += [] if path is None else [(plugin, path)]
    said = refusal(name, [plugin for plugin, _ in found], own)
    if said is not None:
        raise InputValueError(f"torchweather: {said}")
    return found[0][1] if found else None


def recipe_name(path: Path) -> str | None:
    """Whole name of a file in the folder of a package; ``None`` for any other file."""
    for owners in plugins("recipes").values():
        for plugin in owners:
            folder = _folder(plugin)
            if folder is not None and path.is_relative_to(folder):
                return f"{plugin.name}/{path.relative_to(folder).with_suffix('').as_posix()}"
    return None


def recipe_files(plugin: Plugin) -> dict[str, Path]:
    """Files of a package's recipes by their path below its folder.

    Raises:
        TorchweatherError: there is no such folder.
    """
    folder = _folder(plugin)
    if folder is None:
        raise plugin.error(f"there is no folder {plugin.entry.value.replace('.', '/')} in the package.")
    return {path.relative_to(folder).with_suffix("").as_posix(): path for path in sorted(folder.rglob("*.yaml"))}


def _folder(plugin: Plugin) -> Path | None:
    """Folder of an entry point's module, found without importing it; ``None`` where there is none."""
    top, _, rest = plugin.entry.value.partition(".")
    try:
        spec = find_spec(top)
    except ValueError:  # no name, or a module that has no place
        return None
    for place in () if spec is None else spec.submodule_search_locations or ():
        folder = Path(place, *filter(None, rest.split(".")))
        if folder.is_dir():
            return folder
    return None


def kind_of_file(path: str | os.PathLike[str]) -> str | None:
    """Kind of a recipe's file, read as text; ``None`` where it states none."""
    line = KIND_LINE.search(Path(path).read_text(encoding="utf-8"))
    return None if line is None else line[1]
