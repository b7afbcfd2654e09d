"""Pictures of the LiDAR effects of snow on things and of road spray: weather, two settings and panels of each."""

from __future__ import annotations

from functools import partial

from effect_curves import bins
from effect_panels import Lines, Picture
from lidar_panels import LIGHT_SNOW, RAIN, RATIO, brightness, counts, ratio_by_range
from lidar_statistics import intensity_ratio

PICTURES: dict[str, Picture] = {
    "lidar.snow_cover": Picture(
        LIGHT_SNOW,
        ({"reflectivity": 0.05}, {"reflectivity": 0.85}),
        (
            Lines(
                partial(intensity_ratio, axis="incidence_deg", edges=bins(0, 90, 6)),
                "angle of incidence, degrees",
                RATIO,
            ),
            brightness,
        ),
        common={"depth_mm": 10.0},
        legend=(1, "best"),
    ),
    "lidar.road_spray": Picture(
        RAIN,
        ({"water_g_per_m": 4.0}, {"water_g_per_m": 20.0}),
        (ratio_by_range, counts),
        legend=(1, "best"),
    ),
}
