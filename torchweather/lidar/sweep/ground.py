"""The ground under a LiDAR: a plane through the lowest returns of a sweep."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from torchweather.core.arguments import check_arguments
from torchweather.core.errors import InputValueError

__all__ = ["GroundPlane", "fit_ground"]

Numbers = npt.NDArray[np.floating[Any]]

# Returns that may show the ground: below the sensor, not on the own vehicle, near enough for the rings to lie close.
_LOWEST_M, _HIGHEST_M = -4.0, -0.4
_NEAREST_M, _FARTHEST_M = 2.5, 40.0
# One candidate for each cell of this size: its lowest tenth, so that cars and kerbs do not count.
_CELL_M = 2.0
_FEWEST_CELLS = 20
_LOW_SHARE = 0.1
# Reweighted least squares (Cauchy): a kerb is 0.1 to 0.15 m.
_SCALE_M = 0.1
_ROUNDS = 12
# So many candidates are enough: about ten in each cell.
_MOST_POINTS = 30_000
_STEEPEST = math.tan(math.radians(15.0))
# Share of the cells within three scales of the plane, for it to be a ground at all.
_LEAST_AGREEMENT = 0.3


@dataclass(frozen=True)
class GroundPlane:
    """The plane ``z = height_m + slope_x x + slope_y y`` in the sensor's frame, z up.

    Args:
        height_m: below the sensor, so it is negative.
        slope_x: rise to the front, m/m.
        slope_y: rise to the left, m/m.
        spread_m: median distance of the ground's cells from the plane, metres.
    """

    height_m: float
    slope_x: float
    slope_y: float
    spread_m: float

    def height_above(self, xyz: Numbers) -> Numbers:
        """Height of points ``(..., 3)`` above the plane, metres (vertical)."""
        height: Numbers = xyz[..., 2] - self.height_m - self.slope_x * xyz[..., 0] - self.slope_y * xyz[..., 1]
        return height

    def distance_along(self, direction: Numbers, origin_height_m: Numbers | float = 0.0) -> Numbers:
        """Way of beams to the plane, metres; ``inf`` where they rise.

        Args:
            direction: ``(..., 3)`` unit vectors.
            origin_height_m: at which the beams start, ``(...)``.
        """
        falls = self.slope_x * direction[..., 0] + self.slope_y * direction[..., 1] - direction[..., 2]
        above = np.asarray(origin_height_m, dtype=np.float64) - self.height_m
        with np.errstate(divide="ignore", invalid="ignore"):
            way: Numbers = np.where((falls > 0) & (above > 0), above / falls, np.inf)
        return way


def fit_ground(points_xyz: Numbers) -> GroundPlane | None:
    """Fit the ground of a sweep.

    Args:
        points_xyz: ``(N, 3 or more)`` metres in the sensor's frame, x forward, y left, z up; rows at the origin are no
            returns.

    Returns:
        The plane, or ``None`` where too few returns lie low or no plane fits most of them.

    Example:
        >>> x, y = np.meshgrid(np.linspace(-20, 20, 60), np.linspace(-20, 20, 60))
        >>> road = np.stack([x, y, -1.7 + 0.02 * x], -1).reshape(-1, 3)
        >>> plane = fit_ground(road)
        >>> round(plane.height_m, 3), round(plane.slope_x, 3)
        (-1.7, 0.02)
    """
    check_arguments("fit_ground(points_xyz: array)", points_xyz)
    if points_xyz.ndim != 2 or points_xyz.shape[1] < 3:
        raise InputValueError(f"fit_ground: points_xyz must be (N, 3 or more); got {points_xyz.shape}.")
    x, y, z = points_xyz[:: max(1, len(points_xyz) // _MOST_POINTS), :3].T.astype(np.float64)
    flat = np.hypot(x, y)
    with np.errstate(invalid="ignore"):
        low = (z > _LOWEST_M + -0.1 * flat) & (z < _HIGHEST_M + 0.1 * flat) & (flat > _NEAREST_M) & (flat < _FARTHEST_M)
    x, y, z = x[low], y[low], z[low]
    cells = _lowest_of_cells(x, y, z)
    if len(cells) < _FEWEST_CELLS:
        return None
    place, height = np.column_stack([np.ones(len(cells)), cells[:, :2]]), cells[:, 2]
    # The start decides which plane is found: the height at which most cells lie, near the sensor.
    near = height[np.hypot(cells[:, 0], cells[:, 1]) < 15.0]
    start = near if len(near) >= _FEWEST_CELLS // 2 else height
    counts, edges = np.histogram(start, bins=np.arange(_LOWEST_M, 0.5, 0.1))
    plane = np.array([edges[counts.argmax()] + 0.05, 0.0, 0.0])
    scale = 5.0 * _SCALE_M
    for _ in range(_ROUNDS):
        weight = 1.0 / (1.0 + np.square((height - place @ plane) / scale))
        weight = np.where(weight > 0.1, weight, 0.0)
        normal = place.T @ (place * weight[:, None]) + np.diag([0.0, 1.0, 1.0])
        plane = np.linalg.solve(normal, place.T @ (weight * height))
        scale = max(_SCALE_M, 0.7 * scale)
    off = np.abs(height - place @ plane)
    agrees = off < 3.0 * _SCALE_M
    if agrees.mean() < _LEAST_AGREEMENT or max(abs(plane[1]), abs(plane[2])) > _STEEPEST:
        return None
    return GroundPlane(float(plane[0]), float(plane[1]), float(plane[2]), float(np.median(off[agrees])))


def _lowest_of_cells(x: Numbers, y: Numbers, z: Numbers) -> Numbers:
    """A low point of each cell, ``(M, 3)``."""
    if not len(x):
        return np.zeros((0, 3))
    size = round(2 * _FARTHEST_M / _CELL_M) + 2
    cell = ((x + _FARTHEST_M) // _CELL_M).astype(np.intp) * size + ((y + _FARTHEST_M) // _CELL_M).astype(np.intp)
    order = np.argsort(cell + (z - z.min()) / (z.max() - z.min() + 1.0))  # by cell, then by height
    cell = cell[order]
    first = np.flatnonzero(np.r_[True, cell[1:] != cell[:-1]])
    count = np.diff(np.r_[first, len(cell)])
    chosen = order[first + (_LOW_SHARE * count).astype(np.intp)][count >= 3]
    return np.stack([x[chosen], y[chosen], z[chosen]], -1)
