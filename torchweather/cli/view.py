"""``torchweather view``: a page with a point cloud in clear air and in a weather, to turn and zoom."""

from __future__ import annotations

import argparse
import warnings
from dataclasses import replace
from importlib import import_module
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any

from torchweather.cli.clouds import add_complete_scan, add_lidar_fields, add_reading
from torchweather.cli.frame_seeds import FrameSeeds, add_seed_rule, frame_name
from torchweather.cli.sensor_text import preset_named
from torchweather.core.exceptions import InputTypeError, InputValueError

if TYPE_CHECKING:
    from torchweather.cli.clouds import CloudFrame
    from torchweather.lidar.sensor import Lidar
    from torchweather.lidar.transform import LidarResult

NAME = "view"
SUMMARY = "look at a point cloud in clear air and in a weather"
DESCRIPTION = """Writes one HTML page that needs nothing else: the cloud in clear air and in the weather, to turn
and zoom. Points are coloured by kind, intensity or range, and counted by range. It reads what apply reads: KITTI or
WADS .bin, nuScenes .pcd.bin, .pcd, .ply, .npz, .csv, or an Ouster .pcap with its .json beside it. Nothing opens
without --open."""

# Share of a cloud's points below the detection threshold from which on the page warns of a wrong unit.
MANY_FLOORED = 0.5


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.add_argument("input", type=Path, metavar="IN", help="a point cloud")
    parser.add_argument(
        "--weather", required=True, help="rain:rate=25, fog:mor=30, snow:rate=1, or several joined by +"
    )
    parser.add_argument("--sensor", help="lidar:PRESET (see torchweather list); default lidar:ouster-os1-128")
    parser.add_argument("--seed", type=int, default=0, help="default 0; it gives the storm that apply gives the cloud")
    add_seed_rule(parser)
    parser.add_argument(
        "-o", "--out", type=Path, default=Path("torchweather-view.html"), help="page; default torchweather-view.html"
    )
    parser.add_argument("--open", action="store_true", help="open the page in the browser")
    parser.add_argument("--quiet", action="store_true", help="no notes")
    parser.add_argument("--frame", type=int, default=0, help="of a recording, from 0; default 0")
    parser.add_argument(
        "--rerun",
        action="store_true",
        help="also log both clouds to Rerun: to a .rrd beside the page, with --open to the viewer (extra view)",
    )
    group = parser.add_argument_group("lidar", "replaces what the preset says")
    add_lidar_fields(group)
    add_reading(group)
    add_complete_scan(group)
    group.add_argument("--meta", type=Path, metavar="JSON", help="of a .pcap; default the .json of its name")
    parser.set_defaults(lost=None)


def run(args: argparse.Namespace) -> int:
    """Write the page."""
    from torchweather.atmosphere.weather import parse_weather
    from torchweather.cli.output import note, print_json, print_lines
    from torchweather.report.cloud_view import write_cloud_view

    _check(args)
    recording = _rerun() if args.rerun else None
    weather = parse_weather(args.weather)
    frame, points, transform, sensor_name = _prepared(args, weather)
    seed = FrameSeeds(args.seed, args.seed_rule).of(frame_name(frame.path.name, frame.number))
    result, warned = _weathered(seed, frame, points, transform)
    notes, alerts = _notes(args, frame, transform.sensor), [*warned, *_alerts(points, transform.sensor, result)]
    args.out.parent.mkdir(parents=True, exist_ok=True)
    found = write_cloud_view(
        args.out,
        points,
        result,
        transform.sensor,
        weather=weather,
        seed=seed,
        name=frame.path.name if frame.number is None else f"{frame.path.name}, frame {frame.number}",
        sensor_name=sensor_name,
        notes=notes,
        alerts=alerts,
    )
    for text in (*alerts, *notes):
        note(text, quiet=args.quiet)
    if recording is not None:
        found["rerun"] = _logged(recording, args, points, result, transform.sensor)
    if args.json:
        print_json({"input": args.input, "page": args.out, "seed": seed, "weather": weather.to_dict(), **found})
    else:
        print_lines(
            f"wrote {args.out}  points {found['points']}: objects {found['objects']}, particles {found['particles']}, "
            f"lost {found['lost']}"
            + (f", under the ground {found['under_ground']}" if found["under_ground"] else "")
            + (f"\nlogged to {found['rerun']}" if "rerun" in found else "")
        )
    if args.open:
        open_page(args.out)
    return 0


def _weathered(seed: int, frame: CloudFrame, points: Any, transform: Any) -> tuple[Any, list[str]]:
    """The result, and the library's warnings, which belong on the page as well."""
    import torch

    from torchweather.core.errors import TorchweatherError, TorchweatherWarning

    try:
        with warnings.catch_warnings(record=True) as caught, torch.no_grad():
            warnings.simplefilter("always")
            noise = transform.draw(points, seed=seed)
            result = transform.run(points, noise, directions=frame.directions)
    except (InputValueError, InputTypeError) as error:
        raise TorchweatherError(f"{frame.name}: {error}") from error
    said = []
    for warning in caught:
        if issubclass(warning.category, TorchweatherWarning):
            said.append(str(warning.message))
        else:
            warnings.warn_explicit(warning.message, warning.category, warning.filename, warning.lineno)
    return result, list(dict.fromkeys(said))


def open_page(path: Path) -> None:
    """Open a page in the browser."""
    import webbrowser

    webbrowser.open(path.resolve().as_uri())


