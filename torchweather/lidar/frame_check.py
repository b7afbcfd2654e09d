"""Notice a cloud that lies in another frame than the sensor's: out of its reach, or, once a sensor, by its rings."""

from __future__ import annotations

import warnings
from dataclasses import replace

import numpy as np
import torch
from torch import Tensor

from torchweather.core.errors import TorchweatherWarning, owner_name
from torchweather.lidar.cloud_frame import points_in_sensor_frame
from torchweather.lidar.sensor import Lidar
from torchweather.lidar.sweep.sensor_origin import estimate_origin
from torchweather.pipeline.tiling import is_exporting

__all__ = ["far_note", "frame_note", "ground_note", "warn_of_frame"]

# A cloud with fewer rows is no sweep.
FEWEST_ROWS = 5000
# Returns of a sensor may lie somewhat beyond its nominal reach.
_BEYOND = 1.5
# What no sensor on a vehicle sees: so many returns in a part of the turn, at many ranges, and hardly one nearer.
_FEWEST_RETURNS, _NEAREST_M, _NEAREST_SHARE, _SPREAD, _ASIDE_DEG = 1000, 30.0, 0.01, 1.3, 150.0
_SAMPLE = 10_000  # returns that are looked at
# Of KITTI, nuScenes, WADS and RADIATE 3 to 15 % of the returns beyond 4 m lie within 0.2 m of the sensor's height, and
# most lie below it; counted from the road it is 28 to 58 %, with hardly one below.
_BESIDE_M, _LEVEL_M, _GROUND, _BELOW = 4.0, 0.2, 0.25, 0.1
# Sensors whose first cloud, or first whole one, was looked at: the fit takes 0.3 s.
_SEEN: set[tuple[Lidar, bool]] = set()


def frame_note(points: Tensor, sensor: Lidar) -> str:
    """Evidence that a cloud lies in another frame than the sensor says, with what to pass; empty where there is none.

    Args:
        points: ``(N, 3 or more)`` one sweep, metres.
        sensor: with ``origin_m`` and ``rotation`` as far as they are known; its ``ring_column`` is taken where it is
            set, else the order of the rows.
    """
    local = points_in_sensor_frame(points.detach().cpu(), sensor)
    column = sensor.ring_column
    ring = None if column is None or column >= local.shape[-1] else local[:, column].long().numpy()
    found = estimate_origin(local[:, :3].double().numpy(), ring)
    if found is None or not found.is_apart:
        return ""
    turn = np.eye(3) if sensor.rotation is None else np.asarray(sensor.rotation)
    x, y, z = (float(value) for value in turn @ np.asarray(found.origin_m) + np.asarray(sensor.origin_m))
    where = replace(found, origin_m=(x, y, z)).sentence
    return where.replace("the cloud's origin", f"{sensor.origin_m} as given", 1) if any(sensor.origin_m) else where


