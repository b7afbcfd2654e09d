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
from torchweather.core.compiled_philox import NORMALS_A_BLOCK, draw_normals

__all__ = ["HazeAxis", "HazeTables", "Noise", "Streaks", "Work", "haze_row", "haze_rows", "streaks_of", "work_of"]

Array = NDArray[np.float32]
Whole = NDArray[np.int64]


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


class Noise(NamedTuple):
    """White noise of the shells of the haze: numbers, or the key of their stream.

    Args:
        maps: ``(J, H, W)`` numbers; ``(0, 0, 0)``: by the key.
        key: ``(2,)`` of the stream.
        table: ``(65536,)`` of tabulated normals.
        height: H.
    """

    maps: Array
    key: NDArray[np.uint64]
    table: Array
    height: int


class Streaks(NamedTuple):
    """Taps of the streaks of every shell, and the rows of noise at hand; made by ``streaks_of``.

    Args:
        place, aside, weight, taps: taps along the streaks: pixels along, pixels aside, weight, and how many.
        place_across, weight_across, taps_across: taps across them.
        ring: ``(J, rows, W + 2 pad)`` rows of noise, wrapped at their ends.
        filled: ``(J,)`` first row that is not in the ring yet.
        spare: ``(1, W + 2 side)`` sums along the streaks.
        drawn, words: ``(W,)`` a row of noise, and spare words of its stream.
        which, begin, product: of each tap, its row in the ring, its first column and its weight.
        reach: rows of noise above and below a row that it takes.
        pad, side: columns beside the frame, of the ring and of the sums.
        steep: streaks run down the image.
    """

    place: Whole
    aside: Whole
    weight: Array
    taps: Whole
    place_across: Whole
    weight_across: Array
    taps_across: Whole
    ring: Array
    filled: Whole
    spare: Array
    drawn: Array
    words: NDArray[np.uint64]
    which: Whole
    begin: Whole
    product: Array
    reach: int
    pad: int
    side: int
    steep: bool


@jit
def _blend(shift: float) -> tuple[int, float, float]:
    """Whole pixels of a shift and the weights of the two neighbours, of equal energy."""
    whole = math.floor(shift)
    share = shift - whole
    energy = math.hypot(1.0 - share, share)
    return int(whole), (1.0 - share) / energy, share / energy


