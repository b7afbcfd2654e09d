"""Where the sensor of a cloud stands, from the cones of its lasers.

The ring that a laser draws on level ground is a circle about the sensor, and all that it meets lies on a cone whose tip
is the sensor. Where the circles are off centre about the cloud's origin, or the tips lie above it, the cloud is in
another frame than its sensor's: that of the vehicle (Waymo: the rear axle) or of a map.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from torchweather.lidar.sweep.frame_fit import FrameOffset, fit_frame
from torchweather.lidar.sweep.ring_order import rings_from_order

__all__ = ["SensorOrigin", "estimate_origin"]

Numbers = npt.NDArray[np.floating[Any]]
Integers = npt.NDArray[np.integer[Any]]

_FEWEST_POINTS = 2000
_FEWEST_RINGS = 4
# So many rows decide; more cost time alone.
_ROWS = 8_000
_ROUNDS = 2
_NEAREST_M = 4.0
_SECTORS = 8
_ROWS_OF_A_RING = 20
# Rows that follow each other along a ring: this share of the steps in azimuth is small. A larger step back is a gap.
_FOLLOWING, _SMALL_STEP_DEG, _BACK_DEG = 0.9, 5.0, 90.0
# The cloud's own middle is tried too where it is so far from its origin (a cloud in the frame of a map).
_FAR_M = 3.0
# Of the points about their cones, once the tip is right: more is no sweep of one sensor.
_MOST_SPREAD_DEG = 0.15
# No sensor's beams start farther from its origin (HDL-64E: 0.21 m).
_BESIDE_M, _ABOVE_M = 0.3, 0.5
_SURE = 4.0  # errors
# Seen from beside, the points must come nearer to their cones by this factor (a crop of 90 degrees shows no place).
_LEAST_GAIN = 1.3


@dataclass(frozen=True)
class SensorOrigin:
    """Where the sensor stands in the cloud's frame.

    Args:
        origin_m: x, y, z of the tip of the lasers' cones, metres; in the middle of the turn where the cloud is
            compensated for motion. z is that of the median laser.
        error_m: of each: half the distance between the answers of two halves of the turn.
        motion_m: way of the tip along x and y during the turn.
        spread_deg: median distance of the points from their cones, seen from there.
        spread_at_zero_deg: the same, seen from the cloud's origin (from above or below it, as fits best).
        rings: number of rings.
        found_by: how the rings were found: ``ring column`` or ``file order``.
    """

    origin_m: tuple[float, float, float]
    error_m: tuple[float, float, float]
    motion_m: tuple[float, float]
    spread_deg: float
    spread_at_zero_deg: float
    rings: int
    found_by: str

    @property
    def is_apart(self) -> bool:
        """Check whether the cloud is surely in another frame than its sensor's."""
        x, y, z = self.origin_m
        beside_m, error_m = float(np.hypot(x, y)), float(np.hypot(*self.error_m[:2]))
        # Compensation for motion moves the tip by up to its way, whatever moment it refers to.
        gains = self.spread_deg * _LEAST_GAIN < self.spread_at_zero_deg
        beside = gains and beside_m > max(_BESIDE_M + float(np.hypot(*self.motion_m)), _SURE * error_m)
        above = abs(z) > max(_ABOVE_M, _SURE * self.error_m[2])
        return self.spread_deg < _MOST_SPREAD_DEG and (beside or above)

    @property
    def sentence(self) -> str:
        """The evidence, and what to pass."""
        x, y, z = self.origin_m
        errors = ", ".join(f"{error:.2f}" for error in self.error_m)
        return (
            f"The cones of {self.rings} rings ({self.found_by}) meet in ({x:.2f}, {y:.2f}, {z:.2f}) m, +- ({errors}), "
            f"not in the cloud's origin: points lie {self.spread_deg:.3f} degree off cones from there, "
            f"{self.spread_at_zero_deg:.3f} off cones on the origin's own axis. The sensor stands there, and weather "
            f"would gather about another place. Pass Lidar(origin_m=({x:.2f}, {y:.2f}, {z:.2f})), on the command line "
            f"--sensor-origin {x:.2f} {y:.2f} {z:.2f}, or the pose of the sensor."
        )


def estimate_origin(points_xyz: Numbers, ring: Integers | None = None) -> SensorOrigin | None:
    """Estimate where the sensor of a cloud stands.

    Args:
        points_xyz: ``(N, 3 or more)`` metres, z up, of one sweep; rows at the origin are no returns.
        ring: ``(N,)`` ring of each row, below 0 for none; ``None`` takes the order of the rows (KITTI, Waymo).

    Returns:
        The place, or ``None`` where no rings are found.

    Note:
        KITTI, RADIATE and nuScenes moved by (1.43, 0, 2.18) m: found to 0.02 m across and 0.02 m in height over the
        sensor's own (0.16 m, HDL-64E), nuScenes, compensated for motion, to 0.3 m along its way.

    Example:
        >>> rng = np.random.default_rng(0)
        >>> ring, angle, rho = rng.integers(0, 16, 8000), rng.uniform(0, 6.28, 8000), rng.uniform(5, 40, 8000)
        >>> z = 2.0 + rho * np.tan(np.radians(2.0 * ring - 15.0))
        >>> found = estimate_origin(np.stack([1.5 + rho * np.cos(angle), rho * np.sin(angle), z], -1), ring)
        >>> (np.round(found.origin_m, 2) + 0.0).tolist(), found.is_apart
        ([1.5, 0.0, 2.0], True)
    """
    xyz = np.asarray(points_xyz, dtype=np.float64)[:, :3]
    there = np.isfinite(xyz).all(1) & (xyz != 0).any(1)
    if ring is not None:
        there &= ring >= 0
    xyz = xyz[there]
    if len(xyz) < _FEWEST_POINTS:
        return None
    own = None if ring is None else _numbered(np.asarray(ring)[there])
    middle = np.median(xyz[:, :2], axis=0)
    starts = [np.zeros(3)] + ([np.array([*middle, 0.0])] if np.hypot(*middle) > _FAR_M else [])
    tried = [_from(xyz, own, start) for start in starts]
    found = [one for one in tried if one is not None]
    if not found:
        return None
    place, rings, offset = min(found, key=lambda one: one[2].corrected_spread_deg)
    return _answer(xyz, place, rings, offset, "file order" if own is None else "ring column")


