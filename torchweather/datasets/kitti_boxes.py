"""KITTI's object labels: boxes from ``label_2/*.txt`` and back."""

from __future__ import annotations

import math
import os
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from torchweather.core.arguments import check_arguments
from torchweather.core.atomic import atomic_write
from torchweather.core.errors import InputValueError, TorchweatherError
from torchweather.datasets.boxes import Boxes, checked_transform, turned_back, turned_yaw

__all__ = ["read_kitti_boxes", "write_kitti_boxes"]

# In the rectified camera frame (x right, y down, z ahead) rotation_y = 0 is a heading along x, a quarter turn one
# along -z: it turns about y, from z to x.
_PLANE = torch.tensor([[1.0, 0.0], [0.0, 0.0], [0.0, -1.0]], dtype=torch.float64)
_NUMBERS = 14  # truncation, occlusion, alpha, 4 of the image box, 3 of size, 3 of place, rotation_y; then the score


def read_kitti_boxes(
    path: str | os.PathLike[str], T_rectified_from_lidar: Tensor, *, frame: int | None = None
) -> Boxes:
    """Boxes of a KITTI label file, in the frame of the Velodyne.

    The file has the centre of the bottom in the rectified frame of camera 0, height, width, length, and the heading
    about the camera's downward axis. The box of this library is upright in the Velodyne's frame: the tilt between the
    two (half a degree) is dropped.

    Args:
        path: ``label_2/*.txt``, or a result with a score; of the tracking kit ``label_02/SEQUENCE.txt``, whose lines
            begin with the number of a frame and that of a track.
        T_rectified_from_lidar: ``(4, 4)``, `read_kitti_rectified_from_lidar`. Not ``T_camera_from_lidar``, which goes
            on to camera 2, 6 cm beside.
        frame: whose lines are taken, of a file of the tracking kit.

    Returns:
        The boxes, float64. Each record holds ``truncation``, ``occlusion``, ``alpha``, ``bbox`` and, of a result,
        ``score``; of the tracking kit ``track_id``. Lines without a place (DontCare) are in ``unplaced``.

    Raises:
        TorchweatherError: the file is missing or no KITTI label.

    References:
        A. Geiger et al., Are we ready for autonomous driving?, CVPR 2012; the development kit's readme.
    """
    check_arguments(
        "read_kitti_boxes(path: path, T_rectified_from_lidar: Nested, frame: int | None)",
        path,
        T_rectified_from_lidar,
        frame,
    )
    source = Path(path)
    transform = checked_transform(T_rectified_from_lidar, "T_rectified_from_lidar", "read_kitti_boxes")
    try:
        lines = source.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise TorchweatherError(f"{source}: cannot be read ({error}).") from error
    names: list[str] = []
    records: list[dict[str, Any]] = []
    places: list[list[float]] = []
    unplaced: list[dict[str, Any]] = []
    for number, line in enumerate(lines, start=1):
        words = line.split()
        if not words:
            continue
        track: dict[str, Any] = {}
        if words[0].lstrip("-").isdecimal() and len(words) > 2 and words[1].lstrip("-").isdecimal():
            if frame is None:
                raise TorchweatherError(
                    f"{source}: line {number}: labels of the tracking kit, all frames of a sequence in one file. Pass "
                    "the frame: frame=0, 1, ..."
                )
            if int(words[0]) != frame:
                continue
            track, words = {"track_id": int(words[1])}, words[2:]
        elif frame is not None:
            raise TorchweatherError(
                f"{source}: line {number}: expected labels of the tracking kit, frame and track first; got "
                f"{words[0]!r}. Leave frame out."
            )
        try:
            values = [float(word) for word in words[1:]]
            if len(values) not in (_NUMBERS, _NUMBERS + 1):
                raise InputValueError(f"{len(values)} numbers")
            if not all(map(math.isfinite, values)):
                raise InputValueError("NaN or infinity where finite numbers are wanted")
            record: dict[str, Any] = {
                "truncation": values[0],
                "occlusion": int(values[1]),
                "alpha": values[2],
                "bbox": values[3:7],
                **track,
            }
        except (ValueError, OverflowError) as error:
            raise TorchweatherError(
                f"{source}: line {number}: expected a name and {_NUMBERS} numbers, or {_NUMBERS + 1} with a score; got "
                f"{error}."
            ) from error
        if len(values) > _NUMBERS:
            record["score"] = values[_NUMBERS]
        if min(values[7:10]) <= 0:
            unplaced.append({"name": words[0], "place": values[7:14], **record})
        else:
            names.append(words[0])
            records.append(record)
            places.append(values[7:14])
    table = torch.tensor(places, dtype=torch.float64).reshape(-1, 7)
    if not bool(torch.isfinite(table).all()):
        raise TorchweatherError(f"{source}: expected finite sizes, places and rotations; got NaN or inf.")
    height, width, length = table[:, 0], table[:, 1], table[:, 2]
    centre = torch.stack((table[:, 3], table[:, 4] - 0.5 * height, table[:, 5]), dim=-1)  # y points down
    back = torch.linalg.inv(transform)
    return Boxes(
        centre @ back[:3, :3].T + back[:3, 3],
        torch.stack((length, width, height), dim=-1),
        turned_yaw(table[:, 6], _PLANE, back[:3, :3]),
        tuple(names),
        tuple(records),
        tuple(unplaced),
    )


