"""Compiled search for the ring of each beam by its elevation: heights of two blocks of lasers.

Elevations are compared by their tangents, without an arc tangent. Rows too near a limit for rounding are left to torch.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from torchweather.core.compiled import uncontracted

__all__ = ["Block", "heights_of_rows"]

Array = NDArray[np.float32]
ZERO, UNSURE = np.float32(0), np.float32(np.nan)


class Block(NamedTuple):
    """Rings of one block of lasers, by rising elevation.

    Args:
        middle_m: height of the block.
        sure: tangent of the elevation beyond which a beam is this block's, away from the other block.
        within: tangent of the elevation at the block's end beside the other block.
        low, per_cell: first tangent of the cells, and cells per unit.
        first: ``(cells,)`` ring of each cell, below its limit; at most one limit lies in a cell or ``near`` it.
        limit: ``(rings,)`` tangent of the upper limit of each ring; of the last infinite.
        height_m: ``(rings,)``.
    """

    middle_m: np.float32
    sure: np.float32
    within: np.float32
    low: np.float32
    per_cell: np.float32
    first: NDArray[np.int32]
    limit: Array
    height_m: Array


@uncontracted
def heights_of_rows(height_m: Array, points: Array, lower: Block, upper: Block, near: np.float32) -> int:
    """Write the height at which the beam of each row starts; NaN where torch must decide. Returns their number.

    Args:
        height_m: ``(N,)``, written.
        points: ``(N, C)`` in the sensor's frame.
        lower, upper: the blocks of lasers.
        near: difference of tangents that rounding may reach.
    """
    lower_m, upper_m, unsure = lower.middle_m, upper.middle_m, 0
    # Taken out of the tuples here: that costs more than a row.
    lower_sure, lower_within, upper_sure, upper_within = lower.sure, lower.within, upper.sure, upper.within
    first_lower, limit_lower, height_lower = lower.first, lower.limit, lower.height_m
    first_upper, limit_upper, height_upper = upper.first, upper.limit, upper.height_m
    low_lower, cells_lower, last_lower = lower.low, lower.per_cell, np.float32(lower.first.size - 1)
    low_upper, cells_upper, last_upper = upper.low, upper.per_cell, np.float32(upper.first.size - 1)
    for row in range(points.shape[0]):
        x, y, z = points[row, 0], points[row, 1], points[row, 2]
        flat, found = np.sqrt(x * x + y * y), UNSURE
        of_lower, of_upper = (z - lower_m) / flat, (z - upper_m) / flat
        if x == ZERO and y == ZERO:
            found = UNSURE if z != ZERO else ZERO
        elif of_lower > upper_sure and of_upper > upper_within:
            cell = min(max((of_upper - low_upper) * cells_upper, ZERO), last_upper)
            ring = first_upper[int(cell)]
            away = of_upper - limit_upper[ring]
            found = UNSURE if abs(away) < near else height_upper[ring + 1 if away > ZERO else ring]
        elif of_upper < lower_sure and of_lower < lower_within:
            cell = min(max((of_lower - low_lower) * cells_lower, ZERO), last_lower)
            ring = first_lower[int(cell)]
            away = of_lower - limit_lower[ring]
            found = UNSURE if abs(away) < near else height_lower[ring + 1 if away > ZERO else ring]
        height_m[row] = found
        unsure += 1 if found != found else 0
    return unsure
