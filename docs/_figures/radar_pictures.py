"""Pictures of the radar effects: weather, two settings and panels of each."""

from __future__ import annotations

from functools import partial

from effect_curves import bins
from effect_panels import Bars, Lines, Picture
from radar_frames import CLASSES, CLEAR_AIR, HEAVY_RAIN, RAIN
from radar_statistics import (
    behind_targets,
    by_frame,
    drying,
    floors,
    listed,
    listed_of,
    lost_share,
    more_by_range,
    more_by_speed,
    of_classes,
    one_target,
    over_clear_air,
    ratio_share,
    residuals,
    speed_share,
)

RANGE, AZIMUTH, MARGIN = "range of the target, m", "azimuth, degrees", "margin in clear air, dB"
RATIO, LOST, FRAME = "power over clear air's, dB", "targets lost, %", "frame"
ratio_by_range = Lines(partial(over_clear_air, axis="range_m", edges=bins(5, 65, 5)), RANGE, RATIO)
snr_by_margin = Lines(
    partial(over_clear_air, axis="margin_db", edges=bins(0, 25, 1), what="snr_db", margin_db=0.0),
    MARGIN,
    "SNR over clear air's, dB",
    more={"ylim": (-9.0, 1.0)},
)
ratio_by_margin = Lines(
    partial(over_clear_air, axis="margin_db", edges=bins(0, 25, 1), margin_db=0.0),
    MARGIN,
    RATIO,
    more={"ylim": (-9.0, 1.0)},
)
lost_by_margin = Lines(partial(lost_share, edges=bins(0, 16, 1)), MARGIN, LOST, zero=True)

PICTURES: dict[str, Picture] = {
    "radar.wet_radome": Picture(
        RAIN,
        ({"film_db": 0.5}, {"film_db": 1.5}),
        (ratio_by_range, Lines(drying, "time, min (rain from 5 to 25 min)", "loss of the cover, dB")),
        legend=(1, "upper right"),
    ),
    "radar.volume_clutter": Picture(
        RAIN,
        ({"share": 0.003}, {"share": 0.01}),
        (
            Lines(
                partial(more_by_range, edges=bins(0, 12, 0.5)),
                "range of the detection, m",
                "detections per m",
                steps=True,
                zero=True,
            ),
            Lines(
                partial(more_by_speed, edges=bins(-6, 6, 0.5)),
                "radial speed, m/s",
                "detections per m/s",
                steps=True,
                zero=True,
            ),
        ),
    ),
    "radar.noise_floor": Picture(RAIN, ({"shift_db": 3.0}, {"shift_db": 6.0}), (lost_by_margin, snr_by_margin)),
    "radar.cfar_shift": Picture(RAIN, ({"shift_db": 3.0}, {"shift_db": 6.0}), (lost_by_margin, snr_by_margin)),
    "radar.path_loss_scale": Picture(
        HEAVY_RAIN, ({"factor": 0.5}, {"factor": 2.0}), (ratio_by_range, lost_by_margin), legend=(0, "lower left")
    ),
    "radar.multipath": Picture(
        CLEAR_AIR,
        ({"amplitude": 0.2}, {"amplitude": 0.5}),
        (
            Lines(
                partial(behind_targets, edges=bins(-0.25, 6.25, 0.5)),
                "range behind the target, m",
                "targets with a ghost, %",
                steps=True,
                zero=True,
            ),
            Lines(
                partial(ratio_share, edges=bins(-10.25, 6.25, 0.5)),
                RATIO,
                "targets per dB, %",
                steps=True,
                zero=True,
                title="delay_m = 0.1 m",
                more={"xlim": (-13.0, 6.0)},
                instead={"delay_m": 0.1},
            ),
        ),
        common={"delay_m": 3.0},
        common_in_title=True,
        legend=(1, "upper left"),
    ),
    "radar.doppler_spread": Picture(
        RAIN,
        ({"std_m_per_s": 0.1}, {"std_m_per_s": 0.3}),
        (
            Lines(
                partial(speed_share, edges=bins(-1.0125, 1.0125, 0.025)),
                "measured speed of targets at rest, m/s",
                "targets per 0.1 m/s, %",
                steps=True,
                zero=True,
            ),
        ),
    ),
    "radar.wet_rcs": Picture(
        RAIN,
        ({"gain_db": (0.0, 1.0, 2.0)}, {"gain_db": (-1.0, 2.0, 4.0)}),
        (Bars(of_classes, CLASSES, "class of the target", RATIO, base_line=True),),
    ),
    "radar.interference": Picture(
        RAIN,
        ({"probability": 0.1}, {"probability": 0.4}),
        (
            Lines(partial(by_frame, what=floors), FRAME, "noise floor, dBm", dots=True),
            Lines(partial(by_frame, what=listed), FRAME, "targets detected, %", dots=True, more={"ylim": (0, 105)}),
        ),
        common={"level_db": 10.0},
        common_in_title=True,
        legend=(1, "lower left"),
    ),
    "radar.range_migration": Picture(
        RAIN,
        ({"m_per_frame": 0.01}, {"m_per_frame": 0.03}),
        (Lines(partial(by_frame, what=residuals), FRAME, "range less clear air's, cm"),),
    ),
    "radar.pattern_tilt": Picture(
        RAIN,
        ({"angle_rad": 0.05}, {"angle_rad": -0.1}),
        (
            Lines(
                partial(over_clear_air, axis="azimuth_deg", edges=bins(-50, 50, 5)),
                AZIMUTH + " (left is positive)",
                RATIO,
                more={"xlim": (50, -50)},
            ),
        ),
    ),
    "radar.fluctuation": Picture(
        RAIN,
        ({"log_std_db": 1.5}, {"log_std_db": 4.0}),
        (
            Lines(partial(by_frame, what=one_target), FRAME, f"{RATIO}\n(one target)"),
            Lines(
                partial(ratio_share, edges=bins(-16.25, 10.25, 0.5)),
                RATIO,
                "targets per dB, %",
                steps=True,
                zero=True,
                more={"xlim": (-29.0, 10.0)},
            ),
        ),
        legend=(1, "upper left"),
    ),
    "radar.detection_limit": Picture(
        RAIN,
        ({"max_count": 100.0}, {"max_count": 50.0}),
        (
            Lines(partial(lost_share, edges=bins(0, 25, 1)), MARGIN, LOST),
            Lines(partial(listed_of, sizes=bins(16, 256, 16)), "targets in the frame", "detections listed", zero=True),
        ),
        scene="few",
        legend=(1, "upper left"),
    ),
    "radar.road_spray": Picture(
        RAIN,
        ({"water_g_per_m": 20.0}, {"water_g_per_m": 200.0}),
        (
            ratio_by_range,
            Lines(
                partial(more_by_range, edges=bins(0, 20, 1)),
                "range of the detection, m",
                "detections per m",
                steps=True,
                zero=True,
            ),
        ),
        legend=(0, "lower left"),
    ),
}
