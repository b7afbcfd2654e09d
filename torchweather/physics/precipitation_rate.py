"""Precipitation rate that a size distribution carries, and the distribution scaled to carry a given one."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TypeVar

from torch import Tensor

from torchweather.core.arguments import call_given, check_arguments
from torchweather.core.errors import check_at_least, check_one_of
from torchweather.physics.fall_speed import (
    flake_fall_speed_m_per_s,
    rain_fall_speed_m_per_s,
    snow_fall_speed_m_per_s,
)
from torchweather.physics.float64 import Quantity, to_float64
from torchweather.physics.size_distribution import SizeDistribution
from torchweather.physics.snow_geometry import snow_bulk_density_g_per_cm3

__all__ = ["FallSpeed", "close_rate", "fall_speed_law", "precipitation_rate_mm_per_h", "rain_rate_mm_per_h"]

FallSpeed = Callable[[Tensor], Tensor]
"""Diameter of the distribution, mm, to speed, m/s."""

AnyDistribution = TypeVar("AnyDistribution", bound=SizeDistribution)

# 1 mm^3 m^-3 of water falling at 1 m/s is 3.6e-3 mm/h; with pi/6 it is the 6e-4 pi of PHYSICS.md 2.2.
MM_PER_H = 3.6e-3

FALL_SPEED_LAWS: dict[str, FallSpeed] = {
    "drop": rain_fall_speed_m_per_s,
    "melted-flake": snow_fall_speed_m_per_s,
    "flake": flake_fall_speed_m_per_s,
}


def precipitation_rate_mm_per_h(distribution: SizeDistribution, fall_speed: FallSpeed | None = None) -> Tensor:
    """Liquid-equivalent rate, mm/h: the flux of water ``6e-4 pi int D^3 v(D) N(D) dD``.

    Args:
        distribution: drops or flakes; for ``particle="flake"`` the volume counts with its bulk density.
        fall_speed: diameter in mm to speed in m/s; None takes the default law of the particle.

    Returns:
        mm/h, of the batch shape of the distribution.

    References:
        PHYSICS.md 2.2, 2.4.

    Example:
        >>> from torchweather.physics import marshall_palmer
        >>> round(float(precipitation_rate_mm_per_h(marshall_palmer(10.0))), 1)
        11.6
    """
    check_arguments(
        "precipitation_rate_mm_per_h(distribution: SizeDistribution, fall_speed: Callable | None)",
        distribution,
        fall_speed,
    )
    diameter, width = distribution.quadrature()
    law = fall_speed_law(distribution.particle) if fall_speed is None else fall_speed
    speed: Tensor = call_given("precipitation_rate_mm_per_h", "fall_speed", law, diameter)
    water_mm3 = math.pi / 6.0 * diameter**3
    if distribution.particle == "flake":
        water_mm3 = water_mm3 * snow_bulk_density_g_per_cm3(diameter)
    return MM_PER_H * (water_mm3 * speed * width * distribution.number_density_per_m3_mm(diameter)).sum(-1)


rain_rate_mm_per_h = precipitation_rate_mm_per_h


def fall_speed_law(particle: str) -> FallSpeed:
    """Fall speed law of what a distribution counts: ``drop``, ``melted-flake`` or ``flake``.

    Example:
        >>> fall_speed_law("drop").__name__
        'rain_fall_speed_m_per_s'
    """
    check_one_of("particle", particle, FALL_SPEED_LAWS, owner="fall_speed_law")
    return FALL_SPEED_LAWS[particle]


def close_rate(
    distribution: AnyDistribution, rate_mm_per_h: Quantity, fall_speed: FallSpeed | None = None
) -> AnyDistribution:
    """The distribution with its number scaled so that it carries exactly ``rate_mm_per_h``.

    Args:
        distribution: drops or flakes; its shape is kept.
        rate_mm_per_h: liquid-equivalent rate, mm/h, of the batch shape; 0 gives no particles.
        fall_speed: as in ``precipitation_rate_mm_per_h``.

    References:
        PHYSICS.md 2.2 (``close_rate``; off by default in the weather classes).

    Example:
        >>> from torchweather.physics import marshall_palmer
        >>> exact = close_rate(marshall_palmer(10.0), 10.0)
        >>> round(float(precipitation_rate_mm_per_h(exact)), 6)
        10.0
    """
    check_arguments("close_rate(distribution: SizeDistribution, rate_mm_per_h: Quantity)", distribution, rate_mm_per_h)
    check_at_least("rate_mm_per_h", rate_mm_per_h, 0.0, unit="mm/h", owner="close_rate")
    carried = precipitation_rate_mm_per_h(distribution, fall_speed)
    (rate,) = to_float64(rate_mm_per_h)
    return distribution.scaled(rate / carried.clamp_min(1e-300))
