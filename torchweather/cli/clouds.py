"""Point clouds on the command line: the arguments of a LiDAR, which files there are, and the frames in them."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from torchweather.core.exceptions import InputValueError
from torchweather.core.file_names import stem

if TYPE_CHECKING:
    from torch import Tensor

    from torchweather.io import PointCloud, PointReading
    from torchweather.lidar.sensor import Lidar

__all__ = [
    "add_complete_scan",
    "complete_scan_of",
    "LIDAR_ARGUMENTS",
    "CloudFrame",
    "add_lidar_arguments",
    "add_bin_columns",
    "add_lidar_fields",
    "add_reading",
    "clouds_in",
    "gathered_clouds",
    "lidar_fields",
    "reading_of",
    "stem",
    "with_ones",
]

PCAP = ".pcap"
# Named as they stand in the arguments.
LIDAR_FIELDS = (
    "return_mode",
    "intensity_unit",
    "range_at_10_percent_m",
    "near_start_m",
    "near_full_m",
    "near_power",
    "pulse_width_ns",
    "margin_db",
    "max_range_m",
    "columns",
    "sensor_origin",
    "sensor_pose",
)
READING = ("bin_columns", "bin_dtype", "viewpoint")
LIDAR_ARGUMENTS = (
    *LIDAR_FIELDS,
    "q_back",
    "intensity",
    "lost",
    "complete_scan",
    "sky_only",
    "labels",
    "labels_in",
    "meta",
    "force",
    *READING,
)


# Share of a cloud's points below the sensor's own detection floor from which on its unit is surely another: they all
# were detected. Of KITTI's sweeps, a fifth has intensity 0.
NEARLY_ALL = 0.9


def add_force(group: argparse._ArgumentGroup | argparse.ArgumentParser) -> None:
    """The argument that lets a cloud through whose intensities contradict the sensor."""
    group.add_argument(
        "--force", action="store_true", help="go on although intensities or a recording contradict the sensor"
    )


def refuse_wrong_unit(name: str, points: Tensor, sensor: Lidar, args: argparse.Namespace, owner: str) -> None:
    """Raise where a cloud's points lie out of the sensor's reach, or nine tenths below its own floor, unless forced."""
    from torchweather.core.errors import TorchweatherError
    from torchweather.lidar.clouds import below_floor
    from torchweather.lidar.frame_check import far_note, frame_note

    far = "" if getattr(args, "force", False) else far_note(points, sensor)
    if far:
        raise TorchweatherError(f"{owner}: {name}: {far} --force goes on as it is.")
    floored, returns = below_floor(points, sensor)
    if not getattr(args, "force", False) and floored > NEARLY_ALL * returns:
        apart = frame_note(points, sensor)  # farther from the cloud's origin than from the sensor
        if apart:
            raise TorchweatherError(f"{owner}: {name}: {apart}")
        seen = points[..., 3][points[..., :3].square().sum(-1) > 0]
        raise TorchweatherError(
            f"{owner}: {name}: {floored} of {returns} points are, by their intensity, fainter than the sensor can "
            f"detect, yet it detected them. Their intensities are {float(seen.min()):g} to {float(seen.max()):g}, half "
            f"of them {float(seen.median()):g} or less, read as {sensor.intensity_unit}. Give --intensity-unit "
            "(reflectivity, reflectivity_percent, uint8_linear, uint8_calibrated, photons, none) or "
            "--range-at-10-percent-m; --force goes on as it is."
        )


def add_lidar_arguments(parser: argparse.ArgumentParser) -> None:
    """Add arguments on the LiDAR beyond its preset, and on the outputs."""
    group = parser.add_argument_group("lidar", "replaces what the preset says")
    add_lidar_fields(group)
    add_complete_scan(group)
    add_reading(group)
    add_force(group)
    group.add_argument("--q-back", type=float, help="backscatter efficiency of raindrops, 0.094 to 0.6; default 0.2")
    group.add_argument(
        "--lost",
        help="lost points become zero (default; other columns stay; a radar's leave the file), nan, or drop: left out",
    )
    group.add_argument(
        "--labels",
        choices=("label", "npz"),
        help="also write NAME.label (SemanticKITTI: class 110 is a particle, 0 lost or unlabelled), or NAME_labels.npz "
        "(kind: 0 object, 1 particle, 2 lost; source: row of the input, -1 none; transmission, or of a radar snr_db "
        "and attenuation_db; for each row of the input and what is added)",
    )
    group.add_argument("--labels-in", type=Path, metavar="DIR", help="folder of the clear clouds' .label, to carry on")
    group.add_argument("--meta", type=Path, metavar="JSON", help="of a .pcap; default the .json of its name")


def add_reading(group: argparse._ArgumentGroup | argparse.ArgumentParser) -> None:
    """The arguments of files that do not say how they are to be read."""
    add_bin_columns(group)
    group.add_argument(
        "--viewpoint",
        choices=("apply", "ignore"),
        help="of a .pcd whose VIEWPOINT is not its origin; default apply, and ignore with --sensor-origin or -pose",
    )


def add_bin_columns(group: argparse._ArgumentGroup | argparse.ArgumentParser) -> None:
    """The arguments of files without a header."""
    group.add_argument(
        "--bin-columns",
        metavar="NAMES",
        help="columns of a .bin that is not KITTI's x,y,z,intensity: such as x,y,z,intensity,ring:uint16; _ is padding",
    )
    group.add_argument(
        "--bin-dtype", metavar="TYPE", help="of --bin-columns without a type: float32 (default), float64"
    )


def reading_of(args: argparse.Namespace) -> PointReading:
    """The reading of point files that the arguments ask for."""
    from torchweather.io import PointReading

    if getattr(args, "bin_dtype", None) and not getattr(args, "bin_columns", None):
        raise InputValueError("--bin-dtype is the type of --bin-columns; give --bin-columns too.")
    return PointReading(
        intensity=getattr(args, "intensity", None) or "auto",
        bin_columns=getattr(args, "bin_columns", None),
        bin_dtype=getattr(args, "bin_dtype", None) or "float32",
        viewpoint=getattr(args, "viewpoint", None),
    )


def add_lidar_fields(group: argparse._ArgumentGroup) -> None:
    """Add arguments on the LiDAR beyond its preset."""
    group.add_argument("--return-mode", help="strongest, last, first, or dual (second returns get a file NAME_second)")
    group.add_argument(
        "--intensity-unit",
        help="reflectivity, reflectivity_percent, uint8_linear, uint8_calibrated, photons or none",
    )
    group.add_argument(
        "--intensity", metavar="COLUMN", help="the intensity's column, or none; signal has the unit photons"
    )
    group.add_argument("--range-at-10-percent-m", type=float, help="range at which 10 %% reflectivity is just seen, m")
    group.add_argument("--near-start-m", type=float, help="nearer than this, m, it sees nothing of the weather")
    group.add_argument("--near-full-m", type=float, help="from here on, m, it sees the weather in full")
    group.add_argument("--near-power", type=float, help="power of the rise between them; 1 is linear")
    group.add_argument("--pulse-width-ns", type=float, help="width of the pulse (FWHM), ns")
    group.add_argument("--margin-db", type=float, help="mean margin of returns in clear air above the threshold, dB")
    group.add_argument("--max-range-m", type=float, help="largest range, m")
    group.add_argument(
        "--sensor-origin",
        nargs=3,
        type=float,
        metavar=("X", "Y", "Z"),
        help="position of the sensor in the cloud's frame, m; Waymo's clouds: 1.43 0 2.18. Default 0 0 0",
    )
    group.add_argument(
        "--sensor-pose",
        type=Path,
        metavar="FILE",
        help="the same with a rotation: T_cloud_from_sensor, 4 x 4 (.npy, .json, .yaml, or numbers in a .txt)",
    )
    group.add_argument("--columns", type=int, help="firings of each ring in a turn, for --complete-scan")


def lidar_fields(args: argparse.Namespace) -> dict[str, Any]:
    """Fields of the LiDAR that the arguments replace."""
    given = {name: getattr(args, name, None) for name in LIDAR_FIELDS}
    origin, pose = given.pop("sensor_origin"), given.pop("sensor_pose")
    if origin is not None and pose is not None:
        raise InputValueError(
            "--sensor-origin and --sensor-pose both give the position of the sensor; give one of them."
        )
    if pose is not None:
        from torchweather.io import read_sensor_pose
        from torchweather.lidar.pose import split_pose

        given["origin_m"], given["rotation"] = split_pose(read_sensor_pose(pose))
    elif origin is not None:
        given["origin_m"] = tuple(origin)
    # What the column is called says its unit.
    if args.intensity_unit is None and args.intensity in ("none", "signal"):
        given["intensity_unit"] = "none" if args.intensity == "none" else "photons"
    return {name: value for name, value in given.items() if value is not None}


def add_complete_scan(group: argparse._ArgumentGroup) -> None:
    """The arguments of the beams that a cloud lacks."""
    group.add_argument(
        "--complete-scan",
        action="store_true",
        help="add the beams that the cloud lacks, up to the ground, the own vehicle, an obstacle, or the sky",
    )
    group.add_argument("--sky-only", action="store_true", help="with --complete-scan: only beams that end in the sky")


def complete_scan_of(args: argparse.Namespace) -> bool | str:
    """``complete_scan`` of the transform, from the arguments."""
    if args.sky_only and not args.complete_scan:
        raise InputValueError("--sky-only selects the beams that --complete-scan adds; give --complete-scan too.")
    return "sky" if args.sky_only else bool(args.complete_scan)


@dataclass(frozen=True, eq=False)
class CloudFrame:
    """One cloud of a file.

    Args:
        path: the file.
        number: of the frame, in a recording of several; ``None`` in a file of one.
        cloud: its points.
        directions: ``(N, 3)`` of every beam, where the recording knows them.
        product: that recorded it, where the file names it.
    """

    path: Path
    number: int | None
    cloud: PointCloud
    directions: Tensor | None = None
    product: str | None = None

    @property
    def name(self) -> str:
        """File name and frame, for messages."""
        return str(self.path) if self.number is None else f"{self.path}, frame {self.number}"


def gathered_clouds(inputs: list[Path]) -> list[Path]:
    """The files: as they are, of a folder all point clouds and recordings in it by name."""
    from torchweather.io import IMAGE_SUFFIXES, POINT_SUFFIXES
    from torchweather.io.ouster import OSF, OSF_HINT

    known = (*POINT_SUFFIXES, PCAP)
    found: list[Path] = []
    for path in inputs:
        if path.is_dir():
            seen = [file for file in path.iterdir() if not file.name.startswith(".")]
            inside = sorted(file for file in seen if file.name.lower().endswith(known))
            if not inside:
                raise InputValueError(f"{path}: no point clouds; expected {', '.join(known)}.")
            found += inside
        elif not path.exists():
            raise InputValueError(f"{path}: no such file.")
        elif path.suffix.lower() == OSF:
            raise InputValueError(f"{path}: {OSF_HINT}")
        elif not path.name.lower().endswith(known):
            image = " For images give --sensor camera:PRESET." if path.suffix.lower() in IMAGE_SUFFIXES else ""
            raise InputValueError(f"{path}: expected a point cloud ({', '.join(known)}).{image}")
        else:
            found.append(path)
    return found


def clouds_in(path: Path, args: argparse.Namespace, sensor: Lidar | None = None) -> Iterator[CloudFrame]:
    """The clouds of a file, one after another; the sensor's unit chooses among several intensities."""
    from torchweather.io import read_ouster, read_points, read_sensor_points

    if path.suffix.lower() != PCAP:
        reading = reading_of(args)
        cloud = (
            read_points(path, **{**vars(reading), "viewpoint": reading.viewpoint or "apply"})
            if sensor is None
            else read_sensor_points(path, sensor, reading)
        )
        yield CloudFrame(path, None, cloud)
        return
    frames = read_ouster(path, args.meta, intensity=args.intensity or "reflectivity")
    for number, frame in enumerate(frames):
        yield CloudFrame(path, number, frame.cloud, frame.directions, frame.product)


def with_ones(cloud: PointCloud) -> PointCloud:
    """A cloud without intensity, with a column of ones in its place."""
    import torch

    from torchweather.io import PointCloud

    ones = torch.ones_like(cloud.points[:, :1])
    return PointCloud(
        torch.cat([cloud.points[:, :3], ones, cloud.points[:, 3:]], -1),
        (*cloud.columns[:3], "intensity", *cloud.columns[3:]),
    )
