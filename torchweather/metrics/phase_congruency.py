"""Phase congruency: how far the frequencies of an image agree on a feature."""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor

from torchweather.metrics.filters import root
from torchweather.metrics.pooling import ratio

__all__ = ["phase_congruency"]

# Zhang et al. 2011, section II.A, and the implementation that the authors publish with it (after Kovesi 1999).
SCALES = 4
ORIENTATIONS = 4
SHORTEST_WAVE_PX = 6.0
SCALE_STEP = 2.0
# Width of the log-Gabor filters: sigma over centre frequency, and angular spacing over angular sigma
BANDWIDTH = 0.55
ANGULAR_OVERLAP = 1.2
# Deviations of noise above its mean that a feature must pass; the authors lower the threshold by 1.7 after.
NOISE_DEVIATIONS = 2.0
NOISE_DIVISOR = 1.7
# Butterworth low pass that keeps the corners of the spectrum out: cutoff (cycles per pixel) and order
CUTOFF = 0.45
ORDER = 15


class Bank(NamedTuple):
    """Log-Gabor filters over the spectrum."""

    scales: Tensor  # (S, H, W)
    orientations: Tensor  # (O, H, W)


def _frequencies(count: int, like: Tensor) -> Tensor:
    """Cycles per pixel from -0.5, with 0.5 also reached where the count is odd; zero frequency first."""
    steps = torch.arange(count, device=like.device, dtype=like.dtype) - count // 2
    found: Tensor = torch.fft.ifftshift(steps / max(count - count % 2, 1))
    return found


def _bank(height: int, width: int, like: Tensor) -> Bank:
    down, right = torch.meshgrid(_frequencies(height, like), _frequencies(width, like), indexing="ij")
    radius = torch.hypot(down, right)
    # Measured from the rows: the same four orientations; only the Nyquist frequencies of even sides tell it apart.
    angle = torch.atan2(-right, down)
    low_pass = 1.0 / (1.0 + (radius / CUTOFF) ** (2 * ORDER))
    origin = radius == 0
    safe = torch.where(origin, torch.ones_like(radius), radius)
    scales = []
    for scale in range(SCALES):
        centre = 1.0 / (SHORTEST_WAVE_PX * SCALE_STEP**scale)
        ring = torch.exp(-(safe / centre).log().square() / (2.0 * math.log(BANDWIDTH) ** 2)) * low_pass
        scales.append(torch.where(origin, torch.zeros_like(ring), ring))
    sigma = math.pi / ORIENTATIONS / ANGULAR_OVERLAP
    orientations = []
    for orientation in range(ORIENTATIONS):
        off = angle - orientation * math.pi / ORIENTATIONS
        off = torch.atan2(off.sin(), off.cos())
        orientations.append(torch.exp(-off.square() / (2.0 * sigma**2)))
    return Bank(torch.stack(scales), torch.stack(orientations))


def phase_congruency(image: Tensor) -> Tensor:
    """Energy of the local frequencies in phase, above noise, over the sum of their amplitudes.

    Per orientation o the responses of log-Gabor filters at scales n have amplitude A_no; the energy E_o is what they
    have in common with their mean phase, less the spread about it, less the threshold T_o that noise reaches:
    ``PC = sum_o max(E_o - T_o, 0) / sum_o sum_n A_no``. T_o follows from the median of the finest scale.

    Args:
        image: ``(B, 1, H, W)``, any scale: the result ignores brightness and contrast.

    Returns:
        ``(B, 1, H, W)`` in 0..1; 0 for a flat image.

    References:
        P. Kovesi, "Image features from phase congruency", Videre 1(3), 1999.
        L. Zhang, L. Zhang, X. Mou, D. Zhang, "FSIM: a feature similarity index for image quality assessment", IEEE
        Trans. Image Process. 20(8), 2011, section II.A.
    """
    height, width = image.shape[-2:]
    bank = _bank(height, width, image)
    filters = bank.orientations[:, None] * bank.scales  # (O, S, H, W)
    # The filters pass no mean; without a common value, a flat image is 0 and not rounding noise.
    spectrum = torch.fft.fft2(image - image[..., :1, :1].detach())
    response = torch.fft.ifft2(spectrum[:, :, None] * filters)  # (B, O, S, H, W)
    even, odd = response.real, response.imag
    amplitude = root(even.square() + odd.square())
    even_sum, odd_sum = even.sum(2, keepdim=True), odd.sum(2, keepdim=True)
    strength = root(even_sum.square() + odd_sum.square())
    even_mean, odd_mean = ratio(even_sum, strength), ratio(odd_sum, strength)
    in_phase = even * even_mean + odd * odd_mean
    across = (even * odd_mean - odd * even_mean).abs()
    energy = (in_phase - across).sum(2)
    above = (energy - _noise(amplitude[:, :, 0], filters)).clamp(min=0)
    return ratio(above.sum(1, keepdim=True), amplitude.sum((1, 2))[:, None])


def _noise(finest: Tensor, filters: Tensor) -> Tensor:
    """Threshold ``(B, O, 1, 1)`` on the energy, from the amplitudes ``(B, O, H, W)`` of the finest scale."""
    height, width = finest.shape[-2:]
    squared = finest.square().flatten(2).sort(2).values
    middle = squared[..., (squared.shape[-1] - 1) // 2]  # the lower of two
    # Squared amplitudes of Gaussian noise are exponentially distributed: mean = median / ln 2
    power = middle / math.log(2.0) / filters[:, 0].square().sum((1, 2))
    # Energy of white noise through the sum of the filters: squares of sums are squares plus twice the cross terms
    shapes = torch.fft.ifft2(filters).real * math.sqrt(height * width)
    squares = shapes.square().sum((1, 2, 3))
    crossed = (shapes.sum(1).square().sum((1, 2)) - squares) / 2.0
    # Rayleigh distribution: mean sqrt(pi / 2) tau, variance (2 - pi / 2) tau^2
    tau = root(power * (squares + 2.0 * crossed))
    level = math.sqrt(math.pi / 2.0) + NOISE_DEVIATIONS * math.sqrt(2.0 - math.pi / 2.0)
    found: Tensor = (tau * level / NOISE_DIVISOR)[..., None, None]
    return found
