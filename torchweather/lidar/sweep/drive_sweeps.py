"""Choice of the sweeps that stand for a whole drive."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import TypeVar

__all__ = ["MOST_SWEEPS", "evenly_chosen"]

Name = TypeVar("Name", str, Path)

# So many sweeps, evenly over the drive, are enough: 0.1 s and 1 MB each.
MOST_SWEEPS = 50


def evenly_chosen(files: Iterable[Name], most: int = MOST_SWEEPS) -> list[Name]:
    """At most so many of the files, evenly by name; the same in whatever order they come.

    Example:
        >>> evenly_chosen(["c", "a", "b", "a"], 2)
        ['a', 'c']
    """
    rising = sorted(set(files))
    if len(rising) <= most:
        return rising
    return [rising[round(k * (len(rising) - 1) / (most - 1))] for k in range(most)]
