"""Objects that stand on the ground: the lower edge of a box gives its depth."""

from __future__ import annotations

import torch
from torch import Tensor

__all__ = ["paint_boxes"]

# Share of a box's half side over which its depth fades into the background. A silhouette fills a box's middle, never
# its corners: a hard rectangle would show in fog.
_SOFT_SHARE = 0.25


def paint_boxes(
    depth_m: Tensor, fall: Tensor, boxes: Tensor, camera_height_m: float, farthest_m: float
) -> tuple[Tensor, int]:
    """Set the depth of objects that stand on flat ground.

    ``z = h / fall`` at the middle of the box's lower edge: the object's nearest face. Nearer boxes cover farther
    ones. Inside a rounded box (a superellipse of degree 4) the depth is the object's, and fades in its logarithm to
    the background at the border.

    Args:
        depth_m: ``(H, W)``, of the scene without the objects.
        fall: ``(H, W)``, metres that each pixel's ray falls per metre along the optical axis.
        boxes: ``(N, 4)``, left, top, right, bottom edge, pixels.
        camera_height_m: height of the camera over the ground.
        farthest_m: boxes whose lower edge meets the ground beyond this depth, or not at all, are left out.

    Returns:
        Depth ``(H, W)`` and how many boxes were used.

    Note:
        A box cut off by the picture's lower edge is nearer than its depth here.

    Example:
        >>> fall = (torch.arange(60.0) / 100)[:, None].expand(60, 80)      # horizon in row 0, focal length 100 px
        >>> depth, used = paint_boxes(torch.full((60, 80), 50.0), fall, torch.tensor([[20.0, 2, 40, 15]]), 1.5, 60.0)
        >>> depth[8, 30], used                                             # 1.5 m x 100 px / 15 px
        (tensor(10.), 1)
    """
    rows, columns = depth_m.shape
    column = ((boxes[:, 0] + boxes[:, 2]) / 2).round().long().clamp(0, columns - 1)
    bottom = boxes[:, 3].clamp(0, rows - 1)
    upper = bottom.floor().long().clamp(max=max(rows - 2, 0))
    below = fall[(upper + 1).clamp(max=rows - 1), column]
    falls = torch.lerp(fall[upper, column], below, (bottom - upper).to(fall))
    kept = falls > camera_height_m / farthest_m
    boxes, object_m = boxes[kept], camera_height_m / falls[kept]
    log_depth = depth_m.log()
    row = torch.arange(rows, device=depth_m.device, dtype=depth_m.dtype)
    line = torch.arange(columns, device=depth_m.device, dtype=depth_m.dtype)
    for index in torch.argsort(object_m, descending=True).tolist():
        left, top, right, low = boxes[index].to(depth_m).unbind()
        y = (2.0 * row - top - low) / (low - top).clamp_min(1.0)
        x = (2.0 * line - left - right) / (right - left).clamp_min(1.0)
        radius = (x.square().square()[None, :] + y.square().square()[:, None]).sqrt().sqrt()
        weight = ((1.0 - radius) / _SOFT_SHARE).clamp(0.0, 1.0)
        log_depth = torch.lerp(log_depth, object_m[index].log().to(depth_m), weight)
    return log_depth.exp(), len(boxes)
