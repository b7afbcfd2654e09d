"""A random field on the ground about the vehicle: where water or snow lies deeper. All sensors of a sample share it."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from torchweather.core.arguments import check_arguments
from torchweather.core.random import Variate

__all__ = ["GROUND_VARIATE", "ground_noise", "uneven"]

WAVES = 12
SHORTEST_M, LONGEST_M = 0.4, 6.0  # wavelengths, log-uniform: ruts, patches and dips of roads; order of magnitude
GROUND_VARIATE = Variate("ground", "uniform", (WAVES, 3))
"""Wavelength, direction and phase of each wave. Its name is that of the shared stream: water and snow are one field."""


def ground_noise(
    noise: Tensor, x_m: Tensor, y_m: Tensor, footprint_m: Tensor | None = None, redness: float = 0.0
) -> Tensor:
    """A field of mean 0 and variance 1, a sum of plane waves; nearly normal.

    Args:
        noise: ``(B, 12, 3)`` uniforms of ``GROUND_VARIATE``.
        x_m, y_m: ``(1 or B, ...)`` places, forward and left.
        footprint_m: along the ground of what sees a place; waves shorter than two of them fade out.
        redness: power of the wavelength with which the waves grow; above 0 long ones prevail, as in turbulence.

    Returns:
        ``(B, ...)``.

    Example:
        >>> u = torch.rand(1, 12, 3, generator=torch.Generator().manual_seed(1))
        >>> ground_noise(u, torch.zeros(1, 4), torch.arange(4.0)[None]).shape
        torch.Size([1, 4])
    """
    check_arguments("ground_noise(noise: floating(B, 12, 3), x_m: floating, y_m: floating)", noise, x_m, y_m)
    found, power = torch.zeros_like(x_m), torch.zeros((), dtype=x_m.dtype, device=x_m.device)
    for wave in range(WAVES):
        u, v, w = (noise[:, wave, k].to(x_m).view(-1, *(1,) * (x_m.ndim - 1)) for k in range(3))
        length = SHORTEST_M * (LONGEST_M / SHORTEST_M) ** u
        turn = 2.0 * math.pi * v
        phase = (2.0 * math.pi / length) * (x_m * turn.cos() + y_m * turn.sin()) + 2.0 * math.pi * w
        height = torch.cos(phase)
        if footprint_m is not None:
            height = height * (0.5 * length / footprint_m.clamp_min(1e-6) - 1.0).clamp(0.0, 1.0)
        weight = length**redness
        found, power = found + weight * height, power + weight.square()
    return found * (2.0 / power).sqrt()


def uneven(field: Tensor, log_std: float | Tensor) -> Tensor:
    """Log-normal factor of mean 1 from a standard field: ``exp(s f - s^2 / 2)``.

    Example:
        >>> uneven(torch.zeros(2), 0.0)
        tensor([1., 1.])
    """
    check_arguments("uneven(field: floating, log_std: Quantity)", field, log_std)
    return torch.exp(log_std * field - 0.5 * log_std * log_std)
