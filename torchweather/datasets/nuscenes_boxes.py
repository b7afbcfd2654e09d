"""nuScenes' boxes: from annotations (dicts or json) in the global or a sensor's frame, and back."""

from __future__ import annotations

import json
import os
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from torchweather.core.arguments import check_arguments
from torchweather.core.atomic import atomic_write
from torchweather.core.errors import InputValueError, TorchweatherError
from torchweather.datasets.box_visibility import BoxVisibility
from torchweather.datasets.boxes import Boxes, checked_transform, turned_back, turned_yaw

__all__ = ["boxes_from_nuscenes", "boxes_to_nuscenes", "read_nuscenes_boxes", "write_nuscenes_boxes"]

# Where tables, results and mmdetection3d keep the class.
_NAME_KEYS = ("category_name", "detection_name", "tracking_name", "name")
_PLANE = torch.tensor([[1.0, 0.0], [0.0, 1.0], [0.0, 0.0]], dtype=torch.float64)


def boxes_from_nuscenes(annotations: Iterable[Mapping[str, Any]], T_lidar_from_boxes: Tensor | None = None) -> Boxes:
    """Boxes of nuScenes annotations, in the frame of the cloud.

    An annotation has ``translation`` (centre), ``size`` (width, length, height) and ``rotation`` (quaternion w, x, y,
    z of a box whose length points along x). Boxes are upright in the cloud's frame: tilt is dropped.

    Args:
        annotations: as in nuScenes' tables or results, or the dicts of a sensor's frame.
        T_lidar_from_boxes: ``(4, 4)`` from the frame of the annotations (global, or a sensor's) to that of the cloud;
            ``None`` where they are the same. The roof LiDAR's own frame has x right and y forward, as
            `read_nuscenes_points` gives it: boxes and clouds agree as long as both are in it.

    Returns:
        The boxes, float64; each record is the annotation.

    Raises:
        TorchweatherError: an annotation lacks a key or holds other than finite numbers.

    Example:
        >>> car = {"translation": [10, 2, 1], "size": [2, 4, 1.5], "rotation": [1, 0, 0, 0], "category_name": "car"}
        >>> boxes_from_nuscenes([car]).size_m.tolist()
        [[4.0, 2.0, 1.5]]
    """
    check_arguments(
        "boxes_from_nuscenes(annotations: Iterable, T_lidar_from_boxes: Nested | None)",
        annotations,
        T_lidar_from_boxes,
    )
    entries = list(annotations)
    transform = _transform(T_lidar_from_boxes, "boxes_from_nuscenes")
    rows = []
    for number, entry in enumerate(entries):
        check_arguments("boxes_from_nuscenes(annotations: Mapping)", entry)
        try:
            parts = [[float(value) for value in entry[key]] for key in ("translation", "size", "rotation")]
            if [len(part) for part in parts] != [3, 3, 4]:
                raise InputValueError(f"{[len(part) for part in parts]} numbers")
        except (KeyError, TypeError, ValueError, OverflowError) as error:
            raise TorchweatherError(
                f"annotation {number}: expected translation (3), size (3: width, length, height) and rotation (4: w, "
                f"x, y, z); {type(error).__name__}: {error}."
            ) from error
        rows.append([number for part in parts for number in part])
    table = torch.tensor(rows, dtype=torch.float64).reshape(-1, 10)
    bad = ~torch.isfinite(table).all(dim=1) | (table[:, 3:6] <= 0).any(dim=1) | (table[:, 6:].norm(dim=1) == 0)
    if bool(bad.any()):
        first = int(torch.nonzero(bad)[0])
        raise TorchweatherError(
            f"annotation {first}: expected finite numbers, sizes above 0 m and a quaternion that is not 0; got "
            f"{table[first].tolist()}."
        )
    w, x, y, z = (table[:, 6:] / table[:, 6:].norm(dim=1, keepdim=True)).unbind(dim=1)
    # The heading is the first column of the rotation matrix; its angle about z.
    yaw = torch.atan2(2 * (x * y + w * z), 1 - 2 * (y * y + z * z))
    return Boxes(
        table[:, :3] @ transform[:3, :3].T + transform[:3, 3],
        table[:, [4, 3, 5]],
        turned_yaw(yaw, _PLANE, transform[:3, :3]),
        tuple(str(next((entry[key] for key in _NAME_KEYS if key in entry), "")) for entry in entries),
        tuple(dict(entry) for entry in entries),
    )


