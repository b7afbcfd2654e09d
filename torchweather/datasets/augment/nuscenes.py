"""nuScenes' layout: samples, sweeps and the json tables, from which come samples, calibrations and boxes."""

from __future__ import annotations

import json
import re
from collections import defaultdict
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from torchweather.core.errors import InputValueError, TorchweatherError
from torchweather.datasets.augment.folder import kind_of_file
from torchweather.datasets.augment.frame_files import FRAME_FILES
from torchweather.datasets.augment.frames import Frame, SensorFile
from torchweather.datasets.augment.paths import check_relative
from torchweather.io import atomic_write

__all__ = ["annotation_tables", "is_nuscenes", "nuscenes_frames", "write_points_left"]

TABLES = re.compile(r"^(?P<folder>v1\.0-[^/]+)/sample_data\.json$")
LIDAR = "LIDAR_TOP"
# Beyond these a pose is damaged, and its products overflow.
_FARTHEST_M, _LEAST = 1e12, 1e-12
# Of lidarseg and panoptic: table and folder, and the ending of the files.
LABELS = {"lidarseg": "_lidarseg.bin", "panoptic": "_panoptic.npz"}
Matrix = npt.NDArray[np.float64]


def is_nuscenes(paths: Sequence[str]) -> bool:
    """Check whether there are nuScenes' tables."""
    return any(TABLES.match(path) for path in paths)


def annotation_tables(paths: Sequence[str]) -> tuple[str, ...]:
    """Paths of the tables of boxes."""
    return tuple(path for path in paths if re.match(r"^v1\.0-[^/]+/sample_annotation\.json$", path))


def nuscenes_frames(
    root: Path, paths: Sequence[str], keys: Mapping[str, str], *, depth_from_lidar: bool
) -> list[Frame]:
    """Frames of nuScenes: the sensors of a sample, and each sweep, in the weather of the sample that it belongs to.

    Args:
        root: of the data set.
        paths: of all files.
        keys: kinds of sensors that the recipe is for; each channel is drawn under its own name.
        depth_from_lidar: whether a camera's depth is that of the sample's cloud.

    Raises:
        TorchweatherError: a table is broken, or names a file outside the root.
    """
    there = set(paths)
    frames: list[Frame] = []
    for path in paths:
        found = TABLES.match(path)
        if found:
            frames += _Tables(root, found["folder"]).frames(there, keys, depth_from_lidar=depth_from_lidar)
    return frames


def write_points_left(path: Path, before: Path, left: Mapping[str, int]) -> None:
    """The table of boxes with ``num_lidar_pts`` as the weather left them.

    Args:
        path: of the new table.
        before: the table of the clear data.
        left: token of a box to its number of points; boxes without one stay as they are.
    """
    rows = _read(before)
    for row in rows:
        if row.get("token") in left:
            row["num_lidar_pts"] = left[row["token"]]
    with atomic_write(path) as unfinished:
        unfinished.write_text(json.dumps(rows, indent=0) + "\n", encoding="utf-8")


