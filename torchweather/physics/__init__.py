"""Physics as pure functions: particles, their optics, and what they take from a signal."""

from __future__ import annotations

from torchweather.physics.binned_distribution import Binned
from torchweather.physics.fall_speed import (
    flake_fall_speed_m_per_s,
    rain_fall_speed_m_per_s,
    snow_fall_speed_m_per_s,
)
from torchweather.physics.interpolation import KnobTable
from torchweather.physics.precipitation_rate import close_rate, precipitation_rate_mm_per_h, rain_rate_mm_per_h
from torchweather.physics.rain_distributions import RAIN, marshall_palmer
from torchweather.physics.size_distributions import Exponential, Gamma, LogNormal, ModifiedGamma, SizeDistribution
from torchweather.physics.snow_distributions import (
    SNOW,
    brandes_snow,
    brandes_table4,
    gunn_marshall,
    sekhon_srivastava,
)
from torchweather.physics.snow_geometry import (
    equal_visibility_rain_rate,
    melted_diameter_mm,
    physical_diameter_mm,
    snow_bulk_density_g_per_cm3,
)

__all__ = [
    "Binned",
    "Exponential",
    "Gamma",
    "KnobTable",
    "LogNormal",
    "ModifiedGamma",
    "RAIN",
    "SNOW",
    "SizeDistribution",
    "brandes_snow",
    "brandes_table4",
    "close_rate",
    "equal_visibility_rain_rate",
    "flake_fall_speed_m_per_s",
    "gunn_marshall",
    "marshall_palmer",
    "melted_diameter_mm",
    "physical_diameter_mm",
    "precipitation_rate_mm_per_h",
    "rain_fall_speed_m_per_s",
    "rain_rate_mm_per_h",
    "sekhon_srivastava",
    "snow_bulk_density_g_per_cm3",
    "snow_fall_speed_m_per_s",
]
