"""Where a sensor stands on the vehicle."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from torchweather.core.arguments import check_arguments
from torchweather.core.errors import InputValueError
from torchweather.scenes.primitives import Point

__all__ = ["checked_pose"]


def checked_pose(
    owner: str, sensor: str, given: Tensor | Sequence[Sequence[float]] | None, like: Tensor, mount_m: Point
) -> Tensor:
    """``T_vehicle_from_<sensor>`` as a tensor ``(4, 4)``: the given one, checked, or upright and facing ahead.

    Args:
        owner: who asks, for messages.
        sensor: ``lidar`` or ``radar``.
        given: ``(4, 4)``, or ``None``.
        like: its dtype and device are taken.
        mount_m: position where none is given.
    """
    if given is None:
        pose = torch.eye(4, dtype=like.dtype, device=like.device)
        pose[:3, 3] = like.new_tensor(mount_m)
        return pose
    check_arguments("pose(pose: Nested)", given)
    pose = torch.as_tensor(given, dtype=like.dtype, device=like.device)
    last = pose.new_tensor([0.0, 0.0, 0.0, 1.0])
    if pose.shape == (4, 4) and bool(torch.isfinite(pose).all()) and torch.equal(pose[3], last):
        turn = pose[:3, :3]
        # Extrinsics are often written with six digits.
        orthogonal = torch.allclose(turn @ turn.T, torch.eye(3).to(turn), atol=1e-4)
        if orthogonal and float(torch.linalg.det(turn)) > 0:
            return pose
    shown = {"lidar": "LiDAR"}.get(sensor, sensor)
    raise InputValueError(
        f"{owner}: T_vehicle_from_{sensor} must be a finite (4, 4) matrix of a rotation and a position in metres, last "
        f"row 0, 0, 0, 1; got {pose.tolist()}. Columns of the rotation are the {shown}'s x, y and z in the vehicle "
        "frame."
    )
