"""Radar: a millimetre-wave FMCW radar; its carrier, link budget, chirps and antennas."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, ClassVar, Self, TypedDict, Unpack

import torch
from torch import Tensor

from torchweather.core.arguments import check_arguments, check_broadcast
from torchweather.core.distributions import Distribution
from torchweather.core.errors import InputValueError, check_one_of
from torchweather.core.fields import above, at_least, between, check_fields
from torchweather.physics import SPEED_OF_LIGHT_M_PER_S, radar_constant_db, thermal_noise_dbm
from torchweather.pipeline.sensor import Sensor

__all__ = ["POLARISATIONS", "Radar"]

POLARISATIONS = ("h", "v")
HALF_POWER_DB = 10.0 * math.log10(2.0)
PATTERN_FLOOR_DB = 30.0  # generic: how far below its peak an element's pattern ends
GRID = 1e-6  # positions of the antennas are compared to this many half wavelengths


RANGES = {
    "frequency_ghz": between(1.0, 1000.0, "GHz"),
    "elevation_rad": between(-math.pi / 2, math.pi / 2, "rad"),
    "transmit_power_dbm": between(-100.0, 100.0, "dBm"),
    "antenna_gain_dbi": between(-100.0, 100.0, "dBi"),
    **dict.fromkeys(("azimuth_beamwidth_deg", "elevation_beamwidth_deg"), between(0.01, 360.0, "degrees")),
    **dict.fromkeys(("loss_db", "noise_figure_db", "margin_db"), between(0.0, 100.0, "dB")),
    "noise_floor_db": between(-300.0, 300.0, "dB"),
    "detection_snr_db": between(-100.0, 100.0, "dB"),
    "compensated_to_m": between(0.0, 10_000.0, "m"),
    "bandwidth_mhz": above(0.0, 1e6, "MHz"),
    "sample_rate_mhz": above(0.0, 1e6, "MHz"),
    "chirp_period_us": above(0.0, 1e9, "us"),
    "samples": at_least(2, 1e7, advice="One sample a chirp has no range."),
    "chirps": at_least(1, 1e7),
}
"""Values that a radar's fields take."""


class RadarFields(TypedDict, total=False):
    """Fields that a preset can be given anew, by name; those of `Radar`."""

    frequency_ghz: float
    polarisation: str
    elevation_rad: float | Distribution
    transmit_power_dbm: float | Distribution
    antenna_gain_dbi: float | Distribution
    azimuth_beamwidth_deg: float
    elevation_beamwidth_deg: float
    loss_db: float | Distribution
    noise_figure_db: float | Distribution
    bandwidth_mhz: float
    samples: int
    sample_rate_mhz: float
    chirp_period_us: float
    chirps: int
    tx_half_wavelengths: tuple[tuple[float, float], ...]
    rx_half_wavelengths: tuple[tuple[float, float], ...]
    noise_floor_db: float | Distribution | None
    detection_snr_db: float | Distribution
    margin_db: float | Distribution
    compensated_to_m: float


