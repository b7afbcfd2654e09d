"""Gradient magnitude similarity deviation."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional

from torchweather.core.precision import outside_autocast
from torchweather.metrics.colour import luma
from torchweather.metrics.filters import gradient_magnitude, root
from torchweather.metrics.pairs import Pair
from torchweather.metrics.strips import in_strips

__all__ = ["PREWITT", "deviation", "gmsd", "gmsd_of"]

# Prewitt: smoothed across the difference, and the difference
PREWITT = ((1.0 / 3.0, 1.0 / 3.0, 1.0 / 3.0), (1.0, 0.0, -1.0))
# Xue et al. 2014 section III: 170 on a scale of 255
STEADY = 170.0 / 255.0**2
# One window of the gradient at half size.
SMALLEST = 5


@outside_autocast
def gmsd(distorted: Tensor, reference: Tensor, *, data_range: float = 1.0) -> Tensor:
    """Gradient magnitude similarity deviation: how unevenly the edges have suffered.

    Luma at half size; gradient magnitudes ``a``, ``b`` (Prewitt); the score is the standard deviation over the image
    of ``(2 a b + c) / (a^2 + b^2 + c)``.

    Args:
        distorted, reference: ``(..., C, H, W)`` in ``[0, data_range]``, C = 1 or 3 (luma), 5 pixels or larger.
        data_range: value of white.

    Returns:
        ``(...)``; lower is better; 0 (identical images) to 0.5.

    Note:
        Zeros around the image, as the authors' program has it: a change of brightness alone shows at the border.

    References:
        W. Xue, L. Zhang, X. Mou, A. C. Bovik, Gradient magnitude similarity deviation: a highly efficient perceptual
        image quality index, IEEE Transactions on Image Processing 23(2), 2014; METRICS.md 1.

    Example:
        >>> import torch
        >>> ramp = torch.linspace(0.0, 1.0, 16).expand(1, 16, 16)
        >>> float(gmsd(ramp, ramp)), float(gmsd(ramp.square(), ramp)) > 0.0
        (0.0, True)
    """
    return gmsd_of(Pair(distorted, reference, data_range, minimum=SMALLEST, owner="gmsd"))


def gmsd_of(pair: Pair) -> Tensor:
    """:func:`gmsd` of a pair."""
    x, y = pair.halved
    return pair.per_image(deviation(luma(x), luma(y), STEADY))


def deviation(x: Tensor, y: Tensor, steady: float, masking: float = 0.0) -> Tensor:
    """Standard deviation ``(B,)`` of the similarity of the gradients of two planes ``(B, 1, H, W)`` in [0, 1].

    ``masking`` takes this share of the product of the gradients out of both sides of the fraction.
    """

    def lacking(both: Tensor) -> Tensor:
        a, b = gradient_magnitude(both, *PREWITT, "valid").chunk(2, 1)
        # to similarity 1, exactly 0 for identical images
        return (a - b).square() / (a.square() + b.square() - masking * a * b + steady)

    unlike = in_strips(lacking, 2, functional.pad(torch.cat((x, y), 1), (1, 1, 1, 1)))
    return root((unlike - unlike.mean((1, 2, 3), keepdim=True)).square().mean((1, 2, 3)))
