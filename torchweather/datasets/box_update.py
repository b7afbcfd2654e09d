"""Boxes after weather: what is left of each, written into its record."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import torch
from torch import Tensor

from torchweather.core.arguments import check_arguments
from torchweather.core.errors import InputTypeError, InputValueError
from torchweather.datasets.box_visibility import BoxVisibility, box_visibility
from torchweather.datasets.boxes import Boxes, points_in_boxes
from torchweather.pipeline.point_kind import PointKind

if TYPE_CHECKING:
    from torchweather.camera.rgb import RgbResult
    from torchweather.camera.transform import CameraResult
    from torchweather.lidar.transform import LidarResult
    from torchweather.radar.transform import RadarResult

__all__ = ["update_boxes"]

# Where nuScenes' annotations count the points of a sensor.
_NUSCENES_COUNTS = {"lidar": "num_lidar_pts", "radar": "num_radar_pts"}


def update_boxes(
    boxes: Boxes,
    result: LidarResult | RadarResult | CameraResult | RgbResult | None,
    points: Tensor | None = None,
    *,
    rectangles: Tensor | None = None,
) -> Boxes:
    """The same boxes, each record with its points, transmission and cover in the weather.

    Boxes do not move in weather and none is taken away: what is hidden decides the user, by these numbers.

    ===============  =================================================================================================
    result           keys that each record gets
    ===============  =================================================================================================
    of a LiDAR       ``lidar_points_left`` returns of objects inside; ``lidar_transmission`` mean two-way transmission
                     of the beams that met the box; ``lidar_points_before`` where ``points`` are given;
                     ``num_lidar_pts`` (nuScenes) where the record has it
    of a radar       the same with ``radar``; the transmission is the share of the echo's power that is left
    of a camera      ``camera_transmission`` mean transmission (fog), ``camera_particle_cover`` mean share of the
                     exposure in which particles cover a pixel, both over the box's rectangle in the image
    ===============  =================================================================================================

    Args:
        boxes: M boxes in the frame of the cloud.
        result: what ``run`` of a transform gave for one sample; ``None`` where it got no weather (``Compose`` has no
            result then): all ``points`` are left, taken as a LiDAR's.
        points: ``(N, 3 or more)`` the cloud, or the list of detections, that went into the weather. Without it the
            transmission is that of the points left, so it is too high: beams that were lost are not in it.
        rectangles: ``(M, 4)`` left, top, right, bottom in pixels, for a camera; `project_boxes` gives them. Default:
            ``bbox`` of the records, as `read_kitti_boxes` has them. NaN is a box that the image does not show.

    Returns:
        Boxes with new records of plain numbers, for the writers; ``None`` stands for a mean over nothing.

    Raises:
        TypeError: ``result`` is none of these.
        ValueError: a batch, other numbers of boxes, no rectangles, or no ``points`` where there was no weather.

    Note:
        Second returns of a dual-return LiDAR are not counted. A rectangle holds background beside the box, which lies
        farther away and shows a lower transmission than the box itself.

    Example:
        >>> from torchweather.sensors import Lidar
        >>> from torchweather.transforms import LidarFog
        >>> from torchweather.atmosphere.weather import Fog
        >>> fog = LidarFog(Fog(mor_m=50), Lidar.preset("velodyne-hdl-64e"))
        >>> points = torch.tensor([[20.0, 0.0, 0.0, 200.0], [20.0, 0.5, 0.0, 1.0]])
        >>> car = Boxes(torch.tensor([[21.0, 0, 0]]), torch.tensor([[4.0, 2, 2]]), torch.zeros(1), ("Car",))
        >>> update_boxes(car, fog.run(points, fog.draw(points, seed=1)), points).records[0]["lidar_points_before"]
        2
    """
    check_arguments(
        "update_boxes(boxes: Boxes, result: LidarResult | RadarResult | CameraResult | RgbResult | None, "
        "points: real(N, 3+) | None, rectangles: Tensor | None)",
        boxes,
        result,
        points,
        rectangles,
    )
    sensor = "lidar" if result is None else getattr(result, "sensor", "")
    if sensor not in _EVIDENCE:
        raise InputTypeError(
            "update_boxes: result must be what run() of a transform gives (LidarResult, RadarResult, CameraResult, "
            f"RgbResult); got {type(result).__name__}."
        )
    values = _in_clear_air(boxes, points) if result is None else _EVIDENCE[sensor](boxes, result, points, rectangles)
    found = {f"{sensor}_{key}": column for key, column in values.items()}
    records = []
    for number, record in enumerate(boxes.records):
        new = {**record, **{key: _plain(column[number]) for key, column in found.items()}}
        count = _NUSCENES_COUNTS.get(sensor, "")
        if count and count in record:
            new[count] = new[f"{sensor}_points_left"]
        records.append(new)
    return replace(boxes, records=tuple(records))


def _in_cloud(
    boxes: Boxes, result: LidarResult | RadarResult, points: Tensor | None, rectangles: Tensor | None
) -> dict[str, list[Any]]:
    """Counts and mean transmission of the points in each box."""
    after, kind, source, share = result.points, result.kind, result.source, result.transmission
    parts = (after, kind, source, share)
    if not all(isinstance(part, Tensor) for part in parts) or kind.ndim != 1:  # type: ignore[union-attr]
        shape = f"a list of {len(after)} clouds" if isinstance(after, list) else tuple(after.shape)
        raise InputValueError(
            f"update_boxes: result must be of one sample, points (N, C), because boxes differ between samples; got "
            f"{shape}. Call it for each sample of the batch."
        )
    after, kind, source, share = (torch.as_tensor(part) for part in parts)
    if points is not None:
        return _as_lists(box_visibility(boxes, points, after, kind, share, source))
    inside = points_in_boxes(after, boxes) & (kind == int(PointKind.OBJECT))[:, None]  # (N, M)
    left = inside.sum(0)
    share = share.to(torch.promote_types(share.dtype, torch.float32))
    mean = torch.where(inside, share[:, None], 0.0).sum(0) / left  # 0 / 0 is NaN: no point
    return {"points_left": left.tolist(), "transmission": mean.tolist()}


def _in_clear_air(boxes: Boxes, points: Tensor | None) -> dict[str, list[Any]]:
    if points is None:
        raise InputValueError("update_boxes: without a result points are wanted, the cloud (N, 3 or more); got none.")
    count = points.shape[0]
    kind = torch.full((count,), int(PointKind.OBJECT), device=points.device)
    return _as_lists(box_visibility(boxes, points, points, kind, torch.ones(count, device=points.device)))


def _as_lists(seen: BoxVisibility) -> dict[str, list[Any]]:
    return {
        "points_before": seen.points_before.tolist(),
        "points_left": seen.points_left.tolist(),
        "transmission": seen.transmission.tolist(),
    }


def _in_rectangles(
    boxes: Boxes, result: CameraResult | RgbResult, points: Tensor | None, rectangles: Tensor | None
) -> dict[str, list[Any]]:
    """Mean transmission and particle cover over the rectangle of each box."""
    transmission, mask = result.transmission, result.particle_mask
    if transmission.ndim != 3:
        raise InputValueError(
            "update_boxes: result must be of one image, transmission (1, H, W), because boxes differ between samples; "
            f"got {tuple(transmission.shape)}. Call it for each sample of the batch."
        )
    if rectangles is None:
        missing = [number for number, record in enumerate(boxes.records) if "bbox" not in record]
        if missing:
            raise InputValueError(
                "update_boxes: of a camera's result rectangles (M, 4) are wanted, left, top, right, bottom in pixels; "
                f"got none, and record {missing[0]} has no bbox. Take rectangles=project_boxes(boxes, camera, "
                "T_camera_from_lidar)."
            )
        rows = [[float(value) for value in record["bbox"]] for record in boxes.records]
        rectangles = torch.tensor(rows, dtype=torch.float64).reshape(-1, 4)
    if rectangles.shape != (len(boxes), 4):
        raise InputValueError(
            f"update_boxes: rectangles must be ({len(boxes)}, 4), left, top, right, bottom in pixels, one for each "
            f"box; got {tuple(rectangles.shape)}."
        )
    return {
        "transmission": _rectangle_means(transmission[0], rectangles).tolist(),
        "particle_cover": _rectangle_means(mask[0], rectangles).tolist(),
    }


# By the sensor of a result: values of each box from the result, the cloud before the weather, and the rectangles.
_EVIDENCE: dict[str, Callable[[Boxes, Any, Tensor | None, Tensor | None], dict[str, list[Any]]]] = {
    "camera": _in_rectangles,
    "lidar": _in_cloud,
    "radar": _in_cloud,
}


def _rectangle_means(image: Tensor, rectangles: Tensor) -> Tensor:
    """``(M,)`` means of ``(H, W)`` over the pixels whose centres the rectangles hold; NaN over none."""
    height, width = image.shape
    total = torch.zeros(height + 1, width + 1, dtype=torch.float64, device=image.device)
    total[1:, 1:] = image.double().cumsum(0).cumsum(1)
    known = torch.isfinite(rectangles).all(1).to(image.device)
    edges = rectangles.to(device=image.device, dtype=torch.float64).nan_to_num(0.0)
    left, top = edges[:, 0].ceil().clamp(0, width).long(), edges[:, 1].ceil().clamp(0, height).long()
    right, bottom = edges[:, 2].floor().clamp(-1, width - 1).long(), edges[:, 3].floor().clamp(-1, height - 1).long()
    right, bottom = torch.maximum(right + 1, left), torch.maximum(bottom + 1, top)
    inside = total[bottom, right] - total[top, right] - total[bottom, left] + total[top, left]
    return torch.where(known, inside / ((right - left) * (bottom - top)), torch.nan)


def _plain(value: float) -> float | None:
    """None for NaN: json has no NaN."""
    return None if isinstance(value, float) and math.isnan(value) else value
