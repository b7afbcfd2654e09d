"""Compiled haze: streaky noise, tables over depth and the log-normal of every pixel, row after row.

The same formulas as ``haze.haze_depth``, in single precision and with polynomials for exp and ln. A row's arrays stay
in the cache.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from torchweather.camera.compiled_math import exp_of, log_of_sum
from torchweather.core.compiled import jit

__all__ = ["HazeAxis", "haze_rows"]

Array = NDArray[np.float32]


class HazeAxis(NamedTuple):
    """Axis of the tables over the footprint, and of the streaks.

    Args:
        scale: focal length, px.
        far_m: limit of the particles.
        low, step: ln of the first footprint, m/px, and the step of ln.
        longest: length of the longest ray per depth.
        slope: pixels aside for each along the streaks.
        steep: 1.0 where streaks run down the image, 0.0 across it.
    """

    scale: float
    far_m: float
    low: float
    step: float
    longest: float
    slope: float
    steep: float


ZERO, ONE, HALF = np.float32(0), np.float32(1), np.float32(0.5)
SMALL_DEPTH, FLOOR, LEAST = np.float32(1e-6), np.float32(1e-30), np.float32(1e-16)
FAINTEST_TAP = 1e-6  # of a kernel of unit energy; below it a tap is left out


@jit
def _add_shifted(out: Array, row: Array, shift: int, weight: np.float32) -> None:
    """Add ``weight`` times a row that repeats at its ends, read from ``shift`` on."""
    begin = shift % out.size
    _add(out[: out.size - begin], row[begin:], weight)
    _add(out[out.size - begin :], row[:begin], weight)


@jit
def _add(out: Array, row: Array, weight: np.float32) -> None:
    for at in range(out.size):
        out[at] += weight * row[at]


@jit
def _blend(shift: float) -> tuple[int, float, float]:
    """Whole pixels of a shift and the weights of the two neighbours, of equal energy."""
    whole = math.floor(shift)
    share = shift - whole
    energy = math.hypot(1.0 - share, share)
    return int(whole), (1.0 - share) / energy, share / energy


@jit
def _smooth_row(
    out: Array, spare: Array, noise: Array, along: Array, across: Array, row: int, slope: float, steep: float
) -> None:
    """One row of white noise ``(H, W)`` with the correlation of its shell's streaks."""
    height = noise.shape[0]
    spare[:] = 0
    out[:] = 0
    taps, taps_across = along.size // 2, across.size // 2
    if steep == 1.0:
        for tap in range(-taps, taps + 1):
            weight = along[tap + taps]
            if abs(weight) < FAINTEST_TAP:
                continue
            whole, near, far = _blend(tap * slope)
            _add_shifted(spare, noise[(row + tap) % height], whole, np.float32(weight * near))
            if far != 0.0:
                _add_shifted(spare, noise[(row + tap) % height], whole + 1, np.float32(weight * far))
        for tap in range(-taps_across, taps_across + 1):
            if abs(across[tap + taps_across]) >= FAINTEST_TAP:
                _add_shifted(out, spare, tap, across[tap + taps_across])
        return
    for tap_across in range(-taps_across, taps_across + 1):
        side = across[tap_across + taps_across]
        if abs(side) < FAINTEST_TAP:
            continue
        for tap in range(-taps, taps + 1):
            weight = along[tap + taps] * side
            if abs(along[tap + taps]) < FAINTEST_TAP:
                continue
            whole, near, far = _blend(tap * slope)
            _add_shifted(out, noise[(row + tap_across + whole) % height], tap, np.float32(weight * near))
            if far != 0.0:
                _add_shifted(out, noise[(row + tap_across + whole + 1) % height], tap, np.float32(weight * far))


@jit
def _tables_row(
    mean: Array, variance: Array, place: Array, depth_m: Array, mean_table: Array, variance_table: Array, axis: HazeAxis
) -> None:
    """Mean and variance in front of each pixel of a row, on the axis, and its place in the tables."""
    scale, far = np.float32(axis.scale), np.float32(axis.far_m)
    low, per_step = np.float32(axis.low), np.float32(1.0 / axis.step)
    last = np.float32(mean_table.size - 2)
    for at in range(place.size):
        foot = min(max(depth_m[at], SMALL_DEPTH), far) / scale
        place[at] = max((log_of_sum(ZERO, foot) - low) * per_step, ZERO)  # of nan: 0
    for at in range(place.size):
        cell = np.uint32(min(place[at], last))
        share = min(place[at] - np.float32(cell), ONE)
        mean[at] = (mean_table[cell] + share * (mean_table[cell + 1] - mean_table[cell])) * scale
        variance[at] = (variance_table[cell] + share * (variance_table[cell + 1] - variance_table[cell])) * scale


