"""Overlap of boxes: rectangles along the axes of an image, and turned rectangles on the ground."""

from __future__ import annotations

import torch
from torch import Tensor

from torchweather.core.arguments import check_arguments
from torchweather.core.errors import InputValueError, check_finite
from torchweather.core.precision import outside_autocast

__all__ = ["bev_coverage", "bev_iou", "box_coverage", "box_iou"]

# Turned pairs that are worked on at once: some 40 numbers each, 350 MB in float64.
PORTION = 1 << 20


@outside_autocast
def box_iou(first: Tensor, second: Tensor) -> Tensor:
    """Intersection over union of every box with every other, along the axes of an image.

    Args:
        first: ``(N, 4)`` left, top, right, bottom: any unit, right and bottom are edges, not the last pixel.
        second: ``(M, 4)``, likewise.

    Returns:
        ``(N, M)`` in [0, 1]; 0 where both boxes have no area.

    Example:
        >>> box_iou(torch.tensor([[0.0, 0.0, 2.0, 2.0]]), torch.tensor([[1.0, 0.0, 3.0, 2.0], [5.0, 5.0, 6.0, 6.0]]))
        tensor([[0.3333, 0.0000]])
    """
    check_arguments("box_iou(first: Tensor, second: Tensor)", first, second)
    shared = _shared_in_image(first, second, "box_iou")
    area, other = ((boxes[:, 2:] - boxes[:, :2]).prod(-1) for boxes in (first, second))
    return _over_union(shared, area, other)


@outside_autocast
def box_coverage(first: Tensor, second: Tensor) -> Tensor:
    """Share of every first box that each second box covers, along the axes of an image.

    COCO's overlap with a region to be ignored (``iscrowd``): a box inside the region has 1, however small it is.

    Args:
        first: ``(N, 4)`` left, top, right, bottom: any unit, right and bottom are edges, not the last pixel.
        second: ``(M, 4)``, likewise: the regions.

    Returns:
        ``(N, M)`` in [0, 1]; 0 where the first box has no area.

    Example:
        >>> box_coverage(torch.tensor([[0.0, 0.0, 2.0, 2.0]]), torch.tensor([[1.0, 0.0, 9.0, 9.0]]))
        tensor([[0.5000]])
    """
    shared = _shared_in_image(first, second, "box_coverage")
    return _over(shared, (first[:, 2:] - first[:, :2]).prod(-1)[:, None])


def _shared_in_image(first: Tensor, second: Tensor, owner: str) -> Tensor:
    """Area that each box shares with each other, ``(N, M)``."""
    for name, boxes in (("first", first), ("second", second)):
        _check(name, boxes, 4, "left, top, right, bottom", owner)
        if bool((boxes[:, 2:] < boxes[:, :2]).any()):
            raise InputValueError(
                f"{owner}: {name} must have left <= right and top <= bottom; got a box turned inside out. If yours are "
                "x, y, width, height, add the corner."
            )
    low = torch.maximum(first[:, None, :2], second[None, :, :2])
    high = torch.minimum(first[:, None, 2:], second[None, :, 2:])
    return (high - low).clamp_min(0).prod(-1)


@outside_autocast
def bev_iou(first: Tensor, second: Tensor) -> Tensor:
    """Intersection over union of turned rectangles on the ground, seen from above (bird's eye).

    Each rectangle is looked at in the frame of the other, whose edges then lie along the axes. The area they share
    is the integral of the clamped height along the clamped outline, which is piecewise linear: the trapezoid rule
    between the places where it bends is exact, for touching and equal rectangles too.

    Args:
        first: ``(N, 5)`` x, y of the centre, length (along the heading), width, in metres; yaw in radians from x to
            y, as in ``torchweather.io.Boxes``.
        second: ``(M, 5)``, likewise.

    Returns:
        ``(N, M)`` in [0, 1]; 0 where both rectangles have no area.

    Note:
        Exact but for rounding: 1e-12 in float64 within some 1000 m. Height is not looked at.

    Example:
        >>> car = torch.tensor([[10.0, 0.0, 4.0, 2.0, 0.0]])
        >>> across = torch.tensor([[10.0, 0.0, 4.0, 2.0, torch.pi / 2]])
        >>> bev_iou(car, across)  # 4 of 12 square metres
        tensor([[0.3333]])
    """
    check_arguments("bev_iou(first: Tensor, second: Tensor)", first, second)
    shared = _shared_on_ground(first, second, "bev_iou")
    return _over_union(shared, first[:, 2] * first[:, 3], second[:, 2] * second[:, 3])


