"""Light that fog scatters onward by small angles: the modulation transfer of a path, as a sum of Gaussians.

A camera that looks through fog sees the light of a surface three ways: straight, a share ``exp(-tau)``; scattered once
or more by small angles, blurred; and in place of what was scattered aside, airlight. The first two together have the
transfer function of small-angle theory,

    H(f) = exp(-tau (1 - v(f))),  v(f) = int_0^1 P(f u) du,

with P the Hankel transform of the phase function up to ``FORWARD_RAD``, f in cycles per radian of the picture, and u
the place of the scattering, 0 at the surface and 1 at the camera: what is scattered near the surface is blurred least.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import torch
from scipy.integrate import trapezoid
from scipy.optimize import nnls
from scipy.special import itj0y0
from torch import Tensor

from torchweather.core.arguments import check_arguments
from torchweather.core.errors import check_at_least, check_between
from torchweather.physics.float64 import Quantity, to_float64
from torchweather.physics.phase_function import henyey_greenstein_per_sr, mie_phase_function_per_sr
from torchweather.physics.size_distribution import SizeDistribution

__all__ = ["ForwardScattering"]

# Light that is scattered by more counts as airlight. Photons traced through fog of 30 m visibility in front of a
# pattern (tests/reference/fog_photons.py): with 1 rad the transfer is within 0.01 of theirs from 1 cycle/rad on and
# 0.035 at 0.5 cycles/rad, at optical depths up to 5; with 0.5 rad it lacks up to 0.19, with pi/2 it has up to 0.06 too
# much.
FORWARD_RAD = 1.0
ANGLES = 1200
FREQUENCIES_PER_RAD = np.geomspace(0.1, 200.0, 96)  # at which the sum of Gaussians is fitted
WIDTHS_RAD = tuple(0.003 * 2.0**k for k in range(8))
"""Standard deviations of the Gaussians, rad: 0.17 to 22 degrees."""


@dataclass(frozen=True)
class ForwardScattering:
    """Transfer of the light that a fog scatters onward.

    Args:
        mean_transform: v at ``FREQUENCIES_PER_RAD``.
        share: of the scattered light that goes onward by less than ``FORWARD_RAD``, v(0).

    References:
        Wells, J. Opt. Soc. Am. 59, 686 (1969); Zege, Ivanov & Katsev 1991, Image Transfer Through a Scattering Medium.

    Example:
        >>> kernel = ForwardScattering.henyey_greenstein(0.85)
        >>> kernel.weights(torch.tensor([0.0, 2.0])).shape
        torch.Size([2, 8])
    """

    mean_transform: tuple[float, ...]
    share: float

    @classmethod
    def of_fog(
        cls, distribution: SizeDistribution, wavelength_nm: float, temperature_c: float = 10.0
    ) -> ForwardScattering:
        """The transfer of droplets of a size distribution, by Mie theory; no parameter is free.

        Args:
            distribution: of one fog.
            wavelength_nm: 300 to 2500 nm.
            temperature_c: of the water.
        """
        return _of_phase_function(
            lambda angle: mie_phase_function_per_sr(distribution, wavelength_nm, angle, temperature_c=temperature_c)
        )

    @classmethod
    @lru_cache(maxsize=32)
    def henyey_greenstein(cls, asymmetry: float) -> ForwardScattering:
        """The transfer of Henyey and Greenstein's phase function: without the peak of diffraction that fog has.

        Args:
            asymmetry: mean cosine of the scattering angle, -1 to 1 (neither); fog has 0.82 to 0.87.
        """
        check_arguments("ForwardScattering.henyey_greenstein(asymmetry: float)", asymmetry)
        return _of_phase_function(lambda angle: henyey_greenstein_per_sr(angle, asymmetry))

    def transfer(self, optical_depth: Quantity, frequency_per_rad: Quantity) -> Tensor:
        """H: contrast of a pattern behind the fog over that of the pattern, broadcast.

        Args:
            optical_depth: 0 or more.
            frequency_per_rad: of the pattern, 0.1 to 200 cycles per radian.
        """
        check_arguments(
            "ForwardScattering.transfer(optical_depth: Quantity, frequency_per_rad: Quantity)",
            optical_depth,
            frequency_per_rad,
        )
        depth, frequency = to_float64(optical_depth, frequency_per_rad)
        check_at_least("optical_depth", depth, 0.0, owner="ForwardScattering.transfer")
        check_between("frequency_per_rad", frequency, 0.1, 200.0, owner="ForwardScattering.transfer")
        known = np.interp(np.log(frequency.cpu().numpy()), np.log(FREQUENCIES_PER_RAD), self.mean_transform)
        return torch.exp(-depth * (1.0 - torch.from_numpy(np.asarray(known)).to(depth.device)))

    def weights(self, optical_depth: Tensor) -> Tensor:
        """Share of a surface's light that arrives blurred by each of ``WIDTHS_RAD``, beside ``exp(-tau)`` unblurred.

        Non-negative least squares to H over the frequencies; their sum is ``exp(-tau (1 - v(0))) - exp(-tau)``.

        Args:
            optical_depth: ``(N,)``, 0 or more.

        Returns:
            ``(N, 8)``, float64.
        """
        depth = optical_depth.detach().double().cpu().numpy().reshape(-1)
        bells = np.exp(-2.0 * (np.pi * FREQUENCIES_PER_RAD[:, None] * np.array(WIDTHS_RAD)) ** 2)
        rows = np.concatenate([bells, 10.0 * np.ones((1, len(WIDTHS_RAD)))])
        found = np.zeros((len(depth), len(WIDTHS_RAD)))
        for number, tau in enumerate(depth):
            blurred = np.exp(-tau * (1.0 - np.array(self.mean_transform))) - math.exp(-tau)
            whole = math.exp(-tau * (1.0 - self.share)) - math.exp(-tau)
            if whole > 0:
                weight, _ = nnls(rows, np.concatenate([blurred, [10.0 * whole]]))
                found[number] = weight * (whole / weight.sum())
        return torch.from_numpy(found)


def _of_phase_function(per_sr: Callable[[Tensor], Tensor]) -> ForwardScattering:
    angle = np.concatenate([[0.0], np.geomspace(1e-5, FORWARD_RAD, ANGLES)])
    power = 2.0 * np.pi * np.sin(angle) * per_sr(torch.from_numpy(angle)).numpy()
    turns = 2.0 * np.pi * FREQUENCIES_PER_RAD[:, None] * np.maximum(angle, 1e-12)
    mean_bessel = itj0y0(turns)[0] / turns  # int_0^1 J0(turns u) du: the scattering may be anywhere on the path
    transform = trapezoid(power * mean_bessel, angle, axis=-1)
    return ForwardScattering(tuple(transform.tolist()), float(trapezoid(power, angle)))
