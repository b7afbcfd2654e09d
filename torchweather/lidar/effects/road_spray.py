"""Spray of a vehicle ahead of a LiDAR."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import ClassVar

import torch
from torch import Tensor

from torchweather.atmosphere.conditions.ground_noise import ground_noise, uneven
from torchweather.core.random import Variate
from torchweather.lidar.effects.air import along_beam
from torchweather.lidar.stages import exponential
from torchweather.lidar.state import LidarState
from torchweather.physics.extinction import Q_EFF, rain_q_back
from torchweather.physics.road_spray import spray_cross_section_m2_per_kg
from torchweather.pipeline.effect import Effect, Parameter
from torchweather.pipeline.point_kind import PointKind
from torchweather.pipeline.spray import BILLOWS, REDNESS, SPRAY, cloud_of

__all__ = ["LidarRoadSpray"]

OBJECT, PARTICLE = int(PointKind.OBJECT), int(PointKind.PARTICLE)
PARTS = 12  # of the way inside the cloud


class LidarRoadSpray(Effect):
    """Tyres of a vehicle ahead throw up spray: returns from its cloud, and weaker ones from what lies behind it.

    Objects: ``X exp(-2 tau)`` with the optical depth tau of the cloud (``physics.SprayCloud``) on the way. The cloud is
    cut into parts along the beam. Gates of the pulse's length in a part return on average
    ``beta (c tau_p / 2) xi(R) / R^2 exp(-2 tau)``, beta being the drops' backscatter; clumps of drops make the returns
    of gates exponential about that mean. The strongest return of m gates is then ``mean (ln m - ln E)`` with a standard
    exponential E, and the strongest of all parts is an echo more that the receiver may report.

    Args:
        water_g_per_m: in the air behind one row of tyres, g per metre of road, 0 to 5000.
        drop_mm: Sauter diameter of the drops.
        distance_m, lateral_m: of the vehicle's rear tyres, ahead, and of its middle, to the left.
        length_m, height_m: over which the cloud thins out by e, to the rear and upwards.
        uneven: spread of the logarithm of the density, 0 to 2.
        sensor_height_m: of the LiDAR over the road, 0 to 5 m.

    Note:
        Returns of falling particles are not weakened by the spray. x is the vehicle's forward direction.
    """

    id: ClassVar[str] = "lidar.road_spray"
    title: ClassVar[str] = "a vehicle ahead throws up spray"
    term: ClassVar[str] = "road spray (tyre spray)"
    searched: ClassVar[bool] = False
    arguments: ClassVar[tuple[Parameter, ...]] = (
        *SPRAY,
        Parameter("sensor_height_m", "m", 0.0, 5.0, scale=0.5, default=1.7),
    )
    after: ClassVar[str] = "particle_returns"
    rank: ClassVar[int] = -1
    axes: ClassVar[tuple[str, ...]] = ("azimuth_rad", "particle_range_m")
    confusable_with: ClassVar[Mapping[str, str]] = {
        "lidar.spray": "ranges: the own wheels' spray is nearest at the sensor, another vehicle's at its tyres"
    }
    needs: ClassVar[tuple[str, ...]] = ("sensor",)
    reads: ClassVar[tuple[str, ...]] = (
        *("scene.clear_range_m", "scene.empty_direction", "scene.points_in"),
        "air.reach_m",
        *("returns.kind", "returns.range_m", "returns.signal"),
        *("receiver.sensor", "receiver.threshold", "receiver.threshold_scale"),
    )
    writes: ClassVar[tuple[str, ...]] = ("returns.kind", "returns.range_m", "returns.signal")

    def particle_gain(self) -> float:
        """Largest factor of a particle's signal over the threshold: none grows."""
        return 1.0

    def variates(self) -> tuple[Variate, ...]:
        """Variates of the spray's density; strongest gate of each part of each beam, and place in it."""
        return BILLOWS, Variate("arrival", "uniform", (PARTS, "N")), Variate("place", "uniform", ("N",))

    def air_variates(self) -> tuple[Variate, ...]:
        """Variates of the spray's density."""
        return (BILLOWS,)

    def changes(self, state: LidarState, noise: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """Weaker objects, and an echo more."""
        assert state.receiver.sensor is not None
        sensor, like = state.receiver.sensor, state.scene.clear_range_m
        cloud, height_m = cloud_of(self, like), self.value("sensor_height_m", like)
        place = along_beam(state)
        length = torch.stack(place).square().sum(0).sqrt().clamp_min(1e-6)
        dx, dy, dz = (one / length for one in place)
        end_m = torch.where(like > 0, like, state.air.reach_m)
        field = ground_noise(noise["billows"].to(like), cloud.distance_m * dy, cloud.distance_m * dz, redness=REDNESS)
        denser = uneven(field, self.value("uneven", field))
        area = spray_cross_section_m2_per_kg(self.value("drop_mm", like)) * denser  # m^2/kg
        inside_m = cloud.inside_m(dx, end_m)
        part_m = inside_m / PARTS
        gate_m = sensor.pulse_length_m
        depth = torch.zeros_like(like)
        best, best_m = torch.zeros_like(like), torch.zeros_like(like)
        for part in range(PARTS):
            at_m = part_m * (part + 0.5)
            density = cloud.density(at_m * dx, at_m * dy, height_m + at_m * dz)
            own = Q_EFF["rain"] * area * density * part_m
            seen = torch.exp(-2.0 * (depth + 0.5 * own))
            backscatter = area * density * rain_q_back(sensor.wavelength_nm) / (4.0 * math.pi)
            near = at_m.clamp_min(1e-2)
            mean = backscatter * gate_m * sensor.near_response(near) / near.square() * seen
            arrival = exponential(noise["arrival"][:, part].to(like)).clamp_min(1e-9)
            strongest = mean * ((part_m / gate_m).clamp_min(1e-9).log() - arrival.log())
            better = strongest > best
            best = torch.where(better, strongest, best)
            best_m = torch.where(better, at_m, best_m)
            depth = depth + own
        place_m = best_m + (noise["place"].to(like) - 0.5) * part_m
        there = (best >= state.detected_from) & (place_m >= sensor.min_range_m)
        gain = torch.exp(-2.0 * depth)[..., None]
        objects = torch.where(state.returns.kind == OBJECT, state.returns.signal * gain, state.returns.signal)
        echo = {
            "range_m": torch.where(there, place_m, 0.0),
            "signal": torch.where(there, best, 0.0),
            "kind": torch.full_like(state.returns.kind[..., 0], PARTICLE),
        }
        before = {"range_m": state.returns.range_m, "signal": objects, "kind": state.returns.kind}
        return {name: torch.cat([before[name], more[..., None]], -1) for name, more in echo.items()}
