"""Draws as far as a rate needs them: the same storm, fewer numbers; nothing at rate 0."""

from __future__ import annotations

import pytest
import torch

from torchweather.atmosphere.weather import Mixture, Rain, Snow, Weather
from torchweather.sensors import Camera
from torchweather.transforms import AsBayer, BayerRain, BayerWeather

CAMERA = Camera.from_intrinsics(100.0, 100.0, 31.5, 20.0, 64, 48)
FRAME = torch.rand(1, 48, 64, generator=torch.Generator().manual_seed(1)) * 0.6


def transform_of(weather: Weather, camera: Camera = CAMERA) -> BayerWeather:
    return BayerWeather(weather, camera, depth=40.0, airlight=0.7)


@pytest.mark.parametrize(
    "weather", [Rain(1.0), Rain(60.0), Snow(0.5), Mixture(Rain(3.0), Snow(1.0))], ids=["1", "60", "snow", "both"]
)
def test_a_call_draws_the_first_part_of_the_storm(weather: Weather) -> None:
    transform = transform_of(weather)
    whole, part = transform.draw(FRAME, seed=4), transform.draw(FRAME, seed=4, at_rate=True)
    for key, value in part.items():
        assert torch.equal(whole[key][: len(value)], value)
    held = [sum(len(value) for key, value in noise.items() if "shell" in key) for noise in (whole, part)]
    assert held[1] < held[0]
    wanted = transform(FRAME, noise=whole)
    assert torch.equal(transform(FRAME, noise=part), wanted)
    assert torch.equal(transform(FRAME, seed=4), wanted)


def test_noise_of_a_lower_rate_is_refused() -> None:
    noise = transform_of(Rain(1.0)).draw(FRAME, seed=4, at_rate=True)
    transform_of(Rain(0.5))(FRAME, noise=noise)
    with pytest.raises(
        ValueError, match=r"noise 'rain_shell_\d' was drawn for a lower rate; it holds \d+ of \d+ point"
    ):
        transform_of(Rain(30.0))(FRAME, noise=noise)


def test_a_distorting_lens_or_air_of_its_own_gets_every_point() -> None:
    bent = Camera.from_intrinsics(100.0, 100.0, 31.5, 20.0, 64, 48, k1=-0.2)
    for transform in (
        transform_of(Rain(1.0), bent),
        BayerWeather(Rain(1.0, patch_log_std=0.5), CAMERA, depth=40.0, airlight=0.7),
    ):
        whole, part = (transform.draw(FRAME, seed=4, at_rate=at_rate) for at_rate in (False, True))
        assert all(torch.equal(value, whole[key]) for key, value in part.items())


def test_samples_at_rate_0_stay_as_they_are_beside_others() -> None:
    rates = torch.tensor([0.0, 20.0, 0.0, 5.0])
    frames = torch.stack([FRAME, 0.5 * FRAME, 0.3 * FRAME, FRAME])
    out = BayerRain(Rain(rates), CAMERA, depth=40.0, airlight=0.7)(frames, seed=9)
    for row, rate in enumerate(rates.tolist()):
        alone = BayerRain(Rain(rate), CAMERA, depth=40.0, airlight=0.7)(frames[row], seed=9 + row)
        assert torch.equal(out[row], alone)
        assert torch.equal(out[row], frames[row]) == (rate == 0.0)


def test_nothing_is_drawn_at_rate_0() -> None:
    transform = transform_of(Rain(0.0))
    noise = transform.draw(FRAME, seed=1, at_rate=True)
    assert all(not bool(value.any()) for value in noise.values())
    assert torch.equal(transform(FRAME, seed=1), FRAME)
    rgb = torch.randint(0, 256, (3, 48, 64), dtype=torch.uint8)
    assert torch.equal(AsBayer(transform)(rgb, seed=1), rgb)
    assert float(transform.run(FRAME, seed=1).particle_mask.max()) == 0.0
