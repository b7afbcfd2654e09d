"""Frames on the command line: which camera took them, how deep their pixels are."""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from torchweather.image import DepthSource
    from torchweather.sensors import Camera

__all__ = [
    "CAMERA_ARGUMENTS",
    "add_camera_arguments",
    "add_depth_arguments",
    "camera_fields",
    "depth_source",
    "fitted_camera",
    "gathered",
]

# All arguments below that belong to a camera.
CAMERA_ARGUMENTS = (
    *("pattern", "bit_depth", "black_level", "white_level", "fx", "fy", "cx", "cy", "exposure_s", "height_m"),
    *("pitch_rad", "depth", "depth_encoding", "airlight", "ego_speed_m_per_s"),
)


def add_camera_arguments(parser: argparse.ArgumentParser) -> None:
    """What is known of the camera beyond its preset."""
    group = parser.add_argument_group("camera", "replaces what the preset says")
    group.add_argument("--pattern", help="colours of the top-left 2 x 2 pixels: RGGB, BGGR, GRBG, GBRG or RCCB")
    group.add_argument("--bit-depth", type=int, help="bits of the raw value")
    group.add_argument("--black-level", type=float, help="raw value of black")
    group.add_argument("--white-level", type=float, help="raw value of saturation; default 2^bits - 1")
    group.add_argument("--fx", type=float, help="focal length, pixels of the frame; default --fy, else the preset's")
    group.add_argument("--fy", type=float, help="focal length, pixels of the frame; default --fx, else the preset's")
    group.add_argument("--cx", type=float, help="principal point, pixels of the frame")
    group.add_argument("--cy", type=float, help="principal point, pixels of the frame")
    group.add_argument("--exposure-s", type=float, help="exposure time, s: it sets the length of the streaks")
    group.add_argument("--height-m", type=float, help="height above the road, m, for --depth ground")
    group.add_argument("--pitch-rad", type=float, help="pitch, rad, positive looks up, for --depth ground")


def add_depth_arguments(parser: argparse.ArgumentParser) -> None:
    """Where the depth comes from."""
    group = parser.add_argument_group("depth")
    group.add_argument(
        "--depth",
        metavar="FILE|DIR|METRES|ground",
        help="a depth map, a folder with one of the same name for each frame, one number of metres, or flat ground "
        "with sky above the horizon (default)",
    )
    group.add_argument(
        "--depth-encoding", help="of integer maps: millimetre, kitti (1/256 m) or carla (24 bits in red, green, blue)"
    )


def camera_fields(args: argparse.Namespace) -> dict[str, Any]:
    """Fields of the camera that the arguments replace, except the intrinsics."""
    given = {
        "bayer_pattern": args.pattern,
        "bit_depth": args.bit_depth,
        "black_level": args.black_level,
        "white_level": args.white_level,
        "exposure_s": args.exposure_s,
        "height_m": args.height_m,
        "pitch_rad": args.pitch_rad,
    }
    return {name: value for name, value in given.items() if value is not None}


def fitted_camera(camera: Camera, height: int, width: int, args: argparse.Namespace) -> tuple[Camera, str]:
    """The camera for frames of this size with the intrinsics that were given, and what to say about it ('' nothing)."""
    said = ""
    if args.fx is not None or args.fy is not None:
        fx = args.fy if args.fx is None else args.fx
        fy = args.fx if args.fy is None else args.fy
        # Without a principal point of its own a frame has its centre.
        camera = replace(camera, width=width, height=height, fx=fx, fy=fy, cx=None, cy=None)
    elif (camera.height, camera.width) != (height, width):
        scaled = camera.resized(width, height)
        said = (
            f"frames of {width} x {height} px: the preset's camera ({camera.width} x {camera.height} px) is scaled to "
            f"them, fx = {scaled.fx:.1f} px, fy = {scaled.fy:.1f} px; give --fx, --fy, --cx, --cy if you know better."
        )
        camera = scaled
    cx, cy = camera.principal_point_px
    return replace(camera, cx=cx if args.cx is None else args.cx, cy=cy if args.cy is None else args.cy), said


def depth_source(text: str, encoding: str | None, frame: Path) -> DepthSource:
    """The depth of a frame from the argument ``--depth``."""
    from torchweather.io.depth_sources import depth_source as found

    return found(text, encoding, frame)


def gathered(inputs: list[Path]) -> list[Path]:
    """The frames: files as they are, of a folder all images in it by name."""
    from torchweather.io import IMAGE_SUFFIXES

    frames: list[Path] = []
    for path in inputs:
        if path.is_dir():
            inside = sorted(file for file in path.iterdir() if file.suffix.lower() in IMAGE_SUFFIXES)
            if not inside:
                raise ValueError(f"{path}: no images; wanted {', '.join(IMAGE_SUFFIXES)}.")
            frames += inside
        elif path.exists():
            frames.append(path)
        else:
            raise ValueError(f"{path}: no such file.")
    return frames
