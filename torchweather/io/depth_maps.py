"""Depth maps of files as depth sources: whole ones, ones with unknown pixels, along the ray, disparity."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import ClassVar

import torch
from torch import Tensor

from torchweather.camera.depth import (
    COMPLETED,
    EXACT,
    MEASURED,
    CompletedDepthMap,
    DepthMap,
    DepthSource,
    SceneDepth,
    along_ray_to_axis,
    depth_from_disparity,
)
from torchweather.camera.depth.source import SceneSource
from torchweather.camera.sensor import Camera
from torchweather.core.errors import InputValueError, TorchweatherError, check_one_of, check_positive
from torchweather.io.depth import DISPARITY_ENCODINGS, read_depth, read_disparity
from torchweather.io.depth_plausible import check_plausible

__all__ = ["ALONG", "ConvertedDepth", "PartlyKnownDepth", "map_source"]

ALONG = ("axis", "ray")
"""Directions in which a map's metres count: along the optical axis, or along each pixel's ray."""
# A stereo matcher fills 90 % and more of the road; a LiDAR of 64 beams about 6 % of the picture.
_MEASURED_SHARE = 0.9


def map_source(
    path: Path, encoding: str | None = None, *, along: str = "axis", baseline_m: float | None = None
) -> DepthSource:
    """The depth source of a map in a file.

    Args:
        path: as of `read_depth`.
        encoding: as of `read_depth`.
        along: ``axis`` or ``ray``.
        baseline_m: distance between the two lenses, metres, of ``disparity`` and ``disparity_kitti``; the focal length
            is the camera's.

    Returns:
        `DepthMap` where every pixel has a value (``exact``); else a source that completes the unknown ones.

    Raises:
        TorchweatherError: the file is broken, or no pixel has a value.
    """
    check_one_of("along", along, ALONG, owner="map_source")
    if encoding in DISPARITY_ENCODINGS:
        if baseline_m is None:
            raise InputValueError(
                f"{path}: encoding {encoding!r} needs the baseline of the stereo pair: --baseline-m METRES "
                "(0.54 for KITTI). The focal length is the camera's."
            )
        if along == "ray":
            raise InputValueError(f"{path}: a disparity gives depth along the axis; leave --depth-along ray out.")
        check_positive("baseline_m", baseline_m, unit="m", owner="map_source")
        disparity_px = read_disparity(path, encoding)
        _refuse_unknown(torch.isfinite(disparity_px), path, encoding)
        return ConvertedDepth(disparity_px, str(path), encoding=str(encoding), baseline_m=float(baseline_m))
    if baseline_m is not None:
        raise InputValueError(
            f"{path}: --baseline-m belongs to --depth-encoding disparity or disparity_kitti; got "
            f"{encoding or 'float metres'}."
        )
    depth_m = read_depth(path, encoding)
    unknown = depth_m.isnan()
    if bool(unknown.any()):
        _refuse_unknown(torch.isfinite(depth_m), path, encoding)
    if along == "ray":
        return ConvertedDepth(depth_m, str(path), encoding=encoding)
    return PartlyKnownDepth(depth_m) if bool(unknown.any()) else DepthMap(depth_m)


def _refuse_unknown(known: Tensor, path: Path, encoding: str | None) -> None:
    if not bool(known.flatten(-3).any(-1).all()):
        raise TorchweatherError(
            f"{path}: no pixel of the map has a depth (encoding {encoding or 'float metres'}; 0, NaN and -inf are "
            "unknown, inf is sky). Without any measurement give --depth auto, or a depth network: --depth-model."
        )


@dataclasses.dataclass(frozen=True, eq=False)
class PartlyKnownDepth(CompletedDepthMap):
    """A completed map that counts as ``measured`` where nearly all of the scene has a value.

    Its attribute ``confidence`` is ``completed``, the surest word without the camera. `scene` knows the horizon: with a
    value in more than 90 % of the pixels below it, the scene's word is ``measured``.

    Args:
        depth_m: as of `CompletedDepthMap`.
        sky: as of `CompletedDepthMap`.
        upper_edge_rad: as of `CompletedDepthMap`.
    """

    def scene(
        self,
        camera: Camera,
        height: int,
        width: int,
        *,
        device: torch.device | str | None = None,
        dtype: torch.dtype = torch.float32,
        image: Tensor | None = None,
    ) -> SceneDepth:
        """As of `CompletedDepthMap`, with its confidence."""
        scene = super().scene(camera, height, width, device=device, dtype=dtype, image=image)
        share = known_below_horizon(self.depth_m, camera)
        word = MEASURED if share > _MEASURED_SHARE else COMPLETED
        note = f"{share:.1%} of the pixels below the horizon have a measured depth, the others are filled in"
        return dataclasses.replace(scene, confidence=word, notes=(*scene.notes, note))


def known_below_horizon(depth_m: Tensor, camera: Camera) -> float:
    """Share of the pixels below the horizon that have a value; of all pixels where none lies below it."""
    height, width = depth_m.shape[-2:]
    right, down, forward = camera.down_direction()
    ray = camera.ray_directions(height, width, dtype=torch.float64)
    below = right * ray[0] + down * ray[1] + forward > 0
    known = (~depth_m.isnan()).to(torch.float64)
    return float((known[..., below] if bool(below.any()) else known).mean())


@dataclasses.dataclass(frozen=True, eq=False)
class ConvertedDepth(SceneSource):
    """A map that the camera's intrinsics turn into depth: distances along the ray, or disparity.

    Args:
        stored: ``(..., 1, H, W)``, metres along the ray, or pixels of disparity; NaN is unknown.
        name: of the file, for errors.
        encoding: as of `read_depth`.
        baseline_m: of the stereo pair, metres; ``None``: ``stored`` are metres along the ray.
    """

    confidence: ClassVar[str] = COMPLETED

    stored: Tensor
    name: str
    encoding: str | None = None
    baseline_m: float | None = None

    def __post_init__(self) -> None:
        if not bool(self.stored.isnan().any()):
            # A whole disparity is a matcher's answer; whole distances are vouched for, as a DepthMap is.
            object.__setattr__(self, "confidence", EXACT if self.baseline_m is None else MEASURED)

    def scene(
        self,
        camera: Camera,
        height: int,
        width: int,
        *,
        device: torch.device | str | None = None,
        dtype: torch.dtype = torch.float32,
        image: Tensor | None = None,
    ) -> SceneDepth:
        """The converted map's scene: as it is where it is whole, else completed."""
        if tuple(self.stored.shape[-2:]) != (height, width):
            raise InputValueError(
                f"{self.name}: the map must have the image's size, {height} x {width}; got {self.stored.shape[-2]} x "
                f"{self.stored.shape[-1]}. Resize it by nearest neighbour; a disparity shrinks with the width."
            )
        if self.baseline_m is None:
            depth_m = along_ray_to_axis(self.stored, camera)
        else:
            depth_m = depth_from_disparity(self.stored, camera.fx, self.baseline_m)
            check_plausible(depth_m, Path(self.name), self.encoding)
        whole = not bool(depth_m.isnan().any())
        source: DepthSource = DepthMap(depth_m) if whole else PartlyKnownDepth(depth_m)
        scene = source.scene(camera, height, width, device=device, dtype=dtype, image=image)
        return dataclasses.replace(scene, confidence=self.confidence) if whole else scene
