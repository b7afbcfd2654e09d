"""Visibility, extinction and liquid water of fog, each from the other."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from torchweather.core.arguments import check_arguments
from torchweather.core.errors import check_at_least, check_between, check_one_of, check_positive
from torchweather.physics.float64 import Quantity, to_float64

__all__ = [
    "LIQUID_WATER_LAWS",
    "extinction_from_mor",
    "liquid_water_from_mor_g_per_m3",
    "mor_from_extinction",
    "mor_from_liquid_water_m",
]

MOR_CONTRAST = 0.05  # WMO: the meteorological optical range leaves 5 % contrast; the older visual range took 2 %

# Liquid water W g/m^3 at visibility V m: W = a V^-b, PHYSICS.md 2.3
LIQUID_WATER_LAWS = {
    "grabner-kvicera": (36.489, 1.1407),  # Grabner & Kvicera 2009 (print not verified)
    "kunkel": (27.0 ** (1.0 / 0.88), 1.0 / 0.88),  # Kunkel 1984: V = 27 W^-0.88, a visual range of 2 % contrast
}


def extinction_from_mor(mor_m: Quantity, contrast: float = MOR_CONTRAST) -> Tensor:
    """Extinction coefficient, 1/m, that leaves ``contrast`` at the visibility: ``-ln(contrast) / V`` (Koschmieder).

    Args:
        mor_m: visibility, m, above 0, any shape; ``inf`` gives exactly 0. May require grad.
        contrast: threshold that defines the visibility: 0.05 (MOR, WMO) or 0.02 (older visual range).

    References:
        PHYSICS.md 4.8; WMO-No. 8.

    Example:
        >>> round(float(extinction_from_mor(100.0)), 6)
        0.029957
    """
    check_arguments("extinction_from_mor(mor_m: Quantity, contrast: float)", mor_m, contrast)
    check_positive("mor_m", mor_m, unit="m", owner="extinction_from_mor", advice="Clear air is mor_m=inf.")
    _check_contrast(contrast, "extinction_from_mor")
    (mor,) = to_float64(mor_m)
    return -math.log(contrast) / mor


def mor_from_extinction(extinction_per_m: Quantity, contrast: float = MOR_CONTRAST) -> Tensor:
    """Visibility, m, at an extinction coefficient: ``-ln(contrast) / alpha``; no extinction gives ``inf``.

    Args:
        extinction_per_m: power extinction, 1/m, 0 or more, any shape.
        contrast: as in ``extinction_from_mor``.

    Example:
        >>> round(float(mor_from_extinction(0.03)), 2)
        99.86
    """
    check_arguments("mor_from_extinction(extinction_per_m: Quantity, contrast: float)", extinction_per_m, contrast)
    check_at_least("extinction_per_m", extinction_per_m, 0.0, unit="1/m", owner="mor_from_extinction")
    _check_contrast(contrast, "mor_from_extinction")
    (extinction,) = to_float64(extinction_per_m)
    clear = extinction == 0
    mor = -math.log(contrast) / torch.where(clear, torch.ones_like(extinction), extinction)
    return torch.where(clear, torch.full_like(mor, math.inf), mor)


def liquid_water_from_mor_g_per_m3(mor_m: Quantity, law: str = "grabner-kvicera") -> Tensor:
    """Liquid water content of a fog from its visibility, g/m^3, by a regression.

    Args:
        mor_m: visibility, m, above 0, any shape; ``inf`` gives 0.
        law: ``"grabner-kvicera"`` (``36.489 V^-1.1407``) or ``"kunkel"`` (``(27 / V)^(1/0.88)``).

    Note:
        Regressions over many fogs; at 10-50 m the first is not consistent with Koschmieder's law for 10 um droplets.

    References:
        PHYSICS.md 2.3; Grabner & Kvicera 2009; Kunkel 1984.

    Example:
        >>> round(float(liquid_water_from_mor_g_per_m3(100.0)), 3)
        0.191
    """
    check_arguments("liquid_water_from_mor_g_per_m3(mor_m: Quantity, law: str)", mor_m, law)
    owner = "liquid_water_from_mor_g_per_m3"
    check_one_of("law", law, LIQUID_WATER_LAWS, owner=owner)
    check_positive("mor_m", mor_m, unit="m", owner=owner)
    (mor,) = to_float64(mor_m)
    factor, power = LIQUID_WATER_LAWS[law]
    water: Tensor = factor * mor**-power
    return water


def mor_from_liquid_water_m(liquid_water_g_per_m3: Quantity, law: str = "grabner-kvicera") -> Tensor:
    """Visibility, m, from the liquid water content of a fog: the inverse of the regression above.

    Args:
        liquid_water_g_per_m3: above 0, any shape.
        law: as in ``liquid_water_from_mor_g_per_m3``.

    Example:
        >>> round(float(mor_from_liquid_water_m(0.191, "grabner-kvicera")))
        100
    """
    check_arguments("mor_from_liquid_water_m(liquid_water_g_per_m3: Quantity, law: str)", liquid_water_g_per_m3, law)
    owner = "mor_from_liquid_water_m"
    check_one_of("law", law, LIQUID_WATER_LAWS, owner=owner)
    check_positive("liquid_water_g_per_m3", liquid_water_g_per_m3, unit="g/m^3", owner=owner)
    (water,) = to_float64(liquid_water_g_per_m3)
    factor, power = LIQUID_WATER_LAWS[law]
    return torch.pow(factor / water, 1.0 / power)


def _check_contrast(contrast: float, owner: str) -> None:
    check_arguments(f"{owner}(contrast: float)", contrast)
    check_between("contrast", contrast, 1e-6, 1.0 - 1e-6, owner=owner)
