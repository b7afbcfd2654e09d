"""Boxes around things, in one convention whatever file they came from, and the points inside them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import torch
from torch import Tensor

from torchweather.core.arguments import check_arguments
from torchweather.core.errors import InputValueError

__all__ = ["Boxes", "points_in_boxes"]


@dataclass(frozen=True, eq=False)
class Boxes:
    """M upright boxes in the frame of the cloud: x forward, y left, z up, metres.

    Args:
        centre_m: ``(M, 3)`` centres (not the bottom).
        size_m: ``(M, 3)`` length (along the heading), width, height.
        yaw_rad: ``(M,)`` heading: angle from x to y about z.
        names: of the classes, as the file has them.
        records: for each box what else the file says, for writing back.
        unplaced: entries of the file that have no place in space (KITTI's DontCare), for writing back.

    Example:
        >>> boxes = Boxes(torch.tensor([[10.0, 0, 0]]), torch.tensor([[4.0, 2, 1.5]]), torch.zeros(1), ("Car",))
        >>> points_in_boxes(torch.tensor([[11.9, 0.9, 0.7], [11.9, 1.1, 0.7]]), boxes)
        tensor([[ True],
                [False]])
    """

    centre_m: Tensor
    size_m: Tensor
    yaw_rad: Tensor
    names: tuple[str, ...]
    records: tuple[Mapping[str, Any], ...] = field(default=(), repr=False)
    unplaced: tuple[Mapping[str, Any], ...] = field(default=(), repr=False)

    def __post_init__(self) -> None:
        check_arguments(
            "Boxes(centre_m: real, size_m: real, yaw_rad: real, names: Sequence, records: Sequence, "
            "unplaced: Sequence)",
            self.centre_m,
            self.size_m,
            self.yaw_rad,
            self.names,
            self.records,
            self.unplaced,
        )
        object.__setattr__(self, "names", tuple(self.names))
        object.__setattr__(self, "records", tuple(self.records) or ({},) * len(self.names))
        count = len(self.names)
        shapes = (tuple(self.centre_m.shape), tuple(self.size_m.shape), tuple(self.yaw_rad.shape))
        if shapes != ((count, 3), (count, 3), (count,)) or len(self.records) != count:
            raise InputValueError(
                f"Boxes: centre_m and size_m must be (M, 3), yaw_rad (M,), for M = {count} names and records; got "
                f"{shapes[0]}, {shapes[1]}, {shapes[2]} and {len(self.records)} records."
            )
        parts = (self.centre_m, self.size_m, self.yaw_rad[:, None])
        values = torch.cat([part.detach().double() for part in parts], dim=1)
        if not bool(torch.isfinite(values).all()) or not bool((values[:, 3:6] > 0).all()):
            raise InputValueError("Boxes: centres, sizes (m) and yaw (rad) must be finite, sizes above 0.")

    def __len__(self) -> int:
        return len(self.names)

    def select(self, keep: Tensor) -> Boxes:
        """The boxes where ``keep``, ``(M,)`` bool, is true; entries without a place stay."""
        check_arguments("Boxes.select(keep: Tensor)", keep)
        if tuple(keep.shape) != (len(self),):
            raise InputValueError(
                f"Boxes.select: keep must be ({len(self)},), one for each box; got {tuple(keep.shape)}."
            )
        chosen = [k for k, wanted in enumerate(keep.tolist()) if wanted]
        index = torch.tensor(chosen, dtype=torch.long, device=self.centre_m.device)
        return replace(
            self,
            centre_m=self.centre_m[index],
            size_m=self.size_m[index],
            yaw_rad=self.yaw_rad[index],
            names=tuple(self.names[k] for k in chosen),
            records=tuple(self.records[k] for k in chosen),
        )


def points_in_boxes(points: Tensor, boxes: Boxes) -> Tensor:
    """Table of points in boxes, faces included; a point of range 0 (no return) lies in none.

    Args:
        points: ``(..., N, 3 or more)`` x, y, z in metres, in the frame of the boxes.
        boxes: M of them.

    Returns:
        ``(..., N, M)`` bool. Memory grows with N M: some 20 bytes for each pair.
    """
    check_arguments("points_in_boxes(points: real(..., N, 3+), boxes: Boxes)", points, boxes)
    xyz = points[..., :3]
    xyz = xyz.to(torch.promote_types(xyz.dtype, torch.float32))
    centre, half, yaw = boxes.centre_m.to(xyz), 0.5 * boxes.size_m.to(xyz), boxes.yaw_rad.to(xyz)
    x = xyz[..., 0, None] - centre[:, 0]  # (..., N, M)
    y = xyz[..., 1, None] - centre[:, 1]
    z = xyz[..., 2, None] - centre[:, 2]
    cos, sin = torch.cos(yaw), torch.sin(yaw)
    inside = (cos * x + sin * y).abs() <= half[:, 0]
    inside &= (cos * y - sin * x).abs() <= half[:, 1]
    inside &= z.abs() <= half[:, 2]
    return inside & (xyz != 0).any(dim=-1, keepdim=True)


def turned_yaw(angle_rad: Tensor, plane: Tensor, rotation: Tensor) -> Tensor:
    """Heading about z after a change of frame.

    Args:
        angle_rad: ``(M,)`` heading in the plane ``plane``.
        plane: ``(3, 2)`` directions of angle 0 and of a quarter turn, in the frame of ``angle_rad``.
        rotation: ``(3, 3)`` to the new frame. What tilts the heading out of the new x-y plane is dropped.
    """
    flat = (rotation @ plane)[:2]
    heading = torch.stack((torch.cos(angle_rad), torch.sin(angle_rad)), dim=-1) @ flat.T
    return torch.atan2(heading[:, 1], heading[:, 0])


def turned_back(yaw_rad: Tensor, plane: Tensor, rotation: Tensor) -> Tensor:
    """The inverse of `turned_yaw`, exact also where the frames are tilted against each other; -pi to pi."""
    flat = (rotation @ plane)[:2]
    if float(torch.linalg.det(flat).abs()) < 1e-6:
        raise InputValueError("boxes: expected a transform that keeps headings level; got one that turns them upright.")
    flat = torch.linalg.inv(flat)
    heading = torch.stack((torch.cos(yaw_rad), torch.sin(yaw_rad)), dim=-1) @ flat.T
    angle = torch.atan2(heading[:, 1], heading[:, 0])
    return torch.where(angle <= -math.pi, angle + 2 * math.pi, angle)


def checked_transform(transform: Tensor, name: str, owner: str) -> Tensor:
    """A rigid transform ``(4, 4)`` as float64."""
    check_arguments(f"{owner}({name}: Nested)", transform)
    matrix = torch.as_tensor(transform, dtype=torch.float64).cpu()
    rotation = matrix[:3, :3] if matrix.shape == (4, 4) else torch.zeros(3, 3, dtype=torch.float64)
    # Calibration files print seven digits; 1e-3 tells a rotation from anything else.
    rigid = matrix.shape == (4, 4) and matrix[3].tolist() == [0.0, 0.0, 0.0, 1.0]
    if not rigid or not bool(((rotation @ rotation.T - torch.eye(3, dtype=torch.float64)).abs() < 1e-3).all()):
        raise InputValueError(
            f"{owner}: {name} must be a rigid transform (4, 4), rotation and metres above 0, 0, 0, 1; got shape "
            f"{tuple(matrix.shape)}."
        )
    return matrix
