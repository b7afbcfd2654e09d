"""Rings of a sweep's points and the pattern that they follow: the sensor's own, or one estimated from the sweep."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from torchweather.core.arrays import as_numpy
from torchweather.lidar.scan import recover_ring
from torchweather.lidar.sensor import Lidar
from torchweather.lidar.sweep.ring_order import rings_from_order
from torchweather.lidar.sweep.scan_pattern import estimate_pattern

__all__ = ["SweepRings", "sweep_rings"]

Numbers = npt.NDArray[np.floating[Any]]
Integers = npt.NDArray[np.integer[Any]]

# A ring whose points lie farther than this from its cone, in the median, is not the sensor's. Neighbouring rings of
# an HDL-64E are 0.3 degrees apart; motion compensation moves points by less than 0.1 degree. Where rings are far apart,
# a quarter of the way to the next is still no reason to distrust the sensor's table.
_OFF_RING_DEG = 0.1
_OFF_SPACING = 0.25
# Of this many rings: one ring alone may show little but the own vehicle.
_OFF_SHARE = 0.05
# So many points are enough for the medians: about 300 a ring.
_MOST_POINTS = 20_000
_FEWEST = 20
# Near points say little: 0.05 m of the vehicle's motion is 0.6 degrees at 5 m.
_FROM_M = 8.0


@dataclass(frozen=True)
class SweepRings:
    """Rings of a sweep.

    Args:
        ring: ``(N,)`` int64 ring of every row in the numbers of ``sensor``, -1 for a row without return.
        sensor: the LiDAR, with the pattern that the sweep follows.
        words: how the rings were found, for the manifest.
    """

    ring: Tensor
    sensor: Lidar
    words: str


def sweep_rings(cloud: Tensor, sensor: Lidar) -> SweepRings:
    """Find the ring of every point of a sweep.

    From the ring column; or from the order of the rows, if that shows as many rings as the sensor has; or, where
    neither exists, as the ring nearest in elevation. Where rings of a column or of the order do not lie on the
    sensor's cones, the pattern is estimated from the sweep.

    Args:
        cloud: ``(N, C)`` x, y, z in metres in the sensor's frame, further columns.
        sensor: with ``elevations_deg`` and ``columns``.

    Returns:
        The rings, and the sensor with the pattern that fits them.
    """
    elevations = sensor.elevations_deg
    if elevations is None or sensor.columns is None:
        return SweepRings(recover_ring(cloud, sensor), sensor, "")  # raises, and says what the sensor lacks
    xyz = cloud[:, :3].detach().cpu().double().numpy()
    squared_m2 = np.einsum("nk,nk->n", xyz, xyz)
    seen = (squared_m2 > 0) & (squared_m2 >= sensor.min_range_m**2)
    ring = np.full(len(xyz), -1, np.int64)
    if sensor.ring_column is not None:
        column = as_numpy(cloud[:, sensor.ring_column]).astype(np.int64)
        inside = seen & (column >= 0) & (column < len(elevations))
        ring[inside] = column[inside]
        words = "rings from the ring column"
    else:
        returns = xyz if seen.all() else xyz[seen]
        ordered = rings_from_order(returns)
        if ordered is None or int(ordered.max(initial=-1)) + 1 != len(elevations):
            return SweepRings(recover_ring(cloud, sensor), sensor, "rings from the elevations")
        ring[seen] = _numbered_as_sensor(ordered, returns, np.asarray(elevations))
        words = "rings from the order of the rows"
    found = torch.from_numpy(ring)
    off_deg = _off_cones(xyz, ring, sensor)
    allowed_deg = np.maximum(_OFF_RING_DEG, _OFF_SPACING * _spacing_deg(np.asarray(elevations)))
    if (off_deg > allowed_deg).sum() > _OFF_SHARE * len(elevations):
        pattern = estimate_pattern(xyz, ring, len(elevations))
        own = pattern.applied_to(sensor)
        sensor = replace(
            sensor,
            elevations_deg=own.elevations_deg,
            origin_heights_m=own.origin_heights_m,
            columns=own.columns,
            azimuth_offsets_deg=own.azimuth_offsets_deg,
        )
        words += f", their cones from the sweep (the sensor's are off by up to {np.nanmax(off_deg):.2f} degrees)"
    return SweepRings(found.to(cloud.device), sensor, words)


def _numbered_as_sensor(ordered: Integers, xyz: Numbers, elevations: Numbers) -> Integers:
    """Rings in the order of the file, numbered as the sensor's: by the rank of their elevations."""
    part = slice(None, None, max(1, len(xyz) // _MOST_POINTS))
    if not np.bincount(ordered[part], minlength=len(elevations)).all():  # a ring of few points
        part = slice(None)
    of_ring, x, y, z = ordered[part], *xyz[part].T
    flat = np.hypot(x, y)
    far = np.where(flat > _FROM_M, 1.0, 1e-3)
    mean = np.bincount(of_ring, np.arctan2(z, flat) * far) / np.bincount(of_ring, far)
    number = np.empty(len(elevations), np.int64)
    number[np.argsort(mean, kind="stable")] = np.argsort(elevations, kind="stable")
    numbered: Integers = number[ordered]
    return numbered


def _spacing_deg(elevations: Numbers) -> Numbers:
    """Elevation from each ring to the nearest other one, degrees; 0 for a single ring."""
    if len(elevations) < 2:
        return np.zeros(len(elevations))
    order = np.argsort(elevations)
    steps = np.diff(elevations[order])
    nearest = np.empty(len(elevations))
    nearest[order] = np.minimum(np.r_[np.inf, steps], np.r_[steps, np.inf])
    return nearest


def _off_cones(xyz: Numbers, ring: Integers, sensor: Lidar) -> Numbers:
    """Median distance of each ring's points from its cone, degrees; NaN for rings with few points."""
    elevations = np.asarray(sensor.elevations_deg)
    heights = np.zeros(len(elevations)) if sensor.origin_heights_m is None else np.asarray(sensor.origin_heights_m)
    part = np.flatnonzero(ring >= 0)
    part = part[:: max(1, len(part) // _MOST_POINTS)]
    of_ring, x, y, z = ring[part], *xyz[part].T
    flat = np.hypot(x, y)
    off = np.degrees(np.arctan2(z - heights[of_ring], flat)) - elevations[of_ring]
    far = flat > _FROM_M
    found = np.full(len(elevations), np.nan)
    order = np.argsort(of_ring, kind="stable")
    for number, members in enumerate(np.split(order, np.cumsum(np.bincount(of_ring, minlength=len(elevations)))[:-1])):
        of_far = members[far[members]]
        chosen = of_far if len(of_far) >= _FEWEST else members
        if len(chosen) >= _FEWEST:
            found[number] = abs(np.partition(off[chosen], len(chosen) // 2)[len(chosen) // 2])
    return found
