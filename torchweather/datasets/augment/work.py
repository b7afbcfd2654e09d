"""One frame: read, weather, write. What every worker does, whatever engine it belongs to."""

from __future__ import annotations

import errno
import hashlib
import shutil
import time
import warnings
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

import torchweather
from torchweather.camera.depth import AUTO, CompletedDepth, DepthSource, SceneDepth
from torchweather.camera.sensor import Camera
from torchweather.core.errors import InputValueError, TorchweatherError, TorchweatherWarning
from torchweather.core.file_names import stem
from torchweather.core.random import sample_seed
from torchweather.datasets import (
    BoxVisibility,
    box_visibility,
    boxes_from_nuscenes,
    read_kitti_boxes,
    read_kitti_calibration,
    read_kitti_rectified_from_lidar,
)
from torchweather.datasets.augment.frame_recipe import FrameRecipe, SensorUse, text_sha256
from torchweather.datasets.augment.frames import COPY, Frame, SensorFile
from torchweather.datasets.augment.layouts import FROM_LIDAR
from torchweather.datasets.augment.manifest import DONE, FAILED, Row
from torchweather.datasets.augment.own_vehicle import drive_of
from torchweather.datasets.augment.paths import inside
from torchweather.datasets.depth_sources import GROUND, depth_source
from torchweather.io import (
    PointCloud,
    atomic_write,
    merge_kind,
    read_image,
    read_labels,
    read_points,
    read_radar,
    write_image,
    write_labels,
    write_points,
    write_radar,
)
from torchweather.lidar import OwnVehicleMask
from torchweather.pipeline.point_kind import PointKind
from torchweather.radar.sensor import Radar

__all__ = ["ATTEMPTS", "COUNTED", "FULL", "Job", "Worker", "file_sha256"]

ATTEMPTS = ".torchweather-attempts"  # folder of marks below the target, where an engine cannot count tries otherwise
COUNTED = "sweep of"  # a note that counts, and warns of nothing
FULL = "full"  # status of a frame that found no room; it is not recorded
_NO_ROOM = (errno.ENOSPC, errno.EDQUOT)


@dataclass(frozen=True)
class Job:
    """What to do to all frames; plain values, for processes and machines elsewhere.

    Args:
        source: root of the data set.
        target: root of the results.
        recipe: text of the recipe.
        seed: of the run.
        depth: where a camera's depth comes from: a file, a folder, metres, ``ground`` or ``lidar``; ``None`` is the
            LiDAR where the layout has one, else what the recipe says, else ``ground``.
        depth_encoding: of integer depth maps.
        own_vehicle: drive to the mask of its vehicle (`drive_of`).
    """

    source: str
    target: str
    recipe: str
    seed: int
    depth: str | None = None
    depth_encoding: str | None = None
    own_vehicle: Mapping[str, OwnVehicleMask] = field(default_factory=dict, repr=False)