def boxes_to_nuscenes(
    boxes: Boxes, T_lidar_from_boxes: Tensor | None = None, visibility: BoxVisibility | None = None
) -> list[dict[str, Any]]:
    """Annotations of boxes, the inverse of `boxes_from_nuscenes`; other keys of the records stay.

    Args:
        boxes: in the frame of the cloud.
        T_lidar_from_boxes: as it was for reading.
        visibility: of the boxes in weather; sets ``num_lidar_pts`` to the points left.
    """
    check_arguments(
        "boxes_to_nuscenes(boxes: Boxes, T_lidar_from_boxes: Nested | None, visibility: BoxVisibility | None)",
        boxes,
        T_lidar_from_boxes,
        visibility,
    )
    back = torch.linalg.inv(_transform(T_lidar_from_boxes, "boxes_to_nuscenes"))
    centre = (boxes.centre_m.double().cpu() @ back[:3, :3].T + back[:3, 3]).tolist()
    size = boxes.size_m.double().cpu()[:, [1, 0, 2]].tolist()
    half = 0.5 * turned_back(boxes.yaw_rad.double().cpu(), _PLANE, torch.linalg.inv(back[:3, :3]))
    zero = torch.zeros_like(half)
    rotation = torch.stack((torch.cos(half), zero, zero, torch.sin(half)), dim=-1).tolist()
    annotations = []
    for k, (name, record) in enumerate(zip(boxes.names, boxes.records, strict=True)):
        key = next((key for key in _NAME_KEYS if key in record), _NAME_KEYS[0])
        entry = {**record, key: name, "translation": centre[k], "size": size[k], "rotation": rotation[k]}
        if visibility is not None:
            entry["num_lidar_pts"] = int(visibility.points_left[k])
        annotations.append(entry)
    return annotations


def read_nuscenes_boxes(
    path: str | os.PathLike[str], T_lidar_from_boxes: Tensor | None = None, sample_token: str | None = None
) -> Boxes:
    """Boxes of a json file: a list of annotations (with ``sample_token``, those of one sample), or a results file.

    Args:
        path: json; a list, or ``{"results": {sample_token: [...]}}``.
        T_lidar_from_boxes: see `boxes_from_nuscenes`.
        sample_token: of the sample; needed for a results file with several.

    Raises:
        TorchweatherError: the file is missing, no json, has no such sample, or a broken annotation.
    """
    check_arguments(
        "read_nuscenes_boxes(path: path, T_lidar_from_boxes: Nested | None, sample_token: str | None)",
        path,
        T_lidar_from_boxes,
        sample_token,
    )
    source = Path(path)
    try:
        content = json.loads(source.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        raise TorchweatherError(f"{source}: expected json with nuScenes annotations; {error}.") from error
    if isinstance(content, dict) and isinstance(content.get("results"), dict):
        results = content["results"]
        token = next(iter(results)) if sample_token is None and len(results) == 1 else sample_token
        if token not in results:
            raise TorchweatherError(
                f"{source}: expected sample_token, one of {len(results)} samples ({', '.join(list(results)[:3])}, "
                f"...); got {sample_token!r}."
            )
        content = results[token]
    elif isinstance(content, list) and sample_token is not None:
        content = [entry for entry in content if isinstance(entry, dict) and entry.get("sample_token") == sample_token]
    if not isinstance(content, list) or not all(isinstance(entry, dict) for entry in content):
        raise TorchweatherError(f"{source}: expected a list of nuScenes annotations; got {type(content).__name__}.")
    try:
        return boxes_from_nuscenes(content, T_lidar_from_boxes)
    except TorchweatherError as error:
        raise TorchweatherError(f"{source}: {error}") from error


def write_nuscenes_boxes(
    path: str | os.PathLike[str],
    boxes: Boxes,
    T_lidar_from_boxes: Tensor | None = None,
    visibility: BoxVisibility | None = None,
) -> None:
    """Write the annotations of `boxes_to_nuscenes` as a json list."""
    check_arguments(
        "write_nuscenes_boxes(path: path, boxes: Boxes, T_lidar_from_boxes: Nested | None, "
        "visibility: BoxVisibility | None)",
        path,
        boxes,
        T_lidar_from_boxes,
        visibility,
    )
    annotations = boxes_to_nuscenes(boxes, T_lidar_from_boxes, visibility)
    try:
        text = json.dumps(annotations, indent=1)
    except (TypeError, ValueError) as error:
        raise TorchweatherError(f"{path}: a record cannot be written as json ({error}).") from error
    with atomic_write(path) as unfinished:
        unfinished.write_text(text + "\n", encoding="utf-8")


def _transform(transform: Tensor | None, owner: str) -> Tensor:
    if transform is None:
        return torch.eye(4, dtype=torch.float64)
    return checked_transform(transform, "T_lidar_from_boxes", owner)
