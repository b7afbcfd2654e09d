"""Structural similarity weighted by information content."""

from __future__ import annotations

import math

import torch
from torch import Tensor
from torch.nn import functional

from torchweather.metrics.colour import luma
from torchweather.metrics.filters import filtered, power
from torchweather.metrics.ms_ssim import MINIMUM_PX, SCALE_WEIGHTS
from torchweather.metrics.pairs import check_pair, per_image
from torchweather.metrics.ssim import WINDOW_PX, similarity_maps

__all__ = ["iw_ssim"]

# Burt and Adelson 1983: the binomial filter of the Laplacian pyramid; sum sqrt(2), so that bands keep their energy
BINOMIAL = tuple(math.sqrt(2.0) * weight / 16.0 for weight in (1.0, 4.0, 6.0, 4.0, 1.0))
# Wang and Li 2011, section III.A: neighbours of 3 x 3 pixels, variance of the noise of vision on a scale of 0..255
BLOCK_PX, NOISE_VARIANCE, WHITE = 3, 0.4, 255.0
# share of the mean eigenvalue that is added to all, for references whose pixels depend on each other
REGULAR = 1e-12


def band_and_rest(image: Tensor) -> tuple[Tensor, Tensor]:
    """One level of the Laplacian pyramid: the image less its coarse part, and the coarse part at half the size."""
    height, width = image.shape[-2:]
    weights = image.new_tensor(BINOMIAL)
    coarse = filtered(functional.pad(image, (2, 2, 2, 2), mode="reflect"), weights, weights)[..., ::2, ::2]
    # a zero after every pixel, also after the last of an odd side
    pairs = torch.stack((coarse, torch.zeros_like(coarse)), -1).flatten(-2)
    spread = torch.stack((pairs, torch.zeros_like(pairs)), -2).flatten(-3, -2)
    smooth = filtered(functional.pad(spread, (2, 2, 2, 2), mode="reflect"), weights, weights)
    return image - smooth[..., :height, :width], coarse


def enlarged(image: Tensor) -> Tensor:
    """Twice as many pixels each way: linear in between, the outermost go on with the slope of the edge."""
    rows, columns = (4 * side - 3 for side in image.shape[-2:])
    fine = functional.interpolate(image, size=(rows, columns), mode="bilinear", align_corners=False)
    for axis in (-2, -1):
        first, second = fine.narrow(axis, 0, 1), fine.narrow(axis, 1, 1)
        last, before = fine.narrow(axis, -1, 1), fine.narrow(axis, -2, 1)
        fine = torch.cat((2.0 * first - second, fine, 2.0 * last - before), axis)
    return fine[..., ::2, ::2]


def neighbours(band: Tensor, parent: Tensor | None) -> Tensor:
    """``(B, K, P)``: the block around each inner pixel, and the pixel's parent in the next coarser band."""
    blocks = functional.unfold(band, BLOCK_PX)
    if parent is None:
        return blocks
    height, width = band.shape[-2:]
    return torch.cat((blocks, enlarged(parent)[..., 1 : height - 1, 1 : width - 1].flatten(2)), 1)


def information(x: Tensor, y: Tensor, parent: Tensor | None) -> Tensor:
    """Bits that an eye gets from each inner pixel of a distorted band and of its reference, ``(B, 1, H - 2, W - 2)``.

    The neighbours of a pixel are a Gaussian vector times a local scale (Wang and Li 2011, equations 20-28).

    Args:
        x, y: band of the distorted image and of the reference, ``(B, 1, H, W)``.
        parent: next coarser band of the reference, or None.
    """
    box = y.new_full((1, 1, BLOCK_PX, BLOCK_PX), 1.0 / BLOCK_PX**2)
    moments = functional.conv2d(torch.cat((x, y, x.square(), y.square(), x * y)), box)
    mean_x, mean_y, square_x, square_y, product = moments.chunk(5)
    variance_x = (square_x - mean_x.square()).clamp_min(0.0)
    variance_y = (square_y - mean_y.square()).clamp_min(0.0)
    covariance = product - mean_x * mean_y
    # next to nothing on a scale of 0..255: no structure that the distorted band could share
    nothing = torch.finfo(y.dtype).eps
    flat = (variance_y < nothing) | (variance_x < nothing)
    gain = torch.where(flat, 0.0, covariance / (torch.where(flat, 1.0, variance_y) + nothing))
    rest = (variance_x - gain * covariance).clamp_min(0.0)  # of the distorted band, not explained by the reference
    vectors = neighbours(y, parent)
    count = vectors.shape[1]
    # the covariance of neighbours is close to singular where images are smooth: in float64
    wide = vectors.double()
    spread = wide @ wide.mT / wide.shape[-1]
    trace = spread.diagonal(dim1=-2, dim2=-1).sum(-1)
    floor = (REGULAR * trace / count + torch.finfo(torch.float32).tiny)[:, None, None]
    unit = torch.eye(count, dtype=spread.dtype, device=spread.device)
    triangle = torch.linalg.cholesky(spread + floor * unit)
    whitening = torch.linalg.solve_triangular(triangle, unit.expand_as(triangle), upper=False).to(y.dtype)
    eigenvalues = torch.linalg.eigvalsh(spread).clamp_min(0.0).to(y.dtype)
    scale = (whitening @ vectors).square().mean(1).reshape(gain.shape)
    lost = 1.0 + rest / NOISE_VARIANCE
    seen = (rest + (1.0 + gain.square()) * NOISE_VARIANCE) * scale / NOISE_VARIANCE**2
    bits = torch.zeros_like(scale)
    # the sum of the logarithms, two factors at a time: of all of them the product leaves the range of float32
    for pair in eigenvalues.split(2, dim=1):
        factors = torch.ones_like(scale)
        for column in pair.unbind(1):
            factors = factors * (lost + seen * column[:, None, None, None])
        bits = bits + torch.log2(factors)
    return bits


