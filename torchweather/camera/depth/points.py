"""Depth from a LiDAR cloud without the picture: projected, the nearest point of each pixel kept, holes filled."""

from __future__ import annotations

import dataclasses
from typing import ClassVar

import numpy as np
import torch
from torch import Tensor

from torchweather.camera.depth.fill import fill_linear, fill_nearest, paint_sky
from torchweather.camera.depth.projection import project_points
from torchweather.camera.depth.scene_depth import COMPLETED
from torchweather.camera.depth.source import DepthSource
from torchweather.camera.sensor import Camera
from torchweather.core.arguments import check_arguments
from torchweather.core.errors import InputValueError, check_at_least, check_one_of

__all__ = ["DepthFromPoints"]


@dataclasses.dataclass(frozen=True, eq=False)
class DepthFromPoints(DepthSource):
    """Depth from a LiDAR cloud: projected, the nearest point of each pixel kept, holes filled in.

    Args:
        points_xyz: ``(N, 3 or more)``, metres in the LiDAR's frame; further columns are ignored, rows at range 0 are
            beams without a return.
        T_camera_from_lidar: ``(4, 4)``, into the camera's frame (x right, y down, z along the axis).
        fill: ``linear`` lays planes between neighbouring points and keeps steps between objects; ``nearest`` gives a
            pixel without a point the depth of the nearest one that has one; ``none`` leaves such pixels at ``inf``.
        above: what stands above the highest point of a column (highest within ``skyline_window_px``): ``sky`` is
            ``inf``, ``nearest`` continues the nearest point, ``auto`` is sky, except where that point lies at the
            scan's upper edge, so that what it hit may go on above.
        skyline_window_px: columns to each side that share a highest point; about twice the beams' spacing.
        upper_edge_rad: how far below the scan's highest elevation a point still counts as its upper edge; more than
            the spacing of the upper beams.

    Note:
        No scan tells a tall house from a lamp that just reaches the upper beam. ``auto`` errs towards the house: real
        sky that is given a depth stays about as bright in fog as it is, a house that is taken for sky vanishes. A
        cloud seen from another place than the camera's shows some background through foreground; the fill does not
        mend that. It runs on the CPU (about a second for 1600 x 900) and carries no gradient.

    Example:
        >>> camera = Camera.from_intrinsics(fx=4, fy=4, cx=1, cy=1, width=4, height=2)
        >>> lidar_axes = [[0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]]   # x forward, y left, z up
        >>> wall = torch.tensor([[8.0, 2.0, 2.0], [8.0, 2.0, 0.0]])                  # column 0
        >>> DepthFromPoints(wall, lidar_axes)(camera, 2, 4)
        tensor([[[8., 8., 8., 8.],
                 [8., 8., 8., 8.]]])
    """

    confidence: ClassVar[str] = COMPLETED

    points_xyz: Tensor
    T_camera_from_lidar: Tensor
    fill: str = "linear"
    above: str = "auto"
    skyline_window_px: int = 8
    upper_edge_rad: float = 0.03

    def __post_init__(self) -> None:
        check_arguments(
            "DepthFromPoints(points_xyz: Nested, T_camera_from_lidar: Nested, "
            "fill: str, above: str, skyline_window_px: int, upper_edge_rad: float)",
            self.points_xyz,
            self.T_camera_from_lidar,
            self.fill,
            self.above,
            self.skyline_window_px,
            self.upper_edge_rad,
        )
        points = torch.as_tensor(self.points_xyz)
        if points.ndim != 2 or points.shape[-1] < 3:
            raise InputValueError(
                "DepthFromPoints: points_xyz must have shape (N, 3 or more) = x, y, z in metres; "
                f"got {tuple(points.shape)}."
            )
        if not torch.isfinite(points[:, :3]).all():
            raise InputValueError("DepthFromPoints: points_xyz must be finite; got NaN or inf. Drop those rows.")
        transform = torch.as_tensor(self.T_camera_from_lidar, dtype=torch.float64).to(points.device)
        if transform.shape != (4, 4):
            raise InputValueError(f"DepthFromPoints: T_camera_from_lidar must be 4 x 4; got {tuple(transform.shape)}.")
        check_one_of("fill", self.fill, ["linear", "nearest", "none"], owner=self)
        check_one_of("above", self.above, ["auto", "sky", "nearest"], owner=self)
        check_at_least("upper_edge_rad", self.upper_edge_rad, 0.0, unit="rad", owner=self)
        check_at_least("skyline_window_px", self.skyline_window_px, 0, unit="px", owner=self)
        object.__setattr__(self, "points_xyz", points[:, :3].to(torch.float64))
        object.__setattr__(self, "T_camera_from_lidar", transform)

    def __call__(
        self,
        camera: Camera,
        height: int,
        width: int,
        *,
        device: torch.device | str | None = None,
        dtype: torch.dtype = torch.float32,
        image: Tensor | None = None,
    ) -> Tensor:
        """Depth ``(1, H, W)``, metres."""
        x_px, y_px, depth, seen = project_points(self.points_xyz, self.T_camera_from_lidar, camera, height, width)
        pixel = (y_px[seen].round() * width + x_px[seen].round()).long()
        nearest = torch.full((height * width,), torch.inf, dtype=torch.float64, device=depth.device)
        nearest = nearest.scatter_reduce(0, pixel, depth[seen], "amin").view(height, width)
        if self.fill != "none":
            if not bool(seen.any()):
                raise InputValueError(
                    "DepthFromPoints: no point of the cloud falls into the image, so no hole can be filled; check "
                    "T_camera_from_lidar (metres, into x right, y down, z along the axis) and the intrinsics."
                )
            first = depth[seen] <= nearest.flatten()[pixel]  # the points that stand in the picture
            pixel_xy = torch.stack([x_px, y_px], -1)[seen][first]
            cut_off = torch.zeros_like(nearest, dtype=torch.bool)
            if self.above == "auto":
                cut_off.view(-1)[pixel[self._at_upper_edge(seen)]] = True
            points = self.points_xyz[seen][first] @ self.T_camera_from_lidar[:3, :3].T + self.T_camera_from_lidar[:3, 3]
            nearest = self._filled(nearest, cut_off, pixel_xy, points)
        return nearest.to(device=device, dtype=dtype)[None]

    def _at_upper_edge(self, seen: Tensor) -> Tensor:
        """Mask of the seen points that belong to the scan's highest elevations."""
        x, y, z = self.points_xyz[seen].unbind(-1)
        elevation = torch.atan2(z, torch.hypot(x, y))
        return elevation > elevation.max() - self.upper_edge_rad

    def _filled(self, depth: Tensor, cut_off: Tensor, pixel_xy: Tensor, points_xyz: Tensor) -> Tensor:
        sparse = depth.cpu().numpy()
        if self.fill == "linear":
            filled = fill_linear(sparse, pixel_xy.cpu().numpy(), points_xyz.cpu().numpy())
        else:
            filled = fill_nearest(sparse)
        if self.above != "nearest":
            filled = paint_sky(filled, np.isfinite(sparse), cut_off.cpu().numpy(), int(self.skyline_window_px))
        return torch.from_numpy(filled)
