"""Phase congruency: how far the frequencies of an image agree on a feature."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple

import torch
from torch import Tensor

from torchweather.core.compiled import uses_compiled
from torchweather.metrics.compiled_phase import add_orientation, finest_power
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
    """Log-Gabor filters over the spectrum, and what white noise leaves behind them."""

    scales: Tensor  # (S, H, W)
    orientations: Tensor  # (O, H, W)
    finest_power: Tensor  # (O,) of unit noise through the finest filter
    real_power: Tensor  # (O,) of the real part of unit noise through the sum of the filters


def _frequencies(count: int, like: Tensor) -> Tensor:
    """Cycles per pixel from -0.5, with 0.5 also reached where the count is odd; zero frequency first."""
    steps = torch.arange(count, device=like.device, dtype=like.dtype) - count // 2
    found: Tensor = torch.fft.ifftshift(steps / max(count - count % 2, 1))
    return found


@lru_cache(maxsize=2)
@torch.inference_mode(False)  # for a call with gradients, too
def _bank(height: int, width: int, dtype: torch.dtype, device: torch.device) -> Bank:
    like = torch.empty(0, dtype=dtype, device=device)
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
    finest, real = [], []
    for turned_filter in orientations:
        finest.append((turned_filter * scales[0]).square().sum())
        # A filter's real part over the image is its even part over the spectrum; powers are alike (Parseval).
        together = turned_filter * torch.stack(scales).sum(0)
        turned = together.flip((0, 1)).roll((1, 1), (0, 1))
        real.append((0.5 * (together + turned)).square().sum())
    return Bank(torch.stack(scales), torch.stack(orientations), torch.stack(finest), torch.stack(real))


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
    bank = _bank(*image.shape[-2:], image.dtype, image.device)
    # Image by image and orientation by orientation: 16 complex responses of a pair at once are hundreds of MB.
    return torch.cat([_of_one(one, bank) for one in torch.split(image, 1)]) if len(image) else image.clone()


def _of_one(image: Tensor, bank: Bank) -> Tensor:
    """`phase_congruency` of one image ``(1, 1, H, W)``."""
    # The filters pass no mean; without a common value, a flat image is 0 and not rounding noise.
    spectrum = torch.fft.fft2((image - image[..., :1, :1].detach())[0, 0])
    learns = torch.is_grad_enabled() and image.requires_grad
    if uses_compiled() and image.dtype == torch.float32 and image.device.type == "cpu" and not learns:
        return _by_compiled(spectrum.detach(), bank)
    above, amplitudes = torch.zeros_like(image[0, 0]), torch.zeros_like(image[0, 0])
    for orientation, *powers in zip(bank.orientations, bank.finest_power, bank.real_power, strict=True):
        response = torch.fft.ifft2(spectrum * (bank.scales * orientation))  # (S, H, W)
        even, odd = response.real, response.imag
        squared = even.square() + odd.square()
        even_sum, odd_sum = even.sum(0), odd.sum(0)
        strength = root(even_sum.square() + odd_sum.square())
        even_mean, odd_mean = ratio(even_sum, strength), ratio(odd_sum, strength)
        # Summed over the scales, what is in phase with the mean phase is what the sums have of it.
        in_phase = even_sum * even_mean + odd_sum * odd_mean
        across = (even * odd_mean - odd * even_mean).abs().sum(0)
        above = above + (in_phase - across - _noise(squared[0].flatten().median(), *powers)).clamp(min=0)
        amplitudes = amplitudes + (root(squared) if squared.requires_grad else squared.sqrt()).sum(0)
    return ratio(above, amplitudes)[None, None]


def _by_compiled(spectrum: Tensor, bank: Bank) -> Tensor:
    """The same in compiled loops."""
    above, amplitudes = torch.zeros(2, *spectrum.shape)
    filtered = torch.empty(SCALES, *spectrum.shape, dtype=spectrum.dtype)
    for orientation, *powers in zip(bank.orientations, bank.finest_power, bank.real_power, strict=True):
        torch.mul(bank.scales, spectrum * orientation, out=filtered)
        responses = torch.fft.ifft2(filtered)
        median = torch.tensor(finest_power(responses[0]))
        add_orientation(responses, float(_noise(median, *powers)), above, amplitudes)
    return ratio(above, amplitudes)[None, None]


def _noise(median: Tensor, power_of_finest: Tensor, real_power: Tensor) -> Tensor:
    """Threshold on the energy, from the median of the squared amplitudes of the finest scale and powers of filters."""
    # Squared amplitudes of Gaussian noise are exponentially distributed: mean = median / ln 2
    power = median / math.log(2.0) / power_of_finest
    # Rayleigh distribution: mean sqrt(pi / 2) tau, variance (2 - pi / 2) tau^2. Energy of white noise through the sum
    # of the filters: tau^2.
    tau = root(power * real_power)
    level = math.sqrt(math.pi / 2.0) + NOISE_DEVIATIONS * math.sqrt(2.0 - math.pi / 2.0)
    found: Tensor = tau * level / NOISE_DIVISOR
    return found
