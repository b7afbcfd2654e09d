"""Points of a cloud in clear air and in a weather, counted by range and packed for a page."""

from __future__ import annotations

import base64
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
import torch
from torch import Tensor

from torchweather.core.errors import InputValueError
from torchweather.lidar.cloud_frame import points_in_sensor_frame
from torchweather.lidar.sensor import Lidar
from torchweather.lidar.transform import LidarResult
from torchweather.pipeline.point_kind import PointKind
from torchweather.report.cloud_counts import has_return

__all__ = [
    "INT16_MAX",
    "UINT16_MAX",
    "RangeCounts",
    "ViewPoints",
    "counts_by_range",
    "packed",
    "thinned",
    "view_points",
]

# Narrow where weather returns light (the first tens of metres), wide where points are few.
RANGE_EDGES_M = (0.0, 10.0, 20.0, 30.0, 50.0, 80.0, 120.0)
INT16_MAX, UINT16_MAX = 32767, 65535


@dataclass(frozen=True)
class ViewPoints:
    """Points to be shown.

    Args:
        xyz_m: ``(N, 3)`` float32, metres from the sensor, in its frame.
        intensity: ``(N,)`` float32, in the sensor's unit.
        kind: ``(N,)`` uint8, ``PointKind``; a lost point stands where it was in clear air.
        beam: ``(N,)`` int64, number of the beam; the same in clear air and in weather.
    """

    xyz_m: Tensor
    intensity: Tensor
    kind: Tensor
    beam: Tensor

    def __len__(self) -> int:
        return len(self.xyz_m)

    @property
    def range_m(self) -> Tensor:
        """``(N,)`` distance from the sensor, metres."""
        return self.xyz_m.double().square().sum(-1).sqrt()

    def of(self, rows: Tensor) -> ViewPoints:
        """Some of the points."""
        return ViewPoints(self.xyz_m[rows], self.intensity[rows], self.kind[rows], self.beam[rows])


@dataclass(frozen=True)
class RangeCounts:
    """Points of a cloud whose range lies in one interval.

    Args:
        label: the interval, metres.
        clear: points in clear air.
        objects, particles: points in weather.
        lost: points in clear air whose beam reports nothing in weather.
    """

    label: str
    clear: int
    objects: int
    particles: int
    lost: int


def view_points(points: Tensor, result: LidarResult, sensor: Lidar) -> tuple[ViewPoints, ViewPoints]:
    """Points in clear air and in weather, the second with the lost ones.

    Args:
        points: ``(N, C)`` the clear cloud: x, y, z in metres, intensity.
        result: of that cloud, with ``lost`` as zero, NaN or left out; second returns are added to the first.
        sensor: the LiDAR.

    Example:
        >>> from torchweather.transforms import LidarFog
        >>> from torchweather.atmosphere.weather import Fog
        >>> lidar = Lidar.preset("ouster-os1-128")
        >>> points = torch.tensor([[60.0, 0.0, 0.0, 40.0], [0.0, 0.0, 0.0, 0.0]])
        >>> fog = LidarFog(Fog(mor_m=50), lidar)
        >>> clear, weather = view_points(points, fog.run(points, fog.draw(points, seed=1)), lidar)
        >>> clear.kind.tolist(), weather.kind.tolist()
        ([0], [1])
    """
    if not isinstance(result.points, Tensor) or points.ndim != 2:
        raise InputValueError(
            f"view_points: points must be one cloud (N, C), without batch; got {tuple(points.shape)}."
        )
    hit = has_return(points, sensor)
    # From here on about the sensor.
    points = points_in_sensor_frame(points, sensor)
    beams = torch.arange(len(points), device=points.device)
    clear = _taken(points, torch.full_like(beams, int(PointKind.OBJECT)), beams, hit)
    found = points_in_sensor_frame(result.points, sensor)
    first = _reported(found, result.kind, result.source, len(points))
    parts = [first]
    if isinstance(result.second, Tensor):
        second = points_in_sensor_frame(result.second, sensor)
        parts.append(_reported(second, result.second_kind, result.second_source, len(points)))
    answered = torch.zeros(len(points) + 1, dtype=torch.bool, device=points.device)
    answered[first.beam.clamp(max=len(points)).to(points.device)] = True
    parts.append(_taken(points, torch.full_like(beams, int(PointKind.LOST)), beams, hit & ~answered[:-1]))
    columns = ("xyz_m", "intensity", "kind", "beam")
    return clear, ViewPoints(*(torch.cat([getattr(part, name) for part in parts]) for name in columns))


