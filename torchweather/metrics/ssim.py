"""Structural similarity."""

from __future__ import annotations

import torch
from torch import Tensor

from torchweather.metrics.filters import automatic_factor, averaged_down, filtered, gaussian_weights
from torchweather.metrics.pairs import check_pair, per_image

__all__ = ["similarity_maps", "ssim"]

# Wang et al. 2004, section III.C: window 11 x 11 with a standard deviation of 1.5 pixels; K1 and K2 against 0/0
WINDOW_PX, SIGMA_PX = 11, 1.5
K1, K2 = 0.01, 0.03


def similarity_maps(x: Tensor, y: Tensor, white: float = 1.0) -> tuple[Tensor, Tensor]:
    """SSIM and its factor of contrast and structure around each pixel.

    Args:
        x, y: ``(B, C, H, W)``.
        white: value of white, which scales the two constants.

    Returns:
        two ``(B, C, H - 10, W - 10)``: only pixels whose window lies within the image.
    """
    weights = gaussian_weights(WINDOW_PX, SIGMA_PX, x)
    # variances do not change with the zero of the values; near their mean, float32 loses least
    middle = (0.5 * (x + y)).mean((2, 3), keepdim=True).detach()
    x, y = x - middle, y - middle
    # the sum of the two variances is all that the formula needs of them
    moments = filtered(torch.cat((x, y, x.square() + y.square(), x * y)), weights, weights)
    mean_x, mean_y, power, product = moments.chunk(4)
    c1, c2 = (K1 * white) ** 2, (K2 * white) ** 2
    covariance, variances = product - mean_x * mean_y, power - (mean_x.square() + mean_y.square())
    structure = (2.0 * covariance + c2) / (variances + c2)
    mean_x, mean_y = mean_x + middle, mean_y + middle
    brightness = (2.0 * mean_x * mean_y + c1) / (mean_x.square() + mean_y.square() + c1)
    return brightness * structure, structure


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
    x, y = check_pair(distorted, reference, data_range, minimum=WINDOW_PX, owner="ssim")
    factor = 1 if full_resolution else automatic_factor(*y.shape[-2:])
    score, _ = similarity_maps(averaged_down(x, factor), averaged_down(y, factor))
    return per_image(score.mean((1, 2, 3)), reference)
