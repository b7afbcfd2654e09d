"""Compiled sums of a LiDAR frame: what became of each stable beam, and its sums over bins, in one pass over the beams.

The same values as ``LidarSums`` has by torch, with polynomials for ln (relative error below 2e-7) and sums in double
precision. A beam is added up once, in the cell of all beams that have the same bins along all axes; the sums of cells
are then those of their bins.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from torchweather.core.compiled import jit
from torchweather.core.compiled_math import log_of_sum

__all__ = ["Cells", "ParticleBins", "Surfaces", "cells_of", "count_beams", "sum_frame", "sum_particles"]

Array = NDArray[np.float32]
Places = NDArray[np.int32]

ZERO, ONE = np.float32(0), np.float32(1)
LOST, BEFORE, BEYOND, DARK, BRIGHT = (np.int8(kind) for kind in range(5))  # the last two see the surface


class Cells(NamedTuple):
    """Beams by the bins that they lie in along several axes.

    Args:
        of_beam: ``(S,)`` the cell of each beam.
        bins: ``(axes, cells)`` places of each cell's bins among the sums, -1 outside.
    """

    of_beam: Places
    bins: Places


def cells_of(places: Places) -> Cells:
    """Cells of beams with places ``(axes, S)`` of their bins.

    Example:
        >>> cells_of(np.array([[0, 1, 0], [4, 4, 4]], np.int32)).of_beam.tolist()
        [0, 1, 0]
    """
    bins, of_beam = np.unique(places, axis=1, return_inverse=True)
    return Cells(of_beam.reshape(-1).astype(np.int32), np.ascontiguousarray(bins, dtype=np.int32))


class Surfaces(NamedTuple):
    """The stable beams of a scene, S of them, and what a frame is compared with.

    Args:
        beam: ``(S,)`` their places among all beams.
        range_m, intensity: ``(S,)`` of the reference.
        by_reference: their bins along axes that follow the reference.
        by_beam: their bins along axes that belong to the beam.
        range_bin: ``(S,)`` of the former, that of range, -1 outside: intensities spread about their middle in it.
        tolerance_m: how near to the reference a return is the surface's.
        noise_m, reading_noise: standard deviations of the range and of ln(intensity) of clear frames.
        faintest: intensity, at least.
        far_out: clear air's standard deviations; for the middle of its bin a reading beyond counts as lying there.
    """

    beam: Places
    range_m: Array
    intensity: Array
    by_reference: Cells
    by_beam: Cells
    range_bin: Places
    tolerance_m: np.float32
    noise_m: np.float32
    reading_noise: np.float32
    faintest: np.float32
    far_out: np.float32


class ParticleBins(NamedTuple):
    """Axes along which the particles of a frame are counted.

    Args:
        stable, empty: places of the beams that see a surface in clear air, and of those that see nothing.
        bin, ring: ``(ticks,)`` bin of a range, and ring of the map.
        sector: ``(N,)`` of the map, of each beam.
        rings: of the map.
        ticks_per_m: of a range.
        rows, columns: of the scan.
        within_m: of a neighbour's range, that makes a cluster.
        faintest: intensity, at least.
    """

    stable: Places
    empty: Places
    bin: Places
    ring: Places
    sector: Places
    rings: int
    ticks_per_m: int
    rows: int
    columns: int
    within_m: np.float32
    faintest: float


@jit
def sum_frame(
    of_reference: NDArray[np.float64],
    of_beam: NDArray[np.float64],
    before: NDArray[np.bool_],
    range_m: Array,
    intensity: Array,
    surfaces: Surfaces,
) -> None:
    """Add up one frame.

    Args:
        of_reference: ``(bins, 12)``, written: lost, before, beyond, dark, ratio, ratio2, apart, apart2, wide, wide2,
            even, even2, as in ``sums.py``.
        of_beam: ``(bins, 6)``, written: the first six of these.
        before: ``(S,)``, written: beams that see a particle.
        range_m, intensity: ``(N,)`` of the frame, 0 where no return.
        surfaces: of the scene.
    """
    count = surfaces.beam.size
    kinds = np.empty(count, np.int8)
    aparts, ratios, wides, evens = (
        np.empty(count, np.float32),
        np.empty(count, np.float32),
        np.empty(count, np.float32),
        np.empty(count, np.float32),
    )
    _look(kinds, aparts, ratios, range_m, intensity, surfaces)
    apart_sum, same = 0.0, 0
    for at in range(count):
        before[at] = kinds[at] == BEFORE
        if kinds[at] >= DARK:
            apart_sum += aparts[at]
            same += 1
    middle = _middles(kinds, ratios, of_reference.shape[0], surfaces)
    _spread(wides, aparts, np.float32(apart_sum / max(same, 1)), surfaces.noise_m)
    _spread_by_range(evens, ratios, middle, surfaces)
    # Columns as those of the two results.
    cells = np.zeros((surfaces.by_reference.bins.shape[1], of_reference.shape[1]))
    others = np.zeros((surfaces.by_beam.bins.shape[1], of_beam.shape[1]))
    for at in range(count):
        kind, cell, other = kinds[at], surfaces.by_reference.of_beam[at], surfaces.by_beam.of_beam[at]
        if kind < DARK:
            cells[cell, kind] += 1.0
            others[other, kind] += 1.0
            continue
        apart, wide = np.float64(aparts[at]), np.float64(wides[at])
        cells[cell, 6] += apart
        cells[cell, 7] += apart * apart
        cells[cell, 8] += wide
        cells[cell, 9] += wide * wide
        if kind == DARK:
            cells[cell, 3] += 1.0
            others[other, 3] += 1.0
            continue
        ratio, even = np.float64(ratios[at]), np.float64(evens[at])
        cells[cell, 4] += ratio
        cells[cell, 5] += ratio * ratio
        cells[cell, 10] += even
        cells[cell, 11] += even * even
        others[other, 4] += ratio
        others[other, 5] += ratio * ratio
    _into_bins(of_reference, cells, surfaces.by_reference.bins)
    _into_bins(of_beam, others, surfaces.by_beam.bins)


@jit
def _look(
    kinds: NDArray[np.int8], aparts: Array, ratios: Array, range_m: Array, intensity: Array, of: Surfaces
) -> None:
    """Kind of what each stable beam sees, how far behind its surface, and ln of the intensity over its: all written."""
    for at in range(of.beam.size):
        seen_m, level = range_m[of.beam[at]], intensity[of.beam[at]]
        apart = seen_m - of.range_m[at]
        kind = DARK if level <= ZERO else BRIGHT
        kind = BEFORE if apart <= -of.tolerance_m else (BEYOND if apart >= of.tolerance_m else kind)
        kinds[at], aparts[at] = kind if seen_m > ZERO else LOST, apart
        ratios[at] = log_of_sum(ZERO, max(level, of.faintest) / of.intensity[at])


@jit
def _middles(kinds: NDArray[np.int8], ratios: Array, bins: int, of: Surfaces) -> Array:
    """Middle of the ratios in each bin of range: one step of Huber's estimate from their mean."""
    bright, summed, step = np.zeros(bins, np.int32), np.zeros(bins), np.zeros(bins)
    for at in range(kinds.size):
        place = of.range_bin[at]
        if kinds[at] == BRIGHT and place >= 0:
            summed[place] += ratios[at]
            bright[place] += 1
    middle = (summed / np.maximum(bright, 1)).astype(np.float32)
    farthest = of.far_out * of.reading_noise
    for at in range(kinds.size):
        place = of.range_bin[at]
        if kinds[at] == BRIGHT and place >= 0:
            step[place] += min(max(ratios[at] - middle[place], -farthest), farthest)
    return middle + (step / np.maximum(bright, 1)).astype(np.float32)


