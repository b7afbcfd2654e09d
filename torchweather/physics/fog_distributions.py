"""Named fog droplet distributions: measured ones as they are, and shapes scaled to a visibility."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TypeVar

import torch
from torch import Tensor

from torchweather.core.arguments import check_arguments
from torchweather.core.errors import InputValueError, check_one_of, check_positive
from torchweather.physics.extinction import extinction_per_m
from torchweather.physics.float64 import Quantity, to_float64
from torchweather.physics.size_distributions import LogNormal, ModifiedGamma, SizeDistribution
from torchweather.physics.visibility import MOR_CONTRAST, extinction_from_mor, liquid_water_from_mor_g_per_m3

__all__ = [
    "FOG",
    "advection_fog",
    "bernardin",
    "default_fog",
    "deirmendjian_fog",
    "rehearse_fog",
    "scaled_to_visibility",
]

MOR_WAVELENGTH_NM = 550.0  # the eye's: where alpha = ln 20 / V defines the visibility, PHYSICS.md 2.3

# REHEARSE CEREMA fogs, D3.4 Table 5 with the unrounded values of its code: N cm^-3, ln median radius (um), sigma
REHEARSE = {
    10: (6108.486, 0.484235252, 0.74651233),
    20: (3559.641, 0.362382125, 0.777099786),
    30: (2754.154, 0.334042672, 0.742155699),
    50: (3189.711, 0.118386081, 0.656240841),
}

# Rasshofer et al. 2011 after the LISA repository: N cm^-3, alpha, gamma, mode radius um; PHYSICS.md 2.2
DEIRMENDJIAN = {
    "strong-advection": (20.0, 3.0, 1.0, 10.0),
    "moderate-advection": (20.0, 3.0, 1.0, 8.0),
    "strong-spray": (100.0, 6.0, 1.0, 4.0),
    "moderate-spray": (100.0, 6.0, 1.0, 2.0),
    "chu-hogg": (20.0, 2.0, 0.5, 1.0),
}

# Advection fog: effective radius 10 um and mode radius 5 um give alpha = 3 r_c / (r_e - r_c) = 3, PHYSICS.md 2.3
ADVECTION_ALPHA, ADVECTION_MODE_RADIUS_UM = 3.0, 5.0

AnyDistribution = TypeVar("AnyDistribution", bound=SizeDistribution)


def scaled_to_visibility(
    distribution: AnyDistribution, mor_m: Quantity, contrast: float = MOR_CONTRAST
) -> AnyDistribution:
    """The same shape with as many droplets as make Mie extinction at 550 nm equal ``-ln(contrast) / V``.

    Args:
        distribution: any shape; its number does not matter.
        mor_m: V, m, above 0; broadcasts against the parameters; ``inf`` gives no droplets. May require grad.
        contrast: threshold that defines the visibility.

    References:
        PHYSICS.md 2.3, 7.

    Example:
        >>> fog = scaled_to_visibility(bernardin(), 52.0)
        >>> round(0.05 ** -1 * float(torch.exp(-52.0 * extinction_per_m(fog, 550.0))), 6)
        1.0
    """
    check_arguments(
        "scaled_to_visibility(distribution: SizeDistribution, mor_m: Quantity, contrast: float)",
        distribution,
        mor_m,
        contrast,
    )
    wanted = extinction_from_mor(mor_m, contrast)
    return distribution.scaled(wanted / extinction_per_m(distribution, MOR_WAVELENGTH_NM))


def rehearse_fog(nominal_mor_m: int) -> LogNormal:
    """Fog measured in the CEREMA tunnel at a nominal visibility of 10, 20, 30 or 50 m, unscaled.

    Note:
        Mie gives a visibility about 10 % below the nominal one (9.0, 17.9, 27.1, 44.6 m at 530 nm). The printed
        parameters at 10 and 50 m differ; these are the unrounded ones that reproduce D3.4's Table 13.

    References:
        PHYSICS.md 2.3; D3.4 Table 5.

    Example:
        >>> round(float(rehearse_fog(50).liquid_water_g_per_m3()), 3)
        0.132
    """
    check_arguments("rehearse_fog(nominal_mor_m: int)", nominal_mor_m)
    if int(nominal_mor_m) not in REHEARSE:
        raise InputValueError(f"rehearse_fog: nominal_mor_m must be one of 10, 20, 30, 50 m; got {nominal_mor_m!r}.")
    number, log_median, sigma = REHEARSE[int(nominal_mor_m)]
    return LogNormal(number, math.exp(log_median), sigma)


def bernardin() -> LogNormal:
    """Fog of Bernardin et al. 2010: 1330 cm^-3, ln of the median radius 0.44 (um), sigma 0.59; Mie visibility 67 m.

    References:
        PHYSICS.md 2.3; D3.4 Table 2 ("52 m visibility", unit of N not verified).

    Example:
        >>> round(float(bernardin().liquid_water_g_per_m3()), 2)
        0.1
    """
    return LogNormal(1330.0, math.exp(0.44), 0.59)


def deirmendjian_fog(name: str) -> ModifiedGamma:
    """Modified gamma fog of Rasshofer et al. 2011 by name, unscaled.

    Args:
        name: ``strong-advection``, ``moderate-advection``, ``strong-spray``, ``moderate-spray`` or ``chu-hogg``.

    References:
        PHYSICS.md 2.2.

    Example:
        >>> round(float(deirmendjian_fog("strong-advection").total_per_m3))
        20000000
    """
    check_arguments("deirmendjian_fog(name: str)", name)
    check_one_of("name", name, DEIRMENDJIAN, owner="deirmendjian_fog")
    return ModifiedGamma(*DEIRMENDJIAN[name])


def advection_fog(mor_m: Quantity, *, variant: str = "default", contrast: float = MOR_CONTRAST) -> ModifiedGamma:
    """Advection fog of a visibility: modified gamma, gamma = 1, alpha = 3, effective radius 10 um.

    Args:
        mor_m: V, m, above 0, ``(...,)``; ``inf`` gives no droplets. May require grad.
        variant: ``"default"`` scales the number to the visibility (Mie at 550 nm); ``"liquid-water"`` to Grabner &
            Kvicera's liquid water content, as D3.4 does (not consistent with the visibility at short range).
        contrast: threshold that defines the visibility (default variant).

    References:
        PHYSICS.md 2.3.

    Example:
        >>> round(float(advection_fog(100.0, variant="liquid-water").number_per_cm3), 1)
        82.0
    """
    check_arguments("advection_fog(mor_m: Quantity, variant: str, contrast: float)", mor_m, variant, contrast)
    check_one_of("variant", variant, ("default", "liquid-water"), owner="advection_fog")
    shape = ModifiedGamma(1.0, ADVECTION_ALPHA, 1.0, ADVECTION_MODE_RADIUS_UM)
    if variant == "default":
        return scaled_to_visibility(shape, mor_m, contrast)
    return shape.scaled(liquid_water_from_mor_g_per_m3(mor_m) / shape.liquid_water_g_per_m3())


def default_fog(mor_m: Quantity, contrast: float = MOR_CONTRAST) -> LogNormal:
    """Fog of a visibility: the log-normal measured nearest to it, with the number that gives exactly this visibility.

    ln of the median radius and sigma are interpolated in ln V between the REHEARSE fogs and held outside 10-50 m; N
    makes Mie extinction at 550 nm equal ``ln 20 / V``: continuous and monotone in V.

    Args:
        mor_m: V, m, above 0, ``(...,)``; ``inf`` gives no droplets. May require grad.
        contrast: threshold that defines the visibility.

    References:
        PHYSICS.md 7.

    Example:
        >>> fog = default_fog(torch.tensor([50.0, 200.0]))
        >>> extinction_per_m(fog, 550.0).round(decimals=4)
        tensor([0.0599, 0.0150], dtype=torch.float64)
    """
    check_arguments("default_fog(mor_m: Quantity, contrast: float)", mor_m, contrast)
    check_positive("mor_m", mor_m, unit="m", owner="default_fog", advice="Clear air is mor_m=inf.")
    (mor,) = to_float64(mor_m)
    log_median, sigma = _rehearse_between(mor)
    shape = LogNormal(torch.ones_like(mor), torch.exp(log_median), sigma)
    return scaled_to_visibility(shape, mor, contrast)


def _rehearse_between(mor_m: Tensor) -> tuple[Tensor, Tensor]:
    """ln of the median radius (um) and sigma, linear in ln V between the measured fogs, held outside."""
    log_v = torch.log(mor_m.clamp(10.0, 50.0))
    nodes = [math.log(v) for v in REHEARSE]
    rows = list(REHEARSE.values())
    log_median = torch.full_like(log_v, rows[0][1])
    sigma = torch.full_like(log_v, rows[0][2])
    for k in range(len(nodes) - 1):  # a sum of ramps: elementwise and differentiable
        ramp = ((log_v - nodes[k]) / (nodes[k + 1] - nodes[k])).clamp(0.0, 1.0)
        log_median = log_median + ramp * (rows[k + 1][1] - rows[k][1])
        sigma = sigma + ramp * (rows[k + 1][2] - rows[k][2])
    return log_median, sigma


def _advection_by_liquid_water(mor_m: Quantity) -> ModifiedGamma:
    return advection_fog(mor_m, variant="liquid-water")


def _deirmendjian_by_visibility(name: str) -> Callable[[Quantity], SizeDistribution]:
    return lambda mor_m: scaled_to_visibility(deirmendjian_fog(name), mor_m)


def _bernardin_by_visibility(mor_m: Quantity) -> LogNormal:
    return scaled_to_visibility(bernardin(), mor_m)


FOG: dict[str, Callable[[Quantity], SizeDistribution]] = {
    "default": default_fog,
    "advection": advection_fog,
    "advection-liquid-water": _advection_by_liquid_water,
    "bernardin": _bernardin_by_visibility,
    **{name: _deirmendjian_by_visibility(name) for name in DEIRMENDJIAN},
}
"""Fog droplet distributions: name to function of the visibility (MOR) in m; fixed shapes are scaled to it."""
