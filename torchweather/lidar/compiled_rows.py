"""Compiled rows of a cloud: back from where its beams start; the bits of torch."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from torchweather.core.compiled import uncontracted

__all__ = ["raise_rows"]

Array = NDArray[np.float32]
ZERO = np.float32(0)


@uncontracted
def raise_rows(out: Array, values: Array, local: Array, given: Array, height_m: Array, copies: bool) -> None:
    """Write a result from where each beam starts in the sensor's frame, as ``points_in_cloud_frame``.

    Args:
        out: ``(N, C)``, written.
        values: ``(N, C)`` the result.
        local: ``(N, C)`` what went in, likewise.
        given: ``(M, C)`` the same as it came, M <= N.
        height_m: ``(N,)`` at which each beam starts; ``(1,)`` of all.
        copies: whether ``out`` is not ``values``.
    """
    own = height_m.size > 1
    for row in range(values.shape[0]):
        x, y, z = values[row, 0], values[row, 1], values[row, 2]
        for column in range(values.shape[1] if copies else 0):
            out[row, column] = values[row, column]
        if x == local[row, 0] and y == local[row, 1] and z == local[row, 2]:
            out[row, 2] = given[row, 2] if row < given.shape[0] else ZERO
        elif x != ZERO or y != ZERO or z != ZERO:
            out[row, 2] = np.float32(np.float64(z) + np.float64(height_m[row if own else 0]))
        else:
            out[row, 2] = ZERO
