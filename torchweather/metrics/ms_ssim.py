"""Structural similarity over scales."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional

from torchweather.core.precision import outside_autocast
from torchweather.metrics.filters import power
from torchweather.metrics.pairs import Pair
from torchweather.metrics.ssim import WINDOW_PX, lacking

__all__ = ["SCALE_WEIGHTS", "ms_ssim", "ms_ssim_of"]

# Wang et al. 2003, section 3.2: exponents of the five scales, finest first
SCALE_WEIGHTS = (0.0448, 0.2856, 0.3001, 0.2363, 0.1333)
# one window at the coarsest of the five scales
MINIMUM_PX = (WINDOW_PX - 1) * 2 ** (len(SCALE_WEIGHTS) - 1) + 1


def halved(image: Tensor) -> Tensor:
    """Means of 2 x 2 pixels; where a side is odd, the first row and the first column count twice."""
    odd = max(image.shape[-2] % 2, image.shape[-1] % 2)
    return functional.avg_pool2d(functional.pad(image, (odd, 0, odd, 0), mode="replicate"), 2)


@outside_autocast
def ms_ssim(distorted: Tensor, reference: Tensor, *, data_range: float = 1.0, luma_only: bool = False) -> Tensor:
    """Structural similarity at five scales, each half as fine as the one before.

    ``ssim_5^w5 prod_{j<5} cs_j^wj``: the factor of contrast and structure of SSIM at every scale, its factor of
    brightness at the coarsest; each is the mean over the image before it is raised to its weight. A negative mean
    counts as 0. The mean over the channels comes last.

    Args:
        distorted, reference: ``(..., C, H, W)`` in ``[0, data_range]``, grey or RGB.
        data_range: value of white.
        luma_only: RGB is scored by its brightness (ITU-R BT.601) instead of the mean over the channels.

    Returns:
        ``(...)`` in [0, 1]; higher is better; 1 for identical images. Least size 161 x 161.

    Note:
        The paper leaves open how an odd side is halved: here both sides get a copy of their first line if either is
        odd, as in METRICS.md's oracle. The five weights of the paper sum to 1.0001 and are taken as they stand. The
        gradient of a scale whose mean is negative is 0.

    References:
        Wang, Simoncelli, Bovik, Multi-scale structural similarity for image quality assessment, Asilomar Conf. Signals,
        Systems and Computers (2003); METRICS.md 1.

    Example:
        >>> ramp = torch.linspace(0.0, 1.0, 161).expand(1, 161, 161)
        >>> float(ms_ssim(ramp, ramp))
        1.0
        >>> round(float(ms_ssim(0.5 * ramp, ramp)), 2)
        0.85
    """
    pair = Pair(distorted, reference, data_range, minimum=MINIMUM_PX, owner="ms_ssim")
    return ms_ssim_of(pair, luma_only=luma_only)


def ms_ssim_of(pair: Pair, *, luma_only: bool = False) -> Tensor:
    """:func:`ms_ssim` of a pair."""
    x, y = pair.luma if luma_only else pair.images
    score = torch.ones_like(y[:, :, 0, 0])
    for scale, weight in enumerate(SCALE_WEIGHTS):
        if scale:
            x, y = halved(x), halved(y)
        last = scale == len(SCALE_WEIGHTS) - 1
        mean = 1.0 - lacking(x, y, brightness=last).mean((2, 3))
        score = score * power(mean.clamp_min(0.0), weight)
    return pair.per_image(score.mean(1))
