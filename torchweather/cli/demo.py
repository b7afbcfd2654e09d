"""``torchweather demo``: a page that shows the weather on the embedded scene, or on frames of one's own."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from torchweather.cli.frames import add_camera_arguments, add_depth_arguments
from torchweather.cli.sensor_text import preset_named
from torchweather.core.exceptions import InputValueError

if TYPE_CHECKING:
    from torchweather.report.photo_demo import Photo

DEFAULT_CAMERA = "lucid-triton"
NAME = "demo"
SUMMARY = "a page of pictures and numbers"
DESCRIPTION = """Writes a page with the raw frame of the embedded test track in clear weather and in rain, fog and
snow. The page has the numbers behind each picture, and the same scene as a LiDAR and a radar see it. Given raw
frames of a camera, it shows these instead. Given photographs, it writes a page with a slider between each photograph
and the same in fog, rain and snow of several severities. Nothing opens without --open."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.add_argument("inputs", nargs="*", type=Path, metavar="IN", help="photographs, or raw frames, of one's own")
    parser.add_argument(
        "-o", "--out", type=Path, default=Path("torchweather-demo"), help="folder; default torchweather-demo"
    )
    parser.add_argument("--sensor", default="camera", help="camera, or camera:PRESET")
    parser.add_argument("--lidar", metavar="PRESET", help="that looks at the embedded scene; default ouster-os1-128")
    parser.add_argument("--radar", metavar="PRESET", help="that looks at the embedded scene; default imaging-77ghz")
    parser.add_argument("--seed", type=int, default=0, help="default 0")
    parser.add_argument("--open", action="store_true", help="open the page in the browser")
    parser.add_argument("--quiet", action="store_true", help="no progress")
    add_depth_arguments(parser)
    add_camera_arguments(parser)


def run(args: argparse.Namespace) -> int:
    """Write the page."""
    from torchweather.cli.output import note, print_json, print_lines

    frames = _gathered(args)
    progress = not args.quiet and sys.stderr.isatty()
    if _are_photographs(frames):
        from torchweather.report.photo_demo import write_photo_demo

        photos = [_photo(path, args) for path in frames]
        for text in dict.fromkeys(text for photo in photos for text in photo.notes):
            note(text, quiet=args.quiet)
        summary = write_photo_demo(args.out, photos, seed=args.seed, progress=progress)
    else:
        from torchweather.report.demo import write_demo

        options = _options(frames, args)
        for text in options.pop("notes"):
            note(text, quiet=args.quiet)
        summary = write_demo(args.out, seed=args.seed, images=frames, progress=progress, **options)
    if args.json:
        print_json(summary)
    else:
        print_lines(f"wrote {args.out / 'index.html'}")
    if args.open:
        from torchweather.cli.view import open_page

        open_page(args.out / "index.html")
    return 0


def _gathered(args: argparse.Namespace) -> list[Path]:
    """Frames of the user's, none for the embedded scene; arguments that do not belong to them are refused."""
    from torchweather.cli.frames import gathered

    frames = gathered(args.inputs)
    preset_named(args.sensor, "camera", "demo: --sensor must be a camera")
    if not frames and args.depth is not None:
        raise InputValueError("demo: --depth belongs to frames; the embedded scene has its own.")
    for name in ("lidar", "radar"):
        if frames and getattr(args, name) is not None:
            raise InputValueError(f"demo: --{name} belongs to the embedded scene; frames show no point cloud.")
    return frames


def _are_photographs(frames: list[Path]) -> bool:
    """True for colour images, False for raw mosaics and for none; a mix is refused."""
    from torchweather.io import read_image

    kinds = {path: read_image(path)[1].kind for path in frames}
    if len(set(kinds.values())) > 1:
        colour, raw = (next(path for path in frames if kinds[path] == kind) for kind in ("rgb", "mosaic"))
        raise InputValueError(
            f"demo: {colour} is a colour image, {raw} a raw frame or a grey image; each has a page of its own. "
            "Run demo once for each."
        )
    return "rgb" in kinds.values()


def _photo(path: Path, args: argparse.Namespace) -> Photo:
    """A photograph with its camera and depth."""
    from torchweather.camera.depth import AUTO
    from torchweather.cli.frames import camera_fields, depth_source, fitted_camera
    from torchweather.io import read_image
    from torchweather.recipes.transform import camera_of
    from torchweather.report.photo_demo import Photo

    rgb, _ = read_image(path)
    preset = args.sensor.partition(":")[2]
    camera = camera_of({"kind": "camera", "preset": preset or DEFAULT_CAMERA, **camera_fields(args)})
    camera, said = fitted_camera(camera, rgb.shape[-2], rgb.shape[-1], args, frame=path)
    notes = [said[:1].upper() + said[1:]] if said else []
    assumed = []
    if args.exposure_s is None:
        assumed.append(f"exposure {camera.exposure_s * 1e3:g} ms, which sets the length of streaks")
    if args.height_m is None and args.camera is None:
        assumed.append(f"{camera.height_m:g} m above the road")
    if assumed:
        notes.append(f"From the preset camera:{preset or DEFAULT_CAMERA}: {', '.join(assumed)}.")
    depth = (
        None
        if args.depth is None and args.depth_model is None
        else depth_source(args.depth or AUTO, args.depth_encoding, path, args=args)
    )
    return Photo(path, rgb, camera, depth, notes)


def _options(frames: list[Path], args: argparse.Namespace) -> dict[str, Any]:
    """Camera, depth and sensors for the page of raw frames or of the embedded scene."""
    from torchweather.cli.frames import camera_fields, depth_source, fitted_camera
    from torchweather.datasets.depth_sources import GROUND
    from torchweather.io import read_image
    from torchweather.recipes.transform import camera_of

    preset = args.sensor.partition(":")[2]
    options: dict[str, Any] = {"notes": []}
    for kind in ("lidar", "radar"):
        if getattr(args, kind) is not None:
            options[kind] = getattr(args, kind).removeprefix(f"{kind}:")
    changed = camera_fields(args)
    # Without a word about the camera the page takes its default for each frame, and says so.
    if preset or changed or any(value is not None for value in (args.camera, args.fx, args.fy, args.cx, args.cy)):
        camera = camera_of({"kind": "camera", "preset": preset or DEFAULT_CAMERA, **changed})
        height, width = read_image(frames[0])[0].shape[-2:] if frames else (camera.height, camera.width)
        options["camera"], said = fitted_camera(camera, height, width, args)
        options["notes"] += [said] if said else []
    if args.depth is not None or args.depth_model is not None:
        options["depth"] = [
            depth_source(args.depth or GROUND, args.depth_encoding, frame, args=args) for frame in frames
        ]
    return options
