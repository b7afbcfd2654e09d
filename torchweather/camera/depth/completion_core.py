"""From scattered points with depth to a depth for every pixel."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from torchweather.camera.depth.completion_border import carry_down, carry_up, column_ends
from torchweather.camera.depth.completion_edges import fill_along_edges
from torchweather.camera.depth.completion_surfaces import lay_surfaces
from torchweather.camera.depth.hidden_points import point_spacing_px

__all__ = ["Completion", "complete"]

Numbers = npt.NDArray[np.floating[Any]]
Mask = npt.NDArray[np.bool_]

# Columns to each side that share their ends, in units of the points' spacing: about twice that of the points of one
# ring, so that a column between two points is no gap.
_REACH = 2.0
_RING_REACH = 0.6
# Rows above the topmost points in which these may still go on: about the way to the next ring.
_SEAM = 1.3
# Columns to each side without a point of the scan's upper edge, for the beams above to have met nothing: more than a
# chance gap between points, and 31 px at 1242.
_FREE_REACH = 3.0
_FREE_SHARE = 0.025
# Depth of the farthest points, without strays.
_FAR_PERCENTILE = 99.9


@dataclass(frozen=True)
class Completion:
    """A depth for every pixel, and where it comes from.

    Args:
        depth_m: ``(H, W)`` metres, finite.
        hit: ``(H, W)``, true where a point fell.
        top: ``(W,)`` first row of every column that the points reach.
        free: ``(W,)``, true where beams above ``top`` met nothing within their range.
    """

    depth_m: Numbers
    hit: Mask
    top: npt.NDArray[np.intp]
    free: Mask


def complete(
    pixel_xy: Numbers,
    points_xyz: Numbers,
    ray_xyz: Numbers,
    at_upper_edge: Mask,
    down_xyz: tuple[float, float, float],
    picture: Numbers | None,
) -> Completion:
    """Complete points that the camera sees to a depth for every pixel.

    Args:
        pixel_xy: ``(N, 2)`` column and row of every point; points beside the picture help at its edges.
        points_xyz: ``(N, 3)`` the points in the camera's frame, metres; at least one lies in the picture.
        ray_xyz: ``(3, H, W)`` every pixel's ray, scaled to z = 1.
        at_upper_edge: ``(N,)`` points of the scan's highest elevations: what they hit may go on above.
        down_xyz: unit vector of gravity in the camera's frame.
        picture: ``(C, H, W)``, 0..1, or ``None``.

    Returns:
        The completion.
    """
    height, width = ray_xyz.shape[1:]
    surfaces = lay_surfaces(pixel_xy, points_xyz, height, width, down_xyz)
    depth_m, hit = surfaces.depth_m, surfaces.hit
    spacing = point_spacing_px(pixel_xy[:, 0], pixel_xy[:, 1])
    reach, seam = round(_REACH * spacing), round(_SEAM * spacing)
    top, _ = column_ends(hit, reach)
    row = np.arange(height)[:, None]
    depth_m = np.where((row < top) & ~hit, np.nan, depth_m)
    _, bottom = column_ends(~np.isnan(depth_m), reach)
    free = _free_columns(pixel_xy[:, 0], at_upper_edge, width, round(max(_FREE_REACH * spacing, _FREE_SHARE * width)))
    far_m = float(np.percentile(points_xyz[:, 2], _FAR_PERCENTILE))
    depth_m = carry_up(depth_m, top - seam, round(_RING_REACH * spacing), free, far_m, picture)
    depth_m = carry_down(depth_m, bottom, ray_xyz, surfaces.ground)
    # The picture decides where the topmost things end: between their last ring and the next one.
    between = np.isnan(depth_m)
    depth_m = _fill_rest(fill_along_edges(depth_m, between, picture), between)
    return Completion(depth_m, hit, top, free)


def _free_columns(column: Numbers, at_upper_edge: Mask, width: int, reach: int) -> Mask:
    """Columns of the picture with points within reach, but none of the scan's upper edge; others as the nearest."""
    from scipy.ndimage import distance_transform_edt, maximum_filter1d

    place = np.rint(column).astype(np.intp)
    inside = (place >= 0) & (place < width)
    near = np.zeros((2, width), bool)
    near[0, place[inside]] = True
    near[1, place[inside & at_upper_edge]] = True
    some, edge = maximum_filter1d(near, 2 * reach + 1, axis=1, mode="nearest")
    free: Mask = ~edge
    if not some.all():
        free = free[distance_transform_edt(~some, return_distances=False, return_indices=True)[0]]
    return free


def _fill_rest(depth_m: Numbers, wanted: Mask) -> Numbers:
    """Islands that border on nothing known: the nearest known pixel."""
    from scipy.ndimage import distance_transform_edt

    unknown = np.isnan(depth_m)
    rest = unknown & wanted
    if not rest.any():
        return depth_m
    i, j = distance_transform_edt(unknown, return_distances=False, return_indices=True)
    return np.where(rest, depth_m[i, j], depth_m)
