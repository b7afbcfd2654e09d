"""Pictures of the camera effects: weather, two settings, the curve and the part of the frame of each."""

from __future__ import annotations

from camera_picture import AHEAD, HIGH, WALL, WALL_M, Picture
from camera_statistics import (
    against_radius,
    along_a_row,
    by_elevation,
    cover,
    flicker,
    frame_by_frame,
    more,
    on_the_road,
    optical_depth,
    ratio,
    response,
    sharpness,
    sharpness_by_direction,
    streak_directions,
    streak_lengths,
    variance,
)

import torchweather as tw

MIST, FOG, RAIN = tw.Fog(mor_m=150.0), tw.Fog(mor_m=60.0), tw.Rain(25.0)
DEPTH, RATIO, MORE = "depth, m", "signal over that without", "signal more than without"
SHARP = "sharpness over that without"

PICTURES: dict[str, Picture] = {
    "camera.exposure_gain": Picture(MIST, ({"factor": 0.8}, {"factor": 1.4}), ratio, DEPTH, RATIO),
    "camera.airlight_scale": Picture(
        FOG,
        ({"red": 0.8, "green": 0.8, "blue": 0.8}, {"red": 1.2, "green": 1.2, "blue": 1.2}),
        more,
        DEPTH,
        MORE,
        legend="lower left",
        limits=(-0.24, 0.12),
    ),
    "camera.extinction_scale": Picture(
        MIST, ({"factor": 0.5}, {"factor": 2.0}), optical_depth, DEPTH, "optical depth", zero=True
    ),
    "camera.stray_light": Picture(
        MIST, ({"offset": 0.03}, {"offset": 0.1}), more, DEPTH, MORE, zero=True, legend="center right"
    ),
    "camera.aerosol_glow": Picture(
        FOG,
        ({"share_per_optical_depth": 0.3}, {"share_per_optical_depth": 1.5}),
        sharpness,
        DEPTH,
        SHARP,
        AHEAD,
        common={"width_px_per_optical_depth": 4.0},
        zero=True,
    ),
    "camera.defocus": Picture(
        MIST, ({"radius_px": 1.5}, {"radius_px": 4.0}), sharpness, DEPTH, SHARP, AHEAD, zero=True
    ),
    "camera.ego_blur": Picture(
        MIST,
        ({"length_px": 4.0}, {"length_px": 12.0}),
        sharpness_by_direction,
        "direction of the step, degrees",
        SHARP,
        AHEAD,
        common={"angle_rad": 0.0},
        limits=(-0.4, 1.05),
        legend="lower center",
    ),
    "camera.adherent_drops": Picture(
        MIST,
        ({"cover": 0.1}, {"cover": 0.3}),
        along_a_row,
        "column, px",
        "signal along a row",
        legend="upper left",
        limits=(0.1, 0.75),
    ),
    "camera.vignetting": Picture(
        MIST,
        ({"strength": 0.3}, {"strength": 1.0}),
        against_radius,
        "distance from the image's centre, px",
        RATIO,
        ((0.0, 1.0), (0.0, 1.0)),
    ),
    "camera.wind_slant": Picture(
        RAIN,
        ({"angle_rad": 0.2}, {"angle_rad": 0.5}),
        streak_directions,
        "lean of streaks to the right, degrees",
        "correlation 12 px along it",
        WALL,
        shown="cover",
        one_depth_m=WALL_M,
        shown_depth_m=WALL_M,
        limits=(-0.004, 0.045),
        legend="upper left",
    ),
    "camera.wet_surface": Picture(
        MIST,
        ({"darkening": 0.4, "mirror": 0.0}, {"darkening": 0.4, "mirror": 1.0}),
        on_the_road,
        "depth of level ground, m",
        RATIO,
        legend="upper right",
        limits=(0.65, 1.6),
    ),
    "camera.sensor_noise": Picture(
        MIST,
        ({"electrons_per_unit": 3000.0}, {"electrons_per_unit": 500.0}),
        variance,
        "mean signal",
        "variance, 1e-4",
        AHEAD,
        common={"read_electrons": 5.0},
        zero=True,
    ),
    "camera.tone_curve": Picture(
        MIST, ({"gamma": 0.8}, {"gamma": 1.5}), response, "signal without", "signal", zero=True
    ),
    "camera.saturation": Picture(
        MIST, ({"level": 0.45}, {"level": 0.3}), response, "signal without", "signal", zero=True
    ),
    "camera.patchy_fog": Picture(
        FOG, ({"log_std": 0.3}, {"log_std": 0.8}), frame_by_frame, "frame", "transmission, 30 to 50 m away", zero=True
    ),
    "camera.height_fog": Picture(
        FOG,
        ({"scale_height_m": 20.0}, {"scale_height_m": 3.0}),
        by_elevation,
        "elevation, degrees",
        "transmission to 50 m",
        HIGH,
        one_depth_m=50.0,
        zero=True,
        legend="upper left",
    ),
    "camera.streak_contrast": Picture(
        RAIN,
        ({"factor": 0.5}, {"factor": 3.0}),
        flicker,
        DEPTH,
        "standard deviation, 1e-3",
        WALL,
        shown="change",
        shown_depth_m=WALL_M,
        zero=True,
    ),
    "camera.particle_count": Picture(
        RAIN,
        ({"factor": 0.5}, {"factor": 2.0, "depth_max_m": 20.0}),
        cover,
        DEPTH,
        "covered by drops, %",
        WALL,
        shown="cover",
        shown_depth_m=WALL_M,
        zero=True,
        limits=(0.0, 11.0),
        legend="upper left",
    ),
    "camera.rolling_shutter": Picture(
        RAIN,
        ({"row_time_s": 1e-4}, {"row_time_s": 2e-4}),
        streak_lengths,
        "rows apart, px",
        "correlation of the cover",
        WALL,
        shown="cover",
        one_depth_m=WALL_M,
        shown_depth_m=WALL_M,
        zero=True,
    ),
    "camera.snow_cover": Picture(
        MIST,
        ({"depth_mm": 2.0}, {"depth_mm": 20.0}),
        on_the_road,
        "depth of level ground, m",
        RATIO,
        legend="upper right",
    ),
    "camera.road_spray": Picture(
        MIST,
        ({"water_g_per_m": 4.0}, {"water_g_per_m": 20.0}),
        on_the_road,
        "depth of level ground, m",
        RATIO,
        common={"distance_m": 20.0, "lateral_m": -1.5},
        legend="upper right",
    ),
    "camera.refracting_drops": Picture(
        MIST,
        ({"cover": 0.1}, {"cover": 0.3}),
        along_a_row,
        "column, px",
        "signal along a row",
        common={"blur_px": 6.0},
        legend="upper left",
        limits=(0.1, 0.75),
    ),
}
