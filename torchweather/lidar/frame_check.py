"""Notice a cloud that lies in another frame than the sensor's, once for each sensor."""

from __future__ import annotations

import warnings
from dataclasses import replace

import numpy as np
from torch import Tensor

from torchweather.core.errors import TorchweatherWarning, owner_name
from torchweather.lidar.cloud_frame import points_in_sensor_frame
from torchweather.lidar.sensor import Lidar
from torchweather.lidar.sweep.sensor_origin import estimate_origin
from torchweather.pipeline.tiling import is_exporting

__all__ = ["frame_note", "warn_of_frame"]

# A cloud with fewer rows is no sweep.
FEWEST_ROWS = 5000
# Sensors whose first cloud was looked at: the fit takes 0.3 s.
_SEEN: set[Lidar] = set()


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


def warn_of_frame(points: Tensor, sensor: Lidar, owner: object) -> None:
    """Warn where the first cloud of a sensor lies in another frame.

    Args:
        points: ``(..., N, 3 or more)``; of a batch the first is looked at.
        sensor: see `frame_note`.
        owner: for the message.
    """
    if is_exporting() or points.shape[-2] < FEWEST_ROWS or not points.numel() or sensor in _SEEN:
        return
    _SEEN.add(sensor)
    note = frame_note(points.reshape(-1, *points.shape[-2:])[0], sensor)
    if note:
        warnings.warn(f"{owner_name(owner)}: {note}", TorchweatherWarning, stacklevel=5)
