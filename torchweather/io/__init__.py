"""Readers and writers: images, depth maps, KITTI and nuScenes clouds, disdrometers."""

from __future__ import annotations

from torchweather.io.atomic import atomic_write
from torchweather.io.calibration import CameraLidarCalibration
from torchweather.io.depth import DEPTH_ENCODINGS, read_depth
from torchweather.io.images import IMAGE_SUFFIXES, ImageInfo, read_image, write_image
from torchweather.io.kitti import read_kitti_calibration, read_kitti_points
from torchweather.io.nuscenes import read_nuscenes_calibration, read_nuscenes_points

__all__ = [
    "DEPTH_ENCODINGS",
    "IMAGE_SUFFIXES",
    "CameraLidarCalibration",
    "ImageInfo",
    "atomic_write",
    "read_depth",
    "read_image",
    "read_kitti_calibration",
    "read_kitti_points",
    "read_nuscenes_calibration",
    "read_nuscenes_points",
    "write_image",
]
