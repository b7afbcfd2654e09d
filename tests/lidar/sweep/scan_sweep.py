"""Sweeps of a known scan pattern in a yard with walls and a road: what the estimators of patterns are tested on."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.floating[Any]]

# Two blocks of lasers at different heights, as in an HDL-64E, unevenly apart.
ELEVATIONS_DEG = np.r_[np.linspace(-24.0, -9.5, 12), np.linspace(-8.9, 2.0, 12)] + 0.05 * np.sin(np.arange(24.0))
HEIGHTS_M = np.r_[np.full(12, 0.12), np.full(12, 0.20)]
COLUMNS = 900
ROAD_M = -1.7


def sweep(
    elevations_deg: Array = ELEVATIONS_DEG,
    heights_m: Array = HEIGHTS_M,
    columns: int = COLUMNS,
    *,
    missing: float = 0.1,
    noise_m: float = 0.01,
    phase: float = 0.3,
    seed: int = 0,
) -> tuple[Array, npt.NDArray[np.int64]]:
    """A sweep, ring after ring: points ``(N, 4)`` float32 x, y, z, intensity and the ring of each."""
    rng = np.random.default_rng(seed)
    ring, column = (values.reshape(-1) for values in np.mgrid[: len(elevations_deg), :columns])
    angle = 2.0 * np.pi * (column + phase) / columns
    rise = np.tan(np.radians(elevations_deg))[ring]
    wall = 14.0 + 6.0 * np.cos(3.0 * angle + seed) + 3.0 * np.sin(11.0 * angle) + 2.0 * (ring % 3)
    with np.errstate(divide="ignore"):
        road = np.where(rise < 0, (ROAD_M - heights_m[ring]) / rise, np.inf)
    flat = np.minimum(wall, road) + noise_m * rng.standard_normal(len(ring)) * np.cos(np.arctan(rise))
    points = np.stack(
        [flat * np.cos(angle), flat * np.sin(angle), heights_m[ring] + flat * rise, np.full(len(ring), 0.3)], -1
    )
    seen = rng.random(len(ring)) >= missing
    return points[seen].astype(np.float32), ring[seen].astype(np.int64)


def turned_about_y(points: Array, degrees: float) -> Array:
    """The cloud of a sensor whose nose is lowered by an angle."""
    tilt = np.radians(degrees)
    turn = np.array([[np.cos(tilt), 0.0, -np.sin(tilt)], [0.0, 1.0, 0.0], [np.sin(tilt), 0.0, np.cos(tilt)]])
    moved = points.copy()
    moved[:, :3] = points[:, :3] @ turn
    return moved
