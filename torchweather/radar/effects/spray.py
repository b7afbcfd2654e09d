"""Spray of a vehicle ahead of a radar."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import ClassVar

import torch
from torch import Tensor

from torchweather.core.random import Variate
from torchweather.physics.radar_attenuation import fog_attenuation_coefficient_db_per_km_per_g_per_m3
from torchweather.physics.refractive_index import water_permittivity_microwave
from torchweather.pipeline.effect import Parameter
from torchweather.pipeline.spray import SPRAY, cloud_of
from torchweather.radar.clutter import DB, cell_volume_m3
from torchweather.radar.effects.echoes import Appending, listed
from torchweather.radar.sensor import Radar
from torchweather.radar.state import RadarState

__all__ = ["RadarRoadSpray"]

FAINTEST = 1e-30
WATER_C = 10.0


class RadarRoadSpray(Appending):
    """Tyres of a vehicle ahead throw up spray: a small loss behind it, and at most one echo of the cloud itself.

    Drops are small against the wave (Rayleigh): the loss is that of their water (ITU-R P.840), ``k c`` one way with the
    water c on the way (``physics.SprayCloud``), and the reflectivity of a volume ``pi^5 |K|^2 / lambda^4 N D^6`` with
    ``N = 6 C / (pi rho D^3)``. The densest cell, right behind the tyres, is listed where its echo exceeds the
    threshold, as the radar equation has it; a threshold that follows the clutter (CFAR) shows it more rarely.

    Args:
        water_g_per_m: in the air behind one row of tyres, g per metre of road, 0 to 5000.
        drop_mm: diameter of the drops.
        distance_m, lateral_m: of the vehicle's rear tyres, ahead, and of its middle, to the left.
        length_m, height_m: over which the cloud thins out by e, to the rear and upwards.
        uneven: for the other sensors; a radar sees the mean.
        sensor_height_m: of the radar over the road, 0 to 5 m.

    Note:
        The drops are taken to stand still over the road, so that the echo comes closer at the own speed.
    """

    id: ClassVar[str] = "radar.road_spray"
    title: ClassVar[str] = "a vehicle ahead throws up spray"
    term: ClassVar[str] = "road spray (tyre spray)"
    searched: ClassVar[bool] = False
    arguments: ClassVar[tuple[Parameter, ...]] = (
        *SPRAY,
        Parameter("sensor_height_m", "m", 0.0, 5.0, scale=0.5, default=0.5),
    )
    after: ClassVar[str] = "path_attenuation"
    rank: ClassVar[int] = 3
    axes: ClassVar[tuple[str, ...]] = ("range_m", "azimuth_rad", "power_ratio_db")
    confusable_with: ClassVar[Mapping[str, str]] = {
        "radar.path_loss_scale": "targets aside of the vehicle: spray weakens those behind it alone"
    }
    needs: ClassVar[tuple[str, ...]] = ("sensor",)
    reads: ClassVar[tuple[str, ...]] = (
        *("scene.points_in", "scene.range_m"),
        *("returns.clutter", "returns.clutter_valid", "returns.gain_db"),
        "receiver.cover_loss_db",
        "receiver.detection_snr_db",
        "receiver.ego_speed_m_per_s",
        "receiver.noise_floor_db",
        "receiver.noise_shift_db",
        "receiver.sensor",
        "receiver.threshold_shift_db",
    )
    writes: ClassVar[tuple[str, ...]] = ("returns.clutter", "returns.clutter_valid", "returns.gain_db")

    def own_variates(self) -> tuple[Variate, ...]:
        """Power of the echo over its mean."""
        return (Variate("power", "uniform", (1,)),)

    def changes(self, state: RadarState, noise: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """Gains of what lies behind."""
        assert state.receiver.sensor is not None
        like = state.returns.gain_db
        place = state.scene.points_in[..., :3].to(like)
        range_m = state.scene.range_m
        unit = (place / range_m.clamp_min(1e-6)[..., None]).unbind(-1)
        water = cloud_of(self, like).column(unit, self.value("sensor_height_m", like), range_m)
        per_kg = fog_attenuation_coefficient_db_per_km_per_g_per_m3(state.receiver.sensor.frequency_ghz, WATER_C)
        loss_db = 2.0 * float(per_kg) * water  # 1 kg/m^2 is 1 km of 1 g/m^3
        return {"gain_db": like - torch.where(range_m > 0, loss_db, 0.0)}

    def appended(self, state: RadarState, noise: Mapping[str, Tensor]) -> RadarState:
        """The state with a row for the densest cell."""
        assert state.receiver.sensor is not None
        sensor, like = state.receiver.sensor, state.receiver.cover_loss_db
        cloud, height_m = cloud_of(self, like), self.value("sensor_height_m", like)
        ahead_m = cloud.distance_m - 0.5 * sensor.range_resolution_m
        ahead_m, left_m = (value.expand(state.batch) for value in (ahead_m, cloud.lateral_m))
        range_m = (ahead_m.square() + left_m.square()).sqrt()
        density = cloud.density(ahead_m, left_m + 0.5 * 1.6, height_m)
        eta = spray_reflectivity(density, self.value("drop_mm", like), sensor)
        rcs = (eta * cell_volume_m3(range_m, sensor)).clamp_min(FAINTEST)
        azimuth = torch.atan2(left_m, ahead_m)
        off_db = 2.0 * (sensor.gain_dbi(azimuth, torch.zeros_like(azimuth)) - sensor.antenna_gain_dbi)
        drawn = -(1.0 - noise["power"][:, 0].to(like)).log()
        power_db = sensor.constant_db + off_db + (rcs * drawn.clamp_min(FAINTEST) / range_m**4).log() / DB
        power_db = power_db - state.receiver.cover_loss_db
        there = (power_db >= state.detected_from_db) & ~self.at_identity
        # It stands on the road, which comes closer at the own speed.
        speed = torch.full_like(like, -state.receiver.ego_speed_m_per_s) * azimuth.cos()
        row = torch.stack([ahead_m, left_m, torch.zeros_like(left_m), speed, power_db, rcs.log() / DB], -1)
        row = torch.where(there[:, None], row, 0.0)
        return listed(state, row[:, None], there[:, None])


def spray_reflectivity(density_kg_per_m3: Tensor, drop_mm: Tensor, sensor: Radar) -> Tensor:
    """Radar cross-section of a volume of small drops, m^2/m^3."""
    permittivity = complex(water_permittivity_microwave(sensor.frequency_ghz, WATER_C))
    k_square = abs((permittivity - 1.0) / (permittivity + 2.0)) ** 2
    # N D^6 = 6 C D^3 / (pi rho), D in metres.
    sixth = 6.0 * density_kg_per_m3 * (1e-3 * drop_mm) ** 3 / (math.pi * 1000.0)
    return math.pi**5 * k_square / sensor.wavelength_m**4 * sixth
