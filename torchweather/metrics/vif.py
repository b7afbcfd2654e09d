"""Visual information fidelity in the pixel domain."""

from __future__ import annotations

from functools import partial

import torch
from torch import Tensor

from torchweather.core.precision import outside_autocast
from torchweather.metrics.filters import filtered, gaussian_weights
from torchweather.metrics.pairs import Pair
from torchweather.metrics.strips import in_strips

__all__ = ["vif", "vif_of"]

# Side of the window at each scale and its standard deviation as a share of that, from the authors' pixel version.
WINDOWS = (17, 9, 5, 3)
SIGMA_SHARE = 0.2
# Variance of the eye's noise on a scale of 255: the same.
EYE_NOISE = 2.0
# Variances below this on a scale of 255 count as none: the same.
NOTHING = 1e-8
# One pixel is left at the last scale.
SMALLEST = 41


@outside_autocast
def vif(distorted: Tensor, reference: Tensor, *, data_range: float = 1.0) -> Tensor:
    """Visual information fidelity (pixel domain): what the distorted image tells of the reference, against what the
    reference tells itself through the same eye.

    At each of four scales, in Gaussian windows with the variance ``v_r`` of the reference, ``v_d`` of the distorted
    image and their covariance ``c``: gain ``g = c / v_r``, noise ``v_n = v_d - g c``, and
    ``sum log(1 + g^2 v_r / (v_n + v_eye)) / sum log(1 + v_r / v_eye)`` over all windows of all scales.

    Args:
        distorted, reference: ``(..., C, H, W)`` in ``[0, data_range]``, C = 1 or 3 (luma), 41 pixels or larger.
        data_range: value of white.

    Returns:
        ``(...)``; higher is better; 0 and more, 1 for identical images and above 1 where the contrast grows.

    Note:
        Not symmetric: with the arguments swapped the score rises as fog thickens. A reference without any structure has
        nothing to lose: 1.

    References:
        H. R. Sheikh, A. C. Bovik, Image information and visual quality, IEEE Transactions on Image Processing 15(2),
        2006; METRICS.md 1.

    Example:
        >>> ramp = torch.linspace(0.0, 1.0, 48).expand(1, 48, 48)
        >>> float(vif(ramp, ramp)), float(vif(0.5 * ramp, ramp)) < 1.0
        (1.0, True)
    """
    return vif_of(Pair(distorted, reference, data_range, minimum=SMALLEST, owner="vif"))


def vif_of(pair: Pair) -> Tensor:
    """:func:`vif` of a pair."""
    both = torch.cat([_about_middle(plane) for plane in pair.luma], 1)
    total = both.new_zeros(len(both), 2)
    for scale, size in enumerate(WINDOWS):
        window = gaussian_weights(size, SIGMA_SHARE * size, both)
        if scale:
            both = filtered(both, window, window, step=2)
        total = total + in_strips(partial(_information, window=window), size - 1, both).sum((2, 3))
    kept, told = total.unbind(1)
    there = told > 0
    score = torch.where(there, kept, torch.ones_like(kept)) / torch.where(there, told, torch.ones_like(told))
    return pair.per_image(score)


def _about_middle(image: Tensor) -> Tensor:
    """On a scale of 255 about its middle value: variances keep their digits, those of a constant are exactly 0."""
    middle = 0.5 * (image.detach().amax((1, 2, 3), keepdim=True) + image.detach().amin((1, 2, 3), keepdim=True))
    return 255.0 * (image - middle)


def _information(both: Tensor, window: Tensor) -> Tensor:
    """Information in each window of both planes ``(B, 2, H, W)``: of the distorted one and of the reference."""
    x, y = both.chunk(2, 1)
    moments = filtered(torch.cat((both, both.square(), x * y), 1), window, window)
    mean_x, mean_y, square_x, square_y, product = moments.chunk(5, 1)
    # rounding makes variances below 0
    of_x = (square_x - mean_x.square()).clamp_min(0.0)
    of_y = (square_y - mean_y.square()).clamp_min(0.0)
    shared = product - mean_x * mean_y
    # nothing of the reference is left where one is flat or where they run against each other
    related = (of_x >= NOTHING) & (of_y >= NOTHING) & (shared > 0)
    zero, one = torch.zeros_like(of_y), torch.ones_like(of_y)
    gain = torch.where(related, shared, zero) / torch.where(related, of_y, one)
    noise = (of_x - gain * shared).clamp_min(0.0)
    variance = torch.where(of_y >= NOTHING, of_y, zero)
    return torch.cat((gain.square() * variance / (noise + EYE_NOISE), variance / EYE_NOISE), 1).log1p()
