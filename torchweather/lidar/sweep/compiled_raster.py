"""Compiled search for the nearest returns about each beam of a raster; the bits of ``SweepRaster.neighbours``."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from torchweather.core.compiled import uncontracted

__all__ = ["nearest_returns"]

Numbers = NDArray[np.float64]


@uncontracted
def nearest_returns(
    range_m: Numbers,
    raised: NDArray[np.bool_],
    elevation_deg: Numbers,
    row: NDArray[np.intp],
    column: NDArray[np.intp],
    step_deg: float,
    most_azimuth_deg: float,
    most_elevation_deg: float,
    found: tuple[Numbers, Numbers, NDArray[Any]],
) -> None:
    """Write range, angle and whether it is raised of the nearest return to the left, right, above and below.

    Args:
        range_m: ``(rows, columns)`` of the nearest return in each cell, ``inf`` where there is none.
        raised: ``(rows, columns)`` whether it lies above the ground.
        elevation_deg: ``(rows,)``.
        row: ``(M,)`` of the beams, ``column`` likewise.
        column: see ``row``.
        step_deg: width of a column.
        most_azimuth_deg: farthest to the sides.
        most_elevation_deg: farthest up and down.
        found: ``(4, M)`` each, written: range and angle, ``inf`` where none is near enough, and raised.
    """
    rows, columns = range_m.shape
    none = 4 * columns
    after = np.empty((rows, columns), np.int32)  # columns to the next return, round the turn
    before = np.empty((rows, columns), np.int32)
    under = np.empty((rows, columns), np.int32)  # row of the next return, -1 for none
    over = np.empty((rows, columns), np.int32)
    for r in range(rows):
        last = -none
        for c in range(2 * columns):
            at = c - columns if c >= columns else c
            if range_m[r, at] < np.inf:
                last = c
            if c >= columns:
                before[r, at] = min(c - last, none)
        last = none + 2 * columns
        for c in range(2 * columns - 1, -1, -1):
            at = c - columns if c >= columns else c
            if range_m[r, at] < np.inf:
                last = c
            if c < columns:
                after[r, at] = min(last - c, none)
        for c in range(columns):
            under[r, c] = r if range_m[r, c] < np.inf else (under[r - 1, c] if r > 0 else -1)
    for r in range(rows - 1, -1, -1):
        for c in range(columns):
            over[r, c] = r if range_m[r, c] < np.inf else (over[r + 1, c] if r + 1 < rows else -1)
    ranges, angles, flags = found
    for beam in range(len(row)):
        r, c = row[beam], column[beam]
        for side in range(2):
            step = after[r, c] if side == 0 else before[r, c]
            angle = step * step_deg
            near = step <= columns and angle <= most_azimuth_deg
            at = (c + step) % columns if side == 0 else (c - step) % columns
            ranges[side, beam] = range_m[r, at] if near else np.inf
            angles[side, beam] = angle if near else np.inf
            flags[side, beam] = near and raised[r, at]
        for side in range(2):
            other = over[r, c] if side == 0 else under[r, c]
            place = max(other, 0)
            angle = abs(elevation_deg[place] - elevation_deg[r])
            near = other >= 0 and angle <= most_elevation_deg
            ranges[2 + side, beam] = range_m[place, c] if near else np.inf
            angles[2 + side, beam] = angle if near else np.inf
            flags[2 + side, beam] = near and raised[place, c]
