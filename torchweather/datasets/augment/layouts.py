"""Layout of a folder, and its frames."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from pathlib import Path

from torchweather.core.errors import InputValueError, check_one_of
from torchweather.datasets.augment.folder import carried, kind_of_file, sensor_frames
from torchweather.datasets.augment.frames import FROM_LIDAR, DataSet
from torchweather.datasets.augment.kitti import is_kitti, kitti_frames, other_cameras
from torchweather.datasets.augment.manifest import NAME as MANIFEST
from torchweather.datasets.augment.nuscenes import annotation_tables, is_nuscenes, nuscenes_frames
from torchweather.datasets.augment.paths import files_below

__all__ = ["LAYOUTS", "find_frames"]

LAYOUTS = ("auto", "folder", "kitti", "nuscenes")


def find_frames(
    root: Path,
    keys: Mapping[str, str],
    *,
    recipe: str,
    layout: str = "auto",
    depth: str | None = None,
    formats: Mapping[str, str] | None = None,
    follow_links: bool = False,
) -> DataSet:
    """All frames of a data set, those that are only carried along last.

    Args:
        root: the folder.
        keys: kind of sensor to its name in the recipe.
        recipe: its name, for messages.
        layout: one of ``LAYOUTS``.
        depth: where a camera's depth comes from; ``None`` is the LiDAR where the layout has one.
        formats: kind of sensor to the ending of its results.
        follow_links: take links to folders, and links that lead out of the root.

    Raises:
        ValueError: nothing there that the recipe is for.
        TorchweatherError: a link or a table leads out of the root, or a table is broken.
    """
    check_one_of("layout", layout, LAYOUTS, owner="augment")
    left_out: list[str] = []
    below = files_below(root, follow_links=follow_links, left_out=left_out)
    paths = [path for path in below if not path.startswith(MANIFEST)]
    if layout == "auto":
        layout = "nuscenes" if is_nuscenes(paths) else "kitti" if is_kitti(paths) else "folder"
    formats = formats or {}
    if formats and layout != "folder":
        raise InputValueError(
            f"augment: --format is for a plain folder; the layout is {layout}, which has its own formats."
        )
    from_lidar = depth in (None, FROM_LIDAR)
    data = [path for path in paths if not _is_depth(root / path, depth)]
    tables: tuple[str, ...] = ()
    if layout == "folder":
        if depth == FROM_LIDAR:
            raise InputValueError("augment: --depth lidar needs --layout kitti or nuscenes, which have calibrations.")
        frames = sensor_frames(data, keys, formats)
    elif layout == "kitti":
        frames = kitti_frames(data, keys, depth_from_lidar=from_lidar)
    else:
        frames = nuscenes_frames(root, data, keys, depth_from_lidar=from_lidar)
        tables = annotation_tables(paths) if any(frame.annotations for frame in frames) else ()
    found = Counter(kind for kind in (kind_of_file(path, keys) for path in paths) if kind)
    if not frames:
        there = ", ".join(f"{number} for a {kind}" for kind, number in sorted(found.items()))
        raise InputValueError(
            f"augment: recipe {recipe} is for a {' and a '.join(keys)}; {root}, taken as layout {layout}, has no such "
            f"files (found: {there or 'no images, no clouds'}). Give another --recipe or --layout."
        )
    _check_targets([one.target for frame in frames for one in frame.files])
    rest = [frame for frame in carried(paths, frames) if frame.name not in tables]
    depths = set(paths) - set(data)
    alike = [frame.name for frame in rest if frame.name not in depths and kind_of_file(frame.name, keys)]
    clear = Counter(path.rpartition("/")[0] for path in alike)
    notes = other_cameras(clear, keys) if layout == "kitti" else ()
    return DataSet(layout, (*frames, *rest), dict(found), tables, tuple(left_out), dict(clear), notes)


def _is_depth(path: Path, depth: str | None) -> bool:
    """Check whether a file is a depth map that was named: no image, though it may look like one."""
    return depth is not None and Path(depth).exists() and path.resolve().is_relative_to(Path(depth).resolve())


def _check_targets(targets: list[str]) -> None:
    twice = [path for path, number in Counter(targets).items() if number > 1]
    if twice:
        raise InputValueError(f"augment: two files would both be written to {twice[0]}; leave --format out.")
