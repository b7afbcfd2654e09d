"""Feature similarity."""

from __future__ import annotations

import torch
from torch import Tensor

from torchweather.core.precision import outside_autocast
from torchweather.metrics.colour import yiq
from torchweather.metrics.filters import SCHARR, gradient_magnitude
from torchweather.metrics.pairs import Pair
from torchweather.metrics.phase_congruency import phase_congruency
from torchweather.metrics.pooling import chroma_likeness, likeness, weighted_mean

__all__ = ["fsim", "fsim_of"]

# Zhang et al. 2011, section IV.B, for values in 0..255; T4 = T3
PHASE = 0.85
GRADIENT = 160.0
CHROMA = 200.0
CHROMA_POWER = 0.03
WHITE = 255.0
# About one wave of the finest filters
SMALLEST = 8


@outside_autocast
def fsim(distorted: Tensor, reference: Tensor, *, data_range: float = 1.0, chromatic: bool = True) -> Tensor:
    """Feature similarity: likeness of phase congruency and gradient, and of colour, where there are features.

    With the phase congruency ``PC``, the gradient magnitude ``G`` of the luma and ``S(a, b) = (2 a b + T) / (a^2 + b^2
    + T)``: mean of ``S(PC) S(G) |S(I) S(Q)|^0.03`` weighted by the larger ``PC``; I and Q are those of YIQ.

    Args:
        distorted, reference: ``(..., C, H, W)`` in ``[0, data_range]``, C = 1 or 3, 8 pixels or larger.
        data_range: value of white.
        chromatic: compare colour too (FSIMc); False is FSIM. Grey images have no colour: both are the same.

    Returns:
        ``(...)``; higher is better; in 0..1, 1 for identical images.

    Note:
        Images are averaged down to about 256 pixels on the shorter side first. Symmetric. Where neither image has a
        feature, all pixels weigh alike. Opposite colours make ``S(I) S(Q)`` negative; its absolute value is taken,
        where the authors' code takes the real part of the complex power (up to 2e-4 apart).

    References:
        L. Zhang, L. Zhang, X. Mou, D. Zhang, FSIM: a feature similarity index for image quality assessment, IEEE
        Transactions on Image Processing 20(8), 2011; METRICS.md 1.

    Example:
        >>> ramp = torch.linspace(0.0, 1.0, 32).square().expand(3, 32, 32)
        >>> float(fsim(ramp, ramp)), float(fsim(0.5 * ramp, ramp)) < 1.0
        (1.0, True)
    """
    return fsim_of(Pair(distorted, reference, data_range, minimum=SMALLEST, owner="fsim"), chromatic=chromatic)


def fsim_of(pair: Pair, *, chromatic: bool = True) -> Tensor:
    """:func:`fsim` of a pair."""
    x, y = (WHITE * (image if image.shape[1] == 1 else yiq(image)) for image in pair.shrunk)
    features = phase_congruency(torch.cat((x[:, :1], y[:, :1]))).chunk(2)
    slopes = gradient_magnitude(torch.cat((x[:, :1], y[:, :1]), 1), *SCHARR).chunk(2, 1)
    local = likeness(features[0], features[1], PHASE) * likeness(slopes[0], slopes[1], GRADIENT)
    if chromatic and x.shape[1] == 3:
        local = local * chroma_likeness(x[:, 1:], y[:, 1:], CHROMA, CHROMA_POWER)
    return pair.per_image(weighted_mean(local, torch.maximum(features[0], features[1])).clamp_max(1.0))  # sums round
