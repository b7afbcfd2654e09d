"""Frame of a cloud in a millisecond: tilt, place and motion of the sensor by one regression; see `frame_fit`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

__all__ = ["QuickFrame", "quick_frame"]

Numbers = npt.NDArray[np.floating[Any]]
Integers = npt.NDArray[np.integer[Any]]

_TURN_DEG = 360.0
_FEWEST_ROWS = 500
# Tilt, degrees, place beside the origin and motion a turn, metres, by regression of the distances from the cones: KITTI
# 0.000 degree, 0.00 and 0.00 m; nuScenes 0.02 degree, 0.04 and 0.39 m; Seeing Through Fog 0.00, 0.02 and 0.04.
_TILT_DEG, _BESIDE_M, _MOVES_M = 0.15, 0.3, 0.1
_ROWS, _ROUNDS, _FROM_M = 4_000, 3, 4.0
# The points must come nearer to their cones by this factor, and lie off them by more than a sensor's own noise.
_LEAST_GAIN, _LEAST_RAD = 1.3, np.radians(0.01)
# The turn begins where the azimuth wraps, in one of the two ways.
_STARTS_DEG = (0.0, 180.0)


@dataclass(frozen=True)
class QuickFrame:
    """Frame of a cloud.

    Args:
        tilt_deg: of the sensor's plane.
        origin_m: x and y of the sensor at the start of the turn.
        motion_m: its way along x and y during the turn (a cloud that is compensated for motion).
        start_deg: azimuth at which the turn is taken to begin.
        left_deg: median distance of the points from their cones that these leave.
    """

    tilt_deg: float = 0.0
    origin_m: tuple[float, float] = (0.0, 0.0)
    motion_m: tuple[float, float] = (0.0, 0.0)
    start_deg: float = 0.0
    left_deg: float = 0.0

    @property
    def moves(self) -> bool:
        """True where the sensor moved during the turn."""
        return float(np.hypot(*self.motion_m)) > _MOVES_M

    @property
    def fits(self) -> bool:
        """Level, and no farther beside the origin than the motion explains."""
        middle = np.asarray(self.origin_m) + 0.5 * np.asarray(self.motion_m)
        beside_m = float(np.hypot(*middle)) - 0.5 * float(np.hypot(*self.motion_m))
        return self.tilt_deg <= _TILT_DEG and beside_m <= _BESIDE_M

    def stood_still(self, cloud: Tensor, min_range_m: float) -> Tensor:
        """The cloud seen from where the sensor was at each row; rows nearer than it measures are no returns and stay.

        No return comes to lie nearer either: it stays where it is.
        """
        x, y = cloud[:, 0], cloud[:, 1]
        turn = (torch.rad2deg(torch.atan2(y, x)) - self.start_deg) % _TURN_DEG / _TURN_DEG
        moved = cloud.clone()
        for axis in (0, 1):
            moved[:, axis] -= self.origin_m[axis] + turn * self.motion_m[axis]
        seen = (cloud[:, :3] != 0).any(1)
        for one in (cloud, moved):
            seen &= one[:, :3].square().sum(1) >= min_range_m**2
        return torch.where(seen[:, None], moved, cloud)


def quick_frame(xyz: Numbers, number: Integers, elevations: Numbers, heights: Numbers) -> QuickFrame:
    """Regress the distances from the cones on what tilt, place and motion do to them.

    Args:
        xyz: ``(N, 3)`` metres.
        number: ``(N,)`` ring of each row, below 0 for none.
        elevations: ``(K,)`` of the rings, degrees.
        heights: ``(K,)`` at which their beams start, metres.

    Returns:
        The frame; that of the sensor where the points lie on their cones as they are.
    """
    rings = len(elevations)
    part = np.flatnonzero(number >= 0)
    part = part[:: max(1, len(part) // _ROWS)]
    x, y, z = xyz[part].T.astype(np.float64)
    flat = np.hypot(x, y)
    far = flat > _FROM_M
    if far.sum() < _FEWEST_ROWS:
        return QuickFrame()
    x, y, z, flat, ring = x[far], y[far], z[far], flat[far], number[part][far]
    lasers = np.radians(elevations)[ring]
    off = np.arctan2(z - heights[ring], flat) - lasers
    cosine, sine, lever = x / flat, y / flat, -np.sin(lasers) * np.cos(lasers) / flat
    azimuth = np.degrees(np.arctan2(y, x))
    best, best_spread = QuickFrame(), np.inf
    count = np.maximum(np.bincount(ring, minlength=rings), 1)
    for start in _STARTS_DEG:
        turn = (azimuth - start) % _TURN_DEG / _TURN_DEG
        columns = (cosine, sine, lever * cosine, lever * sine, lever * turn * cosine, lever * turn * sine, off)
        design = np.stack([column - (np.bincount(ring, column, rings) / count)[ring] for column in columns], -1)
        weight = np.ones(len(design))
        for _ in range(_ROUNDS):
            weighted = design[:, :6] * weight[:, None]
            normal = design[:, :6].T @ weighted + 1e-9 * np.eye(6)
            found = np.linalg.solve(normal, weighted.T @ design[:, 6])
            left = np.abs(design[:, 6] - design[:, :6] @ found)
            spread = float(np.median(left)) + 1e-9
            weight = 1.0 / np.maximum(1.0, np.square(left / (3.0 * spread)))
        if spread < best_spread:
            tilt = float(np.degrees(np.hypot(found[0], found[1])))
            best_spread = spread
            place, motion = (float(found[2]), float(found[3])), (float(found[4]), float(found[5]))
            best = QuickFrame(tilt, place, motion, start, float(np.degrees(spread)))
    before = float(np.median(np.abs(design[:, 6])))
    return best if best_spread * _LEAST_GAIN < before and before > _LEAST_RAD else QuickFrame()
