"""Complex steerable pyramid, of which the image scores need one level."""

from __future__ import annotations

import math

import torch
from torch import Tensor

__all__ = ["least_size", "steerable_bands"]


def least_size(level: int, pixels: int) -> int:
    """Image size, pixels, from which a level has at least so many."""
    return (pixels - 1) * (1 << (level - 1)) + 1


def steerable_bands(image: Tensor, level: int, orientations: int) -> Tensor:
    """Complex bands of one level, one per orientation.

    In the frequency plane a band is a ring of raised cosines over ``log2`` of the frequency, ``2^-(level + 1)`` to
    ``2^-(level - 1)`` of the Nyquist frequency, times ``cos^(K - 1)`` of the angle to its orientation over one half
    plane. The spectrum is cut to the ring's square, so a band has ``1 / 2^(level - 1)`` of the image's size.

    Args:
        image: ``(B, 1, H, W)``.
        level: 1 is the finest.
        orientations: number ``K`` of orientations, ``pi / K`` apart.

    Returns:
        ``(B, K, H / 2^(level - 1), W / 2^(level - 1))``, sizes rounded up; complex.

    Note:
        Real and imaginary part are a pair in quadrature: a wave of amplitude 1, ``2^-level`` of the Nyquist frequency,
        at the orientation of a band has magnitude 1/2 there.

    References:
        Portilla and Simoncelli, A parametric texture model based on joint statistics of complex wavelet coefficients,
        Int. J. Computer Vision 40, 2000.

    Example:
        >>> steerable_bands(torch.rand(1, 1, 64, 96), 4, 8).shape
        torch.Size([1, 8, 8, 12])
    """
    height, width = image.shape[-2:]
    rows, columns = (_kept(size, level, image) for size in (height, width))
    # A real row has conjugate halves; of the columns the level needs few.
    half = torch.fft.rfft(image, norm="forward").index_select(-1, columns.abs())
    spectrum = torch.fft.fft(torch.where(columns < 0, half.conj(), half), dim=-2, norm="forward")
    spectrum = spectrum.index_select(-2, rows % height)
    down, across = rows[:, None].to(image.dtype) / (0.5 * height), columns.to(image.dtype) / (0.5 * width)
    ring = _ring(down.square() + across.square(), level)
    angle = torch.atan2(down, across)
    centre = math.pi / orientations * torch.arange(orientations, device=image.device, dtype=image.dtype)
    facing = torch.cos(angle - centre[:, None, None]).clamp_min(0.0)
    bands: Tensor = torch.fft.ifft2(spectrum * (ring * facing ** (orientations - 1)), norm="forward")
    return bands


def _kept(size: int, level: int, like: Tensor) -> Tensor:
    """Whole frequencies of the level, in the order of the transform: 0 and up, then the negative ones."""
    for _ in range(level - 1):
        size = (size + 1) // 2
    place = torch.arange(size, device=like.device)
    return torch.where(place < (size + 1) // 2, place, place - size)


def _ring(squared: Tensor, level: int) -> Tensor:
    """Share that a level passes of squared frequencies, shares of Nyquist's: nothing of the mean."""
    octave = 0.5 * squared.clamp_min(torch.finfo(squared.dtype).tiny).log2()
    rise = (octave + (level + 1)).clamp(0.0, 1.0)
    fall = (octave + level).clamp(0.0, 1.0)
    return torch.sin(0.5 * math.pi * rise) * torch.cos(0.5 * math.pi * fall)
