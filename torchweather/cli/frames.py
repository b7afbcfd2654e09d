"""Frames on the command line: which camera took them, how deep their pixels are."""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from torchweather.core.exceptions import InputValueError

if TYPE_CHECKING:
    from torchweather.camera.sensor import Camera
    from torchweather.camera.sensor_fit import CameraFit
    from torchweather.image.depth import DepthSource

__all__ = [
    "CAMERA_ARGUMENTS",
    "add_camera_arguments",
    "add_depth_arguments",
    "add_light_arguments",
    "add_through_mosaic",
    "camera_fields",
    "camera_options",
    "depth_source",
    "fitted_camera",
    "gathered",
]

# All arguments below that belong to a camera.
CAMERA_ARGUMENTS = (
    *("camera", "camera_name", "pattern", "bit_depth", "black_level", "white_level", "fx", "fy", "cx", "cy"),
    *("exposure_s", "height_m", "pitch_rad", "depth", "depth_encoding", "airlight", "exposure_control", "scattering"),
    "night",
    *("ego_speed_m_per_s", "depth_along", "baseline_m", "calib", "depth_model", "depth_model_output"),
    *("depth_model_scale", "depth_model_multiple_px", "through_mosaic"),
)


def add_light_arguments(parser: argparse.ArgumentParser) -> None:
    """Light of the sky, and what the camera makes of it."""
    parser.add_argument(
        "--airlight",
        nargs=3,
        type=float,
        metavar=("R", "G", "B"),
        help="of a camera: linear signal of the sky, 0..1 of saturation; default the frame's own",
    )
    parser.add_argument(
        "--exposure-control",
        choices=("mean", "median"),
        help="of a camera: give frames in weather the mean or median signal of the clear ones, as cameras do",
    )
    parser.add_argument(
        "--night",
        choices=("low_beam", "high_beam", "none"),
        help="of a camera: the frames were taken at night, with these headlamps of the own car; lamps light fog, drops "
        "and flakes, and glow",
    )
    parser.add_argument(
        "--scattering",
        choices=("single", "multiple"),
        help="of a camera's fog: multiple adds the light that dense fog scatters onward, blurred; default single",
    )


def camera_options(args: argparse.Namespace, ego_speed_m_per_s: float | None) -> dict[str, Any]:
    """Options of a camera's transform that were given."""
    given = {
        "airlight": args.airlight,
        "exposure_control": args.exposure_control,
        "scattering": args.scattering,
        "night": None if args.night is None else {"own": args.night},
        "ego_speed_m_per_s": ego_speed_m_per_s,
    }
    return {name: value for name, value in given.items() if value is not None}


def add_camera_arguments(parser: argparse.ArgumentParser) -> None:
    """Add arguments on the camera beyond its preset."""
    group = parser.add_argument_group("camera", "replaces what the preset says")
    group.add_argument(
        "--camera",
        metavar="FILE",
        type=Path,
        help="a calibration: KITTI's text, nuScenes' json, YAML of OpenCV or ROS, COLMAP's cameras.txt",
    )
    group.add_argument(
        "--camera-name", metavar="NAME", help="of the camera where FILE holds several: CAM_BACK, P3, a number"
    )
    group.add_argument("--pattern", help="colours of the top-left 2 x 2 pixels: RGGB, BGGR, GRBG, GBRG or RCCB")
    group.add_argument("--bit-depth", type=int, help="bits of the raw value")
    group.add_argument("--black-level", type=float, help="raw value of black")
    group.add_argument("--white-level", type=float, help="raw value of saturation; default 2^bits - 1")
    group.add_argument(
        "--fx",
        type=float,
        help="focal length, pixels of the frame; default --fy, else --camera's, else from the frame's EXIF, else the "
        "preset's",
    )
    group.add_argument("--fy", type=float, help="focal length, pixels of the frame; default --fx, else as --fx")
    group.add_argument("--cx", type=float, help="principal point, pixels of the frame")
    group.add_argument("--cy", type=float, help="principal point, pixels of the frame")
    group.add_argument("--exposure-s", type=float, help="exposure time, s: it sets the length of the streaks")
    group.add_argument("--height-m", type=float, help="height above the road, m, for --depth ground")
    group.add_argument("--pitch-rad", type=float, help="pitch, rad, positive looks up, for --depth ground")


def add_through_mosaic(parser: argparse.ArgumentParser) -> None:
    """The argument that takes colour images through the camera's mosaic."""
    parser.add_argument(
        "--through-mosaic",
        action="store_true",
        help="take colour images, clear ones too, through the camera's mosaic and back: the sensor's own loss",
    )


