"""Cause for which a sweep does not fit its sensor: another frame, another sensor; or the sweep's own cones."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from torchweather.core.arrays import as_numpy
from torchweather.core.errors import InputValueError
from torchweather.lidar.sensor import Lidar
from torchweather.lidar.sweep.frame_fit import FrameOffset
from torchweather.lidar.sweep.pattern_fit import PatternFit
from torchweather.lidar.sweep.scan_pattern import ScanPattern, estimate_pattern, filled
from torchweather.lidar.sweep.sensor_origin import estimate_origin
from torchweather.lidar.sweep.sweep_rings import SweepRings

__all__ = ["SAME_SENSOR_DEG", "HIGH_M", "frame_problem", "preset_of_rings", "refitted_rings", "sensor_problem"]

Numbers = npt.NDArray[np.floating[Any]]

# Median difference of the elevations of two units of one product: KITTI's HDL-64E and that of Seeing Through Fog 0.15.
SAME_SENSOR_DEG = 0.5
# No head of a LiDAR has its lasers farther above the origin of its own frame (HDL-64E: 0.21 m).
HIGH_M = 0.5
# No LiDAR for the road has half its returns beyond.
_FARTHEST_M = 1000.0


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
    if abs(height_m) > HIGH_M:
        return (
            f"The beams start {height_m:.2f} m above the origin of the cloud: it is in a vehicle's or a map's frame. "
            f"Pass Lidar(origin_m=(0, 0, {height_m:.2f})), on the command line --sensor-origin 0 0 {height_m:.2f}."
        )
    return ""


def sensor_problem(pattern: ScanPattern | PatternFit, sensor: Lidar) -> str:
    """Sentence about a sweep of another sensor, with the preset that fits; empty where it may be the sensor's.

    Args:
        pattern: of the sweep.
        sensor: with ``elevations_deg``.
    """
    wanted = np.sort(np.asarray(sensor.elevations_deg))
    shown = np.sort(pattern.elevations_deg[np.isfinite(pattern.elevations_deg)])
    if len(shown) == len(wanted):
        off = float(np.median(np.abs(shown - wanted)))
        if off <= SAME_SENSOR_DEG:
            return ""
        beside = f"{off:.1f} degrees beside them in the median"
    else:
        beside = f"another number ({pattern.found_by})"
    return (
        f"The sensor has {len(wanted)} rings from {wanted[0]:.1f} to {wanted[-1]:.1f} degrees; the sweep shows "
        f"{len(shown)} rings from {shown[0]:.1f} to {shown[-1]:.1f} degrees, {beside}: another sensor, or a part of "
        f"its rings. {_remedy(shown)}"
    )


def preset_of_rings(elevations_deg: Numbers) -> str | None:
    """The preset whose rings these are, within half a degree in the median.

    Example:
        >>> preset_of_rings(np.arange(-15.0, 16.0, 2.0))
        'velodyne-vlp-16'
    """
    shown = np.sort(elevations_deg)
    for name in Lidar.presets():
        known = Lidar.preset(name).elevations_deg
        if known is None or len(known) != len(shown):
            continue
        if float(np.median(np.abs(np.sort(known) - shown))) < SAME_SENSOR_DEG:
            return name
    return None


def _remedy(shown: Numbers) -> str:
    preset = preset_of_rings(shown)
    if preset is not None:
        return f"The rings are those of {preset}: take that preset."
    return "Take the preset of the sensor (torchweather list), or measure it: torchweather fit-sensor."


def refitted_rings(cloud: Tensor, sensor: Lidar) -> SweepRings:
    """Rings with the sweep's own cones where the sensor's product has them; else raise with the cause."""
    xyz = cloud[:, :3].detach().cpu().double().numpy()
    given = None
    if sensor.ring_column is not None:
        given = as_numpy(cloud[:, sensor.ring_column]).astype(np.int64)
        given = np.where((np.square(xyz).sum(1) < sensor.min_range_m**2) | (xyz == 0).all(1), -1, given)
    pattern, fault = None, ""
    try:
        pattern = estimate_pattern(xyz, given, min_range_m=sensor.min_range_m)
    except ValueError as error:
        fault = str(error).removeprefix("estimate_pattern: ")
    if pattern is not None and pattern.rings != len(sensor.elevations_deg or ()):
        raise InputValueError(f"complete_scan: {sensor_problem(pattern, sensor)}")
    if pattern is None or pattern.frame is not None:
        origin = estimate_origin(xyz, given)
        if origin is not None and origin.is_apart:
            range_m = float(np.median(np.linalg.norm(xyz - np.asarray(origin.origin_m), axis=1)))
            if range_m < _FARTHEST_M:
                raise InputValueError(f"complete_scan: {origin.sentence}")
    if pattern is None:
        evidence, no_rings, _ = fault.partition(". Is the cloud in the sensor's frame")
        if not no_rings:
            raise InputValueError(f"complete_scan: {fault}")
        raise InputValueError(
            f"complete_scan: {evidence}. The sensor has {len(sensor.elevations_deg or ())}. Is the cloud tilted, in a "
            "map's frame, compensated for fast motion, of another sensor, or several sweeps merged? Pass one sweep as "
            "its sensor gave it, in metres, with the ring of each row where the file has it, Lidar(ring_column=...)."
        )
    cause = frame_problem(pattern.frame, float(np.nanmedian(pattern.heights_m))) or sensor_problem(pattern, sensor)
    if cause:
        raise InputValueError(f"complete_scan: {cause}")
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
