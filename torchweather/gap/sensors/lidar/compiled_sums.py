"""Compiled sums of a LiDAR frame: what became of each stable beam, and its sums over bins, in one pass over the beams.

The same values as ``LidarSums`` has by torch, with polynomials for ln (relative error below 2e-7) and sums in double
precision.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from torchweather.core.compiled import jit
from torchweather.core.compiled_math import log_of_sum

__all__ = ["ParticleBins", "Surfaces", "sum_frame", "sum_particles"]

Array = NDArray[np.float32]
Places = NDArray[np.int32]

ZERO, ONE = np.float32(0), np.float32(1)


class Surfaces(NamedTuple):
    """The stable beams of a scene, S of them, and what a frame is compared with.

    Args:
        beam: ``(S,)`` their places among all beams.
        range_m, intensity: ``(S,)`` of the reference.
        of_reference: ``(axes, S)`` places of their bins along axes that follow the reference, -1 outside.
        of_beam: ``(axes, S)`` places of their bins along axes that belong to the beam, -1 outside.
        range_axis: which of the former is that of range: intensities spread about their middle in its bins.
        tolerance_m: how near to the reference a return is the surface's.
        noise_m, reading_noise: standard deviations of the range and of ln(intensity) of clear frames.
        faintest: intensity, at least.
        far_out: clear air's standard deviations; for the middle of its bin a reading beyond counts as lying there.
    """

    beam: Places
    range_m: Array
    intensity: Array
    of_reference: Places
    of_beam: Places
    range_axis: int
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
    kinds = np.empty(count, np.int8)  # 0 lost, 1 before, 2 beyond, 3 the same without intensity, 4 with
    aparts, ratios = np.empty(count, np.float32), np.empty(count, np.float32)
    apart_sum, same = 0.0, 0
    bins = of_reference.shape[0]
    bright, ratio_sum = np.zeros(bins, np.int32), np.zeros(bins)
    for at in range(count):
        seen_m, level = range_m[surfaces.beam[at]], intensity[surfaces.beam[at]]
        apart = seen_m - surfaces.range_m[at]
        kind = np.int8(0)
        if seen_m > ZERO:
            if apart <= -surfaces.tolerance_m:
                kind = np.int8(1)
            elif apart >= surfaces.tolerance_m:
                kind = np.int8(2)
            else:
                kind = np.int8(4 if level > ZERO else 3)
                apart_sum += apart
                same += 1
        if kind == 4:
            ratios[at] = log_of_sum(ZERO, max(level, surfaces.faintest) / surfaces.intensity[at])
            place = surfaces.of_reference[surfaces.range_axis, at]
            if place >= 0:
                ratio_sum[place] += ratios[at]
                bright[place] += 1
        kinds[at], aparts[at] = kind, apart
        before[at] = kind == 1
    common_m = np.float32(apart_sum / max(same, 1))
    centre = (ratio_sum / np.maximum(bright, 1)).astype(np.float32)
    farthest, step = surfaces.far_out * surfaces.reading_noise, np.zeros(bins)
    for at in range(count):
        place = surfaces.of_reference[surfaces.range_axis, at]
        if kinds[at] == 4 and place >= 0:
            step[place] += min(max(ratios[at] - centre[place], -farthest), farthest)
    centre += (step / np.maximum(bright, 1)).astype(np.float32)
    for at in range(count):
        kind = kinds[at]
        if kind < 3:
            for axis in range(surfaces.of_reference.shape[0]):
                place = surfaces.of_reference[axis, at]
                if place >= 0:
                    of_reference[place, kind] += 1.0
            for axis in range(surfaces.of_beam.shape[0]):
                place = surfaces.of_beam[axis, at]
                if place >= 0:
                    of_beam[place, kind] += 1.0
            continue
        apart = aparts[at]
        away = (apart - common_m) / surfaces.noise_m
        wide = log_of_sum(ONE, away * away)
        dark, ratio, even = ONE, ZERO, ZERO
        if kind == 4:
            dark, ratio = ZERO, ratios[at]
            place = surfaces.of_reference[surfaces.range_axis, at]
            if place >= 0:
                off = (ratio - centre[place]) / surfaces.reading_noise
                even = log_of_sum(ONE, off * off)
        for axis in range(surfaces.of_reference.shape[0]):
            place = surfaces.of_reference[axis, at]
            if place >= 0:
                row = of_reference[place]
                row[3] += dark
                row[4] += ratio
                row[5] += ratio * ratio
                row[6] += apart
                row[7] += apart * apart
                row[8] += wide
                row[9] += wide * wide
                row[10] += even
                row[11] += even * even
        for axis in range(surfaces.of_beam.shape[0]):
            place = surfaces.of_beam[axis, at]
            if place >= 0:
                row = of_beam[place]
                row[3] += dark
                row[4] += ratio
                row[5] += ratio * ratio


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
