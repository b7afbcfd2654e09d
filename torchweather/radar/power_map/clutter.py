r"""Radar stage map_clutter: mean echo of rain and snow in each cell of a power map.

By the radar equation, over the noise of the same cell, since a recording's unit is known by its noise alone:

    C / N = K eta V(R) g(theta, phi)^2 d_k / (R^4 N_0) 10^(-loss / 10)

with the radar's constant K and noise N_0 from its link budget, reflectivity eta, volume V of a cell, one-way pattern g
(1 where the antenna turns), share d_k of the Doppler bin, and the loss of path and cover. What follows the exponential
law about this mean is drawn by the receiver.

References:
    PHYSICS.md 6.2, 6.5.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, ClassVar

import torch
from torch import Tensor

from torchweather.atmosphere.weather import Rain, Snow, Weather, weather_from_dict
from torchweather.core.arguments import check_arguments
from torchweather.core.errors import InputTypeError, check_at_least, check_between
from torchweather.pipeline.registry import register
from torchweather.pipeline.stage import Stage
from torchweather.radar.clutter import (
    DB,
    FWHM_PER_STD,
    FallingReflectivity,
    cell_volume_m3,
    radial_speed_m_per_s,
    two_way_widths_rad,
)
from torchweather.radar.power_map.cells import PowerMapState, lines_of_sight, within_half_turn
from torchweather.radar.power_map.power_map import MapAxes
from torchweather.radar.sensor import Radar

__all__ = ["MapClutter", "map_noise_floor_dbm"]

FOLDS = 2  # of the Doppler spectrum over the unambiguous speeds, either way
COMPENSATION = 4  # power of the range by which a receiver with compensation weakens near echoes


def map_noise_floor_dbm(radar: Radar, axes: MapAxes) -> float:
    """Noise of a cell by the link budget, dBm: the chirps count where the map has a Doppler axis.

    Args:
        radar: ``noise_floor_db`` is not looked at, which is of a list of detections.
        axes: of the map.
    """
    check_arguments("map_noise_floor_dbm(radar: Radar, axes: MapAxes)", radar, axes)
    coherent = radar.samples * radar.virtual_channels * (radar.chirps if "doppler" in axes.dims else 1)
    return radar.noise_power_dbm - 10.0 * math.log10(coherent)


@register
class MapClutter(Stage):
    """The mean echo of rain or snow in each cell.

    Identity: ``share = 0``, rate 0.

    Args:
        weather: ``Rain`` or ``Snow``, or its dictionary.
        sensor: the radar, or its dictionary; its link budget sets the noise.
        axes: of the maps, or their dictionary.
        share: factor on the reflectivity.
        near_m: clutter begins there; 1 m is generic (unverified).
        ego_speed_m_per_s: of the vehicle, forward.
        turbulence_m_per_s: standard deviation of the air's speed within a cell; 0.5 is generic (unverified).

    Note:
        The volume of a cell is the radar's resolution, not the map's bin: a bin of zero padding holds no less echo. A
        turning antenna looks level; the half of its beam below the horizon is taken to be in the rain, too.
    """

    default_name: ClassVar[str] = "map_clutter"
    reads: ClassVar[tuple[str, ...]] = ("air.patches", "maps.map_clutter", "returns.gain_db", "scene.points_in")
    writes: ClassVar[tuple[str, ...]] = ("maps.map_clutter",)

    def __init__(
        self,
        weather: Weather | Mapping[str, Any],
        sensor: Radar | Mapping[str, Any],
        axes: MapAxes | Mapping[str, Any],
        share: float = 1.0,
        near_m: float = 1.0,
        ego_speed_m_per_s: float = 0.0,
        turbulence_m_per_s: float = 0.5,
    ) -> None:
        check_arguments(
            "MapClutter(weather: Weather | Mapping, sensor: Radar | Mapping, axes: MapAxes | Mapping, share: float, "
            "near_m: float, ego_speed_m_per_s: float, turbulence_m_per_s: float)",
            weather,
            sensor,
            axes,
            share,
            near_m,
            ego_speed_m_per_s,
            turbulence_m_per_s,
        )
        super().__init__()
        self.sensor = Radar.of(sensor)
        self.axes = axes if isinstance(axes, MapAxes) else MapAxes.from_dict(axes)
        built = weather if isinstance(weather, Weather) else weather_from_dict(weather)
        if not isinstance(built, (Rain, Snow)):
            raise InputTypeError(f"MapClutter: weather must be Rain or Snow; got {type(built).__name__}.")
        check_at_least("share", share, 0.0, owner=self)
        check_between("near_m", near_m, 0.1, 1000.0, unit="m", owner=self)
        check_between("ego_speed_m_per_s", ego_speed_m_per_s, -100.0, 100.0, unit="m/s", owner=self)
        check_between("turbulence_m_per_s", turbulence_m_per_s, 0.0, 100.0, unit="m/s", owner=self)
        self.weather, self.share, self.near_m = built, float(share), float(near_m)
        self.ego_speed_m_per_s, self.turbulence_m_per_s = float(ego_speed_m_per_s), float(turbulence_m_per_s)
        self.falling = FallingReflectivity(built, self.sensor.frequency_ghz)

    def config(self) -> dict[str, Any]:
        """Constructor arguments."""
        return {
            "weather": self.weather.to_dict(),
            "sensor": self.sensor.to_dict(),
            "axes": self.axes.to_dict(),
            "share": self.share,
            "near_m": self.near_m,
            "ego_speed_m_per_s": self.ego_speed_m_per_s,
            "turbulence_m_per_s": self.turbulence_m_per_s,
        }

    def forward(self, state: PowerMapState, noise: Mapping[str, Tensor]) -> PowerMapState:
        """The state with this weather's echo added."""
        if self.share == 0:
            return state
        gain_db = state.returns.gain_db
        eta, fall, fall_std = (value.to(gain_db) for value in self.falling(state.batch))
        of_path = (
            self._over_range(gain_db)[None]
            * self.share
            * eta[:, None, None]
            * torch.exp(DB * gain_db.reshape(state.batch, *self._line_shape))
        )
        of_path = of_path * self._density(state)
        found = self.axes.laid_out(of_path, ("range", "azimuth"))
        found = found * self.axes.laid_out(self._pattern(gain_db), ("azimuth", "elevation"))
        if "doppler" in self.axes.dims:
            share = self.doppler_share(fall, fall_std)
            found = found * self.axes.laid_out(share, ("azimuth", "elevation", "doppler"))
        if state.maps.map_clutter is not None:
            found = found + state.maps.map_clutter
        return state.changed(map_clutter=found)

    @property
    def _line_shape(self) -> tuple[int, int]:
        azimuths = 1 if self.axes.azimuth_rad is None else len(self.axes.azimuth_rad)
        return len(self.axes.range_m), azimuths

    def _over_range(self, like: Tensor) -> Tensor:
        """``(R, 1)`` echo over noise of a reflectivity of 1/m in air that takes nothing."""
        range_m = self.axes.axis("range", like)
        there = range_m >= self.near_m
        safe = torch.where(there, range_m, 1.0)
        level_db = self.sensor.constant_db - map_noise_floor_dbm(self.sensor, self.axes)
        found = cell_volume_m3(safe, self.sensor) / safe**4 * math.exp(DB * level_db)
        if self.sensor.compensated_to_m > 0:
            found = found * (safe / self.sensor.compensated_to_m).clamp_max(1.0) ** COMPENSATION
        return torch.where(there, found, 0.0)[:, None]

    def _density(self, state: PowerMapState) -> Tensor:
        """``(B, R, A)`` of particles over that of uniform air; 1 without patches."""
        if state.air.patches is None:
            return state.returns.gain_db.new_ones(1, 1, 1)
        range_m = self.axes.axis("range", state.returns.gain_db)[None, :, None]
        azimuth = within_half_turn(self.axes.axis("azimuth", state.returns.gain_db))[None, None]
        density: Tensor = state.air.patches.banks(self.weather).at(azimuth, range_m)
        return density

    def _pattern(self, like: Tensor) -> Tensor:
        """``(1, A, E)`` two-way pattern; a turning antenna looks along each azimuth."""
        azimuth, elevation = (self.axes.axis(name, like) for name in ("azimuth", "elevation"))
        off = torch.zeros_like(azimuth) if self.axes.full_turn else within_half_turn(azimuth)
        off_db = 2.0 * (self.sensor.gain_dbi(off[:, None], elevation[None]) - self.sensor.antenna_gain_dbi)
        return torch.exp(DB * off_db)[None]

    def doppler_share(self, fall_m_per_s: Tensor, fall_std_m_per_s: Tensor) -> Tensor:
        """Share of each Doppler bin in the echo, ``(B, A, E, D)``; they add up to 1.

        Args:
            fall_m_per_s, fall_std_m_per_s: ``(B,)`` mean and standard deviation of the fall speed.
        """
        along = lines_of_sight(self.axes, fall_m_per_s.device)[1].to(fall_m_per_s)  # (A, E, 3)
        flat = along.reshape(1, -1, 3)
        still = radial_speed_m_per_s(flat, self.weather, fall_m_per_s, fall_std_m_per_s, fall_m_per_s.new_zeros(1), 0.0)
        mean = still - self.ego_speed_m_per_s * flat[..., 0]
        up = flat[..., 2]
        beam = [width / FWHM_PER_STD for width in two_way_widths_rad(self.sensor)]
        variance = self.turbulence_m_per_s**2 + (fall_std_m_per_s[:, None] * up).square()
        variance = variance + (fall_m_per_s[:, None] * beam[1]).square()
        variance = variance + (self.ego_speed_m_per_s * beam[0] * flat[..., 1]).square()
        speeds = self.axes.axis("doppler", mean)
        width = self.axes.speed_bin_m_per_s
        std = variance.sqrt().clamp_min(0.1 * width)[..., None, None]
        period = len(speeds) * width
        off = speeds - mean[..., None]
        off = off - period * (off / period).round()
        folds = torch.arange(-FOLDS, FOLDS + 1, device=mean.device, dtype=mean.dtype) * period
        place = off[..., None] + folds
        inside = torch.special.ndtr((place + 0.5 * width) / std) - torch.special.ndtr((place - 0.5 * width) / std)
        share: Tensor = inside.sum(-1)
        share = share / share.sum(-1, keepdim=True)
        return share.reshape(mean.shape[0], *along.shape[:2], len(speeds))
