"""Common parts of completed depth sources: the picture as guide, the sky, the result as a scene."""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from torchweather.camera.depth.completion_core import Completion, complete
from torchweather.camera.depth.scene_depth import COMPLETED, SceneDepth
from torchweather.camera.depth.source import SceneSource
from torchweather.camera.sensor import Camera
from torchweather.core.errors import InputValueError

__all__ = ["CompletedSource", "SeenPoints", "Sky", "at_upper_edge"]

Numbers = npt.NDArray[np.floating[Any]]
Mask = npt.NDArray[np.bool_]
Sky = Tensor | Callable[..., Tensor] | None

# Above this share of sky, a pixel without a measurement shows nothing else: its depth is infinite.
_SKY_ALONE = 0.99
# Elevations of near points say little about the scan's edge: the lasers of a spinning LiDAR sit side by side.
_NEAR_M = 8.0
# Without strays.
_TOP_PERCENTILE = 99.9


@dataclass(frozen=True)
class SeenPoints:
    """Points that the camera sees.

    Args:
        pixel_xy: ``(N, 2)`` column and row.
        points_xyz: ``(N, 3)`` in the camera's frame, metres.
        upper_edge: ``(N,)``, true for those of the scan's highest elevations.
        measured_m: ``(H, W)`` depths to keep as they are, NaN elsewhere; ``inf`` is sky, and where there is any, no
            other is guessed without a picture. ``None``: those of the points.
        left_out: how many points were left out, because the camera does not see them.
    """

    pixel_xy: Numbers
    points_xyz: Numbers
    upper_edge: Mask
    measured_m: Numbers | None = None
    left_out: int = 0


def at_upper_edge(elevation_rad: Numbers, range_m: Numbers, margin_rad: float) -> Mask:
    """Find the points of a scan's highest elevations.

    Args:
        elevation_rad: ``(N,)``, above the horizontal.
        range_m: ``(N,)``.
        margin_rad: how far below the highest elevation a point still counts; more than the spacing of the beams.

    Returns:
        ``(N,)``; what these points hit may go on above them.
    """
    far = elevation_rad[range_m > _NEAR_M]
    top = np.percentile(far if len(far) else elevation_rad, _TOP_PERCENTILE)
    edge: Mask = elevation_rad > top - margin_rad
    return edge


class CompletedSource(SceneSource):
    """Depth of some pixels, completed to all of them. Subclasses give the points, and ``sky`` as `CompletedDepth`."""

    confidence: ClassVar[str] = COMPLETED

    sky: Sky

    @abstractmethod
    def seen_points(self, camera: Camera, height: int, width: int) -> tuple[tuple[int, ...], list[SeenPoints]]:
        """Leading dimensions of the frames, and the points of each."""

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
        """Depth and soft sky, ``(..., 1, H, W)``; a batch of images gives a batch of depths."""
        of_points, points = self.seen_points(camera, height, width)
        leading = of_points
        if image is not None:
            if image.ndim < 3 or image.shape[-3] not in (1, 3) or tuple(image.shape[-2:]) != (height, width):
                raise InputValueError(
                    f"{type(self).__name__}: image must have shape (..., 3 or 1, {height}, {width}); got "
                    f"{tuple(image.shape)}."
                )
            leading = np.broadcast_shapes(leading, tuple(image.shape[:-3]))
        frames = math.prod(leading)
        which = np.broadcast_to(np.arange(len(points)).reshape(of_points), leading).ravel()
        images = [None] * frames if image is None else list(_frames(image, leading))
        ray = camera.ray_directions(height, width, dtype=torch.float64)
        parts = []
        for index in range(frames):
            seen, picture = points[which[index]], images[index]
            result = complete(
                seen.pixel_xy, seen.points_xyz, ray.numpy(), seen.upper_edge, camera.down_direction(), _guide(picture)
            )
            share = self._sky_share(camera, ray, picture, result, seen, index, leading)
            parts.append(_merged(result, seen, share))
        depth_m, share = (torch.stack(part).view(*leading, 1, height, width) for part in zip(*parts, strict=True))
        return SceneDepth(
            depth_m.to(device=device, dtype=dtype),
            self.confidence,
            sky=share.to(device=device, dtype=dtype),
            notes=(_note(points[0], result),),
        )

    def _sky_share(
        self,
        camera: Camera,
        ray: Tensor,
        picture: Tensor | None,
        result: Completion,
        seen: SeenPoints,
        index: int,
        leading: Any,
    ) -> Tensor:
        """``(H, W)``, 0 at and below the horizon."""
        height, width = result.depth_m.shape
        _, cy = camera.principal_point_px
        horizon_row = cy + camera.fy * math.tan(camera.pitch_rad)
        if isinstance(self.sky, Tensor):
            given = self.sky if self.sky.ndim > 2 else self.sky[None]
            share = given.expand(*leading, 1, height, width).reshape(-1, height, width)[index]
        elif picture is not None and len(picture) == 3:
            find = self.sky
            if find is None:
                from torchweather.camera.depth.sky import sky_mask

                find = sky_mask
            share = find(picture.cpu(), horizon_row=horizon_row, returns=torch.from_numpy(result.hit)[None])
        elif seen.measured_m is not None and np.isinf(seen.measured_m).any():
            share = torch.zeros(height, width)
        else:
            row = torch.arange(height)[:, None]
            share = (row < torch.from_numpy(result.top)) & torch.from_numpy(result.free)
        right, down, forward = camera.down_direction()
        rises = right * ray[0] + down * ray[1] + forward < 0
        return torch.where(rises, share.reshape(height, width).to(torch.float64).cpu().clamp(0, 1), 0.0)


def _frames(image: Tensor, leading: tuple[int, ...]) -> Tensor:
    return image.detach().expand(*leading, *image.shape[-3:]).reshape(-1, *image.shape[-3:])


def _guide(picture: Tensor | None) -> Numbers | None:
    """The picture as floats 0..1; of a mosaic, the mean over each 2 x 2 cell, which is grey."""
    if picture is None:
        return None
    values = picture.cpu().to(torch.float32)
    if len(values) == 1:
        padded = torch.nn.functional.pad(values[None], (0, 1, 0, 1), mode="replicate")
        values = torch.nn.functional.avg_pool2d(padded, 2, stride=1)[0]
    brightest = 255.0 if picture.dtype == torch.uint8 else max(1.0, float(values.max()))
    guide: Numbers = (values / brightest).numpy()
    return guide


def _merged(result: Completion, seen: SeenPoints, share: Tensor) -> tuple[Tensor, Tensor]:
    """Depth and sky share ``(H, W)`` with the measured pixels as they were."""
    depth_m = torch.from_numpy(result.depth_m)
    measured = torch.from_numpy(result.hit)
    if seen.measured_m is not None:
        given = torch.from_numpy(seen.measured_m)
        sky = torch.isinf(given)
        measured = measured | torch.isfinite(given)
        depth_m = torch.where(torch.isfinite(given), given, depth_m)
        share = torch.where(sky, 1.0, share)
    share = torch.where(measured, share.clamp(max=_SKY_ALONE), share)
    return torch.where(share > _SKY_ALONE, torch.inf, depth_m), share


def _note(seen: SeenPoints, result: Completion) -> str:
    above = float((np.arange(len(result.depth_m))[:, None] < result.top).mean())
    return (
        f"Depth completed from {len(seen.pixel_xy)} points ({seen.left_out} that the camera does not see left out); "
        f"{above:.0%} of the pixels lie above the scan, where depth is carried up."
    )
