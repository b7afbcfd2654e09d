"""A sweep compared with the sensor that is said to have taken it, before beams are appended to it.

Every sweep is judged by cheap signs: distance of the points from their rings' cones, rings without points, step from
neighbour to neighbour, repeated rows. Where one of them is wrong, the pattern is estimated from the sweep (0.1 to
0.5 s), so that the error names the cause.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from torchweather.core.arrays import as_numpy
from torchweather.core.errors import InputValueError
from torchweather.lidar.sensor import Lidar
from torchweather.lidar.sweep.quick_frame import QuickFrame, quick_frame
from torchweather.lidar.sweep.sweep_cause import HIGH_M, SAME_SENSOR_DEG, refitted_rings
from torchweather.lidar.sweep.sweep_rings import SweepRings, sweep_rings

__all__ = ["checked_rings"]

Numbers = npt.NDArray[np.floating[Any]]
Integers = npt.NDArray[np.integer[Any]]

_TURN_DEG = 360.0
# So many rows decide, and a cloud of fewer than the least is no sweep.
_ROWS = 10_000
_FEWEST_ROWS = 500
# Nearer points lie off their cones where the vehicle moves: 0.05 m are 0.4 degree at 8 m.
_FROM_M = 8.0
# Median distance from the cones over half the distance of two rings. Points of another sensor are anywhere between the
# rings (0.5); of 13 sweeps of KITTI 0.006, nuScenes 0.055, KITTI compensated for 15 m/s 0.2.
# Rings that are nearest in elevation hide the distance: 0.4 of points anywhere, WADS 0.000.
_BETWEEN_RINGS, _BETWEEN_NEAREST = 0.25, 0.1
# Rings between the lowest and the highest with a point that have none: at most this share.
_EMPTY_RINGS = 0.25
# A ring with less than this share of the median ring's points counts as empty.
_FEW_POINTS = 0.02
# Neighbours on a ring this many steps apart in the median: thinned, or of a sensor with other columns. (Motors drift by
# 1 %; HDL-64E round azimuths: 1.08 in KITTI, 1.12 in Seeing Through Fog.)
_THINNED = 1.5
_RINGS_TO_JUDGE, _GAPS_TO_JUDGE = 8, 100
_SAME_BEAM = 0.25
# Copies of rows this far away in the file are no echoes of one firing (WADS: 128 rows); a share is looked at.
_ECHO_ROWS = 1000
_HASH = np.uint32(0x9E3779B1)
_KEPT = 64  # one row in so many
_KEPT_BITS = np.uint32(26)
_MOST_COPIES = 0.3
# A sector without any point that is wider is outside the view; nothing is appended there.
_WIDE_GAP_DEG = 10


@dataclass(frozen=True)
class _Signs:
    """Cheap signs of a sweep; see the limits above."""

    between_rings: float
    nearest: bool
    half_distance_deg: float
    frame: QuickFrame
    empty_rings: float
    height_m: float
    moved_deg: float

    @property
    def explained(self) -> bool:
        """Rings known otherwise than by their elevations, and brought onto their cones by the sensor's motion."""
        return not self.nearest and self.frame.moves and self.frame.left_deg <= _BETWEEN_RINGS * self.half_distance_deg

    @property
    def fit(self) -> bool:
        return (
            (self.between_rings <= (_BETWEEN_NEAREST if self.nearest else _BETWEEN_RINGS) or self.explained)
            and self.frame.fits
            and self.empty_rings <= _EMPTY_RINGS
            and self.height_m <= HIGH_M
            and self.moved_deg <= SAME_SENSOR_DEG
        )


