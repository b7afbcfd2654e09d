"""Similarity of the sub-bands of the discrete cosine transform."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from torchweather.core.precision import outside_autocast
from torchweather.metrics.filters import averaged_down, gaussian_weights, root
from torchweather.metrics.pairs import Pair

__all__ = ["dss", "dss_of"]

# Balanov et al. 2015: blocks, weight of a sub-band (standard deviation in frequency steps; below the least it is left
# out), window, share of the worst places that count, and the constants of the constant part and the others (0..255).
BLOCK_PX = 8
BAND_SIGMA = 1.55
LEAST_WEIGHT = 1e-2
WINDOW = 3
WINDOW_SIGMA = 1.5
WORST_SHARE = 0.05
MEAN_CONSTANT = 1000.0
OTHER_CONSTANT = 300.0
WHITE = 255.0
# Images are averaged down by whole factors while both sides keep this many pixels.
SIDE_PX = 256


@outside_autocast
def dss(distorted: Tensor, reference: Tensor, *, data_range: float = 1.0) -> Tensor:
    """DCT sub-band similarity: likeness of local variance in each frequency of 8 x 8 blocks, where it is worst.

    The coefficients of one frequency over all blocks are an image. In 3 x 3 Gaussian windows of it, with the deviations
    ``s_x, s_y``: ``(2 s_x s_y + C) / (s_x^2 + s_y^2 + C)``, averaged over the worst 5 % of the places; for the mean of
    the blocks times the same of ``(s_xy + C) / (s_x s_y + C)``. The score is the mean over the frequencies under a
    Gaussian about frequency 0.

    Args:
        distorted, reference: ``(..., C, H, W)`` in ``[0, data_range]``, C = 1 or 3 (luma), 8 pixels or larger.
        data_range: value of white.

    Returns:
        ``(...)``; higher is better; at most 1, which identical images score exactly.

    Note:
        Images are averaged down first by the whole factor that leaves 256 pixels or more (the other scores round the
        factor); pixels beyond the last whole block do
        not count. Symmetric. D3.4 calls it "Denoise Snow Score"; it measures nothing of the kind.

    References:
        A. Balanov, A. Schwartz, Y. Moshe, N. Peleg, Image quality assessment based on DCT subband similarity, IEEE
        International Conference on Image Processing, 2015; METRICS.md 1.

    Example:
        >>> ramp = torch.linspace(0.0, 1.0, 64).square().expand(3, 64, 64)
        >>> float(dss(ramp, ramp)), float(dss(0.5 * ramp, ramp)) < 1.0
        (1.0, True)
    """
    return dss_of(Pair(distorted, reference, data_range, minimum=BLOCK_PX, owner="dss"))


def dss_of(pair: Pair) -> Tensor:
    """:func:`dss` of a pair."""
    from kornia.filters import filter2d_separable

    x, y = pair.luma
    factor = max(1, min(x.shape[-2:]) // SIDE_PX)
    rows, columns, weight = _bands(x)
    x, y = (_coefficients(WHITE * averaged_down(plane, factor), rows, columns) for plane in (x, y))
    # Around their means, variances keep their digits; windows over the border see zeros outside.
    middle_x, middle_y = (bands.detach().mean((2, 3), keepdim=True) for bands in (x, y))
    x, y = x - middle_x, y - middle_y
    window = gaussian_weights(WINDOW, WINDOW_SIGMA, x)[None]

    def smooth(plane: Tensor) -> Tensor:
        found: Tensor = filter2d_separable(plane, window, window, "constant")
        return found

    inside = smooth(torch.ones_like(x[:1, :1]))
    inside[..., 1:-1, 1:-1] = 1.0
    first, second = (x, smooth(x), middle_x), (y, smooth(y), middle_y)

    def covariance(one: tuple[Tensor, Tensor, Tensor], other: tuple[Tensor, Tensor, Tensor]) -> Tensor:
        a, mean_a, middle_a = one
        b, mean_b, middle_b = other
        border = (1.0 - inside) * (middle_a * mean_b + middle_b * mean_a + middle_a * middle_b * inside)
        return smooth(a * b) - mean_a * mean_b + border

    of_x, of_y = covariance(first, first).clamp_min(0.0), covariance(second, second).clamp_min(0.0)
    both = root(of_x * of_y)
    constant = torch.full_like(weight, OTHER_CONSTANT)
    constant[0] = MEAN_CONSTANT
    constant = constant[:, None, None]
    alike = _worst((2.0 * both + constant) / (of_x + of_y + constant))
    # No covariance exceeds the deviations; beyond them is rounding.
    shared = covariance(first, second)[:, :1]
    shared = torch.maximum(torch.minimum(shared, both[:, :1]), -both[:, :1])
    together = _worst((shared + MEAN_CONSTANT) / (both[:, :1] + MEAN_CONSTANT))
    alike = torch.cat((alike[:, :1] * together, alike[:, 1:]), 1)
    score = (weight * alike).sum(1) / (weight * torch.ones_like(alike)).sum(1)
    return pair.per_image(score)


def _bands(like: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Rows of the transform ``(K, 8)`` down and across, and weight ``(K,)``, of the frequencies that count."""
    step = torch.arange(BLOCK_PX, device=like.device, dtype=like.dtype)
    basis = math.sqrt(2.0 / BLOCK_PX) * torch.cos(math.pi / BLOCK_PX * step[:, None] * (step + 0.5))
    basis = torch.cat((basis[:1] / math.sqrt(2.0), basis[1:]))
    line = torch.exp(-(step + 0.5).square() / (2.0 * BAND_SIGMA**2))
    weight = line[:, None] * line
    down, across = torch.nonzero(weight >= LEAST_WEIGHT, as_tuple=True)  # frequency 0 comes first
    return basis[down], basis[across], weight[down, across]


def _coefficients(image: Tensor, rows: Tensor, columns: Tensor) -> Tensor:
    """Coefficients ``(B, K, H / 8, W / 8)`` of a plane ``(B, 1, H, W)``."""
    blocks = image[:, 0].unfold(1, BLOCK_PX, BLOCK_PX).unfold(2, BLOCK_PX, BLOCK_PX)
    patterns = (rows[:, :, None] * columns[:, None, :]).flatten(1)
    found: Tensor = (blocks.flatten(3) @ patterns.T).permute(0, 3, 1, 2)
    return found


def _worst(likeness: Tensor) -> Tensor:
    """Mean ``(B, K)`` over the lowest share of the places, at least one."""
    ordered = likeness.flatten(2).sort(2).values
    return ordered[..., : max(1, round(WORST_SHARE * ordered.shape[-1]))].mean(2)
