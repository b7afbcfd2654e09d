"""Structural similarity weighted by information content."""

from __future__ import annotations

import math
from functools import partial

import torch
from torch import Tensor
from torch.nn import functional

from torchweather.core.precision import outside_autocast
from torchweather.metrics.colour import luma
from torchweather.metrics.filters import filtered, power, side_by_side
from torchweather.metrics.ms_ssim import MINIMUM_PX, SCALE_WEIGHTS
from torchweather.metrics.pairs import Pair
from torchweather.metrics.pooling import weighted_mean
from torchweather.metrics.ssim import WINDOW_PX, lacking
from torchweather.metrics.strips import in_strips, strips

__all__ = ["iw_ssim", "iw_ssim_of"]

# Burt and Adelson 1983: the binomial filter of the Laplacian pyramid; sum sqrt(2), so that bands keep their energy
BINOMIAL = tuple(math.sqrt(2.0) * weight / 16.0 for weight in (1.0, 4.0, 6.0, 4.0, 1.0))
# Wang and Li 2011, section III.A: neighbours of 3 x 3 pixels, variance of the noise of vision on a scale of 0..255
BLOCK_PX, NOISE_VARIANCE, WHITE = 3, 0.4, 255.0
# share of the mean eigenvalue that is added to all, for references whose pixels depend on each other
REGULAR = 1e-12


def band_and_rest(both: Tensor) -> tuple[Tensor, Tensor]:
    """One level of the Laplacian pyramid: the images less their coarse part, and the coarse part at half the size."""
    # kornia.geometry.pyrdown interpolates instead of taking every second pixel: off by 0.15 of white on noise
    height, width = both.shape[-2:]
    weights = both.new_tensor(BINOMIAL)
    coarse = filtered(functional.pad(both, (2, 2, 2, 2), mode="reflect"), weights, weights, step=2)
    # a zero after every pixel, also after the last of an odd side
    pairs = torch.stack((coarse, torch.zeros_like(coarse)), -1).flatten(-2)
    spread = torch.stack((pairs, torch.zeros_like(pairs)), -2).flatten(-3, -2)
    smooth = filtered(functional.pad(spread, (2, 2, 2, 2), mode="reflect"), weights, weights)
    return both - smooth[..., :height, :width], coarse


def enlarged(image: Tensor, height: int, width: int) -> Tensor:
    """The first pixels of twice as many each way, linear in between."""
    for axis, wanted in ((-2, height), (-1, width)):
        size = image.shape[axis]
        step = torch.arange(wanted, dtype=torch.float64, device=image.device)
        # every second place of those that divide the image into 4 size - 3
        place = ((2.0 * step - 0.5) * (size / (4 * size - 3)) - 0.5).clamp(0, size - 1)
        before = place.long()
        share = (place - before).to(image.dtype)
        first = image.index_select(axis, before)
        second = image.index_select(axis, (before + 1).clamp_max(size - 1))
        image = first + (second - first) * (share[:, None] if axis == -2 else share)
    return image


def neighbours(bands: Tensor) -> Tensor:
    """``(B, K, P)`` of a band, or a band and its enlarged parent, ``(B, 1 or 2, H, W)``: the block around each inner
    pixel, and the pixel's parent."""
    blocks = functional.unfold(bands[:, :1], BLOCK_PX)
    return torch.cat((blocks, bands[:, 1:, 1:-1, 1:-1].flatten(2)), 1)


def information(x: Tensor, y: Tensor, parent: Tensor | None) -> Tensor:
    """Bits that an eye gets from each inner pixel of a distorted band and of its reference, ``(B, 1, H - 2, W - 2)``.

    The neighbours of a pixel are a Gaussian vector times a local scale (Wang and Li 2011, equations 20-28).

    Args:
        x, y: band of the distorted image and of the reference, ``(B, 1, H, W)``.
        parent: next coarser band of the reference, or None.
    """
    bands = y if parent is None else torch.cat((y, enlarged(parent, *y.shape[-2:])), 1)
    spread = covariance(bands)
    count = spread.shape[-1]
    trace = spread.diagonal(dim1=-2, dim2=-1).sum(-1)
    floor = (REGULAR * trace / count + torch.finfo(torch.float32).tiny)[:, None, None]
    unit = torch.eye(count, dtype=spread.dtype, device=spread.device)
    triangle = torch.linalg.cholesky(spread + floor * unit)
    whitening = torch.linalg.solve_triangular(triangle, unit.expand_as(triangle), upper=False).to(y.dtype)
    eigenvalues = torch.linalg.eigvalsh(spread).clamp_min(0.0).to(y.dtype)
    return in_strips(partial(_bits, whitening=whitening, eigenvalues=eigenvalues), BLOCK_PX - 1, x, bands)


