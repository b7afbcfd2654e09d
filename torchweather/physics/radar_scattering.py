"""Attenuation and radar backscatter of drops and flakes at millimetre waves: Mie over the size distribution."""

from __future__ import annotations

import math
from functools import lru_cache

import torch
from torch import Tensor

from torchweather.core.arguments import check_arguments
from torchweather.core.errors import InputValueError, check_between
from torchweather.physics.efficiency_table import size_nodes_mm
from torchweather.physics.extinction import integrated_per_m, support_mm
from torchweather.physics.mie import MieEfficiencies, mie_efficiencies
from torchweather.physics.precipitation_rate import fall_speed_law
from torchweather.physics.refractive_index import (
    water_refractive_index_microwave,
    wet_snow_refractive_index_microwave,
)
from torchweather.physics.size_distribution import SizeDistribution
from torchweather.physics.snow_geometry import (
    ICE_DENSITY_G_PER_CM3,
    melted_diameter_mm,
    physical_diameter_mm,
    snow_bulk_density_g_per_cm3,
    wet_flake_diameter_mm,
)

__all__ = [
    "DB_PER_KM",
    "particle_attenuation_db_per_km",
    "reflectivity_weighted_fall_speed",
    "volume_reflectivity_m2_per_m3",
]

DB_PER_KM = 1e4 / math.log(10.0)  # 4342.9: power extinction 1/m to dB/km, PHYSICS.md 0
LIGHT_NM_GHZ = 299_792_458.0  # speed of light in nm GHz
FREQUENCY_RANGE_GHZ = (1.0, 1000.0)  # of the permittivities of water and ice, PHYSICS.md 1
SPEED_ROUNDING = 1e-12  # of the squared speed: what float64 leaves of E[v^2] - E[v]^2 over some thousand nodes


def particle_attenuation_db_per_km(
    distribution: SizeDistribution,
    frequency_ghz: float = 77.0,
    *,
    temperature_c: float | None = None,
    flake_density_g_per_cm3: float | None = None,
    melt_fraction: float = 0.0,
) -> Tensor:
    """Attenuation by the particles, dB/km one way: Mie extinction over the size distribution.

    Args:
        distribution: drops or flakes, parameters of any batch shape; differentiable in them.
        frequency_ghz: GHz, 1-1000.
        temperature_c: deg C; None is 10 for water and -5 for ice.
        flake_density_g_per_cm3: bulk density of every flake (0.917: solid ice); None is Brandes' law by size.
        melt_fraction: share of every flake's mass that is liquid, 0-1; 0 for drops.

    Note:
        Spheres. Flakes are homogeneous ice-air mixtures (Maxwell-Garnett): a model uncertainty of a factor 3-10.
        Melting flakes shrink (``wet_flake_diameter_mm``) and their snow is enclosed by water at 0 C
        (``wet_snow_refractive_index_microwave``), the upper bound of the mixing rules. Their number stays that of dry
        snow, which falls slowly: at ``melt_fraction=1`` they are more drops than rain of the same rate has.

    References:
        PHYSICS.md 6.5-6.7.

    Example:
        >>> from torchweather.physics import marshall_palmer
        >>> round(float(particle_attenuation_db_per_km(marshall_palmer(25.0))), 1)
        14.5
    """
    check_arguments(
        "particle_attenuation_db_per_km(distribution: SizeDistribution, frequency_ghz: float, "
        "temperature_c: float | None, flake_density_g_per_cm3: float | None, melt_fraction: float)",
        distribution,
        frequency_ghz,
        temperature_c,
        flake_density_g_per_cm3,
        melt_fraction,
    )
    diameter, width, q, counted = _table_of(
        distribution,
        frequency_ghz,
        temperature_c,
        flake_density_g_per_cm3,
        melt_fraction,
        "particle_attenuation_db_per_km",
    )
    return DB_PER_KM * integrated_per_m(distribution, counted, diameter, width, q.q_ext)


def volume_reflectivity_m2_per_m3(
    distribution: SizeDistribution,
    frequency_ghz: float = 77.0,
    *,
    temperature_c: float | None = None,
    flake_density_g_per_cm3: float | None = None,
    melt_fraction: float = 0.0,
) -> Tensor:
    """Radar cross-section of the particles per volume, m^2/m^3: ``eta = int sigma_b N dD``, exact backscatter.

    Args:
        distribution: drops or flakes, parameters of any batch shape; differentiable in them.
        frequency_ghz: GHz, 1-1000.
        temperature_c: as in ``particle_attenuation_db_per_km``.
        flake_density_g_per_cm3: as in ``particle_attenuation_db_per_km``.
        melt_fraction: as in ``particle_attenuation_db_per_km``.

    Note:
        At 77 GHz Rayleigh's approximation is 15-60 times too high for rain of 10-50 mm/h.

    References:
        PHYSICS.md 6.5.

    Example:
        >>> from torchweather.physics import marshall_palmer
        >>> f"{float(volume_reflectivity_m2_per_m3(marshall_palmer(25.0))):.2e}"
        '1.16e-03'
    """
    check_arguments(
        "volume_reflectivity_m2_per_m3(distribution: SizeDistribution, frequency_ghz: float, "
        "temperature_c: float | None, flake_density_g_per_cm3: float | None, melt_fraction: float)",
        distribution,
        frequency_ghz,
        temperature_c,
        flake_density_g_per_cm3,
        melt_fraction,
    )
    diameter, width, q, counted = _table_of(
        distribution,
        frequency_ghz,
        temperature_c,
        flake_density_g_per_cm3,
        melt_fraction,
        "volume_reflectivity_m2_per_m3",
    )
    return integrated_per_m(distribution, counted, diameter, width, q.q_back)