class _Tables:
    """The tables of one version."""

    def __init__(self, root: Path, folder: str) -> None:
        self.root, self.folder = root, root / folder
        self.data = self._rows("sample_data", ("token", "sample_token", "filename", "calibrated_sensor_token"))
        self.sensors = self._by_token("calibrated_sensor", ("token", "translation", "rotation"))
        self.poses = self._by_token("ego_pose", ("token", "translation", "rotation"))
        self.boxes: dict[str, list[dict[str, Any]]] = defaultdict(list)
        if (self.folder / "sample_annotation.json").is_file():
            for row in self._rows("sample_annotation", ("token", "sample_token", "translation", "size", "rotation")):
                self.boxes[row["sample_token"]].append(row)

        self.labels = {task: self._label_table(task) for task in LABELS}

    def _label_table(self, task: str) -> dict[str, str]:
        """Token of a sweep to the file with its labels."""
        path = self.folder / f"{task}.json"
        if not path.is_file():
            return {}
        rows = self._rows(task, ("sample_data_token", "filename"))
        for row in rows:
            check_relative(self.root, row["filename"], str(path))
        return {row["sample_data_token"]: row["filename"] for row in rows}

    def frames(self, there: set[str], keys: Mapping[str, str], *, depth_from_lidar: bool) -> list[Frame]:
        """The frames whose files are there."""
        lidars = {
            row["sample_token"]: row for row in self.data if row["is_key_frame"] and _channel(row["filename"]) == LIDAR
        }
        of_sample: dict[str, list[dict[str, Any]]] = defaultdict(list)
        sweeps: list[dict[str, Any]] = []
        for row in self.data:
            # Files that were found are below the root; a table of all data sets names many more.
            check_relative(self.root, row["filename"], str(self.folder / "sample_data.json"))
            if row["filename"] in there and _kind(row["filename"]) in keys:
                if row["is_key_frame"]:
                    of_sample[row["sample_token"]].append(row)
                else:
                    sweeps.append(row)
        frames = []
        for sample, rows in sorted(of_sample.items()):
            lidar = lidars.get(sample)
            files = tuple(self._file(row, lidar, depth_from_lidar, there) for row in sorted(rows, key=_by_name))
            counted = lidar is not None and any(one.path == lidar["filename"] for one in files)
            annotations = tuple(self.boxes.get(sample, ())) if counted else ()
            to_lidar = None
            if annotations and lidar is not None:
                to_lidar = _plain(np.linalg.inv(self._global_from_sensor(lidar)))
            frames.append(
                Frame(
                    f"sample/{sample}",
                    files,
                    sample,
                    annotations=annotations,
                    lidar_from_global=to_lidar,
                    lidar_key=LIDAR if counted else None,
                )
            )
        for row in sorted(sweeps, key=_by_name):
            file = self._file(row, lidars.get(row["sample_token"]), depth_from_lidar, there)
            frames.append(Frame(row["filename"], (file,), row["sample_token"]))
        return frames

    def _file(
        self, row: Mapping[str, Any], lidar: Mapping[str, Any] | None, depth_from_lidar: bool, there: set[str]
    ) -> SensorFile:
        path, kind = row["filename"], str(_kind(row["filename"]))
        # A sweep has the weather of its sample but drops of its own.
        key = _channel(path) if row["is_key_frame"] else path
        if not FRAME_FILES[kind].takes_depth:
            labels = self._labels_of(row, there) if FRAME_FILES[kind].takes_labels else ()
            return SensorFile(key, kind, path, path, labels)
        matrix = self._sensor(row).get("camera_intrinsic") or None
        cloud = lidar["filename"] if depth_from_lidar and lidar and lidar["filename"] in there else None
        from_lidar = None
        if cloud is not None and lidar is not None:
            from_lidar = _plain(np.linalg.inv(self._global_from_sensor(row)) @ self._global_from_sensor(lidar))
        plain = None if matrix is None else _intrinsic(matrix, self.folder)
        return SensorFile(key, kind, path, path, (), plain, from_lidar, cloud)

    def _labels_of(self, row: Mapping[str, Any], there: set[str]) -> tuple[str, ...]:
        """Files of lidarseg and panoptic that label the points of a sweep: by their tables, else by their names."""
        found = []
        for task, ending in LABELS.items():
            named = f"{task}/{self.folder.name}/{row['token']}{ending}"
            path = self.labels[task].get(row["token"], named)
            if path in there:
                found.append(path)
        return tuple(found)

    def _global_from_sensor(self, row: Mapping[str, Any]) -> Matrix:
        try:
            pose = self.poses[row["ego_pose_token"]]
        except (KeyError, TypeError) as error:
            raise TorchweatherError(f"{self.folder}: {row['filename']} has no pose {error}.") from error
        return _rigid(pose, self.folder) @ _rigid(self._sensor(row), self.folder)

    def _sensor(self, row: Mapping[str, Any]) -> dict[str, Any]:
        try:
            return self.sensors[row["calibrated_sensor_token"]]
        except (KeyError, TypeError) as error:
            raise TorchweatherError(f"{self.folder}: {row['filename']} has no sensor {error}.") from error

    def _by_token(self, name: str, wanted: Sequence[str]) -> dict[str, dict[str, Any]]:
        return {row["token"]: row for row in self._rows(name, wanted)}

    def _rows(self, name: str, wanted: Sequence[str]) -> list[dict[str, Any]]:
        path = self.folder / f"{name}.json"
        rows = _read(path)
        for row in rows:
            lacks = [key for key in wanted if key not in row]
            if lacks:
                raise TorchweatherError(f"{path}: a row lacks {', '.join(lacks)}; it has {', '.join(row)}.")
            odd = [key for key in wanted if key.endswith(("token", "filename")) and not isinstance(row[key], str)]
            if odd:
                raise TorchweatherError(
                    f"{path}: {', '.join(odd)} must be text in every row; got {row[odd[0]]!r:.100}."
                )
            if name == "sample_data":
                row.setdefault("is_key_frame", str(row["filename"]).startswith("samples/"))
        return rows


