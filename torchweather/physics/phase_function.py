"""Phase function of a cloud of particles: the share of the scattered light that goes into each direction."""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
import torch
from torch import Tensor

from torchweather.core.arguments import check_arguments, check_broadcast
from torchweather.core.errors import InputValueError, check_between
from torchweather.physics.efficiency_table import size_nodes_mm
from torchweather.physics.extinction import support_mm
from torchweather.physics.float64 import Quantity, to_float64
from torchweather.physics.mie import mie_scattered_power
from torchweather.physics.refractive_index import water_refractive_index
from torchweather.physics.size_distribution import SizeDistribution

__all__ = ["henyey_greenstein_per_sr", "mie_phase_function_per_sr"]

NM_PER_MM = 1e6
HALF_TURN_RAD = math.pi + 1e-6  # pi in single precision is above pi
SIZE_PARAMETER_HIGH = 4000.0  # pi D / lambda of the largest drop that is summed; fog of 20 m reaches 2100


def mie_phase_function_per_sr(
    distribution: SizeDistribution, wavelength_nm: float, angle_rad: Quantity, *, temperature_c: float = 10.0
) -> Tensor:
    """Phase function of droplets of fog by Mie theory, 1/sr; its integral over the sphere is 1.

    ``p = int (|S1|^2 + |S2|^2) N dD / (k^2 int C_sca N dD) / 2`` for unpolarised light.

    Args:
        distribution: droplets, parameters without a batch shape; size parameters up to 4,000 (0.7 mm at 550 nm).
        wavelength_nm: vacuum wavelength, nm, 300-2500.
        angle_rad: scattering angles, 0 (onward) to pi (back), any shape.
        temperature_c: of the water, deg C.

    Returns:
        1/sr, float64, of the shape of ``angle_rad``.

    Note:
        The sizes are a trapezoid in ln D. The mean cosine of the result is the asymmetry of ``mie_efficiencies``
        within 1e-3, and its value at 180 degrees that of ``backscatter_per_m_sr`` within 1 %.

    References:
        Bohren & Huffman 1983, chapter 4 (equations 4.74, 4.77); PHYSICS.md 3.1.

    Example:
        >>> from torchweather.physics import rehearse_fog
        >>> ahead, back = mie_phase_function_per_sr(rehearse_fog(30), 550.0, torch.tensor([0.0, math.pi]))
        >>> bool(ahead > 1e3 * back)
        True
    """
    check_arguments(
        "mie_phase_function_per_sr(distribution: SizeDistribution, wavelength_nm: float, angle_rad: Quantity, "
        "temperature_c: float)",
        distribution,
        wavelength_nm,
        angle_rad,
        temperature_c,
    )
    owner = "mie_phase_function_per_sr"
    check_between("wavelength_nm", wavelength_nm, 300.0, 2500.0, unit="nm", owner=owner)
    (angle,) = to_float64(angle_rad)
    check_between("angle_rad", angle, 0.0, HALF_TURN_RAD, unit="rad", owner=owner)
    if distribution.batch_shape:
        raise InputValueError(
            f"{owner}: expected a distribution of one fog; got the batch shape {tuple(distribution.batch_shape)}. "
            "Call it once for each."
        )
    low_mm, high_mm = support_mm(distribution)
    largest = math.pi * NM_PER_MM / wavelength_nm * high_mm
    if largest > SIZE_PARAMETER_HIGH:
        raise InputValueError(
            f"{owner}: expected droplets of a size parameter pi D / lambda up to {SIZE_PARAMETER_HIGH:g}; got "
            f"{largest:.0f} ({high_mm:g} mm). Drops of rain and flakes scatter by geometric optics."
        )
    diameter, width, scattered, per_sr = _scattered_by_size(
        low_mm, high_mm, float(wavelength_nm), float(temperature_c), tuple(angle.cpu().reshape(-1).tolist())
    )
    number = distribution.number_density_per_m3_mm(diameter).detach().to(diameter) * width
    found = (number @ per_sr) / (number @ scattered)
    return found.reshape(angle.shape).to(angle.device)


@lru_cache(maxsize=16)
def _scattered_by_size(
    low_mm: float, high_mm: float, wavelength_nm: float, temperature_c: float, angle_rad: tuple[float, ...]
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Diameters and widths ``(K,)``, mm; scattered power, in all ``(K,)`` and per sr ``(K, A)``, in units of 1/k^2."""
    diameter, width = size_nodes_mm(low_mm, high_mm, wavelength_nm)
    x = (math.pi * NM_PER_MM / wavelength_nm * diameter).numpy()
    index = complex(water_refractive_index(wavelength_nm, temperature_c))
    scattered, per_sr = mie_scattered_power(x, index, np.array(angle_rad))
    return diameter, width, torch.from_numpy(scattered), torch.from_numpy(per_sr)


def henyey_greenstein_per_sr(angle_rad: Quantity, asymmetry: Quantity) -> Tensor:
    """Henyey and Greenstein's phase function, 1/sr: ``(1 - g^2) / (4 pi (1 + g^2 - 2 g cos)^1.5)``.

    Args:
        angle_rad: scattering angle, 0 to pi.
        asymmetry: mean cosine g, -1 to 1 (neither), broadcast against it.

    Returns:
        1/sr, float64.

    References:
        Henyey & Greenstein, Astrophys. J. 93, 70 (1941).

    Example:
        >>> bool(henyey_greenstein_per_sr(0.3, 0.0).isclose(torch.tensor(1.0 / (4.0 * math.pi)).double()))
        True
    """
    check_arguments("henyey_greenstein_per_sr(angle_rad: Quantity, asymmetry: Quantity)", angle_rad, asymmetry)
    check_broadcast("henyey_greenstein_per_sr", angle_rad=angle_rad, asymmetry=asymmetry)
    angle, g = to_float64(angle_rad, asymmetry)
    check_between("angle_rad", angle, 0.0, HALF_TURN_RAD, unit="rad", owner="henyey_greenstein_per_sr")
    check_between("asymmetry", g, -0.9999, 0.9999, owner="henyey_greenstein_per_sr")
    return (1.0 - g * g) / (4.0 * math.pi * (1.0 + g * g - 2.0 * g * torch.cos(angle)) ** 1.5)
