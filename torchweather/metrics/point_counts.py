"""Number of points in a region and of a kind."""

from __future__ import annotations

import torch
from torch import Tensor

from torchweather.core.arguments import check_arguments
from torchweather.core.errors import InputValueError, check_between
from torchweather.core.precision import outside_autocast
from torchweather.metrics.clouds import Region, there

__all__ = ["KINDS", "point_counts"]

# OBJECT, PARTICLE, LOST.
KINDS = 3


@outside_autocast
def point_counts(
    points: Tensor,
    kind: Tensor | None = None,
    *,
    valid: Tensor | None = None,
    region: Region | None = None,
    kinds: int = KINDS,
) -> Tensor:
    """Number of points of each cloud, or of each kind of point.

    Args:
        points: ``(..., N, 3 or more)`` metres. Rows of zeros and rows that are not finite are no points.
        kind: ``(..., N)`` integers: 0 object, 1 particle, 2 lost.
        valid: ``(..., N)`` bool, false for padding.
        region: points outside are not counted.
        kinds: number of kinds.

    Returns:
        ``(...)`` int64, or ``(..., kinds)`` with ``kind``. A lost beam has no place: its kind is counted without a
        region, and is in none.

    Example:
        >>> points = torch.tensor([[5.0, 0.0, 0.0], [9.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
        >>> point_counts(points, region=Region(x_m=(0.0, 8.0))), point_counts(points, torch.tensor([0, 1, 2]))
        (tensor(1), tensor([1, 1, 1]))
    """
    check_arguments(
        "point_counts(points: real, kind: real | None, valid: Tensor | None, region: Region | None, kinds: int)",
        points,
        kind,
        valid,
        region,
        kinds,
    )
    name = "point_counts"
    if not isinstance(points, Tensor) or points.ndim < 2 or points.shape[-1] < 3:
        came = tuple(points.shape) if isinstance(points, Tensor) else type(points).__name__
        raise InputValueError(f"{name}: points must be a tensor (..., N, 3 or more) = x, y, z in m; got {came}.")
    for which, value in (("kind", kind), ("valid", valid)):
        if value is not None and value.shape != points.shape[:-1]:
            raise InputValueError(f"{name}: {which} must be {tuple(points.shape[:-1])}; got {tuple(value.shape)}.")
    found = there(points, valid, region)
    if kind is None:
        return found.sum(-1)
    check_between("kinds", kinds, 1, 1 << 16, owner=name)
    kinds = int(kinds)
    if kind.is_floating_point() or bool(((kind < 0) | (kind >= kinds)).any()):
        raise InputValueError(f"{name}: kind must hold integers from 0 to {kinds - 1}.")
    if region is None:  # lost beams too
        found = torch.ones_like(found) if valid is None else valid
    of_kind = kind[..., None] == torch.arange(kinds, device=kind.device)
    return (of_kind & found[..., None]).sum(-2)
