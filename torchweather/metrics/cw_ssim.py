"""Complex wavelet structural similarity."""

from __future__ import annotations

import torch
from torch import Tensor

from torchweather.core.errors import InputValueError
from torchweather.core.precision import outside_autocast
from torchweather.metrics.filters import gaussian_weights, root
from torchweather.metrics.pairs import Pair
from torchweather.metrics.steerable_pyramid import least_size, steerable_bands

__all__ = ["cw_ssim", "cw_ssim_of"]

# Sampat et al. 2009 and the authors' program: a box of 7 x 7 coefficients, a Gaussian of a quarter of the height.
BOX = 7
SIGMA = 0.25
# Grey values of luma; a luma of 8-bit colours has three decimals, so that a tie between two grey values is met.
WHITE = 255.0
TIE = 1e-4
# Amplitudes (white is 1) below this many roundings are those of a flat image.
ROUNDINGS = 16.0


@outside_autocast
def cw_ssim(
    distorted: Tensor,
    reference: Tensor,
    *,
    data_range: float = 1.0,
    level: int = 4,
    orientations: int = 8,
    whole_grey: bool = True,
) -> Tensor:
    """Similarity of the local phases of two images; small shifts and changes of light cost little.

    ``2 |sum a b*| / sum (|a|^2 + |b|^2)`` over 7 x 7 coefficients ``a``, ``b`` of a steerable pyramid's level, averaged
    over places (a Gaussian about the middle of the image) and orientations.

    Args:
        distorted, reference: ``(..., C, H, W)`` in ``[0, data_range]``, C = 1 or 3; colours are scored by their luma.
        data_range: value of white.
        level: of the pyramid, 1 or more; 4 looks at periods of 16 to 64 pixels.
        orientations: 1 or more.
        whole_grey: round the luma of colour images to 256 grey values, halves up, as the authors' 8-bit images are.
            Images of one channel stay as they are. The gradient is that without rounding.

    Returns:
        ``(...)`` in 0 to 1; higher is better; 1 for identical images.

    Note:
        Least size 49 x 49 at level 4. Symmetric. No constant steadies the ratio: places where both images are flat
        count 1, where one is 0. Computed in float64, since the ratio takes the phase of however weak a band.

    References:
        Sampat, Wang, Gupta, Bovik, Markey, Complex wavelet structural similarity, IEEE Trans. Image Processing 18,
        2009; METRICS.md 1.

    Example:
        >>> image = torch.rand(3, 64, 64, generator=torch.Generator().manual_seed(0))
        >>> float(cw_ssim(image, image)), float(cw_ssim(1.0 - image, image)) > 0.99
        (1.0, True)
    """
    for name, number in (("level", level), ("orientations", orientations)):
        if number < 1:
            raise InputValueError(f"cw_ssim: {name} must be 1 or more; got {number!r}.")
    pair = Pair(distorted, reference, data_range, minimum=least_size(level, BOX), owner="cw_ssim")
    return cw_ssim_of(pair, level=level, orientations=orientations, whole_grey=whole_grey)


def cw_ssim_of(pair: Pair, *, level: int = 4, orientations: int = 8, whole_grey: bool = True) -> Tensor:
    """:func:`cw_ssim` of a pair."""
    whole = whole_grey and pair.images[0].shape[1] == 3
    a, b = (steerable_bands(_whole(plane) if whole else plane.double(), level, orientations) for plane in pair.luma)
    product = a * b.conj()
    together = root(_box(product.real).square() + _box(product.imag).square())
    power = _box(a.real.square() + a.imag.square() + (b.real.square() + b.imag.square()))
    lit = power > (ROUNDINGS * torch.finfo(power.dtype).eps) ** 2
    lost = torch.where(lit, 1.0 - 2.0 * together / torch.where(lit, power, torch.ones_like(power)), 0.0)
    rows, columns = (gaussian_weights(size, SIGMA * a.shape[-2], lost) for size in lost.shape[-2:])
    score = 1.0 - (lost.mean(1) * (rows[:, None] * columns)).sum((1, 2))
    return pair.per_image(score.to(pair.images[0].dtype))


def _whole(grey: Tensor) -> Tensor:
    """Luma ``(B, 1, H, W)`` rounded to whole grey values, in float64."""
    rounded = torch.floor(WHITE * grey.detach() + (0.5 + TIE)).double() / WHITE
    return rounded + (grey - grey.detach()) if grey.requires_grad else rounded


def _box(coefficients: Tensor) -> Tensor:
    """Mean over each box that lies within the band."""
    from kornia.filters import box_blur

    inside = slice(BOX // 2, -(BOX // 2))
    means: Tensor = box_blur(coefficients, BOX, "constant")
    return means[..., inside, inside]
