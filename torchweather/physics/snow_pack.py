r"""Snow that lies: how white it is for a camera or a LiDAR, and which share of a surface it covers.

Light that snow scatters many times leaves a deep layer with the albedo

    r = exp(-K sqrt(alpha d)),  alpha = 4 pi kappa / lambda,

with the effective diameter d of its grains, kappa of ice and ``K = 4/3 sqrt(B / (1 - g)) = 3.62``, B = 1.27 being the
absorption enhancement and g = 0.8275 the asymmetry of irregular grains. It falls from 0.98 in the visible to 0.8 to 0.9
at 905 nm and to 0.05 to 0.25 at 1550 nm.

References:
    Kokhanovsky and Zege 2004, Appl. Opt. 43, 1589 (weak absorption: within 3 % below 1.1 um; at 1550 nm order of
    magnitude). Warren 1982, Rev. Geophys. 20, 67; Wiscombe and Warren 1980, J. Atmos. Sci. 37, 2712.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor

from torchweather.core.arguments import check_arguments, check_broadcast
from torchweather.core.errors import check_between
from torchweather.physics.float64 import Quantity, to_float64
from torchweather.physics.refractive_index import ice_refractive_index

__all__ = ["snow_pack_albedo", "snow_share"]

ENHANCEMENT, ASYMMETRY = 1.27, 0.8275  # B and g of irregular grains
GRAIN_RADIUS_UM = (20.0, 2000.0)
ROUGHNESS_MM = 5.0  # depth that covers 1 - 1/e of asphalt or short grass; order of magnitude
# Upward component of the normal: snow slides off a surface steeper than 60 degrees and stays on one up to 30 degrees.
BARE_UP, FULL_UP = 0.5, math.sqrt(0.75)


def snow_pack_albedo(wavelength_nm: Quantity, grain_radius_um: Quantity = 100.0) -> Tensor:
    """Albedo of a deep layer of dry snow for diffuse light, 0 to 1.

    Args:
        wavelength_nm: 300 to 1700 nm.
        grain_radius_um: effective radius of the grains, 20 to 2000 um: fresh snow 50 to 100, old snow 500.

    Returns:
        Float64 of the broadcast shape.

    Raises:
        InputValueError: a value outside its range.

    Example:
        >>> snow_pack_albedo(torch.tensor([550.0, 905.0, 1550.0])).round(decimals=2)
        tensor([0.9900, 0.8800, 0.0500], dtype=torch.float64)
        >>> snow_pack_albedo(torch.tensor([905.0, 1550.0]), 20.0).round(decimals=2)
        tensor([0.9500, 0.2600], dtype=torch.float64)
    """
    owner = "snow_pack_albedo"
    check_broadcast(owner, wavelength_nm=wavelength_nm, grain_radius_um=grain_radius_um)
    wavelength, radius = to_float64(wavelength_nm, grain_radius_um)
    check_between("wavelength_nm", wavelength, 300.0, 1700.0, unit="nm", owner=owner)
    check_between("grain_radius_um", radius, *GRAIN_RADIUS_UM, unit="um", owner=owner)
    absorbed_per_m = 4e9 * math.pi * ice_refractive_index(wavelength).imag / wavelength
    strength = 4.0 / 3.0 * math.sqrt(ENHANCEMENT / (1.0 - ASYMMETRY))
    return torch.exp(-strength * torch.sqrt(absorbed_per_m * 2e-6 * radius))


def snow_share(depth_mm: Tensor, up: Tensor) -> Tensor:
    """Share of a surface that snow covers, 0 to 1: ``(1 - exp(-h / 5 mm)) s(up)``.

    ``s`` rises smoothly from 0 on what is steeper than 60 degrees to 1 on what is flatter than 30 degrees; both are
    orders of magnitude, as snow that sticks lies on steeper surfaces too.

    Args:
        depth_mm: of the snow on level ground, 0 or more.
        up: upward component of the unit normal, -1 to 1; broadcast against ``depth_mm``.

    Example:
        >>> snow_share(torch.tensor([0.0, 5.0, 50.0]), torch.tensor(1.0))
        tensor([0.0000, 0.6321, 1.0000])
        >>> float(snow_share(torch.tensor(50.0), torch.tensor(0.0)))  # a wall
        0.0
    """
    check_arguments("snow_share(depth_mm: floating, up: floating)", depth_mm, up)
    check_broadcast("snow_share", depth_mm=depth_mm, up=up)
    held = ((up - BARE_UP) / (FULL_UP - BARE_UP)).clamp(0.0, 1.0)
    held = held.square() * (3.0 - 2.0 * held)
    return -torch.expm1(-depth_mm / ROUGHNESS_MM) * held
