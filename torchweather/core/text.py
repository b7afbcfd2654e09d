"""Text for people: columns of equal width."""

from __future__ import annotations

__all__ = ["aligned"]


def aligned(rows: list[list[str]]) -> list[str]:
    """Columns of equal width, two spaces apart.

    Example:
        >>> aligned([["a", "bb"], ["ccc", "d"]])
        ['a    bb', 'ccc  d']
    """
    widths = [max(len(row[column]) for row in rows) for column in range(len(rows[0]))]
    return ["  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in rows]
