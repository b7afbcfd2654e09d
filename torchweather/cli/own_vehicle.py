"""``--own-vehicle``: the vehicle that carries the LiDAR, from the sweeps of a drive or from a file."""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any

from torchweather.cli.clouds import reading_of, with_ones
from torchweather.cli.output import note
from torchweather.core.exceptions import InputValueError

if TYPE_CHECKING:
    from torchweather.io import PointCloud
    from torchweather.lidar import OwnVehicleMask
    from torchweather.lidar.sensor import Lidar

__all__ = ["DRIVE", "NONE", "add_own_vehicle", "own_vehicle_of", "words_of"]

DRIVE, NONE = "drive", "none"
RING = "ring"


def add_own_vehicle(group: argparse._ArgumentGroup | argparse.ArgumentParser) -> None:
    """The argument that says which beams meet the own vehicle."""
    group.add_argument(
        "--own-vehicle",
        metavar="drive|FILE|none",
        help="the car that carries the sensor: drive, from the sweeps given, all of one car (at most 50, evenly "
        "chosen; default with --complete-scan and 5 or more that differ); FILE, a mask (.npz); none: in each sweep by "
        "itself. Returns on it come back as they are",
    )


def own_vehicle_of(
    args: argparse.Namespace, files: Sequence[Path], sensor: Lidar, *, complete_scan: bool
) -> OwnVehicleMask | None:
    """The mask that the arguments ask for; ``None``: in each sweep by itself.

    Args:
        args: with ``own_vehicle``.
        files: all sweeps of the run.
        sensor: the LiDAR.
        complete_scan: whether beams are appended, which makes a drive the default.

    Raises:
        ValueError: too few sweeps for the drive that was asked for, or a file without a mask.
    """
    from torchweather.lidar import OwnVehicleMask, own_vehicle_mask
    from torchweather.lidar.sweep.drive_sweeps import evenly_chosen
    from torchweather.lidar.sweep.own_vehicle import FEWEST_VIEWS

    chosen = args.own_vehicle
    if chosen == NONE or (chosen is None and not complete_scan):
        return None
    if chosen not in (None, DRIVE):
        return OwnVehicleMask.load(chosen)
    sweeps = evenly_chosen([file for file in files if file.suffix.lower() != ".pcap"])
    if chosen is None and len(sweeps) < FEWEST_VIEWS:
        return None
    clouds = _clouds(sweeps, args, sensor)
    first = next(clouds, None)
    try:
        if first is None:
            raise InputValueError("expected sweeps in files of their own; got recordings (.pcap).")
        points = (cloud.points for cloud in chain([first], clouds))
        found = own_vehicle_mask(points, _with_ring_column(sensor, first.columns))
    except ValueError as error:
        if chosen == DRIVE:
            raise InputValueError(f"--own-vehicle drive: {error}") from error
        note(f"own vehicle: found in each sweep by itself ({error})", quiet=args.quiet)
        return None
    if chosen is None and not found.beams:
        return None
    note(found.words, quiet=args.quiet)
    return found


def words_of(mask: OwnVehicleMask) -> dict[str, Any]:
    """Size and origin of a mask, as plain values."""
    return {"beams": mask.beams, "sweeps": mask.sweeps, "views": mask.views}


def _clouds(files: Sequence[Path], args: argparse.Namespace, sensor: Lidar) -> Iterator[PointCloud]:
    """The clouds of files, one after another, with a column of intensities."""
    from torchweather.io import read_sensor_points

    for file in files:
        cloud = read_sensor_points(file, sensor, reading_of(args))
        yield with_ones(cloud) if args.intensity == "none" else cloud


def _with_ring_column(sensor: Lidar, columns: Sequence[str]) -> Lidar:
    """The sensor, with the column of a file that holds the ring."""
    if sensor.ring_column is not None or RING not in columns[4:]:
        return sensor
    return replace(sensor, ring_column=columns.index(RING))
