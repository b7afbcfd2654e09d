"""Echoes of a LiDAR beam in rain or snow, every single particle of the beam's cone drawn; and their expected number.

The slow, readable oracle of the LiDAR's particle returns: no table in energy or range, no strongest-particle law.
It shares no line with ``torchweather``, so the two can only agree by being right. Three parts:

- ``every_particle`` draws the particles of many beams, ``chosen`` says what the sensor reports of them;
- ``lambda_by_quadrature`` integrates the expected number of echoes above an energy, without random numbers.

A particle of optical diameter ``D`` at range ``r`` in a beam of diameter ``D_b(r) = d0 + theta r`` returns, over the
system constant ``K`` and in 1/(m^2 sr),

``X = bracket_full min(1, (D / D_b)^2) exp(-2 alpha_eff r) xi(r) / r^2``,

with ``bracket_full = Q_back / (4 pi)`` for drops (``D^2 Q_back / (16 A_b)`` when they are smaller than the beam) and
``rho_s / pi`` for flakes, whose optical diameter is the physical, not the melted one. To it adds the mean of what all
smaller ones within the same pulse return, ``bracket_full exp(-2 alpha_eff r) xi(r) / r^2 (pi/4) l int_0^D N D'^2 dD'``
with ``l = c tau / 2``. ``summed_in_pulses`` adds them one by one instead, as the receiver does.

References: PHYSICS.md 2.2 (rain), 2.4 (snow), 3.2 (effective extinction), 5.2, 5.3, 5.5, 5.9 (LiDAR), 10.4 (pulses).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import brentq

from tests.reference.every_particle import Population

__all__ = [
    "LOST",
    "OBJECT",
    "PARTICLE",
    "Chosen",
    "Echoes",
    "Link",
    "Medium",
    "chosen",
    "every_particle",
    "lambda_by_quadrature",
    "object_signal",
    "summed_in_pulses",
]

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
ReturnMode = Literal["strongest", "first", "last", "dual"]

OBJECT, PARTICLE, LOST = 0, 1, 2  # the numbers of PointKind, DESIGN.md 3
SLAB_RATIO = 1.05  # far end over near end of a slab; only sets how many particles are drawn in vain
SIZE_NODES = 4001  # of the sum over smaller particles
NODES = 40  # Gauss-Legendre nodes of each smooth piece


@dataclass(frozen=True)
class Link:
    """One LiDAR: its beam, its calibration and its near-range response. Lengths in metres."""

    exit_diameter_m: float
    divergence_rad: float  # full angle
    range_at_10_percent_m: float
    near_start_m: float = 2.0
    near_full_m: float = 10.0
    near_power: float = 1.0
    min_range_m: float = 0.0
    max_range_m: float = 120.0
    echo_separation_m: float = 1.5
    pulse_length_m: float = 0.0  # c tau / 2; 0: every particle returns alone

    @property
    def threshold(self) -> float:
        """Smallest signal that is detected: that of a 10 % Lambertian target at its range, 1/(m^2 sr)."""
        return 0.1 / (math.pi * self.range_at_10_percent_m**2)

    @property
    def particles_from_m(self) -> float:
        """Nearest range from which a particle is reported."""
        return max(self.near_start_m, self.min_range_m)

    def beam_diameter_m(self, range_m: Array) -> Array:
        return self.exit_diameter_m + self.divergence_rad * range_m

    def volume_m3(self, range_m: ArrayLike) -> Array:
        """Volume of the cone from the sensor to ``range_m``: the integral of its cross-section."""
        wide = self.beam_diameter_m(np.asarray(range_m, dtype=np.float64))
        return math.pi / (12.0 * self.divergence_rad) * (wide**3 - self.exit_diameter_m**3)

    def range_of_volume_m(self, volume_m3: Array) -> Array:
        """The range to which the cone has this volume."""
        wide = np.cbrt(volume_m3 * 12.0 * self.divergence_rad / math.pi + self.exit_diameter_m**3)
        return (wide - self.exit_diameter_m) / self.divergence_rad

    def near_response(self, range_m: Array) -> Array:
        ramp = (range_m - self.near_start_m) / (self.near_full_m - self.near_start_m)
        return np.clip(ramp, 0.0, 1.0) ** self.near_power


@dataclass(frozen=True)
class Medium:
    """Rain or snow as one LiDAR meets it: sizes, brightness of a particle that fills the beam, extinction."""

    sizes: Population
    q_back: float = 0.2  # rain: backscatter efficiency of a drop, PHYSICS.md 3.2
    flake_reflectivity: float = 0.9  # snow: Lambertian, PHYSICS.md 5.9
    extinction_per_m: float = 0.0  # alpha_eff = alpha q_eff / 2, one way

    @property
    def full_bracket_per_sr(self) -> float:
        """Brightness of a particle that fills the beam, 1/sr."""
        return self.q_back / (4.0 * math.pi) if self.sizes.kind == "rain" else self.flake_reflectivity / math.pi

    @property
    def largest_optical_m(self) -> float:
        return float(self.sizes.optical_diameters_mm(np.array(self.sizes.largest_mm))) * 1e-3

    def counted_diameter_mm(self, optical_m: Array) -> Array:
        """The diameter that the size distribution counts, of a particle of this optical diameter."""
        optical_mm = optical_m * 1e3
        if self.sizes.kind == "rain":
            return optical_mm
        return np.minimum((optical_mm / 2.2947) ** (1.0 / 1.4437), optical_mm / 1.0293)  # inverse of PHYSICS.md 2.4

    def larger_per_m3(self, optical_m: Array) -> Array:
        """Particles per cubic metre with an optical diameter above ``optical_m``."""
        lowest = np.clip(self.counted_diameter_mm(optical_m), self.sizes.smallest_mm, self.sizes.largest_mm)
        ends = np.exp(-self.sizes.slope_per_mm * lowest) - math.exp(-self.sizes.slope_per_mm * self.sizes.largest_mm)
        return self.sizes.n0_per_m3_mm / self.sizes.slope_per_mm * ends

    @cached_property
    def _smaller(self) -> tuple[Array, Array]:
        """Optical diameters, m, and ``int_0^D N D'^2 dD'``, m^2/m^3, by the trapezoid rule over ln of the counted."""
        counted_mm = np.geomspace(self.sizes.smallest_mm, self.sizes.largest_mm, SIZE_NODES)
        optical_m = self.sizes.optical_diameters_mm(counted_mm) * 1e-3
        density = self.sizes.n0_per_m3_mm * np.exp(-self.sizes.slope_per_mm * counted_mm) * counted_mm
        values = density * optical_m**2
        steps = 0.5 * (values[1:] + values[:-1]) * math.log(counted_mm[1] / counted_mm[0])
        return optical_m, np.concatenate([[0.0], np.cumsum(steps)])

    def share_of_full(self, optical_m: Array, beam_m: Array, pulse_length_m: float) -> Array:
        """What a particle returns with the others of its pulse, over the signal of one that fills the beam."""
        inside = np.minimum(optical_m, beam_m)
        others = np.interp(inside, *self._smaller) if pulse_length_m else np.zeros_like(inside)
        return (inside / beam_m) ** 2 + math.pi / 4.0 * pulse_length_m * others

    def needed_m(self, share: Array, beam_m: Array, pulse_length_m: float) -> Array:
        """The optical diameter whose particle returns a share of the full beam's signal; infinite where none does."""
        if pulse_length_m == 0.0:
            with np.errstate(divide="ignore"):
                needed = beam_m * np.sqrt(share)
            return np.where(needed < beam_m, needed, np.inf)
        grid = self._smaller[0]
        share, beam = np.broadcast_arrays(share, beam_m)
        found = np.empty(share.shape)
        for place in np.ndindex(share.shape):
            values = self.share_of_full(grid, beam[place], pulse_length_m)
            wanted = float(share[place])
            if wanted >= values[-1]:
                found[place] = np.inf
            elif wanted <= values[0]:  # none of the smaller ones add to it
                found[place] = beam[place] * math.sqrt(wanted)
            else:
                found[place] = np.interp(wanted, values, grid)
        return found


