"""Counts of a cloud's points in the weather: kept, lost, replaced."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from torchweather.lidar import BeamEnd
from torchweather.lidar.cloud_frame import points_in_sensor_frame
from torchweather.lidar.sensor import Lidar
from torchweather.lidar.transform import LidarResult
from torchweather.pipeline.point_kind import PointKind

__all__ = ["cloud_counts", "has_return"]


def has_return(points: Tensor, sensor: Lidar) -> Tensor:
    """Rows ``(N,)`` with a return: those at the origin, or nearer than the sensor measures, have none."""
    x, y, z = points_in_sensor_frame(points[:, :3], sensor).unbind(-1)
    range_m = (x * x + y * y + z * z).sqrt()
    return (range_m > 0) & (range_m >= sensor.min_range_m)


def _named_ends(counts: Tensor | None) -> dict[str, int]:
    """Beams without return by where they end; those there are."""
    if counts is None:
        return {}
    return {end.name.lower(): int(counts[end]) for end in BeamEnd if end != BeamEnd.RETURN and int(counts[end])}


def cloud_counts(hit: Tensor, result: LidarResult) -> dict[str, Any]:
    """Counts of one cloud: objects, particles, lost points, empty beams.

    Args:
        hit: ``(N,)`` rows of the input with a return.
        result: of that input.

    Returns:
        ``points`` rows of the input; ``objects``, ``particles`` reported; ``lost`` points of the input whose beam
        reports nothing now; ``empty_beams`` without return before the weather, and ``beam_ends``, how many of them end
        in the sky, on the ground, ...; ``floored_points`` at the detection threshold; ``transmission_mean``, two way,
        of the beams that met an object (``None`` where none did); ``own_vehicle_points`` among the objects, where the
        own vehicle is known; of a dual sensor ``second_objects`` and ``second_particles``.

    Example:
        >>> from torchweather.transforms import LidarFog
        >>> from torchweather.atmosphere.weather import Fog
        >>> lidar = Lidar.preset("ouster-os1-128")
        >>> points = torch.tensor([[60.0, 0.0, 0.0, 40.0], [0.0, 0.0, 0.0, 0.0]])
        >>> fog = LidarFog(Fog(mor_m=50), lidar)
        >>> found = cloud_counts(has_return(points, lidar), fog.run(points, fog.draw(points, seed=1)))
        >>> found["objects"], found["particles"], found["lost"], found["empty_beams"]
        (0, 1, 0, 1)
    """
    kind, source, transmission = result.kind, result.source, result.transmission
    assert isinstance(kind, Tensor)
    assert isinstance(source, Tensor)
    assert isinstance(transmission, Tensor)
    # Rows of the result whose beam had a return; its order may be another where points were left out.
    from_hit = (source >= 0) & torch.cat([hit, hit.new_zeros(1)])[source]
    reports = from_hit & (kind != PointKind.LOST)
    found: dict[str, Any] = {
        "points": len(hit),
        "objects": int((kind == PointKind.OBJECT).sum()),
        "particles": int((kind == PointKind.PARTICLE).sum()),
        "lost": int(hit.sum() - reports.sum()),
        "empty_beams": int(result.empty_beams),
        "beam_ends": _named_ends(result.beam_end_counts),
        "floored_points": int(result.floored_points),
        "transmission_mean": float(transmission[from_hit].double().mean()) if bool(from_hit.any()) else None,
    }
    if result.own_vehicle_points is not None:
        found["own_vehicle_points"] = int(result.own_vehicle_points)
    if isinstance(result.second_kind, Tensor):
        found["second_objects"] = int((result.second_kind == PointKind.OBJECT).sum())
        found["second_particles"] = int((result.second_kind == PointKind.PARTICLE).sum())
    return found
