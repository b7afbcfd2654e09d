"""Text for people: columns of equal width, names that are near another."""

from __future__ import annotations

import difflib
from collections.abc import Iterable

__all__ = ["LONGEST_SHOWN", "aligned", "nearest_name"]

LONGEST_SHOWN = 500  # characters of a value in a message


def aligned(rows: list[list[str]]) -> list[str]:
    """Columns of equal width, two spaces apart.

    Example:
        >>> aligned([["a", "bb"], ["ccc", "d"]])
        ['a    bb', 'ccc  d']
    """
    widths = [max(len(row[column]) for row in rows) for column in range(len(rows[0]))]
    return ["  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in rows]


def nearest_name(value: object, names: Iterable[str]) -> str:
    """A sentence `` Did you mean 'x'?``, or an empty string where nothing is near.

    Example:
        >>> nearest_name("rian", ["rain", "snow"])
        " Did you mean 'rain'?"
    """
    # Of a long text the beginning: the time grows with the square of its length.
    near = difflib.get_close_matches(str(value)[:LONGEST_SHOWN], list(names), n=1)
    return f" Did you mean {near[0]!r}?" if near else ""
