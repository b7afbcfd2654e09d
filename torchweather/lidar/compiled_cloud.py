"""Compiled looks at a cloud: what its checks ask, and where its beams start; the bits of torch."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from torchweather.core.compiled import uncontracted

__all__ = ["all_multiples", "look_at", "start_rows"]

Array = NDArray[np.float32]
ZERO, BLOCK = np.float32(0), 512


@uncontracted
def look_at(points: Array, bits: NDArray[np.int32], farthest: np.float32, bright: np.float32) -> tuple[Any, ...]:
    """Look at all rows of a cloud once.

    Args:
        points: ``(N, C)``, C of 4 or more.
        bits: the same as whole numbers, which rise with numbers above 0.
        farthest: magnitude that no number reaches.
        bright: intensity that is bright.

    Returns:
        Numbers that are NaN, infinite or too large; bits of the least and the largest intensity, less than 0 where one
        has a sign; how many intensities are above 0, and how many are bright.
    """
    flat = points.reshape(points.size)
    odd, positive, above = np.int32(0), np.int32(0), np.int32(0)
    for place in range(flat.size):
        odd += np.int32(0 if abs(flat[place]) < farthest else 1)
    low, high = bits[0, 3], bits[0, 3]
    for row in range(points.shape[0]):
        value, whole = points[row, 3], bits[row, 3]
        positive += np.int32(1 if value > ZERO else 0)
        above += np.int32(1 if value > bright else 0)
        low, high = min(low, whole), max(high, whole)
    return odd, low, high, positive, above


@uncontracted
def all_multiples(values: Array, step: np.float32, off: np.float32) -> tuple[bool, bool]:
    """Check whether all values lie within ``off`` steps of a multiple of a step; and whether one is above 0.

    Args:
        values: ``(N,)``.
        step: of the multiples.
        off: share of a step; 0 asks for whole numbers, of a step of 1.
    """
    some = False
    for begin in range(0, values.size, BLOCK):
        far = np.int32(0)
        for row in range(begin, min(begin + BLOCK, values.size)):
            steps = values[row] if off == ZERO else values[row] / step
            away = abs(steps - np.rint(steps))
            far += np.int32(1 if (away > ZERO if off == ZERO else not away < off) else 0)
            some |= values[row] > ZERO
        if far > 0:
            return False, some
    return True, some


@uncontracted
def start_rows(
    lowered: Array,
    square_m2: Array,
    end: NDArray[np.int8],
    points: Array,
    height_m: Array,
    empty: int,
) -> None:
    """Write a cloud from where its beams start, and the square of each row's range.

    Args:
        lowered: ``(N, C)``, written; ``(0, 0)``: every beam starts at 0.
        square_m2: ``(N,)``, written.
        end: ``(N,)``, written: 0 of a row away from the origin, else ``empty``.
        points: ``(N, C)``.
        height_m: ``(N,)`` or of all beams ``(1,)``.
        empty: number of a row without one.
    """
    is_lowered, own = lowered.size > 0, height_m.size > 1
    for row in range(points.shape[0]):
        x, y, z = points[row, 0], points[row, 1], points[row, 2]
        there = x != ZERO or y != ZERO or z != ZERO
        if is_lowered:
            for column in range(points.shape[1]):
                lowered[row, column] = points[row, column]
            z = z - height_m[row if own else 0] if there else z
            lowered[row, 2] = z
        square_m2[row] = x * x + y * y + z * z
        end[row] = 0 if there else empty
