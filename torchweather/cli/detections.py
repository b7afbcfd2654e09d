"""Radar detections on the command line: the arguments of a radar, and which files there are."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from torchweather.core.exceptions import InputValueError

__all__ = [
    "RADAR_ARGUMENTS",
    "add_radar_arguments",
    "add_radar_fields",
    "gathered_detections",
    "radar_fields",
    "radar_options",
]

DETECTION_SUFFIXES = (".pcd", ".npz", ".csv", ".bin")
# Named as they stand in the arguments.
RADAR_FIELDS = ("frequency_ghz", "polarisation", "noise_floor_db", "detection_snr_db")
MAP_ARGUMENTS = ("map", "noise_law", "map_clutter_share", "looks")
RADAR_OPTIONS = ("clutter", "radome_loss_db", "radome_film_db")
RADAR_ARGUMENTS = (*RADAR_FIELDS, *RADAR_OPTIONS, "speed", "gain", *MAP_ARGUMENTS)


def add_radar_arguments(parser: argparse.ArgumentParser) -> None:
    """Add arguments on the radar beyond its preset, on its cover, and on how its files are read."""
    group = parser.add_argument_group(
        "radar", "replaces what the preset says; --lost, --labels npz and --ego-speed-m-per-s are a radar's too"
    )
    add_radar_fields(group)
    group.add_argument("--clutter", action="store_true", help="add detections of rain and snow themselves")
    group.add_argument("--radome-loss-db", type=float, help="two-way loss of a wet cover, whatever the rate")
    group.add_argument("--radome-film-db", type=float, help="two-way loss of the cover's film at 1 mm/h of rain")
    add_map_arguments(parser)


def add_map_arguments(parser: argparse.ArgumentParser) -> None:
    """Add arguments on the power maps of a radar."""
    group = parser.add_argument_group(
        "radar power maps", "polar pictures (.png) and arrays (.npy, .npz) of range, azimuth, Doppler, elevation"
    )
    group.add_argument(
        "--map",
        metavar="NAME|YAML",
        help="order, axes and scale that the files do not hold: radiate, oxford, mulran, boreas-2020, boreas-2021, or "
        "a file with dims, range_m, azimuth_deg, elevation_deg, speed_m_per_s, scale",
    )
    group.add_argument(
        "--noise-law",
        choices=("measured", "scale"),
        help="reading of the lowest levels of bytes. measured (default): so that the recording's own noise has an "
        "exponential law. scale: as the scale has them",
    )
    group.add_argument("--map-clutter-share", type=float, help="factor on the echoes of rain and snow; default 1")
    group.add_argument("--looks", type=int, help="independent looks whose mean power a cell holds; default 1")


def add_radar_fields(group: argparse._ArgumentGroup) -> None:
    """Add arguments on the radar beyond its preset, and on how its files are read."""
    group.add_argument("--frequency-ghz", type=float, help="carrier, GHz")
    group.add_argument("--polarisation", help="h or v")
    group.add_argument("--noise-floor-db", type=float, help="noise of the detections, in the unit of their power")
    group.add_argument("--detection-snr-db", type=float, help="signal over that noise from which a target is detected")
    group.add_argument("--speed", help="of nuScenes' velocities: relative to the radar (default), or compensated")
    group.add_argument("--gain", help="of the antennas, where a file has no power: boresight (default) or pattern")


def radar_fields(args: argparse.Namespace) -> dict[str, Any]:
    """Fields of the radar that the arguments replace."""
    given = {name: getattr(args, name) for name in RADAR_FIELDS}
    return {name: value for name, value in given.items() if value is not None}


def radar_options(args: argparse.Namespace) -> dict[str, Any]:
    """Options of the transform that the arguments set."""
    given = {name: getattr(args, name) for name in (*RADAR_OPTIONS, "ego_speed_m_per_s", "lost")}
    return {name: value for name, value in given.items() if value is not None and value is not False}


def gathered_detections(inputs: list[Path]) -> list[Path]:
    """The files: as they are, of a folder all that may hold detections by name."""
    known = DETECTION_SUFFIXES
    found: list[Path] = []
    for path in inputs:
        if path.is_dir():
            inside = sorted(file for file in path.iterdir() if file.suffix.lower() in known and file.name[0] != ".")
            if not inside:
                raise InputValueError(f"{path}: no radar detections; expected {', '.join(known)}.")
            found += inside
        elif not path.exists():
            raise InputValueError(f"{path}: no such file.")
        elif path.suffix.lower() not in known:
            raise InputValueError(f"{path}: expected radar detections ({', '.join(known)}).")
        else:
            found.append(path)
    return found
