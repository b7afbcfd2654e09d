"""A LiDAR's cloud in a frame: its labels, second returns, own vehicle, and the boxes that are counted in it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, ClassVar

import torch
from torch import Tensor

from torchweather.compose.transform_spec import TransformSpec
from torchweather.core.file_names import stem
from torchweather.datasets import (
    BoxVisibility,
    box_visibility,
    boxes_from_nuscenes,
    read_kitti_boxes,
    read_kitti_rectified_from_lidar,
)
from torchweather.datasets.augment.frame_file import FrameFile
from torchweather.datasets.augment.frame_recipe import SensorUse
from torchweather.datasets.augment.frames import Frame
from torchweather.datasets.augment.job import Job
from torchweather.datasets.augment.own_vehicle import drive_masks, drive_of, masks_from_text, masks_to_text
from torchweather.io import (
    POINT_SUFFIXES,
    PointCloud,
    label_columns,
    label_format,
    merge_kind,
    read_labels,
    read_sensor_points,
    with_labels_of,
    write_labels,
    write_points,
)
from torchweather.lidar import OwnVehicleMask
from torchweather.lidar.sensor import Lidar
from torchweather.pipeline.point_kind import PointKind

__all__ = ["LidarFile"]

COUNTED = "sweep of"  # a note that counts, and warns of nothing
MASKS = "own_vehicle_masks"  # key of the run's settings


@dataclass(frozen=True, kw_only=True)
class LidarUse(SensorUse):
    """The LiDAR of one sweep.

    Args:
        drive: that the sweep belongs to, where there is a mask of it.
        own_vehicle: that mask.
    """

    drive: str = ""
    own_vehicle: OwnVehicleMask | None = field(default=None, repr=False, compare=False)

    def changed(self, spec: TransformSpec[Any]) -> TransformSpec[Any]:
        """The spec with the mask of the drive."""
        if self.own_vehicle is None:
            return spec
        return replace(spec, options={**spec.options, "own_vehicle": self.own_vehicle})


class LidarFile(FrameFile):
    """A point cloud."""

    kind: ClassVar[str] = "lidar"
    suffixes: ClassVar[tuple[str, ...]] = tuple(POINT_SUFFIXES)
    takes_labels: ClassVar[bool] = True
    spec: TransformSpec[Lidar]

    @classmethod
    def prepared(
        cls,
        job: Job,
        frames: Sequence[Frame],
        spec: TransformSpec[Lidar],
        settings: dict[str, str],
        before: Mapping[str, str],
    ) -> Job:
        """The job with a mask of the own vehicle for each drive; a run that goes on takes the masks it began with."""
        masks = masks_from_text(before.get(MASKS, ""))
        if not before:
            sweeps = [file.path for frame in frames for file in frame.files if file.kind == cls.kind]
            masks = drive_masks(
                settings["own_vehicle"] or None,
                sweeps,
                Path(job.source),
                spec,
                job.reading,
                follow_links=job.follow_links,
            )
        settings[MASKS] = masks_to_text(masks)
        return replace(job, own_vehicle=masks)

    def _read(self, path: Path) -> None:
        self.cloud = read_sensor_points(path, self.spec.sensor, self.job.reading)
        self.data = self.cloud.points
        drive = drive_of(self.file.path)
        mask = self.job.own_vehicle.get(drive)
        self.use = LidarUse(kind=self.kind, drive="" if mask is None else drive, own_vehicle=mask)

    def save(self, data: Tensor) -> None:
        """Write a cloud."""
        write_points(self.paths.new(self.file.target), self.cloud.with_points(data))

    def write(self, result: Any) -> None:
        """Write the cloud and its labels, and those of second returns beside them."""
        target, labels = self.file.target, self.file.labels
        seconds = isinstance(result.second, Tensor)
        name, ending = stem(target)
        for path in labels:
            particle_class, form = label_format(path).particle_class, label_format(path).ending
            before = read_labels(self.paths.source(path), len(self.data))
            merged = merge_kind(before, result.kind, result.source, particle_class=particle_class)
            write_labels(self.paths.new(path), merged)
            if seconds:
                merged = merge_kind(before, result.second_kind, result.second_source, particle_class=particle_class)
                write_labels(self.paths.new(f"{path[: len(path) - len(form)]}_second{form}"), merged)
        if seconds:
            other = target[: len(target) - len(name) - len(ending)] + f"{name}_second{ending}"
            write_points(self.paths.new(other), outgoing(self.cloud, result.second, result.second_kind))
        write_points(self.paths.new(target), outgoing(self.cloud, result.points, result.kind))

    def write_clear(self) -> None:
        """Write cloud and labels as they are."""
        for path in self.file.labels:
            self.paths.copy(path, path)
        super().write_clear()

    def note(self, result: Any) -> str:
        """Note on the rows of a sweep, and on how the beams without return were found."""
        kinds = torch.bincount(result.kind.long(), minlength=len(PointKind)).tolist()
        named = (
            f"{kinds[PointKind.OBJECT]} objects, {kinds[PointKind.PARTICLE]} particles, {kinds[PointKind.LOST]} lost"
        )
        columns = ", ".join(f"column {name} {value}" for name, value in label_columns(self.cloud).items())
        classes = [f"labels *{label_format(path).ending}: {label_format(path).words}" for path in self.file.labels]
        classes += [f"labels of particles: {columns}"] if columns else []
        return "; ".join((f"{COUNTED} {len(result.kind)} rows: {named}", str(result.scan), *classes))

    def boxes(self, result: Any) -> list[dict[str, Any]] | None:
        """Points and transmission that the weather left of each box; ``None`` where its place is not known."""
        frame = self.frame
        if frame.lidar_key != self.file.key:
            return None
        if frame.boxes is not None:
            if frame.calibration is None:
                return None  # where its boxes stand in the cloud is not known
            from_lidar = read_kitti_rectified_from_lidar(self.paths.source(frame.calibration))
            boxes = read_kitti_boxes(self.paths.source(frame.boxes), from_lidar, frame=frame.box_frame)
        elif frame.annotations:
            boxes = boxes_from_nuscenes(frame.annotations, torch.tensor(frame.lidar_from_global, dtype=torch.float64))
        else:
            return None
        found = box_visibility(boxes, self.data, result.points, result.kind, result.transmission, result.source)
        return list(_visibility(boxes.names, boxes.records, found))


def outgoing(cloud: PointCloud, points: Tensor, kind: Tensor) -> PointCloud:
    """A result in the columns of its input; a file that marks lost beams by NaN gets the new ones so too."""
    found = cloud.with_points(with_labels_of(cloud, points, kind))
    if found.missing is not None:
        lost = (kind == PointKind.LOST)[:, None] & found.missing.any(0)
        found = replace(found, missing=found.missing | lost)
    return found


def _visibility(
    names: tuple[str, ...], records: tuple[Mapping[str, Any], ...], found: BoxVisibility
) -> Iterator[dict[str, Any]]:
    for k, (name, record) in enumerate(zip(names, records, strict=True)):
        share = float(found.transmission[k])
        yield {
            **({"token": record["token"]} if "token" in record else {}),
            "name": name,
            "points_before": int(found.points_before[k]),
            "points_left": int(found.points_left[k]),
            "transmission": share if share == share else None,
            "particles": int(found.particles[k]),
        }
