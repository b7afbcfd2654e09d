"""Compiled rows of a cloud: where its beams start, and back; the bits of torch."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from torchweather.core.compiled import uncontracted

__all__ = ["lower_rows", "raise_rows"]

Array = NDArray[np.float32]
ZERO = np.float32(0)


@uncontracted
def raise_rows(out: Array, values: Array, local: Array, given: Array, height_m: Array) -> None:
    """Write a result from where each beam starts in the sensor's frame, as ``points_in_cloud_frame``.

    Args:
        out: ``(N, C)``, written.
        values: ``(N, C)`` the result.
        local: ``(N, C)`` what went in, likewise.
        given: ``(M, C)`` the same as it came, M <= N.
        height_m: ``(N,)`` at which each beam starts.
    """
    for row in range(values.shape[0]):
        for column in range(values.shape[1]):
            out[row, column] = values[row, column]
        x, y, z = values[row, 0], values[row, 1], values[row, 2]
        if x == local[row, 0] and y == local[row, 1] and z == local[row, 2]:
            out[row, 2] = given[row, 2] if row < given.shape[0] else ZERO
        elif x != ZERO or y != ZERO or z != ZERO:
            out[row, 2] = np.float32(np.float64(z) + np.float64(height_m[row]))
        else:
            out[row, 2] = ZERO


@uncontracted
def lower_rows(out: Array, range_m: Array, there: NDArray[np.bool_], points: Array, height_m: float) -> None:
    """Write a cloud from where its beams start, all at one height, and the range of every row.

    Args:
        out: ``(N, C)``, written; rows at the origin hold no return and stay there.
        range_m: ``(N,)``, written.
        there: ``(N,)`` rows that hold a return, written.
        points: ``(N, C)``.
        height_m: over the sensor's origin.
    """
    height = np.float32(height_m)
    for row in range(points.shape[0]):
        for column in range(points.shape[1]):
            out[row, column] = points[row, column]
        x, y, z = points[row, 0], points[row, 1], points[row, 2]
        there[row] = x != ZERO or y != ZERO or z != ZERO
        if there[row]:
            z = z - height
            out[row, 2] = z
        range_m[row] = np.sqrt(x * x + y * y + z * z)
