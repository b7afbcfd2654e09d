"""The frame of a cloud and that of the sensor that took it: where the sensor stands and which way it looks.

A cloud may lie in the frame of the vehicle (Waymo: the origin is the rear axle) while a LiDAR's beams start at the
sensor. ``Lidar.origin_m`` and ``Lidar.rotation`` say where:

``p_cloud = rotation @ p_sensor + origin_m``; the columns of the rotation are the sensor's x, y, z in the cloud's frame.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import torch
from torch import Tensor

if TYPE_CHECKING:
    from torchweather.sensors.lidar import Lidar

__all__ = ["checked_origin", "checked_rotation", "points_in_cloud_frame", "points_in_sensor_frame", "split_pose"]

Rotation = tuple[tuple[float, float, float], ...]
Origin = tuple[float, float, float]

# Poses are often written with six digits.
ORTHOGONAL = 1e-4
IDENTITY: Rotation = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))


def _matrix(value: Any, rows: int, columns: int) -> Tensor | None:
    try:
        found = torch.as_tensor(value, dtype=torch.float64).cpu()
    except (TypeError, ValueError, RuntimeError):
        return None
    found = found.reshape(rows, columns) if found.numel() == rows * columns and found.ndim <= 2 else found
    return found if found.shape == (rows, columns) and bool(torch.isfinite(found).all()) else None


def checked_origin(value: Any) -> Origin:
    """``origin_m`` as three numbers."""
    found = _matrix(value, 1, 3)
    if found is None:
        raise ValueError(
            f"Lidar.origin_m: expected x, y, z of the sensor in the cloud's frame, three finite numbers in metres; got "
            f"{value!r}. Pass e.g. origin_m=(1.43, 0.0, 2.18)."
        )
    x, y, z = found[0].tolist()
    return x, y, z


def checked_rotation(value: Any) -> Rotation | None:
    """``rotation`` as rows of numbers; ``None`` for the identity."""
    if value is None:
        return None
    found = _matrix(value, 3, 3)
    if found is None or not torch.allclose(found @ found.T, torch.eye(3).double(), atol=ORTHOGONAL):
        raise ValueError(
            "Lidar.rotation: expected a rotation (3, 3) whose columns are the sensor's x, y, z in the cloud's frame; "
            f"got {value!r}. Pass the upper left 3 x 3 of T_cloud_from_sensor."
        )
    if float(torch.linalg.det(found)) < 0:
        raise ValueError(
            "Lidar.rotation: expected a right-handed rotation (determinant 1); got a reflection (determinant -1). "
            "Check that y is to the left and z up."
        )
    rows = tuple((x, y, z) for x, y, z in found.tolist())
    return None if rows == IDENTITY else rows


def split_pose(pose: Tensor | Sequence[Sequence[float]]) -> tuple[Origin, Rotation | None]:
    """``origin_m`` and ``rotation`` of a pose ``T_cloud_from_sensor``.

    Args:
        pose: ``(4, 4)``, or its first three rows ``(3, 4)``; metres.

    Example:
        >>> split_pose([[0, -1, 0, 1.5], [1, 0, 0, 0], [0, 0, 1, 2]])
        ((1.5, 0.0, 2.0), ((0.0, -1.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, 1.0)))
    """
    found = _matrix(pose, 4, 4)
    if found is not None and found[3].tolist() != [0.0, 0.0, 0.0, 1.0]:
        raise ValueError(
            f"T_cloud_from_sensor: expected the last row 0, 0, 0, 1; got {found[3].tolist()}. Is the matrix transposed?"
        )
    found = _matrix(pose, 3, 4) if found is None else found[:3]
    if found is None:
        raise ValueError(
            "T_cloud_from_sensor: expected a pose (4, 4), or its first three rows (3, 4), of finite numbers, the "
            f"position in metres; got {pose!r}."
        )
    return checked_origin(found[:, 3]), checked_rotation(found[:, :3])


def is_apart(lidar: Lidar) -> bool:
    """Tell whether the sensor's frame differs from the cloud's."""
    return lidar.rotation is not None or any(lidar.origin_m)


def points_in_sensor_frame(points: Tensor, lidar: Lidar) -> Tensor:
    """A cloud in the sensor's frame; rows at the cloud's origin hold no return and stay there.

    Args:
        points: ``(..., N, 3 or more)`` in the cloud's frame: x, y, z in metres, further columns.
        lidar: with ``origin_m`` and ``rotation``.

    Returns:
        ``(..., N, 3 or more)``, the further columns as they are; ``points`` itself where the frames are the same.

    Example:
        >>> from torchweather.sensors import Lidar
        >>> lidar = Lidar(905.0, origin_m=(1.0, 0.0, 2.0))
        >>> points_in_sensor_frame(torch.tensor([[11.0, 5.0, 0.0, 9.0], [0.0, 0.0, 0.0, 0.0]]), lidar)
        tensor([[10.,  5., -2.,  9.],
                [ 0.,  0.,  0.,  0.]])
    """
    if not is_apart(lidar):
        return points
    here = points[..., :3]
    wide = here if torch.compiler.is_compiling() or torch.onnx.is_in_onnx_export() else here.double()
    local = wide - wide.new_tensor(lidar.origin_m)
    if lidar.rotation is not None:
        local = local @ wide.new_tensor(lidar.rotation)
    local = torch.where((here == 0).all(-1, keepdim=True), torch.zeros_like(here), local.to(here))
    return torch.cat([local, points[..., 3:]], -1)


def points_in_cloud_frame(
    values: Tensor, local: Tensor, given: Tensor, lidar: Lidar, height_m: Tensor | None = None
) -> Tensor:
    """A result in the cloud's frame; rows that nothing moved have the bits that they came with.

    Args:
        values: ``(..., N, C)`` in the sensor's frame, from where each beam starts.
        local: ``(..., N, C)`` the cloud that went in, likewise; rows of 0 where it was completed.
        given: ``(..., M, C)`` the same as it came, M <= N, in the cloud's frame.
        lidar: with ``origin_m`` and ``rotation``.
        height_m: ``(..., N)`` at which the beams start over the sensor's origin; ``None`` is 0.

    Returns:
        ``(..., N, C)`` in the dtype of ``values``; rows of 0 (lost) stay so.
    """
    if not is_apart(lidar) and height_m is None:
        return values
    here = values[..., :3]
    wide = here if torch.compiler.is_compiling() or torch.onnx.is_in_onnx_export() else here.double()
    if height_m is not None:
        x, y, z = wide.unbind(-1)
        wide = torch.stack([x, y, z + height_m.to(wide)], -1)
    if lidar.rotation is not None:
        wide = wide @ wide.new_tensor(lidar.rotation).T
    moved = (wide + wide.new_tensor(lidar.origin_m)).to(here)
    more = values.shape[-2] - given.shape[-2]
    came = torch.nn.functional.pad(given[..., :3].to(here), (0, 0, 0, more))
    nothing = (here == 0).all(-1, keepdim=True)
    untouched = (here == local[..., :3]).all(-1, keepdim=True)
    moved = torch.where(nothing, torch.zeros_like(here), moved)
    return torch.cat([torch.where(untouched, came, moved), values[..., 3:]], -1)


def directions_in_sensor_frame(directions: Tensor | None, lidar: Lidar) -> Tensor | None:
    """Directions ``(..., N, 3)`` of the cloud's frame in the sensor's."""
    if directions is None or lidar.rotation is None:
        return directions
    return directions @ directions.new_tensor(lidar.rotation)


def pose_words(origin_m: Sequence[float], rotation: Rotation | None) -> str:
    """Where a sensor stands, in words.

    Example:
        >>> pose_words((1.43, 0.0, 2.18), None)
        '(1.43, 0.00, 2.18) m'
    """
    place = f"({', '.join(f'{value:.2f}' for value in origin_m)}) m"
    if rotation is None:
        return place
    turned_deg = math.degrees(math.acos(max(-1.0, min(1.0, (sum(rotation[k][k] for k in range(3)) - 1.0) / 2.0))))
    return f"{place}, turned by {turned_deg:.1f} degrees"