@dataclass(frozen=True)
class Echoes:
    """Particles whose signal exceeds the energy floor, sorted by beam and range; every field is ``(M,)``."""

    beam: Ints
    range_m: Array
    signal: Array  # N / K, 1/(m^2 sr)
    diameter_mm: Array  # of the drop, or melted of the flake

    def __len__(self) -> int:
        return int(self.beam.size)


@dataclass(frozen=True)
class Chosen:
    """What the sensor reports of each beam; every field is ``(n,)``. A lost beam has range and signal 0."""

    kind: Ints  # OBJECT, PARTICLE or LOST
    range_m: Array
    signal: Array
    diameter_mm: Array  # NaN where no particle is reported
    second: Chosen | None = None  # dual: the farthest echo where that is another one than the strongest


def full_beam_signal(range_m: Array, link: Link, medium: Medium) -> Array:
    """Signal of a particle that fills the beam, 1/(m^2 sr): g(r) of PHYSICS.md 5.3."""
    transmission = np.exp(-2.0 * medium.extinction_per_m * range_m) * link.near_response(range_m)
    return medium.full_bracket_per_sr * transmission / range_m**2


def object_signal(range_m: ArrayLike, reflectivity: ArrayLike, link: Link, medium: Medium) -> Array:
    """Signal of a Lambertian surface seen head-on through the weather, 1/(m^2 sr)."""
    r = np.asarray(range_m, dtype=np.float64)
    transmission = np.exp(-2.0 * medium.extinction_per_m * r) * link.near_response(r)
    return np.asarray(reflectivity, dtype=np.float64) / math.pi * transmission / r**2


