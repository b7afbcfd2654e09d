"""``torchweather apply``: weather on files of images, point clouds and radar detections, each in its own format."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from torchweather.cli.clouds import LIDAR_ARGUMENTS, add_lidar_arguments
from torchweather.cli.detections import RADAR_ARGUMENTS, add_radar_arguments
from torchweather.cli.frame_seeds import add_seed_rule
from torchweather.cli.frames import (
    CAMERA_ARGUMENTS,
    add_camera_arguments,
    add_depth_arguments,
    add_light_arguments,
    add_through_mosaic,
)
from torchweather.cli.output import add_no_fsync
from torchweather.cli.own_vehicle import add_own_vehicle
from torchweather.cli.run_record import add_no_record
from torchweather.core.exceptions import InputValueError

if TYPE_CHECKING:
    from torchweather.atmosphere.weather import Weather
    from torchweather.cli.outcome import Outcome
    from torchweather.recipes.transform import TransformRecipe

NAME = "apply"
SUMMARY = "weather on files of images, point clouds and radar detections"
DESCRIPTION = """Puts a weather on the frames of a camera, a LiDAR or a radar. Of an image, a file with one value
per pixel is a raw Bayer mosaic, a colour file is weathered in linear light. A point cloud is KITTI or WADS .bin,
nuScenes .pcd.bin, .pcd, .ply, .npz, .csv, .las, .laz, or an Ouster .pcap with its .json beside it. Radar detections
are .pcd (nuScenes' or one's own), .npz, .csv or View-of-Delft's .bin; power maps of a radar polar .png, .npy or
.npz. In a video, and in a folder with --sequence, the particles move from frame to frame. Each output keeps the name
and format of its input; each frame of a .pcap becomes a .pcd. It is written whole or not at all. The seed of a frame
is hashed from --seed and the name of its file. A broken file is named and left out. torchweather-record.json records
how each output was made. Exit code 0: all is done; 1: done, but for broken files; 2: a mistake in what was asked, or
no file could be done. With --sensor radar an embedded scene is simulated: scene:test-track, scene:fog-tunnel,
scene:thi-hall or scene:cerema-tunnel. That writes NAME.npz in the weather, NAME_clear.npz in clear air, and NAME.png
with both."""

SCENE = "scene:"  # begins the name of an embedded scene
# What no image is: without --sensor it asks for a LiDAR or a radar.
CLOUDS_ONLY = (".bin", ".pcd", ".ply", ".csv", ".las", ".laz", ".pcap")
KINDS = ("camera", "lidar", "radar")
Work = tuple[Callable[..., None], Callable[[dict[str, Any]], str]]
"""Function that processes the inputs, and the one that describes a result in a line."""
SEQUENCE_ARGUMENTS = ("sequence", "frame_rate_hz")
# By the kind of the sensor: arguments that belong to it, named as they stand in the arguments. Some belong to two.
ARGUMENTS = {
    "camera": (*CAMERA_ARGUMENTS, *SEQUENCE_ARGUMENTS),
    "lidar": (*LIDAR_ARGUMENTS, "own_vehicle"),
    "radar": (*RADAR_ARGUMENTS, "ego_speed_m_per_s", "lost", "labels"),
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.add_argument(
        "inputs", nargs="+", type=Path, metavar="IN", help="images, point clouds, detections, folders, or scene:NAME"
    )
    parser.add_argument(
        "-o", "--out", type=Path, required=True, help="folder for the results; of a sequence also a video, .mp4"
    )
    parser.add_argument("--weather", help="rain:rate=25, fog:mor=30, snow:rate=1, or several joined by +")
    parser.add_argument("--recipe", help="a recipe of kind transform (see torchweather list), or a file of one's own")
    parser.add_argument(
        "--sensor", help="camera, lidar or radar, with :PRESET; default the recipe's, else camera:lucid-triton"
    )
    parser.add_argument("--seed", type=int, default=0, help="default 0")
    add_seed_rule(parser)
    parser.add_argument("--quiet", action="store_true", help="no progress, no notes")
    add_no_record(parser)
    add_no_fsync(parser)
    parser.add_argument(
        "--preview",
        action="store_true",
        help="also write NAME.html: of an image a slider over three severities, of a cloud its points to turn; of a "
        "radar map NAME_preview.png",
    )
    add_light_arguments(parser)
    parser.add_argument(
        "--ego-speed-m-per-s",
        type=_speed,
        metavar="SPEED|FILE",
        help="speed of the vehicle, m/s; a radar's: for --clutter, scenes. Of a sequence also a file of them: a text, "
        "a CSV with the column speed_m_per_s, or a folder of raw KITTI data",
    )
    group = parser.add_argument_group("sequence", "of a camera: a video, or the frames of one drive")
    group.add_argument(
        "--sequence", action="store_true", help="the inputs are successive frames, in which the same particles move"
    )
    group.add_argument(
        "--frame-rate-hz", type=float, help="frames a second; default the video's, or that of KITTI's timestamps.txt"
    )
    add_depth_arguments(parser)
    add_camera_arguments(parser)
    add_through_mosaic(parser)
    add_lidar_arguments(parser)
    add_own_vehicle(parser)
    add_radar_arguments(parser)


def run(args: argparse.Namespace) -> int:
    """Process the files."""
    from torchweather.atmosphere.weather import parse_weather
    from torchweather.cli.outcome import Outcome
    from torchweather.cli.output import print_json, print_lines, shown
    from torchweather.cli.run_record import read_runs
    from torchweather.core.atomic import durable
    from torchweather.recipes import read_recipe

    if args.weather is not None and args.recipe is not None:
        raise InputValueError(
            f"apply: expected --weather or --recipe, which has a weather of its own; got --weather {args.weather} and "
            f"--recipe {args.recipe}. Leave one of them out, or write a recipe with that weather."
        )
    recipe = None if args.recipe is None else read_recipe(args.recipe, "transform")
    if args.weather is not None:
        weather = parse_weather(args.weather)
    elif recipe is not None:
        weather = recipe.build_weather()
    else:
        raise InputValueError("apply: give --weather, such as fog:mor=30, or --recipe (see torchweather list).")
    kind, preset = _sensor(args, recipe)
    process, line = WORK[kind](args)
    recorded = not args.no_record and not _is_video(args.out)
    earlier = read_runs(args.out) if recorded else []
    outcome = Outcome(quiet=args.quiet)
    with durable(not args.no_fsync), ExitStack() as stack:
        if recorded:  # also of a run that is interrupted
            stack.callback(_record, args, weather, outcome, earlier)
        process(args, weather, recipe, preset, outcome)
    if args.json:
        print_json({"files": outcome.done, "broken": outcome.broken, "left_out": outcome.left_out})
    elif outcome.done:
        print_lines("\n".join(line(shown(entry)) for entry in outcome.done))
    return outcome.close()


def _record(args: argparse.Namespace, weather: Weather, outcome: Outcome, earlier: list[dict[str, Any]]) -> None:
    """Write the record of what was done, where anything was."""
    from torchweather.cli.run_record import record_of, write_run

    if outcome.done:
        found = {
            "weather": weather.to_dict(),
            "sensors": outcome.sensors,
            "seed": args.seed,
            "seed_rule": args.seed_rule,
            **outcome.about,
            "files": outcome.done,
            "broken": outcome.broken,
            "left_out": outcome.left_out,
        }
        write_run(args.out, record_of(args, NAME, found), earlier)


def _is_video(path: Path) -> bool:
    """True where the results go into one video, which holds its settings itself."""
    from torchweather.cli.apply_sequence import is_video

    return is_video(path)


def _camera_work(args: argparse.Namespace) -> Work:
    _refuse_scenes(args)
    if not _is_sequence(args):
        _refuse_speed_file(args)
        from torchweather.cli import apply_camera

        return apply_camera.process, apply_camera.line
    if args.preview:
        raise InputValueError("apply: --preview is of single frames; give some of them without --sequence.")
    from torchweather.cli import apply_sequence

    return apply_sequence.process, apply_sequence.line


def _lidar_work(args: argparse.Namespace) -> Work:
    _refuse_scenes(args)
    _refuse_speed_file(args)
    from torchweather.cli import apply_lidar

    return apply_lidar.process, apply_lidar.line


def _radar_work(args: argparse.Namespace) -> Work:
    scenes = _scenes(args)
    if scenes and len(scenes) < len(args.inputs):
        raise InputValueError(f"apply: {scenes[0]} is a scene, other inputs are files; run apply for each.")
    _refuse_speed_file(args)
    if scenes:
        from torchweather.cli import apply_radar_scene

        names = [scene.removeprefix(SCENE) for scene in scenes]
        return partial(apply_radar_scene.process, names=names), apply_radar_scene.line
    from torchweather.cli import apply_radar, apply_radar_map

    if apply_radar_map.has_maps(args):
        return apply_radar_map.process, apply_radar_map.line
    return apply_radar.process, apply_radar.line


WORK: dict[str, Callable[[argparse.Namespace], Work]] = {
    "camera": _camera_work,
    "lidar": _lidar_work,
    "radar": _radar_work,
}
"""By the kind of the sensor."""


def _is_sequence(args: argparse.Namespace) -> bool:
    """Check whether the frames belong together, and the options of a sequence."""
    from torchweather.cli.apply_sequence import is_video

    videos = [path for path in args.inputs if is_video(path)]
    if not args.sequence and not videos:
        if args.frame_rate_hz is not None:
            raise InputValueError("apply: --frame-rate-hz is for a video or --sequence.")
        if is_video(args.out):
            raise InputValueError(
                f"apply: {args.out} is a video; give --sequence if the inputs are frames of one drive."
            )
    return bool(args.sequence or videos)


def _speed(text: str) -> float | Path:
    """A speed in m/s, or the file or folder that holds some."""
    try:
        return float(text)
    except ValueError:
        return Path(text)


def _refuse_speed_file(args: argparse.Namespace) -> None:
    if isinstance(args.ego_speed_m_per_s, Path):
        raise InputValueError(
            f"apply: --ego-speed-m-per-s {args.ego_speed_m_per_s} is a file of speeds, which is for a video or "
            "--sequence; give one number of m/s."
        )


def _scenes(args: argparse.Namespace) -> list[str]:
    """Embedded scenes among the inputs."""
    return [str(path) for path in args.inputs if str(path).startswith(SCENE)]


def _refuse_scenes(args: argparse.Namespace) -> None:
    for scene in _scenes(args):
        raise InputValueError(
            f"apply: {scene} is simulated for a radar; give --sensor radar:PRESET. torchweather demo shows the "
            "embedded scenes as a camera and a LiDAR see them."
        )


def _sensor(args: argparse.Namespace, recipe: TransformRecipe | None) -> tuple[str, str]:
    """Kind and preset of the sensor ('' where none is named); arguments of the other kind are refused."""
    if args.sensor is None:
        kind, preset = ("camera", "") if recipe is None else (recipe.sensor_kind, "")
        clouds = [path for path in args.inputs if path.suffix.lower() in CLOUDS_ONLY]
        if recipe is None and clouds:
            raise InputValueError(
                f"apply: {clouds[0]} is a point cloud; give --sensor lidar:PRESET or radar:PRESET (see torchweather "
                "list)."
            )
    else:
        kind, _, preset = args.sensor.partition(":")
    if kind not in KINDS:
        raise InputValueError(f"apply: --sensor must be camera, lidar or radar, with :PRESET; got {args.sensor!r}.")
    if recipe is not None and recipe.sensor_kind != kind:
        raise InputValueError(f"apply: recipe {recipe.name} is for a {recipe.sensor_kind}; got --sensor {args.sensor}.")
    for other in KINDS:
        for name in ARGUMENTS[other]:
            if name not in ARGUMENTS[kind] and getattr(args, name) not in (None, False):
                raise InputValueError(f"apply: --{name.replace('_', '-')} is for a {other}; the sensor is a {kind}.")
    return kind, preset
