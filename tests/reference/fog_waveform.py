"""Waveform that fog returns to a LiDAR, by direct integration over the pulse: the oracle of the soft return.

With a pulse of power ``sin^2(pi t / (2 tau))`` over ``0 < t < 2 tau`` (``tau`` is its FWHM, and its integral) a hard
target of signal ``X_obj`` peaks at ``X_obj``, so that everything is relative to the detection threshold:

``X_soft(R) = beta int_{R - c tau}^{R} sin^2(pi (R - r) / (c tau)) xi(r) exp(-2 alpha r) / r^2 dr``, 1/(m^2 sr),

from ``r = R1`` (start of the near-range response) on. ``R = c t / 2`` counts from the start of the pulse. A hard
target peaks ``c tau / 2`` behind its range, so the soft return lies at ``R_soft = R_peak - c tau / 2``.
It imports nothing of ``torchweather``.

References: PHYSICS.md 5.3 (near range, calibration), 5.8 (soft target).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import brentq, minimize_scalar

from tests.reference.every_lidar_particle import Link

__all__ = [
    "SoftTarget",
    "hard_signal",
    "last_detected_m",
    "local_signal",
    "object_wins_to_m",
    "soft_return",
    "soft_signal",
]

Array = NDArray[np.float64]

C_M_PER_S = 299_792_458.0
NODES = 48  # Gauss-Legendre nodes of each smooth piece of a pulse length
STEP_M = 0.01  # grid on which maxima and crossings are looked for before they are refined
FARTHEST_M = 200.0


@dataclass(frozen=True)
class SoftTarget:
    """A homogeneous fog at one wavelength, and the pulse that it is seen with."""

    extinction_per_m: float  # one way
    backscatter_per_m_sr: float
    pulse_width_s: float = 10e-9  # FWHM

    @property
    def pulse_length_m(self) -> float:
        """Range that one pulse width covers, c tau / 2."""
        return 0.5 * C_M_PER_S * self.pulse_width_s


def medium_per_m(range_m: Array, fog: SoftTarget, link: Link) -> Array:
    """Signal per metre of fog, ``beta xi exp(-2 alpha r) / r^2``, 1/(m^3 sr)."""
    attenuated = np.exp(-2.0 * fog.extinction_per_m * range_m) * link.near_response(range_m)
    return fog.backscatter_per_m_sr * attenuated / range_m**2


def soft_signal(received_m: ArrayLike, fog: SoftTarget, link: Link, object_range_m: float = math.inf) -> Array:
    """The waveform ``X_soft`` at ``received_m = c t / 2`` from the start of the pulse, 1/(m^2 sr).

    Gauss-Legendre between the ends of the pulse and of the near-range ramp. Fog behind ``object_range_m`` is hidden.
    """
    head = np.asarray(received_m, dtype=np.float64)[..., None]
    tail = head - 2.0 * fog.pulse_length_m
    last = np.minimum(head, object_range_m)
    bounds = [np.maximum(tail, link.near_start_m), np.full_like(head, link.near_full_m), last]
    bounds[1] = np.clip(bounds[1], bounds[0], np.maximum(last, bounds[0]))
    nodes, weights = np.polynomial.legendre.leggauss(NODES)
    total = np.zeros(head.shape[:-1])
    for low, high in pairwise(bounds):
        half = 0.5 * np.maximum(high - low, 0.0)
        r = low + half * (1.0 + nodes)
        pulse = np.sin(math.pi * (head - r) / (2.0 * fog.pulse_length_m)) ** 2
        total += (half * weights * pulse * medium_per_m(r, fog, link)).sum(axis=-1)
    return total


def local_signal(range_m: ArrayLike, fog: SoftTarget, link: Link) -> Array:
    """The local form ``beta (c tau / 2) xi exp(-2 alpha r) / r^2``: the waveform where nothing changes in a pulse."""
    return fog.pulse_length_m * medium_per_m(np.asarray(range_m, dtype=np.float64), fog, link)


def hard_signal(range_m: ArrayLike, reflectivity: float, fog: SoftTarget, link: Link) -> Array:
    """Signal of a Lambertian surface in the fog, seen head-on, 1/(m^2 sr)."""
    r = np.asarray(range_m, dtype=np.float64)
    attenuated = np.exp(-2.0 * fog.extinction_per_m * r) * link.near_response(r)
    return reflectivity / math.pi * attenuated / r**2


def soft_return(fog: SoftTarget, link: Link, object_range_m: float = math.inf) -> tuple[float, float]:
    """``R_soft`` (m) and signal (1/(m^2 sr)) of the maximum of the waveform; zeros where no fog is seen."""
    reach = min(object_range_m, FARTHEST_M) + 2.0 * fog.pulse_length_m
    grid = np.arange(link.near_start_m, reach, STEP_M)
    waveform = soft_signal(grid, fog, link, object_range_m)
    if not waveform.max(initial=0.0) > 0.0:
        return 0.0, 0.0
    top = float(grid[waveform.argmax()])
    found = minimize_scalar(
        lambda r: -float(soft_signal(r, fog, link, object_range_m)),
        bounds=(max(top - STEP_M, link.near_start_m), top + STEP_M),
        method="bounded",
        options={"xatol": 1e-9},
    )
    return float(found.x) - fog.pulse_length_m, -float(found.fun)


def object_wins_to_m(reflectivity: float, fog: SoftTarget, link: Link) -> float:
    """Farthest range at which a surface is stronger than the soft return of unlimited fog."""
    _, peak = soft_return(fog, link)
    return _last_above(lambda r: hard_signal(r, reflectivity, fog, link), peak, link)


def last_detected_m(fog: SoftTarget, link: Link, *, local: bool) -> float:
    """Farthest ``R_soft`` at which the fog's waveform (or its local form) reaches the detection threshold."""
    if local:
        return _last_above(lambda r: local_signal(r, fog, link), link.threshold, link)
    shift = fog.pulse_length_m
    return _last_above(lambda r: soft_signal(r + shift, fog, link), link.threshold, link)


def _last_above(signal: Callable[[Array], Array], level: float, link: Link) -> float:
    grid = np.arange(link.near_start_m + STEP_M, FARTHEST_M, STEP_M)
    above = np.flatnonzero(signal(grid) > level)
    if not above.size:
        return math.nan
    low, high = float(grid[above[-1]]), float(grid[above[-1]]) + STEP_M
    return float(brentq(lambda r: float(signal(np.asarray(r))) - level, low, high, xtol=1e-12))