def every_particle(
    object_range_m: ArrayLike,
    link: Link,
    medium: Medium,
    *,
    rng: np.random.Generator,
    energy_floor: float | None = None,
) -> Echoes:
    """All particles in front of the objects of ``n`` beams whose signal reaches ``energy_floor``.

    Slab by slab the number of particles in all cones is Poisson; each belongs to any beam with the same probability,
    its range has the density of the cone's cross-section, its diameter that of the truncated size distribution.
    Those behind their beam's object are dropped: a Poisson process restricted to a part of space is one of that part.
    In a slab only the sizes are drawn that could reach the floor if the slab were as bright as its brightest
    point; those that do not reach it where they are, are dropped too. Both are exact.

    Args:
        object_range_m: ``(n,)``, metres; ``inf`` where the beam meets nothing.
        link: the sensor.
        medium: the weather.
        rng: the random numbers.
        energy_floor: smallest signal that is listed, 1/(m^2 sr); None is the detection threshold.
    """
    farthest = np.minimum(np.asarray(object_range_m, dtype=np.float64), link.max_range_m)
    floor = link.threshold if energy_floor is None else energy_floor
    end = float(farthest.max(initial=0.0))
    parts = list(_slabs(farthest, link, medium, floor, end, rng)) if end > link.particles_from_m else []
    empty = (np.zeros(0, np.int64), np.zeros(0), np.zeros(0), np.zeros(0))
    beam, range_m, signal, diameter_mm = (np.concatenate(columns) for columns in zip(empty, *parts, strict=True))
    order = np.lexsort((range_m, beam))
    return Echoes(beam[order], range_m[order], signal[order], diameter_mm[order])


def _slabs(
    farthest_m: Array, link: Link, medium: Medium, floor: float, end_m: float, rng: np.random.Generator
) -> Iterator[tuple[Ints, Array, Array, Array]]:
    start = max(link.particles_from_m, 1e-3)  # below 1 mm there is no cone to speak of, and 1 / r^2 has no bound
    n_slabs = max(1, math.ceil(math.log(end_m / start) / math.log(SLAB_RATIO)))
    sizes = medium.sizes
    for near, far in pairwise(np.geomspace(start, end_m, n_slabs + 1).tolist()):
        ends = np.array([near, far])
        # No point of the slab is brighter: each factor at the end where it is larger.
        transmission = math.exp(-2.0 * medium.extinction_per_m * near) * float(link.near_response(ends)[1])
        brightest = medium.full_bracket_per_sr * transmission / near**2
        if brightest == 0.0:
            continue
        # The narrowest beam, and the most that the others of any particle add.
        all_others = math.pi / 4.0 * link.pulse_length_m * float(medium._smaller[1][-1])
        left = floor / brightest - all_others
        if left >= 1.0:
            continue
        smallest_m = float(link.beam_diameter_m(ends)[0]) * math.sqrt(max(left, 0.0))
        per_m3 = float(medium.larger_per_m3(np.array(smallest_m)))
        volumes = link.volume_m3(ends)
        n = int(rng.poisson(farthest_m.size * per_m3 * (volumes[1] - volumes[0])))
        beam = rng.integers(0, farthest_m.size, n)
        range_m = link.range_of_volume_m(rng.uniform(volumes[0], volumes[1], n))
        lowest = max(sizes.smallest_mm, float(medium.counted_diameter_mm(np.array(smallest_m))))
        low, high = math.exp(-sizes.slope_per_mm * lowest), math.exp(-sizes.slope_per_mm * sizes.largest_mm)
        diameter_mm = -np.log(low - rng.random(n) * (low - high)) / sizes.slope_per_mm
        optical_m = sizes.optical_diameters_mm(diameter_mm) * 1e-3
        share = medium.share_of_full(optical_m, link.beam_diameter_m(range_m), link.pulse_length_m)
        signal = full_beam_signal(range_m, link, medium) * share
        kept = (signal >= floor) & (range_m < farthest_m[beam])
        yield beam[kept], range_m[kept], signal[kept], diameter_mm[kept]


