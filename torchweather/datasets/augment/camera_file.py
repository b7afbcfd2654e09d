"""A camera's image in a frame: its intrinsics, its depth, and the image in weather."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar

import torch
from torch import Tensor

from torchweather.camera.depth import AUTO, CompletedDepth, DepthSource, SceneDepth
from torchweather.camera.sensor import Camera
from torchweather.compose.transform_spec import TransformSpec
from torchweather.core.errors import InputValueError, TorchweatherError, TorchweatherWarning
from torchweather.core.file_names import stem
from torchweather.datasets import read_kitti_calibration
from torchweather.datasets.augment.frame_file import FrameFile
from torchweather.datasets.augment.frame_recipe import SensorUse
from torchweather.datasets.augment.frames import FROM_LIDAR
from torchweather.datasets.depth_sources import GROUND, depth_source
from torchweather.datasets.kitti import kitti_camera_matrix
from torchweather.io import IMAGE_SUFFIXES, read_image, read_points, write_image

__all__ = ["CameraFile"]


@dataclass(frozen=True, kw_only=True)
class CameraUse(SensorUse):
    """The camera of one image.

    Args:
        camera: with the size and the intrinsics of the image.
        rgb: true for a colour image.
    """

    camera: Camera
    rgb: bool

    def changed(self, spec: TransformSpec[Any]) -> TransformSpec[Any]:
        """The spec for this camera, of mosaics or of colour images."""
        return replace(spec, sensor=self.camera, rgb=self.rgb, through_mosaic=spec.through_mosaic and self.rgb)


class CameraFile(FrameFile):
    """An image, raw or RGB."""

    kind: ClassVar[str] = "camera"
    suffixes: ClassVar[tuple[str, ...]] = IMAGE_SUFFIXES
    takes_depth: ClassVar[bool] = True
    spec: TransformSpec[Camera]
    use: CameraUse

    def _read(self, path: Path) -> None:
        self.data, info = read_image(path)
        self.info = info
        if info.note:
            warnings.warn(info.note, TorchweatherWarning, stacklevel=2)
        if self.data.ndim != 3:
            raise InputValueError(f"{path}: expected one image a file; got {tuple(self.data.shape)}.")
        camera, rgb = self._camera(), info.kind == "rgb"
        height, width = self.data.shape[-2:]
        source = self._depth_source(path, rgb)
        self._source, self._size = source, (height, width)
        self.use = CameraUse(kind=self.kind, depth=source is not None, camera=camera, rgb=rgb)

    def _camera(self) -> Camera:
        """The recipe's camera with the intrinsics of the data set, or scaled to the size of the image."""
        height, width = self.data.shape[-2:]
        camera = self.spec.sensor
        matrix: Any = self.file.camera_matrix
        if matrix is None and self.frame.calibration is not None:
            matrix = kitti_camera_matrix(self.paths.source(self.frame.calibration)).tolist()
        if matrix is not None:
            fx, fy, cx, cy = matrix[0][0], matrix[1][1], matrix[0][2], matrix[1][2]
            return replace(camera, width=width, height=height, fx=fx, fy=fy, cx=cx, cy=cy)
        return camera if (camera.height, camera.width) == (height, width) else camera.fitted_to(width, height)

    def _depth_source(self, path: Path, rgb: bool) -> DepthSource | None:
        """Depth of the image; ``None`` leaves it to the recipe's own source."""
        file, chosen = self.file, self.job.depth
        if file.depth_cloud is not None:
            cloud = read_points(self.paths.source(file.depth_cloud), intensity="none", **self._columns()).points
            from_lidar: Any = file.camera_from_lidar
            if from_lidar is None:
                if self.frame.calibration is None:
                    raise TorchweatherError(
                        f"{path}: depth from the LiDAR needs its calibration: calib/{stem(file.path)[0]}.txt, "
                        "calib.txt of the sequence (odometry), calib/SEQUENCE.txt (tracking) or "
                        "calib_cam_to_cam.txt of the day (raw); there is none. Or give --depth."
                    )
                calibration = read_kitti_calibration(self.paths.source(self.frame.calibration))
                from_lidar = calibration.T_camera_from_lidar
                if calibration.assumption:
                    warnings.warn(
                        f"the calibration lacks the LiDAR's place; assumed: {calibration.assumption}",
                        TorchweatherWarning,
                        stacklevel=2,
                    )
            return CompletedDepth(cloud, torch.as_tensor(from_lidar, dtype=torch.float64))
        if chosen == FROM_LIDAR:
            raise TorchweatherError(f"{path}: there is no cloud of its number, for --depth lidar.")
        if chosen is None:
            if self.spec.options.get("depth") is not None:
                return None
            chosen = AUTO if rgb else GROUND
        job = self.job
        return depth_source(chosen, job.depth_encoding, path, along=job.depth_along, baseline_m=job.baseline_m)

    def _columns(self) -> dict[str, Any]:
        """Columns of the clouds, where they are stated."""
        how = self.job.reading
        return {"bin_columns": how.bin_columns, "bin_dtype": how.bin_dtype}

    def depths(self) -> Iterator[tuple[str, SceneDepth]]:
        """The depth of the image where it is not left to the recipe: triangulated, or guessed from the picture."""
        if self._source is not None:
            scene = self._source.scene(self.use.camera, *self._size, image=self.data)
            yield f"{self.file.key} depth", scene.to(dtype=torch.float32)

    def save(self, data: Tensor) -> None:
        """Write an image."""
        write_image(self.paths.new(self.file.target), data, like=self.info, png_level=self.job.png_level)

    def note(self, result: Any) -> str:
        """Certainty of the depth."""
        return f"depth {result.depth_confidence}"
