r"""Radar stage volume_clutter: what drops and flakes send back themselves.

The rain in a cell of the map, of volume V and reflectivity eta, has the cross section ``eta V``, with
``V = pi / (4 ln 2) theta phi R^2 dR`` for the two-way widths theta and phi of the beam: its echo falls with the square
of the range. Many drops add up with random phases, so that the power of a cell follows an exponential law about its
mean P(R). Above the threshold T there are, per metre,

    dN/dR = (cells per range bin / dR) exp(-T / P(R))

cells, which is what is drawn: ranges in the order in which they come, by inverting the integral of dN/dR, and powers
above T by the same exponential law once more.

References:
    PHYSICS.md 6.5.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Mapping
from dataclasses import replace
from functools import lru_cache
from typing import Any, ClassVar

import torch
from torch import Tensor, nn

from torchweather.atmosphere.density_field import mean_density
from torchweather.atmosphere.weather import Rain, Snow, Weather, weather_from_dict
from torchweather.core.arguments import check_arguments
from torchweather.core.errors import InputTypeError, check_at_least, check_between
from torchweather.core.random import Variate
from torchweather.lidar.returns.beam_particles import RATE_HIGH_MM_PER_H, RATE_LOW_MM_PER_H, RATE_NODES
from torchweather.physics import InterpolationTable, reflectivity_weighted_fall_speed
from torchweather.pipeline.registry import register
from torchweather.pipeline.stage import Stage
from torchweather.pipeline.tiling import is_exporting
from torchweather.radar.sensor import Radar
from torchweather.radar.state import RadarState

__all__ = [
    "FallingReflectivity",
    "VolumeClutter",
    "cell_volume_m3",
    "clutter_directions_rad",
    "radial_speed_m_per_s",
    "two_way_widths_rad",
    "view_rad",
]

DB = math.log(10.0) / 10.0
ARRAY_WIDTH = 0.886  # half-power width of a row of n equal elements half a wavelength apart: 0.886 * 2 / n rad
GAUSSIAN_AREA = math.pi / (4.0 * math.log(2.0))  # solid angle of a Gaussian beam over the product of its widths
RANGE_NODES = 256
VIEW_WIDTHS = 2.0  # clutter is looked for within so many one-way widths: to 12 dB below the peak, one way
NEVER = 1e-30
FULL = 0.8  # expected share of the rows that are taken where clutter abounds: what comes beyond them is the farthest
DIRECTIONS = (25, 15)  # patches of the view in azimuth and elevation: 0.08 and 0.13 widths each
FWHM_PER_STD = 2.0 * math.sqrt(2.0 * math.log(2.0))


def two_way_widths_rad(radar: Radar) -> tuple[float, float]:
    """Two-way half-power widths (azimuth, elevation) of the radar's beam: element twice, and the virtual array.

    ``1 / theta^2 = 2 / theta_element^2 + 1 / theta_array^2``; a virtual element's phase is already two-way.

    Example:
        >>> [round(math.degrees(width), 1) for width in two_way_widths_rad(Radar.preset("awr1843-like"))]
        [12.1, 18.4]
    """
    one_way = (math.radians(radar.azimuth_beamwidth_deg), math.radians(radar.elevation_beamwidth_deg))
    widths = []
    for axis in (0, 1):
        extent = 0.0  # of the virtual array: both arrays' together
        for elements in (radar.tx_half_wavelengths, radar.rx_half_wavelengths):
            places = [element[axis] for element in elements]
            extent += max(places) - min(places)
        inverse = 2.0 / one_way[axis] ** 2
        if extent > 0:
            inverse += ((extent + 1.0) / (2.0 * ARRAY_WIDTH)) ** 2
        widths.append(inverse**-0.5)
    return widths[0], widths[1]


def cell_volume_m3(range_m: Tensor, radar: Radar) -> Tensor:
    """Volume of one cell of the map, ``pi / (4 ln 2) theta phi R^2 dR`` with the two-way widths.

    Args:
        range_m: of the cell, any shape.

    References:
        PHYSICS.md 6.5.
    """
    azimuth, elevation = two_way_widths_rad(radar)
    return GAUSSIAN_AREA * azimuth * elevation * radar.range_resolution_m * range_m.square()


@lru_cache(maxsize=32)
def _table(weather: Rain | Snow, frequency_ghz: float) -> InterpolationTable:
    """Reflectivity, mean and standard deviation of the fall speed over the rate."""

    def of_rate(rate: Tensor) -> Tensor:
        melted, slower = (weather.melt_fraction, weather.visibility_spread) if isinstance(weather, Snow) else (0.0, 1.0)
        reflectivity, mean, std = reflectivity_weighted_fall_speed(
            weather.distribution(rate), frequency_ghz, temperature_c=weather.temperature_c, melt_fraction=melted
        )
        return torch.stack((reflectivity, mean / slower, std / slower), -1)

    return InterpolationTable(of_rate, RATE_LOW_MM_PER_H, RATE_HIGH_MM_PER_H, RATE_NODES, zero_at_zero=True)


class FallingReflectivity(nn.Module):
    """Reflectivity and Doppler of rain or snow over its rate.

    Args:
        weather: its size distribution counts; its rate is the intensity.
        frequency_ghz: of the carrier.
    """

    rate_mm_per_h: Tensor

    def __init__(self, weather: Rain | Snow, frequency_ghz: float) -> None:
        super().__init__()
        self.weather = weather
        self.table = copy.deepcopy(_table(replace(weather, rate_mm_per_h=0.0), float(frequency_ghz)))
        self.register_buffer("rate_mm_per_h", torch.as_tensor(weather.rate_mm_per_h, dtype=torch.float32))

    def forward(self, batch: int) -> tuple[Tensor, Tensor, Tensor]:
        """eta, m^2/m^3, mean fall speed and its standard deviation, m/s, ``(B,)`` each."""
        eta, mean, std = self.table(self.rate_mm_per_h.reshape(-1)).expand(batch, 3).unbind(-1)
        return eta, mean, std


@register
class VolumeClutter(Stage):
    """Detections of the rain or snow itself, appended to the list.

    Identity: ``share = 0`` (nothing is appended); at rate 0 all that is appended is no detection.

    Args:
        weather: ``Rain`` or ``Snow``, or its dictionary.
        sensor: the radar, or its dictionary. Its link budget gives the power in dBm: ``noise_floor_db`` must
            be in dBm too.
        share: factor on the reflectivity.
        capacity: rows that are appended. Where four fifths as many cells or more exceed the threshold, a random share
            of them is listed; rows that are not needed stay empty.
        near_m: clutter begins there; 1 m is generic: the cover's own reflection hides what is nearer (unverified).
        ego_speed_m_per_s: of the vehicle, forward.
        turbulence_m_per_s: standard deviation of the air's speed within a cell; 0.5 is generic (unverified).

    Note:
        Every cell whose clutter exceeds the noise floor by the detection SNR counts, as the radar equation has it: with
        the processing gain of an imaging radar those are very many, so that ``capacity`` and not the rain says how many
        are listed. A radar whose threshold follows the clutter around a cell (CFAR) reports far fewer: for counts use
        the FMCW simulator. Drops fall with the mean and the spread of their Doppler spectrum; speeds are folded as the
        radar folds them. The cross section is what the radar equation makes of the power, the path's loss in it.

    References:
        PHYSICS.md 6.5.
    """

    default_name: ClassVar[str] = "volume_clutter"
    reads: ClassVar[tuple[str, ...]] = (
        "scene.points_in",
        *("air.attenuation_db_per_km", "air.extra_m", "air.patches"),
        *("returns.clutter", "returns.clutter_valid", "returns.gain_db"),
        "receiver.cover_loss_db",
        "receiver.detection_snr_db",
        "receiver.noise_floor_db",
        "receiver.noise_shift_db",
        "receiver.pattern_tilt_rad",
        "receiver.speed_std_m_per_s",
        "receiver.threshold_shift_db",
    )
    writes: ClassVar[tuple[str, ...]] = ("returns.clutter", "returns.clutter_valid")
    share: Tensor

    def __init__(
        self,
        weather: Weather | Mapping[str, Any],
        sensor: Radar | Mapping[str, Any],
        share: float = 1.0,
        capacity: int = 64,
        near_m: float = 1.0,
        ego_speed_m_per_s: float = 0.0,
        turbulence_m_per_s: float = 0.5,
    ) -> None:
        check_arguments(
            "VolumeClutter(weather: Weather | Mapping, sensor: Radar | Mapping, share: float, capacity: int, "
            "near_m: float, ego_speed_m_per_s: float, turbulence_m_per_s: float)",
            weather,
            sensor,
            share,
            capacity,
            near_m,
            ego_speed_m_per_s,
            turbulence_m_per_s,
        )
        super().__init__()
        self.sensor = Radar.of(sensor)
        built = weather if isinstance(weather, Weather) else weather_from_dict(weather)
        if not isinstance(built, (Rain, Snow)):
            raise InputTypeError(f"VolumeClutter: weather must be Rain or Snow; got {type(built).__name__}.")
        check_at_least("share", share, 0.0, owner=self)
        check_between("capacity", capacity, 1, 100_000, owner=self)
        check_between("near_m", near_m, 0.1, 0.9 * self.sensor.max_range_m, unit="m", owner=self)
        check_between("ego_speed_m_per_s", ego_speed_m_per_s, -100.0, 100.0, unit="m/s", owner=self)
        check_between("turbulence_m_per_s", turbulence_m_per_s, 0.0, 100.0, unit="m/s", owner=self)
        self.falling = FallingReflectivity(built, self.sensor.frequency_ghz)
        self.capacity, self.near_m, self.identity = int(capacity), float(near_m), share == 0
        self.ego_speed_m_per_s, self.turbulence_m_per_s = float(ego_speed_m_per_s), float(turbulence_m_per_s)
        self.register_buffer("share", torch.tensor(float(share)))

    def config(self) -> dict[str, Any]:
        """Constructor arguments."""
        return {
            "weather": self.falling.weather.to_dict(),
            "sensor": self.sensor.to_dict(),
            "share": float(self.share),
            "capacity": self.capacity,
            "near_m": self.near_m,
            "ego_speed_m_per_s": self.ego_speed_m_per_s,
            "turbulence_m_per_s": self.turbulence_m_per_s,
        }

    def variates(self) -> tuple[Variate, ...]:
        """Arrival, direction, power and Doppler of each detection; none at the identity."""
        if self.identity:
            return ()
        each = (self.capacity,)
        uniform = [Variate(name, "uniform", each) for name in ("arrival", "direction", "azimuth", "elevation", "power")]
        return (*uniform, Variate("doppler", "normal", each))

    def forward(self, state: RadarState, noise: Mapping[str, Tensor]) -> RadarState:
        """The state with the weather's own detections."""
        if self.identity:
            return state
        own = {key: value.to(state.returns.gain_db.dtype) for key, value in noise.items()}
        eta, fall, fall_std = (value.to(state.returns.gain_db.dtype) for value in self.falling(state.batch))
        threshold_db = state.detected_from_db
        node_m = self._nodes_m(state)
        bins = self._doppler_bins(fall, fall_std)
        missing = self._missing(node_m, eta, bins, threshold_db, state)
        per_m = self._cells_per_m(missing, bins, self._denser(node_m, state))
        range_m, there = self._ranges(node_m, per_m, own["arrival"])
        missing = self._missing(range_m, eta, bins, threshold_db, state)
        denser = self._denser(range_m, state)
        places = (own["direction"], own["azimuth"], own["elevation"])
        azimuth, elevation, patch = self._direction_rad(missing, *places, denser)
        if denser is not None:
            missing = missing / denser.gather(-1, patch[..., None])[..., 0]
        off_db = 2.0 * (self.sensor.gain_dbi(azimuth, elevation) - self.sensor.antenna_gain_dbi)
        peak_db = threshold_db[:, None] - missing.log() / DB
        power_db = _above_db(threshold_db[:, None], peak_db + off_db, own["power"])
        if state.receiver.pattern_tilt_rad is not None:
            azimuth = azimuth + state.receiver.pattern_tilt_rad[:, None]
        spread: float | Tensor = self.turbulence_m_per_s
        if state.receiver.speed_std_m_per_s is not None:
            more = state.receiver.speed_std_m_per_s[:, None]
            spread = torch.where(more > 0, (spread**2 + more.square()).clamp_min(NEVER).sqrt(), spread)
        clutter = self._rows(range_m, azimuth, elevation, power_db, off_db, fall, fall_std, own["doppler"], spread)
        clutter = torch.where(there[..., None], clutter, 0.0)
        if state.returns.clutter is not None and state.returns.clutter_valid is not None:
            clutter, there = (
                torch.cat([state.returns.clutter, clutter], 1),
                torch.cat([state.returns.clutter_valid, there], 1),
            )
        return state.changed(clutter=clutter, clutter_valid=there)

    def _nodes_m(self, state: RadarState) -> Tensor:
        near, far = self.near_m, self.sensor.max_range_m
        node = torch.arange(RANGE_NODES, device=state.returns.gain_db.device, dtype=state.returns.gain_db.dtype)
        return near * (far / near) ** (node / (RANGE_NODES - 1))[None]

    def _doppler_bins(self, fall: Tensor, fall_std: Tensor) -> Tensor:
        """Bins over which the Doppler spectrum of a cell spreads, ``(B,)``: its equivalent width half-way off the axis.

        Turbulence, the drops' own speeds, and what the width of the beam makes of their fall and the vehicle's speed.
        """
        sensor = self.sensor
        tilt = [math.sin(math.radians(w) / 2.0) for w in (sensor.azimuth_beamwidth_deg, sensor.elevation_beamwidth_deg)]
        beam = [width / FWHM_PER_STD for width in two_way_widths_rad(sensor)]
        variance = self.turbulence_m_per_s**2 + (fall_std * tilt[1]).square() + (fall * beam[1]).square()
        std = (variance + (self.ego_speed_m_per_s * tilt[0] * beam[0]) ** 2).sqrt()
        return (math.sqrt(2.0 * math.pi) * std / sensor.speed_resolution_m_per_s).clamp_min(1.0)

    def _missing(self, range_m: Tensor, eta: Tensor, bins: Tensor, threshold_db: Tensor, state: RadarState) -> Tensor:
        """Threshold over the mean echo of a cell at the peak of the pattern, ``(B, ...)``; at most 1e30."""
        reflectivity = (eta * self.share.to(eta)).clamp_min(NEVER)
        rcs = reflectivity[:, None] * cell_volume_m3(range_m, self.sensor) / bins[:, None]
        path_db = 2e-3 * state.air.attenuation_db_per_km[:, None] * range_m + state.receiver.cover_loss_db[:, None]
        mean_db = self.sensor.constant_db + (rcs / range_m**4).log() / DB - path_db
        return torch.exp(DB * (threshold_db[:, None] - mean_db).clamp_max(300.0))

    def _off_axis(self, like: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Azimuth and elevation of directions spread evenly over the view, and the pattern's loss there, ``(G,)``."""
        places = [(torch.arange(n, device=like.device, dtype=like.dtype) + 0.5) / n for n in DIRECTIONS]
        azimuth, elevation = (
            axis.reshape(-1) for axis in clutter_directions_rad(self.sensor, *torch.meshgrid(*places, indexing="ij"))
        )
        loss_db = 2.0 * (self.sensor.antenna_gain_dbi - self.sensor.gain_dbi(azimuth, elevation))
        return azimuth, elevation, torch.exp(DB * loss_db)

    def _denser(self, range_m: Tensor, state: RadarState) -> Tensor | None:
        """Echo over that in uniform air, ``(B, n, G)``, at ranges ``(1 or B, n)`` in the directions of ``_off_axis``.

        More particles of this kind there, and more of all weather on the way to them and back.
        """
        if state.air.patches is None:
            return None
        banks = state.air.patches.banks(self.falling.weather)
        azimuth, elevation, _ = self._off_axis(state.returns.gain_db)
        ground_m = range_m[..., None] * elevation.cos()
        azimuth = azimuth.expand_as(ground_m)
        there = banks.at(azimuth, ground_m)
        if state.air.extra_m is None:  # a chain without path attenuation
            return there
        way_db = 2e-3 * state.air.attenuation_db_per_km[:, None, None] * range_m[..., None]
        more = mean_density(state.air.extra_m, azimuth, ground_m, banks.step_m) - 1.0
        return there * torch.exp(-DB * way_db * more)

    def _cells_per_m(self, missing: Tensor, bins: Tensor, denser: Tensor | None = None) -> Tensor:
        """Cells above the threshold per metre of range, ``(B, ...)``, over the whole view."""
        azimuth, elevation = two_way_widths_rad(self.sensor)
        beams = max(1.0, math.prod(view_rad(self.sensor)) / (GAUSSIAN_AREA * azimuth * elevation))
        _, _, loss = self._off_axis(missing)
        above = torch.exp(-missing[..., None] * (loss if denser is None else loss / denser)).mean(-1)
        return beams * bins[:, None] / self.sensor.range_resolution_m * above

    def _direction_rad(
        self, missing: Tensor, direction: Tensor, azimuth: Tensor, elevation: Tensor, denser: Tensor | None = None
    ) -> tuple[Tensor, Tensor, Tensor]:
        """Where in the view each detection lies: ``direction`` picks a part of it, the others the place in the part."""
        middle_azimuth, middle_elevation, loss = self._off_axis(missing)
        seen = loss - loss.min()
        if denser is not None:
            loss_there = loss / denser
            seen = loss_there - loss_there.amin(-1, keepdim=True)
        share = torch.exp(-missing[..., None] * seen).cumsum(-1)
        patch = (share < (direction * share[..., -1])[..., None]).sum(-1).clamp_max(len(loss) - 1)
        size = [view / n for view, n in zip(view_rad(self.sensor), DIRECTIONS, strict=True)]
        return (
            middle_azimuth[patch] + (azimuth - 0.5) * size[0],
            middle_elevation[patch] + (elevation - 0.5) * size[1],
            patch,
        )

    def _ranges(self, node_m: Tensor, per_m: Tensor, arrival: Tensor) -> tuple[Tensor, Tensor]:
        """Ranges of the detections in order, ``(B, K)``, and which of them exist."""
        step = 0.5 * (per_m[:, 1:] + per_m[:, :-1]) * (node_m[:, 1:] - node_m[:, :-1])
        # A share of a Poisson process, taken at random, is a Poisson process again.
        share = (FULL * self.capacity / step.sum(1, keepdim=True).clamp_min(NEVER)).clamp_max(1.0)
        expected = torch.cat([torch.zeros_like(step[:, :1]), (share * step).cumsum(1)], 1)
        place = -(1.0 - arrival).log().cumsum(1)
        there = place < expected[:, -1:]
        right = _place_among(expected, place).clamp(1, RANGE_NODES - 1)
        low, high = expected.gather(1, right - 1), expected.gather(1, right)
        part = ((place - low) / (high - low).clamp_min(NEVER)).clamp(0.0, 1.0)
        nodes = node_m.expand(place.shape[0], -1)
        return torch.lerp(nodes.gather(1, right - 1), nodes.gather(1, right), part), there

    def _rows(
        self,
        range_m: Tensor,
        azimuth: Tensor,
        elevation: Tensor,
        power_db: Tensor,
        off_db: Tensor,
        fall: Tensor,
        fall_std: Tensor,
        doppler: Tensor,
        spread_m_per_s: float | Tensor,
    ) -> Tensor:
        """x, y, z, radial speed, power and radar cross section of each, ``(B, K, 6)``."""
        flat = torch.cos(elevation)
        along = torch.stack([flat * torch.cos(azimuth), flat * torch.sin(azimuth), torch.sin(elevation)], -1)
        speed = radial_speed_m_per_s(along, self.falling.weather, fall, fall_std, doppler, spread_m_per_s)
        speed = speed - along[..., 0] * self.ego_speed_m_per_s
        period = 2.0 * self.sensor.max_speed_m_per_s
        speed = speed - period * (speed / period).round()
        rcs_dbsm = power_db - self.sensor.constant_db - off_db + 4.0 * range_m.log() / DB
        numbers = torch.stack([speed, power_db, rcs_dbsm], -1)
        return torch.cat([along * range_m[..., None], numbers], -1)


def view_rad(radar: Radar) -> tuple[float, float]:
    """Width in azimuth and elevation of the view in which clutter is looked for, at most the half sphere ahead."""
    azimuth, elevation = math.radians(radar.azimuth_beamwidth_deg), math.radians(radar.elevation_beamwidth_deg)
    return min(VIEW_WIDTHS * azimuth, math.pi), min(VIEW_WIDTHS * elevation, math.pi)


def clutter_directions_rad(radar: Radar, azimuth: Tensor, elevation: Tensor) -> tuple[Tensor, Tensor]:
    """Azimuth and elevation within the element's view from uniform variates."""
    view_azimuth, view_elevation = view_rad(radar)
    return (azimuth - 0.5) * view_azimuth, (elevation - 0.5) * view_elevation


def radial_speed_m_per_s(
    direction: Tensor,
    weather: Rain | Snow,
    fall: Tensor,
    fall_std: Tensor,
    doppler: Tensor,
    turbulence_m_per_s: float | Tensor,
) -> Tensor:
    """Radial speed of drops or flakes, m/s, positive receding: wind, fall, and their spread within a cell.

    Args:
        direction: ``(B, K, 3)`` unit vectors to them.
        weather: for its wind.
        fall, fall_std: ``(B,)`` mean and standard deviation of the fall speed.
        doppler: ``(B, K)`` standard normal.
        turbulence_m_per_s: standard deviation of the air's speed, ``()`` or ``(B, 1)``.
    """
    wind = direction.new_tensor(weather.wind_m_per_s)
    up = direction[..., 2]
    std = (turbulence_m_per_s**2 + (fall_std[:, None] * up) ** 2).sqrt()
    return direction @ wind - fall[:, None] * up + std * doppler


def _place_among(rising: Tensor, values: Tensor) -> Tensor:
    """Number of ``rising`` ``(B, n)`` below each of ``values`` ``(B, K)``."""
    if is_exporting():  # ONNX has no search
        return (rising[:, None] < values[..., None]).sum(-1)
    return torch.searchsorted(rising.contiguous(), values.contiguous())


def _above_db(threshold_db: Tensor, mean_db: Tensor, uniform: Tensor) -> Tensor:
    """Power of a cell that exceeds the threshold: ``T + P E`` with E of exponential law, in dB."""
    exceeding = torch.exp(DB * (mean_db - threshold_db).clamp_min(-300.0)) * -(1.0 - uniform).log()
    return threshold_db + torch.log1p(exceeding) / DB