def _bright(image: Tensor) -> Tensor:
    """Luma on a scale of 0..255."""
    return luma(WHITE * image)


def covariance(bands: Tensor) -> Tensor:
    """Of the neighbours, ``(B, K, K)``: close to singular where images are smooth, so in float64."""
    total, places = bands.new_zeros((), dtype=torch.float64), 0
    for rows in strips(bands, BLOCK_PX - 1):
        vectors = neighbours(bands[..., rows, :]).double()
        # image by image: products in a batch of so few rows take processors more than twice as long
        total = total + torch.stack([each @ each.mT for each in vectors])
        places += vectors.shape[-1]
    return total / places


def _bits(x: Tensor, bands: Tensor, whitening: Tensor, eigenvalues: Tensor) -> Tensor:
    """Of a strip."""
    y = bands[:, :1]
    # one sum of nine, not three of three: the rounding of flat areas is that of METRICS.md's oracle
    # kornia.filters.box_blur, not separable: 1.6 times the time of a strip (4.5 against 2.9 ms)
    box = y.new_full((5, 1, BLOCK_PX, BLOCK_PX), 1.0 / BLOCK_PX**2)
    moments = functional.conv2d(side_by_side(torch.cat((x, y, x.square(), y.square(), x * y), 1)), box, groups=5)
    mean_x, mean_y, square_x, square_y, product = moments.chunk(5, 1)
    variance_x = (square_x - mean_x.square()).clamp_min(0.0)
    variance_y = (square_y - mean_y.square()).clamp_min(0.0)
    shared = product - mean_x * mean_y
    # next to nothing on a scale of 0..255: no structure that the distorted band could share
    nothing = torch.finfo(y.dtype).eps
    flat = (variance_y < nothing) | (variance_x < nothing)
    gain = torch.where(flat, 0.0, shared / (torch.where(flat, 1.0, variance_y) + nothing))
    rest = (variance_x - gain * shared).clamp_min(0.0)  # of the distorted band, not explained by the reference
    scale = (whitening @ neighbours(bands)).square().mean(1).reshape(gain.shape)
    lost = 1.0 + rest / NOISE_VARIANCE
    seen = (rest + (1.0 + gain.square()) * NOISE_VARIANCE) * scale / NOISE_VARIANCE**2
    bits = torch.zeros_like(scale)
    # the sum of the logarithms, two factors at a time: of all of them the product leaves the range of float32
    for first in range(0, eigenvalues.shape[1], 2):
        factors = torch.ones_like(scale)
        for column in eigenvalues[:, first : first + 2].unbind(1):
            factors = factors * torch.addcmul(lost, seen, column[:, None, None, None])
        bits = bits + torch.log2(factors)
    return bits


@outside_autocast
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
    return iw_ssim_of(Pair(distorted, reference, data_range, minimum=MINIMUM_PX, owner="iw_ssim"))


def iw_ssim_of(pair: Pair) -> Tensor:
    """:func:`iw_ssim` of a pair."""
    # scaled before it is mixed, for the same rounding as the oracle's
    band, rest = band_and_rest(torch.cat([in_strips(_bright, 0, image) for image in pair.images], 1))
    score = torch.ones_like(band[:, 0, 0, 0])
    # the windows of the similarity lie further inside than the blocks
    inside = WINDOW_PX // 2 - BLOCK_PX // 2
    last = len(SCALE_WEIGHTS) - 1
    for scale, exponent in enumerate(SCALE_WEIGHTS):
        coarser, rest = band_and_rest(rest) if scale < last - 1 else (rest, rest)
        x, y = band.chunk(2, 1)
        lack = lacking(x, y, WHITE, brightness=scale == last)
        if scale == last:
            mean = 1.0 - lack.mean((1, 2, 3))
        else:
            # the coarsest band has what is left of the image as its next, which is no parent
            weights = information(x, y, coarser[:, 1:] if scale < last - 1 else None)
            mean = 1.0 - weighted_mean(lack, weights[..., inside:-inside, inside:-inside])
        score = score * power(mean.abs(), exponent / sum(SCALE_WEIGHTS))
        band = coarser
    return pair.per_image(score)
