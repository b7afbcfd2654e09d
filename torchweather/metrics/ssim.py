"""Structural similarity."""

from __future__ import annotations

from functools import partial

import torch
from torch import Tensor

from torchweather.core.precision import outside_autocast
from torchweather.metrics.filters import filtered, gaussian_weights
from torchweather.metrics.pairs import Pair
from torchweather.metrics.strips import in_strips

__all__ = ["lacking", "ssim", "ssim_of"]

# Wang et al. 2004, section III.C: window 11 x 11 with a standard deviation of 1.5 pixels; K1 and K2 against 0/0
WINDOW_PX, SIGMA_PX = 11, 1.5
K1, K2 = 0.01, 0.03


def lacking(x: Tensor, y: Tensor, white: float = 1.0, *, brightness: bool = True) -> Tensor:
    """Difference between 1 and the SSIM around each pixel, exactly 0 for identical images.

    Args:
        x, y: ``(B, C, H, W)``.
        white: value of white, which scales the two constants.
        brightness: or the factor of contrast and structure alone.

    Returns:
        ``(B, C, H - 10, W - 10)``: only pixels whose window lies within the image.
    """
    return in_strips(partial(_lacking, white=white, brightness=brightness), WINDOW_PX - 1, x, y)


def _lacking(x: Tensor, y: Tensor, white: float, brightness: bool) -> Tensor:
    weights = gaussian_weights(WINDOW_PX, SIGMA_PX, y)
    # variances do not change with the zero of the values; near their mean, float32 loses least
    off = x - y
    middle, shift = (plane.detach().mean((2, 3), keepdim=True) for plane in (y, off))
    y, off = y - middle, off - shift
    moments = filtered(torch.cat((y, off, y * (y + off), off.square()), 1), weights, weights)
    mean_y, mean_off, product, power = moments.chunk(4, 1)
    covariance = product - mean_y * (mean_y + mean_off)
    # the variances of x and y are together twice their covariance and the variance of their difference
    variance_off = power - mean_off.square()
    structure = variance_off / (2.0 * covariance + variance_off + (K2 * white) ** 2)
    if not brightness:
        return structure
    mean_y, mean_off = mean_y + middle, mean_off + shift
    mean_x = mean_y + mean_off
    light = mean_off.square() / (mean_x.square() + mean_y.square() + (K1 * white) ** 2)
    return light + structure - light * structure


@outside_autocast
def ssim(
    distorted: Tensor,
    reference: Tensor,
    *,
    data_range: float = 1.0,
    full_resolution: bool = False,
) -> Tensor:
    """Structural similarity: mean, contrast and structure compared in an 11 x 11 Gaussian window.

    ``(2 mx my + c1) (2 sxy + c2) / ((mx^2 + my^2 + c1) (sx^2 + sy^2 + c2))`` with the windowed means ``m``, variances
    ``s^2`` and covariance ``sxy``, ``c1 = (0.01 white)^2``, ``c2 = (0.03 white)^2``; the mean over all windows that lie
    within the image, and over the channels.

    Args:
        distorted, reference: ``(..., C, H, W)`` in ``[0, data_range]``, grey or RGB.
        data_range: value of white.
        full_resolution: no averaging down. Otherwise images are averaged down by ``round(min(H, W) / 256)`` first, as
            the authors of the score advise for the usual viewing distance.

    Returns:
        ``(...)`` in [-1, 1]; higher is better; 1 for identical images. Least size 11 x 11.

    Note:
        Scores at full resolution, averaged down, of brightness and of RGB differ widely for one pair: name the variant.
        At full resolution the score is that of scikit-image with ``gaussian_weights=True`` and
        ``use_sample_covariance=False``.

    References:
        Wang, Bovik, Sheikh, Simoncelli, Image quality assessment: from error visibility to structural similarity, IEEE
        Trans. Image Process. 13 (2004); METRICS.md 1.

    Example:
        >>> grey = torch.full((1, 16, 16), 0.5)
        >>> float(ssim(grey, grey))
        1.0
        >>> round(float(ssim(0.5 * grey, grey)), 4)
        0.8001
    """
    pair = Pair(distorted, reference, data_range, minimum=WINDOW_PX, owner="ssim")
    return ssim_of(pair, full_resolution=full_resolution)


def ssim_of(pair: Pair, *, full_resolution: bool = False) -> Tensor:
    """:func:`ssim` of a pair."""
    x, y = pair.images if full_resolution else pair.shrunk
    return pair.per_image(1.0 - lacking(x, y).mean((1, 2, 3)))