@jit
def _spread(out: Array, values: Array, middle: np.float32, one: np.float32) -> None:
    """``ln(1 + square)`` of departures from a middle, in so large units: written."""
    for at in range(values.size):
        away = (values[at] - middle) / one
        out[at] = log_of_sum(ONE, away * away)


@jit
def _spread_by_range(out: Array, ratios: Array, middle: Array, of: Surfaces) -> None:
    """The same of the ratios, from the middle of their bin of range."""
    for at in range(ratios.size):
        away = (ratios[at] - middle[max(of.range_bin[at], 0)]) / of.reading_noise
        out[at] = log_of_sum(ONE, away * away)


@jit
def _into_bins(sums: NDArray[np.float64], cells: NDArray[np.float64], bins: Places) -> None:
    """Add sums of cells ``(cells, columns)`` up in their bins."""
    for axis in range(bins.shape[0]):
        for cell in range(bins.shape[1]):
            place = bins[axis, cell]
            if place >= 0:
                for column in range(cells.shape[1]):
                    sums[place, column] += cells[cell, column]


@jit
def count_beams(number: NDArray[np.float64], which: NDArray[np.bool_], by_beam: Cells) -> None:
    """Number of some beams ``(S,)`` in each bin ``(bins,)``: written."""
    cells = np.zeros((by_beam.bins.shape[1], 1))
    for at in range(which.size):
        if which[at]:
            cells[by_beam.of_beam[at], 0] += 1.0
    _into_bins(number.reshape(-1, 1), cells, by_beam.bins)


