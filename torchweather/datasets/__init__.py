"""Data sets: KITTI, nuScenes, REHEARSE, CARLA, adapters of frameworks; boxes and calibrations; whole folders."""

from __future__ import annotations

from torchweather.datasets.adapters import HuggingFaceAdapter, Mmdet3dAdapter, OpenPcdetAdapter
from torchweather.datasets.box_projection import project_boxes
from torchweather.datasets.box_update import update_boxes
from torchweather.datasets.box_visibility import BoxVisibility, box_visibility
from torchweather.datasets.boxes import Boxes, points_in_boxes
from torchweather.datasets.calibration import CameraLidarCalibration
from torchweather.datasets.camera_files import read_camera, read_camera_fields
from torchweather.datasets.carla import (
    camera_from_carla,
    depth_from_carla,
    depth_to_carla,
    detections_from_carla,
    detections_to_carla,
    image_from_carla,
    image_to_carla,
    points_from_carla,
    points_to_carla,
    pose_from_carla,
)
from torchweather.datasets.carla_rig import CARLA_SENSORS, CarlaRig
from torchweather.datasets.kitti import read_kitti_calibration, read_kitti_points, read_kitti_rectified_from_lidar
from torchweather.datasets.kitti_boxes import read_kitti_boxes, write_kitti_boxes
from torchweather.datasets.nuscenes import read_nuscenes_calibration, read_nuscenes_points
from torchweather.datasets.nuscenes_boxes import (
    boxes_from_nuscenes,
    boxes_to_nuscenes,
    read_nuscenes_boxes,
    write_nuscenes_boxes,
)
from torchweather.datasets.rehearse import REHEARSE_FOLDERS, RehearseSequence, read_rehearse

__all__ = [
    "BoxVisibility",
    "Boxes",
    "CARLA_SENSORS",
    "CameraLidarCalibration",
    "CarlaRig",
    "HuggingFaceAdapter",
    "Mmdet3dAdapter",
    "OpenPcdetAdapter",
    "REHEARSE_FOLDERS",
    "RehearseSequence",
    "box_visibility",
    "boxes_from_nuscenes",
    "boxes_to_nuscenes",
    "camera_from_carla",
    "depth_from_carla",
    "depth_to_carla",
    "detections_from_carla",
    "detections_to_carla",
    "image_from_carla",
    "image_to_carla",
    "points_from_carla",
    "points_in_boxes",
    "points_to_carla",
    "pose_from_carla",
    "project_boxes",
    "read_camera",
    "read_camera_fields",
    "read_kitti_boxes",
    "read_kitti_calibration",
    "read_kitti_points",
    "read_kitti_rectified_from_lidar",
    "read_nuscenes_boxes",
    "read_nuscenes_calibration",
    "read_nuscenes_points",
    "read_rehearse",
    "update_boxes",
    "write_kitti_boxes",
    "write_nuscenes_boxes",
]
