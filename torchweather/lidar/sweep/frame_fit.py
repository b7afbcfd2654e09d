"""Frame of a cloud compared with its sensor's: tilt, offset of the origin, motion during the turn.

In the sensor's frame the points of ring k lie on ``z = h_k + rho tan e_k``. A small tilt (a, b), an origin beside that
of the cloud (o) and a motion of v metres a turn, phase f of the turn, change that by terms that all rings share:

``z / rho = tan e_k + h_k / rho + a cos A + b sin A - tan e_k (o + f v) . (cos A, sin A) / rho``
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from torchweather.lidar.sweep.cone_fit import ConeFit, cone_residual_deg, fit_cones

__all__ = ["FrameOffset", "fit_frame"]

Numbers = npt.NDArray[np.floating[Any]]
Integers = npt.NDArray[np.integer[Any]]

_ROUNDS = 6
_OUTLIER_SPREADS = 3.0
_TURN_DEG = 360.0
_FEWEST_ROWS = 20
# The turn begins where azimuth wraps, in one of the two ways.
_STARTS_DEG = (0.0, 180.0)
# What is worth a word: smaller values move a point by less than a beam.
_LEAST_TILT_DEG = 0.1
_LEAST_SHIFT_M = 0.1
# The points must come nearer to their cones by this factor.
_LEAST_GAIN = 1.3


@dataclass(frozen=True)
class FrameOffset:
    """Frame of a cloud compared with its sensor's.

    Args:
        tilt_deg: rise of the sensor's plane along x and along y.
        origin_m: x and y of the sensor in the cloud, at the start of the turn.
        motion_m: its way along x and y during the turn (a cloud that is compensated for motion).
        spread_deg: median spread of the rings about their cones in the cloud's frame,
        corrected_spread_deg: and in the sensor's.
        cones: in the sensor's frame, tilt, origin and motion taken out.
        start_deg: azimuth at which the turn is taken to begin.
    """

    tilt_deg: tuple[float, float]
    origin_m: tuple[float, float]
    motion_m: tuple[float, float]
    spread_deg: float
    corrected_spread_deg: float
    cones: ConeFit
    start_deg: float = 0.0

    def in_sensor_frame(self, xyz: Numbers) -> Numbers:
        """Points ``(N, 3)`` without tilt, origin and motion; heights stay those over the cloud's origin."""
        tilt = np.radians(self.tilt_deg)
        return _in_sensor_frame(xyz, np.array([*tilt, *self.origin_m, *self.motion_m]), self.start_deg)[0]

    def sentences(self) -> tuple[str, ...]:
        """Notes on what differs, with what to do."""
        if self.corrected_spread_deg * _LEAST_GAIN > self.spread_deg:
            return ()
        found = []
        evidence = (
            f"the points then lie {self.corrected_spread_deg:.3f} degree from their cones instead of "
            f"{self.spread_deg:.3f}"
        )
        if np.hypot(*self.tilt_deg) > _LEAST_TILT_DEG:
            found.append(
                f"The cloud is tilted against its sensor, whose plane rises {self.tilt_deg[0]:+.2f} degrees along "
                f"x and {self.tilt_deg[1]:+.2f} along y ({evidence}). Pass Lidar(rotation=...) or a pose."
            )
        if np.hypot(*self.motion_m) > _LEAST_SHIFT_M:
            found.append(
                f"The cloud is compensated for motion: the sensor moves ({self.motion_m[0]:+.2f}, "
                f"{self.motion_m[1]:+.2f}) m during the turn ({evidence}). Near points lie off their beams."
            )
        height = float(np.nanmedian(self.cones.height_m))
        if self.stands_apart:
            found.append(
                f"The sensor stands at ({self.origin_m[0]:.2f}, {self.origin_m[1]:.2f}, {height:.2f}) m in the cloud's "
                f"frame ({evidence}). Pass Lidar(origin_m=...)."
            )
        return tuple(found)

    @property
    def stands_apart(self) -> bool:
        """Check whether the sensor stands beside the cloud's origin, seen from above."""
        return bool(np.hypot(*self.origin_m) > _LEAST_SHIFT_M >= np.hypot(*self.motion_m))