def _check(args: argparse.Namespace) -> None:
    """Raise where the page would be no page, or the frame no frame."""
    if args.out.suffix.lower() not in (".html", ".htm"):
        raise InputValueError(f"view: --out must be a page, such as page.html; got {args.out}.")
    if args.frame < 0:
        raise InputValueError(f"view: --frame must be 0 or more; got {args.frame}.")


def _prepared(args: argparse.Namespace, weather: Any) -> tuple[CloudFrame, Any, Any, str]:
    """The frame, its points with an intensity, the transform, and the sensor's name."""
    from torchweather.cli.apply_lidar import RING, builder
    from torchweather.cli.clouds import clouds_in, gathered_clouds, with_ones
    from torchweather.cli.ouster_product import refuse_other_product
    from torchweather.core.errors import TorchweatherError
    from torchweather.sensors import DEFAULT_PRESETS

    preset = preset_named(args.sensor, "lidar", "view: --sensor must be lidar, with :PRESET")
    if args.input.is_dir():
        raise InputValueError(f"view: {args.input} is a folder; give one point cloud.")
    (path,) = gathered_clouds([args.input])
    sensor, build = builder(args, weather, None, preset)
    frame = next(islice(clouds_in(path, args, sensor), args.frame, None), None)
    if frame is None or (args.frame and frame.number is None):
        raise TorchweatherError(f"{path}: has no frame {args.frame}. Give a smaller --frame.")
    refuse_other_product(frame.name, frame.product, sensor, args, "view")
    cloud = with_ones(frame.cloud) if args.intensity == "none" else frame.cloud
    if args.complete_scan and sensor.ring_column is None and RING in cloud.columns[4:]:
        sensor = replace(sensor, ring_column=cloud.columns.index(RING))
    return frame, cloud.points, build(sensor), f"lidar:{preset or DEFAULT_PRESETS['lidar']}"


def _notes(args: argparse.Namespace, frame: CloudFrame, sensor: Lidar) -> list[str]:
    """Sentences about what was not given."""
    notes = []
    if args.sensor is None:
        notes.append("No --sensor was given: the default preset is assumed. Beam, range and intensity depend on it.")
    if sensor.intensity_unit == "none":
        notes.append(
            f"The cloud has no intensity: every object counts as a reflectivity of {sensor.assumed_reflectivity:g}."
        )
    elif args.intensity_unit is None and args.intensity != "signal":
        notes.append(
            f"No --intensity-unit was given: the preset's is assumed ({sensor.intensity_unit}). It decides which "
            "points are lost."
        )
    if args.range_at_10_percent_m is None:
        notes.append(
            f"The range at which 10 % reflectivity is just seen is the preset's, {sensor.range_at_10_percent_m:g} m."
        )
    if args.near_start_m is None and args.near_full_m is None:
        notes.append(
            f"The receiver sees nothing nearer than {sensor.near_start_m:g} m and all from {sensor.near_full_m:g} m "
            "on: plausible values of the preset. They decide how many near particles show."
        )
    if frame.directions is None and not args.complete_scan:
        notes.append(
            "Beams without a return are not in the file, so weather is not seen there; --complete-scan infers them."
        )
    return notes


def _alerts(points: Any, sensor: Lidar, result: LidarResult) -> list[str]:
    """Sentences that put the whole picture in doubt."""
    from torchweather.report.cloud_counts import has_return

    returns, floored = int(has_return(points, sensor).sum()), int(result.floored_points)
    if floored <= MANY_FLOORED * returns:
        return []
    text = (
        f"{floored} of {returns} points are, by their intensity, fainter than the sensor can detect. The unit of "
        "intensity is probably wrong, and so is all that follows from it: check --intensity-unit and "
        "--range-at-10-percent-m."
    )
    return [text]


def _rerun() -> Any:
    """The module of rerun-sdk."""
    from torchweather.core.errors import TorchweatherError
    from torchweather.core.extras import install_hint

    try:
        rerun = import_module("rerun")
    except ImportError as error:
        raise TorchweatherError(f"view: --rerun needs rerun-sdk. {install_hint('view')}") from error
    if not hasattr(rerun, "Points3D"):
        raise TorchweatherError(
            "view: --rerun needs rerun-sdk; another package named rerun is installed: pip uninstall rerun. "
            f"{install_hint('view')}"
        )
    return rerun


def _logged(rerun: Any, args: argparse.Namespace, points: Any, result: LidarResult, sensor: Lidar) -> str:
    """Log both clouds, coloured by kind, to a file beside the page, or with --open to the viewer; where they went."""
    from torchweather.report.cloud_view import COLOURS
    from torchweather.report.view_points import view_points

    target: Path = args.out.with_suffix(".rrd")
    colours = [[int(text[at : at + 2], 16) for at in (1, 3, 5)] for text in COLOURS.values()]
    rerun.init("torchweather_view", spawn=args.open)
    if not args.open:
        rerun.save(target)
    for name, cloud in zip(("clear", "weather"), view_points(points, result, sensor), strict=True):
        shades = [colours[kind] for kind in cloud.kind.tolist()]
        rerun.log(name, rerun.Points3D(cloud.xyz_m.numpy(), colors=shades), static=True)
    if not args.open:
        rerun.disconnect()  # else the file is complete only when the process ends
    return "viewer" if args.open else str(target)
