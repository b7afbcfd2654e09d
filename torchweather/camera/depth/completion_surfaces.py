"""Planes between neighbouring points of a scan, and which of them are surfaces."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from torchweather.camera.depth.completion_noise import level_depths, rows_closer

__all__ = ["Surfaces", "lay_surfaces"]

Numbers = npt.NDArray[np.floating[Any]]

# Corners of a triangle whose depths differ by more than this ratio lie on two objects, or on one seen at a grazing
# angle. The distance of the plane to the lens tells them apart: the road passes 1.2 m or more below a camera, a plane
# that spans a depth step passes close to it. 0.5, 0.7, 1.0 and 1.3 m were tried on half of 13 KITTI frames.
_STEP_RATIO = 1.15
_NEAREST_SURFACE_M = 1.0
# A triangle with a side longer than this many median sides spans a gap of the scan: 4 and 8 do equally well. In dense
# maps the median is a pixel or two, and holes of this many pixels are still one surface.
_LONGEST_SIDE = 6.0
_SHORT_PX = 24.0
# The ground's normal lies within 11 degrees of gravity, and the ground 0.3 to 4 m below a car's or lorry's camera.
_GROUND_COSINE = 0.98
_GROUND_M = (0.3, 4.0)
_FEWEST_GROUND_TRIANGLES = 20


@dataclass(frozen=True)
class Surfaces:
    """Depth between the points of a scan.

    Args:
        depth_m: ``(H, W)`` metres, NaN where no surface is known.
        hit: ``(H, W)``, true where a point fell.
        ground: ``(3,)`` such that ``ground . P = 1`` for points of the road in the camera's frame, metres; ``None``
            where no road is seen.
    """

    depth_m: Numbers
    hit: npt.NDArray[np.bool_]
    ground: Numbers | None


def lay_surfaces(
    pixel_xy: Numbers, points_xyz: Numbers, height: int, width: int, down_xyz: tuple[float, float, float]
) -> Surfaces:
    """Lay planes through neighbouring points, where these lie on one surface.

    Inverse depth is linear in the image of a plane, so it is what is interpolated over a Delaunay triangulation, after
    the noise of points on planes is taken out.

    Args:
        pixel_xy: ``(N, 2)`` column and row of every point, not rounded; points beside the picture help at its edges.
        points_xyz: ``(N, 3)`` the points in the camera's frame, metres.
        height: rows of the picture.
        width: columns of the picture.
        down_xyz: unit vector of gravity in the camera's frame.

    Returns:
        The surfaces. A pixel with points has the depth of its nearest one.
    """
    from scipy.spatial import Delaunay, QhullError

    depth_m = np.full((height, width), np.nan)
    ground = None
    try:
        mesh = Delaunay(rows_closer(pixel_xy))
    except (QhullError, ValueError):  # fewer than three points, or all on one line
        mesh = None
    if mesh is not None:
        corner = mesh.simplices  # (T, 3)
        normal, lens_m = _planes(points_xyz[corner])
        is_surface = _are_surfaces(pixel_xy[corner], points_xyz[corner, 2], lens_m)
        ground = _ground(normal, lens_m, is_surface, points_xyz[corner], down_xyz)
        _interpolate(depth_m, mesh, pixel_xy, is_surface, 1.0 / level_depths(pixel_xy, points_xyz[:, 2]))
    column, row = np.rint(pixel_xy).astype(np.intp).T
    inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
    nearest = np.full((height, width), np.inf)
    np.minimum.at(nearest, (row[inside], column[inside]), points_xyz[inside, 2])
    hit = np.isfinite(nearest)
    return Surfaces(np.where(hit, nearest, depth_m), hit, ground)


def _planes(triangles: Numbers) -> tuple[Numbers, Numbers]:
    """Unit normals ``(T, 3)`` and distances from the lens ``(T,)``, metres."""
    normal = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    normal /= np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-12)
    return normal, np.abs(np.einsum("tc,tc->t", normal, triangles[:, 0]))


def _are_surfaces(corners_xy: Numbers, depths: Numbers, lens_m: Numbers) -> npt.NDArray[np.bool_]:
    side = np.square(corners_xy - np.roll(corners_xy, 1, axis=1)).sum(-1).max(-1)
    step = depths.max(-1) > _STEP_RATIO * depths.min(-1)
    longest = max(_LONGEST_SIDE**2 * float(np.median(side)), _SHORT_PX**2)
    are: npt.NDArray[np.bool_] = (~step | (lens_m >= _NEAREST_SURFACE_M)) & (side <= longest)
    return are


def _ground(
    normal: Numbers,
    lens_m: Numbers,
    is_surface: npt.NDArray[np.bool_],
    triangles: Numbers,
    down_xyz: tuple[float, float, float],
) -> Numbers | None:
    down = np.asarray(down_xyz)
    level = is_surface & (np.abs(normal @ down) > _GROUND_COSINE) & (triangles[:, 0] @ down > 0)
    level &= (lens_m > _GROUND_M[0]) & (lens_m < _GROUND_M[1])
    if level.sum() < _FEWEST_GROUND_TRIANGLES:
        return None
    facing = normal[level] * np.sign(np.einsum("tc,tc->t", normal[level], triangles[level, 0]))[:, None]
    plane: Numbers = np.median(facing / lens_m[level, None], axis=0)
    return plane


def _interpolate(
    depth_m: Numbers, mesh: Any, pixel_xy: Numbers, is_surface: npt.NDArray[np.bool_], inverse_depth: Numbers
) -> None:
    height, width = depth_m.shape
    first = max(0, int(np.floor(pixel_xy[:, 1].min())))
    last = min(height, int(np.ceil(pixel_xy[:, 1].max())) + 1)
    row, column = np.mgrid[first:last, 0:width].reshape(2, -1)
    place = rows_closer(np.stack([column, row], -1).astype(np.float64))
    triangle = mesh.find_simplex(place)
    on_surface = (triangle >= 0) & is_surface[triangle]
    triangle, place = triangle[on_surface], place[on_surface]
    # Inverse depth of each triangle as origin and slope in the picture.
    value = inverse_depth[mesh.simplices]  # (T, 3)
    slope = np.einsum("tk,tkc->tc", value[:, :2] - value[:, 2:], mesh.transform[:, :2])
    origin = value[:, 2] - np.einsum("tc,tc->t", slope, mesh.transform[:, 2])
    inverse = origin[triangle] + np.einsum("nc,nc->n", slope[triangle], place)
    depth_m[row[on_surface], column[on_surface]] = 1.0 / inverse
