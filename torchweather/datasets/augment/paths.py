"""Paths that must stay below a root: of files found, of names in tables, of rows in a manifest."""

from __future__ import annotations

import hashlib
import os
import stat
from collections.abc import Iterator
from pathlib import Path, PurePosixPath

from torchweather.core.errors import InputValueError, TorchweatherError

__all__ = ["check_folders", "check_relative", "file_sha256", "files_below", "inside"]


def inside(root: Path, relative: str, what: str, *, follow_links: bool = False) -> Path:
    """The file of a relative path; refused where it would lie outside the root, also by way of a link.

    Args:
        root: the folder.
        relative: path below it, with ``/``.
        what: what names the path, for messages.
        follow_links: a link may lead out of the root.

    Example:
        >>> inside(Path("data"), "../secret.png", "table.json")
        Traceback (most recent call last):
        torchweather.core.errors.TorchweatherError: table.json: ...
    """
    check_relative(root, relative, what)
    path = root / relative
    if not follow_links and not path.resolve().is_relative_to(root.resolve()):
        raise TorchweatherError(_outside(root, relative, what))
    return path


def file_sha256(path: Path) -> str:
    """Of the content of a file."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def check_relative(root: Path, relative: str, what: str) -> None:
    """Refuse a path that leads out of the root as it is written; links are not looked at."""
    pure = PurePosixPath(relative)
    if not relative or pure.is_absolute() or ".." in pure.parts or "\\" in relative:
        raise TorchweatherError(_outside(root, relative, what))


def _outside(root: Path, relative: str, what: str) -> str:
    return f"{what}: {relative!r} lies outside {root}; expected a path below it. Nothing is read."


def files_below(root: Path, *, follow_links: bool = False, left_out: list[str] | None = None) -> Iterator[str]:
    """Relative paths of all files, by name; dot files and folders, pipes and sockets are left out.

    Args:
        root: the folder.
        follow_links: take links to folders, and links that lead out of the root; else they are refused.
        left_out: gets the relative paths of what is left out.
    """
    left = [] if left_out is None else left_out
    for folder, folders, names in os.walk(root, onerror=_raise, followlinks=follow_links):
        here = Path(folder)
        for name in sorted([*folders, *names]):
            if name.startswith("."):  # ._0.png of macOS, .Trash-0/
                left.append((here / name).relative_to(root).as_posix())
        folders[:] = sorted(name for name in folders if not name.startswith("."))
        names = [name for name in names if not name.startswith(".")]
        for name in [*folders, *names]:
            path = here / name
            if path.is_symlink():
                _check_link(root, path, follow_links=follow_links)
        for name in sorted(names):
            path = here / name
            relative = path.relative_to(root).as_posix()
            if path.is_file() or path.is_symlink():  # no pipes and sockets: reading them may never end
                if path.is_symlink() and path.exists() and not stat.S_ISREG(path.stat().st_mode):
                    left.append(relative)
                else:
                    yield relative
            else:
                left.append(relative)


def _check_link(root: Path, path: Path, *, follow_links: bool) -> None:
    """Refuse a link that leads out of the root or to a folder, unless they are followed, and one that never ends."""
    if follow_links:
        if path.is_dir() and path.parent.resolve().is_relative_to(path.resolve()):
            raise TorchweatherError(f"{path}: a link to a folder that holds it has no end. Take it out of {root}.")
        return
    relative = path.relative_to(root).as_posix()
    check_relative(root, relative, f"{path}: a link")
    if not path.resolve().is_relative_to(root.resolve()):
        raise TorchweatherError(
            f"{_outside(root, relative, f'{path}: a link')} --follow-links takes links, wherever they lead."
        )
    if path.is_dir():
        raise TorchweatherError(
            f"{path}: a link to a folder; its files would be done twice. Take it out of {root}, or give --follow-links."
        )


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
