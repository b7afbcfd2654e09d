"""Frames of a study in files as sensors record them: point clouds and images, read when they are asked for."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from torchweather.camera.bayer import mosaic
from torchweather.camera.levels import raw_to_linear
from torchweather.camera.sensor import Camera
from torchweather.camera.tone import normalise, srgb_decode
from torchweather.core.errors import TorchweatherError, TorchweatherWarning
from torchweather.gap.study.checks import numbers
from torchweather.gap.study.frames import Frame
from torchweather.gap.study.scan_grid import DirectionMean, organised_frame, scan_frame
from torchweather.io import read_image, read_sensor_points
from torchweather.io.depth_maps import map_source
from torchweather.lidar.scan import scan_directions
from torchweather.lidar.sensor import Lidar

__all__ = ["CloudFile", "ImageFile", "beam_directions", "even_camera", "shared_depth"]


@dataclass(frozen=True)
class CloudFile:
    """A frame in a file of points: an organised cloud as it stands, any other on the sensor's scan pattern."""

    path: Path
    lidar: Lidar

    def __call__(self) -> Frame:
        """``range_m`` and ``intensity`` of each beam."""
        cloud = read_sensor_points(self.path, self.lidar)
        if cloud.grid is not None:
            return organised_frame(cloud, self.lidar)
        return scan_frame(cloud, self.lidar, str(self.path))[0]

    def __str__(self) -> str:
        return str(self.path)


@dataclass(frozen=True)
class ImageFile:
    """A frame in an image file: a raw mosaic by the camera's levels, a colour image by sRGB and the filter array.

    Noise below black is cut, and a last row or column of odd size is dropped.
    """

    path: Path
    camera: Camera

    def __call__(self) -> Frame:
        """``bayer``, linear, black at 0, saturation at 1."""
        image, info = read_image(self.path)
        size = (self.camera.height, self.camera.width)
        if image.ndim != 3 or tuple(image.shape[-2:]) != size:
            raise TorchweatherError(
                f"{self.path}: the image must have the camera's size, {size[0]} x {size[1]} px; got "
                f"{tuple(image.shape[-2:])}. Use camera.resized(width, height) for scaled images."
            )
        image = image[..., : size[0] - size[0] % 2, : size[1] - size[1] % 2]
        try:
            if info.kind == "rgb":
                linear = mosaic(srgb_decode(normalise(image)), self.camera.bayer_pattern)
            else:
                linear = raw_to_linear(image, self.camera, "ImageFile")
        except (TypeError, ValueError) as error:
            raise TorchweatherError(f"{self.path}: {error}") from error
        return {"bayer": linear[0].clamp(0.0, 1.0).numpy()}

    def __str__(self) -> str:
        return str(self.path)


def even_camera(camera: Camera) -> Camera:
    """The camera without a last row or column of odd size."""
    return camera.cropped(0, 0, camera.height - camera.height % 2, camera.width - camera.width % 2)


def shared_depth(given: Any, encoding: str | None, camera: Camera, name: str) -> Frame:
    """``depth_m`` of a scene, of the size of `even_camera`, from a file, a number of metres or an array."""
    if given is None:
        raise TorchweatherError(f"{name} is missing: a camera study needs metres along the axis, inf for sky.")
    if isinstance(given, (str, Path)):
        depth = map_source(Path(given), encoding)(camera, camera.height, camera.width).squeeze(0).numpy()
    elif isinstance(given, (int, float)):
        depth = np.full((camera.height, camera.width), float(given), dtype=np.float32)
    else:
        depth = numbers(given, name)
        depth = depth[0] if depth.ndim == 3 and len(depth) == 1 else depth
    if depth.shape != (camera.height, camera.width):
        raise TorchweatherError(
            f"{name} must have the camera's size (H, W) = ({camera.height}, {camera.width}); got {depth.shape}."
        )
    even = even_camera(camera)
    return {"depth_m": depth[: even.height, : even.width]}


def beam_directions(
    files: Sequence[Path], lidar: Lidar, directions: NDArray[Any] | Tensor | None, owner: str
) -> NDArray[Any]:
    """``(H, W, 3)`` of the beams of all files, which are read once for it; warns how many points are lost.

    Args:
        files: of all frames of the study.
        lidar: the sensor.
        directions: of organised clouds; ``None`` takes the mean of each cell's returns.
        owner: who complains.
    """
    first: tuple[int, int] | None = None
    lost = total = 0
    mean: DirectionMean | None = None
    for place, path in enumerate(files):
        cloud = read_sensor_points(path, lidar)
        if place and cloud.grid != first:
            raise TorchweatherError(
                f"{path}: all clouds must have one grid, {first or 'none (unorganised)'} as {files[0]}; "
                f"got {cloud.grid}."
            )
        if cloud.grid is not None:
            first = cloud.grid
            mean = mean or DirectionMean(cloud.grid)
            mean.update(cloud, lidar)
        else:
            frame, missed = scan_frame(cloud, lidar, str(path))
            lost += missed
            total += missed + int(np.count_nonzero(frame["range_m"]))
    if lost:
        warnings.warn(
            f"{owner}: {lost} of {total} points ({100 * lost / total:.1f} %) share a beam of the scan pattern "
            f"{len(lidar.elevations_deg or ())} x {lidar.columns} with another one and are dropped. Many: the sensor, "
            "its columns per turn or its ring_column are others, or the clouds hold two returns per beam.",
            TorchweatherWarning,
            stacklevel=4,
        )
    if mean is not None:
        return mean.compute(owner) if directions is None else numbers(directions, f"{owner}: directions")
    if directions is not None:
        raise TorchweatherError(f"{owner}: directions belong to organised clouds; these have none. Leave them out.")
    pattern: NDArray[Any] = scan_directions(lidar, dtype=torch.float64).numpy()
    return pattern.reshape(len(lidar.elevations_deg or ()), -1, 3)
