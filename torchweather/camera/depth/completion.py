"""CompletedDepth: a LiDAR cloud completed to a depth for every pixel, with the picture as guide."""

from __future__ import annotations

import dataclasses

import numpy as np
import torch
from torch import Tensor

from torchweather.camera.depth.completion_scene import CompletedSource, SeenPoints, Sky, at_upper_edge
from torchweather.camera.depth.hidden_points import unseen_points
from torchweather.camera.depth.projection import project_points
from torchweather.camera.sensor import Camera
from torchweather.core.arguments import check_arguments
from torchweather.core.errors import InputValueError, check_at_least

__all__ = ["CompletedDepth"]

# Points beside and below the picture, so that a car which the frame cuts is whole. Without lens distortion only: its
# polynomial is fitted inside the picture.
_BESIDE_SHARE = 1 / 8
_BELOW_SHARE = 1 / 16


@dataclasses.dataclass(frozen=True, eq=False)
class CompletedDepth(CompletedSource):
    """Depth of every pixel from a LiDAR cloud, with the picture's edges where near and far points mix.

    Points that the camera does not see are left out: those between nearer ones, and returns from behind the panes of
    cars. Planes between neighbouring points give the surfaces. At depth steps, each pixel takes the side that it
    reaches without crossing an edge of the picture. Above the scan, depth is carried up, and below it the road goes
    on. Without a picture, depth steps lie midway between points.

    Args:
        points_xyz: ``(N, 3 or more)``, metres in the LiDAR's frame (z up); further columns are ignored, rows at range
            0 are beams without a return.
        T_camera_from_lidar: ``(4, 4)``, into the camera's frame (x right, y down, z along the axis).
        sky: share of sky in every pixel, ``(..., 1, H, W)`` 0..1; or a function that finds it, called as
            ``sky(rgb, horizon_row=..., returns=...)`` with the picture and the ``(1, H, W)`` mask of pixels with a
            point. ``None`` is `torchweather.camera.depth.sky.sky_mask`; without a colour picture, what stands above the
            topmost point of a column and above the horizon, unless that point belongs to the scan's upper edge.
        upper_edge_rad: how far below the scan's highest elevation a point still counts as its upper edge; more than
            the spacing of the upper beams.

    Note:
        Nothing above the scan is measured: a lorry's roof and the tree behind it get one depth. It runs on the CPU
        (about 0.35 s for 1242 x 375) and carries no gradient.

    Example:
        >>> camera = Camera.from_intrinsics(fx=4, fy=4, cx=1, cy=1, width=4, height=2)
        >>> lidar_axes = torch.tensor([[0.0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]])
        >>> wall = torch.tensor([[8.0, 2.0, 2.0], [8.0, 2.0, 0.0]])   # x forward, y left, z up; column 0
        >>> CompletedDepth(wall, lidar_axes)(camera, 2, 4)
        tensor([[[8., 8., 8., 8.],
                 [8., 8., 8., 8.]]])
    """

    points_xyz: Tensor
    T_camera_from_lidar: Tensor
    sky: Sky = None
    upper_edge_rad: float = 0.03

    def __post_init__(self) -> None:
        check_arguments(
            "CompletedDepth(points_xyz: real | array, T_camera_from_lidar: real | array, upper_edge_rad: float)",
            self.points_xyz,
            self.T_camera_from_lidar,
            self.upper_edge_rad,
        )
        points = torch.as_tensor(self.points_xyz)
        if points.ndim != 2 or points.shape[-1] < 3:
            raise InputValueError(
                "CompletedDepth: points_xyz must have shape (N, 3 or more) = x, y, z in metres; got "
                f"{tuple(points.shape)}."
            )
        if not torch.isfinite(points[:, :3]).all():
            raise InputValueError("CompletedDepth: points_xyz must be finite; got NaN or inf. Drop those rows.")
        transform = torch.as_tensor(self.T_camera_from_lidar, dtype=torch.float64, device="cpu")
        if transform.shape != (4, 4):
            raise InputValueError(f"CompletedDepth: T_camera_from_lidar must be 4 x 4; got {tuple(transform.shape)}.")
        check_at_least("upper_edge_rad", self.upper_edge_rad, 0.0, unit="rad", owner=self)
        object.__setattr__(self, "points_xyz", points[:, :3].detach().to(device="cpu", dtype=torch.float64))
        object.__setattr__(self, "T_camera_from_lidar", transform)

    def seen_points(self, camera: Camera, height: int, width: int) -> tuple[tuple[int, ...], list[SeenPoints]]:
        """No leading dimensions, and the points that the camera sees."""
        beside, below = (0, 0) if camera.distorted else (round(_BESIDE_SHARE * width), round(_BELOW_SHARE * height))
        cx, _ = camera.principal_point_px
        wider = dataclasses.replace(camera, cx=cx + beside)
        size = (height + below, width + 2 * beside)
        place = project_points(self.points_xyz, self.T_camera_from_lidar, wider, *size)
        column, row, depth_m = (value[place[3]].numpy() for value in place[:3])
        keep = ~unseen_points(column, row, depth_m, *size, camera.fx, camera.fy, camera.height_m)
        column = column - beside
        in_picture = (np.rint(column) >= 0) & (np.rint(column) < width) & (np.rint(row) < height)
        if not (keep & in_picture).any():
            raise InputValueError(
                "CompletedDepth: no point of the cloud falls into the image, so no depth can be completed; check "
                "T_camera_from_lidar (metres, into x right, y down, z along the axis) and the intrinsics."
            )
        x, y, z = self.points_xyz.numpy().T  # all around: what the camera sees may all lie low
        edge = at_upper_edge(np.arctan2(z, np.hypot(x, y)), np.hypot(x, y), self.upper_edge_rad)[place[3].numpy()]
        in_camera = self.points_xyz[place[3]] @ self.T_camera_from_lidar[:3, :3].T + self.T_camera_from_lidar[:3, 3]
        return (), [
            SeenPoints(
                np.stack([column, row], -1)[keep],
                in_camera.numpy()[keep],
                edge[keep],
                left_out=int((~keep & in_picture).sum()),
            )
        ]
