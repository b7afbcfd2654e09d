"""Haar wavelet-based perceptual similarity index."""

from __future__ import annotations

import math

import torch
from torch import Tensor
from torch.nn import functional

from torchweather.core.precision import outside_autocast
from torchweather.metrics.colour import yiq
from torchweather.metrics.filters import filtered
from torchweather.metrics.pairs import Pair

__all__ = ["haarpsi", "haarpsi_of"]

# Reisenhofer et al. 2018 section 3: fitted to opinion scores; C on a scale of 255
STEADY = 30.0 / 255.0**2
STEEPNESS = 4.2
# The two finer scales tell how alike, the coarsest how much it counts.
SCALES = 3


@outside_autocast
def haarpsi(distorted: Tensor, reference: Tensor, *, data_range: float = 1.0) -> Tensor:
    """Haar wavelet-based perceptual similarity index, at half size.

    Horizontal and vertical Haar coefficients of the luma at three scales; similarity ``s`` of each direction is the
    mean over the two finer ones of ``(2 |a b| + C) / (a^2 + b^2 + C)``, its weight the larger coefficient of the
    coarsest. I and Q add one ``s`` from their 2 x 2 means with the mean weight of both directions. With the logistic
    function ``l(s) = 1 / (1 + exp(-4.2 s))`` the score is ``(l^-1(sum w l(s) / sum w) / 4.2)^2``.

    Args:
        distorted, reference: ``(..., C, H, W)`` in ``[0, data_range]``, C = 1 (no colour term) or 3, 16 pixels or
            larger.
        data_range: value of white.

    Returns:
        ``(...)``; higher is better; 0 to 1, exactly 1 for identical images.

    Note:
        Zeros around the image, as the authors' program has it. Where no pixel has a weight (both black): 1.

    References:
        R. Reisenhofer, S. Bosse, G. Kutyniok, T. Wiegand, A Haar wavelet-based perceptual similarity index for image
        quality assessment, Signal Processing: Image Communication 61, 2018; METRICS.md 1.

    Example:
        >>> ramp = torch.linspace(0.0, 1.0, 16).expand(3, 16, 16)
        >>> float(haarpsi(ramp, ramp)), 0.0 < float(haarpsi(ramp.square(), ramp)) < 1.0
        (1.0, True)
    """
    return haarpsi_of(Pair(distorted, reference, data_range, minimum=2 ** (SCALES + 1), owner="haarpsi"))


def haarpsi_of(pair: Pair) -> Tensor:
    """:func:`haarpsi` of a pair."""
    x, y = pair.halved
    colour = x.shape[1] == 3
    x, y = (yiq(image) if colour else image for image in (x, y))
    *fine, coarsest = _haar(torch.cat((x[:, :1], y[:, :1]), 1))
    lack = torch.stack([_lack(*magnitudes) for magnitudes in fine]).mean(0)
    weight = torch.maximum(*coarsest)
    if colour:
        hue = _lack(*_mean(torch.cat((x[:, 1:], y[:, 1:]), 1)).chunk(2, 1)).mean(1, keepdim=True)
        lack = torch.cat((lack, hue), 1)
        weight = torch.cat((weight, weight.mean(1, keepdim=True)), 1)
    return pair.per_image(_pooled(lack, weight))


def _haar(both: Tensor) -> list[tuple[Tensor, Tensor]]:
    """Magnitudes ``(B, 2, H, W)`` of the coefficients in both directions, from the finest scale on, of both planes of
    ``(B, 2, H, W)``."""
    # kornia.filters.filter2d_separable: 1.6 times the time of the score at 1920 x 1080 (154 against 95 ms)
    found = []
    for scale in range(1, SCALES + 1):
        side = 2**scale
        ones = both.new_full((side,), 1.0 / side)
        step = torch.cat((both.new_ones(side // 2), -both.new_ones(side // 2)))
        around = _around(both, side)
        magnitudes = torch.stack((filtered(around, step, ones), filtered(around, ones, step)), 1).abs()
        found.append((magnitudes[:, :, 0], magnitudes[:, :, 1]))
    return found


def _mean(planes: Tensor) -> Tensor:
    """Magnitude of the mean over 2 x 2."""
    half = planes.new_full((2,), 0.5)
    return filtered(_around(planes, 2), half, half).abs()


def _around(planes: Tensor, side: int) -> Tensor:
    """Zeros around, so that an even window leaves the size as it is."""
    before, after = side // 2 - 1, side // 2
    return functional.pad(planes, (before, after, before, after))


def _lack(a: Tensor, b: Tensor) -> Tensor:
    """Difference between 1 and the similarity of two magnitudes."""
    return (a - b).square() / (a.square() + b.square() + STEADY)


def _pooled(lack: Tensor, weight: Tensor) -> Tensor:
    """Score ``(B,)`` from what each place lacks to similarity 1 and how much it counts."""
    # l(1) - l(s) = l(s) (1 - l(1)) (exp(4.2 (1 - s)) - 1): exactly 0 for s = 1
    best = 1.0 / (1.0 + math.exp(-STEEPNESS))
    short = (1.0 - best) * torch.sigmoid(STEEPNESS * (1.0 - lack)) * torch.expm1(STEEPNESS * lack)
    total = weight.sum((1, 2, 3))
    weighed = total > 0
    mean = (weight * short).sum((1, 2, 3)) / torch.where(weighed, total, torch.ones_like(total))
    different = weighed & (mean > 0)
    score = (torch.logit(best - torch.where(different, mean, torch.zeros_like(mean))) / STEEPNESS).square()
    return torch.where(different, score.clamp_max(1.0), torch.ones_like(score))
