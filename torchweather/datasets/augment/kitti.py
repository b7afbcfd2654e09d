"""KITTI's object layout: image_2, velodyne, calib and label_2 below training or testing, files of a frame by number."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Mapping, Sequence

from torchweather.datasets.augment.folder import name_without_ending
from torchweather.datasets.augment.frame_files import FRAME_FILES
from torchweather.datasets.augment.frames import Frame, SensorFile

__all__ = ["is_kitti", "kitti_frames"]

# Camera 2 is the left colour camera, for which the calibration is read; that of camera 3 stands beside it.
CAMERA, LIDAR, CALIBRATION, BOXES, LABELS = "image_2", "velodyne", "calib", "label_2", "labels"
FOLDERS = {CAMERA: "camera", LIDAR: "lidar", CALIBRATION: "", BOXES: "", LABELS: ""}
SUFFIXES = {folder: FRAME_FILES[kind].suffixes for folder, kind in FOLDERS.items() if kind}
SUFFIXES |= {CALIBRATION: (".txt",), BOXES: (".txt",)}
PLACE = re.compile(rf"^(?P<split>(?:.*/)?)(?P<folder>{'|'.join(FOLDERS)})/(?P<name>[^/]+)$")


def is_kitti(paths: Sequence[str]) -> bool:
    """Whether there are images or clouds in KITTI's folders."""
    return any(re.search(rf"(^|/)({CAMERA}|{LIDAR})/[^/]+$", path) for path in paths)


def kitti_frames(paths: Sequence[str], keys: Mapping[str, str], *, depth_from_lidar: bool) -> list[Frame]:
    """Frames of KITTI's layout, each of one number: its image and its cloud, with one weather.

    Args:
        paths: of all files.
        keys: kind of sensor to its name in the recipe.
        depth_from_lidar: whether the camera's depth is that of the projected cloud.
    """
    grouped: dict[str, dict[str, str]] = defaultdict(dict)
    for path in paths:
        place = PLACE.match(path)
        if place and path.lower().endswith(SUFFIXES.get(place["folder"], (".label",))):
            grouped[place["split"] + name_without_ending(place["name"])][place["folder"]] = path
    frames = []
    for name, there in sorted(grouped.items()):
        files = []
        for folder in (CAMERA, LIDAR):
            kind = FOLDERS[folder]
            if folder in there and kind in keys:
                sensor = FRAME_FILES[kind]
                labels = (there[LABELS],) if sensor.takes_labels and LABELS in there else ()
                cloud = there.get(LIDAR) if sensor.takes_depth and depth_from_lidar else None
                files.append(SensorFile(keys[kind], kind, there[folder], there[folder], labels, depth_cloud=cloud))
        if not files:
            continue
        lidar_key = keys.get(FOLDERS[LIDAR]) if LIDAR in there else None
        boxes = None if lidar_key is None else there.get(BOXES)
        needs = boxes is not None or any(FRAME_FILES[one.kind].takes_depth for one in files)
        calibration = there.get(CALIBRATION) if needs else None
        frames.append(Frame(name, tuple(files), name, calibration, boxes, lidar_key=lidar_key))
    return frames
