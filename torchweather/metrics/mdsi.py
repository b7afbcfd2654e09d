"""Mean deviation similarity index."""

from __future__ import annotations

import math
from typing import Literal

import torch
from torch import Tensor

from torchweather.core.errors import InputValueError
from torchweather.core.precision import outside_autocast
from torchweather.metrics.colour import mixed
from torchweather.metrics.filters import automatic_factor, gradient_magnitude, power, root, subsampled
from torchweather.metrics.gmsd import PREWITT
from torchweather.metrics.pairs import Pair

__all__ = ["mdsi", "mdsi_of"]

# Nafchi et al. 2016 section II: luminance and two chromaticities of the Gaussian colour model
LHM = ((0.2989, 0.5870, 0.1140), (0.30, 0.04, -0.35), (0.34, -0.60, 0.17))
# the same, on a scale of 255: gradients against each other, gradients against their fusion, chromaticity
C1, C2, C3 = (constant / 255.0**2 for constant in (140.0, 55.0, 550.0))
# the same: share of the gradients in the sum; exponents of gradients and chromaticity in the product
SHARE = 0.6
GRADIENT_POWER, COLOUR_POWER = 0.2, 0.1
# the same: power that the similarity is raised to before its deviation is taken, and the deviation after
POWER = 0.25
# One window of the gradient.
SMALLEST = 3


@outside_autocast
def mdsi(
    distorted: Tensor,
    reference: Tensor,
    *,
    data_range: float = 1.0,
    combination: Literal["sum", "product"] = "sum",
) -> Tensor:
    """Mean deviation similarity index: how unevenly edges and colours have suffered.

    Shrunk to about 256 pixels; ``S(a, b, c) = (2 a b + c) / (a^2 + b^2 + c)`` of the gradient magnitudes ``d``, ``r``
    of both images and ``f`` of their mean: ``G = S(d, r, c1) + S(d, f, c2) - S(r, f, c2)``; ``C`` likewise from both
    chromaticities together. With ``q = (0.6 G + 0.4 C)^(1/4)`` the score is ``mean(|q - mean(q)|)^(1/4)``.

    Args:
        distorted, reference: ``(..., C, H, W)`` in ``[0, data_range]``, C = 1 (as equal R, G, B) or 3, 3 pixels or
            larger.
        data_range: value of white.
        combination: ``sum``, or ``product``: ``G^0.2 C^0.1`` for ``0.6 G + 0.4 C``.

    Returns:
        ``(...)``; lower is better; 0 (identical images) to about 1.

    Note:
        Not symmetric. ``G`` and ``C`` may fall below 0; the root is the complex one, as in the authors' program. Zeros
        around the image, as there. The gradient is 0 where the true one is infinite (identical images, similarity 0).
        The ``product`` of the reference implementation multiplies real parts and adds imaginary ones; the product here
        is that of complex numbers, within 0.001 of it, and the same where ``G`` and ``C`` stay above 0.

    References:
        H. Z. Nafchi, A. Shahkolaei, R. Hedjam, M. Cheriet, Mean deviation similarity index: efficient and reliable
        full-reference image quality evaluator, IEEE Access 4, 2016; METRICS.md 1.

    Example:
        >>> ramp = torch.linspace(0.0, 1.0, 16).expand(3, 16, 16)
        >>> float(mdsi(ramp, ramp)), 0.0 < float(mdsi(ramp.square(), ramp)) < 1.0
        (0.0, True)
    """
    if combination not in ("sum", "product"):
        raise InputValueError(f"mdsi: combination must be 'sum' or 'product'; got {combination!r}.")
    pair = Pair(distorted, reference, data_range, minimum=SMALLEST, owner="mdsi")
    return mdsi_of(pair, combination=combination)


def mdsi_of(pair: Pair, *, combination: Literal["sum", "product"] = "sum") -> Tensor:
    """:func:`mdsi` of a pair."""
    factor = automatic_factor(*pair.images[0].shape[-2:])
    x, y = (mixed(subsampled(image, factor).expand(-1, 3, -1, -1), LHM) for image in pair.images)
    light = torch.cat([image[:, :1] for image in (x, y, 0.5 * (x + y))], 1)
    d, r, f = gradient_magnitude(light, *PREWITT).chunk(3, 1)
    edges = _similar(d, r, C1) + (_similar(d, f, C2) - _similar(r, f, C2))
    a, b = x[:, 1:], y[:, 1:]
    colours = (2.0 * (a * b).sum(1, True) + C3) / ((a.square() + b.square()).sum(1, True) + C3)
    parts = _complex_root(edges, colours, combination)
    real, imaginary = (part - part.mean((1, 2, 3), keepdim=True) for part in parts)
    away = root(real.square() + imaginary.square()).mean((1, 2, 3))
    return pair.per_image(power(away, POWER))


def _similar(a: Tensor, b: Tensor, steady: float) -> Tensor:
    return (2.0 * a * b + steady) / (a.square() + b.square() + steady)


def _complex_root(edges: Tensor, colours: Tensor, combination: str) -> tuple[Tensor, Tensor]:
    """Real and imaginary part of the root of the combined similarities, the principal one where they are below 0."""
    if combination == "sum":
        factors = [(SHARE * edges + (1.0 - SHARE) * colours, POWER)]
    else:
        factors = [(edges, GRADIENT_POWER * POWER), (colours, COLOUR_POWER * POWER)]
    size, angle = torch.ones_like(edges), torch.zeros_like(edges)
    for value, exponent in factors:
        size = size * power(value.abs(), exponent)
        angle = angle + math.pi * exponent * (value < 0).to(angle.dtype)
    return size * angle.cos(), size * angle.sin()
