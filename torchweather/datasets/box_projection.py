"""Where upright boxes stand in an image: the rectangle around their eight corners."""

from __future__ import annotations

import torch
from torch import Tensor

from torchweather.camera.depth import project_points
from torchweather.camera.sensor import Camera
from torchweather.core.arguments import check_arguments
from torchweather.datasets.boxes import Boxes

__all__ = ["box_corners", "project_boxes"]

# Nearer than this a corner lies beside or behind the camera, and its place in the image means nothing.
_NEAREST_CORNER_M = 0.1


def box_corners(boxes: Boxes) -> Tensor:
    """Corners of M boxes, ``(M, 8, 3)``, metres, in the frame and the dtype of the boxes.

    Example:
        >>> box = Boxes(torch.tensor([[10.0, 0, 0]]), torch.tensor([[4.0, 2, 1]]), torch.zeros(1), ("Car",))
        >>> box_corners(box)[0, 0].tolist(), box_corners(box)[0, 7].tolist()
        ([8.0, -1.0, -0.5], [12.0, 1.0, 0.5])
    """
    half = 0.5 * boxes.size_m
    signs = half.new_tensor([[x, y, z] for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)])
    along, across, up = (signs * half[:, None]).unbind(-1)  # (M, 8) each
    cos, sin = torch.cos(boxes.yaw_rad)[:, None], torch.sin(boxes.yaw_rad)[:, None]
    turned = torch.stack((cos * along - sin * across, sin * along + cos * across, up), dim=-1)
    return boxes.centre_m[:, None] + turned


def project_boxes(boxes: Boxes, camera: Camera, T_camera_from_lidar: Tensor) -> Tensor:
    """Rectangle of each box in the image.

    Args:
        boxes: M of them, in the frame of the cloud.
        camera: intrinsics and lens distortion.
        T_camera_from_lidar: ``(4, 4)``, metres.

    Returns:
        ``(M, 4)`` left, top, right, bottom in pixels (a pixel's centre is a whole number), cut to the image; NaN for a
        box that the image does not show, and for one with a corner beside or behind the camera.

    Example:
        >>> camera = Camera.from_intrinsics(fx=100, fy=100, cx=50, cy=40, width=101, height=81)
        >>> mounting = torch.tensor([[0.0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]])
        >>> box = Boxes(torch.tensor([[12.0, 0, 0]]), torch.tensor([[4.0, 2, 1]]), torch.zeros(1), ("Car",))
        >>> project_boxes(box, camera, mounting)
        tensor([[40., 35., 60., 45.]])
    """
    check_arguments(
        "project_boxes(boxes: Boxes, camera: Camera, T_camera_from_lidar: real)",
        boxes,
        camera,
        T_camera_from_lidar,
    )
    corners = box_corners(boxes).reshape(-1, 3)
    x_px, y_px, depth_m, _ = project_points(corners, T_camera_from_lidar, camera)
    x_px, y_px, depth_m = (values.reshape(-1, 8) for values in (x_px, y_px, depth_m))
    left, right = x_px.amin(1).clamp_min(0.0), x_px.amax(1).clamp_max(camera.width - 1.0)
    top, bottom = y_px.amin(1).clamp_min(0.0), y_px.amax(1).clamp_max(camera.height - 1.0)
    shown = (depth_m > _NEAREST_CORNER_M).all(1) & (left <= right) & (top <= bottom)
    rectangle = torch.stack((left, top, right, bottom), dim=-1)
    return torch.where(shown[:, None], rectangle, torch.nan)