def summed_in_pulses(particles: Echoes, pulse_length_m: float) -> Array:
    """Signal at each particle with all others of its beam added, each weighted with the pulse's shape.

    The pulse is sin^2 of FWHM tau: an echo at a distance d counts ``cos^2(pi d / (2 l))``, l = c tau / 2, and nothing
    beyond l. For particles of a `Link` whose own pulse length is 0.
    """
    total = particles.signal.copy()
    for step in range(1, len(particles)):
        apart = particles.range_m[step:] - particles.range_m[:-step]
        near = np.flatnonzero((particles.beam[step:] == particles.beam[:-step]) & (apart < pulse_length_m))
        if not near.size:
            break
        weight = np.cos(math.pi * apart[near] / (2.0 * pulse_length_m)) ** 2
        np.add.at(total, near, weight * particles.signal[near + step])
        np.add.at(total, near + step, weight * particles.signal[near])
    return total


def chosen(
    particles: Echoes,
    object_range_m: ArrayLike,
    object_signal: ArrayLike,
    link: Link,
    mode: ReturnMode,
) -> Chosen:
    """What the sensor reports of each beam.

    An echo counts if its signal reaches the threshold. It is absorbed if a stronger one that counts lies closer than
    ``echo_separation_m`` in the same beam, also when that one is absorbed itself. Of the rest ``strongest`` is the
    one of the largest signal, ``first`` the nearest, ``last`` the farthest; ``dual`` is the strongest and, where it is
    another echo, the last. An object nearer than ``near_start_m`` is always reported, and nothing else of its beam.

    Args:
        particles: of ``every_particle``, with an energy floor not above the threshold.
        object_range_m: ``(n,)``, metres; ``inf`` where the beam meets nothing.
        object_signal: ``(n,)``, behind the weather, 1/(m^2 sr); of no meaning where there is no object.
        link: the sensor.
        mode: return mode.
    """
    distance = np.asarray(object_range_m, dtype=np.float64)
    n = distance.size
    near = distance < link.near_start_m
    strength = np.broadcast_to(np.asarray(object_signal, dtype=np.float64), n)
    seen = np.isfinite(distance) & (near | (strength >= link.threshold))
    counted = (particles.signal >= link.threshold) & ~near[particles.beam]
    beam = np.concatenate([np.flatnonzero(seen), particles.beam[counted]])
    order = np.lexsort((np.concatenate([distance[seen], particles.range_m[counted]]), beam))
    beam = beam[order]
    table = np.stack(
        [
            np.concatenate([distance[seen], particles.range_m[counted]])[order],
            np.concatenate([strength[seen], particles.signal[counted]])[order],
            np.concatenate([np.full(int(seen.sum()), np.nan), particles.diameter_mm[counted]])[order],
        ]
    )
    alone = ~_absorbed(beam, table[0], table[1], link.echo_separation_m)
    beam, table = beam[alone], table[:, alone]

    last = _last_of_each(beam)
    first = (beam.size - 1 - _last_of_each(beam[::-1]))[::-1]
    by_signal = np.lexsort((table[1], beam))
    strongest = by_signal[_last_of_each(beam[by_signal])]
    reported = {"strongest": strongest, "dual": strongest, "first": first, "last": last}[mode]
    second = None
    if mode == "dual":
        other = last[last != strongest]
        second = _report(n, beam[other], table[:, other])
    return _report(n, beam[reported], table[:, reported], second)