@jit
def _add_shell(deviation: Array, variance: Array, field: Array, low: np.float32, high: np.float32) -> None:
    """Add a shell's noise with the variance of its part in front of the scene."""
    for at in range(deviation.size):
        deviation[at] += np.sqrt(max(min(variance[at], high) - low, ZERO)) * field[at]


@jit
def _lognormal_row(out: Array, mean: Array, variance: Array, deviation: Array, ray: Array) -> None:
    """Optical depth of each pixel: log-normal of the mean, the variance and the deviation along its ray."""
    for at in range(out.size):
        m, v = mean[at] * ray[at], variance[at] * ray[at] * ray[at]
        there = m > LEAST and v > LEAST
        safe = v if there else ONE
        centre = (m if there else ONE) + HALF * safe
        spread = log_of_sum(ONE, safe / (centre * centre))
        power = np.sqrt(spread / safe) * (deviation[at] * ray[at]) - HALF * spread
        varied = centre * exp_of(power)
        out[at] = varied if there else m


@jit
def _faded_row(
    faded: Array, optical: Array, mean: Array, place: Array, ray: Array, clear: Array, axis: HazeAxis
) -> None:
    """Optical depth of each pixel of a row weighted with the mean transmission of the fog to its particles."""
    scale, top = np.float32(axis.scale), np.float32(clear.shape[0] - 1)
    last = np.float32(clear.shape[1] - 2)
    per_ray = top / max(np.float32(axis.longest) - ONE, SMALL_DEPTH)
    for at in range(faded.size):
        cell = np.uint32(min(place[at], last))
        share = min(place[at] - np.float32(cell), ONE)
        ray_place = min(max((ray[at] - ONE) * per_ray, ZERO), top)
        node = np.uint32(min(ray_place, top - ONE))
        beyond = ray_place - np.float32(node)
        near = clear[node, cell] + share * (clear[node, cell + 1] - clear[node, cell])
        far_low, far_high = clear[node + 1, cell], clear[node + 1, cell + 1]
        weight = near + beyond * (far_low + share * (far_high - far_low) - near)
        faded[at] = optical[at] * weight * scale / max(mean[at], FLOOR)


@jit
def haze_rows(
    optical: Array,
    faded: Array,
    noise: Array,
    depth_m: Array,
    ray: Array,
    mean_table: Array,
    variance_table: Array,
    clear_table: Array,
    along: Array,
    across: Array,
    lowest: Array,
    highest: Array,
    axis: HazeAxis,
    first: int,
) -> None:
    """Write the optical depth of the haze in some rows of one frame.

    Args:
        optical: ``(rows, W)``, written.
        faded: the same weighted with the fog's transmission, written; ``(0, 0)`` without fog.
        noise: ``(J, H, W)`` white noise of each shell of the haze.
        depth_m, ray: ``(rows, W)`` scene depth and length of ray per depth.
        mean_table, variance_table: ``(G,)`` over the footprint.
        clear_table: ``(N, G)`` haze per focal length weighted with the fog's transmission, for N lengths of ray.
        along, across: ``(J, taps)`` kernels.
        lowest, highest: ``(J,)`` variance in front of each shell and at its end.
        axis: numbers.
        first: row of the frame that ``optical`` begins with.
    """
    rows, width = optical.shape
    shells = noise.shape[0]
    field, spare, deviation = np.empty(width, np.float32), np.empty(width, np.float32), np.empty(width, np.float32)
    mean, variance, place = np.empty(width, np.float32), np.empty(width, np.float32), np.empty(width, np.float32)
    for row in range(rows):
        _tables_row(mean, variance, place, depth_m[row], mean_table, variance_table, axis)
        deviation[:] = 0
        for shell in range(shells):
            kernels = (along[shell], across[shell])
            _smooth_row(field, spare, noise[shell], *kernels, first + row, axis.slope, axis.steep)
            _add_shell(deviation, variance, field, lowest[shell], highest[shell])
        _lognormal_row(optical[row], mean, variance, deviation, ray[row])
        if faded.size > 0:
            _faded_row(faded[row], optical[row], mean, place, ray[row], clear_table, axis)