def reflectivity_weighted_fall_speed(
    distribution: SizeDistribution,
    frequency_ghz: float = 77.0,
    temperature_c: float | None = None,
    melt_fraction: float = 0.0,
) -> tuple[Tensor, Tensor, Tensor]:
    """Reflectivity of the particles and the fall speed they show a radar that looks straight up.

    ``eta = int sigma_b N dD``, ``mean = int v sigma_b N dD / eta``, ``std^2 = int (v - mean)^2 sigma_b N dD / eta``:
    the moments of the Doppler spectrum in still air.

    Args:
        distribution: drops or flakes, parameters of any batch shape; differentiable in them.
        frequency_ghz: as in ``particle_attenuation_db_per_km``.
        temperature_c: as in ``particle_attenuation_db_per_km``.
        melt_fraction: as in ``particle_attenuation_db_per_km``; it weights the sizes and leaves their speed alone.

    Returns:
        eta in m^2/m^3, as ``volume_reflectivity_m2_per_m3``; mean and standard deviation of the speed in m/s, downward
        positive. All of the batch shape; where nothing falls, 0.

    Note:
        Still air at sea level. Turbulence and wind shear widen a measured spectrum further.

    References:
        PHYSICS.md 2.5, 6.5.

    Example:
        >>> from torchweather.physics import marshall_palmer
        >>> _, mean, std = reflectivity_weighted_fall_speed(marshall_palmer(25.0))
        >>> round(float(mean), 1), round(float(std), 1)
        (4.9, 1.3)
    """
    check_arguments(
        "reflectivity_weighted_fall_speed(distribution: SizeDistribution, frequency_ghz: float, "
        "temperature_c: float | None, melt_fraction: float)",
        distribution,
        frequency_ghz,
        temperature_c,
        melt_fraction,
    )
    diameter, width, q, counted = _table_of(
        distribution, frequency_ghz, temperature_c, None, melt_fraction, "reflectivity_weighted_fall_speed"
    )
    speed = fall_speed_law(distribution.particle)(counted)
    eta, first, second = (
        integrated_per_m(distribution, counted, diameter, width, q.q_back * speed**power) for power in (0, 1, 2)
    )
    something = eta > 0
    share = torch.where(something, eta, torch.ones_like(eta))
    mean = first / share
    variance = second / share - mean**2
    # One speed alone has no spread; the root's slope is infinite there.
    spread = variance > SPEED_ROUNDING * mean**2
    std = torch.sqrt(torch.where(spread, variance, torch.ones_like(variance)))
    return eta, mean, torch.where(spread, std, torch.zeros_like(std))


def _table_of(
    distribution: SizeDistribution,
    frequency_ghz: float,
    temperature_c: float | None,
    density: float | None,
    melt_fraction: float,
    owner: str,
) -> tuple[Tensor, Tensor, MieEfficiencies, Tensor]:
    """Outline diameters, widths, efficiencies, and the diameters by which the distribution counts the particles."""
    check_between("frequency_ghz", frequency_ghz, *FREQUENCY_RANGE_GHZ, unit="GHz", owner=owner)
    check_between("melt_fraction", melt_fraction, 0.0, 1.0, owner=owner)
    low, high = support_mm(distribution, order=6.0)
    if distribution.particle == "drop":
        if melt_fraction != 0.0:
            raise InputValueError(
                f"{owner}: melt_fraction must be 0 for a distribution of drops, which are liquid; got "
                f"{melt_fraction!r}. It is for flakes."
            )
        celsius = 10.0 if temperature_c is None else float(temperature_c)
        diameter, width, q = _water_table(low, high, float(frequency_ghz), celsius)
        return diameter, width, q, diameter
    celsius = -5.0 if temperature_c is None else float(temperature_c)
    melted = distribution.particle == "melted-flake"
    if not melted:
        low, high = (float(melted_diameter_mm(d)) for d in (low, high))
    return _flake_table(low, high, float(frequency_ghz), celsius, density, melted, float(melt_fraction))


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
    low: float,
    high: float,
    frequency_ghz: float,
    celsius: float,
    density: float | None,
    melted: bool,
    melt_fraction: float,
) -> tuple[Tensor, Tensor, MieEfficiencies, Tensor]:
    """The widths are those of the counted diameter; a given density sets the physical one through the mass.

    The nodes are spaced for the dry flake, which the melting one never exceeds.
    """
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
    index = wet_snow_refractive_index_microwave(frequency_ghz, bulk, melt_fraction, celsius)
    outline = wet_flake_diameter_mm(diameter, mass_diameter, melt_fraction)
    q = mie_efficiencies(math.pi * 1e6 / wavelength_nm * outline, index)
    counted = mass_diameter if melted else physical_diameter_mm(mass_diameter)
    # ln-widths: dD_counted = D_counted (d ln D_counted / d ln D_phys) dln D_phys, the slope by differences
    slope = torch.gradient(torch.log(counted), spacing=(torch.log(diameter),), edge_order=2)[0]
    return outline, width / diameter * counted * slope, q, counted
