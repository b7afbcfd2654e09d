"""Kinds of sensors in a data set, each with the class that reads and writes its files."""

from __future__ import annotations

from torchweather.datasets.augment.camera_file import CameraFile
from torchweather.datasets.augment.frame_file import FrameFile
from torchweather.datasets.augment.lidar_file import LidarFile
from torchweather.datasets.augment.radar_file import RadarFile

__all__ = ["FRAME_FILES"]

FRAME_FILES: dict[str, type[FrameFile]] = {one.kind: one for one in (CameraFile, LidarFile, RadarFile)}
"""By the kind of sensor; a file that may be of several is taken for the first."""
