"""KITTI's layouts: object, tracking, odometry with SemanticKITTI, and raw; files of a frame by their number.

=========  =======================================================  ==============================================
kit        a frame                                                  calibration, boxes
=========  =======================================================  ==============================================
object     ``image_2/000000.png``, ``velodyne/000000.bin``          ``calib/000000.txt``, ``label_2/000000.txt``
odometry   the same below ``sequences/00``, ``labels/*.label``      ``calib.txt`` of the sequence
tracking   ``image_02/0000/000000.png``, ``velodyne/0000/*.bin``    ``calib/0000.txt``, ``label_02/0000.txt``
raw        ``DRIVE/image_02/data``, ``DRIVE/velodyne_points/data``  ``calib_cam_to_cam.txt``, ``_velo_`` of the day
=========  =======================================================  ==============================================
"""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field

from torchweather.datasets.augment.folder import name_without_ending
from torchweather.datasets.augment.frame_files import FRAME_FILES
from torchweather.datasets.augment.frames import Frame, SensorFile
from torchweather.datasets.kitti import RAW_CALIBRATIONS

__all__ = ["is_kitti", "kitti_frames", "other_cameras"]

# Camera 2 is the left colour camera, for which the calibration is read; that of camera 3 stands beside it.
CAMERA, LIDAR, CALIBRATION, BOXES, LABELS = "image_2", "velodyne", "calib", "label_2", "labels"
SENSORS = {CAMERA: "camera", LIDAR: "lidar"}
SUFFIXES = {role: FRAME_FILES[kind].suffixes for role, kind in SENSORS.items()}
SUFFIXES |= {CALIBRATION: (".txt",), BOXES: (".txt",), LABELS: (".label",)}
OTHER_CAMERAS = ("image_0", "image_1", "image_3", "image_00", "image_01", "image_03")
ROLES = {"image_02": CAMERA, "velodyne_points": LIDAR}
"""Folders of the other kits, by the name that the object kit has for them."""
# A place has the folder's name, the sequence of the tracking kit, and the file's name.
PLACE = re.compile(rf"^(?P<split>(?:.*/)?)(?P<folder>{'|'.join(SUFFIXES)})/(?P<name>[^/]+)$")
TRACKING = re.compile(
    rf"^(?P<split>(?:.*/)?)(?P<folder>{CAMERA}|image_02|{LIDAR}|{LABELS})/(?P<sequence>\d{{4}})/(?P<name>[^/]+)$"
)
RAW = re.compile(r"^(?P<split>(?:.*/)?)(?P<folder>image_02|velodyne_points)/data/(?P<name>[^/]+)$")


@dataclass
class _Group:
    """Files of one number.

    Args:
        split: folder that the sensors' folders are in, with ``/``.
        sequence: of the tracking kit; empty of the others.
        raw: whether it is the raw kit's.
        there: role to path.
    """

    split: str
    sequence: str
    raw: bool
    there: dict[str, str] = field(default_factory=dict)

    def calibration(self, paths: Collection[str]) -> str | None:
        """The path of the calibration: of the frame, the sequence, or the day."""
        if self.raw:
            day = self.split[: self.split[:-1].rfind("/") + 1]
            found = [f"{folder}{RAW_CALIBRATIONS[0]}" for folder in (self.split, day)]
        elif self.sequence:
            found = [f"{self.split}{CALIBRATION}/{self.sequence}.txt"]
        else:
            found = [self.there.get(CALIBRATION, ""), f"{self.split}calib.txt"]
        return next((path for path in found if path in paths), None)

    def boxes(self, paths: Collection[str]) -> str | None:
        """The path of the labels of its boxes."""
        if self.sequence:
            found = [f"{self.split}{folder}/{self.sequence}.txt" for folder in ("label_02", BOXES)]
            return next((path for path in found if path in paths), None)
        return self.there.get(BOXES)


def is_kitti(paths: Sequence[str]) -> bool:
    """Check whether there are images or clouds in KITTI's folders."""
    return any(_placed(path) is not None for path in paths)


