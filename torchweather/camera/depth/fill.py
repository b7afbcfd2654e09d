"""Dense depth from the scattered pixels that a LiDAR scan hits: surfaces between the points, sky above them.

On the CPU with numpy and scipy: neither a triangulation nor a nearest-neighbour search gains from a tensor.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

__all__ = ["fill_linear", "fill_nearest", "paint_sky"]

Depth = npt.NDArray[np.floating[Any]]
Mask = npt.NDArray[np.bool_]

# A plane through three neighbouring points that would pass the lens nearer than this is no surface but a step from
# one object to another: roads, walls and cars keep a metre away from a camera.
_NEAREST_SURFACE_M = 1.0

# A triangle with a side longer than this many median sides spans a gap of the scan, or its hollow outline: nothing
# says that there is one surface.
_LONGEST_SIDE = 4.0


def fill_nearest(depth: Depth) -> Depth:
    """Every pixel without a depth (``inf``) takes that of the nearest pixel that has one."""
    from scipy.ndimage import distance_transform_edt

    row, column = distance_transform_edt(np.isinf(depth), return_distances=False, return_indices=True)
    filled: Depth = depth[row, column]
    return filled


def fill_linear(depth: Depth, pixel_xy: Depth, points_xyz: Depth) -> Depth:
    """Planes between neighbouring points; steps between objects and the outside of the scan as `fill_nearest`.

    Inverse depth is linear in the image of a plane, so it is what is interpolated over a Delaunay triangulation.

    Args:
        depth: ``(H, W)``, metres along the axis, ``inf`` where no point fell.
        pixel_xy: ``(N, 2)``, column and row where each point fell, not rounded: on whole numbers the triangulation
            is ambiguous, and searching it slow.
        points_xyz: ``(N, 3)``, the same points in the camera's frame, metres.

    Returns:
        ``(H, W)``, finite.
    """
    from scipy.spatial import Delaunay, QhullError

    filled = fill_nearest(depth)
    try:
        mesh = Delaunay(pixel_xy)
    except (QhullError, ValueError):  # fewer than three points, or all in one line
        return filled
    corner = mesh.simplices  # (T, 3)
    triangles = points_xyz[corner]  # (T, 3, 3)
    through_lens = np.abs(np.linalg.det(triangles)) < 1e-9
    triangles[through_lens] = np.eye(3)
    plane = np.linalg.solve(triangles, np.ones((len(corner), 3, 1)))[
        ..., 0
    ]  # plane . P = 1: at 1 / |plane| from the lens
    side = np.linalg.norm(pixel_xy[corner] - pixel_xy[np.roll(corner, 1, axis=-1)], axis=-1).max(-1)
    is_surface = ~through_lens & (side <= _LONGEST_SIDE * np.median(side))
    is_surface &= np.linalg.norm(plane, axis=-1) <= 1.0 / _NEAREST_SURFACE_M
    hole_row, hole_column = np.nonzero(np.isinf(depth))
    triangle = mesh.find_simplex(np.stack([hole_column, hole_row], -1).astype(np.float64))
    inside = (triangle >= 0) & is_surface[triangle]
    triangle, hole_row, hole_column = triangle[inside], hole_row[inside], hole_column[inside]
    offset = np.stack([hole_column, hole_row], -1) - mesh.transform[triangle, 2]
    share = np.einsum("nij,nj->ni", mesh.transform[triangle, :2], offset)
    share = np.concatenate([share, 1.0 - share.sum(-1, keepdims=True)], -1)
    # Barycentric in pixels: the same as the plane without lens distortion, and between its corners with it.
    filled[hole_row, hole_column] = 1.0 / (share / points_xyz[corner[triangle], 2]).sum(-1)
    return filled


def paint_sky(filled: Depth, hit: Mask, cut_off: Mask, window_px: int) -> Depth:
    """Sky (``inf``) above the highest point of each column, except where the scan itself ends there.

    Args:
        filled: ``(H, W)`` depth.
        hit: ``(H, W)``, pixels with a point.
        cut_off: ``(H, W)``, pixels with a point of the scan's upper edge: what it hit may go on above it.
        window_px: columns to each side that share their highest point.

    Returns:
        ``(H, W)``.
    """
    from scipy.ndimage import distance_transform_edt, maximum_filter1d, minimum_filter1d

    height = hit.shape[0]
    size = 2 * window_px + 1
    top = minimum_filter1d(np.where(hit.any(0), np.argmax(hit, axis=0), height), size, mode="nearest")
    goes_on = maximum_filter1d(cut_off.any(0), size, mode="nearest")
    unknown = top == height
    if unknown.any():  # far from any point: as the nearest column that has one
        nearest = distance_transform_edt(unknown, return_distances=False, return_indices=True)[0]
        top, goes_on = top[nearest], goes_on[nearest]
    sky = (np.arange(height)[:, None] < top) & ~goes_on
    return np.where(sky, np.inf, filled)
