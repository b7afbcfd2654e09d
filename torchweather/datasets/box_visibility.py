"""Remains of each box in the weather: points, and the share of the light that came through."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from torchweather.core.arguments import check_arguments
from torchweather.core.errors import InputValueError
from torchweather.datasets.boxes import Boxes, points_in_boxes
from torchweather.pipeline.point_kind import PointKind

__all__ = ["BoxVisibility", "box_visibility"]

# Pairs of point and box that are looked at in one go: about 100 MB.
_PAIRS = 1 << 22


@dataclass(frozen=True, eq=False)
class BoxVisibility:
    """Visibility of M boxes.

    Args:
        points_before: ``(M,)`` int64, returns inside each box without weather.
        points_left: ``(M,)`` int64, returns of objects inside each box with weather: neither particles nor lost beams.
        transmission: ``(M,)`` mean two-way transmission of the beams that met the box without weather; NaN where no
            beam did.
        particles: ``(M,)`` int64, drops, flakes and fog that the sensor reports inside each box.
    """

    points_before: Tensor
    points_left: Tensor
    transmission: Tensor
    particles: Tensor


def box_visibility(
    boxes: Boxes,
    points_before: Tensor,
    result_points: Tensor,
    kind: Tensor,
    transmission: Tensor,
    source: Tensor | None = None,
) -> BoxVisibility:
    """Points left in each box, and the mean transmission of its beams.

    Args:
        boxes: M boxes in the frame of the clouds.
        points_before: ``(N, 3 or more)`` the cloud that went into the weather, x, y, z in metres.
        result_points: ``(K, 3 or more)`` the cloud that came out.
        kind: ``(K,)`` `PointKind` of each point that came out.
        transmission: ``(K,)`` two-way transmission of each beam that came out.
        source: ``(K,)`` row of ``points_before`` of each beam, -1 for a beam that had none; ``None`` where row i is
            beam i (K = N).

    Returns:
        The visibility, on the device of the points. Where lost beams were left out (``lost="drop"``) the mean
        transmission is that of the beams left, so it is too high: run with ``lost="zero"`` for the true one.

    Example:
        >>> boxes = Boxes(torch.tensor([[10.0, 0, 0]]), torch.tensor([[4.0, 2, 2]]), torch.zeros(1), ("Car",))
        >>> before = torch.tensor([[9.0, 0, 0, 1], [10.0, 0, 0, 1], [30.0, 0, 0, 1]])
        >>> after = torch.tensor([[9.0, 0, 0, 1], [0.0, 0, 0, 0], [30.0, 0, 0, 1]])
        >>> left = box_visibility(boxes, before, after, torch.tensor([0, 2, 0]), torch.tensor([0.5, 0.3, 0.1]))
        >>> left.points_before, left.points_left, left.transmission
        (tensor([2]), tensor([1]), tensor([0.4000]))
    """
    check_arguments(
        "box_visibility(boxes: Boxes, points_before: real, result_points: real, kind: Tensor, "
        "transmission: real, source: Tensor | None)",
        boxes,
        points_before,
        result_points,
        kind,
        transmission,
        source,
    )
    if points_before.ndim != 2 or result_points.ndim != 2 or min(points_before.shape[1], result_points.shape[1]) < 3:
        raise InputValueError(
            "box_visibility: points must be (N, 3 or more), one cloud at a time (boxes differ between samples); got "
            f"{tuple(points_before.shape)} and {tuple(result_points.shape)}."
        )
    rows, results = points_before.shape[0], result_points.shape[0]
    if kind.shape != (results,) or transmission.shape != (results,):
        raise InputValueError(
            f"box_visibility: kind and transmission must have one value for each of the {results} result points; got "
            f"{tuple(kind.shape)} and {tuple(transmission.shape)}."
        )
    if (source is None and results != rows) or (source is not None and source.shape != (results,)):
        raise InputValueError(
            f"box_visibility: source must give the row, of {rows}, from which each of the {results} result points "
            f"comes; got {'None' if source is None else tuple(source.shape)}."
        )
    if source is not None and results and not bool(((source >= -1) & (source < rows)).all()):
        raise InputValueError(f"box_visibility: source must lie in -1..{rows - 1}.")
    device = points_before.device
    beam = torch.arange(rows, device=device) if source is None else source.to(device=device, dtype=torch.long)
    known = beam >= 0
    is_object = (kind.to(device) == int(PointKind.OBJECT)) & known
    is_particle = kind.to(device) == int(PointKind.PARTICLE)
    share = transmission.to(device).to(torch.promote_types(transmission.dtype, torch.float32))
    before = torch.zeros(len(boxes), dtype=torch.long, device=device)
    left, particles = torch.zeros_like(before), torch.zeros_like(before)
    mean = torch.full((len(boxes),), torch.nan, dtype=share.dtype, device=device)
    step = max(1, _PAIRS // max(rows, results, 1))
    for begin in range(0, len(boxes), step):
        some = torch.arange(len(boxes)) // step == begin // step
        part = boxes.select(some)
        met = points_in_boxes(points_before, part)  # (N, m)
        before[begin : begin + step] = met.sum(dim=0)
        seen = points_in_boxes(result_points, part)  # (K, m)
        left[begin : begin + step] = (seen & is_object[:, None]).sum(dim=0)
        particles[begin : begin + step] = (seen & is_particle[:, None]).sum(dim=0)
        if rows and results:
            beams = met[beam.clamp_min(0)] & known[:, None]  # (K, m)
            total = torch.where(beams, share[:, None], torch.zeros_like(share[:, None])).sum(dim=0)
            mean[begin : begin + step] = total / beams.sum(dim=0)  # 0 / 0 is NaN: no beam
    return BoxVisibility(before, left, mean, particles)
