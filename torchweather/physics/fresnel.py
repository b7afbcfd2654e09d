"""Light on a sphere by geometric optics: what it reflects, refracts, and sends straight back."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from torchweather.core.arguments import check_arguments, check_broadcast
from torchweather.core.errors import InputValueError, check_at_least, check_between, check_positive
from torchweather.physics.float64 import Quantity, to_complex128, to_float64

__all__ = ["SphereBudget", "axial_q_back", "normal_reflectance", "sphere_budget"]


class SphereBudget(NamedTuple):
    """Budget of unpolarised light on a transparent sphere; shares of the light on its disk, summing to 1."""

    external_reflection: float
    """Reflected at the outside."""
    refraction: float
    """Refracted twice, straight through (p = 1): what a raindrop shows of the scene."""
    one_internal: float
    """Reflected once inside (p = 2), the rainbow's light."""
    rest: float
    """Two internal reflections and more."""
    full_field_of_view_deg: float
    """Full angle of the scene seen by refraction: ``2 (pi - 2 asin(1/n))``."""


def sphere_budget(refractive_index: float, panels: int = 4096) -> SphereBudget:
    """Fresnel budget of a sphere: reflected, refracted and internally reflected shares, averaged over the disk.

    Args:
        refractive_index: n, above 1, real.
        panels: midpoints of the integral over the disk.

    Note:
        The 0.94 and 0.06 of a raindrop's colour are these numbers for n = 1.33, rounded.

    References:
        PHYSICS.md 4.1; Garg & Nayar 2007.

    Example:
        >>> budget = sphere_budget(1.33)
        >>> [round(v, 3) for v in budget]
        [0.066, 0.885, 0.04, 0.009, 164.986]
    """
    check_arguments("sphere_budget(refractive_index: float, panels: int)", refractive_index, panels)
    check_between("panels", panels, 1, 1 << 24, owner="sphere_budget")
    refractive_index, panels = float(refractive_index), int(panels)
    if not 1.0 < refractive_index <= 1e6:
        raise InputValueError(
            f"sphere_budget: refractive_index must be a real number above 1; got {refractive_index!r}."
        )
    # sin^2 of the angle of incidence is uniform over the disk; its midpoint grid crowds towards grazing incidence,
    # where the reflectance rises steeply.
    t = (np.arange(panels) + 0.5) / panels
    one_minus = t**4
    weight = 4.0 * t**3 / panels
    cos_i = np.sqrt(one_minus)
    cos_t = np.sqrt(1.0 - (1.0 - one_minus) / refractive_index**2)
    across = ((cos_i - refractive_index * cos_t) / (cos_i + refractive_index * cos_t)) ** 2
    along = ((refractive_index * cos_i - cos_t) / (refractive_index * cos_i + cos_t)) ** 2
    outside, through, once = 0.0, 0.0, 0.0
    for reflectance in (across, along):  # half of the light in each polarisation
        outside += 0.5 * float((weight * reflectance).sum())
        through += 0.5 * float((weight * (1.0 - reflectance) ** 2).sum())
        once += 0.5 * float((weight * (1.0 - reflectance) ** 2 * reflectance).sum())
    view = math.degrees(2.0 * (math.pi - 2.0 * math.asin(1.0 / refractive_index)))
    return SphereBudget(outside, through, once, 1.0 - outside - through - once, view)


def normal_reflectance(refractive_index: complex | Tensor) -> Tensor:
    """Power reflected by a flat surface at normal incidence: ``|(m - 1) / (m + 1)|^2``, float64.

    Args:
        refractive_index: ``n + i k``, any shape.

    Example:
        >>> round(float(normal_reflectance(1.3284)), 4)
        0.0199
    """
    m = _checked_index(refractive_index, "normal_reflectance")
    return ((m - 1.0) / (m + 1.0)).abs() ** 2


def axial_q_back(
    refractive_index: complex | Tensor, *, diameter_mm: Quantity | None = None, wavelength_nm: Quantity | None = None
) -> Tensor:
    """Backscatter efficiency of a large sphere from its two axial glints, front and rear.

    ``R0 [1 + (1 - R0)^2 (n / (2 - n))^2 exp(-8 pi k D / lambda)]``: the lower bound for raindrops.

    Args:
        refractive_index: ``n + i k``, n below 2.
        diameter_mm: D, mm; with ``wavelength_nm`` the rear glint is absorbed, without it k is ignored.
        wavelength_nm: lambda, nm.

    References:
        PHYSICS.md 3.2.

    Example:
        >>> round(float(axial_q_back(1.328)), 3)
        0.094
    """
    check_arguments(
        "axial_q_back(diameter_mm: Quantity | None, wavelength_nm: Quantity | None)",
        diameter_mm,
        wavelength_nm,
    )
    check_broadcast("axial_q_back", index=refractive_index, diameter_mm=diameter_mm, wavelength_nm=wavelength_nm)
    m = _checked_index(refractive_index, "axial_q_back")
    if not torch.compiler.is_compiling() and bool((m.real >= 2.0).any()):
        raise InputValueError(
            "axial_q_back: the real part of refractive_index must be below 2, where the rear glint has a focus; got "
            f"{float(m.real.detach().max()):g}."
        )
    reflected = normal_reflectance(torch.complex(m.real, torch.zeros_like(m.real)))
    rear = (1.0 - reflected) ** 2 * (m.real / (2.0 - m.real)) ** 2
    if diameter_mm is not None and wavelength_nm is not None:
        k, diameter, wavelength = to_float64(m.imag, diameter_mm, wavelength_nm)
        check_positive("wavelength_nm", wavelength, unit="nm", owner="axial_q_back")
        check_at_least("diameter_mm", diameter, 0.0, unit="mm", owner="axial_q_back")
        rear = rear * torch.exp(-8.0 * math.pi * k * diameter * 1e6 / wavelength)
    return reflected * (1.0 + rear)


def _checked_index(refractive_index: complex | Tensor, owner: str) -> Tensor:
    (m,) = to_complex128(refractive_index)
    check_between("the real part of refractive_index", m.real, 1e-3, 1e3, owner=owner)
    check_between("the imaginary part of refractive_index", m.imag, 0.0, 1e3, owner=owner)
    return m
