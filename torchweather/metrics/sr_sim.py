"""Similarity weighted by the saliency of the spectral residual."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from torchweather.core.precision import outside_autocast
from torchweather.metrics.colour import luma, yiq
from torchweather.metrics.filters import SCHARR, automatic_factor, averaged_down, gaussian_weights, gradient_magnitude
from torchweather.metrics.pairs import Pair
from torchweather.metrics.pooling import chroma_likeness, likeness, stretched, weighted_mean
from torchweather.metrics.resize import cubic_weights, resized

__all__ = ["sr_sim", "sr_sim_of"]

# Zhang & Li 2012, for values in 0..255
SALIENCY = 0.40
GRADIENT = 225.0
GRADIENT_POWER = 0.50
WHITE = 255.0
# Spectral residual (Hou & Zhang 2007) with the sizes of Zhang & Li 2012: on a quarter of the size
SHRINK = 0.25
SMOOTH = 3
BLOB = 10
BLOB_SIGMA = 3.8
# Colour as FSIM compares it (Zhang et al. 2011)
CHROMA = 200.0
CHROMA_POWER = 0.03
# Three pixels are left at a quarter of the size.
SMALLEST = 12
# Amplitude below which a frequency counts as absent, for values in 0..255. Rounding images to float32 leaves 1e-4 in a
# frequency that they lack; the levels of 8 bits leave 1 and more in the others. Whitening divides by the amplitude, so
# without a floor rounding noise of absent frequencies (a flat row, a periodic pattern) would decide the saliency.
ABSENT = 1e-3


@outside_autocast
def sr_sim(distorted: Tensor, reference: Tensor, *, data_range: float = 1.0, chromatic: bool = False) -> Tensor:
    """Spectral residual based similarity: likeness of saliency and gradient, where there is saliency.

    With the saliency ``R`` of the spectral residual, the gradient magnitude ``G`` of the luma and ``S(a, b) = (2 a b +
    C) / (a^2 + b^2 + C)``: mean of ``S(R) S(G)^0.5`` weighted by the larger ``R``.

    Args:
        distorted, reference: ``(..., C, H, W)`` in ``[0, data_range]``, C = 1 or 3 (luma), 12 pixels or larger.
        data_range: value of white.
        chromatic: compare the I and Q of colour images too, as FSIM does.

    Returns:
        ``(...)``; higher is better; in 0..1 but for overshoot of the resampled saliency, 1 for identical images.

    Note:
        Images are averaged down to about 256 pixels on the shorter side first. Saliency is stretched to 0..1 in each
        image; a flat image has none, and where neither image has any, all pixels weigh alike. Symmetric. Saliency is
        found in float64, and frequencies that an image lacks count with an amplitude of 0.001 (white is 255): the score
        of float32 images is that of the same images in float64 to 1e-6.

    References:
        L. Zhang, H. Li, SR-SIM: a fast and high performance IQA index based on spectral residual, IEEE International
        Conference on Image Processing, 2012; METRICS.md 1.

    Example:
        >>> ramp = torch.linspace(0.0, 1.0, 32).square().expand(3, 32, 32)
        >>> float(sr_sim(ramp, ramp)), float(sr_sim(0.5 * ramp, ramp)) < 1.0
        (1.0, True)
    """
    pair = Pair(distorted, reference, data_range, minimum=SMALLEST, owner="sr_sim")
    return sr_sim_of(pair, chromatic=chromatic)


def sr_sim_of(pair: Pair, *, chromatic: bool = False) -> Tensor:
    """:func:`sr_sim` of a pair."""
    kind = pair.images[0].dtype
    factor = automatic_factor(*pair.images[0].shape[-2:])
    x, y = (WHITE * averaged_down(image.double(), factor) for image in pair.images)
    light = [luma(x), luma(y)]
    salient = [_saliency(plane).to(kind) for plane in light]
    x, y, *light = (plane.to(kind) for plane in (x, y, *light))
    slopes = gradient_magnitude(torch.cat(light, 1), *SCHARR).chunk(2, 1)
    local = likeness(salient[0], salient[1], SALIENCY) * likeness(slopes[0], slopes[1], GRADIENT) ** GRADIENT_POWER
    if chromatic and x.shape[1] == 3:
        local = local * chroma_likeness(yiq(x)[:, 1:], yiq(y)[:, 1:], CHROMA, CHROMA_POWER)
    return pair.per_image(weighted_mean(local, torch.maximum(salient[0], salient[1])).clamp_max(1.0))  # sums round


def _saliency(plane: Tensor) -> Tensor:
    """Residual of a plane's log spectrum ``(B, 1, H, W)`` over its own average; 0 for a flat plane."""
    from kornia.filters import box_blur, filter2d_separable

    height, width = plane.shape[-2:]
    rows, columns = math.ceil(SHRINK * height), math.ceil(SHRINK * width)
    # Without a common value, all frequencies of a flat plane are 0 and not rounding noise; frequency 0 gets it back.
    flat = plane[..., :1, :1].detach()
    quarter = cubic_weights(height, rows, SHRINK, plane), cubic_weights(width, columns, SHRINK, plane)
    origin = torch.zeros_like(plane[:1, :1, :rows, :columns])
    origin[..., 0, 0] = rows * columns
    spectrum = torch.fft.fft2(resized(plane - flat, *quarter)) + origin * flat
    logarithm = 0.5 * (spectrum.real.square() + spectrum.imag.square() + ABSENT**2).log()
    whitened = torch.fft.ifft2(spectrum * torch.exp(-box_blur(logarithm, SMOOTH, "replicate")))
    power = whitened.real.square() + whitened.imag.square()
    blob = gaussian_weights(BLOB, BLOB_SIGMA, plane)[None]
    smooth = filter2d_separable(power, blob, blob, "constant")
    back = cubic_weights(rows, height, height / rows, plane), cubic_weights(columns, width, width / columns, plane)
    return resized(stretched(smooth), *back)
