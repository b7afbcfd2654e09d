"""Size and density of a snowflake: physical and melted diameter, bulk density, rain of equal visibility."""

from __future__ import annotations

import torch
from torch import Tensor

from torchweather.core.arguments import check_arguments, check_broadcast
from torchweather.core.errors import check_at_least, check_between, check_one_of
from torchweather.physics.float64 import Quantity, to_float64

__all__ = [
    "MELTED_DIAMETER_MAX_MM",
    "MELTED_DIAMETER_MIN_MM",
    "equal_visibility_rain_rate",
    "melted_diameter_mm",
    "physical_diameter_mm",
    "snow_bulk_density_g_per_cm3",
    "wet_flake_diameter_mm",
]

SNOW_DENSITY_AT_1MM_G_PER_CM3 = 0.178  # Brandes et al. 2007, PHYSICS.md 2.4
SNOW_DENSITY_EXPONENT = -0.922  # Brandes et al. 2007; D3.4 prints -0.992 (typo)
SNOW_DENSITY_EXPONENT_D3_4 = -0.992
ICE_DENSITY_G_PER_CM3 = 0.917  # solid ice caps the law, PHYSICS.md 2.4

# Physical diameter below which the law exceeds solid ice: 0.169 mm.
SOLID_ICE_BELOW_MM = (ICE_DENSITY_G_PER_CM3 / SNOW_DENSITY_AT_1MM_G_PER_CM3) ** (1.0 / SNOW_DENSITY_EXPONENT)

PHYSICAL_DIAMETER_MAX_MM = 20.0  # largest flake of the default domain, PHYSICS.md 2.4
MELTED_DIAMETER_MIN_MM = 0.1  # PHYSICS.md 2.4
MELTED_DIAMETER_MAX_MM = (
    SNOW_DENSITY_AT_1MM_G_PER_CM3 * PHYSICAL_DIAMETER_MAX_MM ** (3.0 + SNOW_DENSITY_EXPONENT)
) ** (1.0 / 3.0)
"""Melted diameter of the largest flake of the default domain (20 mm across), mm."""

EQUAL_VISIBILITY_CONSTANT = 487.0  # Hahner et al. 2022; derived from equal extinction in PHYSICS.md 2.4


def physical_diameter_mm(melted_mm: Quantity) -> Tensor:
    """Diameter of the snowflake that melts to a drop of ``melted_mm``, mm.

    ``D_phys = max((D^3 / 0.178)^(1/2.078), D / 0.917^(1/3))``: mass is kept, the flake has Brandes' bulk density
    and is never denser than ice.

    Args:
        melted_mm: diameter of the melted flake, mm, any shape, 0 or more.

    Returns:
        Physical diameter, mm, float64, same shape.

    References:
        PHYSICS.md 2.4; Brandes et al. 2007.

    Example:
        >>> round(float(physical_diameter_mm(1.0)), 4)
        2.2947
    """
    check_arguments("physical_diameter_mm(melted_mm: Quantity)", melted_mm)
    (melted,) = to_float64(melted_mm)
    check_at_least("melted_mm", melted, 0.0, unit="mm", owner="physical_diameter_mm")
    power = 1.0 / (3.0 + SNOW_DENSITY_EXPONENT)
    loose = (melted**3 / SNOW_DENSITY_AT_1MM_G_PER_CM3) ** power
    return torch.maximum(loose, melted / ICE_DENSITY_G_PER_CM3 ** (1.0 / 3.0))


def melted_diameter_mm(physical_mm: Quantity) -> Tensor:
    """Diameter of the drop to which a snowflake of ``physical_mm`` melts, mm: the inverse of the above.

    Args:
        physical_mm: diameter of the flake, mm, any shape, 0 or more.

    Example:
        >>> round(float(melted_diameter_mm(20.0)), 3)
        4.48
    """
    check_arguments("melted_diameter_mm(physical_mm: Quantity)", physical_mm)
    (physical,) = to_float64(physical_mm)
    check_at_least("physical_mm", physical, 0.0, unit="mm", owner="melted_diameter_mm")
    loose = (SNOW_DENSITY_AT_1MM_G_PER_CM3 * physical ** (3.0 + SNOW_DENSITY_EXPONENT)) ** (1.0 / 3.0)
    return torch.minimum(loose, physical * ICE_DENSITY_G_PER_CM3 ** (1.0 / 3.0))


def snow_bulk_density_g_per_cm3(physical_mm: Quantity, *, variant: str = "default") -> Tensor:
    """Mass over volume of a snowflake, g/cm^3: ``min(0.178 D^-0.922, 0.917)``, D its physical diameter in mm.

    Args:
        physical_mm: diameter of the flake, mm, any shape.
        variant: ``"d3_4"`` takes the exponent as D3.4 prints it (-0.992).

    References:
        PHYSICS.md 2.4; Brandes et al. 2007.

    Example:
        >>> snow_bulk_density_g_per_cm3(torch.tensor([0.1, 1.0, 10.0])).round(decimals=4)
        tensor([0.9170, 0.1780, 0.0213], dtype=torch.float64)
    """
    check_arguments("snow_bulk_density_g_per_cm3(physical_mm: Quantity, variant: str)", physical_mm, variant)
    check_one_of("variant", variant, ("default", "d3_4"), owner="snow_bulk_density_g_per_cm3")
    (physical,) = to_float64(physical_mm)
    check_at_least("physical_mm", physical, 0.0, unit="mm", owner="snow_bulk_density_g_per_cm3")
    exponent = SNOW_DENSITY_EXPONENT_D3_4 if variant == "d3_4" else SNOW_DENSITY_EXPONENT
    return (SNOW_DENSITY_AT_1MM_G_PER_CM3 * physical**exponent).clamp_max(ICE_DENSITY_G_PER_CM3)