@dataclass(frozen=True)
class Radar(Sensor):
    """A millimetre-wave FMCW radar with transmitters that take turns (TDM-MIMO) and complex samples.

    Args:
        frequency_ghz: carrier, 1-1000.
        polarisation: ``h`` or ``v``.
        elevation_rad: elevation of the path through the rain (P.838 depends on it weakly).
        transmit_power_dbm: of one transmitter.
        antenna_gain_dbi: of one transmit or receive element at boresight.
        azimuth_beamwidth_deg, elevation_beamwidth_deg: full width of an element's one-way pattern at half power.
        loss_db: of the radar itself, both ways together.
        noise_figure_db: of the receiver.
        bandwidth_mhz: B, swept while sampling; the range resolution is c / 2B.
        samples: of one chirp.
        sample_rate_mhz: of complex samples; also the receiver's noise bandwidth.
        chirp_period_us: T_c, from one chirp to the next, whichever transmitter sends it.
        chirps: of each transmitter in a frame.
        tx_half_wavelengths, rx_half_wavelengths: positions (left, up) of the elements, in half wavelengths.
        noise_floor_db: noise of a detection list, in the unit of its power column; ``None`` is the link budget's, dBm:
            thermal noise less the processing gain.
        detection_snr_db: signal over the noise floor from which a target is detected.
        margin_db: mean of the exponential law by which a listed point exceeds the threshold where its power column says
            that it does not (it was detected, so it did).
        compensated_to_m: range up to which the receiver weakens echoes with ``(R / compensated_to_m)^4``, so that like
            targets look alike; the echoes of rain in recorded power maps follow it. 0: not at all.

    Note:
        The element's pattern is Gaussian in both angles, ``-12 dB (angle / width)^2``, and ends 30 dB below its peak.

    References:
        PHYSICS.md 6.2, 6.4, 6.8.

    Example:
        >>> radar = Radar.preset("awr1843-like")
        >>> radar.virtual_channels, round(radar.range_resolution_m, 3), round(radar.max_speed_m_per_s, 2)
        (12, 0.293, 8.11)
    """

    kind: ClassVar[str] = "radar"
    drawable: ClassVar[tuple[str, ...]] = (
        *("transmit_power_dbm", "antenna_gain_dbi", "loss_db", "noise_figure_db", "noise_floor_db"),
        *("detection_snr_db", "margin_db", "elevation_rad"),
    )

    frequency_ghz: float = 77.0
    polarisation: str = "h"
    elevation_rad: float = 0.0
    transmit_power_dbm: float = 12.0
    antenna_gain_dbi: float = 13.0
    azimuth_beamwidth_deg: float = 65.0
    elevation_beamwidth_deg: float = 25.0
    loss_db: float = 0.0
    noise_figure_db: float = 14.0
    bandwidth_mhz: float = 1000.0
    samples: int = 512
    sample_rate_mhz: float = 12.5
    chirp_period_us: float = 50.0
    chirps: int = 128
    tx_half_wavelengths: tuple[tuple[float, float], ...] = ((0.0, 0.0),)
    rx_half_wavelengths: tuple[tuple[float, float], ...] = ((0.0, 0.0),)
    noise_floor_db: float | None = None
    detection_snr_db: float = 12.0
    margin_db: float = 3.0
    compensated_to_m: float = 0.0

    if TYPE_CHECKING:

        @classmethod
        def preset(cls, name: str, **overrides: Unpack[RadarFields]) -> Self:  # type: ignore[override]
            """As of every sensor."""
            ...

    def __post_init__(self) -> None:
        if self._ends_are_good():
            return
        check_fields(self, RANGES)
        check_one_of("polarisation", self.polarisation, POLARISATIONS, owner=self)
        for name in ("tx_half_wavelengths", "rx_half_wavelengths"):
            object.__setattr__(self, name, _positions(name, getattr(self, name)))
        if self.active_time_s > self.chirp_period_s * (1 + 1e-9):
            raise InputValueError(
                f"Radar: {self.samples} samples at {self.sample_rate_mhz:g} MHz take {1e6 * self.active_time_s:g} us, "
                f"longer than the chirp period of {self.chirp_period_us:g} us. Give fewer samples, a higher "
                "sample_rate_mhz or a longer chirp_period_us."
            )

    # ---- chirps ------------------------------------------------------------------------------------------------

    @property
    def wavelength_m(self) -> float:
        """Of the carrier."""
        return SPEED_OF_LIGHT_M_PER_S / (1e9 * self.frequency_ghz)

    @property
    def active_time_s(self) -> float:
        """While a chirp is sampled."""
        return self.samples / (1e6 * self.sample_rate_mhz)

    @property
    def slope_hz_per_s(self) -> float:
        """S, of the chirp: bandwidth over active time."""
        return 1e6 * self.bandwidth_mhz / self.active_time_s

    @property
    def chirp_period_s(self) -> float:
        """T_c, from one chirp to the next."""
        return 1e-6 * self.chirp_period_us

    @property
    def repetition_period_s(self) -> float:
        """T_r, from one chirp of a transmitter to its next."""
        return self.transmitters * self.chirp_period_s

    @property
    def frame_time_s(self) -> float:
        """Of all chirps."""
        return self.chirps * self.repetition_period_s

    @property
    def range_resolution_m(self) -> float:
        """c / 2B, one bin of the range transform."""
        return SPEED_OF_LIGHT_M_PER_S / (2e6 * self.bandwidth_mhz)

    @property
    def max_range_m(self) -> float:
        """fs c / 2S: what lies beyond appears at a shorter range."""
        return self.samples * self.range_resolution_m

    @property
    def speed_resolution_m_per_s(self) -> float:
        """lambda / (2 N_c T_r), one bin of the Doppler transform."""
        return self.wavelength_m / (2.0 * self.frame_time_s)

    @property
    def max_speed_m_per_s(self) -> float:
        """lambda / (4 T_r), receding or approaching: what is faster appears at another speed."""
        return self.wavelength_m / (4.0 * self.repetition_period_s)

    @property
    def range_doppler_cells(self) -> int:
        """Cells of the range-Doppler map of a frame: samples times chirps."""
        return self.samples * self.chirps

    # ---- antennas ----------------------------------------------------------------------------------------------

    @property
    def transmitters(self) -> int:
        """Number of transmitters."""
        return len(self.tx_half_wavelengths)

    @property
    def receivers(self) -> int:
        """Number of receivers."""
        return len(self.rx_half_wavelengths)

    @property
    def virtual_channels(self) -> int:
        """Pairs of a transmitter and a receiver."""
        return self.transmitters * self.receivers

    @cached_property
    def virtual_half_wavelengths(self) -> Tensor:
        """``(V, 2)`` positions (left, up) of the virtual elements; transmitter k and receiver r are row k N_rx + r."""
        tx = torch.tensor(self.tx_half_wavelengths, dtype=torch.float64)
        rx = torch.tensor(self.rx_half_wavelengths, dtype=torch.float64)
        return (tx[:, None] + rx[None]).reshape(-1, 2)

    def gain_dbi(self, azimuth_rad: Tensor, elevation_rad: Tensor) -> Tensor:
        """Gain of one element, one way, in a direction.

        Args:
            azimuth_rad, elevation_rad: of the direction, any shape.
        """
        check_arguments("Radar.gain_dbi(azimuth_rad: real, elevation_rad: real)", azimuth_rad, elevation_rad)
        check_broadcast("Radar.gain_dbi", azimuth_rad=azimuth_rad, elevation_rad=elevation_rad)
        across = torch.rad2deg(azimuth_rad) / self.azimuth_beamwidth_deg
        up = torch.rad2deg(elevation_rad) / self.elevation_beamwidth_deg
        down_db = 4.0 * HALF_POWER_DB * (across.square() + up.square())
        return self.antenna_gain_dbi - down_db.clamp_max(PATTERN_FLOOR_DB)

    # ---- link budget -------------------------------------------------------------------------------------------

    @property
    def constant_db(self) -> float:
        """Echo at boresight in dBm of 1 m^2 at 1 m."""
        return float(
            radar_constant_db(self.frequency_ghz, self.transmit_power_dbm, 2.0 * self.antenna_gain_dbi, self.loss_db)
        )

    @property
    def noise_power_dbm(self) -> float:
        """Thermal noise of one complex sample."""
        return float(thermal_noise_dbm(1e6 * self.sample_rate_mhz, self.noise_figure_db))

    @property
    def processing_gain_db(self) -> float:
        """Of the transforms over samples, chirps and channels, without windows."""
        return 10.0 * math.log10(self.samples * self.chirps * self.virtual_channels)

    @property
    def floor_db(self) -> float:
        """Noise floor of a detection list: ``noise_floor_db``, or the link budget's in dBm."""
        return self.noise_power_dbm - self.processing_gain_db if self.noise_floor_db is None else self.noise_floor_db


def _positions(name: str, values: object) -> tuple[tuple[float, float], ...]:
    """Element positions as pairs of floats, each its own."""
    try:
        pairs = tuple((float(left), float(up)) for left, up in values)  # type: ignore[attr-defined]
    except (TypeError, ValueError):
        pairs = ()
    if not pairs or not all(math.isfinite(value) for pair in pairs for value in pair):
        raise InputValueError(
            f"Radar: {name} must be pairs (left, up) in half wavelengths, one an element; got {values!r}."
        )
    if len({(round(left / GRID), round(up / GRID)) for left, up in pairs}) < len(pairs):
        raise InputValueError(f"Radar: {name} must hold each position once; got {values!r}.")
    return pairs