class Worker:
    """Does frame after frame.

    Args:
        job: what to do.
    """

    def __init__(self, job: Job) -> None:
        self.job = job
        self.source, self.target = Path(job.source), Path(job.target)
        self.recipe = FrameRecipe(job.recipe)
        self.recipe_sha256 = text_sha256(job.recipe)

    def process(self, frame: Frame) -> Row:
        """The row of a frame; a frame that cannot be done leaves no file behind."""
        started = time.perf_counter()
        seed = sample_seed(self.job.seed, frame.seed_name, 0)
        row = Row(
            frame=frame.name,
            status=DONE,
            kind=COPY if frame.is_copy else "weather",
            inputs={},
            outputs={},
            recipe_sha256=self.recipe_sha256,
            seed=seed,
            version=torchweather.__version__,
        )
        written: list[str] = []
        said: list[warnings.WarningMessage] = []
        try:
            row = replace(row, inputs={path: _stamp(self._in(path)) for path in frame.reads})
            for path in frame.reads:
                row.inputs[path][0] = file_sha256(self._in(path))
            if not frame.is_copy:
                with torch.no_grad(), warnings.catch_warnings(record=True) as said:
                    warnings.simplefilter("always", TorchweatherWarning)
                    row = self._in_weather(frame, seed, row, written)
            for file in frame.files:
                if frame.is_copy:
                    self._copy(file.path, file.target, written)
            outputs = {path: [file_sha256(self._out(path)), self._out(path).stat().st_size] for path in written}
            row = replace(row, outputs=outputs)
        except Exception as error:
            for path in written:
                self._out(path).unlink(missing_ok=True)
            row = replace(row, status=FULL if no_room(error) else FAILED, error=one_line(error))
        notes = tuple(dict.fromkeys([*row.notes, *(" ".join(str(one.message).split()) for one in said)]))
        return replace(row, notes=notes, seconds=time.perf_counter() - started)

    # ---- a frame -------------------------------------------------------------------------------------------------

    def _in_weather(self, frame: Frame, seed: int, row: Row, written: list[str]) -> Row:
        clear = {file.key: _Clear(self, frame, file) for file in frame.files}
        compose = self.recipe.for_sensors({key: one.use for key, one in clear.items()})
        sample = {name: value for one in clear.values() for name, value in one.sample()}
        draw = compose.draw(sample, seed=seed)
        assert not isinstance(draw, list)
        out, results = compose.run(sample, draw=draw)
        for file in frame.files:
            if file.key in results:
                self._write(clear[file.key], results[file.key], written)
            elif file.kind == "camera" and compose.clear_through_mosaic(file.key):
                write_image(self._new(file.target, written), out[file.key])
            else:
                self._write_clear(clear[file.key], written)
        sure = tuple(
            f"{file.key}: depth {results[file.key].depth_confidence}"
            for file in frame.files
            if file.kind == "camera" and file.key in results
        )
        sure += tuple(
            f"{file.key}: {COUNTED} {_counts(results[file.key])}"
            for file in frame.files
            if file.kind == "lidar" and file.key in results
        )
        boxes = None
        if frame.lidar_key in results:
            boxes = self._boxes(frame, clear[str(frame.lidar_key)], results[frame.lidar_key])
        return replace(row, weather=draw.weather, boxes=boxes, notes=sure)

    def _write(self, clear: _Clear, result: Any, written: list[str]) -> None:
        target = clear.file.target
        if clear.file.kind == "camera":
            write_image(self._new(target, written), result.rgb if clear.use.rgb else result.bayer)
            return
        if clear.file.kind == "radar":
            write_radar(self._new(target, written), clear.radar.with_points(result.points))
            return
        seconds = isinstance(result.second, Tensor)
        name, ending = stem(target)
        other = target[: len(target) - len(name) - len(ending)] + f"{name}_second"
        if clear.file.labels is not None:
            before = read_labels(self._in(clear.file.labels), len(clear.cloud.points))
            write_labels(self._new(clear.file.labels, written), merge_kind(before, result.kind, result.source))
            if seconds:
                merged = merge_kind(before, result.second_kind, result.second_source)
                label = Path(clear.file.labels).with_name(f"{name}_second.label").as_posix()
                write_labels(self._new(label, written), merged)
        if seconds:
            cloud = outgoing(clear.cloud, result.second, result.second_kind)
            write_points(self._new(other + ending, written), cloud)
        write_points(self._new(target, written), outgoing(clear.cloud, result.points, result.kind))

    def _write_clear(self, clear: _Clear, written: list[str]) -> None:
        """A frame that the recipe leaves in clear air: its files as they are."""
        file = clear.file
        if file.labels is not None:
            self._copy(file.labels, file.labels, written)
        if file.path == file.target:
            self._copy(file.path, file.target, written)
        elif file.kind == "camera":
            write_image(self._new(file.target, written), clear.image)
        elif file.kind == "lidar":
            write_points(self._new(file.target, written), clear.cloud)
        else:
            write_radar(self._new(file.target, written), clear.radar)

    def _boxes(self, frame: Frame, clear: _Clear, result: Any) -> list[dict[str, Any]] | None:
        """What the weather left of each box."""
        if frame.boxes is not None:
            if frame.calibration is None:
                return None  # where its boxes stand in the cloud is not known
            boxes = read_kitti_boxes(
                self._in(frame.boxes), read_kitti_rectified_from_lidar(self._in(frame.calibration))
            )
        elif frame.annotations:
            boxes = boxes_from_nuscenes(frame.annotations, torch.tensor(frame.lidar_from_global, dtype=torch.float64))
        else:
            return None
        found = box_visibility(
            boxes, clear.cloud.points, result.points, result.kind, result.transmission, result.source
        )
        return list(_visibility(boxes.names, boxes.records, found))

    def _copy(self, path: str, target: str, written: list[str]) -> None:
        with atomic_write(self._new(target, written)) as unfinished:
            shutil.copyfile(self._in(path), unfinished)

    def _in(self, path: str) -> Path:
        return inside(self.source, path, "augment")

    def _out(self, path: str) -> Path:
        return inside(self.target, path, "augment")

    def _new(self, path: str, written: list[str]) -> Path:
        """Where a result goes; its folder is made."""
        found = self._out(path)
        found.parent.mkdir(parents=True, exist_ok=True)
        if path not in written:
            written.append(path)
        return found


