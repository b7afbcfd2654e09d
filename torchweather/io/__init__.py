"""Readers and writers: images, depth maps, KITTI and nuScenes clouds, disdrometers."""

from __future__ import annotations

from torchweather.io.atomic import atomic_write
from torchweather.io.calibration import CameraLidarCalibration
from torchweather.io.depth import DEPTH_ENCODINGS, read_depth
from torchweather.io.disdrometer import read_disdrometer
from torchweather.io.drop_spectrum import DropSpectrum, spectrum_from_counts, spectrum_from_drops
from torchweather.io.images import IMAGE_SUFFIXES, ImageInfo, read_image, write_image
from torchweather.io.kitti import read_kitti_calibration, read_kitti_points
from torchweather.io.nuscenes import read_nuscenes_calibration, read_nuscenes_points
from torchweather.io.parsivel import parsivel_area_mm2, parsivel_edges_mm, parsivel_speeds_m_per_s

__all__ = [
    "DEPTH_ENCODINGS",
    "IMAGE_SUFFIXES",
    "CameraLidarCalibration",
    "DropSpectrum",
    "ImageInfo",
    "atomic_write",
    "parsivel_area_mm2",
    "parsivel_edges_mm",
    "parsivel_speeds_m_per_s",
    "read_depth",
    "read_disdrometer",
    "read_image",
    "read_kitti_calibration",
    "read_kitti_points",
    "read_nuscenes_calibration",
    "read_nuscenes_points",
    "spectrum_from_counts",
    "spectrum_from_drops",
    "write_image",
]
