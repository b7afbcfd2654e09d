"""Frames and modules in double precision, over all camera transforms."""

from __future__ import annotations

import copy
import math

import pytest
import torch

from tests.contract.test_camera_contract import CAMERA, IDENTITIES, Maker, every_transform, frame
from torchweather.atmosphere.weather import Weather
from torchweather.transforms import BayerWeather

DOUBLE = torch.float64


@every_transform
@pytest.mark.parametrize("batch", [(), (2,), (2, 3)], ids=str)
def test_double_frames_see_the_weather_of_single_ones(make: Maker, batch: tuple[int, ...]) -> None:
    transform, given = make(), frame(*batch, dtype=DOUBLE)
    noise = transform.draw(given, seed=1)
    got = transform(given, noise=noise)
    assert got.dtype == DOUBLE
    assert got.shape == given.shape
    # Coefficients and particles are float32.
    assert torch.allclose(got.float(), transform(given.float(), noise=noise), atol=2e-5)


@pytest.mark.parametrize("weather", IDENTITIES.values(), ids=IDENTITIES.keys())
@pytest.mark.parametrize("depth_m", [7.0, math.inf])
def test_no_weather_gives_double_frames_back_bit_for_bit(weather: Weather, depth_m: float) -> None:
    given = frame(2, dtype=DOUBLE)
    assert torch.equal(BayerWeather(weather, CAMERA, depth=depth_m, airlight=0.7)(given), given)


@every_transform
def test_a_module_can_be_moved_to_double_precision(make: Maker) -> None:
    transform, given = make(), frame(2)
    noise = transform.draw(given, seed=1)
    wanted = transform(given, noise=noise)
    moved = copy.deepcopy(transform).to(DOUBLE)
    for frames in (given, given.double()):
        # The same float32 tables, in double arithmetic.
        assert torch.allclose(moved(frames, noise=noise).float(), wanted, atol=2e-5)