def add_depth_arguments(parser: argparse.ArgumentParser) -> None:
    """Where the depth comes from."""
    group = parser.add_argument_group("depth")
    group.add_argument(
        "--depth",
        metavar="FILE|DIR|METRES|ground|auto",
        help="a depth map, or with --calib a LiDAR cloud; a folder with one of the same name for each frame; one "
        "number of metres; flat ground with sky above the horizon (default of raw frames); or guessed from the "
        "picture: ground, side walls, sky (default of photographs). Pixels of a map without a value are completed",
    )
    group.add_argument(
        "--depth-encoding",
        help="of depth maps: metre (default of floats), centimetre, millimetre, kitti (1/256 m), carla (24 bits in "
        "red, green, blue), disparity (pixels), disparity_kitti (1/256 pixel); 0 and NaN are unknown",
    )
    group.add_argument(
        "--depth-along",
        choices=("axis", "ray"),
        help="direction of a map's metres: along the optical axis (default), or along each pixel's ray",
    )
    group.add_argument("--baseline-m", type=float, help="of a disparity: distance of the two lenses, m")
    group.add_argument(
        "--calib",
        metavar="FILE|DIR",
        type=Path,
        help="of a LiDAR cloud: the way to the camera, KITTI's object calibration or nuScenes' json; a folder has one "
        "of the same name for each frame",
    )
    group.add_argument(
        "--depth-model", metavar="ONNX", type=Path, help="a depth network for RGB frames, run on the CPU"
    )
    group.add_argument(
        "--depth-model-output",
        choices=("depth", "inverse_depth", "disparity"),
        help="of the network: depth (default), inverse depth, or a stereo pair's disparity in pixels",
    )
    group.add_argument(
        "--depth-model-scale",
        choices=("metric", "ground", "lidar"),
        help="of the network's output: metres (default), or unknown and found from flat ground below the camera, or "
        "from the cloud or sparse map of --depth",
    )
    group.add_argument(
        "--depth-model-multiple-px",
        type=int,
        help="where the network takes any size: what height and width must be multiples of; default 14",
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


def fitted_camera(
    camera: Camera, height: int, width: int, args: argparse.Namespace, *, frame: Path | None = None
) -> tuple[Camera, str]:
    """The camera for frames of this size, and what to say about it ('' nothing).

    The intrinsics come from the first of these that is there: ``--fx``/``--fy``; the file of ``--camera``; the EXIF
    tags of the frame; the preset, fitted to the size with square pixels. ``--cx`` and ``--cy`` replace one number.

    Args:
        camera: the preset with the fields that the arguments replaced.
        height, width: of the frames, pixels.
        args: with the arguments of `add_camera_arguments`.
        frame: the file of the frame, for its EXIF tags, and its calibration in a folder of ``--calib``.
    """
    args = _with_calibration(args, frame)
    said = ""
    if getattr(args, "camera", None) is not None:
        camera, said = _calibrated(camera, height, width, args)
        fx, fy = (camera.fx, camera.fy) if args.fx is None and args.fy is None else _focal(args)
        camera = replace(camera, fx=fx, fy=fy)
    elif args.fx is not None or args.fy is not None:
        fx, fy = _focal(args)
        # Without a principal point of its own a frame has its centre.
        camera = replace(camera, width=width, height=height, fx=fx, fy=fy, cx=None, cy=None)
    else:
        camera, said = _photographed(camera, height, width, frame)
    cx, cy = camera.principal_point_px
    return replace(camera, cx=cx if args.cx is None else args.cx, cy=cy if args.cy is None else args.cy), said


def _with_calibration(args: argparse.Namespace, frame: Path | None) -> argparse.Namespace:
    """The arguments with the camera of ``--calib``, where nothing else gives the intrinsics."""
    calibration = getattr(args, "calib", None)
    given = any(getattr(args, name, None) is not None for name in ("camera", "fx", "fy"))
    if given or calibration is None or frame is None:
        return args
    from torchweather.datasets.depth_clouds import calibration_file, frame_camera_name

    named = args.camera_name or frame_camera_name(frame)
    return argparse.Namespace(**{**vars(args), "camera": calibration_file(calibration, frame), "camera_name": named})


def _focal(args: argparse.Namespace) -> tuple[float, float]:
    """fx and fy as given; one of them stands for both."""
    return (args.fy if args.fx is None else args.fx, args.fx if args.fy is None else args.fy)


def _calibrated(camera: Camera, height: int, width: int, args: argparse.Namespace) -> tuple[Camera, str]:
    """The preset with the lens of a calibration file, and with its mounting where the arguments give none."""
    from torchweather.camera.sensor_fit import without_distortion
    from torchweather.datasets.camera_files import read_camera_fields

    fields = read_camera_fields(args.camera, width=width, height=height, name=getattr(args, "camera_name", None))
    for name in ("height_m", "pitch_rad"):
        if getattr(args, name, None) is not None:
            fields.pop(name, None)
    calibrated = replace(without_distortion(camera), **fields)
    lens = ", lens distortion" if calibrated.distorted else ""
    return calibrated, (
        f"frames of {width} x {height} px: fx = {calibrated.fx:.1f} px, fy = {calibrated.fy:.1f} px{lens} from "
        f"{args.camera}."
    )


def _photographed(camera: Camera, height: int, width: int, frame: Path | None) -> tuple[Camera, str]:
    """The camera by the EXIF tags of the frame, else the preset's fitted to it."""
    from torchweather.camera.sensor_fit import fit_camera, without_distortion
    from torchweather.io.exif import read_exif_focal

    found = None if frame is None else read_exif_focal(frame, width, height)
    if found is not None and found.focal_px is not None:
        focal = found.focal_px
        photographed = replace(camera, width=width, height=height, fx=focal, fy=focal, cx=None, cy=None)
        # The preset's distortion is of another lens.
        return without_distortion(photographed), (
            f"frames of {width} x {height} px: fx = fy = {focal:.1f} px from their EXIF ({found.evidence}); --fx or "
            "--camera replaces it."
        )
    fit = fit_camera(camera, width, height)
    why = "" if found is None else f" ({found.evidence})"
    return fit.camera, _fit_note(camera, fit, why)


# A pinhole of more than 4:1 is unlikely: KITTI's frames, the widest of driving data sets, have 3.3:1.
_PANORAMA = 4.0


def _fit_note(camera: Camera, fit: CameraFit, why: str) -> str:
    """Note on changes of the preset's camera; '' where there are none."""
    fitted = fit.camera
    if fit.how == "same":
        return ""
    size = (
        f"frames of {fitted.width} x {fitted.height} px{why}: the preset's camera ({camera.width} x {camera.height} px)"
    )
    advice = "give --camera or --fx if you know better."
    if fit.how == "scaled":
        return f"{size} is scaled to them, fx = {fitted.fx:.1f} px, fy = {fitted.fy:.1f} px; {advice}"
    kept = (
        "keeps the view along its longer side, turned by a quarter"
        if fit.how == "turned"
        else f"keeps its horizontal view of {fit.horizontal_view_deg:.1f} degrees, its vertical one is {fit.how}"
    )
    lens = "; its lens distortion is left out" if camera.distorted and not fitted.distorted else ""
    wide = max(fitted.width, fitted.height) > _PANORAMA * min(fitted.width, fitted.height)
    panorama = " A panorama is no pinhole: its rays are wrong away from the centre." if wide else ""
    return f"{size} {kept}, square pixels, fx = fy = {fitted.fx:.1f} px{lens}; {advice}{panorama}"


def depth_source(
    text: str, encoding: str | None, frame: Path, *, args: argparse.Namespace | None = None
) -> DepthSource:
    """The depth of a frame from the arguments of `add_depth_arguments`.

    Args:
        text: of ``--depth``, or its default.
        encoding: of ``--depth-encoding``.
        frame: path of the image.
        args: all arguments; ``None`` leaves the others at their defaults.
    """
    from torchweather.datasets.depth_sources import depth_source as found

    given = vars(args) if args is not None else {}
    return found(
        text,
        encoding,
        frame,
        along=given.get("depth_along"),
        baseline_m=given.get("baseline_m"),
        calibration=given.get("calib"),
        camera_name=given.get("camera_name"),
        model=given.get("depth_model"),
        model_output=given.get("depth_model_output"),
        model_scale=given.get("depth_model_scale"),
        model_multiple_px=given.get("depth_model_multiple_px"),
    )


def gathered(inputs: list[Path]) -> list[Path]:
    """The frames: files as they are, of a folder all images in it by name, except dot files."""
    from torchweather.io import IMAGE_SUFFIXES

    frames: list[Path] = []
    for path in inputs:
        if path.is_dir():
            inside = sorted(
                # ._0.png is what macOS writes beside 0.png on other disks.
                file
                for file in path.iterdir()
                if file.suffix.lower() in IMAGE_SUFFIXES and not file.name.startswith(".")
            )
            if not inside:
                raise InputValueError(f"{path}: no images; expected {', '.join(IMAGE_SUFFIXES)}.")
            frames += inside
        elif path.exists():
            frames.append(path)
        else:
            raise InputValueError(f"{path}: no such file.")
    return frames
