"""The range noise of a LiDAR, taken out where neighbouring points lie on one plane."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

__all__ = ["level_depths", "rows_closer"]

Numbers = npt.NDArray[np.floating[Any]]

# Rings of a scan lie farther apart than the points of a ring: neighbours, and triangles, are sought with rows this
# much closer together. Median, 90th percentile and share over 25 % of left-out points on half of 13 KITTI frames:
# 1.0 gives 0.61, 4.07, 1.66 %; 0.5 and 0.35 give 0.60, 3.95, 1.63 %.
_ROW_WEIGHT = 0.4
# Points that must lie on one plane: three or four rings on KITTI. 24 and 48 do as well, and take longer.
_NEIGHBOURS = 16
# The farthest of them may lie this far from the plane along the ray: twice to four times the noise of a LiDAR, and
# less than a kerb. 0.07 to 0.2 m do equally well: a median of 0.57 instead of 0.60 %.
_ON_PLANE_M = 0.1


def rows_closer(pixel_xy: Numbers) -> Numbers:
    """Places in a picture whose rows are closer together, so that rings are about as close as the points of a ring.

    Args:
        pixel_xy: ``(N, 2)`` column and row.

    Returns:
        ``(N, 2)``.
    """
    closer: Numbers = pixel_xy * np.array([1.0, _ROW_WEIGHT])
    return closer


def level_depths(pixel_xy: Numbers, depth_m: Numbers) -> Numbers:
    """Move points along their rays onto the plane of their neighbours, where these all lie on one.

    Inverse depth is linear in the image of a plane, so a straight line through it needs no more than the pixels.

    Args:
        pixel_xy: ``(N, 2)`` column and row, not rounded.
        depth_m: ``(N,)`` metres, above 0.

    Returns:
        ``(N,)`` metres; points on rough or small things as they were.
    """
    from scipy.spatial import cKDTree

    if len(depth_m) < _NEIGHBOURS:
        return depth_m
    place = rows_closer(pixel_xy)
    neighbour = cKDTree(place).query(place, _NEIGHBOURS)[1]  # (N, K), the point itself among them
    offset = place[neighbour] - place[:, None]
    basis = np.concatenate([np.ones_like(offset[..., :1]), offset], -1)  # (N, K, 3)
    ratio = depth_m[:, None] / depth_m[neighbour]  # inverse depth, in units of the point's own
    transposed = basis.swapaxes(1, 2)
    normal = transposed @ basis
    # Neighbours on one line of the picture define no plane: a trifle on the diagonal gives them the flattest one.
    normal += 1e-9 * np.eye(3)
    plane = np.linalg.solve(normal, transposed @ ratio[..., None])  # (N, 3, 1)
    off_m = np.abs(ratio - (basis @ plane)[..., 0]).max(-1) * depth_m
    return np.where(off_m < _ON_PLANE_M, depth_m / plane[:, 0, 0], depth_m)
