"""Peak signal-to-noise ratio."""

from __future__ import annotations

import torch
from torch import Tensor

from torchweather.core.precision import outside_autocast
from torchweather.metrics.pairs import Pair
from torchweather.metrics.strips import in_strips

__all__ = ["psnr", "psnr_of"]


@outside_autocast
def psnr(distorted: Tensor, reference: Tensor, *, data_range: float = 1.0) -> Tensor:
    """Peak signal-to-noise ratio, dB: ``10 log10(data_range^2 / MSE)``.

    Args:
        distorted, reference: ``(..., C, H, W)`` in ``[0, data_range]``, C = 1 or 3.
        data_range: value of white.

    Returns:
        ``(...)``; higher is better; infinite for identical images.

    References:
        METRICS.md 1.

    Example:
        >>> round(float(psnr(torch.full((3, 4, 4), 0.5), torch.full((3, 4, 4), 0.6))), 3)
        20.0
    """
    return psnr_of(Pair(distorted, reference, data_range, owner="psnr"))


def psnr_of(pair: Pair) -> Tensor:
    """:func:`psnr` of a pair."""
    x, y = pair.images
    error = in_strips(lambda x, y: (x - y).square().sum((2, 3), keepdim=True), 0, x, y).sum((1, 2, 3)) / x[0].numel()
    different = error > 0
    safe = torch.where(different, error, torch.ones_like(error))
    return pair.per_image(torch.where(different, -10.0 * safe.log10(), torch.inf))
