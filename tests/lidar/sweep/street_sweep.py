"""A sweep over a road beside a house and behind a car with panes, whose beams without return have known ends."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from torchweather.lidar.sweep.beam_ends import BeamEnd

Numbers = npt.NDArray[np.floating[Any]]

SENSOR_M = 1.7  # above the road
COLUMNS = 720
ELEVATIONS_DEG = np.concatenate([np.arange(-24.0, -6.0, 1.0), np.arange(-6.0, 6.1, 0.5)])
MAX_RANGE_M = 100.0
HOUSE = (12.0, 8.0)  # distance to the left, height above the sensor; metres
CAR = (9.0, 10.0, -1.0, 1.0, 1.5)  # from x, to x, from y, to y, height over the road
PANE = (0.8, 1.3)  # of the car's front, height over the road
OWN = (-160.0, 160.0, -14.0)  # azimuth beyond these and elevation below: the own vehicle


@dataclass(frozen=True)
class Sweep:
    """Returns and beams without one; ``truth`` and ``truth_m`` say what those meet and where."""

    points: Numbers
    ring: npt.NDArray[np.intp]
    direction: Numbers
    direction_ring: npt.NDArray[np.intp]
    truth: npt.NDArray[np.int8]
    truth_m: Numbers


def street(slope: float = 0.0) -> Sweep:
    """The sweep; ``slope`` is the road's rise to the front."""
    ring, column = (index.ravel() for index in np.mgrid[: len(ELEVATIONS_DEG), :COLUMNS])
    elevation = np.radians(ELEVATIONS_DEG[ring])
    azimuth_deg = (column + 0.5) * 360.0 / COLUMNS - 180.0
    azimuth = np.radians(azimuth_deg)
    d = np.stack([np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)], -1)
    with np.errstate(divide="ignore", invalid="ignore"):
        falls = slope * d[:, 0] - d[:, 2]
        road = np.where(falls > 0, SENSOR_M / falls, np.inf)
        house = np.where(d[:, 1] > 0, HOUSE[0] / d[:, 1], np.inf)
        house = np.where(house * d[:, 2] < HOUSE[1], house, np.inf)
        car = np.where(d[:, 0] > 0, CAR[0] / d[:, 0], np.inf)
        over_road = SENSOR_M + car * (d[:, 2] - slope * d[:, 0])
    on_car = np.isfinite(car) & (np.abs(car * d[:, 1]) < CAR[3]) & (over_road > 0) & (over_road < CAR[4])
    way = np.minimum(np.minimum(road, house), np.where(on_car, car, np.inf))
    pane = on_car & (car <= way) & (over_road > PANE[0]) & (over_road < PANE[1]) & (np.abs(car * d[:, 1]) < 0.7)
    own = ((azimuth_deg < OWN[0]) | (azimuth_deg > OWN[1])) & (ELEVATIONS_DEG[ring] < OWN[2])
    # Wet road returns nothing beyond 40 m; every fiftieth beam fails.
    failed = np.arange(len(ring)) % 50 == 7
    empty = pane | own | failed | (way > MAX_RANGE_M) | ((way == road) & (road > 40.0))
    truth = np.where(way > MAX_RANGE_M, BeamEnd.SKY, np.where(way == road, BeamEnd.GROUND, BeamEnd.OBSTACLE))
    truth = np.where(own, BeamEnd.OWN_VEHICLE, truth).astype(np.int8)
    truth_m = np.where(own, 0.0, np.minimum(way, MAX_RANGE_M))
    points = d[~empty] * way[~empty, None]
    return Sweep(points, ring[~empty], d[empty], ring[empty], truth[empty], truth_m[empty])
