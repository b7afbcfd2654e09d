"""nuScenes: LiDAR sweeps and the calibration of a camera."""

from __future__ import annotations

import os
from pathlib import Path

import torch
from torch import Tensor

from torchweather.core.arguments import check_arguments
from torchweather.core.errors import InputValueError, TorchweatherError, nearest_name
from torchweather.core.yaml_file import read_json
from torchweather.datasets.calibration import CameraLidarCalibration
from torchweather.io.points import read_points

__all__ = ["read_nuscenes_calibration", "read_nuscenes_points"]


def read_nuscenes_points(path: str | os.PathLike[str]) -> Tensor:
    """A sweep of the roof LiDAR.

    Args:
        path: ``LIDAR_TOP/*.pcd.bin``.

    Returns:
        ``(N, 5)`` float32: x, y, z in metres, intensity 0..255, ring. As stored, x points right and y forward;
        ``T_camera_from_lidar`` of `read_nuscenes_calibration` expects them so.

    Raises:
        TorchweatherError: the file is missing, truncated, or not float32 rows of five.
    """
    check_arguments("read_nuscenes_points(path: path)", path)
    return read_points(path, format="nuscenes").points


def read_nuscenes_calibration(path: str | os.PathLike[str], camera: str = "CAM_FRONT") -> CameraLidarCalibration:
    """A camera and the roof LiDAR at the camera's time stamp.

    Args:
        path: json with an entry per camera that holds ``cam2img`` (3 x 3) and ``lidar2cam`` (4 x 4), the form in which
            mmdetection3d keeps a nuScenes frame.
        camera: name of the entry.

    Raises:
        TorchweatherError: the file is missing, no json, or lacks the entry.
    """
    check_arguments("read_nuscenes_calibration(path: path, camera: str)", path, camera)
    source = Path(path)
    content = read_json(source, "a calibration for each camera")
    entries = content if isinstance(content, dict) else {}
    if camera not in entries:
        names = [name for name, entry in entries.items() if isinstance(entry, dict) and "cam2img" in entry]
        raise TorchweatherError(
            f"{source}: expected an entry {camera!r}; got cameras {', '.join(names) or 'none'}."
            f"{nearest_name(camera, names)}"
        )
    try:
        camera_matrix = torch.tensor(entries[camera]["cam2img"], dtype=torch.float64)
        transform = torch.tensor(entries[camera]["lidar2cam"], dtype=torch.float64)
    except (KeyError, TypeError, ValueError) as error:
        raise TorchweatherError(
            f"{source}: expected numbers in cam2img and lidar2cam of {camera!r}; {type(error).__name__}: {error}."
        ) from error
    if camera_matrix.shape != (3, 3) or transform.shape != (4, 4):
        raise TorchweatherError(
            f"{source}: expected cam2img 3 x 3 and lidar2cam 4 x 4 of {camera!r}; got {tuple(camera_matrix.shape)} and "
            f"{tuple(transform.shape)}."
        )
    try:
        return CameraLidarCalibration(camera_matrix, transform)
    except InputValueError as error:
        raise TorchweatherError(f"{source}: {error}") from error