def _reported(points: Tensor, kind: Any, source: Any, count: int) -> ViewPoints:
    """Points of a result that a beam reports; beams that were appended follow those of the input."""
    rows = torch.arange(len(points), device=points.device)
    beam = torch.where(source >= 0, source, rows + count)
    return _taken(points, kind, beam, kind != PointKind.LOST)


def _taken(points: Tensor, kind: Tensor, beam: Tensor, rows: Tensor) -> ViewPoints:
    xyz, intensity = points[rows, :3].float().cpu(), points[rows, 3].float().cpu()
    return ViewPoints(xyz, intensity, kind[rows].to(torch.uint8).cpu(), beam[rows].cpu())


def counts_by_range(clear: ViewPoints, weather: ViewPoints) -> list[RangeCounts]:
    """Counts by range, in intervals that cover all points; the last row is their sum.

    Points in weather count at the range that they report, lost ones at their range in clear air.
    """

    def numbers(low_m: float, high_m: float) -> dict[str, int]:
        here = (weather.range_m >= low_m) & (weather.range_m < high_m)
        clear_here = (clear.range_m >= low_m) & (clear.range_m < high_m)
        kinds = {"objects": PointKind.OBJECT, "particles": PointKind.PARTICLE, "lost": PointKind.LOST}
        return {"clear": int(clear_here.sum())} | {
            name: int((here & (weather.kind == kind)).sum()) for name, kind in kinds.items()
        }

    rows = [
        RangeCounts(f"{low_m:g} to {high_m:g}", **numbers(low_m, high_m)) for low_m, high_m in pairwise(RANGE_EDGES_M)
    ]
    rows.append(RangeCounts(f"{RANGE_EDGES_M[-1]:g} and more", **numbers(RANGE_EDGES_M[-1], np.inf)))
    last = max((number for number, row in enumerate(rows) if row.clear or row.objects or row.particles), default=0)
    return [*rows[: last + 1], RangeCounts("all", **numbers(0.0, np.inf))]


def packed(cloud: ViewPoints, step_m: float, intensity_step: float) -> dict[str, Any]:
    """A cloud as base64 of little-endian arrays: x, y, z in int16 steps, intensity in uint16 steps, kind in uint8.

    Args:
        cloud: the points.
        step_m: metres of one step of a position.
        intensity_step: of one step of an intensity.

    Example:
        >>> cloud = ViewPoints(torch.ones(1, 3), torch.ones(1), torch.ones(1, dtype=torch.uint8), torch.zeros(1))
        >>> packed(cloud, step_m=1.0, intensity_step=0.5)
        {'count': 1, 'position': 'AQABAAEA', 'intensity': 'AgA=', 'kind': 'AQ=='}
    """
    position = (cloud.xyz_m.double().numpy() / step_m).round().clip(-INT16_MAX, INT16_MAX).astype("<i2")
    intensity = (cloud.intensity.double().nan_to_num().numpy() / intensity_step).round().clip(0, UINT16_MAX)
    return {
        "count": len(cloud),
        "position": base64.b64encode(position.tobytes()).decode("ascii"),
        "intensity": base64.b64encode(intensity.astype("<u2").tobytes()).decode("ascii"),
        "kind": base64.b64encode(cloud.kind.numpy().astype("u1").tobytes()).decode("ascii"),
    }


def thinned(clear: ViewPoints, seen: ViewPoints, most: int) -> tuple[ViewPoints, ViewPoints, int]:
    """Every so many-th beam of both clouds, so that neither has more than ``most`` points."""
    stride = max(1, -(-max(len(clear), len(seen)) // most))
    while True:
        thin = [cloud.of(cloud.beam % stride == 0) if stride > 1 else cloud for cloud in (clear, seen)]
        if max(map(len, thin)) <= most or stride > max(len(clear), len(seen)):
            return thin[0], thin[1], stride
        stride += 1
