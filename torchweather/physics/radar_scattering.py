"""Attenuation and radar backscatter of drops and flakes at millimetre waves: Mie over the size distribution."""

from __future__ import annotations

import math
from functools import lru_cache

import torch
from torch import Tensor

from torchweather.errors import check_between
from torchweather.physics.efficiency_table import size_nodes_mm
from torchweather.physics.extinction import integrated_per_m, support_mm
from torchweather.physics.mie import MieEfficiencies, mie_efficiencies
from torchweather.physics.refractive_index import snow_refractive_index_microwave, water_refractive_index_microwave
from torchweather.physics.size_distribution import SizeDistribution
from torchweather.physics.snow_geometry import (
    ICE_DENSITY_G_PER_CM3,
    melted_diameter_mm,
    physical_diameter_mm,
    snow_bulk_density_g_per_cm3,
)

__all__ = ["DB_PER_KM", "particle_attenuation_db_per_km", "volume_reflectivity_m2_per_m3"]

DB_PER_KM = 1e4 / math.log(10.0)  # 4342.9: power extinction 1/m to dB/km, PHYSICS.md 0
LIGHT_NM_GHZ = 299_792_458.0  # speed of light in nm GHz


def particle_attenuation_db_per_km(
    distribution: SizeDistribution,
    frequency_ghz: float = 77.0,
    *,
    temperature_c: float | None = None,
    flake_density_g_per_cm3: float | None = None,
) -> Tensor:
    """Attenuation by the particles, dB/km one way: Mie extinction over the size distribution.

    Args:
        distribution: drops or flakes, parameters of any batch shape; differentiable in them.
        frequency_ghz: GHz, 1-1000.
        temperature_c: deg C; None is 10 for water and -5 for ice.
        flake_density_g_per_cm3: bulk density of every flake (0.917: solid ice); None is Brandes' law by size.

    Note:
        Spheres. Flakes are homogeneous ice-air mixtures (Maxwell-Garnett): a model uncertainty of a factor 3-10.
        Wet snow attenuates far more and is not covered.

    References:
        PHYSICS.md 6.5-6.7.

    Example:
        >>> from torchweather.physics import marshall_palmer
        >>> round(float(particle_attenuation_db_per_km(marshall_palmer(25.0))), 1)
        14.5
    """
    diameter, width, q, counted = _table_of(distribution, frequency_ghz, temperature_c, flake_density_g_per_cm3)
    return DB_PER_KM * integrated_per_m(distribution, counted, diameter, width, q.q_ext)


def volume_reflectivity_m2_per_m3(
    distribution: SizeDistribution,
    frequency_ghz: float = 77.0,
    *,
    temperature_c: float | None = None,
    flake_density_g_per_cm3: float | None = None,
) -> Tensor:
    """Radar cross-section of the particles per volume, m^2/m^3: ``eta = int sigma_b N dD``, exact backscatter.

    Args:
        distribution: drops or flakes, parameters of any batch shape; differentiable in them.
        frequency_ghz: GHz, 1-1000.
        temperature_c: as in ``particle_attenuation_db_per_km``.
        flake_density_g_per_cm3: as in ``particle_attenuation_db_per_km``.

    Note:
        At 77 GHz Rayleigh's approximation is 15-60 times too high for rain.

    References:
        PHYSICS.md 6.5.

    Example:
        >>> from torchweather.physics import marshall_palmer
        >>> f"{float(volume_reflectivity_m2_per_m3(marshall_palmer(25.0))):.2e}"
        '1.16e-03'
    """
    diameter, width, q, counted = _table_of(distribution, frequency_ghz, temperature_c, flake_density_g_per_cm3)
    return integrated_per_m(distribution, counted, diameter, width, q.q_back)


def _table_of(
    distribution: SizeDistribution, frequency_ghz: float, temperature_c: float | None, density: float | None
) -> tuple[Tensor, Tensor, MieEfficiencies, Tensor]:
    """Physical diameters and widths, efficiencies, and the diameters by which the distribution counts them."""
    check_between("frequency_ghz", frequency_ghz, 1.0, 1000.0, unit="GHz", owner="particle_attenuation_db_per_km")
    low, high = support_mm(distribution, order=6.0)
    if distribution.particle == "drop":
        celsius = 10.0 if temperature_c is None else float(temperature_c)
        diameter, width, q = _water_table(low, high, float(frequency_ghz), celsius)
        return diameter, width, q, diameter
    celsius = -5.0 if temperature_c is None else float(temperature_c)
    melted = distribution.particle == "melted-flake"
    if not melted:
        low, high = (float(melted_diameter_mm(d)) for d in (low, high))
    return _flake_table(low, high, float(frequency_ghz), celsius, density, melted)


@lru_cache(maxsize=64)
def _water_table(
    low: float, high: float, frequency_ghz: float, celsius: float
) -> tuple[Tensor, Tensor, MieEfficiencies]:
    wavelength_nm = LIGHT_NM_GHZ / frequency_ghz
    diameter, width = size_nodes_mm(low, high, wavelength_nm, for_backscatter=True)
    index = complex(water_refractive_index_microwave(frequency_ghz, celsius))
    return diameter, width, mie_efficiencies(math.pi * 1e6 / wavelength_nm * diameter, index)


@lru_cache(maxsize=64)
def _flake_table(
    low: float, high: float, frequency_ghz: float, celsius: float, density: float | None, melted: bool
) -> tuple[Tensor, Tensor, MieEfficiencies, Tensor]:
    """The widths are those of the counted diameter; a given density sets the physical one through the mass."""
    if density is None:
        ends = [float(physical_diameter_mm(d)) for d in (low, high)]
    else:
        check_between("flake_density_g_per_cm3", density, 1e-3, ICE_DENSITY_G_PER_CM3, owner="flake table")
        ends = [d / density ** (1.0 / 3.0) for d in (low, high)]
    wavelength_nm = LIGHT_NM_GHZ / frequency_ghz
    diameter, width = size_nodes_mm(ends[0], ends[1], wavelength_nm, for_backscatter=True)
    if density is None:
        bulk, mass_diameter = snow_bulk_density_g_per_cm3(diameter), melted_diameter_mm(diameter)
    else:
        bulk, mass_diameter = torch.full_like(diameter, density), diameter * density ** (1.0 / 3.0)
    index = snow_refractive_index_microwave(frequency_ghz, bulk, celsius)
    q = mie_efficiencies(math.pi * 1e6 / wavelength_nm * diameter, index)
    counted = mass_diameter if melted else physical_diameter_mm(mass_diameter)
    # ln-widths: dD_counted = D_counted (d ln D_counted / d ln D_phys) dln D_phys, the slope by differences
    slope = torch.gradient(torch.log(counted), spacing=(torch.log(diameter),), edge_order=2)[0]
    return diameter, width / diameter * counted * slope, q, counted