class _Clear:
    """A file of a frame as it was read, and the sensor that took it."""

    def __init__(self, worker: Worker, frame: Frame, file: SensorFile) -> None:
        self.worker, self.frame, self.file = worker, frame, file
        path = worker._in(file.path)
        self.depth: SceneDepth | None = None
        if file.kind == "camera":
            self.image, info = read_image(path)
            if self.image.ndim != 3:
                raise InputValueError(f"{path}: wanted one image a file; got {tuple(self.image.shape)}.")
            self.use = SensorUse("camera", self._camera(), info.kind == "rgb")
            self.depth = self._depth(path)
            self.use = replace(self.use, depth=self.depth is not None)
        elif file.kind == "lidar":
            self.cloud = read_points(path)
            mask = worker.job.own_vehicle.get(drive_of(file.path))
            self.use = SensorUse("lidar", drive="" if mask is None else drive_of(file.path), own_vehicle=mask)
        else:
            sensor = worker.recipe.plan("radar").sensor
            assert isinstance(sensor, Radar)
            self.radar = read_radar(path, sensor)
            self.use = SensorUse("radar")

    def sample(self) -> Iterator[tuple[str, Tensor | SceneDepth]]:
        """What the recipe is given."""
        if self.file.kind == "camera":
            yield self.file.key, self.image
        else:
            yield self.file.key, self.cloud.points if self.file.kind == "lidar" else self.radar.points
        if self.depth is not None:
            yield f"{self.file.key} depth", self.depth

    def _camera(self) -> Camera:
        """The recipe's camera with the intrinsics of the data set, or scaled to the size of the image."""
        height, width = self.image.shape[-2:]
        camera = self.worker.recipe.plan("camera").sensor
        assert isinstance(camera, Camera)
        matrix: Any = self.file.camera_matrix
        if matrix is None and self.frame.calibration is not None:
            matrix = read_kitti_calibration(self.worker._in(self.frame.calibration)).camera_matrix.tolist()
        if matrix is not None:
            fx, fy, cx, cy = matrix[0][0], matrix[1][1], matrix[0][2], matrix[1][2]
            return replace(camera, width=width, height=height, fx=fx, fy=fy, cx=cx, cy=cy)
        return camera if (camera.height, camera.width) == (height, width) else camera.fitted_to(width, height)

    def _depth(self, path: Path) -> SceneDepth | None:
        """Depth of the image; ``None`` leaves it to the recipe's own source."""
        camera = self.use.camera
        source = self._depth_source(path)
        if source is None:
            return None
        assert camera is not None
        return source.scene(camera, camera.height, camera.width, image=self.image).to(dtype=torch.float32)

    def _depth_source(self, path: Path) -> DepthSource | None:
        worker, file = self.worker, self.file
        if file.depth_cloud is not None:
            cloud = read_points(worker._in(file.depth_cloud)).points
            from_lidar: Any = file.camera_from_lidar
            if from_lidar is None:
                if self.frame.calibration is None:
                    raise TorchweatherError(
                        f"{path}: depth from the LiDAR needs its calibration, calib/{stem(file.path)[0]}.txt; there is "
                        "none. Or give --depth."
                    )
                calibration = read_kitti_calibration(worker._in(self.frame.calibration))
                from_lidar = calibration.T_camera_from_lidar
            return CompletedDepth(cloud, torch.as_tensor(from_lidar, dtype=torch.float64))
        chosen = worker.job.depth
        if chosen == FROM_LIDAR:
            raise TorchweatherError(f"{path}: there is no cloud of its number, for --depth lidar.")
        if chosen is None:
            if worker.recipe.plan("camera").options.get("depth") is not None:
                return None
            chosen = AUTO if self.use.rgb else GROUND
        return depth_source(chosen, worker.job.depth_encoding, path)


def _counts(result: Any) -> str:
    """What the rows of a sweep are, and how the beams without return were found."""
    kinds = torch.bincount(result.kind.long(), minlength=len(PointKind)).tolist()
    named = f"{kinds[PointKind.OBJECT]} objects, {kinds[PointKind.PARTICLE]} particles, {kinds[PointKind.LOST]} lost"
    return f"{len(result.kind)} rows: {named}; {result.scan}"


def outgoing(cloud: PointCloud, points: Tensor, kind: Tensor) -> PointCloud:
    """A result in the columns of its input; a file that marks lost beams by NaN gets the new ones so too."""
    found = cloud.with_points(points)
    if found.missing is not None:
        lost = (kind == PointKind.LOST)[:, None] & found.missing.any(0)
        found = replace(found, missing=found.missing | lost)
    return found


def file_sha256(path: Path) -> str:
    """Of the content of a file."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def no_room(error: BaseException | None) -> bool:
    """Whether an error, or what caused it, says that the disk is full."""
    while error is not None:
        if isinstance(error, OSError) and error.errno in _NO_ROOM:
            return True
        error = error.__cause__ or error.__context__
    return False


def one_line(error: Exception) -> str:
    """The message without line breaks; of a system's error with the name of the file."""
    if isinstance(error, OSError) and error.filename is not None:
        return f"{error.filename}: {error.strerror}"
    return " ".join(str(error).split()) or type(error).__name__


def _stamp(path: Path) -> list[Any]:
    """Place for the hash, size, time of the last change in ns."""
    found = path.stat()
    return ["", found.st_size, found.st_mtime_ns]


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
