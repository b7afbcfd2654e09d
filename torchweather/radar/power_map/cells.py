"""PowerMapState: the cells of a map on their way through the radar's chain."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, ClassVar

import torch
from torch import Tensor

from torchweather.core.arguments import check_arguments
from torchweather.core.errors import InputValueError
from torchweather.pipeline.point_kind import PointKind
from torchweather.radar.power_map.power_map import MapAxes
from torchweather.radar.sensor import Radar
from torchweather.radar.state import RadarState

__all__ = ["PowerMapState", "lines_of_sight", "map_state"]


@dataclass(frozen=True)
class RadarMaps:
    """Maps that came in and go out; S are the sizes of their dimensions.

    Args:
        map_in: ``(B, *S)`` the maps as they came.
        map_clutter: ``(B, *S)`` mean echo of the weather over the mean noise of clear air, a ratio of powers; ``None``
            is none.
        map_out: ``(B, *S)`` the maps that go out; ``None`` until the receiver.
    """

    map_in: Tensor
    map_clutter: Tensor | None = None
    map_out: Tensor | None = None


@dataclass(frozen=True)
class PowerMapState(RadarState):
    """A batch of maps. The detections of ``RadarState`` are the cells over range and azimuth, R x A of them."""

    parts: ClassVar[dict[str, type[Any]]] = {**RadarState.parts, "maps": RadarMaps}

    maps: RadarMaps


for _part in (RadarMaps, PowerMapState):
    torch.export.register_dataclass(_part, serialized_type_name=f"torchweather.{_part.__name__}")


def map_state(values: Tensor, axes: MapAxes, sensor: Radar, ego_speed_m_per_s: float = 0.0) -> PowerMapState:
    """The state before any stage.

    Args:
        values: ``(B, *S)``.
        axes: of each map.
        sensor: the radar.
        ego_speed_m_per_s: of the vehicle, forward.
    """
    check_arguments(
        "map_state(values: Tensor, axes: MapAxes, sensor: Radar, ego_speed_m_per_s: float)",
        values,
        axes,
        sensor,
        ego_speed_m_per_s,
    )
    if values.ndim != 1 + len(axes.dims):
        raise InputValueError(
            f"map_state: values must be (B, {', '.join(axes.dims)}) of the axes; got {tuple(values.shape)}."
        )
    along = lines_of_sight(axes, values.device)[0]  # (R, A, 3)
    place = along.reshape(1, -1, 3).expand(values.shape[0], -1, -1)
    points = torch.cat([place, torch.zeros_like(place)], -1)
    range_m = torch.linalg.vector_norm(place, dim=-1)
    nothing = torch.zeros_like(range_m)
    each = points.new_zeros(values.shape[0])
    return PowerMapState.of(
        points_in=points,
        range_m=range_m,
        gain_db=nothing,
        kind=torch.full_like(range_m, int(PointKind.OBJECT), dtype=torch.int8),
        noise_floor_db=each,  # powers of a map count from its own noise
        detection_snr_db=points.new_tensor(sensor.detection_snr_db),
        attenuation_db_per_km=each,
        cover_loss_db=each,
        ego_speed_m_per_s=ego_speed_m_per_s,
        map_in=values,
    )


def lines_of_sight(axes: MapAxes, device: torch.device | None = None) -> tuple[Tensor, Tensor]:
    """Places of the cells at elevation 0, ``(R, A, 3)`` m, and unit vectors of all directions, ``(A, E, 3)``."""
    range_m, azimuth, elevation = (axes.axis(name).to(device) for name in ("range", "azimuth", "elevation"))
    flat = torch.stack([azimuth.cos(), azimuth.sin(), torch.zeros_like(azimuth)], -1)
    place = range_m[:, None, None] * flat
    across = elevation.cos()[None, :, None] * flat[:, None]
    up = elevation.sin()[None, :, None] * flat.new_tensor([0.0, 0.0, 1.0])
    return place.float(), (across + up).float()


def within_half_turn(angle_rad: Tensor) -> Tensor:
    """The same angle between -pi and pi."""
    return torch.remainder(angle_rad + math.pi, 2.0 * math.pi) - math.pi
