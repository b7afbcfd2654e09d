"""RadialSpeed: what a Doppler (FMCW) LiDAR measures of drops, flakes and fog."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, ClassVar

import torch
from torch import Tensor

from torchweather.core.arguments import check_arguments
from torchweather.core.errors import InputValueError, check_between
from torchweather.core.random import Variate
from torchweather.lidar.sensor import Lidar
from torchweather.lidar.stages import SensorStage, vehicle_directions
from torchweather.lidar.state import LidarState
from torchweather.pipeline.point_kind import PointKind
from torchweather.pipeline.registry import register

__all__ = ["RadialSpeed"]


@register
class RadialSpeed(SensorStage):
    """Speed of each particle as a Doppler (FMCW) LiDAR measures it, in its column: along the beam, positive away.

    A particle moves with the wind and falls as its size says (``ParticleReturns``), the air about it is turbulent, and
    the vehicle drives. Objects keep the speed that they came with.

    Identity: without particles.

    Args:
        sensor: the LiDAR, or its dictionary; it has a ``speed_column``.
        ego_speed_m_per_s: of the vehicle, forward.
        turbulence_m_per_s: standard deviation of the air's speed along a beam; 0.5 is generic (unverified).
    """

    default_name: ClassVar[str] = "radial_speed"
    reads: ClassVar[tuple[str, ...]] = (
        *("scene.clear_range_m", "scene.empty_direction", "scene.points_in"),
        *("returns.echo_speed_m_per_s", "returns.kind", "returns.points", "returns.second"),
    )
    writes: ClassVar[tuple[str, ...]] = ("returns.points", "returns.second")

    def __init__(
        self,
        sensor: Lidar | Mapping[str, Any],
        ego_speed_m_per_s: float = 0.0,
        turbulence_m_per_s: float = 0.5,
    ) -> None:
        check_arguments(
            "RadialSpeed(sensor: Lidar | Mapping, ego_speed_m_per_s: float, turbulence_m_per_s: float)",
            sensor,
            ego_speed_m_per_s,
            turbulence_m_per_s,
        )
        super().__init__(sensor)
        if self.sensor.speed_column is None:
            raise InputValueError("RadialSpeed: the sensor needs the column of the speed; set Lidar(speed_column=...).")
        check_between("ego_speed_m_per_s", ego_speed_m_per_s, -100.0, 100.0, unit="m/s", owner=self)
        check_between("turbulence_m_per_s", turbulence_m_per_s, 0.0, 100.0, unit="m/s", owner=self)
        self.ego_speed_m_per_s, self.turbulence_m_per_s = float(ego_speed_m_per_s), float(turbulence_m_per_s)
        self.reported = 2 if self.sensor.return_mode == "dual" else 1

    def config(self) -> dict[str, Any]:
        """Constructor arguments."""
        own = {"ego_speed_m_per_s": self.ego_speed_m_per_s, "turbulence_m_per_s": self.turbulence_m_per_s}
        return {**super().config(), **own}

    def variates(self) -> tuple[Variate, ...]:
        """Turbulence and noise of each reported echo."""
        return (Variate("speed", "normal", (self.reported, "N")),)

    def forward(self, state: LidarState, noise: Mapping[str, Tensor]) -> LidarState:
        """The state with the speeds of particles in the points that go out."""
        assert state.returns.points is not None
        speed = state.returns.echo_speed_m_per_s
        if speed is None:  # a chain without particles
            return state
        ego = self.ego_speed_m_per_s * vehicle_directions(state, self.sensor)[..., 0]
        spread = math.hypot(self.sensor.speed_noise_m_per_s, self.turbulence_m_per_s)
        clouds: list[Tensor | None] = []
        for echo, cloud in enumerate((state.returns.points, state.returns.second)):
            if cloud is None:
                clouds.append(None)
                continue
            measured = speed[..., echo] - ego + spread * noise["speed"][:, echo].to(speed)
            column = torch.arange(cloud.shape[-1], device=cloud.device) == self.sensor.speed_column
            own = (state.returns.kind[..., echo] == int(PointKind.PARTICLE))[..., None] & column
            clouds.append(torch.where(own, measured[..., None].to(cloud), cloud))
        return state.changed(points=clouds[0], second=clouds[1])