def iw_ssim(distorted: Tensor, reference: Tensor, *, data_range: float = 1.0) -> Tensor:
    """Structural similarity of the luma at five scales, each pixel weighted by the information it carries.

    ``prod_j |sum_i w_ij cs_ij / sum_i w_ij|^b_j`` over the pixels ``i`` of the bands ``j`` of a Laplacian pyramid: the
    factor of contrast and structure of SSIM, at the coarsest scale the whole SSIM with equal weights. ``w`` is the
    mutual information between image and perception, of the reference and of the distorted image together, under a
    Gaussian scale mixture of 3 x 3 neighbours and the parent.

    Args:
        distorted, reference: ``(..., C, H, W)`` in ``[0, data_range]``, grey or RGB (ITU-R BT.601 luma).
        data_range: value of white.

    Returns:
        ``(...)`` from 0 to 1; higher is better; 1 for identical images. Least size 161 x 161.

    Note:
        An odd side of the pyramid is mirrored about a line of zeros after its last, as in METRICS.md's oracle (about
        the last itself, the score differs by up to 1e-5). The covariance of the neighbours is regularised by 1e-12 of
        its mean eigenvalue, so a flat reference has a score. Where no pixel carries information, all weigh the same.
        Where the reference is constant but for rounding and the distorted image is not, the weight of a pixel follows
        that rounding: 4e-6 of the score on images with large flat areas. In float32 the score is good to 3e-3.

    References:
        Wang, Li, Information content weighting for perceptual image quality assessment, IEEE Trans. Image Process. 20
        (2011); Burt, Adelson, The Laplacian pyramid as a compact image code, IEEE Trans. Commun. 31 (1983);
        METRICS.md 1.

    Example:
        >>> ramp = torch.linspace(0.0, 1.0, 161).expand(1, 161, 161)
        >>> float(iw_ssim(ramp, ramp))
        1.0
    """
    x, y = check_pair(distorted, reference, data_range, minimum=MINIMUM_PX, owner="iw_ssim")
    (band_x, x), (band_y, y) = band_and_rest(luma(x * WHITE)), band_and_rest(luma(y * WHITE))
    score = torch.ones_like(y[:, 0, 0, 0])
    # the windows of the similarity lie further inside than the blocks
    inside = WINDOW_PX // 2 - BLOCK_PX // 2
    last = len(SCALE_WEIGHTS) - 1
    for scale, exponent in enumerate(SCALE_WEIGHTS):
        (next_x, x), (next_y, y) = (band_and_rest(x), band_and_rest(y)) if scale < last - 1 else ((x, x), (y, y))
        whole, structure = similarity_maps(band_x, band_y, WHITE)
        if scale == last:
            mean = whole.mean((1, 2, 3))
        else:
            # the coarsest band has what is left of the image as its next, which is no parent
            weights = information(band_x, band_y, next_y if scale < last - 1 else None)
            weights = weights[..., inside:-inside, inside:-inside]
            total = weights.sum((1, 2, 3))
            there = total > 0
            # what is missing from 1, so that nothing missing gives 1 exactly
            lacking = (weights * (1.0 - structure)).sum((1, 2, 3)) / torch.where(there, total, torch.ones_like(total))
            mean = torch.where(there, 1.0 - lacking, structure.mean((1, 2, 3)))
        score = score * power(mean.abs(), exponent / sum(SCALE_WEIGHTS))
        band_x, band_y = next_x, next_y
    return per_image(score, reference)
