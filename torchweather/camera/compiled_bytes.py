"""Compiled look-ups of ``srgb_bytes``: the same numbers, without an array between the steps."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from torchweather.core.compiled import jit

__all__ = ["find_levels", "look_up"]


@jit
def look_up(out: NDArray[np.float32], levels: NDArray[np.uint8], table: NDArray[np.float32]) -> None:
    """Write the table's value of each level.

    Args:
        out: ``(n,)``, written.
        levels: ``(n,)``.
        table: ``(256,)``.
    """
    for at in range(levels.size):
        out[at] = table[levels[at]]


@jit
def find_levels(
    out: NDArray[np.uint8], linear: NDArray[np.float32], level: NDArray[np.uint8], begins: NDArray[np.float32]
) -> None:
    """Write the level of each linear value.

    Args:
        out: ``(n,)``, written.
        linear: ``(n,)``; below 0 and nan are 0, above 1 is 1.
        level: of the lower end of each range of equal width between 0 and 1.
        begins: of each range, where the next level begins.
    """
    ranges = np.float32(level.size - 1)
    zero, last = np.float32(0), np.uint32(level.size - 1)
    for at in range(linear.size):
        value = linear[at]
        place = np.uint32(min(max(value * ranges, zero), ranges))
        out[at] = level[place] + (1 if value >= begins[place] and place < last else 0)  # infinity begins nothing
