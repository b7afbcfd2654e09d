"""Luminance in cd/m^2 and the linear signal that an exposure makes of it, and back.

ISO 2720 and ISO 12232: a surface of luminance L gives the sensor the exposure ``H = q L t / N^2`` (lx s), t the
exposure time and N the f-number, with ``q = 0.65`` for a lens that lets 90 % of the light through, 10 degrees off its
axis. The saturation-based speed S is defined by ``H_sat = 78 / S``, so the signal over saturation is
``q L t S / (78 N^2)``. What a camera prints as ISO may be another of the standard's speeds (the standard output
sensitivity has half a stop and more of headroom, ``H_sat`` then unknown): a grey card of known luminance decides.
"""

from __future__ import annotations

from dataclasses import dataclass

from torch import Tensor

from torchweather.core.arguments import check_arguments
from torchweather.core.errors import InputValueError, check_at_least, check_between
from torchweather.physics.float64 import Quantity, to_float64

__all__ = [
    "LuminanceExposure",
    "airlight_from_luminance",
    "luminance_from_signal",
    "signal_from_luminance",
]

SATURATION_LX_S = 78.0  # ISO 12232: exposure at saturation times the saturation-based speed
LENS_FACTOR = 0.65  # ISO 2720 and ISO 12232: pi/4 x transmission 0.90 x vignetting 0.98 x cos^4 of 10 degrees


@dataclass(frozen=True)
class LuminanceExposure:
    """Exposure of a camera: the factor from luminance to signal.

    Args:
        iso: saturation-based speed, 1 to 10,000,000.
        f_number: 0.5 to 128.
        exposure_s: exposure time, 1e-7 to 3600 s.
        lens_factor: q, 0.01 to 0.79 (that is pi/4, a lens without any loss on its axis).

    Raises:
        InputValueError: a value outside its range.

    Example:
        >>> sunny_16 = LuminanceExposure(iso=100, f_number=16, exposure_s=0.01)
        >>> round(sunny_16.saturation_cd_per_m2)
        30720
    """

    iso: float
    f_number: float
    exposure_s: float
    lens_factor: float = LENS_FACTOR

    def __post_init__(self) -> None:
        check_arguments(
            "LuminanceExposure(iso: float, f_number: float, exposure_s: float, lens_factor: float)",
            self.iso,
            self.f_number,
            self.exposure_s,
            self.lens_factor,
        )
        check_between("iso", self.iso, 1.0, 1e7, owner=self)
        check_between("f_number", self.f_number, 0.5, 128.0, owner=self)
        check_between("exposure_s", self.exposure_s, 1e-7, 3600.0, unit="s", owner=self)
        check_between("lens_factor", self.lens_factor, 0.01, 0.79, owner=self)

    @property
    def saturation_cd_per_m2(self) -> float:
        """Luminance that just saturates, cd/m^2."""
        return SATURATION_LX_S * self.f_number**2 / (self.lens_factor * self.exposure_s * self.iso)


def signal_from_luminance(luminance_cd_per_m2: Quantity, exposure: LuminanceExposure) -> Tensor:
    """Linear signal of a luminance, share of saturation; above 1 the sensor clips.

    Args:
        luminance_cd_per_m2: 0 or more, any shape.
        exposure: of the camera.

    Returns:
        float64, same shape, not clipped.

    References:
        ISO 2720:1974; ISO 12232:2019, saturation-based speed.

    Example:
        >>> import torch
        >>> sky = torch.tensor([2000.0, 10_000.0])  # the horizon of an overcast day
        >>> signal_from_luminance(sky, LuminanceExposure(iso=100, f_number=16, exposure_s=0.01)).round(decimals=3)
        tensor([0.0650, 0.3260], dtype=torch.float64)
    """
    check_arguments(
        "signal_from_luminance(luminance_cd_per_m2: Quantity, exposure: LuminanceExposure)",
        luminance_cd_per_m2,
        exposure,
    )
    (luminance,) = to_float64(luminance_cd_per_m2)
    check_at_least("luminance_cd_per_m2", luminance, 0.0, unit="cd/m^2", owner="signal_from_luminance")
    return luminance / exposure.saturation_cd_per_m2


def luminance_from_signal(signal: Quantity, exposure: LuminanceExposure) -> Tensor:
    """Luminance of a linear signal, cd/m^2: the inverse of `signal_from_luminance`.

    Args:
        signal: share of saturation, 0 to 1, black level taken away, any shape; 1 is the least luminance that saturates.
        exposure: of the camera.

    Returns:
        float64, same shape.

    Example:
        >>> float(luminance_from_signal(0.5, LuminanceExposure(iso=100, f_number=16, exposure_s=0.01)))
        15360.0
    """
    check_arguments("luminance_from_signal(signal: Quantity, exposure: LuminanceExposure)", signal, exposure)
    (share,) = to_float64(signal)
    check_between("signal", share, 0.0, 1.0, unit="of saturation", owner="luminance_from_signal")
    return share * exposure.saturation_cd_per_m2


def airlight_from_luminance(
    luminance_cd_per_m2: float,
    *,
    iso: float,
    f_number: float,
    exposure_s: float,
    lens_factor: float = LENS_FACTOR,
) -> float:
    """Airlight, as the transforms' ``airlight=`` takes it, of a fog of known luminance.

    Args:
        luminance_cd_per_m2: of the fog near the horizon, 0 or more; an overcast day has 2,000 to 10,000 cd/m^2.
        iso, f_number, exposure_s, lens_factor: see `LuminanceExposure`.

    Returns:
        Linear signal, share of saturation, 0 to 1; the same in the three colours of a white-balanced frame.

    Raises:
        InputValueError: a value outside its range, or a fog so bright that it saturates the sensor.

    Example:
        >>> round(airlight_from_luminance(4000.0, iso=100, f_number=8, exposure_s=0.005), 3)
        0.26
    """
    check_arguments("airlight_from_luminance(luminance_cd_per_m2: float)", luminance_cd_per_m2)
    exposure = LuminanceExposure(iso, f_number, exposure_s, lens_factor)
    signal = float(signal_from_luminance(float(luminance_cd_per_m2), exposure))
    if signal > 1.0:
        raise InputValueError(
            f"airlight_from_luminance: expected a luminance of at most {exposure.saturation_cd_per_m2:.0f} cd/m^2, "
            f"which saturates this exposure; got {luminance_cd_per_m2:g}. Pass exposure_s={exposure_s / signal:.3g} or "
            "less, or airlight=1.0 for a fog that clips."
        )
    return signal
