"""Blur of a raw mosaic or of colour planes, each colour by itself.

In a mosaic neighbours of one colour lie 2 px apart, so each of the four phases of the CFA is a picture of its own, and
a path in full-resolution pixels is half as long in it. A disk or a line falls between its pixels: the light there is
what cubic convolution (Keys 1981, a = -1/2) puts through them. It reproduces parabolas, so a blur's variance is exactly
that of its disk, ``radius^2 / 4`` along each axis, or line, ``length^2 / 12``, however small. A Gaussian is the
discrete one (Lindeberg 1990), ``exp(-t) I_n(t)``, whose variance is t exactly: blurs after each other add up.
"""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
import torch
from torch import Tensor

from torchweather.camera.state import CameraState
from torchweather.pipeline.tiling import is_exporting

__all__ = ["blurred_along", "disk_points_px", "gaussian_blur", "line_points_px", "phases", "spacing_px", "whole"]

POINTS_OF_QUARTER, POINTS_OF_LINE = 64, 65
GOLDEN_ANGLE = math.pi * (3.0 - math.sqrt(5.0))
PART = 48  # pixels of an axis that are blurred at once
FREQUENCIES = 512  # of the discrete Gaussian's transform; more than twice its longest kernel


def spacing_px(state: CameraState) -> int:
    """Pixels from one sample of a colour to the next: 2 in a mosaic, 1 in colour planes."""
    return 1 if state.receiver.cfa_index is None else 2


def phases(image: Tensor, spacing: int = 2) -> Tensor:
    """The four phases of a mosaic, ``(B, 1, H, W)`` to ``(B, 4, H/2, W/2)``; colour planes (spacing 1) as they are."""
    return torch.nn.functional.pixel_unshuffle(image, 2) if spacing == 2 else image


def whole(planes: Tensor, spacing: int = 2) -> Tensor:
    """The image that `phases` took apart."""
    return torch.nn.functional.pixel_shuffle(planes, 2) if spacing == 2 else planes


def disk_points_px(radius_px: Tensor) -> Tensor:
    """Points that fill a disk evenly (Vogel 1979), the same in all four quarters: ``(B,)`` to ``(B, K, 2)``."""
    number = torch.arange(POINTS_OF_QUARTER, device=radius_px.device).to(radius_px.dtype)
    ring = torch.sqrt((number + 0.5) / POINTS_OF_QUARTER)
    u, v = ring * torch.cos(GOLDEN_ANGLE * number), ring * torch.sin(GOLDEN_ANGLE * number)
    points = torch.stack([torch.cat([u, -v, -u, v]), torch.cat([v, u, -v, -u])], -1)
    return radius_px[:, None, None] * points


def line_points_px(length_px: Tensor, angle_rad: Tensor) -> Tensor:
    """Points along a line around the origin, ``(B,)`` each to ``(B, K, 2)``; the angle is from x to y."""
    step = (torch.arange(POINTS_OF_LINE, device=length_px.device).to(length_px.dtype) + 0.5) / POINTS_OF_LINE - 0.5
    along = torch.stack([torch.cos(angle_rad), torch.sin(angle_rad)], -1)
    return length_px[:, None, None] * step[:, None] * along[:, None]


def blurred_along(image: Tensor, points_px: Tensor, reach_px: float, spacing: int = 2) -> Tensor:
    """An image ``(B, C, H, W)`` whose every pixel is the mean over points ``(B, K, 2)``, column and row, around it.

    Args:
        image: a mosaic (C = 1) or colour planes; it goes on beyond its edges with the pixels there.
        points_px: relative to each pixel.
        reach_px: no point lies farther away along either axis.
        spacing: pixels from one sample of a colour to the next.
    """
    from kornia.filters import filter2d  # imported at first use: 0.2 s

    reach = math.ceil(reach_px / spacing) + 1
    # Own weights: kornia.filters.motion_blur has lines of whole pixels (6 px at 0.5 rad: 0.9 times the time, off by
    # 0.16 of white), and kornia has no disk.
    node = torch.arange(-reach, reach + 1, device=image.device, dtype=image.dtype)
    weight = _cubic(points_px.to(image.dtype)[..., None] / spacing - node)  # (B, K, 2, nodes)
    kernel = torch.einsum("bkr,bkc->brc", weight[:, :, 1], weight[:, :, 0]) / points_px.shape[1]
    found = filter2d(phases(image, spacing), kernel, "replicate")
    # The cubic undershoots beside lone bright pixels; light ends at black.
    return whole(found, spacing).clamp_min(0.0)