def _numbered(ring: Integers) -> Integers:
    """Rings from 0 on without gaps."""
    found: Integers = np.unique(ring, return_inverse=True)[1].reshape(-1)
    return found


def _from(xyz: Numbers, own: Integers | None, start: Numbers) -> tuple[Numbers, Integers, FrameOffset] | None:
    """Where the cones meet, the rings and the fit about that place, begun at one place."""
    place, offset = start, None
    rings = _turns(xyz - place) if own is None else own
    for number in range(_ROUNDS):
        if rings is None or int(rings.max()) + 1 < _FEWEST_RINGS:
            return None
        offset = _fitted(xyz - place, rings)
        if offset is None:
            return None
        place = place + _tip(offset)
        if own is None and number == 0:
            # Seen from about the sensor the rows of a ring follow each other in azimuth; before, not quite.
            exact = rings_from_order(np.where(np.abs(xyz - place) < 1e-9, 1e-9, xyz - place))
            rings = rings if exact is None else exact
    assert rings is not None
    assert offset is not None
    return place, rings, offset


def _turns(xyz: Numbers) -> Integers | None:
    """Number of the turn about the vertical axis that each row is in, -1 for rows near it.

    The rows of a ring go round a place inside it, though not evenly; rows at both ends may be on the neighbour.
    """
    turns = np.full(len(xyz), -1, dtype=np.int64)
    away = np.hypot(xyz[:, 0], xyz[:, 1]) > _NEAREST_M
    if away.sum() < _FEWEST_POINTS:
        return None
    azimuth = np.degrees(np.arctan2(xyz[away, 1], xyz[away, 0]))
    step = np.diff(azimuth)
    step -= 360.0 * np.round(step / 360.0)
    small = np.abs(step) < _SMALL_STEP_DEG
    if small.mean() < _FOLLOWING:
        return None
    step *= np.sign(np.sum(step[small])) or 1.0
    step[step < -_BACK_DEG] += 360.0
    way = np.r_[0.0, np.cumsum(step)]
    turns[away] = np.floor((way - way.min()) / 360.0).astype(np.int64)
    return turns


def _fitted(xyz: Numbers, rings: Integers) -> FrameOffset | None:
    known = (rings >= 0) & (np.hypot(xyz[:, 0], xyz[:, 1]) > _NEAREST_M)
    step = max(1, int(known.sum()) // _ROWS)
    part, ring = xyz[known][::step], rings[known][::step]
    count = np.bincount(ring, minlength=1)
    many = count[ring] >= _ROWS_OF_A_RING
    part, ring = part[many], _numbered(ring[many])
    if len(part) < _FEWEST_POINTS // 4 or int(ring.max()) + 1 < _FEWEST_RINGS:
        return None
    with np.errstate(all="ignore"), warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        try:
            found = fit_frame(part, ring, int(ring.max()) + 1)
        except np.linalg.LinAlgError:
            return None
    return found if np.isfinite(_tip(found)).all() else None


def _tip(offset: FrameOffset) -> Numbers:
    """Tip of the cones in the middle of the turn."""
    x, y = (origin + 0.5 * motion for origin, motion in zip(offset.origin_m, offset.motion_m, strict=True))
    known = offset.cones.height_m[np.isfinite(offset.cones.height_error_m)]
    heights = known if len(known) else offset.cones.height_m
    return np.array([x, y, float(np.nanmedian(heights))])


def _answer(xyz: Numbers, place: Numbers, rings: Integers, offset: FrameOffset, found_by: str) -> SensorOrigin:
    moved = xyz - place
    sector = np.floor((np.arctan2(moved[:, 1], moved[:, 0]) / np.pi + 1.0) * (_SECTORS / 2)).astype(np.intp) % 2
    one, other = (_fitted(moved[sector == half], rings[sector == half]) for half in (0, 1))
    error = np.full(3, np.inf) if one is None or other is None else 0.5 * np.abs(_tip(one) - _tip(other))
    axis = _fitted(xyz, rings) if np.hypot(*place[:2]) > 0 else offset
    x, y, z = (float(value) for value in place)
    return SensorOrigin(
        (x, y, z),
        (float(error[0]), float(error[1]), float(error[2])),
        offset.motion_m,
        offset.corrected_spread_deg,
        offset.spread_deg if axis is None else axis.spread_deg,
        int(rings.max()) + 1,
        found_by,
    )
