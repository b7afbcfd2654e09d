"""Points of a scan that the camera does not see, and points seen through the windows of cars.

A LiDAR stands beside the camera, so it sees past the edges of near things: such points fall among nearer ones.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

__all__ = ["enclosed_returns", "hidden_points", "lonely_points", "point_spacing_px", "unseen_points"]

Numbers = npt.NDArray[np.floating[Any]]
Mask = npt.NDArray[np.bool_]
Index = npt.NDArray[np.intp]

# A point is nearer than another at z if it lies before z / 1.10 - 0.4 m: a tenth for grazing surfaces, 0.4 m for the
# roughness of leaves and the thickness of car bodies. Both from trials on 13 KITTI frames.
_NEARER_RATIO = 1.10
_NEARER_M = 0.4

# Reach of the search in units of the points' spacing. On 13 KITTI frames (3.9 px) that is 6 px to the sides, 9 px up
# and down, within a strip of 3 px up and down, 2 px to the sides, which is wider than half the distance of two rings.
_REACH_ALONG_ROW = 1.55
_REACH_ALONG_COLUMN = 2.3
_STRIP_ROWS = 0.8
_STRIP_COLUMNS = 0.5

# Neighbours that must all be nearer for a far point to be lonely: those of its own ring and the next.
_NEIGHBOURS = 8

# More than the spacing of 32 beams in a picture of 1600 x 900 (18 px on nuScenes).
_WIDEST_SPACING_PX = 24.0

# A pane with its frame: the near points on both sides of it are at most this far apart, at their distance. On half of
# 13 KITTI frames, 0.6 x 0.4 m and 1.4 x 0.9 m give 1.80 and 1.95 % of left-out points more than 25 % off, this 1.85 %.
_WINDOW_WIDTH_M = 0.9
_WINDOW_HEIGHT_M = 0.6
# Beyond this distance, a pane is smaller than the spacing of the points.
_FARTHEST_WINDOW_M = 40.0
_NEAREST_WINDOW_M = 1.0
_BAND_RATIO = 1.3


def point_spacing_px(column: Numbers, row: Numbers) -> float:
    """Typical distance between neighbouring points in pixels: the root of the area that each one has.

    Args:
        column: ``(N,)`` pixels.
        row: ``(N,)`` pixels.

    Returns:
        1 to 24: a handful of points says nothing about the pixels between them.

    Example:
        >>> column, row = np.meshgrid(np.arange(0.0, 100.0, 4), np.arange(0.0, 80.0, 4))
        >>> round(point_spacing_px(column.ravel(), row.ravel()), 1)
        4.0
    """
    if len(column) < 4:
        return 1.0
    # The middle 96 %: single returns from a tree top span rows that hold nothing else.
    height, width = (np.diff(np.percentile(place, [2, 98]))[0] / 0.96 for place in (row, column))
    return float(np.clip(np.sqrt(height * width / len(column)), 1.0, _WIDEST_SPACING_PX))


def hidden_points(
    column: Numbers, row: Numbers, depth_m: Numbers, height: int, width: int, road_per_m_px: float = 0.0
) -> Mask:
    """Find points with nearer ones on two opposite sides.

    Nearer points on one side alone prove nothing: on a road seen at a grazing angle, they lie below every point.

    Args:
        column: ``(N,)`` pixels, inside the picture.
        row: ``(N,)`` pixels.
        depth_m: ``(N,)`` metres.
        height: rows of the picture.
        width: columns of the picture.
        road_per_m_px: growth of a road's inverse depth from row to row, ``1 / (fy h)`` of a camera at height h; points
            on a road a few rows below are not nearer things.

    Returns:
        ``(N,)``, true where the camera sees something nearer.

    Example:
        >>> column = np.array([10.0, 12.0, 14.0])
        >>> hidden_points(column, np.full(3, 5.0), np.array([10.0, 30.0, 10.0]), 10, 20)
        array([False,  True, False])
    """
    spacing = point_spacing_px(column, row)
    nearest = _nearest_in_pixel(_pixel(column), _pixel(row), depth_m, height, width)
    strip_rows, strip_columns = round(_STRIP_ROWS * spacing), round(_STRIP_COLUMNS * spacing)
    left, right = _nearest_before_and_after(_widened(nearest, strip_rows, 0), round(_REACH_ALONG_ROW * spacing), 1)
    above, below = _nearest_before_and_after(
        _widened(nearest, strip_columns, 1), round(_REACH_ALONG_COLUMN * spacing), 0
    )
    i, j = _pixel(row), _pixel(column)
    road = 1.0 / (1.0 / depth_m + (strip_rows + 1) * road_per_m_px)
    hidden: Mask = np.maximum(left, right)[i, j] < np.minimum(_limit(depth_m), road)
    hidden |= np.maximum(above, below)[i, j] < _limit(depth_m)
    return hidden


def enclosed_returns(
    column: Numbers, row: Numbers, depth_m: Numbers, height: int, width: int, fx: float, fy: float
) -> Mask:
    """Find far points that nearer ones enclose on four sides, closely enough for the pane of a car.

    Args:
        column: ``(N,)`` pixels, inside the picture.
        row: ``(N,)`` pixels.
        depth_m: ``(N,)`` metres.
        height: rows of the picture.
        width: columns of the picture.
        fx: focal length, pixels.
        fy: focal length, pixels.

    Returns:
        ``(N,)``, true for returns from behind a pane.
    """
    enclosed = np.zeros(len(depth_m), bool)
    if not len(depth_m):
        return enclosed
    spacing = point_spacing_px(column, row)
    limit = _limit(depth_m)
    # Half the points' spacing is fine enough to find neighbours, and quicker than single pixels.
    cell = max(1, int(spacing / 2))
    i, j = _pixel(row) // cell, _pixel(column) // cell
    nearest = _nearest_in_pixel(j, i, depth_m, height // cell + 1, width // cell + 1)
    by_row = _widened(nearest, round(_STRIP_ROWS * spacing / cell), 0)
    by_column = _widened(nearest, round(_STRIP_COLUMNS * spacing / cell), 1)
    near = max(float(limit.min()), _NEAREST_WINDOW_M)
    while near < min(_FARTHEST_WINDOW_M, float(limit.max())):
        last = near * _BAND_RATIO >= _FARTHEST_WINDOW_M
        of_band = np.nonzero((limit >= near) & ((limit < near * _BAND_RATIO) | last))[0]
        if len(of_band):
            gap_x = _gap_m(np.where(by_row < near, by_row, np.inf), i[of_band], j[of_band], 1) * cell / fx
            gap_y = _gap_m(np.where(by_column < near, by_column, np.inf), i[of_band], j[of_band], 0) * cell / fy
            enclosed[of_band] = (gap_x <= _WINDOW_WIDTH_M) & (gap_y <= _WINDOW_HEIGHT_M)
        near *= _BAND_RATIO
    return enclosed


def lonely_points(column: Numbers, row: Numbers, depth_m: Numbers) -> Mask:
    """Find points whose neighbours are all nearer: returns through a gap of leaves, a mirror, a pane.

    Args:
        column: ``(N,)`` pixels.
        row: ``(N,)`` pixels.
        depth_m: ``(N,)`` metres.

    Returns:
        ``(N,)``.
    """
    from scipy.spatial import cKDTree

    if len(column) <= _NEIGHBOURS:
        return np.zeros(len(column), bool)
    place = np.stack([column, row], -1)
    neighbour = cKDTree(place).query(place, _NEIGHBOURS + 1)[1][:, 1:]
    lonely: Mask = depth_m[neighbour].max(-1) < _limit(depth_m)
    return lonely


def unseen_points(
    column: Numbers,
    row: Numbers,
    depth_m: Numbers,
    height: int,
    width: int,
    fx: float,
    fy: float,
    camera_height_m: float,
) -> Mask:
    """Find hidden points, then among the others returns from behind panes, then lonely ones.

    Args:
        column: ``(N,)`` pixels, inside the picture.
        row: ``(N,)`` pixels.
        depth_m: ``(N,)`` metres.
        height: rows of the picture.
        width: columns of the picture.
        fx: focal length, pixels.
        fy: focal length, pixels.
        camera_height_m: above the road.

    Returns:
        ``(N,)``.
    """
    seen = ~hidden_points(column, row, depth_m, height, width, 1.0 / (fy * camera_height_m))
    seen[seen] = ~enclosed_returns(column[seen], row[seen], depth_m[seen], height, width, fx, fy)
    seen[seen] = ~lonely_points(column[seen], row[seen], depth_m[seen])
    return ~seen


def _limit(depth_m: Numbers) -> Numbers:
    limit: Numbers = depth_m / _NEARER_RATIO - _NEARER_M
    return limit


def _pixel(place: Numbers) -> Index:
    return np.rint(place).astype(np.intp)


def _nearest_in_pixel(column: Index, row: Index, depth_m: Numbers, height: int, width: int) -> Numbers:
    nearest = np.full((height, width), np.inf)
    np.minimum.at(nearest, (row, column), depth_m)
    return nearest


def _widened(nearest: Numbers, reach: int, axis: int) -> Numbers:
    from scipy.ndimage import minimum_filter1d

    widened: Numbers = minimum_filter1d(nearest, 2 * reach + 1, axis=axis, mode="constant", cval=np.inf)
    return widened


def _nearest_before_and_after(nearest: Numbers, reach: int, axis: int) -> tuple[Numbers, Numbers]:
    """Least depth among the ``reach`` pixels before each pixel, and among those after it."""
    from scipy.ndimage import minimum_filter1d

    reach = max(reach, 1)
    edge = [(0, 0), (0, 0)]
    edge[axis] = (reach, reach)
    padded = np.pad(nearest, edge, constant_values=np.inf)
    # Output k of the filter with this origin is the least of entries k .. k + reach - 1 of the padded array.
    ahead = minimum_filter1d(padded, reach, axis=axis, mode="constant", cval=np.inf, origin=-(reach // 2))
    size = nearest.shape[axis]
    return np.take(ahead, np.arange(size), axis), np.take(ahead, np.arange(reach + 1, reach + 1 + size), axis)


def _gap_m(near: Numbers, i: Index, j: Index, axis: int) -> Numbers:
    """Way in pixels to the next near pixel on either side, each times that pixel's depth; ``inf`` without one."""
    size = near.shape[axis]
    index = np.arange(size, dtype=np.int32)
    index = index[:, None] if axis == 0 else index[None]
    there = np.isfinite(near)
    before = np.maximum.accumulate(np.where(there, index, -1), axis)[i, j]
    flipped = np.flip(np.where(there, index, size), axis)
    after = np.flip(np.minimum.accumulate(flipped, axis), axis)[i, j]
    both = (before >= 0) & (after < size)
    place = i if axis == 0 else j
    gap = np.full(len(place), np.inf)
    place, before, after, across = place[both], before[both], after[both], (j if axis == 0 else i)[both]
    first, second = (
        (near[before, across], near[after, across]) if axis == 0 else (near[across, before], near[across, after])
    )
    gap[both] = (place - before) * first + (after - place) * second
    return gap
