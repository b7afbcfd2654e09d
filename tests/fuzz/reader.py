"""A reader of the package as the fuzzer takes it: a file name, small files of its kind, and a call."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

__all__ = ["Reader", "given", "saved"]


def _nothing(_: Path) -> Mapping[str, bytes]:
    return {}


@dataclass(frozen=True)
class Reader:
    """One reader and one kind of file.

    Args:
        name: of the reader and the kind.
        file: name under which the mutated file lies, folders included.
        make: files of the kind, made in an empty folder.
        read: takes the path of the file; what it gives must be finite.
        beside: further files by name, made in an empty folder; they stay as they are.
        memory_bytes: address space that a read may take.
    """

    name: str
    file: str
    make: Callable[[Path], Sequence[bytes]]
    read: Callable[[Path], Any]
    beside: Callable[[Path], Mapping[str, bytes]] = _nothing
    memory_bytes: int = 2 << 30


def saved(folder: Path, name: str, write: Callable[[Path], Any]) -> bytes:
    """The bytes that a writer puts into a file of this name."""
    path = folder / name
    path.parent.mkdir(parents=True, exist_ok=True)
    write(path)
    return path.read_bytes()


def given(*contents: bytes | str) -> Callable[[Path], Sequence[bytes]]:
    """Files that stand in the code."""
    return lambda _: [one.encode() if isinstance(one, str) else one for one in contents]
