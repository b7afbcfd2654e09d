"""Compiled veil: haze, marks and colour of one kind of particles, row after row of the frame.

What ``ParticleVeil`` does in bands with an array after each operation, for particles without fog and lamps.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from torchweather.camera.compiled_math import blend_row, covered_share
from torchweather.camera.particles.compiled_haze import HazeAxis, HazeTables, Noise, haze_row, streaks_of, work_of
from torchweather.core.compiled import jit

__all__ = ["veil_rows"]

Array = NDArray[np.float32]

ONE = np.float32(1)
ROWS_AT_ONCE = 16  # of the sums, which hold one column after the other: a line of the cache


@jit
def _cover_row(covered: Array, optical: Array, sharp: Array, near: Array) -> None:
    """Covered share of the exposure behind haze and marks; nothing falls before the own vehicle."""
    for at in range(covered.size):
        covered[at] = covered_share(optical[at] + sharp[at])
    for at in range(near.size):
        covered[at] *= ONE - near[at]


@jit
def veil_rows(
    out: Array,
    mask: Array,
    signal: Array,
    sharp: Array,
    light: Array,
    near: Array,
    noise: Noise,
    depth_m: Array,
    ray: Array,
    tables: HazeTables,
    axis: HazeAxis,
    first: int,
    last: int,
) -> None:
    """Write the rows ``first..last`` of one frame behind its particles.

    Args:
        out: ``(C, H, W)``, written.
        mask: ``(H, W)`` covered share of the exposure, written; ``(0, 0)``: not wanted.
        signal: ``(C, H, W)`` of the clear frame.
        sharp: ``(W, H)`` optical depth of the marks, one column after the other.
        light: ``(C, 2, W)`` colour of the particles at the pixels of even and odd rows.
        near: ``(H, W)`` share of the own vehicle; ``(0, 0)``: none.
        noise, depth_m, ray, tables, axis: of the haze, as ``haze_rows`` takes them, of the whole frame.
        first, last: rows.
    """
    planes, _, width = out.shape
    streaks = streaks_of(tables.along, tables.across, width, axis.slope, axis.steep)
    work = work_of(width)
    optical, covered = np.empty(width, np.float32), np.empty(width, np.float32)
    block = np.empty((ROWS_AT_ONCE, width), np.float32)
    for row in range(first, last):
        within = (row - first) % ROWS_AT_ONCE
        if within == 0:
            rows = min(ROWS_AT_ONCE, last - row)
            for column in range(width):
                for some in range(rows):
                    block[some, column] = sharp[column, row + some]
        haze_row(optical, noise, depth_m[row], ray[row], tables, axis, streaks, work, row)
        _cover_row(covered, optical, block[within], near[row] if near.size > 0 else near.ravel())
        for plane in range(planes):
            blend_row(out[plane, row], signal[plane, row], light[plane, row % 2], covered)
        if mask.size > 0:
            for at in range(width):
                mask[row, at] = covered[at]
