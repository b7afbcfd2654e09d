"""RangeDopplerMap: the range-Doppler map of a cube given as two real tensors, by real arithmetic alone."""

from __future__ import annotations

import math

import torch
from torch import Tensor, nn

from torchweather.core.arguments import check_arguments
from torchweather.core.errors import InputTypeError, InputValueError, check_one_of
from torchweather.radar.fmcw.windows import WINDOWS, window
from torchweather.radar.sensor import Radar

__all__ = ["RangeDopplerMap"]

SMALLEST_MW = 1e-30  # keeps logarithms finite


class RangeDopplerMap(nn.Module):
    """Range-Doppler map for machines without complex numbers: what ``range_doppler`` gives, as matrix products.

    Each transform is a product with its cosines and sines, which hold the window and, over the chirps, the shift that
    puts speed 0 at bin ``N_c // 2``; so every length is as good as a power of two.

    Args:
        radar: the sensor.
        window_name: one of ``WINDOWS``, for both transforms.

    Note:
        float32; rounding is below 1e-6 of the largest sample. The transmitters' turns are not taken out.

    References:
        PHYSICS.md 6.4.

    Example:
        >>> radar = Radar.preset("awr1843-like", samples=200, chirps=48)
        >>> cube = torch.ones(12, 48, 200)
        >>> real, imaginary, power_dbm = RangeDopplerMap(radar)(cube, 0 * cube)
        >>> power_dbm.shape, round(float(power_dbm[24, 0]), 3)
        (torch.Size([48, 200]), 0.0)
    """

    range_cos: Tensor
    range_sin: Tensor
    doppler_cos: Tensor
    doppler_sin: Tensor

    def __init__(self, radar: Radar, window_name: str = "hann") -> None:
        check_arguments("RangeDopplerMap(radar: Radar, window_name: str)", radar, window_name)
        super().__init__()
        Radar.check(radar, "radar", "awr1843-like", owner=self)
        check_one_of("window_name", window_name, WINDOWS, owner=self)
        self.radar, self.window_name = radar, window_name
        for axis, length, shift in (("range", radar.samples, 0), ("doppler", radar.chirps, radar.chirps // 2)):
            place = torch.arange(length, dtype=torch.int64)
            # Whole turns are taken off in integers: the cosines are exact to the last bit of float64.
            turns = (place[:, None] * (place - shift)) % length
            phase = turns.double() * (2.0 * math.pi / length)
            weights = window(window_name, length)[:, None]
            self.register_buffer(f"{axis}_cos", (weights * phase.cos()).float())
            self.register_buffer(f"{axis}_sin", (weights * phase.sin()).float())

    def forward(self, real: Tensor, imaginary: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Map of each channel and their mean power.

        Args:
            real, imaginary: ``(..., V, N_c, N_s)`` parts of the samples, square root of milliwatts.

        Returns:
            Real and imaginary part of the map ``(..., V, N_c, N_s)``, and its power ``(..., N_c, N_s)`` in dBm, the
            mean over the channels.
        """
        self._check(real, imaginary)
        cos, sin = self.range_cos, self.range_sin
        real, imaginary = real @ cos + imaginary @ sin, imaginary @ cos - real @ sin
        cos, sin = self.doppler_cos.T, self.doppler_sin.T
        real, imaginary = cos @ real + sin @ imaginary, cos @ imaginary - sin @ real
        power = (real.square() + imaginary.square()).mean(-3)
        return real, imaginary, 10.0 * power.clamp_min(SMALLEST_MW).log10()

    def _check(self, real: Tensor, imaginary: Tensor) -> None:
        wanted = (self.radar.virtual_channels, self.radar.chirps, self.radar.samples)
        for name, part in (("real", real), ("imaginary", imaginary)):
            if part.ndim < 3 or tuple(part.shape[-3:]) != wanted:
                raise InputValueError(
                    f"RangeDopplerMap: {name} must be (..., {wanted[0]} virtual channels, {wanted[1]} chirps, "
                    f"{wanted[2]} samples), those of the radar; got {tuple(part.shape)}."
                )
            if part.dtype != self.range_cos.dtype:
                raise InputTypeError(
                    f"RangeDopplerMap: {name} must be {self.range_cos.dtype}, as the map; got {part.dtype}. Use "
                    "cube.real and cube.imag."
                )