def checked_rings(cloud: Tensor, sensor: Lidar) -> tuple[SweepRings, Tensor]:
    """Find the rings of a sweep, and refuse one that another sensor took, or that lies in another frame.

    Args:
        cloud: ``(N, C)`` x, y, z in metres in the sensor's frame, further columns.
        sensor: with ``elevations_deg`` and ``columns``.

    Returns:
        As `sweep_rings`, where the elevations of a sweep without ring column are those of another unit of the product
        with the cones of the sweep; and the cloud, the motion of the sensor taken out where it was compensated for.

    Raises:
        ValueError: the sweep is in another frame, of another sensor, thinned, or written twice.
    """
    _check_ring_column(cloud, sensor)
    xyz = as_numpy(cloud[:, :3])
    _refuse_copies(xyz)
    frame = QuickFrame()
    try:
        found = sweep_rings(cloud, sensor)
        fit = len(cloud) < _FEWEST_ROWS
        if not fit:
            signs = _signs(xyz, found, sensor)
            fit, frame = signs.fit, signs.frame
    except ValueError:
        if sensor.elevations_deg is None or sensor.columns is None:
            raise
        fit = False
    if not fit:
        found, frame = refitted_rings(cloud, sensor), QuickFrame()
    _refuse_thinned(xyz, found, cloud)
    covered = _covered_deg(xyz[:: max(1, len(xyz) // _ROWS)])
    if 0 < covered < _TURN_DEG and len(cloud) >= _FEWEST_ROWS:
        words = f"{found.words}; the sweep covers {covered} of 360 degrees of azimuth, nothing is appended elsewhere"
        found = replace(found, words=words)
    if not frame.moves:
        return found, cloud
    x_m, y_m = frame.motion_m
    words = f"{found.words}; compensated for motion of ({x_m:+.2f}, {y_m:+.2f}) m a turn, taken out to find the beams"
    return replace(found, words=words), frame.stood_still(cloud, sensor.min_range_m)


def _check_ring_column(cloud: Tensor, sensor: Lidar) -> None:
    if sensor.ring_column is None or not sensor.elevations_deg or not len(cloud):
        return
    column = cloud[:, sensor.ring_column].detach()
    rings, highest = len(sensor.elevations_deg), float(column.max())
    if highest >= rings:
        raise InputValueError(
            f"complete_scan: expected ring numbers 0 to {rings - 1} of the sensor's {rings} rings in column "
            f"{sensor.ring_column}; got numbers up to {highest:g}. It is a sweep of another sensor, or another column: "
            "take the preset of the sensor (torchweather list), or Lidar(ring_column=...)."
        )
    if bool((column != column.round()).any()):
        raise InputValueError(
            f"complete_scan: expected whole ring numbers in column {sensor.ring_column}; got fractions. Pass the "
            "column of the ring, Lidar(ring_column=...)."
        )


def _refuse_copies(xyz: Numbers) -> None:
    """Raise where many rows repeat others elsewhere in the file; one value in 64 is looked at."""
    bits = np.ascontiguousarray(xyz[:, 0], dtype=np.float32).view(np.uint32)
    place = np.flatnonzero(bits * _HASH >> _KEPT_BITS == 0)
    place = place[(xyz[place] != 0).any(1)]
    if len(place) < _FEWEST_ROWS // _KEPT:
        return
    order = np.lexsort((place, *xyz[place].T))
    place = place[order]
    same = (xyz[place][1:] == xyz[place][:-1]).all(1)
    share = float((np.diff(place)[same] > _ECHO_ROWS).sum()) / len(place)
    if share > _MOST_COPIES:
        raise InputValueError(
            f"complete_scan: expected every return once; {100 * share:.0f} % of the rows repeat others elsewhere in "
            "the file: a sweep written twice. Drop the copies and keep the order: numpy.unique(points, axis=0, "
            "return_index=True) gives the rows, sort them."
        )


def _signs(xyz: Numbers, found: SweepRings, given: Lidar) -> _Signs:
    sensor = found.sensor
    elevations = np.asarray(sensor.elevations_deg)
    rings = len(elevations)
    heights = np.zeros(rings) if sensor.origin_heights_m is None else np.asarray(sensor.origin_heights_m)
    number = found.ring.cpu().numpy()
    count = np.bincount(number[number >= 0], minlength=rings)
    here = np.zeros(rings, bool)
    if count.any():
        here = count > _FEW_POINTS * np.median(count[count > 0])
    rank = np.argsort(np.argsort(elevations))[here]
    span = int(rank.max() - rank.min()) + 1 if len(rank) else 1
    part = np.flatnonzero(number >= 0)
    part = part[:: max(1, len(part) // _ROWS)]
    ring, flat = number[part], np.hypot(xyz[part, 0], xyz[part, 1])
    far = flat > _FROM_M
    if far.sum() >= _FEWEST_ROWS:
        part, ring, flat = part[far], ring[far], flat[far]
    off = np.degrees(np.arctan2(xyz[part, 2] - heights[ring], flat)) - elevations[ring]
    between = float(np.median(np.abs(off) / _half_distance(elevations)[ring])) if len(part) else 0.0
    moved = float(np.median(np.abs(np.sort(elevations) - np.sort(np.asarray(given.elevations_deg)))))
    return _Signs(
        between_rings=between if rings > 1 else 0.0,
        nearest=sensor.ring_column is None and "order" not in found.words,
        half_distance_deg=float(np.median(_half_distance(elevations))),
        frame=quick_frame(xyz, number, elevations, heights),
        empty_rings=1.0 - len(rank) / span,
        height_m=float(abs(np.median(heights))) if sensor is not given else 0.0,
        moved_deg=moved,
    )


def _half_distance(elevations: Numbers) -> Numbers:
    """Half the way to the nearest other ring, degrees."""
    order = np.argsort(elevations)
    steps = np.maximum(np.diff(elevations[order]), 1e-3)
    half = np.empty(len(elevations))
    half[order] = 0.5 * np.minimum(np.r_[np.inf, steps], np.r_[steps, np.inf])
    return half


def _refuse_thinned(xyz: Numbers, found: SweepRings, cloud: Tensor) -> None:
    """Raise where the neighbours on nearly all places of the rings stand farther apart than the sensor's columns."""
    sensor, number = found.sensor, found.ring.cpu().numpy()
    count = np.bincount(number[number >= 0], minlength=1)
    if sensor.ring_column is not None:
        rows = torch.bincount(cloud[:, sensor.ring_column].long().clamp(min=0)).cpu().numpy()
        if len(rows) and (rows == rows[0]).all() and (number < 0).any():
            return  # a file with a row for every beam says itself how many returned nothing
    gaps = []
    step = _TURN_DEG / (sensor.columns or 1)
    for ring in np.argsort(-count, kind="stable")[:_RINGS_TO_JUDGE]:
        own = xyz[number == ring].astype(np.float64)
        own = own[np.hypot(own[:, 0], own[:, 1]) > _FROM_M]
        gap = np.diff(np.sort(np.degrees(np.arctan2(own[:, 1], own[:, 0]))))
        gaps.append(gap[gap > _SAME_BEAM * step])
    every = np.sort(np.concatenate(gaps)) if gaps else np.zeros(0)
    if len(every) < _GAPS_TO_JUDGE or every[len(every) // 2] <= _THINNED * step:
        return
    typical = every[len(every) // 2]
    apart = float(every[(every > typical / _THINNED) & (every < typical * _THINNED)].mean())
    regular = every[len(every) // 10] > _THINNED * step
    columns = round(_TURN_DEG / apart)
    raise InputValueError(
        f"complete_scan: expected neighbours {step:.3f} degrees apart on a ring, as Lidar(columns={sensor.columns}) "
        f"has them; the sweep's are {apart:.3f} degrees apart. Pass the sweep before it was thinned"
        + (f", or Lidar(columns={columns}), on the command line --columns {columns}." if regular else ".")
    )


def _covered_deg(xyz: Numbers) -> int:
    """Azimuth of the sweep, degrees, less sectors without any point."""
    there = (xyz[:, :2] != 0).any(1)
    size = round(_TURN_DEG)
    azimuth = np.degrees(np.arctan2(xyz[there, 1], xyz[there, 0])) + _TURN_DEG
    place = np.flatnonzero(np.bincount(azimuth.astype(np.intp) % size, minlength=size))
    if not len(place):
        return 0
    gap = np.diff(np.r_[place, place[0] + size]) - 1
    return size - int(gap[gap >= _WIDE_GAP_DEG].sum())
