"""Light that drops and flakes scatter into a direction, per steradian and per light on their outline."""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from torchweather.core.arguments import check_arguments
from torchweather.core.errors import check_between
from torchweather.physics.extinction import rain_q_back
from torchweather.physics.float64 import Quantity, to_float64

__all__ = ["drop_scattering_per_sr", "flake_scattering_per_sr"]

WATER_INDEX = 1.33  # visible
HALF_TURN_RAD = math.pi + 1e-6  # pi in single precision is above pi
BIN_RAD = math.radians(3.0)  # wider than a rainbow, which real drops smear as well
RAYS = 60_000


def drop_scattering_per_sr(angle_rad: Quantity, wavelength_nm: float = 550.0) -> Tensor:
    """Share of the light on a drop's disk that it sends into a direction, 1/sr, by geometric optics.

    Reflection, refraction and one reflection inside, in bins of 3 degrees; backward no less than what a LiDAR takes
    for drops, ``rain_q_back / (4 pi)``. Diffraction, which goes onward by less than a degree, is left out.

    Args:
        angle_rad: between the light's direction and the scattered one: 0 is onward, pi back.
        wavelength_nm: of the backward value.

    Returns:
        float64, of the shape of ``angle_rad``.

    References:
        van de Hulst 1957, chapter 12; PHYSICS.md 3.2, 4.1.

    Example:
        >>> onward, back = drop_scattering_per_sr(torch.tensor([0.2, 3.1]))
        >>> bool(onward > 20 * back)
        True
    """
    check_arguments("drop_scattering_per_sr(angle_rad: Quantity, wavelength_nm: float)", angle_rad, wavelength_nm)
    (angle,) = to_float64(angle_rad)
    check_between("angle_rad", angle, 0.0, HALF_TURN_RAD, unit="rad", owner="drop_scattering_per_sr")
    middle, per_sr = _geometric_optics()
    found = torch.from_numpy(np.asarray(np.interp(angle.cpu().numpy(), middle, per_sr))).to(angle.device)
    back = rain_q_back(wavelength_nm) / (4.0 * math.pi)
    return torch.where(angle > 0.5 * math.pi, found.clamp_min(back), found)


@lru_cache(maxsize=1)
def _geometric_optics() -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """Middles of the bins, rad, and the share of the light on a sphere's disk in each, 1/sr."""
    t = (np.arange(RAYS) + 0.5) / RAYS  # sin^2 of the angle of incidence is uniform over the disk
    into = np.arcsin(np.sqrt(t))
    inside = np.arcsin(np.sqrt(t) / WATER_INDEX)
    upright = (np.cos(into) - WATER_INDEX * np.cos(inside)) / (np.cos(into) + WATER_INDEX * np.cos(inside))
    parallel = (WATER_INDEX * np.cos(into) - np.cos(inside)) / (WATER_INDEX * np.cos(into) + np.cos(inside))
    edges = np.linspace(0.0, math.pi, round(math.pi / BIN_RAD) + 1)
    power = np.zeros(len(edges) - 1)
    for reflectance in (upright**2, parallel**2):
        ways = (
            (reflectance, math.pi - 2.0 * into),
            ((1.0 - reflectance) ** 2, 2.0 * (into - inside)),
            ((1.0 - reflectance) ** 2 * reflectance, np.abs(math.pi + 2.0 * into - 4.0 * inside)),
        )
        for share, turn in ways:
            power += 0.5 * np.histogram(turn, edges, weights=share)[0] / RAYS
    solid_angle_sr = 2.0 * math.pi * (np.cos(edges[:-1]) - np.cos(edges[1:]))
    return 0.5 * (edges[1:] + edges[:-1]), power / solid_angle_sr


def flake_scattering_per_sr(angle_rad: Quantity, albedo: float, reflectivity: float) -> Tensor:
    """Share of the light on a flake's outline that it sends into a direction, 1/sr.

    ``albedo (1 + b cos) / (4 pi)``: all of it adds up to the albedo, and straight back goes ``reflectivity / pi``, as a
    LiDAR sees it. With the defaults of ``Snow`` it is nearly even.

    Args:
        angle_rad: 0 is onward, pi back.
        albedo: share of the light that a flake scatters, above 0 to 1.
        reflectivity: of a flake seen from the light, 0 to 1; more than half of the albedo counts as half.

    References:
        PHYSICS.md 10.2, 10.3.

    Example:
        >>> back = flake_scattering_per_sr(math.pi, 0.9, 0.25)
        >>> round(float(back) * math.pi, 2)
        0.25
    """
    check_arguments(
        "flake_scattering_per_sr(angle_rad: Quantity, albedo: float, reflectivity: float)",
        angle_rad,
        albedo,
        reflectivity,
    )
    (angle,) = to_float64(angle_rad)
    owner = "flake_scattering_per_sr"
    check_between("angle_rad", angle, 0.0, HALF_TURN_RAD, unit="rad", owner=owner)
    check_between("albedo", albedo, 1e-6, 1.0, owner=owner)
    check_between("reflectivity", reflectivity, 0.0, 1.0, owner=owner)
    slope = max(1.0 - 4.0 * reflectivity / albedo, -1.0)
    return albedo * (1.0 + slope * torch.cos(angle)) / (4.0 * math.pi)
