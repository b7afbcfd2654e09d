"""Frames of a data set: which files belong together, and what is known of them before they are read."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

__all__ = ["COPY", "FROM_LIDAR", "DataSet", "Frame", "SensorFile"]

COPY = "copy"
FROM_LIDAR = "lidar"  # source of a camera's depth: the cloud of its frame


@dataclass(frozen=True)
class SensorFile:
    """One file of a frame.

    Args:
        key: name of the sensor in its frame, such as ``image``; its particles are drawn under this name.
        kind: ``camera``, ``lidar``, ``radar``, or ``copy`` for what is carried along as it is.
        path: below the root of the data set, with ``/``.
        target: below the root of the result; the same path unless another format was asked for.
        labels: of a cloud, paths of the files that label its points.
        camera_matrix: ``(3, 3)`` in pixels, where the data set's tables have it.
        camera_from_lidar: ``(4, 4)`` into this camera from the cloud that gives its depth.
        depth_cloud: path of that cloud.
    """

    key: str
    kind: str
    path: str
    target: str
    labels: tuple[str, ...] = ()
    camera_matrix: tuple[tuple[float, ...], ...] | None = None
    camera_from_lidar: tuple[tuple[float, ...], ...] | None = None
    depth_cloud: str | None = None


@dataclass(frozen=True)
class Frame:
    """Unit that gets one weather, is recorded in one row, and is done whole or not at all.

    Args:
        name: in the manifest.
        files: of its sensors.
        seed_name: what its seed is made of; frames of one sample share it.
        calibration: path of a KITTI calibration.
        boxes: path of a KITTI label file, whose boxes are looked for in the cloud.
        box_frame: number of the frame in a label file of the tracking kit, which has a whole sequence.
        beside_calibration: the second calibration file of the raw kit.
        annotations: of nuScenes, boxes of the cloud ``lidar_key``, in the global frame.
        lidar_from_global: ``(4, 4)`` for them.
        lidar_key: of the cloud that the boxes are counted in.
    """

    name: str
    files: tuple[SensorFile, ...]
    seed_name: str
    calibration: str | None = None
    boxes: str | None = None
    annotations: tuple[Mapping[str, Any], ...] = field(default=(), repr=False)
    lidar_from_global: tuple[tuple[float, ...], ...] | None = None
    lidar_key: str | None = None
    box_frame: int | None = None
    beside_calibration: str | None = None

    @property
    def reads(self) -> tuple[str, ...]:
        """Paths of all files that the result depends on, in order, each once."""
        found = [one.path for one in self.files]
        for one in self.files:
            found += [*one.labels, *((one.depth_cloud,) if one.depth_cloud is not None else ())]
        found += [path for path in (self.calibration, self.beside_calibration, self.boxes) if path]
        return tuple(dict.fromkeys(found))

    @property
    def is_copy(self) -> bool:
        """True where nothing of it sees any weather."""
        return all(one.kind == COPY for one in self.files)


@dataclass(frozen=True)
class DataSet:
    """All frames of a folder.

    Args:
        layout: ``folder``, ``kitti`` or ``nuscenes``.
        frames: by name; those with a sensor before those that are only copied.
        found: number of files by kind of sensor, also of kinds that the recipe is not for.
        annotation_tables: paths of nuScenes' ``sample_annotation.json``, whose point counts are brought up to date.
        left_out: paths that are not even carried along: hidden ones, pipes, sockets.
        clear: folder to the number of a sensor's files in it that are carried along in clear air.
        notes: what a reader must know of them.
    """

    layout: str
    frames: tuple[Frame, ...]
    found: Mapping[str, int]
    annotation_tables: tuple[str, ...] = ()
    left_out: tuple[str, ...] = ()
    clear: Mapping[str, int] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
