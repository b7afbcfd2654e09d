"""Straight edges of a picture: runs of edge pixels of one orientation, each fitted by its principal axis."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

__all__ = ["LineSegments", "find_segments", "grey_levels"]

Array = npt.NDArray[np.floating[Any]]

# Gradient of a kept edge, sRGB levels 0..1 a pixel: twice the noise of an 8-bit JPEG of a road (about 0.01).
_LEAST_GRADIENT = 0.02
# Neighbours of one run differ by at most this angle: cos(2 x 20 deg). Wider joins foliage, narrower breaks lane marks.
_SAME_ORIENTATION_COS = float(np.cos(np.deg2rad(40.0)))
_SHORTEST_PX = 18.0  # shorter runs point badly: at 18 px half a pixel of noise at each end is 2 degrees
_THICKEST_PX = 1.0  # standard deviation across the run; more is a curve or a tuft


@dataclass(frozen=True)
class LineSegments:
    """Straight edges.

    Args:
        centre_xy: ``(N, 2)``, column and row of the middle, pixels.
        direction_xy: ``(N, 2)``, unit vectors along the edge.
        length_px: ``(N,)``.
    """

    centre_xy: Array
    direction_xy: Array
    length_px: Array


def grey_levels(rgb: Any) -> Array:
    """Mean of the colours, 0..1, ``(H, W)`` float32, of a picture ``(C, H, W)`` of bytes or of floats 0..1."""
    picture = np.asarray(rgb)
    scale = 255.0 if picture.dtype == np.uint8 else 1.0
    grey: Array = picture.astype(np.float32).mean(0) / np.float32(scale)
    return grey


def find_segments(grey: Array) -> LineSegments:
    """Straight edges of a grey picture.

    Edge pixels are the maxima of the gradient along its own direction. Neighbours of like orientation form a run;
    a run that is long and thin is an edge.

    Args:
        grey: ``(H, W)``, 0..1.

    Returns:
        Edges of at least 18 pixels, in the order in which the rows of the picture meet them.

    Example:
        >>> picture = np.zeros((40, 40), np.float32)
        >>> picture[20:] = 1.0
        >>> [round(float(v)) for v in find_segments(picture).length_px]
        [36]
    """
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    row, column, orientation = _edge_pixels(grey)
    count = len(row)
    number = np.full(grey.shape, -1, np.int32)
    number[row, column] = np.arange(count, dtype=np.int32)
    first, second = [], []
    for down, right in ((0, 1), (1, -1), (1, 0), (1, 1)):
        neighbour = number[row + down, column + right]
        here = np.flatnonzero(neighbour >= 0)
        there = neighbour[here]
        # Orientation is kept as a doubled angle, so that an edge and its reverse side differ by 0.
        alike = (orientation[here] * orientation[there]).sum(-1) > _SAME_ORIENTATION_COS
        first.append(here[alike])
        second.append(there[alike])
    edges = np.concatenate(first), np.concatenate(second)
    graph = coo_matrix((np.ones(len(edges[0]), np.int8), edges), shape=(count, count))
    runs, label = connected_components(graph, directed=False)
    return _fitted(label, runs, column.astype(np.float64), row.astype(np.float64))


def _edge_pixels(grey: Array) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.intp], Array]:
    """Row, column and doubled-angle orientation of the ridge of the gradient, two pixels away from the border."""
    smooth = (grey[:-2] + 2.0 * grey[1:-1] + grey[2:]) * 0.25
    right = np.zeros_like(grey)
    right[1:-1, 1:-1] = 0.5 * (smooth[:, 2:] - smooth[:, :-2])
    smooth = (grey[:, :-2] + 2.0 * grey[:, 1:-1] + grey[:, 2:]) * 0.25
    down = np.zeros_like(grey)
    down[1:-1, 1:-1] = 0.5 * (smooth[2:] - smooth[:-2])
    squared = right * right + down * down
    inner = np.zeros(grey.shape, bool)
    inner[2:-2, 2:-2] = squared[2:-2, 2:-2] > _LEAST_GRADIENT**2
    row, column = np.nonzero(inner)
    gx, gy, here = right[row, column], down[row, column], squared[row, column]
    # Of the four directions of the pixel grid, the one nearest to the gradient: tan(22.5 deg) parts them.
    step_x = np.where(np.abs(gx) > 0.4142 * np.abs(gy), np.sign(gx), 0).astype(np.intp)
    step_y = np.where(np.abs(gy) > 0.4142 * np.abs(gx), np.sign(gy), 0).astype(np.intp)
    ahead, behind = squared[row + step_y, column + step_x], squared[row - step_y, column - step_x]
    ridge = (here >= ahead) & (here > behind)
    row, column, gx, gy, here = row[ridge], column[ridge], gx[ridge], gy[ridge], here[ridge]
    orientation = np.stack([gx * gx - gy * gy, 2.0 * gx * gy], -1) / here[:, None]
    return row, column, orientation


def _fitted(label: npt.NDArray[np.integer[Any]], runs: int, x: Array, y: Array) -> LineSegments:
    """Principal axis of each run; short and thick runs dropped."""

    def total(values: Array) -> Array:
        result: Array = np.bincount(label, values, minlength=runs).astype(np.float64)
        return result

    count: Array = np.maximum(np.bincount(label, minlength=runs), 1).astype(np.float64)
    centre_x, centre_y = total(x) / count, total(y) / count
    x, y = x - centre_x[label], y - centre_y[label]
    xx, xy, yy = total(x * x) / count, total(x * y) / count, total(y * y) / count
    spread = np.hypot(0.5 * (xx - yy), xy)
    along, across = 0.5 * (xx + yy) + spread, np.maximum(0.5 * (xx + yy) - spread, 0.0)
    length = np.sqrt(12.0 * along)  # of a uniform run of that variance
    angle = 0.5 * np.arctan2(2.0 * xy, xx - yy)
    kept = (length >= _SHORTEST_PX) & (np.sqrt(across) <= _THICKEST_PX)
    direction = np.stack([np.cos(angle), np.sin(angle)], -1)
    return LineSegments(np.stack([centre_x, centre_y], -1)[kept], direction[kept], length[kept])
