"""Visual saliency-induced index."""

from __future__ import annotations

import math

import torch
from torch import Tensor
from torch.nn import functional

from torchweather.core.precision import outside_autocast
from torchweather.metrics.colour import mixed
from torchweather.metrics.filters import SCHARR, automatic_factor, gradient_magnitude, power, root
from torchweather.metrics.pairs import Pair
from torchweather.metrics.pooling import likeness, stretched, weighted_mean

__all__ = ["vsi", "vsi_of"]

# Zhang, Shen & Li 2014, for values in 0..255
SALIENCY, GRADIENT, CHROMA = 1.27, 386.0, 130.0
GRADIENT_POWER, CHROMA_POWER = 0.40, 0.02
WHITE = 255.0
# Opponent colours of Geusebroek et al. 2001, as the paper has them
LMN = ((0.06, 0.63, 0.27), (0.30, 0.04, -0.35), (0.34, -0.60, 0.17))
# Saliency of simple priors (Zhang, Gu & Li 2013): log-Gabor filter, centre, warm colours; on 256 x 256 pixels
SIDE = 256
CENTRE_FREQUENCY, BANDWIDTH = 0.021, 1.34
CENTRE_PX, WARMTH = 145.0, 0.001
# sRGB to XYZ (IEC 61966-2-1), white D50, CIE L*a*b*
XYZ = ((0.4124564, 0.3575761, 0.1804375), (0.2126729, 0.7151522, 0.0721750), (0.0193339, 0.1191920, 0.9503041))
D50 = (0.96421, 1.0, 0.82521)
CIE_EPSILON, CIE_KAPPA = 0.008856, 903.3
SMALLEST = 3


@outside_autocast
def vsi(distorted: Tensor, reference: Tensor, *, data_range: float = 1.0) -> Tensor:
    """Visual saliency-induced index: likeness of saliency, gradient and colour, where there is saliency.

    With the saliency ``VS`` of simple priors (a band of frequencies, the centre, warm colours), the gradient magnitude
    ``G`` of the brightness L, the opponent colours M and N and ``S(a, b) = (2 a b + C) / (a^2 + b^2 + C)``: mean of
    ``S(VS) S(G)^0.4 [S(M) S(N)]^0.02`` weighted by the larger ``VS``.

    Args:
        distorted, reference: ``(..., C, H, W)`` in ``[0, data_range]``, C = 1 (three equal colours) or 3, 3 pixels or
            larger.
        data_range: value of white.

    Returns:
        ``(...)``; higher is better; in 0..1, 1 for identical images.

    Note:
        Images are averaged down to about 256 pixels on the shorter side; saliency is found at 256 x 256 and stretched
        to 0..1 in each image. Where opposite colours make ``S(M) S(N)`` negative, the real part of its power counts.
        With the paper's sigma_C of 0.001 nearly every pixel is warm. Symmetric.

    References:
        L. Zhang, Y. Shen, H. Li, VSI: a visual saliency-induced index for perceptual image quality assessment, IEEE
        Transactions on Image Processing 23(10), 2014; L. Zhang, Z. Gu, H. Li, SDSP: a novel saliency detection method
        by combining simple priors, IEEE International Conference on Image Processing, 2013; METRICS.md 1.

    Example:
        >>> ramp = torch.linspace(0.0, 1.0, 32).square().expand(3, 32, 32)
        >>> float(vsi(ramp, ramp)), float(vsi(0.5 * ramp, ramp)) < 1.0
        (1.0, True)
    """
    return vsi_of(Pair(distorted, reference, data_range, minimum=SMALLEST, owner="vsi"))


def vsi_of(pair: Pair) -> Tensor:
    """:func:`vsi` of a pair."""
    x, y = (image.expand(-1, 3, -1, -1) for image in pair.images)
    factor = automatic_factor(*x.shape[-2:])
    salient = [_shrunk(_saliency(image), factor) for image in (x, y)]
    lmn = [mixed(WHITE * _shrunk(image, factor), LMN) for image in (x, y)]
    slopes = gradient_magnitude(torch.cat([image[:, :1] for image in lmn], 1), *SCHARR).chunk(2, 1)
    chroma = likeness(lmn[0][:, 1:], lmn[1][:, 1:], CHROMA).prod(1, keepdim=True)
    # Real part of a power of what opposite colours make negative
    turned = torch.where(chroma < 0, math.cos(CHROMA_POWER * math.pi), torch.ones_like(chroma))
    local = likeness(salient[0], salient[1], SALIENCY) * power(likeness(slopes[0], slopes[1], GRADIENT), GRADIENT_POWER)
    local = local * power(chroma.abs(), CHROMA_POWER) * turned
    return pair.per_image(weighted_mean(local, torch.maximum(salient[0], salient[1])).clamp_max(1.0))  # sums round


def _shrunk(image: Tensor, factor: int) -> Tensor:
    """Averaged down, with the edge continued by half a block before (``(factor - 1) // 2`` pixels after)."""
    if factor <= 1:
        return image
    before, after = factor // 2, (factor - 1) // 2
    padded = functional.pad(image, (before, after, before, after), mode="replicate")
    return functional.avg_pool2d(padded, factor)


def _saliency(image: Tensor) -> Tensor:
    """0..1, of the image's size."""
    lab = _lab(functional.interpolate(image, (SIDE, SIDE), mode="bilinear", align_corners=False))
    place = torch.arange(-SIDE // 2, SIDE // 2, dtype=image.dtype, device=image.device)
    radius = torch.fft.ifftshift((place[:, None] ** 2 + place**2).sqrt() / SIDE)
    radius[0, 0] = 1.0
    band = torch.exp(-(radius / CENTRE_FREQUENCY).log().square() / (2.0 * BANDWIDTH**2))
    band = torch.where(radius <= 0.5, band, 0.0)
    passed = torch.fft.ifft2(torch.fft.fft2(lab) * band).real
    contrast = root(passed.square().sum(1, keepdim=True))
    away = place + 1.0
    central = torch.exp(-(away[:, None] ** 2 + away**2) / CENTRE_PX**2)
    low, high = lab.amin((2, 3), keepdim=True), lab.amax((2, 3), keepdim=True)
    warm = (lab - low) / (high - low + torch.finfo(lab.dtype).eps)
    warmth = 1.0 - torch.exp(-warm[:, 1:].square().sum(1, keepdim=True) / WARMTH**2)
    found = contrast * central * warmth
    return stretched(functional.interpolate(found, image.shape[-2:], mode="bilinear", align_corners=True))


def _lab(image: Tensor) -> Tensor:
    """CIE L*a*b* of sRGB in 0..1, ``(B, 3, H, W)``."""
    steep = power(((image + 0.055) / 1.055).clamp_min(0.0), 2.4)
    linear = torch.where(image <= 0.04045, image / 12.92, steep)
    share = mixed(linear, XYZ) / image.new_tensor(D50)[:, None, None]
    bent = torch.where(share <= CIE_EPSILON, (CIE_KAPPA * share + 16.0) / 116.0, power(share, 1.0 / 3.0))
    red, light, blue = bent.unbind(1)
    return torch.stack([116.0 * light - 16.0, 500.0 * (red - light), 200.0 * (light - blue)], 1)
