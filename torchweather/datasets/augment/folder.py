"""A folder of images and clouds: every file a frame, or files of one name where a recipe is for several sensors."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Collection, Mapping, Sequence

from torchweather.core.errors import InputValueError
from torchweather.core.file_names import stem
from torchweather.datasets.augment.frame_files import FRAME_FILES
from torchweather.datasets.augment.frames import COPY, Frame, SensorFile

__all__ = ["carried", "kind_of_file", "name_without_ending", "renamed", "sensor_frames"]


def kind_of_file(path: str, kinds: Collection[str]) -> str | None:
    """Kind that a file may be of, ``camera``, ``lidar`` or ``radar``; of several the one that the recipe is for.

    Example:
        >>> kind_of_file("a/0.npz", ["lidar"]), kind_of_file("a/0.npz", ["camera"]), kind_of_file("a/0.txt", ["lidar"])
        ('lidar', 'camera', None)
    """
    lower = path.lower()
    could = [kind for kind, sensor in FRAME_FILES.items() if lower.endswith(sensor.suffixes)]
    return next((kind for kind in could if kind in kinds), could[0] if could else None)


def sensor_frames(paths: Sequence[str], keys: Mapping[str, str], formats: Mapping[str, str]) -> list[Frame]:
    """Frames of a folder.

    Args:
        paths: of all files.
        keys: kind of sensor to its name in the recipe.
        formats: kind of sensor to the ending of its results, where it is not that of the inputs.
    """
    there = set(paths)
    grouped: dict[str, list[SensorFile]] = defaultdict(list)
    for path in paths:
        kind = kind_of_file(path, keys)
        if kind is None or kind not in keys:
            continue
        # A sample of several sensors is found by the name that its files share, whatever folders they stand in.
        name = path if len(keys) == 1 else stem(path)[0]
        labels = _labels_of(path, there) if FRAME_FILES[kind].takes_labels else ()
        grouped[name].append(SensorFile(keys[kind], kind, path, renamed(path, kind, formats), labels))
    for name, files in grouped.items():
        for kind in keys:
            same = [one.path for one in files if one.kind == kind]
            if len(same) > 1:
                raise InputValueError(
                    f"augment: a recipe for several sensors joins files of one name, but {same[0]} and {same[1]} are "
                    f"both of a {kind} and named {name}. Run augment for each sequence, or --layout kitti or nuscenes."
                )
    return [Frame(name, tuple(files), name) for name, files in sorted(grouped.items())]


def carried(paths: Sequence[str], frames: Sequence[Frame]) -> list[Frame]:
    """Files that no frame writes, to be copied as they are: one frame a file."""
    written = {one.path for frame in frames for one in frame.files}
    written |= {path for frame in frames for one in frame.files for path in one.labels}
    written |= {one.target for frame in frames for one in frame.files}
    return [Frame(path, (SensorFile(COPY, COPY, path, path),), path) for path in paths if path not in written]


def renamed(path: str, kind: str, formats: Mapping[str, str]) -> str:
    """The path of a result, with the ending that was asked for."""
    return path if kind not in formats else name_without_ending(path) + formats[kind]


def name_without_ending(path: str) -> str:
    """The path up to the ending; nuScenes' ``.pcd.bin`` is one."""
    return path[: len(path) - len(stem(path)[1])]


def _labels_of(path: str, there: Collection[str]) -> tuple[str, ...]:
    """The ``.label`` of a cloud: beside it, or as SemanticKITTI has it, ``velodyne`` and ``labels`` side by side."""
    beside = f"{name_without_ending(path)}.label"
    parts = beside.split("/")
    other = "/".join([*parts[:-2], "labels", parts[-1]]) if len(parts) > 1 else beside
    return next(((one,) for one in (beside, other) if one in there), ())
