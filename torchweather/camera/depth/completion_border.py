"""Depth beyond the scan's edges: the ground below its lowest ring, walls and trees above its topmost one."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
import torch

__all__ = ["carry_down", "carry_up", "column_ends"]

Numbers = npt.NDArray[np.floating[Any]]
Mask = npt.NDArray[np.bool_]
Index = npt.NDArray[np.intp]

# All widths as shares of the picture's; pixels are those at 1242. From views of 13 KITTI frames in fog of
# 200 m, not from scores.
# One point at the edge may be a stray.
_STRAY_SHARE = 7 / 1242
# Near things narrower than this (poles, lamps, people) do not go on to the top: fog would hang in curtains. They fade
# into what stands beside them, within this many pixels of height, and what stands there is blurred across columns.
_CLOSING_SHARE = 61 / 1242
_FADE_SHARE = 60 / 1242
_NARROW_BLUR_SHARE = 1.5 / 1242
_BLUR_SHARE = 8 / 1242
# Windows of the filters that move the carried depth to the picture's edges; its threshold is a contrast of 0.03.
_GUIDE_SHARE = 61 / 1242
_NARROW_GUIDE_SHARE = 17 / 1242
# The filters' local means come from every fourth or second pixel.
_GUIDE_SUBSAMPLE = 4
_NARROW_GUIDE_SUBSAMPLE = 2
_GUIDE_EPS = 1e-3
# The lowest points of a column lie on the road if their depth is the road's to this share.
_ON_GROUND = 0.2


def column_ends(known: Mask, reach: int) -> tuple[Index, Index]:
    """First and last known row of every column.

    Args:
        known: ``(H, W)``, with at least one known pixel.
        reach: columns to each side that share their ends.

    Returns:
        ``(W,)`` and ``(W,)``; columns without a known pixel take those of the nearest one that has any.
    """
    from scipy.ndimage import distance_transform_edt, maximum_filter1d, minimum_filter1d

    height = len(known)
    size = 2 * reach + 1
    there = known.any(0)
    top = minimum_filter1d(np.where(there, np.argmax(known, 0), height), size, mode="nearest")
    bottom = maximum_filter1d(np.where(there, height - 1 - np.argmax(known[::-1], 0), -1), size, mode="nearest")
    empty = top == height
    if empty.any():
        nearest = distance_transform_edt(empty, return_distances=False, return_indices=True)[0]
        top, bottom = top[nearest], bottom[nearest]
    return top, bottom


def carry_down(depth_m: Numbers, bottom: Index, ray_xyz: Numbers, ground: Numbers | None) -> Numbers:
    """Continue the road, or what stands on it, below the last known row of every column.

    Args:
        depth_m: ``(H, W)`` metres, NaN where unknown.
        bottom: ``(W,)`` rows.
        ray_xyz: ``(3, H, W)`` every pixel's ray, scaled to z = 1.
        ground: ``(3,)`` such that ``ground . P = 1`` on the road; ``None``: depths stay as they are at ``bottom``.

    Returns:
        ``(H, W)``.
    """
    height, width = depth_m.shape
    column = np.arange(width)
    below = np.arange(height)[:, None] > bottom
    last = _edge_depth(depth_m, -1, 0)
    carried = np.broadcast_to(last, depth_m.shape)
    if ground is not None:
        inverse = np.einsum("c,chw->hw", ground, ray_xyz)
        at_edge = inverse[bottom, column]
        road = 1.0 / np.maximum(inverse, 1e-6)
        ratio = last * at_edge
        on_road = (at_edge > 0) & (np.abs(np.log(np.maximum(ratio, 1e-6))) < _ON_GROUND)
        carried = np.where(on_road, ratio * road, np.minimum(carried, np.where(inverse > 0, road, np.inf)))
    return np.where(below, carried, depth_m)


def carry_up(depth_m: Numbers, top: Index, reach: int, free: Mask, far_m: float, picture: Numbers | None) -> Numbers:
    """Continue walls and trees above the first known row of every column.

    Args:
        depth_m: ``(H, W)`` metres, NaN where unknown.
        top: ``(W,)`` rows above which nothing is known.
        reach: columns between two points of one ring.
        free: ``(W,)``, true where beams above met nothing within their range.
        far_m: that range, metres.
        picture: ``(C, H, W)``, 0..1, whose edges the carried depth follows; ``None``: it is the same in all rows.

    Returns:
        ``(H, W)``.
    """
    from scipy.ndimage import gaussian_filter1d, grey_closing, median_filter

    height, width = depth_m.shape
    edge = np.log(_edge_depth(depth_m, 1, reach))
    edge = median_filter(edge, _odd(_STRAY_SHARE * width), mode="nearest")
    edge = np.where(free, np.maximum(edge, np.log(far_m)), edge)
    lasting = grey_closing(edge, _odd(_CLOSING_SHARE * width), mode="nearest")
    row = np.arange(height)[:, None]
    last = max(int(top.max()), 0)
    fade = np.exp((row[:last] - np.minimum(top, last)).clip(max=0) / (_FADE_SHARE * width))
    narrow = gaussian_filter1d(edge - lasting, max(_NARROW_BLUR_SHARE * width, 0.3), mode="nearest") * fade
    lasting = gaussian_filter1d(lasting, max(_BLUR_SHARE * width, 0.5), mode="nearest")
    wide = np.broadcast_to(lasting, narrow.shape)
    if picture is not None and last > 1:
        wide = _guided(wide, picture[:, :last], _odd(_GUIDE_SHARE * width), _GUIDE_SUBSAMPLE)
        narrow = _guided(narrow, picture[:, :last], _odd(_NARROW_GUIDE_SHARE * width), _NARROW_GUIDE_SUBSAMPLE)
    carried = depth_m.copy()
    carried[:last] = np.where(row[:last] < top, np.exp(wide + narrow), depth_m[:last])
    return carried


def _odd(size: float) -> int:
    return 2 * round(size / 2) + 1


def _guided(value: Numbers, picture: Numbers, size: int, subsample: int) -> Numbers:
    """Smooth a map, except across the picture's edges: guided filter (He, Sun, Tang 2013)."""
    from kornia.filters import guided_blur

    if min(value.shape) <= size:  # too small a picture for the filter's border
        return value
    guide = torch.from_numpy(np.ascontiguousarray(picture, np.float32))[None]
    field = torch.from_numpy(np.ascontiguousarray(value, np.float32))[None, None]
    blurred = guided_blur(guide, field, size, _GUIDE_EPS, subsample=subsample)[0, 0].numpy()
    # The local linear model extrapolates to colours that its window lacks.
    kept: Numbers = np.clip(blurred, value.min(), value.max()).astype(np.float64)
    return kept


def _edge_depth(depth_m: Numbers, step: int, reach: int) -> Numbers:
    """Depth of the first (step 1) or last (step -1) known row of every column; ``(W,)``, finite.

    Columns that end lower than one within ``reach`` lie between two points of a ring: they take that one's depth.
    """
    from scipy.ndimage import distance_transform_edt, minimum_filter1d

    upright = depth_m[::step]
    known = ~np.isnan(upright)
    first = np.where(known.any(0), np.argmax(known, 0), len(upright))
    end = minimum_filter1d(first, 2 * reach + 1, mode="nearest")
    edge: Numbers = upright[np.minimum(first, len(upright) - 1), np.arange(depth_m.shape[1])]
    empty = np.isnan(edge) | (first > end + reach)
    if empty.any() and not empty.all():
        edge = edge[distance_transform_edt(empty, return_distances=False, return_indices=True)[0]]
    return edge
