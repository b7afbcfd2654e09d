"""Peak signal-to-noise ratio."""

from __future__ import annotations

import torch
from torch import Tensor

from torchweather.metrics.pairs import check_pair, per_image

__all__ = ["psnr"]


def psnr(distorted: Tensor, reference: Tensor, *, data_range: float = 1.0) -> Tensor:
    """Peak signal-to-noise ratio, dB: ``10 log10(data_range^2 / MSE)``.

    Args:
        distorted, reference: ``(..., C, H, W)`` in ``[0, data_range]``, any number of channels.
        data_range: value of white.

    Returns:
        ``(...)``; higher is better; infinite for identical images.

    References:
        METRICS.md 1.

    Example:
        >>> round(float(psnr(torch.full((3, 4, 4), 0.5), torch.full((3, 4, 4), 0.6))), 3)
        20.0
    """
    channels = tuple(reference.shape[-3:-2]) if isinstance(reference, Tensor) else (3,)
    x, y = check_pair(distorted, reference, data_range, channels=channels, owner="psnr")
    error = (x - y).square().mean((1, 2, 3))
    different = error > 0
    safe = torch.where(different, error, torch.ones_like(error))
    return per_image(torch.where(different, -10.0 * safe.log10(), torch.inf), reference)
