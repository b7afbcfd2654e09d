"""Options of the transforms of a LiDAR."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

from torchweather.lidar.sweep.own_vehicle import OwnVehicleMask
from torchweather.pipeline.options import TransformOptions

__all__ = ["LidarOptions"]


@dataclass(frozen=True, kw_only=True, eq=False)
class LidarOptions(TransformOptions):
    """Keyword arguments of `LidarWeather`, which describes them."""

    q_eff: float | None = None
    q_back: float | str | None = None
    fog_extinction: str = "mie"
    fog_backscatter: str = "mie"
    receiver: str = "gate"
    lost: str = "zero"
    complete_scan: bool | str = False
    beam_ends: str = "scene"
    own_vehicle: OwnVehicleMask | Sequence[float] | str | None = None
    variant: str | None = None
    ego_speed_m_per_s: float = 0.0

    fixed: ClassVar[tuple[str, ...]] = ("p", "lost", "complete_scan", "own_vehicle")
