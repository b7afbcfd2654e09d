"""Pictures of the structure of rain and snow: density by direction, sizes, near ones, one particle in two beams."""

from __future__ import annotations

import math
from functools import partial

from effect_curves import bins
from effect_panels import Lines, Picture
from lidar_maps import FromAbove
from lidar_panels import LIGHT_SNOW, SNOW, brightness, counts
from lidar_statistics import apart_of_neighbours, particle_share

PICTURES: dict[str, Picture] = {
    "lidar.particle_density_azimuth": Picture(
        LIGHT_SNOW,
        ({"amplitude": 2.0}, {"amplitude": 2.0, "wind_amplitude": 0.6}),
        (
            Lines(
                partial(particle_share, axis="azimuth_deg", edges=bins(-180, 180, 10)),
                "azimuth, degrees",
                "sky beams with a particle, %",
                zero=True,
                more={"xlim": (180, -180), "xticks": (180, 90, 0, -90, -180)},
            ),
            FromAbove(15.0),
        ),
        common={"azimuth_rad": math.pi, "width_rad": 1.0},
        legend=(0, "lower left"),
    ),
    "lidar.particle_density_elevation": Picture(
        LIGHT_SNOW,
        ({"amplitude": 2.0}, {"amplitude": 2.0, "steepness": 8.0}),
        (
            Lines(
                partial(particle_share, axis="elevation_deg", edges=bins(0, 23, 1)),
                "elevation, degrees",
                "sky beams with a particle, %",
                zero=True,
            ),
        ),
        common={"elevation_rad": 0.1, "width_rad": 0.15},
    ),
    "lidar.particle_sizes": Picture(
        SNOW, ({"factor_1mm": 5.0}, {"factor_4mm": 5.0}), (counts, brightness), legend=(1, "upper right")
    ),
    "lidar.shared_particles": Picture(
        SNOW,
        ({"share": 0.5}, {"share": 1.0}),
        (
            Lines(
                apart_of_neighbours,
                "neighbouring particle returns: apart in range, cm",
                "pairs in a frame",
                zero=True,
                steps=True,
            ),
        ),
        scene="fine",
    ),
    "lidar.near_response": Picture(
        SNOW,
        ({"full_m": 8.0, "power": 1.0}, {"full_m": 16.0, "power": 2.0}),
        (counts, brightness),
        legend=(0, "upper right"),
    ),
}
