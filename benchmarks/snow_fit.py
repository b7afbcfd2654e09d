"""Fits of `snow_structure.py`: density over azimuth and elevation, sizes against the range of the flakes, sharing.

All of it is counted on beams that see nothing behind the snow ("free"), where no object decides what is reported.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.optimize import minimize, nnls

import torchweather as tw
from torchweather.lidar.beam import Beam
from torchweather.lidar.effects.structure import beam_overlap
from torchweather.lidar.returns.beam_particles import SIZE_KNOTS_MM, BeamParticles
from torchweather.lidar.returns.strongest import expected_number

Array = NDArray[np.float64]

RANGE_EDGES_M = (2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0, 10.0, 12.0, 14.0, 17.0, 20.0, 30.0)
GAINS_DB = tuple(-20.0 + step for step in range(15))
SAME_M, CHANCE_M = 0.06, (0.06, 0.5)  # apart: one flake (three deviations of the range), and two by chance
BLOCK_DEG = 5.0  # of a ring, in which recorded flakes may come together


@dataclass(frozen=True)
class Snow:
    """Beams of a frame that see nothing behind the snow, ``(N,)`` each.

    Args:
        azimuth_rad, elevation_rad: of the beam.
        ring: number of its laser.
        flake: whether it returns snow.
        ranges_m: of the flakes, two a beam at most, 0 where there is none, ``(N, 2)``.
    """

    azimuth_rad: Array
    elevation_rad: Array
    ring: NDArray[np.int64]
    flake: NDArray[np.bool_]
    ranges_m: Array


# ---- density -----------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Density:
    """Expected number of flakes in each beam; the parameters of the two effects, and that of a beam beside them."""

    number: float
    azimuth: dict[str, float]
    elevation: dict[str, float]

    def of(self, snow: Snow) -> Array:
        """Number of flakes that a beam sees on average, ``(N,)``."""
        found = self.number * wake(snow.azimuth_rad, **self.azimuth) * layer(snow.elevation_rad, **self.elevation)
        return np.maximum(found, 1e-9)


def bump(apart_rad: Array, width_rad: float, steepness: float = 1.0) -> Array:
    """The lobe of the effects, by angles."""
    found: Array = 0.5 ** (np.abs(np.sin(0.5 * apart_rad)) / np.sin(0.25 * width_rad)) ** (2.0 * steepness)
    return found


def wake(
    azimuth: Array,
    amplitude: float,
    azimuth_rad: float,
    width_rad: float,
    wind_amplitude: float,
    wind_azimuth_rad: float,
) -> Array:
    """Density of `lidar.particle_density_azimuth`."""
    found: Array = 1.0 + amplitude * bump(azimuth - azimuth_rad, width_rad)
    return found * (1.0 + wind_amplitude * np.cos(azimuth - wind_azimuth_rad))


def layer(elevation: Array, amplitude: float, elevation_rad: float, width_rad: float, steepness: float) -> Array:
    """Density of `lidar.particle_density_elevation`."""
    return 1.0 + amplitude * bump(elevation - elevation_rad, width_rad, steepness)


def fitted_density(snow: Snow) -> Density:
    """The density of greatest likelihood: a beam returns a flake with ``1 - exp(-number)``."""

    def density(t: Array) -> Density:
        return Density(
            math.exp(t[0]),
            {
                "amplitude": math.expm1(t[1]),
                "azimuth_rad": t[2],
                "width_rad": min(max(math.exp(t[3]), 0.01), 2.0 * math.pi),
                "wind_amplitude": 1.0 / (1.0 + math.exp(-t[7])),
                "wind_azimuth_rad": t[8],
            },
            {
                "amplitude": math.expm1(t[4]),
                "elevation_rad": t[5],
                "width_rad": min(max(math.exp(t[6]), 0.01), 2.0 * math.pi),
                "steepness": 1.0 + 7.0 / (1.0 + math.exp(-t[9])),
            },
        )

    def cost(t: Array) -> float:
        number = density(t).of(snow)
        return float(-np.log(-np.expm1(-number[snow.flake])).sum() + number[~snow.flake].sum())

    start = np.array([-1.7, 1.0, math.pi, -1.0, 0.7, 0.0, -2.8, -1.0, 1.0, 0.0])
    for _ in range(3):
        options = {"maxiter": 6000, "maxfev": 6000, "xatol": 1e-4, "fatol": 1e-4, "adaptive": True}
        start = minimize(cost, start, method="Nelder-Mead", options=options).x
    found = density(start)
    found.azimuth["azimuth_rad"] = math.remainder(found.azimuth["azimuth_rad"], 2.0 * math.pi)
    found.azimuth["wind_azimuth_rad"] = math.remainder(found.azimuth["wind_azimuth_rad"], 2.0 * math.pi)
    return found


def overdispersion(snow: Snow, number: Array) -> float:
    """Variance of the count of a block (5 degrees of a ring, or 5 degrees of all rings) over that of free flakes."""
    chance = -np.expm1(-number)
    away, spread = snow.flake - chance, chance * (1.0 - chance)
    column = ((snow.azimuth_rad + math.pi) * (180.0 / math.pi / BLOCK_DEG)).astype(np.int64)
    found = 1.0
    for block in (column, column + 1000 * snow.ring):
        _, place = np.unique(block, return_inverse=True)
        found = max(found, float((np.bincount(place, away) ** 2).sum() / spread.sum()))
    return found


# ---- sizes and backscatter ---------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Sizes:
    """Factors of `lidar.particle_sizes`, backscatter and how well the ranges of the flakes are met."""

    factors: tuple[float, ...]
    gain_db: float
    chi2: float
    bins: int


def numbers_by_range(weather: tw.Snow, sensor: tw.Lidar, gain_db: float) -> tuple[Array, Array]:
    """Expected flakes above threshold in each bin of range, and up to the last range, for each size's unit factor.

    Each flake counts alone, so that numbers are sums over the sizes; those of one pulse add 5 to 10 % to the share.
    """
    sensor = replace(sensor, pulse_width_ns=1e-9)
    part, beam = BeamParticles(weather, sensor, q_back=None, published=False), Beam(sensor)
    wanted = beam.threshold * 10.0 ** (-0.1 * gain_db)
    edges = torch.tensor([[*RANGE_EDGES_M, part.grid.far_m]])
    row = ((torch.log(wanted) - part.log_low) / part.log_step).expand_as(edges)
    found = []
    for unit in torch.eye(len(SIZE_KNOTS_MM)):
        between = part.between(beam, torch.zeros(1), sizes=unit[None])
        found.append(expected_number(between, row, part.grid.position(edges))[0].double().numpy())
    upto = np.stack(found)  # (knots, edges)
    return np.diff(upto[:, :-1], axis=1), upto[:, -1]


def fitted_sizes(snow: Snow, density: Density, weather: tw.Snow, sensor: tw.Lidar) -> list[Sizes]:
    """Non-negative factors that give the ranges of the flakes, and the number that the density has, for each gain.

    Sorted, the best first. A low gain asks for very many flakes, whose pulses add up to far more echoes than each
    makes alone; `numbers_by_range` does not see that, so the caller has to look at what they give together.
    """
    counts, _ = np.histogram(snow.ranges_m[snow.ranges_m > 0], RANGE_EDGES_M)
    beams = float(density.of(snow).sum()) / density.number
    error = np.sqrt(counts + 1.0)
    found = []
    for gain_db in GAINS_DB:
        by_range, upto = numbers_by_range(weather, sensor, gain_db)
        factors, residual = nnls((beams * by_range / error).T, counts / error)
        number = float(factors @ upto)
        if number > 0:
            # The chance of a flake in a beam is what the density was fitted to.
            scaled = tuple(min(float(one) * density.number / number, 100.0) for one in factors)
            found.append(Sizes(scaled, gain_db, float(residual**2), len(counts)))
    return sorted(found, key=lambda one: one.chi2)


def matching_rate(weather: tw.Snow, sensor: tw.Lidar, share: float) -> float:
    """Rate at which a share of beams into the sky returns a flake."""
    low, high = 0.01, 20.0
    for _ in range(40):
        rate = math.sqrt(low * high)
        part = BeamParticles(tw.Snow(rate_mm_per_h=rate), sensor, q_back=None, published=False)
        beam, reach = Beam(sensor), torch.full((1, 1), part.grid.far_m)
        number = float(part.expected_above(beam, beam.threshold.reshape(1, 1), torch.zeros(1), reach))
        low, high = (rate, high) if -math.expm1(-number) < share else (low, rate)
    return rate


# ---- sharing -----------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Shared:
    """Flakes at one range in neighbouring beams: how many, how many by chance, how many the geometry has."""

    pairs: int
    by_chance: float
    by_geometry: float

    @property
    def share(self) -> float:
        """Of the geometric overlap."""
        return (self.pairs - self.by_chance) / max(self.by_geometry, 1e-9)

    @property
    def error(self) -> float:
        """Standard, of ``share``, from the counts."""
        return math.sqrt(max(self.pairs, 1) + 0.1 * self.by_chance) / max(self.by_geometry, 1e-9)


def counted_shared(snow: Snow, sensor: tw.Lidar) -> Shared:
    """Pairs of neighbours along a ring whose nearest flakes lie at one range."""
    assert sensor.columns is not None
    step = 2.0 * math.pi / sensor.columns
    order = np.lexsort((snow.azimuth_rad, snow.ring))
    ring, azimuth = snow.ring[order], snow.azimuth_rad[order]
    nearest = np.where(snow.ranges_m > 0, snow.ranges_m, np.inf).min(1)[order]
    beside = (np.diff(ring) == 0) & (np.diff(azimuth) < 1.5 * step)
    apart = np.full(len(beside), np.inf)
    both = beside & np.isfinite(nearest[1:]) & np.isfinite(nearest[:-1])
    apart[both] = np.abs(nearest[1:][both] - nearest[:-1][both])
    near = int((apart < SAME_M).sum())
    chance = ((apart >= CHANCE_M[0]) & (apart < CHANCE_M[1])).sum() * SAME_M / (CHANCE_M[1] - CHANCE_M[0])
    ranges = torch.from_numpy(nearest[:-1][beside & np.isfinite(nearest[:-1])])
    angle = step * float(np.cos(snow.elevation_rad).mean())
    overlap = beam_overlap(angle * ranges, 1e-3 * (sensor.exit_diameter_mm + sensor.divergence_mrad * ranges))
    return Shared(near, float(chance), float(overlap.sum()))


def shares(values: NDArray[np.bool_], axis: Array, edges: tuple[float, ...]) -> list[tuple[int, float]]:
    """Number of beams and share of those with a flake in each bin of an axis."""
    found = []
    for low, high in pairwise(edges):
        inside = (axis > low) & (axis <= high)
        found.append((int(inside.sum()), float(values[inside].mean()) if inside.any() else math.nan))
    return found
