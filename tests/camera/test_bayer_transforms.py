"""Raw frames in weather: what a result holds, patterns, lenses, companded levels, and gradients in light."""

from __future__ import annotations

import math

import pytest
import torch

from tests.contract.table import CAMERA, IMAGES, LIGHT, SEEN, TABLE, TILTED, H, W, frame, same_bits
from torchweather.atmosphere.weather import Fog, Mixture, Rain, Snow, Weather
from torchweather.core.errors import TorchweatherWarning
from torchweather.sensors import BAYER_PATTERNS, Camera
from torchweather.transforms import BayerWeather

MOSAICS = [name for name in TABLE if name.startswith("Bayer")]
each = pytest.mark.parametrize("name", MOSAICS)


@each
def test_a_result_holds_what_the_weather_did(name: str) -> None:
    given, weather = frame(2, 3), TABLE[name].weather(TABLE[name].intensities[0])
    result = TABLE[name].built().run(given, seed=1)
    assert result.transmission.shape == result.particle_mask.shape == given.shape
    assert torch.allclose(result.airlight, torch.tensor(LIGHT).expand(2, 3, 3))
    for share in (result.transmission, result.particle_mask):
        assert float(share.min()) >= 0.0
        assert float(share.max()) <= 1.0
    kinds = {part.kind for part in weather.parts}
    assert bool((result.particle_mask > 0).any()) == bool(kinds & {"rain", "snow"})
    assert bool((result.transmission < 1).any()) == ("fog" in kinds)


@each
def test_a_batch_through_a_tilted_lens_equals_its_frames(name: str) -> None:
    transform, given = TABLE[name].built(sensor=TILTED), frame(2)
    together = transform(given, seed=10)
    for row in range(2):
        assert torch.equal(together[row], transform(given[row], seed=10 + row))


@each
def test_the_smallest_mosaic_is_one_cell_and_every_pattern_is_taken(name: str) -> None:
    cell = Camera.from_intrinsics(300.0, 300.0, 0.5, 0.5, 2, 2)
    given = torch.full((1, 2, 2), 0.2)
    assert TABLE[name].built(sensor=cell)(given).shape == (1, 2, 2)
    with pytest.warns(TorchweatherWarning, match="no sky"):
        TABLE[name].built(sensor=cell, airlight=None)(given)
    for pattern in BAYER_PATTERNS:
        camera = Camera.from_intrinsics(300.0, 300.0, 15.5, 11.5, W, H, bayer_pattern=pattern)
        assert TABLE[name].built(sensor=camera)(frame()).shape == (1, H, W)


@pytest.mark.parametrize("weather", [Mixture(Rain(0.0), Snow(0.0), Fog(math.inf)), Fog(math.inf)], ids=["all", "fog"])
@pytest.mark.parametrize("dtype", IMAGES, ids=str)
@pytest.mark.parametrize("depth_m", [7.0, math.inf])
@pytest.mark.parametrize("knots", [None, ((0.0, 0.0), (0.25, 0.5), (1.0, 1.0))], ids=["linear", "companded"])
def test_no_weather_changes_no_bit_at_any_depth_and_level(
    weather: Weather, dtype: torch.dtype, depth_m: float, knots: tuple[tuple[float, float], ...] | None
) -> None:
    levels = {"black_level": 64.0, "white_level": 4000.0, "response_knots": knots}
    camera = Camera.from_intrinsics(300.0, 300.0, 15.5, 11.5, W, H, **levels)
    given = frame(2, dtype=dtype)
    result = BayerWeather(weather, camera, depth=depth_m, airlight=0.7).run(given)
    assert same_bits(result.bayer, given)
    assert bool((result.particle_mask == 0).all())
    assert bool((result.transmission == 1).all())


@pytest.mark.parametrize(
    ("name", "value", "sign"),
    [("BayerRain", 20.0, 1), ("BayerSnow", 1.0, 1), ("BayerFog", 50.0, -1), ("BayerWeather", 50.0, -1)],
)
def test_over_a_dark_scene_under_a_bright_sky_more_weather_is_brighter(name: str, value: float, sign: int) -> None:
    rate = torch.full((2,), value, requires_grad=True)
    TABLE[name].built(rate)(0.1 * frame(2), seed=1).mean().backward()
    assert rate.grad is not None
    assert bool(torch.isfinite(rate.grad).all())
    assert bool((rate.grad * sign > 0).all())


def test_the_gradient_reaches_every_pixel_of_the_frame() -> None:
    given = frame(1).requires_grad_()
    TABLE["BayerWeather"].built().run(given, seed=1).bayer.sum().backward()
    assert given.grad is not None
    assert bool(torch.isfinite(given.grad).all())
    assert bool((given.grad > 0).all())


def test_the_classes_of_one_weather_are_those_of_all() -> None:
    given = frame(2)
    for name in MOSAICS[:3]:
        weather = TABLE[name].weather(TABLE[name].intensities[0])
        assert torch.equal(BayerWeather(weather, CAMERA, **SEEN)(given, seed=1), TABLE[name].built()(given, seed=1))
