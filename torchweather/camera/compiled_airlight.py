"""Compiled look for the brightest spot of a mosaic: the sums of ``airlight._brightest``, row after row."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from torchweather.core.compiled import jit

__all__ = ["brightest_cells"]

Array = NDArray[np.float32]


@jit
def _sums_row(both: Array, signal: Array, row: int, spare: Array) -> int:
    """Sums over the 3 x 3 neighbours two apart of each pixel of a row, and how many rows they have."""
    height, width = signal.shape
    first, last = max(row - 2, row % 2), row + 2 if row + 2 < height else row
    for at in range(width):
        spare[at] = signal[first, at]
    for other in range(first + 2, last + 1, 2):
        for at in range(width):
            spare[at] += signal[other, at]
    for at in range(2, width - 2):
        both[at] = (spare[at - 2] + spare[at]) + spare[at + 2]
    for at in range(2):
        both[at] = spare[at] + spare[at + 2]
        both[width - 1 - at] = spare[width - 1 - at] + spare[width - 3 - at]
    return (last - first) // 2 + 1


@jit
def brightest_cells(signal: Array) -> Array:
    """Mean of the brightest 3 x 3 neighbourhood of each phase, ``(2, 2)``; at the edges of fewer.

    Args:
        signal: ``(H, W)``, 4 or more of each.
    """
    height, width = signal.shape
    both, spare = np.empty(width, np.float32), np.empty(width, np.float32)
    most = np.full((2, width), -np.inf, np.float32)
    for row in range(height):
        count = _sums_row(both, signal, row, spare)
        inner, outer = np.float32(1.0 / (3 * count)), np.float32(1.0 / (2 * count))
        column_most = most[row % 2]
        for at in range(2, width - 2):
            column_most[at] = max(column_most[at], both[at] * inner)
        for at in (0, 1, width - 2, width - 1):
            column_most[at] = max(column_most[at], both[at] * outer)
    found = np.empty((2, 2), np.float32)
    for y in range(2):
        for x in range(2):
            found[y, x] = most[y, x::2].max()
    return found
