"""Outputs are finite over the whole range of every unit, and a little beyond."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch

from tests.contract.table import LIDAR, RADAR, TABLE, cloud, detections, frame, image, rays
from torchweather.atmosphere.weather import Fog, Mixture, Rain, Snow
from torchweather.lidar.sensor import INTENSITY_UNITS
from torchweather.transforms import LidarWeather, RadarAttenuation

EVERYTHING = Mixture(Snow(2.0), Fog(40.0), Rain(30.0))
# Largest intensity of a unit that files hold; photons of a retroreflector. Beyond 255 lies what 8 bits cannot hold.
LARGEST = {"reflectivity": 1e4, "reflectivity_percent": 1e6, "photons": 1e9, "none": 1e9}
pytestmark = pytest.mark.filterwarnings("ignore:.*(the sensor declares|lies? above)")


@pytest.mark.parametrize("mode", ["strongest", "dual"])
@pytest.mark.parametrize("unit", INTENSITY_UNITS)
def test_a_cloud_is_finite_at_every_intensity(unit: str, mode: str) -> None:
    points = cloud(1)
    largest = LARGEST.get(unit, 65535.0)
    points[..., 40:, 3] = torch.logspace(-6.0, torch.tensor(largest).log10(), points.shape[-2] - 40)
    points[..., 1::2, 3] = points[..., 1::2, 3].floor()
    transform = LidarWeather(EVERYTHING, replace(LIDAR, intensity_unit=unit, return_mode=mode))
    for dtype in (torch.float32, torch.float64):
        result = transform.run(points.to(dtype), transform.draw(points, seed=1), directions=rays(1))
        assert torch.isfinite(result.points).all(), unit
        if result.second is not None:
            assert torch.isfinite(result.second).all(), unit


@pytest.mark.parametrize("clutter", [False, True])
def test_a_list_is_finite_at_every_power(clutter: bool) -> None:
    points = detections(1)
    points[..., 4] = torch.linspace(-400.0, 400.0, points.shape[-2])
    points[..., 5] = torch.linspace(200.0, -200.0, points.shape[-2])
    transform = RadarAttenuation(EVERYTHING, RADAR, clutter=clutter)
    with torch.no_grad():
        assert torch.isfinite(transform(points, transform.draw(points, seed=1))).all()


@pytest.mark.parametrize("name", [name for name in TABLE if name.startswith(("Bayer", "AsBayer"))])
@pytest.mark.parametrize("level", [0.0, 1.0])
def test_a_frame_is_finite_at_every_level(name: str, level: float) -> None:
    entry = TABLE[name]
    data = (image if name.startswith("As") else frame)(1)
    data = data / 0.6 * level
    data[..., ::3] = 0.0
    out = entry.built()(data, noise=entry.built().draw(data, seed=1), **entry.beside(1))
    assert torch.isfinite(out).all()
