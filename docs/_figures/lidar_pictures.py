"""Pictures of the LiDAR effects: weather, two settings and panels of each."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import partial

import numpy as np
from effect_curves import bins
from effect_panels import Bars, Lines, Picture
from lidar_maps import FromAbove, LostMap, RangeImage
from lidar_panels import (
    CLEAR_AIR,
    FOG,
    HAZE,
    LIGHT_SNOW,
    MIST,
    OBJECT_RANGE,
    RAIN,
    RATIO,
    SNOW,
    at_10_to_12_m,
    bright,
    brightness,
    counts,
    lost_by_margin,
    margin_of,
    optical_depth_of,
    ratio_by_margin,
    ratio_by_range,
)
from lidar_statistics import (
    BEHIND,
    NEIGHBOUR_M,
    intensity_ratio,
    nearer_share,
    neighbours,
    particle_count,
    particles_before,
    particles_in_frames,
    residual,
    residual_share,
)

PICTURES: dict[str, Picture] = {
    "lidar.beam_divergence": Picture(
        SNOW, ({"extra_mrad": 2.0}, {"extra_mrad": 6.0}), (counts, brightness), legend=(1, "upper right")
    ),
    "lidar.isolated_return_filter": Picture(
        LIGHT_SNOW,
        ({"probability": 0.5}, {"probability": 1.0}),
        (
            Bars(
                neighbours,
                ("0", "1", "2", "3", "4", "≥ 5"),
                "neighbours on the scan within 1 m of range",
                "particle returns",
            ),
            FromAbove(15.0),
        ),
        common={"radius_m": NEIGHBOUR_M},
    ),
    "lidar.threshold_shift": Picture(RAIN, ({"shift_db": 2.0}, {"shift_db": 5.0}), (lost_by_margin, ratio_by_margin)),
    "lidar.window_loss": Picture(
        SNOW,
        ({"loss_db": 2.0}, {"loss_db": 5.0}),
        (
            Lines(
                partial(intensity_ratio, axis="range_m", edges=bins(4, 34, 5), only=bright),
                OBJECT_RANGE,
                RATIO,
                more={"ylim": (-6.5, 0.3)},
            ),
            counts,
        ),
        legend=(1, "best"),
    ),
    "lidar.extinction_scale": Picture(HAZE, ({"factor": 0.5}, {"factor": 2.0}), (ratio_by_range, lost_by_margin)),
    "lidar.wet_target": Picture(
        LIGHT_SNOW,
        ({"share": 0.3}, {"share": 0.6}),
        (
            Lines(
                partial(intensity_ratio, axis="incidence_deg", edges=bins(0, 90, 6)),
                "angle of incidence, degrees",
                RATIO,
            ),
            replace(brightness, more={"ylim": (8.0, 40.0)}),
        ),
    ),
    "lidar.blind_zone": Picture(SNOW, ({"range_m": 4.0}, {"range_m": 7.0}), (counts,)),
    "lidar.range_noise": Picture(
        RAIN,
        ({"std_m": 0.02}, {"std_m": 0.05}),
        (
            Lines(
                partial(residual_share, edges=np.arange(-15.5, 16.0, 1.0)),
                "range less clear air's, cm",
                "objects per cm, %",
                steps=True,
                zero=True,
            ),
        ),
    ),
    "lidar.range_bias": Picture(
        RAIN,
        ({"offset_m": 0.05}, {"walk_m_per_decade": -0.05}),
        (
            Lines(
                partial(residual, axis=margin_of, edges=bins(0, 16, 1)),
                "margin in clear air, dB",
                "range less clear air's, cm",
            ),
        ),
    ),
    "lidar.limited_extent": Picture(SNOW, ({"extent_m": 20.0}, {"extent_m": 8.0}), (ratio_by_range, counts)),
    "lidar.last_return": Picture(
        SNOW,
        ({"probability": 0.5}, {"probability": 1.0}),
        (Bars(particles_before, BEHIND, "range of the object behind, m", "beams with a particle, %"),),
    ),
    "lidar.static_structure": Picture(
        RAIN,
        ({"width_rad": 0.1}, {"width_rad": 0.3}),
        (
            Lines(
                partial(nearer_share, axis="azimuth_deg", edges=bins(-40, 40, 1.40625)),
                "azimuth, degrees",
                "new object returns, %",
                zero=True,
                more={"xlim": (40, -40)},
            ),
            RangeImage(40.0, 40.0),
        ),
        common={"azimuth_rad": -0.5, "range_m": 9.0},
    ),
    "lidar.intensity_compression": Picture(
        MIST,
        ({"exponent": 0.5}, {"saturation": 100.0}),
        (
            Lines(
                partial(intensity_ratio, axis="intensity", edges=bins(0, 260, 20), only=at_10_to_12_m),
                "intensity in clear air, photons",
                RATIO,
            ),
            lost_by_margin,
        ),
    ),
    "lidar.range_stretch": Picture(
        FOG,
        ({"m_per_optical_depth": 0.1}, {"m_per_optical_depth": 0.3}),
        (
            Lines(
                partial(residual, axis=optical_depth_of, edges=bins(0, 1.5, 0.1)),
                "optical depth, one way",
                "range less clear air's, cm",
            ),
        ),
    ),
    "lidar.crosstalk": Picture(
        RAIN,
        ({"probability": 0.001}, {"probability": 0.003}),
        (
            Lines(
                partial(particle_count, edges=bins(0, 120, 10)),
                "range of the point, m",
                "spurious points per m",
                zero=True,
            ),
            FromAbove(120.0),
        ),
        also=CLEAR_AIR,
    ),
    "lidar.particle_backscatter": Picture(
        SNOW, ({"gain_db": -3.0}, {"gain_db": 3.0}), (counts, brightness), legend=(1, "upper right")
    ),
    "lidar.sector_loss": Picture(
        RAIN,
        ({"loss_db": 2.0}, {"loss_db": 5.0}),
        (
            Lines(
                partial(intensity_ratio, axis="azimuth_deg", edges=bins(-60, 60, 3)),
                "azimuth, degrees",
                RATIO,
                more={"xlim": (60, -60)},
            ),
            LostMap(60.0),
        ),
        common={"azimuth_rad": -0.6, "width_rad": 0.5},
    ),
    "lidar.patchy_weather": Picture(
        SNOW,
        ({"log_std": 0.3}, {"log_std": 0.6}),
        (Lines(particles_in_frames, "frame", "particle returns, thousands", zero=True),),
    ),
    "lidar.spray": Picture(
        RAIN,
        ({"strength": 0.3}, {"strength": 1.0}),
        (counts, FromAbove(20.0, behind_only=True)),
        common={"azimuth_rad": math.pi, "width_rad": 0.5},
    ),
    "lidar.ring_gain": Picture(
        RAIN,
        ({"db_per_ring": 0.03}, {"db_per_ring": 0.1}),
        (Lines(partial(intensity_ratio, axis="elevation_deg", edges=bins(-22, 10, 2)), "elevation, degrees", RATIO),),
    ),
}
