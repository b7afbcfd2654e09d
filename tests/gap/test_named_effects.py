"""Which effects the search tries by itself, and that it finds the others where they are named."""

from __future__ import annotations

import pytest

from tests.gap.tiny_camera_study import values_of
from tests.gap.tiny_radar_study import tiny_radar_study
from tests.gap.tiny_study import tiny_study
from torchweather.atmosphere.weather import Rain
from torchweather.gap import find_gap
from torchweather.gap.inference.effect_forms import searched_effects
from torchweather.gap.study.study import Study
from torchweather.stages import EFFECTS

# The names of the catalogue that the gap search is specified with.
SPECIFIED = {
    "lidar": (
        "beam_divergence isolated_return_filter threshold_shift window_loss extinction_scale wet_target blind_zone "
        "range_noise range_bias limited_extent last_return static_structure intensity_compression range_stretch "
        "crosstalk particle_backscatter sector_loss patchy_weather spray ring_gain"
    ),
    "camera": (
        "exposure_gain airlight_scale extinction_scale stray_light aerosol_glow defocus ego_blur adherent_drops "
        "vignetting wind_slant wet_surface sensor_noise tone_curve saturation patchy_fog height_fog streak_contrast "
        "particle_count rolling_shutter"
    ),
    "radar": (
        "wet_radome volume_clutter noise_floor cfar_shift path_loss_scale multipath doppler_spread wet_rcs "
        "interference range_migration pattern_tilt fluctuation detection_limit"
    ),
}
NAMED_ALONE = {
    "lidar": {"snow_cover", "road_spray"},
    "camera": {"snow_cover", "road_spray", "refracting_drops"},
    "radar": {"road_spray"},
}


@pytest.mark.parametrize("sensor", SPECIFIED)
def test_every_specified_name_is_searched_for_by_default(sensor: str) -> None:
    searched = set(searched_effects(sensor))
    assert {f"{sensor}.{name}" for name in SPECIFIED[sensor].split()} <= searched
    every = {name for name in EFFECTS if name.startswith(f"{sensor}.")}
    assert every - searched == {f"{sensor}.{name}" for name in NAMED_ALONE[sensor]}


def study_with_spray(sensor: str) -> Study:
    """A small study in rain behind a vehicle 15 m ahead, whose spray the model lacks."""
    water_g_per_m = {"lidar": 30.0, "camera": 10.0, "radar": 100.0}[sensor]
    hidden = [EFFECTS[f"{sensor}.road_spray"](water_g_per_m=water_g_per_m)]
    if sensor == "lidar":
        return tiny_study(hidden, seed=2, weathers=(Rain(15.0), Rain(40.0), Rain(25.0)))
    if sensor == "radar":
        return tiny_radar_study(hidden, seed=2, number=48)
    return Study.from_arrays(**values_of(hidden, kind="rain", seed=4))


@pytest.mark.long
@pytest.mark.parametrize(
    ("sensor", "rivals"),
    [
        ("lidar", "spray window_loss sector_loss"),
        ("camera", "extinction_scale stray_light"),
        ("radar", "wet_radome"),
    ],
)
def test_spray_is_found_where_it_is_named(sensor: str, rivals: str) -> None:
    named = [f"{sensor}.road_spray", *(f"{sensor}.{name}" for name in rivals.split())]
    found = find_gap(study_with_spray(sensor), effects=named, seed=0).to_dict()
    assert found["verdict"] in ("named", "named_and_rest")  # eight parameters, fitted to a few frames
    (effect,) = found["effects"]
    assert effect["name"] == f"{sensor}.road_spray"
    # The cloud thins out over 20 m: its place is known to a tenth of that.
    assert effect["parameters"]["distance_m"] == pytest.approx(15.0, abs=2.0)
    assert found["gap"]["after"] < 0.3 * found["gap"]["before"]
