"""Pose of a data set's camera and LiDAR to each other."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from torch import Tensor

from torchweather.camera.sensor import Camera
from torchweather.core.arguments import check_arguments
from torchweather.core.errors import InputValueError, check_finite

__all__ = ["CameraLidarCalibration"]


@dataclass(frozen=True, eq=False)
class CameraLidarCalibration:
    """Intrinsics of a rectified camera and the way from the LiDAR's frame into the camera's.

    Args:
        camera_matrix: ``(3, 3)``, pixels.
        T_camera_from_lidar: ``(4, 4)``, float64, metres; into x right, y down, z along the axis.
        assumption: what was not in the file and had to be assumed, in words; empty where all of it was measured.
    """

    camera_matrix: Tensor
    T_camera_from_lidar: Tensor
    assumption: str = ""

    def __post_init__(self) -> None:
        check_arguments(
            "CameraLidarCalibration(camera_matrix: real, T_camera_from_lidar: real, assumption: str)",
            self.camera_matrix,
            self.T_camera_from_lidar,
            self.assumption,
        )
        for name, shape in (("camera_matrix", (3, 3)), ("T_camera_from_lidar", (4, 4))):
            value = getattr(self, name)
            if not isinstance(value, Tensor) or tuple(value.shape) != shape or not value.is_floating_point():
                got = f"{tuple(value.shape)} {value.dtype}" if isinstance(value, Tensor) else repr(value)
                raise InputValueError(
                    f"CameraLidarCalibration: {name} must be a floating-point tensor {shape}; got {got}."
                )
            check_finite(name, value, owner=self)

    def camera(self, width: int, height: int, **more: Any) -> Camera:
        """The camera for images of this size; every other field of `Camera` by keyword."""
        k = self.camera_matrix
        return Camera.from_intrinsics(
            float(k[0, 0]), float(k[1, 1]), float(k[0, 2]), float(k[1, 2]), width, height, **more
        )