def _cubic(distance: Tensor) -> Tensor:
    """Keys's weight of a pixel at a distance in pixels."""
    x = distance.abs()
    near = (1.5 * x - 2.5) * x.square() + 1.0
    far = ((2.5 - 0.5 * x) * x - 4.0) * x + 2.0
    return torch.where(x <= 1.0, near, torch.where(x < 2.0, far, 0.0))


def gaussian_blur(planes: Tensor, variance_px2: float, spacing: int = 2) -> Tensor:
    """Phases ``(B, 4, H/2, W/2)``, or colour planes, blurred by a Gaussian of a variance in full-resolution pixels."""
    variance = variance_px2 / spacing**2
    batch, number, height, width = planes.shape
    if is_exporting():  # a graph blurs pictures of any size
        from kornia.filters import filter2d_separable

        weights = torch.tensor([_gaussian(variance)], device=planes.device, dtype=planes.dtype)
        convolved: Tensor = filter2d_separable(planes, weights, weights, "replicate")
        return convolved
    # Dense parts of a band matrix, which do many more sums a second than convolutions of one channel.
    # kornia.filters.filter2d_separable: 4.1 times the time at 1920 x 1080 and 14 px (53 against 13 ms)
    rows = planes.reshape(-1, width)
    across = [rows[:, seen] @ part.to(planes).T for seen, part in _blurring(variance, width)]
    columns = torch.cat(across, 1).view(batch * number, height, width)
    down = [part.to(planes) @ columns[:, seen] for seen, part in _blurring(variance, height)]
    return torch.cat(down, 1).view(batch, number, height, width)


@lru_cache(maxsize=32)
def _blurring(variance: float, size: int) -> list[tuple[slice, Tensor]]:
    """Parts of the band matrix ``(size, size)`` that blurs an axis: what each sees, and weights ``(part, seen)``.

    Beyond the ends of the axis stands what is there.
    """
    weights = np.array(_gaussian(variance))
    reach = len(weights) // 2
    near = np.arange(size)[:, None] + np.arange(-reach, reach + 1)
    whole = np.zeros((size, size))
    np.add.at(whole, (np.arange(size)[:, None], near.clip(0, size - 1)), weights)
    found = []
    for first in range(0, size, PART):
        seen = slice(max(first - reach, 0), min(first + PART + reach, size))
        found.append((seen, torch.from_numpy(whole[first : first + PART, seen].copy())))
    return found


@lru_cache(maxsize=32)
def _gaussian(variance: float) -> tuple[float, ...]:
    """Weights of the discrete Gaussian to five standard deviations, from its transform ``exp(t (cos w - 1))``; the
    variance t in samples of one colour."""
    # kornia.filters.get_gaussian_discrete_kernel1d: off by 2e-8 at t = 192, and 272 against 1 ms
    reach = min(math.ceil(5.0 * math.sqrt(variance)) + 2, FREQUENCIES // 2 - 1)
    frequency = 2.0 * math.pi * np.arange(FREQUENCIES) / FREQUENCIES
    lag = np.arange(-reach, reach + 1)
    weights = (np.exp(variance * (np.cos(frequency) - 1.0)) * np.cos(frequency * lag[:, None])).mean(1)
    weights = np.maximum(weights, 0.0)
    return tuple((weights / weights.sum()).tolist())
