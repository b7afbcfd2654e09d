"""``torchweather demo``: a page that shows the weather on the embedded scene, or on frames of one's own."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

from torchweather.commands.frames import add_camera_arguments, add_depth_arguments

NAME = "demo"
SUMMARY = "a page of pictures and numbers"
DESCRIPTION = """Writes a page with the raw frame of the embedded test track in clear weather and in rain, fog and snow,
with the numbers that say why it looks so, and the same scene as a LiDAR and a radar see it. Given frames of a camera,
it shows these instead."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.add_argument("inputs", nargs="*", type=Path, metavar="IN", help="frames of one's own, raw or RGB")
    parser.add_argument(
        "-o", "--out", type=Path, default=Path("torchweather-demo"), help="folder; default torchweather-demo"
    )
    parser.add_argument("--sensor", default="camera", help="camera, or camera:PRESET")
    parser.add_argument("--lidar", metavar="PRESET", help="that looks at the embedded scene; default ouster-os1-128")
    parser.add_argument("--radar", metavar="PRESET", help="that looks at the embedded scene; default imaging-77ghz")
    parser.add_argument("--seed", type=int, default=0, help="default 0")
    parser.add_argument("--quiet", action="store_true", help="no progress")
    add_depth_arguments(parser)
    add_camera_arguments(parser)


def run(args: argparse.Namespace) -> int:
    """Write the page."""
    from torchweather.commands.output import note, print_json, print_lines
    from torchweather.report.demo import write_demo

    frames, options = _frames(args)
    for text in options.pop("notes"):
        note(text, quiet=args.quiet)
    progress = not args.quiet and sys.stderr.isatty()
    summary = write_demo(args.out, seed=args.seed, images=frames, progress=progress, **options)
    if args.json:
        print_json(summary)
    else:
        print_lines(f"wrote {args.out / 'index.html'}")
    return 0


def _frames(args: argparse.Namespace) -> tuple[list[Path], dict[str, Any]]:
    """Frames of the user's with their depth and camera; none of them for the embedded scene."""
    from torchweather.commands.frames import camera_fields, depth_source, fitted_camera, gathered
    from torchweather.io import read_image
    from torchweather.transforms.recipes import camera_of

    frames = gathered(args.inputs)
    kind, _, preset = args.sensor.partition(":")
    if kind != "camera":
        raise ValueError(f"demo: --sensor must be a camera; got {args.sensor!r}.")
    if not frames and args.depth is not None:
        raise ValueError("demo: --depth belongs to frames; the embedded scene knows its depth.")
    options: dict[str, Any] = {"notes": []}
    for kind_of_preset in ("lidar", "radar"):
        given = getattr(args, kind_of_preset)
        if given is not None:
            if frames:
                raise ValueError(f"demo: --{kind_of_preset} belongs to the embedded scene; frames show no point cloud.")
            options[kind_of_preset] = given.removeprefix(f"{kind_of_preset}:")
    changed = camera_fields(args)
    # Without a word about the camera the page takes its default for each frame, and says so.
    if preset or changed or any(value is not None for value in (args.fx, args.fy, args.cx, args.cy)):
        camera = camera_of({"kind": "camera", "preset": preset or "lucid-triton", **changed})
        height, width = read_image(frames[0])[0].shape[-2:] if frames else (camera.height, camera.width)
        options["camera"], said = fitted_camera(camera, height, width, args)
        options["notes"] += [said] if said else []
    if args.depth is not None:
        options["depth"] = [depth_source(args.depth, args.depth_encoding, frame) for frame in frames]
    return frames, options
