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

from torchweather.lidar.frame_fit import FrameOffset
from torchweather.lidar.scan_pattern import ScanPattern, estimate_pattern, filled
from torchweather.lidar.sensor_origin import estimate_origin
from torchweather.lidar.sweep_rings import SweepRings, sweep_rings
from torchweather.sensors import Lidar

__all__ = ["checked_rings", "frame_problem", "sensor_problem"]

Numbers = npt.NDArray[np.floating[Any]]
Integers = npt.NDArray[np.integer[Any]]

_TURN_DEG = 360.0
# So many rows decide, and a cloud of fewer than the least is no sweep.
_ROWS = 20_000
_FEWEST_ROWS = 500
# Nearer points lie off their cones where the vehicle moves: 0.05 m are 0.4 degree at 8 m.
_FROM_M = 8.0
# Median distance from the cones over half the distance of two rings. Points of another sensor are anywhere between the
# rings (0.5); of 13 sweeps of KITTI 0.006, nuScenes 0.055, KITTI compensated for 15 m/s 0.2.
_BETWEEN_RINGS = 0.25
# Rise of the cloud along its ring, degrees: KITTI and WADS 0.000, nuScenes 0.02, compensated for 15 m/s 0.08.
_TILT_DEG = 0.15
# Rings between the lowest and the highest with a point that have none: at most this share.
_EMPTY_RINGS = 0.25
# A ring with less than this share of the median ring's points counts as empty.
_FEW_POINTS = 0.02
# Neighbours on a ring this many steps apart in the median: thinned, or of a sensor with other columns. (Motors drift by
# 1 %; HDL-64E round azimuths: 1.08 in KITTI, 1.12 in Seeing Through Fog.)
_THINNED = 1.5
_RINGS_TO_JUDGE, _GAPS_TO_JUDGE = 8, 100
_SAME_BEAM = 0.25
# Median difference of the elevations of two units of one product: KITTI's HDL-64E and that of Seeing Through Fog 0.15.
_SAME_SENSOR_DEG = 0.5
# No head of a LiDAR has its lasers farther above the origin of its own frame (HDL-64E: 0.21 m).
_HIGH_M = 0.5
# Copies of rows this far away in the file are no echoes of one firing (WADS: 128 rows); a share is looked at.
_ECHO_ROWS = 1000
_HASH = np.uint32(0x9E3779B1)
_KEPT_BITS = np.uint32(28)  # one row in 16
_MOST_COPIES = 0.3
# No LiDAR for the road has half its returns beyond.
_FARTHEST_M = 1000.0
# A sector without any point that is wider is outside the view; nothing is appended there.
_WIDE_GAP_DEG = 10


@dataclass(frozen=True)
class _Signs:
    """Cheap signs of a sweep; see the limits above."""

    between_rings: float
    tilt_deg: float
    rings: int
    empty_rings: float
    height_m: float
    moved_deg: float

    @property
    def fit(self) -> bool:
        return (
            self.between_rings <= _BETWEEN_RINGS
            and self.tilt_deg <= _TILT_DEG
            and self.empty_rings <= _EMPTY_RINGS
            and self.height_m <= _HIGH_M
            and self.moved_deg <= _SAME_SENSOR_DEG
        )