@jit
def _taps_of(kernels: Array, slope: float) -> tuple[Whole, Whole, Array, Whole]:
    """Taps of each shell's kernel ``(J, taps)``: place along it, pixels aside, weight, and how many there are."""
    shells, size = kernels.shape
    place, aside = np.zeros((shells, 2 * size), np.int64), np.zeros((shells, 2 * size), np.int64)
    weight, count = np.zeros((shells, 2 * size), np.float32), np.zeros(shells, np.int64)
    for shell in range(shells):
        for tap in range(-(size // 2), size // 2 + 1):
            whole_weight = kernels[shell, tap + size // 2]
            if abs(whole_weight) < FAINTEST_TAP:
                continue
            whole, near, far = _blend(tap * slope)
            for step, part in ((0, near), (1, far)):
                if part != 0.0:
                    at = count[shell]
                    place[shell, at], aside[shell, at] = tap, whole + step
                    weight[shell, at] = np.float32(whole_weight * part)
                    count[shell] += 1
    return place, aside, weight, count


@jit
def _clear(out: Array) -> None:
    for at in range(out.size):
        out[at] = ZERO


@jit
def _add_one(out: Array, row: Array, weight: np.float32) -> None:
    for at in range(out.size):
        out[at] += weight * row[at]


@jit
def _add_four(out: Array, a: Array, b: Array, c: Array, d: Array, weights: Array) -> None:
    of_a, of_b, of_c, of_d = weights[0], weights[1], weights[2], weights[3]
    for at in range(out.size):
        out[at] += (of_a * a[at] + of_b * b[at]) + (of_c * c[at] + of_d * d[at])


@jit
def _add_rows(out: Array, rows: Array, which: Whole, begin: Whole, weight: Array, count: int) -> None:
    """Add weighted rows, each from a column of its own on; four at a time, so that the sum is read less often."""
    size, at = out.size, 0
    while at + 4 <= count:
        a, b, c, d = begin[at], begin[at + 1], begin[at + 2], begin[at + 3]
        _add_four(
            out,
            rows[which[at], a : a + size],
            rows[which[at + 1], b : b + size],
            rows[which[at + 2], c : c + size],
            rows[which[at + 3], d : d + size],
            weight[at : at + 4],
        )
        at += 4
    while at < count:
        _add_one(out, rows[which[at], begin[at] : begin[at] + size], weight[at])
        at += 1


@jit
def _wrapped(out: Array, row: Array, pad: int) -> None:
    """A row that repeats at its ends, with ``pad`` more pixels on either side."""
    width = row.size
    middle = out[pad : pad + width]
    for at in range(width):
        middle[at] = row[at]
    for at in range(pad):
        out[at] = row[(at - pad) % width]
        out[pad + width + at] = row[at % width]


@jit
def _streaky_row(out: Array, noise: Noise, shell: int, row: int, streaks: Streaks) -> None:
    """One row of a shell's white noise ``(H, W)`` with the correlation of its streaks.

    The rows of noise that it needs are kept, wrapped at their ends, for the rows that follow.
    """
    height, pad, reach = noise.height, streaks.pad, streaks.reach
    ring, slots = streaks.ring[shell], streaks.ring.shape[1]
    for some in range(max(streaks.filled[shell], row - reach), row + reach + 1):
        whole = some % height
        if noise.maps.size > 0:
            _wrapped(ring[some % slots], noise.maps[shell, whole], pad)
        else:
            draw_normals(streaks.drawn, streaks.words, noise.key, noise.table, (shell * height + whole) * out.size)
            _wrapped(ring[some % slots], streaks.drawn, pad)
    streaks.filled[shell] = row + reach + 1
    side = streaks.side
    spare, count = streaks.spare, streaks.taps[shell]
    if streaks.steep:  # along the rows first, wide enough for the columns aside
        for tap in range(count):
            streaks.which[tap] = (row + streaks.place[shell, tap]) % slots
            streaks.begin[tap] = pad - side + streaks.aside[shell, tap]
        wide = spare[0]
        _clear(wide)
        _add_rows(wide, ring, streaks.which, streaks.begin, streaks.weight[shell], count)
        _clear(out)
        across = streaks.taps_across[shell]
        for tap in range(across):
            streaks.which[tap] = 0
            streaks.begin[tap] = side + streaks.place_across[shell, tap]
        _add_rows(out, spare, streaks.which, streaks.begin, streaks.weight_across[shell], across)
        return
    _clear(out)
    for tap_across in range(streaks.taps_across[shell]):
        lower = row + streaks.place_across[shell, tap_across]
        for tap in range(count):
            streaks.which[tap] = (lower + streaks.aside[shell, tap]) % slots
            streaks.begin[tap] = pad + streaks.place[shell, tap]
            streaks.product[tap] = streaks.weight[shell, tap] * streaks.weight_across[shell, tap_across]
        _add_rows(out, ring, streaks.which, streaks.begin, streaks.product, count)


@jit
def streaks_of(along: Array, across: Array, width: int, slope: float, steep: float) -> Streaks:
    """Taps and rows at hand of every shell.

    Args:
        along, across: ``(J, taps)`` kernels.
        width: of the frame.
        slope, steep: of ``HazeAxis``.
    """
    place, aside, weight, count = _taps_of(along, slope)
    place_across, _, weight_across, count_across = _taps_of(across, 0.0)
    far, far_aside, side = np.abs(place).max(), np.abs(aside).max(), np.abs(place_across).max()
    down = steep == 1.0
    reach, pad = (far, far_aside + side) if down else (far_aside + side, far)
    shells, most = along.shape[0], 2 * max(along.shape[1], across.shape[1])
    ring = np.empty((shells, 2 * reach + 1, width + 2 * pad), np.float32)
    filled, spare = np.full(shells, -(1 << 40)), np.empty((1, width + 2 * side), np.float32)
    which, begin, product = np.zeros(most, np.int64), np.zeros(most, np.int64), np.zeros(most, np.float32)
    return Streaks(
        place,
        aside,
        weight,
        count,
        place_across,
        weight_across,
        count_across,
        ring,
        filled,
        spare,
        np.empty(width, np.float32),
        np.empty(4 * (width // NORMALS_A_BLOCK + 2), np.uint64),
        which,
        begin,
        product,
        reach,
        pad,
        side,
        down,
    )


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


class HazeTables(NamedTuple):
    """Tables of the haze of one sample.

    Args:
        mean, variance: ``(G,)`` over the footprint.
        along, across: ``(J, taps)`` kernels of each shell.
        lowest, highest: ``(J,)`` variance in front of each shell and at its end.
    """

    mean: Array
    variance: Array
    along: Array
    across: Array
    lowest: Array
    highest: Array


class Work(NamedTuple):
    """Arrays of one row, ``(W,)``; made by ``work_of``."""

    field: Array
    deviation: Array
    mean: Array
    variance: Array
    place: Array


@jit
def work_of(width: int) -> Work:
    """Arrays for rows of a width."""
    rows = np.empty((5, width), np.float32)
    return Work(rows[0], rows[1], rows[2], rows[3], rows[4])


@jit
def haze_row(
    optical: Array,
    noise: Noise,
    depth_m: Array,
    ray: Array,
    tables: HazeTables,
    axis: HazeAxis,
    streaks: Streaks,
    work: Work,
    row: int,
) -> None:
    """Write the optical depth of the haze in one row of a frame; mean and place in the tables stay in ``work``.

    Args:
        optical: ``(W,)``, written.
        noise: of each shell of the haze.
        depth_m, ray: ``(W,)`` scene depth and length of ray per depth.
        tables, axis, streaks: of the sample.
        work: written.
        row: of the frame.
    """
    _tables_row(work.mean, work.variance, work.place, depth_m, tables.mean, tables.variance, axis)
    _clear(work.deviation)
    most = work.variance.max()
    for shell in range(tables.lowest.size):
        if most > tables.lowest[shell]:  # nowhere else does a shell in this row reach into the air before the scene
            _streaky_row(work.field, noise, shell, row, streaks)
            _add_shell(work.deviation, work.variance, work.field, tables.lowest[shell], tables.highest[shell])
    _lognormal_row(optical, work.mean, work.variance, work.deviation, ray)


@jit
def haze_rows(
    optical: Array,
    faded: Array,
    noise: Noise,
    depth_m: Array,
    ray: Array,
    clear_table: Array,
    tables: HazeTables,
    axis: HazeAxis,
    first: int,
) -> None:
    """Write the optical depth of the haze in some rows of one frame.

    Args:
        optical: ``(rows, W)``, written.
        faded: the same weighted with the fog's transmission, written; ``(0, 0)`` without fog.
        noise: of each shell of the haze.
        depth_m, ray: ``(rows, W)`` scene depth and length of ray per depth.
        clear_table: ``(N, G)`` haze per focal length weighted with the fog's transmission, for N lengths of ray.
        tables, axis: of the sample.
        first: row of the frame that ``optical`` begins with.
    """
    rows, width = optical.shape
    streaks, work = streaks_of(tables.along, tables.across, width, axis.slope, axis.steep), work_of(width)
    for row in range(rows):
        haze_row(optical[row], noise, depth_m[row], ray[row], tables, axis, streaks, work, first + row)
        if faded.size > 0:
            _faded_row(faded[row], optical[row], work.mean, work.place, ray[row], clear_table, axis)