def far_note(points: Tensor, sensor: Lidar) -> str:
    """Evidence that the sensor cannot see a cloud from where it stands; empty where there is none.

    Args:
        points: ``(..., N, 3 or more)``, metres.
        sensor: with ``origin_m`` and ``rotation`` as far as they are known.

    Example:
        >>> far_note(torch.tensor([[110.0, 200.0, 1.7], [130.0, 200.0, 1.7]]), Lidar(905.0, max_range_m=120.0))[:40]
        '2 of 2 returns lie farther than 1.5 time'
    """
    rows = points.detach().reshape(-1, points.shape[-1])
    sampled = rows[:: max(1, len(rows) // _SAMPLE), :3].double()
    local = points_in_sensor_frame(sampled, sensor)
    range_m = local.norm(dim=-1)
    near = int(torch.count_nonzero((range_m > 0) & (range_m <= min(_NEAREST_M, _BEYOND * sensor.max_range_m))))
    if 2 * near > int(torch.count_nonzero(range_m)):  # as of nearly every cloud: most returns are near
        return ""
    local, range_m = local[range_m > 0], range_m[range_m > 0]
    if len(range_m) < 2:  # one point is no evidence
        return ""
    beyond = int((range_m > _BEYOND * sensor.max_range_m).sum())
    nearest_m, farthest_m = (float(torch.quantile(range_m, share)) for share in (_NEAREST_SHARE, 1.0 - _NEAREST_SHARE))
    if 2 * beyond > len(range_m):
        evidence = (
            f"{beyond} of {len(range_m)} returns lie farther than {_BEYOND:g} times the sensor's reach, "
            f"{sensor.max_range_m:g} m"
        )
    elif (
        len(range_m) >= _FEWEST_RETURNS
        and nearest_m > _NEAREST_M
        and farthest_m > _SPREAD * nearest_m
        and _azimuths_deg(local) < _ASIDE_DEG
    ):
        evidence = f"{len(range_m)} returns lie aside, all but a hundredth of them more than {nearest_m:.0f} m away"
    else:
        return ""
    return (
        f"{evidence}; half of them are {float(range_m.median()):.0f} m away or more. The cloud is in another frame (of "
        "a map, of the vehicle), or not in metres. Say where the sensor stands in it with Lidar(origin_m=(x, y, z)) or "
        "Lidar.with_pose (command line: --sensor-origin X Y Z, --sensor-pose FILE), or give max_range_m."
    )


def _azimuths_deg(local: Tensor) -> float:
    """Angle that the azimuths of points cover, but for their largest gap, degrees."""
    azimuth = torch.rad2deg(torch.atan2(local[:, 1], local[:, 0])).sort().values
    gaps = torch.cat([azimuth.diff(), (azimuth[0] + 360.0 - azimuth[-1])[None]])
    return 360.0 - float(gaps.max())


def ground_note(points: Tensor, sensor: Lidar) -> str:
    """Evidence that the sensor would lie in the ground that it sees; empty where there is none.

    Args:
        points: ``(N, 3 or more)`` one cloud, z up, metres.
        sensor: with ``origin_m`` and ``rotation`` as far as they are known.
    """
    local = points_in_sensor_frame(points.detach()[..., :3], sensor).reshape(-1, 3).double()
    local = local[local[:, :2].norm(dim=-1) > _BESIDE_M]
    if len(local) < _FEWEST_RETURNS:
        return ""
    height_m = local[:, 2]
    level = float((height_m.abs() < _LEVEL_M).double().mean())
    below = float((height_m < -2.0 * _LEVEL_M).double().mean())
    # A scanner of one plane has all of its returns at its own height.
    if not _GROUND <= level <= 1.0 - _BELOW or below > _BELOW:
        return ""
    return (
        f"{100.0 * level:.0f} % of {len(local)} returns lie at the height of the origin, within {_LEVEL_M:g} m, and "
        f"{100.0 * below:.1f} % below it: they look like the ground, on which the sensor does not lie. The cloud is in "
        "the frame of the vehicle. Say where the sensor stands in it with Lidar(origin_m=(x, y, z)) or Lidar.with_pose "
        "(command line: --sensor-origin X Y Z, --sensor-pose FILE)."
    )


def warn_of_frame(points: Tensor, sensor: Lidar, owner: object) -> None:
    """Warn where the first cloud of a sensor lies in another frame.

    Args:
        points: ``(..., N, 3 or more)``; of a batch the first is looked at.
        sensor: see `frame_note`.
        owner: for the message.
    """
    if is_exporting():
        return
    far = far_note(points, sensor) if points.numel() else ""
    if far:
        warnings.warn(f"{owner_name(owner)}: {far}", TorchweatherWarning, stacklevel=6)
        return
    whole = points.shape[-2] >= FEWEST_ROWS
    if not points.numel() or points.shape[-2] < _FEWEST_RETURNS or (sensor, whole) in _SEEN:
        return
    _SEEN.add((sensor, whole))
    first = points.reshape(-1, *points.shape[-2:])[0]
    note = (frame_note(first, sensor) if whole else "") or ground_note(first, sensor)
    if note:
        warnings.warn(f"{owner_name(owner)}: {note}", TorchweatherWarning, stacklevel=6)
