"""The viewpoint of a PCD file: points to the frame of the sensor that stands there, and back.

``VIEWPOINT x y z w x y z`` is the place of the sensor in the frame of the points, metres, and the rotation of its axes
as a quaternion: ``p_file = R p_sensor + place``.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from torchweather.core.errors import TorchweatherError

__all__ = ["VIEWPOINTS", "points_to_file", "points_to_sensor"]

VIEWPOINTS = ("apply", "ignore")
# The points lie around the viewpoint, not around the origin, unless they are this much farther from it.
_FARTHER = 1.5

Array = npt.NDArray[Any]


def points_to_sensor(xyz: Array, viewpoint: Sequence[float], source: Path) -> Array:
    """Positions ``(N, 3)`` float64 seen from the viewpoint.

    Raises:
        TorchweatherError: the points lie around the origin of the file, not around its viewpoint.
    """
    place, rotation = np.asarray(viewpoint[:3]), _rotation(viewpoint[3:])
    moved: Array = (xyz - place) @ rotation
    there = (moved != 0).any(axis=1)
    if bool(there.any()):
        from_viewpoint_m = float(np.median(np.linalg.norm(xyz[there] - place, axis=1)))
        from_origin_m = float(np.median(np.linalg.norm(xyz[there], axis=1)))
        if from_viewpoint_m > _FARTHER * from_origin_m:
            shown = ", ".join(f"{metres:g}" for metres in viewpoint[:3])
            raise TorchweatherError(
                f"{source}: its VIEWPOINT puts the sensor at ({shown}) m. Half of the points lie within "
                f"{from_origin_m:.1f} m of the origin, and {from_viewpoint_m:.1f} m from that place. "
                "If they are in the sensor's frame already, pass viewpoint='ignore' (command line: --viewpoint "
                "ignore); else correct the file."
            )
    return moved


def points_to_file(xyz: Array, viewpoint: Sequence[float]) -> Array:
    """The inverse of `points_to_sensor`."""
    moved: Array = xyz @ _rotation(viewpoint[3:]).T + np.asarray(viewpoint[:3])
    return moved


def _rotation(quaternion: Sequence[float]) -> Array:
    w, x, y, z = np.asarray(quaternion, np.float64) / np.linalg.norm(quaternion)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )
