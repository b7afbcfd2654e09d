"""The scan pattern and the first surface that each of its beams meets."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .scene import SENSOR_HEIGHT_M, FloatArray, Scene

__all__ = ["Scan", "Target", "cast", "scan_pattern"]

# Highest and lowest ring: much of the sensor's view, most rings near the horizon, deg.
HIGHEST_DEG, LOWEST_DEG = 14.0, -22.0
# Edge of the ground's patches, and the spread of log reflectivity between patches and over a box.
PATCH_M, PATCH_SPREAD, TEXTURE_SPREAD = 2.0, 0.25, 0.1


@dataclass(frozen=True)
class Scan:
    """Beams of a grid of ``rings x columns``.

    Args:
        elevation_deg: of each ring, falling.
        direction: ``(H, W, 3)`` unit vectors, x forward, y left, z up; the azimuth falls with the column.
    """

    elevation_deg: FloatArray
    direction: FloatArray

    @property
    def shape(self) -> tuple[int, int]:
        """Rings and columns."""
        return self.direction.shape[0], self.direction.shape[1]

    @property
    def azimuth_rad(self) -> FloatArray:
        """``(N,)``, -pi..pi."""
        flat = self.direction.reshape(-1, 3)
        return np.asarray(np.arctan2(flat[:, 1], flat[:, 0]))

    @property
    def ring(self) -> FloatArray:
        """``(N,)`` row of each beam."""
        rings, columns = self.shape
        return np.repeat(np.arange(rings, dtype=np.float64), columns)

    @property
    def column(self) -> FloatArray:
        """``(N,)`` column of each beam."""
        rings, columns = self.shape
        return np.tile(np.arange(columns, dtype=np.float64), rings)

    def turned(self, yaw_rad: float, pitch_rad: float) -> Scan:
        """The same pattern from a sensor that is turned left by the yaw and nods down by the pitch."""
        cos, sin = np.cos(yaw_rad), np.sin(yaw_rad)
        yaw = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
        cos, sin = np.cos(pitch_rad), np.sin(pitch_rad)
        pitch = np.array([[cos, 0.0, sin], [0.0, 1.0, 0.0], [-sin, 0.0, cos]])
        return Scan(self.elevation_deg, self.direction @ (yaw @ pitch).T)


def scan_pattern(rings: int, columns: int) -> Scan:
    """Rings that crowd around the horizon and columns clockwise from straight ahead."""
    step = np.linspace(-1.0, 1.0, rings)
    bent = 0.6 * step + 0.4 * step**3
    middle, half = 0.5 * (HIGHEST_DEG + LOWEST_DEG), 0.5 * (HIGHEST_DEG - LOWEST_DEG)
    elevation_deg = np.round(middle - half * bent, 2)
    elevation = np.radians(elevation_deg)[:, None]
    azimuth = -2.0 * np.pi * np.arange(columns)[None, :] / columns
    direction = np.stack(
        [np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation) + 0.0 * azimuth],
        -1,
    )
    return Scan(elevation_deg, direction)


@dataclass(frozen=True)
class Target:
    """The first surface of each beam, ``(N,)`` each.

    Args:
        range_m: infinite where there is none.
        reflectivity: Lambertian, 0 where there is none.
        cos_incidence: NaN where there is none.
        up: z of the surface's normal, NaN where there is none.
    """

    range_m: FloatArray
    reflectivity: FloatArray
    cos_incidence: FloatArray
    up: FloatArray


def _patch(position: FloatArray, edge_m: float, seed: int) -> FloatArray:
    """A standard normal draw that belongs to the patch in which a point lies, ``(N,)`` from ``(N, K)``."""
    cells = np.floor(position / edge_m).astype(np.int64)
    mixed = np.full(len(cells), seed, dtype=np.uint64)
    for axis in range(cells.shape[1]):  # splitmix64 (Steele, Lea & Flood 2014), axis after axis
        mixed = mixed + cells[:, axis].astype(np.uint64) * np.uint64(0x9E3779B97F4A7C15) + np.uint64(axis + 1)
        mixed = (mixed ^ (mixed >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
        mixed = (mixed ^ (mixed >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
        mixed = mixed ^ (mixed >> np.uint64(31))
    first = ((mixed >> np.uint64(40)).astype(np.float64) + 0.5) / 2.0**24
    second = ((mixed & np.uint64(0xFFFFFF)).astype(np.float64) + 0.5) / 2.0**24
    return np.asarray(np.sqrt(-2.0 * np.log(first)) * np.cos(2.0 * np.pi * second))


def cast(scene: Scene, scan: Scan, max_range_m: float, height_m: float = SENSOR_HEIGHT_M) -> Target:
    """The nearest surface along each beam, not farther than ``max_range_m``, from a height over the ground."""
    beam = scan.direction.reshape(-1, 3)
    n = len(beam)
    with np.errstate(divide="ignore"):
        nearest = np.where((beam[:, 2] < 0.0) & (height_m > 0.0), -height_m / beam[:, 2], np.inf)
    cosine, up, owner = np.abs(beam[:, 2]), np.ones(n), np.full(n, -1)
    for number, box in enumerate(scene.boxes):
        cos, sin = np.cos(box.yaw_rad), np.sin(box.yaw_rad)
        turn = np.array([[cos, sin, 0.0], [-sin, cos, 0.0], [0.0, 0.0, 1.0]])
        origin = turn @ -np.array([box.x_m, box.y_m, 0.5 * box.height_m - height_m])
        local = beam @ turn.T
        half = 0.5 * np.array([box.length_m, box.width_m, box.height_m])
        safe = np.where(np.abs(local) < 1e-12, 1e-12, local)
        ends = np.stack([(-half - origin) / safe, (half - origin) / safe])
        entry, leave = ends.min(0), ends.max(0)
        face = entry.argmax(1)
        enter = entry.max(1)
        hit = (enter <= leave.min(1)) & (enter > 0.0) & (enter < nearest)
        nearest = np.where(hit, enter, nearest)
        cosine = np.where(hit, np.abs(np.take_along_axis(local, face[:, None], 1)[:, 0]), cosine)
        up = np.where(hit, (face == 2).astype(np.float64), up)
        owner = np.where(hit, number, owner)
    nearest = np.where(nearest <= max_range_m, nearest, np.inf)
    seen = np.isfinite(nearest)
    point = beam * np.where(seen, nearest, 0.0)[:, None]
    level = np.array([box.reflectivity for box in scene.boxes] + [scene.ground_reflectivity])[owner]
    patch = PATCH_SPREAD * _patch(point[:, :2], PATCH_M, scene.patch_seed)
    texture = TEXTURE_SPREAD * _patch(point, 0.5, scene.patch_seed + 1)
    reflectivity = np.clip(level * np.exp(np.where(owner < 0, patch, texture)), 0.02, 0.9)
    return Target(
        nearest,
        np.where(seen, reflectivity, 0.0),
        np.where(seen, cosine, np.nan),
        np.where(seen, up, np.nan),
    )
