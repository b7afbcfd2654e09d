"""Compiled look for the brightest spot of a mosaic and for the ground: the sums of ``airlight._brightest`` and of
``flake_light``, row after row."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from torchweather.core.compiled import jit

__all__ = ["brightest_cells", "light_of_ground"]

Array = NDArray[np.float32]

ZERO, ONE, ENDLESS = np.float32(0), np.float32(1), np.float32(np.inf)


@jit
def _add_three(out: Array, a: Array, b: Array, c: Array) -> None:
    for at in range(out.size):  # from slices: with at + 2 there would be no vectors
        out[at] = (a[at] + b[at]) + c[at]


@jit
def _raise_most(most: Array, sums: Array, share: np.float32) -> None:
    for at in range(most.size):
        most[at] = max(most[at], sums[at] * share)


@jit
def _sums_row(both: Array, signal: Array, row: int, spare: Array) -> int:
    """Sums over the 3 x 3 neighbours two apart of each pixel of a row, and how many rows they have."""
    height, width = signal.shape
    first, last = max(row - 2, row % 2), row + 2 if row + 2 < height else row
    if last == first + 4:
        _add_three(spare, signal[first], signal[first + 2], signal[last])
    else:
        for at in range(width):
            spare[at] = signal[first, at]
        for other in range(first + 2, last + 1, 2):
            for at in range(width):
                spare[at] += signal[other, at]
    _add_three(both[2 : width - 2], spare[: width - 4], spare[2 : width - 2], spare[4:])
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
        _raise_most(column_most[2 : width - 2], both[2 : width - 2], inner)
        for at in (0, 1, width - 2, width - 1):
            column_most[at] = max(column_most[at], both[at] * outer)
    found = np.empty((2, 2), np.float32)
    for y in range(2):
        for x in range(2):
            found[y, x] = most[y, x::2].max()
    return found


@jit
def light_of_ground(signal: Array, depth_m: Array, sky: Array, sine_elevation: Array, near: Array) -> Array:
    """Mean over all pixels of each plane on the ground, and of the share of ground itself, ``(C + 1,)``.

    Args:
        signal: ``(C, H, W)``.
        depth_m: ``(H, W)``; its endless pixels are the sky where ``sky`` is ``(0, 0)``.
        sky: ``(H, W)`` share of sky.
        sine_elevation: ``(H, W)``, below 0 on the ground.
        near: ``(H, W)`` share of the own vehicle; ``(0, 0)``: none.
    """
    planes, height, width = signal.shape
    sums, weight = np.zeros((planes + 1, width), np.float32), np.empty(width, np.float32)
    found = np.empty(planes + 1, np.float32)
    whole = sums[planes]
    for row in range(height):
        below = sine_elevation[row]
        if sky.size > 0:
            of_sky = sky[row]
            for at in range(width):
                weight[at] = (ONE if below[at] < ZERO else ZERO) * (ONE - of_sky[at])
        else:
            depth = depth_m[row]
            for at in range(width):
                weight[at] = (ONE if below[at] < ZERO else ZERO) * (ZERO if depth[at] == ENDLESS else ONE)
        if near.size > 0:
            vehicle = near[row]
            for at in range(width):
                weight[at] *= ONE - vehicle[at]
        for at in range(width):
            whole[at] += weight[at]
        for plane in range(planes):
            total, lit = sums[plane], signal[plane, row]
            for at in range(width):
                total[at] += weight[at] * lit[at]
    for plane in range(planes + 1):
        found[plane] = sums[plane].astype(np.float64).sum() / (height * width)
    return found
