"""The depth of a frame as it is named on the command line."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from torchweather.camera.depth import AUTO, ConstantDepth, DepthSource, FlatGround, ScenePrior
from torchweather.camera.depth.completion_scene import CompletedSource
from torchweather.camera.depth.network import DepthNetwork
from torchweather.core.errors import InputValueError
from torchweather.datasets.depth_clouds import cloud_file, cloud_source, is_cloud
from torchweather.io.depth_maps import map_source

__all__ = ["GROUND", "depth_source"]

GROUND = "ground"
DEPTH_SUFFIXES = (".npy", ".npz", ".png", ".tif", ".tiff", ".pfm")


def depth_source(
    text: str,
    encoding: str | None,
    frame: Path,
    *,
    along: str | None = None,
    baseline_m: float | None = None,
    calibration: Path | None = None,
    camera_name: str | None = None,
    model: Path | None = None,
    model_output: str | None = None,
    model_scale: str | None = None,
    model_multiple_px: int | None = None,
) -> DepthSource:
    """The depth of a frame.

    Args:
        text: a map or a cloud of points; a folder with one of the frame's name; one number of metres; ``ground``; or
            ``auto``: guessed from the picture. With a network that needs no points: ``ground`` or ``auto``.
        encoding: of maps, as `read_depth` takes it.
        frame: path of the image.
        along: ``axis`` (default) or ``ray``: the direction of a map's metres.
        baseline_m: of a stereo pair whose disparity the map is, or a metric network's output, metres.
        calibration: file or folder that leads from the LiDAR of a cloud to the camera.
        camera_name: of the camera in a calibration of several.
        model: ONNX file of a depth network, in place of what ``text`` names.
        model_output: as `DepthNetwork.output`; default ``depth``.
        model_scale: ``metric`` (default), ``ground``, or ``lidar``: from the cloud or sparse map that ``text`` names.
        model_multiple_px: as `DepthNetwork.multiple_px`.

    Returns:
        `DepthMap` of a map without unknown pixels; maps with some, and clouds, are completed.

    Example:
        >>> depth_source("30", None, Path("0001.png"))
        ConstantDepth(depth_m=30.0)
    """
    if model is None:
        for option, value in (("output", model_output), ("scale", model_scale), ("multiple-px", model_multiple_px)):
            if value is not None:
                raise InputValueError(f"--depth-model-{option} belongs to --depth-model ONNX; give the network.")
        return _named(text, encoding, frame, along, baseline_m, calibration, camera_name)
    scale: str | CompletedSource = model_scale or "metric"
    if scale == "lidar":
        measured = _named(text, encoding, frame, along, None, calibration, camera_name)
        if not isinstance(measured, CompletedSource):
            raise InputValueError(
                "--depth-model-scale lidar needs measured points: --depth CLOUD with --calib FILE, or a map along the "
                f"axis with unknown pixels; got --depth {text}."
            )
        scale = measured
    elif text not in (AUTO, GROUND):
        raise InputValueError(
            f"--depth {text} and --depth-model {model} both give the depth; leave one out, or scale the network by the "
            "cloud or sparse map: --depth-model-scale lidar."
        )
    else:
        _only_maps({"--depth-along": along, "--depth-encoding": encoding, "--calib": calibration}, f"network {model}")
    return DepthNetwork(
        model,
        output=model_output or "depth",
        scale=scale,
        multiple_px=DepthNetwork.multiple_px if model_multiple_px is None else model_multiple_px,
        baseline_m=baseline_m,
    )


def _named(
    text: str,
    encoding: str | None,
    frame: Path,
    along: str | None,
    baseline_m: float | None,
    calibration: Path | None,
    camera_name: str | None,
) -> DepthSource:
    """The depth that ``--depth`` names."""
    of_maps = {"--depth-along": along, "--baseline-m": baseline_m, "--depth-encoding": encoding}
    without_file = _without_file(text)
    if without_file is not None:
        _only_maps({**of_maps, "--calib": calibration}, f"--depth {text}")
        return without_file
    path = Path(text)
    calibrated = calibration is not None
    if path.is_dir():
        path = _same_name(path, frame, calibrated)
    elif not path.exists():
        raise InputValueError(
            f"--depth must be a file, a folder, a number of metres, {GROUND!r} or {AUTO!r}; got {text!r}, and no such "
            "file exists."
        )
    if is_cloud(path, calibrated=calibrated):
        _only_maps(of_maps, f"cloud {path}")
        return cloud_source(path, calibration, frame, name=camera_name)
    return map_source(path, encoding, along=along or "axis", baseline_m=baseline_m)


def _only_maps(options: Mapping[str, object], got: str) -> None:
    """Raise where an option of depth files was given with something else."""
    for option, value in options.items():
        if value is not None:
            of = "LiDAR cloud" if option == "--calib" else "depth map"
            raise InputValueError(f"{option} belongs to a {of} in a file, named by --depth; got the depth of {got}.")


def _without_file(text: str) -> DepthSource | None:
    if text == GROUND:
        return FlatGround()
    if text == AUTO:
        return ScenePrior()
    try:
        return ConstantDepth(float(text))
    except ValueError as error:
        if "could not convert" not in str(error):
            raise
    return None


def _same_name(folder: Path, frame: Path, calibrated: bool) -> Path:
    """The map or cloud of a frame; with a calibration the cloud, where both are there."""
    cloud = cloud_file(folder, frame, calibrated=calibrated)
    if calibrated and cloud is not None:
        return cloud
    for suffix in DEPTH_SUFFIXES:
        found = folder / (frame.stem + suffix)
        if found.is_file():
            return found
    if cloud is not None:
        return cloud
    clouds = " or a cloud of that name" if calibrated else ""
    raise InputValueError(
        f"{folder}: no depth map for {frame.name}; expected {frame.stem} with {', '.join(DEPTH_SUFFIXES)}{clouds}."
    )