def checked_rings(cloud: Tensor, sensor: Lidar) -> SweepRings:
    """Find the rings of a sweep, and refuse one that another sensor took, or that lies in another frame.

    Args:
        cloud: ``(N, C)`` x, y, z in metres in the sensor's frame, further columns.
        sensor: with ``elevations_deg`` and ``columns``.

    Returns:
        As `sweep_rings`; where the elevations of a sweep without ring column are those of another unit of the product,
        with the cones of the sweep.

    Raises:
        ValueError: the sweep is in another frame, of another sensor, thinned, or written twice.
    """
    _check_ring_column(cloud, sensor)
    xyz = cloud[:, :3].detach().cpu().numpy()
    _refuse_copies(xyz)
    try:
        found = sweep_rings(cloud, sensor)
        fit = len(cloud) < _FEWEST_ROWS or _signs(xyz, found, sensor).fit
    except ValueError:
        if sensor.elevations_deg is None or sensor.columns is None:
            raise
        fit = False
    if not fit:
        found = _diagnosed(cloud, sensor)
    _refuse_thinned(xyz, found, cloud)
    covered = _covered_deg(xyz[:: max(1, len(xyz) // _ROWS)])
    if 0 < covered < _TURN_DEG and len(cloud) >= _FEWEST_ROWS:
        words = f"{found.words}; the sweep covers {covered} of 360 degrees of azimuth, nothing is appended elsewhere"
        found = replace(found, words=words)
    return found


def frame_problem(frame: FrameOffset | None, height_m: float = 0.0) -> str:
    """Sentence about a cloud in another frame than its sensor's, with what to pass; empty where it is none.

    Args:
        frame: as `estimate_pattern` finds it.
        height_m: of the beams' start over the cloud's origin.
    """
    if frame is not None:
        a, b = (np.radians(angle) for angle in frame.tilt_deg)
        tilted = next((text for text in frame.sentences() if "tilted" in text), "")
        if tilted:
            normal = np.array([-a, -b, 1.0]) / np.sqrt(1.0 + a * a + b * b)
            forward = np.array([1.0, 0.0, a]) / np.hypot(1.0, a)
            rows = np.stack([forward, np.cross(normal, forward), normal], axis=1).round(4) + 0.0
            shown = ", ".join("(" + ", ".join(f"{value:g}" for value in row) + ")" for row in rows)
            return tilted.replace("Pass Lidar(rotation=...) or a pose.", "").strip() + (
                f" Pass Lidar(rotation=({shown})), on the command line --sensor-pose with that rotation, or turn the "
                "cloud level."
            )
        moved = [text for text in frame.sentences() if "motion" in text]
        if moved:
            return f"{moved[0]} Pass the cloud as it was measured, or undo the compensation."
        if frame.stands_apart:
            return frame.sentences()[-1]
    if abs(height_m) > _HIGH_M:
        return (
            f"The beams start {height_m:.2f} m above the origin of the cloud: it is in a vehicle's or a map's frame. "
            f"Pass Lidar(origin_m=(0, 0, {height_m:.2f})), on the command line --sensor-origin 0 0 {height_m:.2f}."
        )
    return ""


def sensor_problem(pattern: ScanPattern, sensor: Lidar) -> str:
    """Sentence about a sweep of another sensor, with the preset that fits; empty where it may be the sensor's.

    Args:
        pattern: of the sweep.
        sensor: with ``elevations_deg``.
    """
    wanted = np.sort(np.asarray(sensor.elevations_deg))
    shown = np.sort(pattern.elevations_deg[np.isfinite(pattern.elevations_deg)])
    if len(shown) == len(wanted):
        off = float(np.median(np.abs(shown - wanted)))
        if off <= _SAME_SENSOR_DEG:
            return ""
        beside = f"{off:.1f} degrees beside them in the median"
    else:
        beside = f"another number ({pattern.found_by})"
    return (
        f"The sensor has {len(wanted)} rings from {wanted[0]:.1f} to {wanted[-1]:.1f} degrees; the sweep shows "
        f"{len(shown)} rings from {shown[0]:.1f} to {shown[-1]:.1f} degrees, {beside}: another sensor, or a part of "
        f"its rings. {_remedy(shown)}"
    )


def _remedy(shown: Numbers) -> str:
    for name in Lidar.presets():
        known = Lidar.preset(name).elevations_deg
        if known is None or len(known) != len(shown):
            continue
        if float(np.median(np.abs(np.sort(known) - shown))) < _SAME_SENSOR_DEG:
            return f"The rings are those of {name}: take that preset."
    return "Take the preset of the sensor (torchweather list), or measure it: torchweather fit-sensor."


def _check_ring_column(cloud: Tensor, sensor: Lidar) -> None:
    if sensor.ring_column is None or not sensor.elevations_deg or not len(cloud):
        return
    column = cloud[:, sensor.ring_column].detach()
    rings, highest = len(sensor.elevations_deg), float(column.max())
    if highest >= rings:
        raise ValueError(
            f"complete_scan: expected ring numbers 0 to {rings - 1} of the sensor's {rings} rings in column "
            f"{sensor.ring_column}; got numbers up to {highest:g}. It is a sweep of another sensor, or another column: "
            "take the preset of the sensor (torchweather list), or Lidar(ring_column=...)."
        )
    if bool((column != column.round()).any()):
        raise ValueError(
            f"complete_scan: expected whole ring numbers in column {sensor.ring_column}; got fractions. Pass the "
            "column of the ring, Lidar(ring_column=...)."
        )


def _refuse_copies(xyz: Numbers) -> None:
    """Raise where many rows repeat others elsewhere in the file; one value in 16 is looked at."""
    bits = np.ascontiguousarray(xyz[:, 0], dtype=np.float32).view(np.uint32)
    place = np.flatnonzero(bits * _HASH >> _KEPT_BITS == 0)
    place = place[(xyz[place] != 0).any(1)]
    if len(place) < _FEWEST_ROWS // 16:
        return
    order = np.lexsort((place, *xyz[place].T))
    place = place[order]
    same = (xyz[place][1:] == xyz[place][:-1]).all(1)
    share = float((np.diff(place)[same] > _ECHO_ROWS).sum()) / len(place)
    if share > _MOST_COPIES:
        raise ValueError(
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
        tilt_deg=_tilt_deg(off, ring, xyz[part], flat, rings),
        rings=int(here.sum()),
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


def _tilt_deg(off: Numbers, ring: Integers, xyz: Numbers, flat: Numbers, rings: int) -> float:
    """Amplitude of the distances from the cones over azimuth, each ring's own mean taken out."""
    near = np.abs(off) < _TURN_DEG / 36.0
    if near.sum() < _FEWEST_ROWS:
        return 0.0
    off, ring, flat = off[near], ring[near], np.maximum(flat[near], 1e-6)
    design = np.stack([xyz[near, 0] / flat, xyz[near, 1] / flat, off], -1)
    count = np.maximum(np.bincount(ring, minlength=rings), 1)
    for column in design.T:
        column -= (np.bincount(ring, column, rings) / count)[ring]
    a, b = np.linalg.lstsq(design[:, :2], design[:, 2], rcond=None)[0]
    return float(np.hypot(a, b))


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
    raise ValueError(
        f"complete_scan: expected neighbours {step:.3f} degrees apart on a ring, as Lidar(columns={sensor.columns}) "
        f"has them; the sweep's are {apart:.3f} degrees apart. Pass the sweep before it was thinned"
        + (f", or Lidar(columns={columns}), on the command line --columns {columns}." if regular else ".")
    )


def _covered_deg(xyz: Numbers) -> int:
    """Azimuth of the sweep, degrees, less sectors without any point."""
    there = (xyz[:, :2] != 0).any(1)
    size = round(_TURN_DEG)
    azimuth = np.degrees(np.arctan2(xyz[there, 1], xyz[there, 0])) % _TURN_DEG
    place = np.flatnonzero(np.bincount(azimuth.astype(np.intp) % size, minlength=size))
    if not len(place):
        return 0
    gap = np.diff(np.r_[place, place[0] + size]) - 1
    return size - int(gap[gap >= _WIDE_GAP_DEG].sum())


def _diagnosed(cloud: Tensor, sensor: Lidar) -> SweepRings:
    """Rings with the sweep's own cones where the sensor's product has them; else raise with the cause."""
    xyz = cloud[:, :3].detach().cpu().double().numpy()
    given = None
    if sensor.ring_column is not None:
        given = cloud[:, sensor.ring_column].detach().cpu().numpy().astype(np.int64)
        given = np.where((np.square(xyz).sum(1) < sensor.min_range_m**2) | (xyz == 0).all(1), -1, given)
    pattern, fault = None, ""
    try:
        pattern = estimate_pattern(xyz, given, min_range_m=sensor.min_range_m)
    except ValueError as error:
        fault = str(error).removeprefix("estimate_pattern: ")
    if pattern is not None and pattern.rings != len(sensor.elevations_deg or ()):
        raise ValueError(f"complete_scan: {sensor_problem(pattern, sensor)}")
    if pattern is None or pattern.frame is not None:
        origin = estimate_origin(xyz, given)
        if origin is not None and origin.is_apart:
            range_m = float(np.median(np.linalg.norm(xyz - np.asarray(origin.origin_m), axis=1)))
            if range_m < _FARTHEST_M:
                raise ValueError(f"complete_scan: {origin.sentence}")
    if pattern is None:
        evidence, no_rings, _ = fault.partition(". Is the cloud in the sensor's frame")
        if not no_rings:
            raise ValueError(f"complete_scan: {fault}")
        raise ValueError(
            f"complete_scan: {evidence}. The sensor has {len(sensor.elevations_deg or ())}. Is the cloud tilted, in a "
            "map's frame, of another sensor, or several sweeps merged? Pass one sweep as its sensor gave it, in "
            "metres, with the ring of each row where the file has it, Lidar(ring_column=...)."
        )
    cause = frame_problem(pattern.frame, float(np.nanmedian(pattern.heights_m))) or sensor_problem(pattern, sensor)
    if cause:
        raise ValueError(f"complete_scan: {cause}")
    return _of_pattern(pattern, sensor, cloud)


def _of_pattern(pattern: ScanPattern, sensor: Lidar, cloud: Tensor) -> SweepRings:
    """Rings numbered as the sensor's, with the cones of the pattern."""
    elevations = np.asarray(sensor.elevations_deg)
    place = np.arange(len(elevations))
    if pattern.found_by != "ring column":
        shown = np.where(np.isfinite(pattern.elevations_deg), pattern.elevations_deg, np.inf)
        place = np.empty(len(elevations), np.int64)
        place[np.argsort(shown, kind="stable")] = np.argsort(elevations, kind="stable")
    ring = np.where(pattern.ring >= 0, place[pattern.ring], -1)
    order = np.argsort(place)
    own = replace(
        sensor,
        elevations_deg=tuple(filled(pattern.elevations_deg[order], sensor.elevations_deg).tolist()),
        origin_heights_m=tuple(filled(pattern.heights_m[order], sensor.origin_heights_m).tolist()),
        columns=pattern.columns,
        azimuth_offsets_deg=tuple(np.nan_to_num(pattern.phase_deg[order]).tolist()),
    )
    words = f"rings and their cones from the sweep ({pattern.found_by})"
    return SweepRings(torch.from_numpy(ring).to(cloud.device), own, words)