def wet_flake_diameter_mm(physical_mm: Quantity, melted_mm: Quantity, melt_fraction: Quantity) -> Tensor:
    """Diameter of a snowflake of which a share of the mass has melted, mm: the volumes of dry snow and water added.

    ``D^3 = (1 - f) D_dry^3 + f D_melted^3``: the dry flake at f = 0 (exactly), its drop at f = 1.

    Args:
        physical_mm: diameter of the dry flake, mm, any shape.
        melted_mm: diameter of the drop it melts to, mm; broadcasts.
        melt_fraction: f, share of the mass that is liquid, 0 to 1; broadcasts.

    Note:
        The dry snow that is left keeps its bulk density, so the flake shrinks evenly with the melted mass.

    References:
        PHYSICS.md 2.4, 6.7 (the melted mass in the mixing rule).

    Example:
        >>> wet_flake_diameter_mm(2.2947, 1.0, torch.tensor([0.0, 0.5, 1.0])).round(decimals=3)
        tensor([2.2950, 1.8700, 1.0000], dtype=torch.float64)
    """
    check_arguments(
        "wet_flake_diameter_mm(physical_mm: Quantity, melted_mm: Quantity, melt_fraction: Quantity)",
        physical_mm,
        melted_mm,
        melt_fraction,
    )
    fraction, physical, melted = to_float64(melt_fraction, physical_mm, melted_mm)
    check_broadcast("wet_flake_diameter_mm", physical_mm=physical, melted_mm=melted, melt_fraction=fraction)
    check_between("melt_fraction", fraction, 0.0, 1.0, owner="wet_flake_diameter_mm")
    for name, diameter in (("physical_mm", physical), ("melted_mm", melted)):
        check_between(name, diameter, 0.0, 1e6, unit="mm", owner="wet_flake_diameter_mm")
    wet = ((1.0 - fraction) * physical**3 + fraction * melted**3) ** (1.0 / 3.0)
    return torch.where(fraction > 0, wet, physical)


def equal_visibility_rain_rate(
    snowfall_mm_per_h: Quantity,
    *,
    density_g_per_cm3: Quantity = 0.178,
    diameter_mm: Quantity = 1.0,
    fall_speed_m_per_s: Quantity = 1.6,
    variant: str = "default",
) -> Tensor:
    """Rain rate, mm/h, that dims as much as a snowfall; *not* the liquid equivalent of the snow.

    ``R = (S / (487 rho_s D v))^(3/2)``, D in metres: geometric snow extinction ``8.33e-7 S/(v rho_s D)`` set equal to
    that of rain, ``4.06e-4 R^(2/3)``.

    Args:
        snowfall_mm_per_h: liquid-equivalent snowfall, mm/h.
        density_g_per_cm3: bulk density of the flakes.
        diameter_mm: their diameter, mm.
        fall_speed_m_per_s: their speed, m/s.
        variant: ``"d3_4"`` has D3.4's exponent 3/4 in place of 3/2.

    References:
        PHYSICS.md 2.4; Hahner et al. 2022.

    Example:
        >>> round(float(equal_visibility_rain_rate(0.25)), 3)
        2.42
    """
    check_arguments(
        "equal_visibility_rain_rate(snowfall_mm_per_h: Quantity, density_g_per_cm3: Quantity, "
        "diameter_mm: Quantity, fall_speed_m_per_s: Quantity, variant: str)",
        snowfall_mm_per_h,
        density_g_per_cm3,
        diameter_mm,
        fall_speed_m_per_s,
        variant,
    )
    check_broadcast(
        "equal_visibility_rain_rate",
        snowfall_mm_per_h=snowfall_mm_per_h,
        density_g_per_cm3=density_g_per_cm3,
        diameter_mm=diameter_mm,
        fall_speed_m_per_s=fall_speed_m_per_s,
    )
    owner = "equal_visibility_rain_rate"
    check_one_of("variant", variant, ("default", "d3_4"), owner=owner)
    snowfall, density, diameter, speed = to_float64(
        snowfall_mm_per_h, density_g_per_cm3, diameter_mm, fall_speed_m_per_s
    )
    check_between("snowfall_mm_per_h", snowfall, 0.0, 1e6, unit="mm/h", owner=owner)
    check_between("density_g_per_cm3", density, 1e-6, 1.0, unit="g/cm3", owner=owner)
    check_between("diameter_mm", diameter, 1e-6, 1e6, unit="mm", owner=owner)
    check_between("fall_speed_m_per_s", speed, 1e-6, 100.0, unit="m/s", owner=owner)
    base = snowfall / (EQUAL_VISIBILITY_CONSTANT * density * diameter * 1e-3 * speed)
    return base ** (0.75 if variant == "d3_4" else 1.5)