def fit_frame(xyz: Numbers, ring: Integers, rings: int) -> FrameOffset:
    """Fit the frame of a cloud whose rings are known.

    Args:
        xyz: ``(N, 3)`` metres.
        ring: ``(N,)`` 0 to ``rings - 1``.
        rings: number of rings.

    Returns:
        Tilt, origin and motion that bring the points onto cones; small tilts and offsets of a few metres only.

    Example:
        >>> rng = np.random.default_rng(0)
        >>> ring, angle, rho = rng.integers(0, 8, 8000), rng.uniform(0, 6.28, 8000), rng.uniform(5, 40, 8000)
        >>> z = rho * np.tan(np.radians(3.0 * ring - 20.0))
        >>> x, y = rho * np.cos(angle), rho * np.sin(angle)
        >>> offset = fit_frame(np.stack([x + 1.0, y, z + 0.02 * x], -1), ring, 8)
        >>> (np.round(offset.tilt_deg, 1) + 0.0).tolist(), (np.round(offset.origin_m, 1) + 0.0).tolist()
        ([1.1, 0.0], [1.0, 0.0])
    """
    # A ring of a few points lies on a cone whatever the frame.
    many = np.bincount(ring, minlength=rings)[ring] >= _FEWEST_ROWS
    if many.any():
        xyz, ring = xyz[many], ring[many]
    first = fit_cones(xyz, ring, rings)
    before = _middle(first)
    found = [_fitted(xyz.astype(np.float64), ring, rings, first, start) for start in _STARTS_DEG]
    best = int(np.argmin([_middle(cones) for _, cones in found]))
    common, cones = found[best]
    tilt = (float(np.degrees(common[0])), float(np.degrees(common[1])))
    return FrameOffset(
        tilt,
        (float(common[2]), float(common[3])),
        (float(common[4]), float(common[5])),
        before,
        _middle(cones),
        cones,
        _STARTS_DEG[best],
    )


def _middle(cones: ConeFit) -> float:
    return float(np.nanmedian(cones.spread_deg))


def _fitted(xyz: Numbers, ring: Integers, rings: int, cones: ConeFit, start_deg: float) -> tuple[Numbers, ConeFit]:
    common = np.zeros(6)
    for _ in range(_ROUNDS):
        moved, turn = _in_sensor_frame(xyz, common, start_deg)
        cones = fit_cones(moved, ring, rings)
        common = common + _step(moved, turn, ring, rings, cones)
    moved, _ = _in_sensor_frame(xyz, common, start_deg)
    return common, fit_cones(moved, ring, rings)


def _in_sensor_frame(xyz: Numbers, common: Numbers, start_deg: float) -> tuple[Numbers, Numbers]:
    a, b, ox, oy, vx, vy = common
    turn = (np.degrees(np.arctan2(xyz[:, 1], xyz[:, 0])) - start_deg) % _TURN_DEG / _TURN_DEG
    x, y = xyz[:, 0] - ox - turn * vx, xyz[:, 1] - oy - turn * vy
    return np.stack([x, y, xyz[:, 2] - a * x - b * y], -1), turn


def _step(xyz: Numbers, turn: Numbers, ring: Integers, rings: int, cones: ConeFit) -> Numbers:
    """Change of the common terms: residuals on covariates, both less what each ring's own cone takes up."""
    flat = np.maximum(np.hypot(xyz[:, 0], xyz[:, 1]), 1e-6)
    cosine, sine, near = xyz[:, 0] / flat, xyz[:, 1] / flat, 1.0 / flat
    lever = -np.tan(np.radians(cones.elevation_deg))[ring] * near
    columns = np.stack([cosine, sine, lever * cosine, lever * sine, lever * turn * cosine, lever * turn * sine], -1)
    residual = np.radians(cone_residual_deg(xyz, ring, cones))
    spread = np.radians(np.maximum(cones.spread_deg, 1e-4))[ring]
    weight = 1.0 / np.maximum(1.0, np.square(residual / (_OUTLIER_SPREADS * spread))) / np.square(spread)
    weight = np.where(np.isfinite(weight), weight, 0.0)
    every = np.column_stack([columns, residual])
    own = np.stack([weight, weight * near, weight * near * near], -1)
    sums = np.stack([np.bincount(ring, part, rings) for part in own.T], -1)
    w, wu, wuu = np.maximum(sums[:, 0], 1e-300), sums[:, 1], sums[:, 2]
    variance = np.maximum(wuu - wu * wu / w, 1e-300)
    for place in range(every.shape[1]):  # residualise on (1, 1 / rho) of each ring
        value = every[:, place]
        wv = np.bincount(ring, weight * value, rings)
        slope = (np.bincount(ring, weight * value * near, rings) - wu * wv / w) / variance
        every[:, place] = value - (wv / w - slope * wu / w)[ring] - slope[ring] * near
    design, wanted = every[:, :6], every[:, 6]
    normal = design.T @ (design * weight[:, None])
    # A sliver of a prior: 10 degrees, 5 m; keeps a half turn or a flat ring from running away.
    prior = np.diag([1 / 0.17**2] * 2 + [1 / 25.0] * 4) * float(np.median(weight))
    step: Numbers = np.linalg.solve(normal + prior, design.T @ (weight * wanted))
    return step
