"""The base model of a study: each kind against the transform itself, identities, and what belongs to whom."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch

from tests.gap import studies
from torchweather.atmosphere.weather import Fog, Rain, Snow, Weather
from torchweather.gap.sensors.camera.study_kind import simulated_camera
from torchweather.gap.sensors.lidar.study_kind import simulated_lidar
from torchweather.gap.sensors.link.study_kind import dry_samples, rain_attenuation_db, simulated_link
from torchweather.gap.sensors.radar.study_kind import simulated_radar
from torchweather.gap.study.simulation import simulate, start_frame
from torchweather.gap.study.study import Study
from torchweather.physics import rain_attenuation_p838_db_per_km
from torchweather.sensors import Camera, Lidar, Radar, scan_directions
from torchweather.transforms import BayerWeather, LidarWeather, RadarAttenuation

LIDAR = Lidar.preset(
    "ouster-os1-128",
    elevations_deg=[-4.0, 0.0, 4.0, 8.0],
    azimuth_offsets_deg=None,
    origin_heights_m=None,
    columns=256,
    intensity_unit="reflectivity",
)
GRID = (4, 256)
DIRECTION = scan_directions(LIDAR).reshape(*GRID, 3).numpy()
CAMERA = Camera.from_intrinsics(30.0, 30.0, 15.5, 11.5, 32, 24, exposure_s=0.004)
RADAR = Radar.preset("imaging-77ghz")


def scan() -> dict[str, Any]:
    rng = np.random.default_rng(1)
    seen = rng.random(GRID) < 0.7
    return {
        "range_m": np.where(seen, rng.uniform(3.0, 60.0, GRID), 0.0).astype(np.float32),
        "intensity": np.where(seen, rng.uniform(0.1, 0.9, GRID), 0.0).astype(np.float32),
    }


def picture() -> tuple[dict[str, Any], Any]:
    rng = np.random.default_rng(2)
    depth_m = np.full((24, 32), 40.0, dtype=np.float32)
    depth_m[:8] = math.inf
    bayer = rng.uniform(0.05, 0.4, (24, 32)).astype(np.float32)
    bayer[:8] = 0.6
    return {"bayer": bayer}, depth_m


def study(kind: str, clear: int, frames: int) -> Study:
    """A small study; of a camera one with sky in view."""
    if kind != "camera":
        return studies.study(kind, clear=clear, frames=frames)
    frame, depth_m = picture()
    rng = np.random.default_rng(3)
    shots = [{"bayer": np.clip(frame["bayer"] + 0.01 * rng.standard_normal((24, 32)), 0, 1)} for _ in range(clear)]
    return Study.from_arrays(
        sensor=CAMERA,
        scenes=[{"id": "s0", "clear": shots, "geometry": {"depth_m": depth_m}}],
        conditions=[{"id": "c0", "scene": "s0", "weather": "rain:rate=25", "frames": [frame] * frames}],
    )


def detections() -> tuple[dict[str, Any], dict[str, Any]]:
    geometry = {
        "range_m": np.array([20.0, 50.0, 75.0, 60.0]),
        "azimuth_rad": np.array([0.0, 0.3, -0.4, 0.1]),
        "elevation_rad": np.array([0.0, 0.02, 0.05, 0.0]),
    }
    clear = {
        "power_db": np.array([-80.0, -95.0, np.nan, -112.0]),
        "range_m": np.array([20.1, 49.9, np.nan, 60.0]),
        "speed_m_per_s": np.array([0.0, -2.0, np.nan, 1.0]),
        "noise_floor_db": np.array(-125.0),
        "clutter": np.ones((2, 6)),
    }
    return clear, geometry


# ---- LiDAR -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("weather", [Rain(25.0), Fog(mor_m=40.0), Snow(2.0)])
def test_a_scan_is_what_the_transform_makes_of_its_points(weather: Weather) -> None:
    clear = scan()
    beams = torch.from_numpy(DIRECTION).reshape(-1, 3)
    range_m, intensity = (torch.from_numpy(clear[key]).reshape(-1) for key in ("range_m", "intensity"))
    points = torch.cat([range_m[:, None] * beams, intensity[:, None]], -1)
    transform = LidarWeather(weather, LIDAR, beam_ends="max_range")
    wanted = transform(points, transform.draw(points, seed=5), directions=beams)
    found = simulated_lidar(clear, DIRECTION, weather, LIDAR, 5)
    there = (wanted[:, :3] != 0).any(-1)
    assert torch.equal(torch.from_numpy(found["range_m"]).reshape(-1) > 0, there)
    # Ranges are metres up to 120: single precision through x, y, z and back leaves 120 * 2^-23 * 3.
    torch.testing.assert_close(
        torch.from_numpy(found["range_m"]).reshape(-1), wanted[:, :3].norm(dim=-1) * there, rtol=0, atol=5e-5
    )
    assert torch.equal(torch.from_numpy(found["intensity"]).reshape(-1)[there], wanted[there, 3])


def test_without_weather_a_scan_keeps_its_bits() -> None:
    clear = scan()
    found = simulated_lidar(clear, DIRECTION, Rain(0.0), LIDAR, 5)
    for name, values in clear.items():
        assert np.array_equal(found[name], values), name


def test_beams_without_return_see_flakes_and_objects_keep_their_own_range() -> None:
    clear = scan()
    found = simulated_lidar(clear, DIRECTION, Snow(3.0), LIDAR, 7)
    empty = clear["range_m"] == 0
    assert (found["range_m"][empty] > 0).any()
    kept = (found["range_m"] == clear["range_m"]) & ~empty
    nearer = (found["range_m"] < clear["range_m"]) & (found["range_m"] > 0)
    lost = (found["range_m"] == 0) & ~empty
    assert kept.sum() + nearer.sum() + lost.sum() == (~empty).sum()
    assert nearer.any()


# ---- camera ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("weather", [Rain(25.0), Fog(mor_m=80.0), Snow(2.0)])
def test_a_picture_is_what_the_transform_makes_of_it(weather: Weather) -> None:
    clear, depth_m = picture()
    transform = BayerWeather(weather, CAMERA, ego_speed_m_per_s=20.0)
    bayer = torch.from_numpy(clear["bayer"])[None]
    wanted = transform(bayer, torch.from_numpy(depth_m)[None], transform.draw(bayer, seed=3))
    found = simulated_camera(clear, depth_m, weather, CAMERA, 3, ego_speed_m_per_s=20.0)
    assert np.array_equal(found["bayer"], wanted[0].numpy())


def test_frames_of_a_companding_camera_are_linear_already() -> None:
    clear, depth_m = picture()
    companding = replace(CAMERA, response_knots=((0.0, 0.0), (0.1, 0.5), (1.0, 1.0)))
    found, wanted = (simulated_camera(clear, depth_m, Fog(mor_m=80.0), camera, 3) for camera in (companding, CAMERA))
    assert np.array_equal(found["bayer"], wanted["bayer"])


def test_exposure_of_the_condition_counts() -> None:
    built = study("camera", clear=2, frames=1)
    condition = built.conditions[0]
    short, long = (simulate(built, replace(condition, exposure_s=s), seed=1)["bayer"] for s in (1e-4, 0.05))
    assert not np.array_equal(short, long)


def test_a_measured_airlight_of_the_condition_counts() -> None:
    built = study("camera", clear=2, frames=1)
    condition = replace(built.conditions[0], weather=Fog(mor_m=5.0), airlight=(0.3, 0.4, 0.5))
    foggy = simulate(built, condition, seed=1)["bayer"]
    # Of a scene some metres away nothing is left in fog of 5 m, but where it is near: the airlight shows.
    assert np.median(foggy[0::2, 0::2]) == pytest.approx(0.3, abs=0.05)
    assert np.median(foggy[1::2, 1::2]) == pytest.approx(0.5, abs=0.05)


def test_the_exposure_gain_of_the_condition_counts() -> None:
    built = study("camera", clear=2, frames=1)
    foggy = replace(built.conditions[0], weather=Fog(mor_m=40.0))
    plain, half = (simulate(built, replace(foggy, exposure_gain=gain), seed=1)["bayer"] for gain in (None, 0.5))
    np.testing.assert_allclose(half, 0.5 * plain, atol=1e-6)
    one = simulate(built, replace(foggy, exposure_gain=1.0), seed=1)["bayer"]
    assert np.array_equal(one, plain)
    # Measured airlight has the exposure of its own frames: where nothing else is left, the gain changes nothing.
    dense = replace(built.conditions[0], weather=Fog(mor_m=5.0), airlight=(0.3, 0.4, 0.5), exposure_gain=0.5)
    assert np.median(simulate(built, dense, seed=1)["bayer"][0::2, 0::2]) == pytest.approx(0.3, abs=0.05)
    # A gain above 1 saturates.
    bright = simulate(built, replace(built.conditions[0], weather=Fog(mor_m=1e4), exposure_gain=500.0), seed=1)["bayer"]
    assert bright.max() <= 1.0


# ---- radar -----------------------------------------------------------------------------------------------------------


def test_detections_are_what_the_transform_makes_of_them() -> None:
    clear, geometry = detections()
    transform = RadarAttenuation(Rain(50.0), replace(RADAR, noise_floor_db=-125.0))
    per_km = float(transform.attenuation_db_per_km)
    found = simulated_radar(clear, geometry, Rain(50.0), RADAR, 1)
    loss_db = 2e-3 * per_km * geometry["range_m"]
    # Of 12 dB over the floor of -125 dB, the fourth has 1 dB to spare and loses 2.2 dB (18.5 dB/km); the third was
    # never detected.
    assert loss_db[3] == pytest.approx(2.2, abs=0.1)
    np.testing.assert_allclose(found["power_db"][:2], (clear["power_db"] - loss_db)[:2], rtol=0, atol=1e-5)
    for name in ("power_db", "range_m", "speed_m_per_s"):
        assert np.isnan(found[name]).tolist() == [False, False, True, True], name
    assert np.array_equal(found["range_m"][:2], clear["range_m"][:2])
    assert np.array_equal(found["clutter"], clear["clutter"])
    assert found["noise_floor_db"] == -125.0


def test_a_fog_without_droplets_leaves_detections_as_they_are() -> None:
    clear, geometry = detections()
    found = simulated_radar(clear, geometry, Fog(), RADAR, 1)
    for name, values in clear.items():
        assert np.array_equal(found[name], values, equal_nan=True), name


# ---- links -----------------------------------------------------------------------------------------------------------


def test_loss_of_a_link_is_that_of_its_parts() -> None:
    links = {"length_km": np.array([3.0]), "frequency_ghz": np.array([23.0]), "polarisation": np.array([0])}
    rain = np.array([[[2.0, 0.0, 40.0]]])
    each = rain_attenuation_p838_db_per_km(torch.from_numpy(rain), 23.0)[0, 0]
    assert rain_attenuation_db(links, rain)[0, 0] == pytest.approx(float(each.sum()), rel=1e-12)  # 1 km each, one way
    upright = rain_attenuation_db({**links, "polarisation": np.array([1])}, rain)[0, 0]
    vertical = rain_attenuation_p838_db_per_km(torch.from_numpy(rain), 23.0, polarisation_tilt_rad=math.pi / 2)
    assert upright == pytest.approx(float(vertical.sum()), rel=1e-12)
    assert np.isnan(rain_attenuation_db(links, np.array([[[1.0, np.nan, 0.0]]])))[0, 0]


def test_a_link_starts_from_its_own_dry_samples() -> None:
    time_s = 300.0 * np.arange(40)
    rain = np.zeros((40, 2, 1))
    rain[10:13] = 8.0
    attenuation = np.stack([np.full(40, 0.5), np.full(40, -0.25)], -1)
    attenuation[9:16] = 77.0  # in rain and less than 15 min from it: never a start
    links = {
        "length_km": np.array([1.0, 2.0]),
        "frequency_ghz": np.array([20.0, 20.0]),
        "polarisation": np.array([1, 1]),
    }
    frame = {"time_s": time_s, "attenuation_db": attenuation, "rain_mm_per_h": rain}
    found = simulated_link(links, frame, 4)["attenuation_db"]
    loss = rain_attenuation_db(links, rain)
    np.testing.assert_allclose(found, loss + np.array([0.5, -0.25]), rtol=0, atol=1e-12)
    assert loss[11, 1] == pytest.approx(2 * loss[11, 0])


def test_unknown_rain_is_not_dry() -> None:
    rain = np.zeros((4, 1, 1))
    rain[0] = np.nan
    assert dry_samples(np.array([0.0, 900.0, 900.1, 5000.0]), rain)[:, 0].tolist() == [False, False, True, True]


# ---- studies ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", studies.KINDS)
def test_the_same_seed_gives_the_same_frame_and_the_global_generator_stays(kind: str) -> None:
    built = study(kind, clear=3, frames=2)
    condition = built.conditions[0]
    before = torch.get_rng_state()
    first, again = (simulate(built, condition, seed=11, number=1) for _ in range(2))
    assert torch.equal(torch.get_rng_state(), before)
    assert set(first) == set(again)
    for name, values in first.items():
        assert np.array_equal(values, again[name], equal_nan=True), name
    others = [simulate(built, condition, seed=seed, number=number) for seed, number in ((11, 0), (12, 1))]
    main = {"lidar": "intensity", "camera": "bayer", "radar": "power_db", "link": "attenuation_db"}[kind]
    seen = [each[main] for each in others]
    assert any(not np.array_equal(first[main], each, equal_nan=True) for each in seen)


def test_clear_conditions_give_clear_frames() -> None:
    built = study("lidar", clear=4, frames=2)
    condition = next(each for each in built.conditions if each.weather is None)
    for number in range(6):
        found = simulate(built, condition, seed=2, number=number)
        start = start_frame(built, condition, seed=2, number=number)
        assert np.array_equal(found["range_m"], built.scene_of(condition).clear[start]["range_m"])


def test_every_clear_frame_is_a_start_equally_often() -> None:
    built = study("radar", clear=4, frames=1)
    starts = [start_frame(built, built.conditions[0], seed=3, number=number) for number in range(800)]
    counts = np.bincount(starts, minlength=4)
    # Binomial of 800 and 1/4: 200 with a standard deviation of 12.2; four of them.
    assert np.abs(counts - 200).max() < 49


def test_integers_are_rounded_once() -> None:
    """Mean loss of dark returns: half a step of rounding on both sides cancels, as in frames of the sensor."""
    beams = np.tile([1.0, 0.0, 0.0], (8, 512, 1))
    levels = np.full((8, 512), 3.0, np.float32)
    frame = {"range_m": np.full((8, 512), 8.0, np.float32), "intensity": levels}
    lidar = Lidar(905.0, intensity_unit="uint8_calibrated")
    built = Study.from_arrays(
        sensor=lidar,
        beams={"direction": beams},
        scenes=[{"id": "s0", "clear": [frame, frame]}],
        conditions=[{"id": "c0", "scene": "s0", "weather": "fog:mor=250", "frames": [frame]}],
    )
    found = simulate(built, built.conditions[0], seed=1)
    seen = np.isclose(found["range_m"], 8.0, atol=1e-3)
    passed = math.exp(-2.0 * 8.0 * float(LidarWeather(Fog(mor_m=250.0), lidar).extinction_per_m))
    # Levels spread evenly over 3 to 4, dimmed and rounded down: the share that falls below 3.
    below = min((3.0 / passed - 3.0), 1.0)
    assert 0.2 < below < 0.9
    share = float(np.mean(found["intensity"][seen] < 3.0))
    assert share == pytest.approx(below, abs=4 * math.sqrt(below * (1 - below) / seen.sum()) + 2e-3)
    assert set(np.unique(found["intensity"][seen])) <= {2.0, 3.0}
