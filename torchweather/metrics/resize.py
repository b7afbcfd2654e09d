"""Resampling of planes to another size."""

from __future__ import annotations

import math

import torch
from torch import Tensor

__all__ = ["cubic_weights", "resized"]


def _cubic(distance: Tensor) -> Tensor:
    """Keys 1981, a = -1/2."""
    near = 1.5 * distance**3 - 2.5 * distance**2 + 1.0
    far = -0.5 * distance**3 + 2.5 * distance**2 - 4.0 * distance + 2.0
    return torch.where(distance <= 1, near, torch.where(distance < 2, far, torch.zeros_like(distance)))


def cubic_weights(inputs: int, outputs: int, scale: float, like: Tensor) -> Tensor:
    """``(outputs, inputs)`` weights of cubic resampling by ``scale``; the signal is mirrored at its ends.

    Going down, the kernel is widened by ``1 / scale`` against aliasing, as MATLAB's imresize does.
    """
    shrink = min(scale, 1.0)
    reach = 4.0 / shrink
    taps = math.ceil(reach) + 2
    centre = (torch.arange(outputs, device=like.device, dtype=like.dtype) + 0.5) / scale - 0.5
    first = torch.floor(centre - 0.5 * reach)
    place = first[:, None] + torch.arange(taps, device=like.device, dtype=like.dtype)
    weights = _cubic(shrink * (centre[:, None] - place).abs())
    weights = weights / weights.sum(1, keepdim=True)
    folded = place.long() % (2 * inputs)
    folded = torch.minimum(folded, 2 * inputs - 1 - folded)
    return like.new_zeros(outputs, inputs).scatter_add_(1, folded, weights)


def resized(image: Tensor, down: Tensor, across: Tensor) -> Tensor:
    """``(B, C, H, W)`` through the weights of its rows ``(H', H)`` and its columns ``(W', W)``."""
    found: Tensor = down @ image @ across.T
    return found