def _absorbed(beam: Ints, range_m: Array, signal: Array, separation_m: float) -> NDArray[np.bool_]:
    """Whether a stronger echo lies closer than the separation; the echoes are sorted by beam and range."""
    gone = np.zeros(beam.size, dtype=bool)
    for step in range(1, beam.size):
        # Echo i and its step-th neighbour behind it; once no such pair is close, no wider pair is.
        close = (beam[:-step] == beam[step:]) & (range_m[step:] - range_m[:-step] < separation_m)
        if not close.any():
            break
        gone[:-step] |= close & (signal[:-step] < signal[step:])
        gone[step:] |= close & (signal[step:] < signal[:-step])
    return gone


def _last_of_each(beam: Ints) -> Ints:
    """Index of the last row of each run of equal beams."""
    return np.flatnonzero(np.append(beam[1:] != beam[:-1], True)[: beam.size])


def _report(n: int, beam: Ints, table: Array, second: Chosen | None = None) -> Chosen:
    kind = np.full(n, LOST, dtype=np.int64)
    columns = np.zeros((3, n))
    columns[2] = np.nan
    kind[beam] = np.where(np.isnan(table[2]), OBJECT, PARTICLE)
    columns[:, beam] = table
    return Chosen(kind, columns[0], columns[1], columns[2], second)


def lambda_by_quadrature(energy: float, range_m: float, link: Link, medium: Medium) -> float:
    """Expected number of particles in front of ``range_m`` with a signal above ``energy`` (1/(m^2 sr)).

    ``Lambda(e, R) = int A_b(r) N_>(D_e(r)) dr`` over the reported ranges, with ``D_e`` the diameter whose particle
    returns e with the others of its pulse (alone ``D_b sqrt(e / g)``), the tail taken from the smallest diameter where
    ``D_e`` is below it, and 0 where ``D_e`` is above the largest or no particle returns e. Gauss-Legendre on each piece
    between the kinks and jumps of the integrand.
    """
    start, end = max(link.particles_from_m, 1e-3), min(range_m, link.max_range_m)
    if end <= start:
        return 0.0

    def needed_m(r: Array) -> Array:
        with np.errstate(divide="ignore"):
            share = energy / full_beam_signal(r, link, medium)
        return medium.needed_m(share, link.beam_diameter_m(r), link.pulse_length_m)

    def integrand(r: Array) -> Array:
        needed = needed_m(r)
        wide = link.beam_diameter_m(r)
        return np.where(needed < wide, math.pi / 4.0 * wide**2 * medium.larger_per_m3(np.minimum(needed, wide)), 0.0)

    nodes, weights = np.polynomial.legendre.leggauss(NODES)
    total = 0.0
    for low, high in pairwise(_breaks(needed_m, start, end, link, medium)):
        r = 0.5 * (low + high) + 0.5 * (high - low) * nodes
        total += 0.5 * (high - low) * float(weights @ integrand(r))
    return total


def _breaks(needed_m: Callable[[Array], Array], start: float, end: float, link: Link, medium: Medium) -> list[float]:
    """Ends of the pieces on which the integrand is smooth, refined so that no piece spans a factor above 1.2."""
    grid = np.geomspace(start, end, max(8, math.ceil(math.log(end / start) / math.log(1.02))) + 1)
    grid = np.unique(np.append(grid, np.clip(link.near_full_m, start, end)))
    search = grid.copy()
    search[0] *= 1.0 + 1e-9  # where the response begins it is zero, and no diameter is large enough
    sizes = medium.sizes
    levels_mm = [sizes.smallest_mm, sizes.largest_mm]
    if sizes.kind == "snow":
        levels_mm.append((1.0293 / 2.2947) ** (1.0 / 0.4437))  # where the flake's density reaches that of ice
    levels_m = sizes.optical_diameters_mm(np.array(levels_mm)) * 1e-3
    kinks: list[float] = []
    for level in (*levels_m.tolist(), None):

        def excess(r: Array, level: float | None = level) -> Array:
            target = link.beam_diameter_m(r) if level is None else level
            return np.log(target) - np.log(np.minimum(needed_m(r), 1e6))

        values = excess(search)
        for i in np.flatnonzero(values[:-1] * values[1:] < 0.0).tolist():
            kinks.append(brentq(lambda r, f=excess: float(f(np.array(r))), search[i], search[i + 1], xtol=1e-12))
    full_m = min(max(link.near_full_m, start), end)
    ends: list[float] = np.unique(np.concatenate([grid[::8], grid[-1:], kinks, [full_m]])).tolist()
    return ends