@outside_autocast
def bev_coverage(first: Tensor, second: Tensor) -> Tensor:
    """Share of every first rectangle on the ground that each second one covers.

    Args:
        first: ``(N, 5)`` x, y, length, width in metres, yaw in radians, as in ``bev_iou``.
        second: ``(M, 5)``, likewise: the regions.

    Returns:
        ``(N, M)`` in [0, 1]; 0 where the first rectangle has no area.

    Example:
        >>> car, region = torch.tensor([[10.0, 0.0, 4.0, 2.0, 0.0]]), torch.tensor([[10.0, 0.0, 50.0, 1.0, 0.0]])
        >>> bev_coverage(car, region)
        tensor([[0.5000]])
    """
    return _over(_shared_on_ground(first, second, "bev_coverage"), (first[:, 2] * first[:, 3])[:, None])


def _shared_on_ground(first: Tensor, second: Tensor, owner: str) -> Tensor:
    """Area that each rectangle shares with each other, in portions that memory holds, ``(N, M)``."""
    for name, boxes in (("first", first), ("second", second)):
        _check(name, boxes, 5, "x, y, length, width, yaw", owner)
        if bool((boxes[:, 2:4] < 0).any()):
            raise InputValueError(f"{owner}: {name} must have lengths and widths of 0 m or more; got a negative one.")
    if not len(first):
        return first.new_zeros(0, len(second))
    rows = max(PORTION // max(len(second), 1), 1)
    return torch.cat([_shared_area(some, second) for some in torch.split(first, rows)])


def _check(name: str, boxes: Tensor, columns: int, names: str, owner: str) -> None:
    if not isinstance(boxes, Tensor) or boxes.ndim != 2 or boxes.shape[1] != columns or not boxes.is_floating_point():
        came = f"{tuple(boxes.shape)} {boxes.dtype}" if isinstance(boxes, Tensor) else type(boxes).__name__
        raise InputValueError(f"{owner}: {name} must be a floating-point tensor (N, {columns}): {names}; got {came}.")
    check_finite(name, boxes, owner=owner)


def _over_union(shared: Tensor, area: Tensor, other: Tensor) -> Tensor:
    return _over(shared, area[:, None] + other[None] - shared)


def _over(shared: Tensor, whole: Tensor) -> Tensor:
    return torch.where(whole > 0, shared / torch.where(whole > 0, whole, 1.0), 0.0).clamp(0.0, 1.0)


def _shared_area(first: Tensor, second: Tensor) -> Tensor:
    """Area that each rectangle of ``first`` shares with each of ``second``, ``(N, M)``."""
    corner_x, corner_y = _corners_in_frame(first, second)  # (N, M, 4)
    half_x, half_y = (second[None, :, None, k] / 2 for k in (2, 3))
    step_x, step_y = corner_x.roll(-1, -1) - corner_x, corner_y.roll(-1, -1) - corner_y
    # Along an edge, from 0 to 1: its ends and where it crosses the lines of the other rectangle's edges.
    bends = torch.stack(
        [
            torch.zeros_like(corner_x),
            _crossing(-half_x, corner_x, step_x),
            _crossing(half_x, corner_x, step_x),
            _crossing(-half_y, corner_y, step_y),
            _crossing(half_y, corner_y, step_y),
            torch.ones_like(corner_x),
        ],
        -1,
    )
    along = bends.sort(-1).values  # (N, M, 4, 6)
    x = _within(corner_x[..., None] + along * step_x[..., None], half_x[..., None])
    y = _within(corner_y[..., None] + along * step_y[..., None], half_y[..., None])
    # The outline runs against the clock: upper edges to the left.
    return -(x.diff(dim=-1) * (y[..., 1:] + y[..., :-1]) / 2).sum((-1, -2)).clamp_max(0.0)


def _corners_in_frame(first: Tensor, second: Tensor) -> tuple[Tensor, Tensor]:
    """Corners of each ``first``, against the clock, in the frame of each ``second``; ``(N, M, 4)`` twice."""
    signs = first.new_tensor([[1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]]) / 2
    along, across = (first[:, None, k, None] * signs[:, k - 2] for k in (2, 3))  # (N, 1, 4)
    turn = (first[:, None, 4] - second[None, :, 4])[..., None]
    offset = first[:, None, :2] - second[None, :, :2]
    cos, sin = second[:, 4].cos(), second[:, 4].sin()
    centre_x = (offset[..., 0] * cos + offset[..., 1] * sin)[..., None]
    centre_y = (offset[..., 1] * cos - offset[..., 0] * sin)[..., None]
    return (
        centre_x + along * turn.cos() - across * turn.sin(),
        centre_y + along * turn.sin() + across * turn.cos(),
    )


def _crossing(line: Tensor, start: Tensor, step: Tensor) -> Tensor:
    """Where an edge crosses a line, as share of the edge; 0 where it runs along it."""
    return torch.where(step == 0, 0.0, (line - start) / torch.where(step == 0, 1.0, step)).clamp(0.0, 1.0)


def _within(value: Tensor, half: Tensor) -> Tensor:
    return torch.minimum(torch.maximum(value, -half), half)
