"""Targets of a radar, seen from above: detections, powers, speeds and ranges less those of the clear frames."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from torchweather.gap.places import CellValues, Point, mean_over_frames, quantity_of
from torchweather.gap.sensors.radar.frames import RadarFrames
from torchweather.gap.sensors.radar.scene import Detections, detections_of
from torchweather.gap.study.conditions import Condition

__all__ = ["radar_cells"]

Floats = NDArray[np.float64]

QUANTITIES = {
    **dict.fromkeys(("lost", "detections", "clutter", "ghost", "noise_floor"), "lost"),
    **dict.fromkeys(("speed", "repeated_speed"), "speed_m_per_s"),
    **dict.fromkeys(("range", "repeated_range"), "range_m"),
}
NAMES = {
    "lost": ("frames in which a target is not detected", "% of frames"),
    "power_db": ("power over clear air's", "dB"),
    "speed_m_per_s": ("speed less clear air's", "m/s"),
    "range_m": ("range less clear air's", "m"),
}


def radar_cells(
    model: RadarFrames, condition: Condition, statistic: str, before: Point, after: Point | None, seeds: Sequence[int]
) -> CellValues:
    """Targets of a condition; arguments as ``places.PlacesOf``."""
    scene = model.scenes[condition.scene]
    quantity = quantity_of(statistic, QUANTITIES, "power_db")
    counted = scene.counted.any(0)
    clear = {name: mean_over_frames(values[:, counted])[0] for name, values in scene.reference.items()}

    def of(frames: Detections) -> Floats:
        if quantity == "lost":
            return 100.0 * np.isnan(frames.power_db[:, counted]).astype(np.float64)
        values: Floats = getattr(frames, quantity)[:, counted] - clear[quantity]
        return values

    measured = detections_of(list(condition.frames))
    known = {name: values[counted] for name, values in scene.geometry.items()}
    flat = known["range_m"] * np.cos(known["elevation_rad"])
    name, unit = NAMES[quantity]
    half = 50.0 / len(measured) if quantity == "lost" else 0.0
    return CellValues(
        name,
        unit,
        of(measured),
        of(model.simulated_lists(condition, *before, seeds)),
        None if after is None else of(model.simulated_lists(condition, *after, seeds)),
        np.full(int(counted.sum()), half),
        x=-flat * np.sin(known["azimuth_rad"]),
        y=flat * np.cos(known["azimuth_rad"]),
        x_name="to the right, m",
        y_name="ahead, m",
    )
