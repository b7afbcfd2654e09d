"""Masks of the own vehicle for the drives of a data set."""

from __future__ import annotations

import base64
import io
import json
import zipfile
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from torchweather.compose.transform_spec import TransformSpec
from torchweather.core.errors import InputValueError, TorchweatherError
from torchweather.datasets.augment.paths import inside
from torchweather.io import PointReading, read_sensor_points
from torchweather.lidar import OwnVehicleMask, own_vehicle_mask
from torchweather.lidar.sensor import Lidar
from torchweather.lidar.sweep.drive_sweeps import evenly_chosen

if TYPE_CHECKING:
    from torch import Tensor

__all__ = ["DRIVE", "NONE", "drive_masks", "drive_of", "masks_from_text", "masks_to_text"]

DRIVE, NONE = "drive", "none"
LOG_ENDS = "__"  # n015-2018-07-24-11-22-45+0800__LIDAR_TOP__1532402927647951: a log of nuScenes is one drive


def drive_of(path: str) -> str:
    """The drive that a sweep belongs to: its folder, and what stands before ``__`` in its name.

    Example:
        >>> drive_of("training/velodyne/000008.bin"), drive_of("samples/LIDAR_TOP/n015__LIDAR_TOP__15.pcd.bin")
        ('training/velodyne/', 'samples/LIDAR_TOP/n015')
    """
    folder, _, name = path.rpartition("/")
    log, ends, _ = name.partition(LOG_ENDS)
    return f"{folder}/{log if ends else ''}"


def drive_masks(
    chosen: str | None,
    sweeps: Sequence[str],
    source: Path,
    spec: TransformSpec[Lidar],
    reading: PointReading,
    *,
    follow_links: bool = False,
) -> dict[str, OwnVehicleMask]:
    """Drive to its mask.

    Args:
        chosen: ``drive``; ``none``; a file of a mask; ``None``: ``drive`` where the recipe completes sweeps and has no
            ``own_vehicle`` of its own.
        sweeps: paths of the data set's clouds; at most 50 of a drive are read, evenly chosen by name.
        source: root of the data set.
        spec: of the recipe's LiDAR.
        reading: how the clouds are to be read.
        follow_links: links may lead out of the source.

    Returns:
        Drives with fewer than 5 sweeps that differ have none: each of their sweeps is looked at by itself.

    Raises:
        ValueError: ``drive`` was asked for and no drive has a mask.
    """
    drives: dict[str, list[str]] = {}
    for path in sweeps:
        drives.setdefault(drive_of(path), []).append(path)
    wanted = bool(spec.options.get("complete_scan")) and spec.options.get("own_vehicle") is None
    if chosen == NONE or (chosen is None and not wanted):
        return {}
    if chosen not in (None, DRIVE):
        mask = OwnVehicleMask.load(chosen)
        return dict.fromkeys(drives, mask)
    found: dict[str, OwnVehicleMask] = {}
    why = "there are no sweeps"
    for drive, paths in drives.items():
        try:
            clouds = _clouds(evenly_chosen(paths), source, spec.sensor, reading, follow_links=follow_links)
            mask = own_vehicle_mask(clouds, spec.sensor)
        except (ValueError, IndexError) as error:
            why = str(error)
            continue
        if mask.beams or chosen == DRIVE:
            found[drive] = mask
    if chosen == DRIVE and not found:
        raise InputValueError(f"augment: --own-vehicle drive: {why}")
    return found


def masks_to_text(masks: Mapping[str, OwnVehicleMask]) -> str:
    """Masks as the manifest keeps them, for a run that goes on later: size and origin, and the mask itself."""
    values = {}
    for drive, mask in masks.items():
        buffer = io.BytesIO()
        mask.save(buffer)
        data = base64.b64encode(buffer.getvalue()).decode("ascii")
        values[drive] = {"beams": mask.beams, "sweeps": mask.sweeps, "views": mask.views, "npz_base64": data}
    return json.dumps(values)


def masks_from_text(text: str) -> dict[str, OwnVehicleMask]:
    """Masks of a text that `masks_to_text` wrote; none of an empty text."""
    try:
        values = json.loads(text or "{}")
        return {
            drive: OwnVehicleMask.load(io.BytesIO(base64.b64decode(one["npz_base64"]))) for drive, one in values.items()
        }
    except (ValueError, TypeError, KeyError, AttributeError, RecursionError, OSError, zipfile.BadZipFile) as error:
        raise TorchweatherError(
            f"augment: the manifest's masks of the own vehicle cannot be read ({error}); --restart begins again."
        ) from error


def _clouds(
    paths: Sequence[str], source: Path, sensor: Lidar, reading: PointReading, *, follow_links: bool
) -> Iterator[Tensor]:
    """The sweeps that can be read; a broken one is reported when its turn comes."""
    for path in paths:
        try:
            yield read_sensor_points(inside(source, path, "augment", follow_links=follow_links), sensor, reading).points
        except (ValueError, OSError, TorchweatherError):
            continue
