"""Studies from folders as data sets have them: a clear folder and measured ones, or KITTI's with a table of weather."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from numpy.typing import NDArray
from torch import Tensor

from torchweather.atmosphere.weather import Weather, weather_from_dict
from torchweather.camera.sensor import Camera
from torchweather.core.errors import TorchweatherError, nearest_name
from torchweather.core.file_names import is_hidden
from torchweather.gap.sensors.all import KINDS
from torchweather.gap.study.conditions import StudySensor
from torchweather.gap.study.frames import FrameSource
from torchweather.gap.study.kinds import Given, Paths, StudyKind
from torchweather.gap.study.parts import CLEAR, WEATHERS
from torchweather.gap.study.study import Study
from torchweather.io.tables import read_table
from torchweather.lidar.sensor import Lidar
from torchweather.sensors import sensor_preset

__all__ = ["study_from_folders", "study_from_kitti"]

PathLike = str | os.PathLike[str]
Depth = PathLike | float | NDArray[Any] | Tensor

SCENE = "s0"
NO_FRAME = "metadata.csv"  # a table that REHEARSE-3D keeps beside the frames
TABLE_COLUMNS = ("frame", "weather", "value", "scene", "rel_sd", "time_s", "split")
REQUIRED_COLUMNS = TABLE_COLUMNS[:3]


def study_from_folders(
    clear: PathLike,
    measured: Mapping[Any, Weather | str],
    sensor: Lidar | Camera | str,
    *,
    rel_sd: float = 0.0,
    depth: Depth | None = None,
    depth_encoding: str | None = None,
    directions: NDArray[Any] | Tensor | None = None,
) -> Study:
    """A study of one scene from a folder of clear frames and folders of measured ones, as in REHEARSE.

    Args:
        clear: folder of the frames in clear air.
        measured: for each folder of measured frames its weather, such as ``{"fog_30m": "fog:mor=30"}``; the conditions
            have the folders' names, with that of the folder around each where two are alike (``001-ouster``).
        sensor: that took all of them; an object or text such as ``lidar:ouster-os1-128``.
        rel_sd: relative standard deviation of the recorded rates or visibilities.
        depth: camera: metres along the optical axis, as a file, a number or an array ``(H, W)``; inf is sky.
        depth_encoding: of a depth file that holds integers (`read_depth`).
        directions: LiDAR, organised clouds: ``(H, W, 3)``; ``None`` takes the mean direction of each cell's returns.

    Returns:
        The study. Frames are read when they are asked for, in the order of their names.

    Raises:
        TorchweatherError: a folder holds no frame, or one that cannot be read.

    Note:
        LiDAR: organised clouds keep their grid; others are put on the sensor's scan pattern, and a warning says how
        many points found no place of their own (see `scan_frame`). Camera: raw frames become linear by the camera's
        levels; RGB images are decoded from sRGB and sampled by the colour filter array, which is light only roughly;
        noise below black is cut. A last row or column of odd size is dropped, of frames and camera.

    Example:
        >>> import tempfile
        >>> import torch
        >>> from torchweather.io import write_image
        >>> root = Path(tempfile.mkdtemp())
        >>> for folder, grey in (("clear", 0.2), ("fog_30m", 0.4)):
        ...     (root / folder).mkdir()
        ...     for k in range(2):
        ...         write_image(root / folder / f"{k}.npy", torch.full((1, 6, 8), grey + 0.01 * k))
        >>> camera = Camera.from_intrinsics(20.0, 20.0, 3.5, 2.5, 8, 6)
        >>> study = study_from_folders(root / "clear", {root / "fog_30m": "fog:mor=30"}, camera, depth=25.0)
        >>> study.conditions[0].id, study.conditions[0].frames[1]["bayer"].shape
        ('fog_30m', (6, 8))
    """
    owner = "study_from_folders"
    built, kind = _sensor(sensor, owner)
    conditions = [
        {"id": name, "scene": SCENE, "weather": weather, "rel_sd": rel_sd, "frames": _files(folder, kind)}
        for name, (folder, weather) in zip(_names(list(measured)), measured.items(), strict=True)
    ]
    given = {"depth": depth, "depth_encoding": depth_encoding, "directions": directions}
    return _study(built, kind, {SCENE: _files(clear, kind)}, conditions, given, owner)


def study_from_kitti(
    folder: PathLike,
    sensor: Lidar | Camera | str,
    *,
    table: PathLike | None = None,
    depth: Mapping[str, Depth] | Depth | None = None,
    depth_encoding: str | None = None,
    directions: NDArray[Any] | Tensor | None = None,
) -> Study:
    """A study from folders as KITTI has them, and a table of the weather of each frame.

    Args:
        folder: with ``velodyne`` (a LiDAR) or ``image_2`` (a camera).
        sensor: that took the frames; an object or text such as ``lidar:velodyne-hdl-64e``.
        table: ``.csv`` or ``.parquet``; default ``weather.csv`` in the folder. Columns ``frame`` (name without ending),
            ``weather`` (rain, fog, snow or clear), ``value`` (mm/h, or metres of visibility; empty for clear), and
            where known ``scene`` (name of the place), ``rel_sd`` (of the value), ``time_s``, ``split`` (fit or
            holdout).
        depth: camera: as in `study_from_folders`; by scene where there are several.
        depth_encoding, directions: as in `study_from_folders`.

    Returns:
        The study: rows ``clear`` are the clear frames of their scene, all others of one scene, weather and value one
        condition, such as ``s0-rain-25``.

    Raises:
        TorchweatherError: a column, a frame or the clear frames of a scene are missing; with file and row.

    Note:
        Clear and measured frames of a scene must look at the same place: a clear street elsewhere is no reference.
        Frames of a recording drive are scenes of their own.

    Example:
        >>> import tempfile
        >>> import torch
        >>> from torchweather.io import write_points
        >>> root = Path(tempfile.mkdtemp())
        >>> (root / "velodyne").mkdir()
        >>> for k in range(3):
        ...     write_points(root / "velodyne" / f"{k:06d}.bin", torch.tensor([[8.0 + k, 0.0, 0.0, 0.5]]))
        >>> rows = ["frame,weather,value", "000000,clear,", "000001,clear,", "000002,rain,25"]
        >>> _ = (root / "weather.csv").write_text(chr(10).join(rows))
        >>> study = study_from_kitti(root, Lidar(905.0, elevations_deg=(0.0, 2.0), columns=360))
        >>> study.conditions[0].id, float(study.conditions[0].frames[0]["range_m"].max())
        ('s0-rain-25', 10.0)
    """
    owner, root = "study_from_kitti", Path(folder)
    built, kind = _sensor(sensor, owner)
    path = root / "weather.csv" if table is None else Path(table)
    files = {file.name.split(".")[0]: file for file in _files(root / kind.kitti_folder, kind)}
    scenes: dict[str, list[Path]] = {}
    conditions: dict[str, dict[str, Any]] = {}
    for place, row in enumerate(_rows(path), start=2):  # the first line of a CSV holds the names
        where = f"{path}: row {place}"
        file = _file_of(row["frame"], files, where)
        scene = SCENE if row.get("scene") is None else str(row["scene"])
        if row["weather"] == CLEAR:
            scenes.setdefault(scene, []).append(file)
            continue
        stated: dict[str, Any] = {
            "id": f"{scene}-{row['weather']}-{row['value']}",
            "scene": scene,
            "weather": _weather(row, where),
            "rel_sd": row.get("rel_sd") or 0.0,
            "split": row.get("split"),
        }
        one = conditions.setdefault(stated["id"], {**stated, "frames": [], "time_s": []})
        if any(one[key] != value for key, value in stated.items()):
            raise TorchweatherError(f"{where}: rel_sd and split must be those of the other frames of {one['id']}.")
        one["frames"].append(file)
        one["time_s"] += [] if row.get("time_s") is None else [row["time_s"]]
    for one in conditions.values():
        one["time_s"] = one["time_s"] or None
        if one["scene"] not in scenes:
            raise TorchweatherError(
                f"{path}: the scene {one['scene']} has no clear frame; add rows with weather clear."
            )
    given = {"depth": depth, "depth_encoding": depth_encoding, "directions": directions}
    return _study(built, kind, scenes, list(conditions.values()), given, owner)


# ---- folders and tables ----------------------------------------------------------------------------------------------


def _sensor(sensor: StudySensor | str, owner: str) -> tuple[StudySensor, StudyKind]:
    """The sensor, and its kind of study."""
    built = sensor_preset(sensor)[1] if isinstance(sensor, str) else sensor
    for kind in KINDS.values():
        if kind.sensor_class is not None and isinstance(built, kind.sensor_class) and kind.frame_file is not None:
            return built, kind
    raise TorchweatherError(
        f"{owner}: sensor must be a Lidar or a Camera; got {type(built).__name__}. Detection lists of a radar do "
        "not identify their targets: use Study.from_arrays."
    )


def _names(folders: Sequence[PathLike]) -> list[str]:
    """Names of the conditions: those of the folders, or of each and the one around it."""
    short = [Path(folder).name for folder in folders]
    if len(set(short)) == len(short):
        return short
    return ["-".join(Path(folder).absolute().parts[-2:]) for folder in folders]


def _files(folder: PathLike, kind: StudyKind) -> list[Path]:
    """Frames of a folder by name."""
    root, suffixes = Path(folder), kind.suffixes
    if not root.is_dir():
        raise TorchweatherError(f"{root}: no such folder. Wanted frames ending in {', '.join(suffixes)}.")
    named = (file for file in root.iterdir() if file.name.lower().endswith(suffixes) and not is_hidden(file))
    found = sorted(file for file in named if file.name != NO_FRAME)
    if not found:
        raise TorchweatherError(f"{root}: no frames; expected files ending in {', '.join(suffixes)}.")
    return found


def _rows(path: Path) -> list[dict[str, Any]]:
    """Rows of the table of weather."""
    columns = read_table(path)
    for name in columns:
        if name not in TABLE_COLUMNS:
            raise TorchweatherError(
                f"{path}: unknown column {name!r}; known are {', '.join(TABLE_COLUMNS)}."
                f"{nearest_name(name, TABLE_COLUMNS)}"
            )
    for name in REQUIRED_COLUMNS:
        if name not in columns:
            raise TorchweatherError(f"{path}: the column {name!r} is missing; got {', '.join(columns)}.")
    return [dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)]


def _file_of(frame: Any, files: Mapping[str, Path], where: str) -> Path:
    """The file of a frame; a number stands for a name with leading zeros."""
    if isinstance(frame, int):
        names = [name for name in files if name.isdecimal() and int(name) == frame]
    else:
        names = [name for name in files if name == frame]
    if not names:
        raise TorchweatherError(f"{where}: frame {frame!r} has no file.{nearest_name(frame, files)}")
    return files[names[0]]


def _weather(row: Mapping[str, Any], where: str) -> Weather:
    kinds = (*WEATHERS, CLEAR)
    if row["weather"] not in kinds:
        raise TorchweatherError(
            f"{where}: weather must be one of {', '.join(kinds)}; got {row['weather']!r}."
            f"{nearest_name(row['weather'], kinds)}"
        )
    intensity = WEATHERS[row["weather"]][0]
    if not isinstance(row["value"], (int, float)):
        raise TorchweatherError(f"{where}: value must be a number, {intensity}; got {row['value']!r}.")
    try:
        return weather_from_dict({"kind": row["weather"], intensity: float(row["value"])})
    except ValueError as error:
        raise TorchweatherError(f"{where}: {error}") from error


def _study(sensor: Any, kind: StudyKind, scenes: Paths, conditions: Sequence[Given], given: Given, owner: str) -> Study:
    """The study of these files."""
    measured = [path for one in conditions for path in one["frames"]]
    kept, beams, geometry = kind.recorded(sensor, scenes, measured, given, owner)

    def frames(paths: Sequence[Path]) -> list[FrameSource]:
        assert kind.frame_file is not None  # as `_sensor` chose it
        return [kind.frame_file(path, sensor) for path in paths]

    return Study.from_arrays(
        sensor=kept,
        beams=beams,
        scenes=[{"id": key, "clear": frames(scenes[key]), "geometry": geometry.get(key)} for key in scenes],
        conditions=[{**one, "frames": frames(one["frames"])} for one in conditions],
    )
