"""Reflectivity of a snow flake for a LiDAR: a thin cloud of ice grains, not a pack of snow."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from torchweather.core.arguments import check_broadcast
from torchweather.core.errors import check_at_least, check_between, check_positive
from torchweather.physics.float64 import Quantity, to_float64
from torchweather.physics.refractive_index import ice_refractive_index

__all__ = ["FLAKE_COLUMN_KG_PER_M2", "SNOW_PACK_REFLECTIVITY", "flake_reflectivity"]

FLAKE_COLUMN_KG_PER_M2 = 0.12
"""Mass of a flake over its cross-section, ``2/3 rho_s D``: 0.12 kg/m^2 at 1 mm and 0.14 at 10 mm (Brandes' density)."""
SNOW_PACK_REFLECTIVITY = 0.9
"""Of a deep layer of fresh snow, which Hahner et al. 2022 give to flakes."""
ICE_DENSITY_KG_PER_M3 = 917.0
CONSERVATIVE = 1e-9  # least share that a grain absorbs, so that a layer without absorption has a finite k


def flake_reflectivity(
    wavelength_nm: Quantity,
    *,
    grain_radius_um: Quantity = 100.0,
    asymmetry: Quantity = 0.77,
    column_kg_per_m2: Quantity = FLAKE_COLUMN_KG_PER_M2,
) -> Tensor:
    """Diffuse reflectivity of a flake, 0 to 1: a layer of ice grains of optical depth 1 to 4, over black.

    ``tau = 3/2 column / (rho_ice r)`` (geometric optics, extinction efficiency 2). Half of it is diffraction, which
    goes straight on; a grain absorbs the share ``A = 1 - exp(-(4/3) (4 pi kappa / lambda) r f(n))`` of the other half,
    ``f = (n^3 - (n^2 - 1)^(3/2)) / n`` being the lengthening of paths in a weakly absorbing sphere. The layer is a
    two-stream one: ``R = g2 tanh(k tau/2) / (k + g1 tanh(k tau/2))``, ``k^2 = g1^2 - g2^2``,
    ``g1 = 3/4 (2 - w (1 + g'))``, ``g2 = 3/4 w (1 - g')``, ``w = 1 - A``, ``g' = 2 g - 1``. Where nothing is absorbed
    that is ``x / (1 + x)``, ``x = 3/4 (1 - g) tau``. Photons followed through the layer give 0.28 for its 0.25 in the
    visible, and 0.08 for its 0.09 at 1,550 nm.

    Args:
        wavelength_nm: of the laser, nm, 185 to 2,500, any shape.
        grain_radius_um: of the ice grains, micrometres; 50 to 200 is plausible, a factor of 2 to either side.
        asymmetry: g of a grain, 0.5 to 1: 0.77 for crystals, 0.89 for spheres.
        column_kg_per_m2: mass of the flake over its cross-section.

    Returns:
        Float64 of the broadcast shape. Known within a factor of 2: the grains' size is not measured by a LiDAR.

    Raises:
        InputValueError: a value outside its range.

    References:
        PHYSICS.md 10.3. Two-stream: Meador and Weaver 1980, J. Atmos. Sci. 37. Absorption of a large sphere: Bohren and
        Huffman 1983, 7.1.

    Example:
        >>> flake_reflectivity(torch.tensor([532.0, 905.0, 1550.0])).round(decimals=3)
        tensor([0.2530, 0.2520, 0.0940], dtype=torch.float64)
    """
    owner = "flake_reflectivity"
    wavelength, radius, g, column = to_float64(wavelength_nm, grain_radius_um, asymmetry, column_kg_per_m2)
    check_broadcast(owner, wavelength_nm=wavelength, grain_radius_um=radius, asymmetry=g, column_kg_per_m2=column)
    check_positive("grain_radius_um", radius, unit="um", owner=owner)
    check_between("asymmetry", g, 0.5, 1.0, owner=owner)
    check_at_least("column_kg_per_m2", column, 0.0, unit="kg/m^2", owner=owner)
    index = ice_refractive_index(wavelength)
    n, kappa = index.real, index.imag
    tau = 1.5 * column / (ICE_DENSITY_KG_PER_M3 * radius * 1e-6)
    lengthened = (n**3 - (n**2 - 1) ** 1.5) / n
    path_m = (4 / 3) * radius * 1e-6 * lengthened
    scattered = torch.exp(-(4 * math.pi * kappa / (wavelength * 1e-9)) * path_m).clamp_max(1 - CONSERVATIVE)
    broad = 2 * g - 1  # asymmetry without the diffraction, half of all light, which has 1
    out = 0.75 * (2 - scattered * (1 + broad))
    back = 0.75 * scattered * (1 - broad)
    k = torch.sqrt(out**2 - back**2)
    fall = torch.tanh(k * tau / 2)
    return back * fall / (k + out * fall)
