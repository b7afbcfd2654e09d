"""Sweeps of a made drive: a road between walls that come and go, and an own car that hides beams and returns some."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from torchweather.sensors import Lidar

ELEVATIONS_DEG = tuple(np.r_[np.arange(-24.0, -4.0, 1.0), np.arange(-4.0, 3.1, 0.5)].tolist())
COLUMNS = 720
SENSOR = Lidar(905.0, elevations_deg=ELEVATIONS_DEG, columns=COLUMNS, max_range_m=100.0, intensity_unit="reflectivity")
SENSOR_M = 1.7
# The own car, in degrees: behind, it hides all beams below an elevation; to the left, a mirror returns at 1.1 m.
HIDDEN = (160.0, 200.0, -9.5)
MIRROR = (80.0, 86.0, -20.5, -15.5)
MIRROR_M = 1.1
PERSON = (20.0, 32.0)  # azimuths, degrees
PERSON_M = 2.0

Mask = npt.NDArray[np.bool_]


def rings_and_columns() -> tuple[npt.NDArray[Any], npt.NDArray[Any]]:
    """Ring and azimuth in degrees of every beam, ``(R * C,)`` each."""
    ring, column = (index.ravel() for index in np.mgrid[: len(ELEVATIONS_DEG), :COLUMNS])
    return ring, (column + 0.5) * 360.0 / COLUMNS


def hidden() -> Mask:
    """Beams that the car blocks, ``(R * C,)``."""
    ring, azimuth = rings_and_columns()
    found: Mask = (azimuth > HIDDEN[0]) & (azimuth < HIDDEN[1]) & (np.asarray(ELEVATIONS_DEG)[ring] < HIDDEN[2])
    return found


def mirror() -> Mask:
    """Beams that meet the mirror, ``(R * C,)``."""
    ring, azimuth = rings_and_columns()
    elevation = np.asarray(ELEVATIONS_DEG)[ring]
    found: Mask = (azimuth > MIRROR[0]) & (azimuth < MIRROR[1]) & (elevation > MIRROR[2]) & (elevation < MIRROR[3])
    return found


def sweep(place: float, *, person: bool = False, car: bool = True, seed: int | None = None) -> tuple[Tensor, Mask]:
    """A sweep at a place of the drive, ring after ring: ``(N, 4)`` float32, and which beams returned ``(R * C,)``.

    Args:
        place: along the drive; sweeps at one place show the same walls.
        person: stands 2 m in front of the car.
        car: whether the sensor stands on it.
        seed: of the noise.
    """
    rng = np.random.default_rng(int(1000 * place) if seed is None else seed)
    ring, azimuth_deg = rings_and_columns()
    elevation, azimuth = np.radians(np.asarray(ELEVATIONS_DEG)[ring]), np.radians(azimuth_deg)
    wall = (16.0 + 6.0 * np.cos(2.0 * azimuth + place) + 4.0 * np.sin(5.0 * azimuth - 2.0 * place)) / np.cos(elevation)
    with np.errstate(divide="ignore"):
        road = np.where(elevation < 0, SENSOR_M / -np.sin(elevation), np.inf)
    way = np.minimum(wall, road)
    if person:
        seen = (azimuth_deg > PERSON[0]) & (azimuth_deg < PERSON[1])
        way = np.where(seen, np.minimum(way, PERSON_M / np.cos(elevation)), way)
    way = np.where(mirror() & car, MIRROR_M, way) + 0.01 * rng.standard_normal(len(ring))
    beam = np.stack([np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)], -1)
    returned = ~(hidden() & car) & (rng.random(len(ring)) > 0.03)
    points = np.column_stack([beam * way[:, None], np.full(len(ring), 0.3)])[returned]
    return torch.from_numpy(points.astype(np.float32)), returned
