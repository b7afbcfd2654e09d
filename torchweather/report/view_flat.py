"""Side view and angles of a cloud's page: the ground under the sensor, the axes, and particles that lie below it."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from torchweather.lidar import GroundPlane, fit_ground
from torchweather.pipeline.point_kind import PointKind
from torchweather.report.view_points import ViewPoints

__all__ = ["BELOW_COLOUR", "UNDER_M", "WITHIN_M", "flat_view", "under_ground"]

# A plane is the ground where it was fitted, and a road is not flatter than this.
WITHIN_M, UNDER_M = 40.0, 0.3
BELOW_COLOUR = "#ff2f7d"
LONGEST_M = 60.0  # to either side
ABOVE_M, BELOW_M, DEEPEST_M = 7.0, 2.5, 14.0
USUAL_HEIGHT_M = 1.8  # of a sensor, where no ground is found
LOWEST_DEG, HIGHEST_DEG = -60.0, 60.0
STRAY = 1e-3  # share of the points that may lie outside the axes


def under_ground(cloud: ViewPoints, plane: GroundPlane | None) -> int:
    """Particles more than ``UNDER_M`` under the ground, within ``WITHIN_M`` of the sensor.

    Args:
        cloud: in the sensor's frame.
        plane: the ground; ``None`` is not known.
    """
    if plane is None:
        return 0
    xyz = cloud.xyz_m[cloud.kind == PointKind.PARTICLE].double().numpy()
    near = np.hypot(xyz[:, 0], xyz[:, 1]) < WITHIN_M
    return int((plane.height_above(xyz)[near] < -UNDER_M).sum())


def flat_view(clear: ViewPoints, weather: ViewPoints, reach_m: float) -> tuple[dict[str, Any], GroundPlane | None]:
    """Axes and ground for the flat pictures of the page.

    Args:
        clear, weather: the points, in the sensor's frame.
        reach_m: range up to which nearly all points lie.

    Returns:
        ``ground`` (or ``None``): ``height_m``, ``slope_x``, ``slope_y``, ``under_m``, ``within_m``; ``side_x_m``,
        ``side_z_m`` and ``elevation_deg``: ends of the axes; ``below_colour``. And the plane.
    """
    plane = fit_ground(clear.xyz_m.numpy()) if len(clear) else None
    height_m = -USUAL_HEIGHT_M if plane is None else plane.height_m
    half_m = min(LONGEST_M, 10.0 * math.ceil(max(reach_m, 10.0) / 10.0))
    particles = weather.xyz_m[weather.kind == PointKind.PARTICLE].double().numpy()
    near = particles[np.abs(particles[:, 0]) < half_m]
    lowest_m = height_m - BELOW_M
    if len(near):
        lowest_m = min(lowest_m, float(np.quantile(near[:, 2], STRAY)) - 0.5)
    found: dict[str, Any] = {
        "ground": None,
        "side_x_m": [-half_m, half_m],
        "side_z_m": [math.floor(max(lowest_m, height_m - DEEPEST_M)), math.ceil(height_m + ABOVE_M)],
        "elevation_deg": _elevations_deg(clear, weather),
        "below_colour": BELOW_COLOUR,
    }
    if plane is not None:
        found["ground"] = {
            "height_m": plane.height_m,
            "slope_x": plane.slope_x,
            "slope_y": plane.slope_y,
            "under_m": UNDER_M,
            "within_m": WITHIN_M,
        }
    return found, plane


def _elevations_deg(clear: ViewPoints, weather: ViewPoints) -> list[float]:
    """Ends of the axis of elevation: nearly all points, whole fives."""
    xyz = np.concatenate([clear.xyz_m.double().numpy(), weather.xyz_m.double().numpy()])
    if not len(xyz):
        return [-25.0, 5.0]
    elevation_deg = np.degrees(np.arctan2(xyz[:, 2], np.hypot(xyz[:, 0], xyz[:, 1])))
    low, high = np.quantile(elevation_deg, (STRAY, 1.0 - STRAY))
    low_deg, high_deg = 5.0 * math.floor((low - 0.5) / 5.0), 5.0 * math.ceil((high + 0.5) / 5.0)
    return [max(LOWEST_DEG, low_deg), min(HIGHEST_DEG, high_deg)]
