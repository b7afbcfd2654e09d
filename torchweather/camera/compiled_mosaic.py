"""Compiled way from a mosaic to sRGB levels: Malvar-He-Cutler and encoding, row after row.

The same filters as ``demosaic`` by ``malvar``; sums are rounded in another order.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from torchweather.camera.compiled_bytes import find_levels
from torchweather.core.compiled import jit

__all__ = ["levels_of_mosaic"]

Array = NDArray[np.float32]

HALF, TWO, FOUR, FIVE, SIX = (np.float32(number) for number in (0.5, 2, 4, 5, 6))
THREE_HALVES, EIGHTH = np.float32(1.5), np.float32(1 / 8)


@jit
def _reflected(at: int, size: int) -> int:
    """Index of a row or column beyond the edges, reflected about the edge pixel."""
    at = abs(at)
    return at if at < size else 2 * (size - 1) - at


@jit
def _pad(out: Array, row: Array) -> None:
    width = row.size
    out[2 : width + 2] = row
    for side in range(2):
        out[side] = row[2 - side]
        out[width + 2 + side] = row[width - 2 - side]


@jit
def _filter_row(found: Array, above_2: Array, above: Array, here: Array, below: Array, below_2: Array) -> None:
    """The five values of each pixel: its own, green at a colour, a colour at green in its row and in its column, and
    the opposite colour. Rows are padded by two pixels."""
    for at in range(found.shape[1]):
        own = here[at + 2]
        near_rows, near_columns = above[at + 2] + below[at + 2], here[at + 1] + here[at + 3]
        far_rows, far_columns = above_2[at + 2] + below_2[at + 2], here[at] + here[at + 4]
        corners = (above[at + 1] + above[at + 3]) + (below[at + 1] + below[at + 3])
        found[0, at] = own
        found[1, at] = (FOUR * own + TWO * (near_rows + near_columns) - far_rows - far_columns) * EIGHTH
        found[2, at] = (FIVE * own + FOUR * near_columns - corners - far_columns + HALF * far_rows) * EIGHTH
        found[3, at] = (FIVE * own + FOUR * near_rows - corners - far_rows + HALF * far_columns) * EIGHTH
        found[4, at] = (SIX * own + TWO * corners - THREE_HALVES * (far_rows + far_columns)) * EIGHTH


@jit
def _interleave(out: Array, even: Array, odd: Array) -> None:
    for at in range(out.size // 2):
        out[2 * at] = even[2 * at]
        out[2 * at + 1] = odd[2 * at + 1]


@jit
def levels_of_mosaic(
    out: NDArray[np.uint8],
    bayer: Array,
    filters: NDArray[np.int64],
    matrix: Array,
    level: NDArray[np.uint8],
    begins: Array,
    first: int,
    last: int,
) -> None:
    """Write the sRGB levels of the rows ``first..last`` of one frame.

    Args:
        out: ``(3, H, W)``, written.
        bayer: ``(H, W)`` linear in light.
        filters: ``(3, 2, 2)`` which of the values of ``_filter_row`` each colour takes in each phase of the cell.
        matrix: ``(3, 3)`` of colours; ``(0, 0)``: none.
        level, begins: as of ``find_levels``.
        first, last: rows.
    """
    height, width = bayer.shape
    rows, found = np.empty((5, width + 4), np.float32), np.empty((5, width), np.float32)
    colours, mixed = np.empty((3, width), np.float32), np.empty(width, np.float32)
    for row in range(first - 2, first + 2):
        _pad(rows[row % 5], bayer[_reflected(row, height)])
    for row in range(first, last):
        _pad(rows[(row + 2) % 5], bayer[_reflected(row + 2, height)])
        around = (rows[(row - 2) % 5], rows[(row - 1) % 5], rows[row % 5], rows[(row + 1) % 5], rows[(row + 2) % 5])
        _filter_row(found, *around)
        for colour in range(3):
            of_row = filters[colour, row % 2]
            _interleave(colours[colour], found[of_row[0]], found[of_row[1]])
        for colour in range(3):
            if matrix.size == 0:
                find_levels(out[colour, row], colours[colour], level, begins)
                continue
            red, green, blue = matrix[colour, 0], matrix[colour, 1], matrix[colour, 2]
            for at in range(width):
                mixed[at] = red * colours[0, at] + green * colours[1, at] + blue * colours[2, at]
            find_levels(out[colour, row], mixed, level, begins)