def write_kitti_boxes(path: str | os.PathLike[str], boxes: Boxes, T_rectified_from_lidar: Tensor) -> None:
    """Write boxes as a KITTI label file, two decimals as there; the inverse of `read_kitti_boxes`.

    What a record lacks is written as KITTI writes what is unknown: truncation and occlusion -1, alpha -10, image box 0.
    """
    check_arguments(
        "write_kitti_boxes(path: path, boxes: Boxes, T_rectified_from_lidar: Nested)",
        path,
        boxes,
        T_rectified_from_lidar,
    )
    transform = checked_transform(T_rectified_from_lidar, "T_rectified_from_lidar", "write_kitti_boxes")
    back = torch.linalg.inv(transform)
    size = boxes.size_m.double().cpu()
    bottom = boxes.centre_m.double().cpu() @ transform[:3, :3].T + transform[:3, 3]
    bottom[:, 1] += 0.5 * size[:, 2]
    angle = turned_back(boxes.yaw_rad.double().cpu(), _PLANE, back[:3, :3])
    table = torch.cat((size[:, [2, 1, 0]], bottom, angle[:, None]), dim=1).tolist()
    lines = [_line(name, record, place) for name, record, place in zip(boxes.names, boxes.records, table, strict=True)]
    lines += [_line(entry["name"], entry, entry["place"]) for entry in boxes.unplaced]
    with atomic_write(path) as unfinished:
        unfinished.write_text("".join(line + "\n" for line in lines), encoding="utf-8", newline="\n")


def _line(name: str, record: Any, place: list[float]) -> str:
    truncation = float(record.get("truncation", -1.0))
    words = [
        name.replace(" ", "_"),
        "-1" if truncation == -1 else f"{truncation:.2f}",
        str(int(record.get("occlusion", -1))),
        _two(record.get("alpha", -10.0)),
        *(f"{float(value):.2f}" for value in record.get("bbox", (0.0, 0.0, 0.0, 0.0))),
        *(_two(value) for value in place),
    ]
    if "score" in record:
        words.append(f"{float(record['score']):g}")
    return " ".join(words)


def _two(value: float) -> str:
    """Two decimals; KITTI's marks of what is unknown (-1, -10, -1000) without, zero without a sign."""
    if value in (-1.0, -10.0, -1000.0):
        return str(int(value))
    return f"{round(float(value), 2) + 0.0:.2f}"
