"""Where the points of a LiDAR cloud fall in an image."""

from __future__ import annotations

import torch
from torch import Tensor

from torchweather.camera.sensor import Camera
from torchweather.core.arguments import check_arguments
from torchweather.core.errors import check_between

__all__ = ["project_points"]

# Points nearer than this to the camera's plane belong to the sensor's own mounting, and their projection explodes.
_NEAREST_POINT_M = 0.1


def project_points(
    points_xyz: Tensor, T_camera_from_lidar: Tensor, camera: Camera, height: int | None = None, width: int | None = None
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Pixels of an image that the points of a cloud fall on.

    Args:
        points_xyz: ``(N, 3 or more)``, metres in the LiDAR's frame.
        T_camera_from_lidar: ``(4, 4)``.
        camera: intrinsics and lens distortion.
        height: rows of the image. Default: the camera's.
        width: columns of the image. Default: the camera's.

    Returns:
        Column and row in pixels (float; a pixel's centre is a whole number) and depth in metres, each ``(N,)``, and a
        mask ``(N,)`` of the points whose nearest pixel lies in the image.

    Example:
        >>> camera = Camera.from_intrinsics(fx=10, fy=10, cx=2, cy=1, width=6, height=4)
        >>> project_points(torch.tensor([[0.2, 0.1, 1.0]]), torch.eye(4), camera)
        (tensor([4.]), tensor([2.]), tensor([1.]), tensor([True]))
    """
    check_arguments(
        "project_points(points_xyz: floating(N, 3+), T_camera_from_lidar: real(4, 4), camera: Camera, "
        "height: int | None, width: int | None)",
        points_xyz,
        T_camera_from_lidar,
        camera,
        height,
        width,
    )
    check_between("T_camera_from_lidar", T_camera_from_lidar, -1e9, 1e9, unit="m", owner="project_points")
    farthest = torch.where(points_xyz[:, :3].isnan(), 0.0, points_xyz[:, :3])
    check_between("points_xyz", farthest, -1e9, 1e9, unit="m", owner="project_points")
    rows, columns = height or camera.height, width or camera.width
    transform = T_camera_from_lidar.to(points_xyz)
    in_camera = points_xyz[:, :3] @ transform[:3, :3].T + transform[:3, 3]
    depth = in_camera[:, 2]
    in_front = depth > _NEAREST_POINT_M
    safe_depth = torch.where(in_front, depth, 1.0)
    x, y = in_camera[:, 0] / safe_depth, in_camera[:, 1] / safe_depth
    if camera.distorted:
        # Far outside the picture the distortion polynomial folds back into it: keep to the rays the picture has.
        ray = camera.ray_directions(rows, columns, device=points_xyz.device, dtype=points_xyz.dtype)
        in_front = in_front & (x.square() + y.square() <= 1.02 * ray[:2].square().sum(0).max())
    x, y = camera.distort(x, y)
    cx, cy = camera.principal_point_px
    x_px, y_px = camera.fx * x + cx, camera.fy * y + cy
    seen = in_front & (x_px > -0.5) & (x_px < columns - 0.5) & (y_px > -0.5) & (y_px < rows - 0.5)
    # A range of exactly 0 is a beam without a return, wherever the LiDAR is mounted.
    seen = seen & (points_xyz[:, :3].square().sum(-1) > 0)
    return x_px, y_px, depth, seen