def _read(path: Path) -> list[dict[str, Any]]:
    try:
        rows = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        raise TorchweatherError(f"{path}: expected a table of nuScenes in json; {error}.") from error
    if not isinstance(rows, list) or not all(isinstance(row, dict) for row in rows):
        raise TorchweatherError(f"{path}: expected a table of nuScenes, a list of rows; got {type(rows).__name__}.")
    return rows


def _channel(path: str) -> str:
    """``samples/CAM_FRONT/a.jpg`` is of ``CAM_FRONT``."""
    parts = path.split("/")
    return parts[1] if len(parts) > 2 else path


def _kind(path: str) -> str | None:
    kinds = {"CAM": "camera", "LIDAR": "lidar", "RADAR": "radar"}
    kind = kinds.get(_channel(path).split("_")[0])
    return kind if kind is not None and kind_of_file(path, [kind]) == kind else None


def _by_name(row: Mapping[str, Any]) -> str:
    return str(row["filename"])


def _rigid(row: Mapping[str, Any], where: Path) -> Matrix:
    """A row's translation and rotation (quaternion w, x, y, z) as ``(4, 4)``."""
    try:
        turn = np.asarray(row["rotation"], np.float64)
        matrix = np.eye(4)
        matrix[:3, 3] = row["translation"]
        if not np.abs(matrix).max() < _FARTHEST_M or not _LEAST < np.abs(turn).max() < 1.0 / _LEAST:
            raise InputValueError(f"got {row['translation']!r} and {row['rotation']!r}")
        w, x, y, z = turn / np.linalg.norm(turn)
    except (TypeError, ValueError, OverflowError) as error:
        raise TorchweatherError(f"{where}: expected translation (3) and rotation (4: w, x, y, z); {error}.") from error
    matrix[:3, :3] = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return matrix


def _intrinsic(matrix: Any, where: Path) -> tuple[tuple[float, ...], ...]:
    """A camera's matrix, ``(3, 3)`` finite numbers."""
    try:
        found = np.asarray(matrix, np.float64)
        if found.shape != (3, 3) or not np.isfinite(found).all():
            raise InputValueError(f"got {matrix!r}")
    except (TypeError, ValueError, OverflowError) as error:
        raise TorchweatherError(f"{where}: expected camera_intrinsic, 3 x 3 finite numbers; {error}.") from error
    return _plain(found)


def _plain(matrix: npt.NDArray[Any]) -> tuple[tuple[float, ...], ...]:
    return tuple(tuple(float(value) for value in line) for line in matrix)
