"""ITU-R P.838-3: specific attenuation of rain at 1-1000 GHz, ``gamma = k R^alpha`` dB/km."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from torchweather.core.arguments import check_arguments, check_broadcast
from torchweather.core.errors import check_at_least, check_between
from torchweather.physics.float64 import Quantity, to_float64

__all__ = ["RainCoefficients", "rain_attenuation_coefficients", "rain_attenuation_p838_db_per_km"]

# ITU-R P.838-3, tables 1-4: terms (a, b, c) of sum a exp(-((lg f - b)/c)^2), then slope and offset in lg f
_K_H = (
    (
        (-5.33980, -0.10008, 1.13098),
        (-0.35351, 1.26970, 0.45400),
        (-0.23789, 0.86036, 0.15354),
        (-0.94158, 0.64552, 0.16817),
    ),
    -0.18961,
    0.71147,
)
_K_V = (
    (
        (-3.80595, 0.56934, 0.81061),
        (-3.44965, -0.22911, 0.51059),
        (-0.39902, 0.73042, 0.11899),
        (0.50167, 1.07319, 0.27195),
    ),
    -0.16398,
    0.63297,
)
_ALPHA_H = (
    (
        (-0.14318, 1.82442, -0.55187),
        (0.29591, 0.77564, 0.19822),
        (0.32177, 0.63773, 0.13164),
        (-5.37610, -0.96230, 1.47828),
        (16.1721, -3.29980, 3.43990),
    ),
    0.67849,
    -1.95537,
)
_ALPHA_V = (
    (
        (-0.07771, 2.33840, -0.76284),
        (0.56727, 0.95545, 0.54039),
        (-0.20238, 1.14520, 0.26809),
        (-48.2991, 0.791669, 0.116226),
        (48.5833, 0.791459, 0.116479),
    ),
    -0.053739,
    0.83433,
)


class RainCoefficients(NamedTuple):
    """Coefficients of ``gamma = k R^alpha`` (dB/km, R in mm/h), horizontal and vertical polarisation, float64."""

    k_horizontal: Tensor
    alpha_horizontal: Tensor
    k_vertical: Tensor
    alpha_vertical: Tensor


def rain_attenuation_coefficients(frequency_ghz: Quantity) -> RainCoefficients:
    """k and alpha of ITU-R P.838-3 for horizontal and vertical polarisation.

    Args:
        frequency_ghz: GHz, 1-1000, any shape.

    References:
        PHYSICS.md 6.5; ITU-R P.838-3 (2005).

    Example:
        >>> [round(float(c), 4) for c in rain_attenuation_coefficients(77.0)]
        [1.132, 0.7177, 1.1276, 0.7073]
    """
    check_arguments("rain_attenuation_coefficients(frequency_ghz: Quantity)", frequency_ghz)
    (frequency,) = to_float64(frequency_ghz)
    check_between("frequency_ghz", frequency, 1.0, 1000.0, unit="GHz", owner="rain_attenuation_coefficients")
    log_f = torch.log10(frequency)

    def curve(table: tuple[tuple[tuple[float, float, float], ...], float, float]) -> Tensor:
        terms, slope, offset = table
        total = slope * log_f + offset
        for a, b, c in terms:
            total = total + a * torch.exp(-(((log_f - b) / c) ** 2))
        return total

    k_h, k_v = (torch.pow(10.0, curve(table)) for table in (_K_H, _K_V))
    return RainCoefficients(k_h, curve(_ALPHA_H), k_v, curve(_ALPHA_V))


def rain_attenuation_p838_db_per_km(
    rate_mm_per_h: Quantity,
    frequency_ghz: Quantity = 77.0,
    *,
    polarisation_tilt_rad: Quantity = 0.0,
    elevation_rad: Quantity = 0.0,
) -> Tensor:
    """Attenuation of rain, dB/km one way: ITU-R P.838-3.

    ``k = [k_H + k_V + (k_H - k_V) cos^2(el) cos(2 tau)] / 2`` and alpha likewise, weighted by k.

    Args:
        rate_mm_per_h: R, mm/h, 0 or more; may require grad.
        frequency_ghz: GHz, 1-1000.
        polarisation_tilt_rad: tau, 0 horizontal, pi/2 vertical, pi/4 circular.
        elevation_rad: of the path above the horizon.

    References:
        PHYSICS.md 6.5; ITU-R P.838-3.

    Example:
        >>> round(float(rain_attenuation_p838_db_per_km(25.0)), 2)
        11.41
    """
    check_arguments(
        "rain_attenuation_p838_db_per_km(rate_mm_per_h: Quantity, frequency_ghz: Quantity, "
        "polarisation_tilt_rad: Quantity, elevation_rad: Quantity)",
        rate_mm_per_h,
        frequency_ghz,
        polarisation_tilt_rad,
        elevation_rad,
    )
    check_broadcast(
        "rain_attenuation_p838_db_per_km",
        rate_mm_per_h=rate_mm_per_h,
        frequency_ghz=frequency_ghz,
        polarisation_tilt_rad=polarisation_tilt_rad,
        elevation_rad=elevation_rad,
    )
    check_at_least("rate_mm_per_h", rate_mm_per_h, 0.0, unit="mm/h", owner="rain_attenuation_p838_db_per_km")
    rate, frequency, tilt, elevation = to_float64(rate_mm_per_h, frequency_ghz, polarisation_tilt_rad, elevation_rad)
    k_h, a_h, k_v, a_v = rain_attenuation_coefficients(frequency)
    mix = torch.cos(elevation) ** 2 * torch.cos(2.0 * tilt)
    k = 0.5 * (k_h + k_v + (k_h - k_v) * mix)
    alpha = 0.5 * (k_h * a_h + k_v * a_v + (k_h * a_h - k_v * a_v) * mix) / k
    # alpha < 1: the slope at no rain is infinite, which no optimiser wants; there it is 0.
    raining = rate > 0
    gamma = k * torch.where(raining, rate, torch.ones_like(rate)) ** alpha
    return torch.where(raining, gamma, torch.zeros_like(gamma))
