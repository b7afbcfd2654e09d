"""Paths that must stay below a root: of files found, of names in tables, of rows in a manifest."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path, PurePosixPath

from torchweather.errors import TorchweatherError

__all__ = ["check_folders", "files_below", "inside"]


def inside(root: Path, relative: str, what: str) -> Path:
    """The file of a relative path; refused where it would lie outside the root, also by way of a link.

    Example:
        >>> inside(Path("data"), "../secret.png", "table.json")
        Traceback (most recent call last):
        torchweather.errors.TorchweatherError: table.json: ...
    """
    pure = PurePosixPath(relative)
    path = root / pure
    stays = relative and not pure.is_absolute() and ".." not in pure.parts and "\\" not in relative
    if not stays or not path.resolve().is_relative_to(root.resolve()):
        raise TorchweatherError(f"{what}: {relative!r} lies outside {root}; wanted a path below it. Nothing is read.")
    return path


def files_below(root: Path) -> Iterator[str]:
    """Relative paths of all files, by name; a link out of the root is refused."""
    for folder, folders, names in os.walk(root, onerror=_raise):
        folders.sort()
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
            yield Path(folder, name).relative_to(root).as_posix()


def check_folders(source: Path, target: Path) -> None:
    """Refuse a source that is none, and a target in it or around it."""
    if not source.is_dir():
        raise ValueError(f"augment: SRC must be a folder; there is none at {source}.")
    if target.exists() and not target.is_dir():
        raise ValueError(f"augment: DST must be a folder; {target} is a file.")
    here, there = source.resolve(), target.resolve()
    if here == there:
        raise ValueError(f"augment: SRC and DST are the same folder, {source}; give another DST.")
    if there.is_relative_to(here) or here.is_relative_to(there):
        raise ValueError(f"augment: {source} and {target} lie in each other; give a DST beside SRC.")


def _raise(error: OSError) -> None:
    raise error