def kitti_frames(paths: Sequence[str], keys: Mapping[str, str], *, depth_from_lidar: bool) -> list[Frame]:
    """Frames of KITTI's layouts, each of one number: its image and its cloud, with one weather.

    Args:
        paths: of all files.
        keys: kind of sensor to its name in the recipe.
        depth_from_lidar: whether the camera's depth is that of the projected cloud.
    """
    grouped: dict[str, _Group] = {}
    everything = set(paths)
    others: dict[str, dict[str, str]] = defaultdict(dict)  # calibrations, boxes and labels that stand by number
    for path in paths:
        place = _placed(path)
        if place is not None:
            name, role, group = place
            grouped.setdefault(name, group).there[role] = path
            continue
        beside = PLACE.match(path)
        if beside and path.lower().endswith(SUFFIXES[beside["folder"]]):
            others[beside["split"] + name_without_ending(beside["name"])][beside["folder"]] = path
        labels = TRACKING.match(path)
        if labels and labels["folder"] == LABELS and path.lower().endswith(SUFFIXES[LABELS]):
            name = f"{labels['split']}{labels['sequence']}/{name_without_ending(labels['name'])}"
            others[name][LABELS] = path
    frames = []
    for name, group in sorted(grouped.items()):
        group.there |= {role: path for role, path in others[name].items() if role not in group.there}
        frame = _frame(name, group, everything, keys, depth_from_lidar=depth_from_lidar)
        if frame is not None:
            frames.append(frame)
    return frames


def _placed(path: str) -> tuple[str, str, _Group] | None:
    """Name of the frame, role and group of a sensor's file; ``None`` of any other."""
    for pattern in (RAW, TRACKING, PLACE):
        place = pattern.match(path)
        if place is None:
            continue
        role = ROLES.get(place["folder"], place["folder"])
        if role in SENSORS and path.lower().endswith(SUFFIXES[role]):
            sequence = place["sequence"] if pattern is TRACKING else ""
            below = f"{sequence}/" if sequence else ""
            name = f"{place['split']}{below}{name_without_ending(place['name'])}"
            return name, role, _Group(place["split"], sequence, pattern is RAW)
    return None


def _frame(
    name: str, group: _Group, paths: Collection[str], keys: Mapping[str, str], *, depth_from_lidar: bool
) -> Frame | None:
    """The frame of a number; ``None`` where it has no sensor that the recipe is for."""
    files = []
    for role, kind in SENSORS.items():
        if role in group.there and kind in keys:
            sensor, path = FRAME_FILES[kind], group.there[role]
            labels = (group.there[LABELS],) if sensor.takes_labels and LABELS in group.there else ()
            cloud = group.there.get(LIDAR) if sensor.takes_depth and depth_from_lidar else None
            files.append(SensorFile(keys[kind], kind, path, path, labels, depth_cloud=cloud))
    if not files:
        return None
    lidar_key = keys.get(SENSORS[LIDAR]) if LIDAR in group.there else None
    boxes = None if lidar_key is None else group.boxes(paths)
    needs = boxes is not None or any(FRAME_FILES[one.kind].takes_depth for one in files)
    calibration = group.calibration(paths) if needs else None
    number = name.rpartition("/")[2]
    return Frame(
        name,
        tuple(files),
        name,
        calibration,
        boxes,
        lidar_key=lidar_key,
        box_frame=int(number) if group.sequence and boxes is not None and number.isdecimal() else None,
        beside_calibration=_beside(calibration, paths),
    )


def _beside(calibration: str | None, paths: Collection[str]) -> str | None:
    """The second calibration file of the raw kit."""
    if calibration is None or not calibration.endswith(RAW_CALIBRATIONS[0]):
        return None
    other = calibration[: -len(RAW_CALIBRATIONS[0])] + RAW_CALIBRATIONS[1]
    return other if other in paths else None


def other_cameras(clear: Mapping[str, int], keys: Mapping[str, str]) -> tuple[str, ...]:
    """Notes on folders of KITTI's other cameras, which stay clear beside an ``image_2`` in weather.

    Args:
        clear: folder to the number of its files that are carried along in clear air.
        keys: kind of sensor to its name in the recipe.
    """
    if SENSORS[CAMERA] not in keys:
        return ()
    return tuple(
        f"{folder}: {number} images of another camera stay in clear air beside {CAMERA} in weather. A stereo pair of "
        "them does not show one storm; leave the folder out, or use one camera."
        for folder, number in clear.items()
        if set(folder.split("/")) & set(OTHER_CAMERAS)
    )
