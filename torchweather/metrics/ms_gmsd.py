"""Gradient magnitude similarity deviation over several scales."""

from __future__ import annotations

import torch
from torch import Tensor

from torchweather.core.precision import outside_autocast
from torchweather.metrics.colour import luma, yiq
from torchweather.metrics.filters import root, subsampled
from torchweather.metrics.gmsd import deviation
from torchweather.metrics.pairs import Pair

__all__ = ["ms_gmsd", "ms_gmsd_of"]

# Zhang et al. 2017: weights of full, half, quarter and eighth size; masking; constant on a scale of 255
WEIGHTS = (0.096, 0.596, 0.289, 0.019)
MASKING = 0.5
STEADY = 170.0 / 255.0**2
# the same: share of colour, and how it fades as the gradients differ
COLOUR_SHARE = 0.01
FADE = (0.32, 15.0)
# The last of four scales has at least 2 pixels a side.
SMALLEST = 16


@outside_autocast
def ms_gmsd(distorted: Tensor, reference: Tensor, *, data_range: float = 1.0, chromatic: bool = False) -> Tensor:
    """Multi-scale gradient magnitude similarity deviation: ``M = sqrt(sum_s w_s GMSD_s^2)`` over four scales, with a
    masking term in the similarity.

    ``chromatic``: ``g M + (1 - g) 0.01 E`` with ``E`` the root of the summed mean square errors of I and Q at the last
    scale, on a scale of 255, and ``g = 2 / (1 + 0.32 exp(-15 M)) - 1``.

    Args:
        distorted, reference: ``(..., C, H, W)`` in ``[0, data_range]``, C = 1 or 3 (luma), 16 pixels or larger.
        data_range: value of white.
        chromatic: colour counts too; C = 3.

    Returns:
        ``(...)``; lower is better; 0 (identical images) to 0.5, with colour to about 1.

    References:
        B. Zhang, P. V. Sander, A. Bermak, Gradient magnitude similarity deviation on multiple scales for color image
        quality assessment, IEEE International Conference on Acoustics, Speech and Signal Processing, 2017; METRICS.md
        1.

    Example:
        >>> ramp = torch.linspace(0.0, 1.0, 16).expand(3, 16, 16)
        >>> float(ms_gmsd(ramp, ramp, chromatic=True)), float(ms_gmsd(ramp.square(), ramp)) > 0.0
        (0.0, True)
    """
    channels = (3,) if chromatic else (1, 3)
    pair = Pair(distorted, reference, data_range, channels=channels, minimum=SMALLEST, owner="ms_gmsd")
    return ms_gmsd_of(pair, chromatic=chromatic)


def ms_gmsd_of(pair: Pair, *, chromatic: bool = False) -> Tensor:
    """:func:`ms_gmsd` of a pair."""
    total = WEIGHTS[0] * deviation(*pair.luma, STEADY, MASKING).square()
    x, y = (yiq(image) if chromatic else luma(image) for image in pair.halved)
    for scale, weight in enumerate(WEIGHTS[1:]):
        if scale:
            x, y = subsampled(x, 2), subsampled(y, 2)
        total = total + weight * deviation(x[:, :1], y[:, :1], STEADY, MASKING).square()
    score = root(total)
    if chromatic:
        error = 255.0 * root((x - y)[:, 1:].square().mean((2, 3)).sum(1))
        share = 2.0 / (1.0 + FADE[0] * torch.exp(-FADE[1] * score)) - 1.0
        score = share * score + (1.0 - share) * COLOUR_SHARE * error
    return pair.per_image(score)
