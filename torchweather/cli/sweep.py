"""``torchweather sweep``: scores of one sensor's data in weather of rising severity, as a table and a page."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from torchweather.cli.clouds import (
    LIDAR_FIELDS,
    READING,
    add_complete_scan,
    add_force,
    add_lidar_fields,
    add_reading,
)
from torchweather.cli.detections import RADAR_FIELDS, add_radar_fields
from torchweather.cli.frame_seeds import add_seed_rule, storm_seeds
from torchweather.cli.frames import (
    CAMERA_ARGUMENTS,
    add_camera_arguments,
    add_depth_arguments,
    add_light_arguments,
    add_through_mosaic,
)
from torchweather.cli.regions import REGION_HELP
from torchweather.cli.run_record import add_no_record
from torchweather.core.exceptions import InputValueError

if TYPE_CHECKING:
    from torchweather.evaluation.sweep import Level, Subject

NAME = "sweep"
SUMMARY = "scores against weather of rising severity: a table and a page with the curves"
DESCRIPTION = """Puts weather of rising severity on clear frames, point clouds or radar detections, and scores each
against the clear data. Writes a tidy table, summary.json and a page with the curves. The page lists which scores get
worse at every step, and why the others do not. The data are an embedded scene, files, or folders whose files are
judged together. Raw frames are scored as the colour image they give (demosaiced, sRGB)."""

SCENE = "scene:"  # begins the name of an embedded scene
DEFAULT_INPUT = "scene:test-track"
KINDS = ("camera", "lidar", "radar")
# By the kind of the sensor: arguments that belong to it, named as they stand in the arguments. Some belong to two.
ARGUMENTS = {
    "camera": (*CAMERA_ARGUMENTS, "size"),
    "lidar": (*LIDAR_FIELDS, "intensity", "complete_scan", "sky_only", "meta", "region", "force", *READING),
    "radar": (*RADAR_FIELDS, "speed", "gain", "region"),
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.add_argument(
        "inputs", nargs="*", metavar="IN", help=f"files, folders, or scene:NAME; default {DEFAULT_INPUT}"
    )
    parser.add_argument("-o", "--out", type=Path, required=True, help="folder for table, summary.json and index.html")
    parser.add_argument("--sensor", required=True, help="camera, lidar or radar, with :PRESET")
    parser.add_argument(
        "--weather",
        action="append",
        required=True,
        help="with a list of values: rain:rate=1,5,10,25,50, fog:mor=400,100,30; may be given several times",
    )
    parser.add_argument("--seeds", type=int, default=3, metavar="N", help="storms at every level; default 3")
    parser.add_argument("--seed", type=int, default=0, help="of all storms; default 0")
    add_seed_rule(parser)
    add_no_record(parser)
    parser.add_argument("--metrics", help="names joined by commas; default all that the sensor has")
    parser.add_argument("--table", choices=("csv", "parquet"), default="csv", help="format of the table; default csv")
    parser.add_argument("--size", metavar="WxH", help="of an embedded scene's frame; default half the preset's")
    parser.add_argument("--region", help=f"of clouds and detections: {REGION_HELP}")
    parser.add_argument("--quiet", action="store_true", help="no progress, no notes")
    add_light_arguments(parser)
    parser.add_argument(
        "--allow-guessed-depth",
        action="store_true",
        help='score frames whose depth is guessed too, such as flat ground; the results are headed "depth guessed"',
    )
    parser.add_argument("--ego-speed-m-per-s", type=float, help="of a camera: speed of the vehicle")
    add_depth_arguments(parser)
    add_camera_arguments(parser)
    add_through_mosaic(parser)
    lidar = parser.add_argument_group("lidar", "replaces what the preset says")
    add_lidar_fields(lidar)
    add_reading(lidar)
    add_complete_scan(lidar)
    add_force(lidar)
    lidar.add_argument("--meta", type=Path, metavar="JSON", help="of a .pcap; default the .json of its name")
    add_radar_fields(parser.add_argument_group("radar", "replaces what the preset says"))


def run(args: argparse.Namespace) -> int:
    """Sweep and write."""
    from torchweather.cli.output import note, print_json, print_lines
    from torchweather.cli.run_record import read_runs, record_of, write_run
    from torchweather.evaluation.sweep import parse_levels
    from torchweather.report.sweep_page import write_sweep

    kind, _, preset = args.sensor.partition(":")
    _check(args, kind)
    levels = [level for text in args.weather for level in parse_levels(text)]
    names = None if args.metrics is None else [name.strip() for name in args.metrics.split(",") if name.strip()]
    subjects, sensor, notes = _subjects(args, kind, preset)
    for text in notes:
        note(text, quiet=args.quiet)
    earlier = [] if args.no_record else read_runs(args.out)
    seeds = storm_seeds(args.seed, args.seeds, args.seed_rule)
    summary = write_sweep(
        args.out,
        subjects,
        levels,
        seeds,
        names,
        sensor=sensor,
        table=args.table,
        notes=notes,
        progress=not args.quiet and sys.stderr.isatty(),
    )
    if not args.no_record:
        write_run(args.out, record_of(args, NAME, _recorded(args, subjects, levels, seeds, summary)), earlier)
    if args.json:
        print_json(summary)
    else:
        headed = ["depth guessed"] if summary["depth"] == "guessed" else []
        print_lines("\n".join([*headed, *map(_line, summary["series"]), f"wrote {args.out / 'index.html'}"]))
    return 0


def _recorded(
    args: argparse.Namespace,
    subjects: list[Subject],
    levels: list[Level],
    seeds: list[int],
    summary: dict[str, Any],
) -> dict[str, Any]:
    """Entries of a sweep in the record."""
    sensors: list[Any] = []
    for subject in subjects:
        values = getattr(subject, subject.sensor).to_dict()
        if values not in sensors:
            sensors.append(values)
    return {
        "weather": [level.weather.to_dict() for level in levels],
        "sensors": sensors,
        "seed": args.seed,
        "seed_rule": args.seed_rule,
        "seeds": seeds,
        "options": dict(getattr(subjects[0], "options", {})),
        "depth": args.depth or summary["depth"],
        "inputs": [subject.name for subject in subjects],
        "files": [{"output": str(args.out / name)} for name in (summary["table"], "summary.json", "index.html")],
    }


def _line(series: dict[str, Any]) -> str:
    """A series as text."""
    missing = [name for name, metric in series["metrics"].items() if not metric["follows"]]
    but = f"; not {', '.join(missing)}" if missing else ""
    values = ", ".join(f"{value:g}" for value in series["values"])
    return (
        f"{series['scene']}, {series['weather']}, {series['knob']} {values}: "
        f"{series['expected']} of {series['out_of']} scores get worse at every step{but}"
    )


def _check(args: argparse.Namespace, kind: str) -> None:
    """Refuse an unknown kind of sensor, and arguments of another kind."""
    if kind not in KINDS:
        raise InputValueError(f"sweep: --sensor must be camera, lidar or radar, with :PRESET; got {args.sensor!r}.")
    if args.seeds < 1:
        raise InputValueError(f"sweep: --seeds must be 1 or more; got {args.seeds}.")
    for other in KINDS:
        for name in ARGUMENTS[other]:
            if name not in ARGUMENTS[kind] and getattr(args, name) not in (None, False):
                raise InputValueError(f"sweep: --{name.replace('_', '-')} is for a {other}; the sensor is a {kind}.")


def _subjects(args: argparse.Namespace, kind: str, preset: str) -> tuple[list[Subject], str, list[str]]:
    """Subjects that get the weather, the sensor's name, and notes for the reader."""
    from torchweather.cli import sweep_inputs
    from torchweather.sensors import DEFAULT_PRESETS

    inputs = args.inputs or [DEFAULT_INPUT]
    named = preset or DEFAULT_PRESETS[kind]
    notes = [] if preset else [f"No preset was given: the sensor is {kind}:{named}."]
    scenes = [text for text in inputs if text.startswith(SCENE)]
    files = [Path(text) for text in inputs if not text.startswith(SCENE)]
    if scenes and args.depth is not None:
        raise InputValueError("sweep: --depth belongs to frames of one's own; an embedded scene has its own.")
    if args.size is not None and files:
        raise InputValueError("sweep: --size belongs to embedded scenes; files keep the size they have.")
    make = sweep_inputs.MAKERS[kind](args, named, notes)
    subjects = [make.scene(text.removeprefix(SCENE)) for text in scenes]
    for path in files:
        subjects += make.files(path)
    return subjects, f"{kind}:{named}", list(dict.fromkeys(notes))
