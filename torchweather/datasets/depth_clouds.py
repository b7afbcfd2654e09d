"""LiDAR clouds with a calibration as the depth of frames: which file belongs to a frame, and how it is completed."""

from __future__ import annotations

import dataclasses
import re
from pathlib import Path

import torch
from torch import Tensor

from torchweather.camera.depth import CompletedDepth, SceneDepth
from torchweather.camera.sensor import Camera
from torchweather.core.errors import InputValueError, TorchweatherError
from torchweather.core.file_names import is_hidden
from torchweather.datasets.calibration import CameraLidarCalibration
from torchweather.datasets.kitti import read_kitti_calibration
from torchweather.datasets.nuscenes import read_nuscenes_calibration
from torchweather.io.points import POINT_SUFFIXES, read_points

__all__ = ["CalibratedCloud", "calibration_file", "cloud_file", "cloud_source", "frame_camera_name", "is_cloud"]

# Only a cloud ends so; .npz may be a depth map as well.
_CLOUDS_ALONE = tuple(suffix for suffix in POINT_SUFFIXES if suffix != ".npz")
_CALIBRATIONS = (".txt", ".json")
# nuScenes names files LOG__SENSOR__MICROSECONDS; its LiDAR turns 20 times a second.
_NUSCENES = re.compile(r"(?P<log>.+?)__(?P<sensor>[A-Z][A-Z_]*)__(?P<stamp>\d+)$")
_SAME_MOMENT_US = 50_000
_SEQUENCE = re.compile(r"\d{4}")  # of KITTI's tracking kit
_OF_A_SEQUENCE = ["calib", "calib_cam_to_cam"]  # of KITTI's odometry kit; of the raw kit


def is_cloud(path: Path, *, calibrated: bool) -> bool:
    """Tell whether a file is a cloud by its name; ``.npz`` is one where a calibration was given."""
    name = path.name.lower()
    return name.endswith(_CLOUDS_ALONE) or (calibrated and name.endswith(".npz"))


def cloud_file(folder: Path, frame: Path, *, calibrated: bool = True) -> Path | None:
    """The cloud of a frame in a folder: of the same name, or of the same moment in nuScenes' names; else ``None``."""
    suffixes = POINT_SUFFIXES if calibrated else _CLOUDS_ALONE
    for suffix in suffixes:
        found = folder / (frame.stem + suffix)
        if found.is_file():
            return found
    taken = _NUSCENES.match(frame.stem)
    if taken is None:
        return None
    near: list[tuple[int, Path]] = []
    for path in sorted(path for path in folder.glob(f"*{taken['log']}__*") if not is_hidden(path)):
        ending = next((one for one in suffixes if path.name.endswith(one)), "")
        named = _NUSCENES.match(path.name.removesuffix(ending)) if ending else None
        if named and named["log"] == taken["log"] and "LIDAR" in named["sensor"]:
            near.append((abs(int(named["stamp"]) - int(taken["stamp"])), path))
    away_us, path = min(near, default=(_SAME_MOMENT_US + 1, frame))
    return path if away_us <= _SAME_MOMENT_US else None


def calibration_file(calibration: Path, frame: Path) -> Path:
    """The calibration of a frame.

    Args:
        calibration: a file, or a folder with one of the frame's name (KITTI's objects), of its folder's name (KITTI's
            tracking), of its log's name followed by ``_calib`` (nuScenes), with ``calib.txt`` (KITTI's odometry) or
            ``calib_cam_to_cam.txt`` (raw), or with a single file that has not the number of another frame.
        frame: path of the image.
    """
    if calibration.is_file():
        return calibration
    if not calibration.is_dir():
        raise InputValueError(f"--calib must be a file or a folder; got {str(calibration)!r}, which does not exist.")
    stems = [frame.stem]
    taken = _NUSCENES.match(frame.stem)
    stems += [taken["log"], f"{taken['log']}_calib"] if taken else []
    stems += [frame.parent.name] if _SEQUENCE.fullmatch(frame.parent.name) else []
    stems += _OF_A_SEQUENCE
    for stem in stems:
        for suffix in _CALIBRATIONS:
            found = calibration / (stem + suffix)
            if found.is_file():
                return found
    inside = [path for path in calibration.iterdir() if not is_hidden(path)]
    alone = [path for path in inside if path.suffix.lower() in _CALIBRATIONS]
    if len(alone) == 1:
        numbered = alone[0].stem.isdecimal() and frame.stem.isdecimal() and len(alone[0].stem) == len(frame.stem)
        if not numbered:
            return alone[0]
    raise InputValueError(
        f"{calibration}: no calibration for {frame.name}; expected {frame.stem} with {' or '.join(_CALIBRATIONS)}, or "
        "a single file for all frames."
    )


def frame_camera_name(frame: Path) -> str | None:
    """The camera that a frame's name in nuScenes' way tells, such as ``CAM_BACK``; else ``None``."""
    taken = _NUSCENES.match(frame.stem)
    return taken["sensor"] if taken and taken["sensor"].startswith("CAM") else None


def cloud_source(cloud: Path, calibration: Path | None, frame: Path, *, name: str | None = None) -> CalibratedCloud:
    """The depth of a frame from a cloud and its calibration.

    Args:
        cloud: as of `read_points`.
        calibration: a file or folder as of `calibration_file`.
        frame: path of the image.
        name: of the camera where a nuScenes file holds several. Default: as the frame's name says, else ``CAM_FRONT``.
    """
    if calibration is None:
        raise InputValueError(
            f"{cloud} is a cloud of points: give the way from the LiDAR to the camera, --calib FILE or DIR (KITTI's "
            "object calibration, nuScenes' json)."
        )
    read = _calibration(calibration_file(calibration, frame), frame, name)
    points = read_points(cloud, intensity="none").points
    return CalibratedCloud(points, read.T_camera_from_lidar, assumption=read.assumption)


def _calibration(path: Path, frame: Path, name: str | None) -> CameraLidarCalibration:
    if path.suffix.lower() == ".json":
        return read_nuscenes_calibration(path, name or frame_camera_name(frame) or "CAM_FRONT")
    if name not in (None, "P2", "P_rect_02", "image_02", "image_2"):
        raise TorchweatherError(
            f"{path}: the depth of a KITTI cloud is that of camera 2 (P2); got the camera {name!r}. Leave "
            "--camera-name out, or give depth maps of that camera."
        )
    return read_kitti_calibration(path)


@dataclasses.dataclass(frozen=True, eq=False)
class CalibratedCloud(CompletedDepth):
    """`CompletedDepth` whose notes tell what the calibration had to assume.

    Args:
        points_xyz: as of `CompletedDepth`.
        T_camera_from_lidar: as of `CompletedDepth`.
        sky: as of `CompletedDepth`.
        upper_edge_rad: as of `CompletedDepth`.
        assumption: in words, empty for none.
    """

    assumption: str = ""

    def scene(
        self,
        camera: Camera,
        height: int,
        width: int,
        *,
        device: torch.device | str | None = None,
        dtype: torch.dtype = torch.float32,
        image: Tensor | None = None,
    ) -> SceneDepth:
        """As of `CompletedDepth`, with one note more."""
        scene = super().scene(camera, height, width, device=device, dtype=dtype, image=image)
        if not self.assumption:
            return scene
        note = f"The calibration lacks the LiDAR's place; assumed: {self.assumption}"
        return dataclasses.replace(scene, notes=(*scene.notes, note))
