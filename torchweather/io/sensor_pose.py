"""Where a sensor stands in the frame of its clouds: a pose from a file."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from torchweather.core.arguments import check_arguments
from torchweather.core.errors import TorchweatherError
from torchweather.core.yaml_file import parse_json, parse_yaml
from torchweather.io.arrays import read_array
from torchweather.lidar.pose import split_pose

__all__ = ["read_sensor_pose"]

_MAX_BYTES = 2**20  # a pose has some 200
_MATRIX = "T_cloud_from_sensor, or translation and rotation (quaternion w, x, y, z) as in nuScenes"
_WANTED = f"expected {_MATRIX}: 4 x 4 or its first three rows as .npy, .txt (12 or 16 numbers), .json or .yaml"
# Keys under which tools keep such a matrix; the last is Waymo's.
_KEYS = ("T_cloud_from_sensor", "T_vehicle_from_lidar", "T_vehicle_from_sensor", "transform", "extrinsic")


def read_sensor_pose(path: str | os.PathLike[str]) -> Tensor:
    """``T_cloud_from_sensor`` of a file, ``(4, 4)``, float64, metres: for ``Lidar.with_pose``.

    Args:
        path: ``.npy``; ``.txt`` with 12 or 16 numbers in rows (a name and a colon before them are skipped, as in
            KITTI's calibrations of one line); ``.json``, ``.yaml`` or ``.yml`` with the matrix as rows or as a list,
            alone or under ``T_cloud_from_sensor``, ``T_vehicle_from_lidar``, ``transform`` or ``extrinsic``, or with
            ``translation`` and ``rotation`` (quaternion w, x, y, z, as a row of nuScenes' calibrated_sensor).

    Raises:
        TorchweatherError: the file is missing, or holds no pose.

    Example:
        >>> from tempfile import mkdtemp
        >>> file = Path(mkdtemp()) / "top.txt"
        >>> _ = file.write_text("1 0 0 1.43\\n0 1 0 0\\n0 0 1 2.18\\n")
        >>> read_sensor_pose(file)[:3, 3].tolist()
        [1.43, 0.0, 2.18]
    """
    check_arguments("read_sensor_pose(path: path)", path)
    source = Path(path)
    if not source.is_file():
        raise TorchweatherError(f"{source}: no such file; {_WANTED}.")
    if source.suffix.lower() == ".npy":
        values: Any = read_array(source, ("T_cloud_from_sensor",))
    else:
        if source.stat().st_size > _MAX_BYTES:
            raise TorchweatherError(f"{source}: {_WANTED}; got {source.stat().st_size} bytes.")
        values = _of_text(source)
    pose = torch.eye(4, dtype=torch.float64)
    try:
        origin_m, rotation = split_pose(values)
    except ValueError as error:
        raise TorchweatherError(f"{source}: {error}") from error
    pose[:3, 3] = torch.tensor(origin_m, dtype=torch.float64)
    if rotation is not None:
        pose[:3, :3] = torch.tensor(rotation, dtype=torch.float64)
    return pose


def _of_text(source: Path) -> Any:
    """Input of ``split_pose``: rows of numbers."""
    try:
        text = source.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise TorchweatherError(f"{source}: {_WANTED}; {error}.") from error
    suffix = source.suffix.lower()
    if suffix not in (".json", ".yaml", ".yml"):
        return _of_numbers(text, source)
    if suffix == ".json":
        content = parse_json(text, str(source), _MATRIX)
    else:
        content = parse_yaml(text, str(source), _MATRIX, allow_nan=True)
    if isinstance(content, Mapping):
        content = _of_mapping(content, source)
    if isinstance(content, list) and len(content) in (12, 16):
        return [content[4 * row : 4 * row + 4] for row in range(len(content) // 4)]
    return content


def _of_numbers(text: str, source: Path) -> list[list[float]]:
    words = [word for word in re.split(r"[\s,;\[\]]+", re.sub(r"^\s*\w+:", "", text)) if word]
    try:
        values = [float(word) for word in words]
    except ValueError as error:
        raise TorchweatherError(f"{source}: {_WANTED}; {error}.") from error
    if len(values) not in (12, 16):
        raise TorchweatherError(f"{source}: {_WANTED}; got {len(values)} numbers.")
    return [values[4 * row : 4 * row + 4] for row in range(len(values) // 4)]


def _of_mapping(content: Mapping[Any, Any], source: Path) -> Any:
    for key in _KEYS:
        if key in content:
            inner = content[key]
            return inner.get("transform", inner) if isinstance(inner, Mapping) else inner
    if "translation" not in content or "rotation" not in content:
        raise TorchweatherError(f"{source}: {_WANTED}; got {', '.join(map(str, content)) or 'nothing'}.")
    try:
        place = torch.as_tensor(content["translation"], dtype=torch.float64).reshape(3, 1)
        turn = torch.as_tensor(content["rotation"], dtype=torch.float64)
        turn = turn if turn.shape == (3, 3) else _rotation_of_quaternion(turn.reshape(4))
    except (TypeError, ValueError, RuntimeError) as error:
        raise TorchweatherError(f"{source}: {_WANTED}; {error}.") from error
    return torch.cat([turn, place], 1)


def _rotation_of_quaternion(quaternion: Tensor) -> Tensor:
    w, x, y, z = (quaternion / quaternion.norm()).tolist()
    return torch.tensor(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ],
        dtype=torch.float64,
    )
