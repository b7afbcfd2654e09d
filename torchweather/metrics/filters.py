"""Filters of the image scores."""

from __future__ import annotations

import math

import torch
from torch import Tensor
from torch.nn import functional

__all__ = [
    "SCHARR",
    "automatic_factor",
    "averaged_down",
    "filtered",
    "gaussian_weights",
    "gradient_magnitude",
    "power",
    "root",
    "side_by_side",
    "subsampled",
]


# Scharr's gradient: smoothing across, difference along
SCHARR = ((3.0 / 16.0, 10.0 / 16.0, 3.0 / 16.0), (1.0, 0.0, -1.0))


def gaussian_weights(size: int, sigma_px: float, like: Tensor) -> Tensor:
    """Weights of a Gaussian window, ``(size,)``, sum 1."""
    from kornia.filters import get_gaussian_kernel1d  # imported at first use: 0.2 s

    weights: Tensor = get_gaussian_kernel1d(size, sigma_px, force_even=True, device=like.device, dtype=like.dtype)
    return weights[0]


def filtered(image: Tensor, vertical: Tensor, horizontal: Tensor, padding: str = "valid", step: int = 1) -> Tensor:
    """Each channel correlated with the outer product of two rows of weights.

    Args:
        image: ``(B, C, H, W)``.
        vertical, horizontal: ``(k,)`` each.
        padding: ``valid`` (smaller) or ``same`` (zeros around an odd window).
        step: pixels from one place of the window to the next, either way.
    """
    # kornia.filters.gaussian_blur2d: 1.4 times the time for a strip of SSIM (4.2 against 3.1 ms); filter2d_separable:
    # 24 times for every second pixel of 1920 x 1080 (239 against 9.8 ms). benchmarks/filters.json
    batch, channels, rows, columns = *image.shape[:2], len(vertical), len(horizontal)
    around = (rows // 2, columns // 2) if padding == "same" else (0, 0)
    planes = batch * channels
    tall = vertical.reshape(1, 1, -1, 1).expand(planes, 1, rows, 1)
    wide = horizontal.reshape(1, 1, 1, -1).expand(planes, 1, 1, columns)
    found = side_by_side(image.reshape(1, planes, *image.shape[2:]))
    found = functional.conv2d(found, tall, padding=(around[0], 0), stride=(step, 1), groups=planes)
    found = functional.conv2d(found, wide, padding=(0, around[1]), stride=(1, step), groups=planes)
    return found.reshape(batch, channels, *found.shape[2:])


def side_by_side(planes: Tensor) -> Tensor:
    """The values of a pixel next to each other in memory, where a processor then filters several times as fast: oneDNN
    has vectors over the channels, of two or more, in single precision."""
    fast = planes.device.type == "cpu" and planes.dtype == torch.float32 and planes.shape[1] > 1
    return planes.contiguous(memory_format=torch.channels_last) if fast else planes


def averaged_down(image: Tensor, factor: int) -> Tensor:
    """Every ``factor``-th pixel of the image averaged over ``factor`` x ``factor``."""
    return image if factor <= 1 else functional.avg_pool2d(image, factor)


def subsampled(image: Tensor, factor: int) -> Tensor:
    """Averages over ``factor`` x ``factor`` about every ``factor``-th pixel from the first on, zeros around the image:
    ``(B, C, ceil(H / factor), ceil(W / factor))``, as MATLAB's ``conv2(image, mean, 'same')(1:factor:end)``."""
    before = (factor - 1) // 2
    # up to the last block; what lies beyond it is cut off
    below, right = (-(-side // factor) * factor - side - before for side in image.shape[-2:])
    edges = (before, right, before, below)
    return functional.avg_pool2d(functional.pad(image, edges) if any(edges) else image, factor)


def root(value: Tensor) -> Tensor:
    """Square root of 0 or more whose gradient at 0 is 0."""
    there = value > 0
    return torch.where(there, torch.where(there, value, torch.ones_like(value)).sqrt(), torch.zeros_like(value))


def power(value: Tensor, exponent: float) -> Tensor:
    """Value of 0 or more raised to an exponent above 0; its gradient at 0 is 0."""
    there = value > 0
    return torch.where(there, torch.where(there, value, torch.ones_like(value)) ** exponent, torch.zeros_like(value))


def gradient_magnitude(
    image: Tensor, across: tuple[float, ...], along: tuple[float, ...], padding: str = "same"
) -> Tensor:
    """Length of the gradient of each channel: differences ``along`` smoothed ``across``, zeros around the image unless
    the padding is ``valid``."""
    # kornia.filters.filter2d_separable: 9.4 times the time at 1920 x 1080 (487 against 52 ms)
    smooth, differ = (image.new_tensor(weights) for weights in (across, along))
    return root(filtered(image, smooth, differ, padding).square() + filtered(image, differ, smooth, padding).square())


def automatic_factor(height: int, width: int, target: int = 256) -> int:
    """Factor by which the scores shrink an image to about ``target`` pixels on its shorter side first."""
    return max(1, math.floor(min(height, width) / target + 0.5))