@jit
def _has_neighbour(range_m: Array, beam: int, bins: ParticleBins) -> bool:
    """True where one of the eight neighbours of a return has nearly its range; as ``has_neighbour``."""
    row, column, own_m = beam // bins.columns, beam % bins.columns, range_m[beam]
    for up in range(-1, 2):
        beside_row = row + up
        if beside_row < 0 or beside_row >= bins.rows:
            continue
        for aside in range(-1, 2):
            if up == 0 and (aside == 0 or bins.columns == 1):
                continue
            other_m = range_m[beside_row * bins.columns + (column + aside) % bins.columns]
            if other_m > ZERO and abs(other_m - own_m) < bins.within_m:
                return True
    return False


@jit
def _add_particle(
    sums: NDArray[np.float64],
    maps: NDArray[np.float64],
    range_m: Array,
    intensity: Array,
    beam: int,
    is_before: bool,
    bins: ParticleBins,
) -> None:
    tick = min(int(range_m[beam] * np.float32(bins.ticks_per_m)), bins.bin.size - 1)
    place = bins.bin[tick]
    sums[1 if is_before else 2, place] += 1.0
    sums[3, place] += 1.0
    if _has_neighbour(range_m, beam, bins):
        sums[4, place] += 1.0
    if intensity[beam] > ZERO:
        level = np.log(max(np.float64(intensity[beam]), bins.faintest))
        sums[5, place] += 1.0
        sums[7, place] += level
        sums[8, place] += level * level
    else:
        sums[6, place] += 1.0
    maps[bins.sector[beam] * bins.rings + bins.ring[tick]] += 1.0


@jit
def sum_particles(
    sums: NDArray[np.float64],
    maps: NDArray[np.float64],
    range_m: Array,
    intensity: Array,
    before: NDArray[np.bool_],
    of_empty: NDArray[np.bool_],
    bins: ParticleBins,
) -> None:
    """Add up the particles of one frame.

    Args:
        sums: ``(9, bins)``, written: frame, before, of_empty, particle, clustered, bright_particle, dark_particle,
            level, level2, as in ``sums.py``.
        maps: ``(cells,)``, written: their number.
        range_m, intensity: ``(N,)`` of the frame, 0 where no return.
        before, of_empty: stable beams, and empty ones, that see a particle.
        bins: along which they are counted.
    """
    for place in range(sums.shape[1]):
        sums[0, place] = 1.0
    for at in range(before.size):
        if before[at]:
            _add_particle(sums, maps, range_m, intensity, bins.stable[at], True, bins)
    for at in range(of_empty.size):
        if of_empty[at]:
            _add_particle(sums, maps, range_m, intensity, bins.empty[at], False, bins)
