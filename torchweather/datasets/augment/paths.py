"""Paths that must stay below a root: of files found, of names in tables, of rows in a manifest."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path, PurePosixPath

from torchweather.core.errors import InputValueError, TorchweatherError

__all__ = ["check_folders", "check_relative", "files_below", "inside"]


def inside(root: Path, relative: str, what: str) -> Path:
    """The file of a relative path; refused where it would lie outside the root, also by way of a link.

    Example:
        >>> inside(Path("data"), "../secret.png", "table.json")
        Traceback (most recent call last):
        torchweather.core.errors.TorchweatherError: table.json: ...
    """
    check_relative(root, relative, what)
    path = root / relative
    if not path.resolve().is_relative_to(root.resolve()):
        raise TorchweatherError(_outside(root, relative, what))
    return path


def check_relative(root: Path, relative: str, what: str) -> None:
    """Refuse a path that leads out of the root as it is written; links are not looked at."""
    pure = PurePosixPath(relative)
    if not relative or pure.is_absolute() or ".." in pure.parts or "\\" in relative:
        raise TorchweatherError(_outside(root, relative, what))


def _outside(root: Path, relative: str, what: str) -> str:
    return f"{what}: {relative!r} lies outside {root}; wanted a path below it. Nothing is read."


def files_below(root: Path) -> Iterator[str]:
    """Relative paths of all files, by name; a link out of the root is refused, dot files and folders are left out."""
    for folder, folders, names in os.walk(root, onerror=_raise):
        folders[:] = sorted(name for name in folders if not name.startswith("."))
        names = [name for name in names if not name.startswith(".")]  # ._0.png of macOS, .Trash-0/
        for name in [*folders, *names]:
            path = Path(folder, name)
            if path.is_symlink():
                relative = path.relative_to(root).as_posix()
                inside(root, relative, f"{path}: a link")
                if path.is_dir():
                    raise TorchweatherError(
                        f"{path}: a link to a folder; its files would be done twice. Take it out of {root}."
                    )
        for name in sorted(names):
            path = Path(folder, name)
            if path.is_file() or path.is_symlink():  # no pipes and sockets: reading them may never end
                yield path.relative_to(root).as_posix()


def check_folders(source: Path, target: Path) -> None:
    """Refuse a source that is none, and a target in it or around it."""
    if not source.is_dir():
        raise InputValueError(f"augment: SRC must be a folder; there is none at {source}.")
    if target.exists() and not target.is_dir():
        raise InputValueError(f"augment: DST must be a folder; {target} is a file.")
    here, there = source.resolve(), target.resolve()
    if here == there:
        raise InputValueError(f"augment: SRC and DST are the same folder, {source}; give another DST.")
    if there.is_relative_to(here) or here.is_relative_to(there):
        raise InputValueError(f"augment: {source} and {target} lie in each other; give a DST beside SRC.")


def _raise(error: OSError) -> None:
    raise error
