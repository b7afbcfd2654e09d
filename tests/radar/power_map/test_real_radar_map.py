"""RADIATE's polar pictures through the chain: bytes without weather, the floor's own histogram, targets by the book."""

from __future__ import annotations

import math
from pathlib import Path

import pytest
import torch

from tests.recordings import recording
from torchweather.atmosphere.weather import Fog, Mixture, Rain, Snow
from torchweather.compose import Compose
from torchweather.io import read_image, read_points, read_power_map, write_power_map
from torchweather.radar.map_transform import RadarMapWeather
from torchweather.radar.power_map import map_detections, noise_correlation, quiet_cells, with_noise_scale
from torchweather.sensors import Camera, Lidar, Radar
from torchweather.transforms import AsBayer, BayerRain, LidarRain

pytestmark = pytest.mark.real_data

FRAMES = ("000001", "000005", "000009", "000013", "000018")
SENSOR = Radar.preset("navtech-radiate")
CALM = Mixture(Rain(0.0), Snow(0.0), Fog(math.inf))


@pytest.mark.parametrize("name", FRAMES)
def test_without_weather_a_frame_is_the_same_file(name: str, tmp_path: Path) -> None:
    file = recording(f"radiate_fog/Navtech_Polar/{name}.png")
    clear = read_power_map(file, "radiate")
    assert clear.axes.shape == (576, 400)
    for power_map in (clear, with_noise_scale(clear)):
        calm = RadarMapWeather(CALM, SENSOR, axes=clear.axes, scale=power_map.scale, radome_film_db=1.0)
        out = calm.of_map(power_map, seed=1)
        write_power_map(tmp_path / "out.png", out)
        assert (tmp_path / "out.png").read_bytes() == file.read_bytes()


@pytest.mark.parametrize("name", FRAMES[1:])
def test_a_lossy_cover_leaves_the_quiet_cells_as_they_are_and_weakens_strong_ones(name: str) -> None:
    """The scale is that of the first frame's noise, the floor is found in each."""
    first = with_noise_scale(read_power_map(recording("radiate_fog/Navtech_Polar/000001.png"), "radiate"))
    clear = read_power_map(recording(f"radiate_fog/Navtech_Polar/{name}.png"), "radiate").with_scale(first.scale)
    wet = RadarMapWeather(Rain(50.0), SENSOR, axes=clear.axes, scale=clear.scale, radome_loss_db=10.0, clutter=False)
    out = wet.of_map(clear, seed=2)
    quiet = quiet_cells(clear)
    before, after = (one.values[quiet].float() for one in (clear, out))
    # Blocks hold some weak echoes, too, which go: half a step of 0.5 dB.
    assert float(after.mean()) == pytest.approx(float(before.mean()), abs=1.0)
    assert float(after.std()) == pytest.approx(float(before.std()), rel=0.08)
    strong = clear.values >= 90
    loss_db = wet.run(clear.values).attenuation_db.expand(clear.values.shape)[strong]
    steps = clear.values[strong].float() - out.values[strong].float()
    # Cells 20 dB above the floor after the loss: bytes of 0.5 dB, less what the floor adds back (1 %).
    assert float((steps * 0.5 - loss_db).mean()) == pytest.approx(0.0, abs=0.1)


def test_the_presets_range_resolution_is_that_of_the_noise() -> None:
    """The preset states the mean over these five frames; the window's response is checked in the tests of the cells."""
    maps = [read_power_map(recording(f"radiate_fog/Navtech_Polar/{name}.png"), "radiate") for name in FRAMES]
    first, second = (sum(values) / 5 for values in zip(*(noise_correlation(one, 2) for one in maps), strict=True))
    assert first == pytest.approx(0.65, abs=0.05)
    assert second == pytest.approx(0.25, abs=0.05)
    oversampling = SENSOR.range_resolution_m / 0.17361
    assert oversampling == pytest.approx(1.4, abs=0.02)


def test_heavy_rain_hides_targets_and_lists_no_more_of_its_own_than_it_hides() -> None:
    clear = with_noise_scale(read_power_map(recording("radiate_fog/Navtech_Polar/000001.png"), "radiate"))
    rain = RadarMapWeather(Rain(50.0), SENSOR, axes=clear.axes, scale=clear.scale)
    before, after = (map_detections(one, SENSOR, noise_db=0.0) for one in (clear, rain.of_map(clear, seed=1)))
    assert 0.3 < len(after) / len(before) < 0.9
    assert torch.isfinite(after).all()


def test_one_storm_for_radar_lidar_and_camera_of_the_drive() -> None:
    folder = "radiate_fog"
    clear = with_noise_scale(read_power_map(recording(f"{folder}/Navtech_Polar/000001.png"), "radiate"))
    cloud = read_points(recording(f"{folder}/velo_lidar/000001.csv")).points.float()
    image = read_image(recording(f"{folder}/zed_left/000001.png"))[0].float() / 255.0
    height, width = image.shape[-2:]
    camera = Camera.from_intrinsics(337.9, 338.7, 341.7, 200.7, width, height)
    calm = Rain(0.0)
    compose = Compose(
        {
            "radar": RadarMapWeather(calm, SENSOR, axes=clear.axes, scale=clear.scale),
            "points": LidarRain(calm, Lidar.preset("velodyne-hdl-32e")),
            "image": AsBayer(BayerRain(calm, camera, airlight=0.6, depth=30.0)),
        },
        weather=[Rain(50.0), None],
        history="weather",
    )
    sample = {"radar": clear.values, "points": cloud, "image": image}
    for seed in range(6):
        out = compose(sample, seed=seed)
        rainy = out["weather"]["weather"] is not None
        for key, value in sample.items():
            assert torch.equal(out[key], value) != rainy, key
