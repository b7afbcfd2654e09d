"""Where a sensor stands in a cloud's frame: origin and rotation, checked, and from a pose matrix."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor

from torchweather.core.arguments import nested_shape
from torchweather.core.errors import InputValueError

__all__ = ["Origin", "Rotation", "checked_origin", "checked_rotation", "split_pose"]

Rotation = tuple[tuple[float, float, float], ...]
Origin = tuple[float, float, float]

# Poses are often written with six digits.
ORTHOGONAL = 1e-4
IDENTITY: Rotation = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))


def _matrix(value: Any, rows: int, columns: int) -> Tensor | None:
    if nested_shape(value) is None:
        return None
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
        raise InputValueError(
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
        raise InputValueError(
            "Lidar.rotation: expected a rotation (3, 3) whose columns are the sensor's x, y, z in the cloud's frame; "
            f"got {value!r}. Pass the upper left 3 x 3 of T_cloud_from_sensor."
        )
    if float(torch.linalg.det(found)) < 0:
        raise InputValueError(
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
        raise InputValueError(
            f"T_cloud_from_sensor: expected the last row 0, 0, 0, 1; got {found[3].tolist()}. Is the matrix transposed?"
        )
    found = _matrix(pose, 3, 4) if found is None else found[:3]
    if found is None:
        raise InputValueError(
            "T_cloud_from_sensor: expected a pose (4, 4), or its first three rows (3, 4), of finite numbers, the "
            f"position in metres; got {pose!r}."
        )
    return checked_origin(found[:, 3]), checked_rotation(found[:, :3])
