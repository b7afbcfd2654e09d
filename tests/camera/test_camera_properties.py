"""What holds for any weather, scene and depth: energy, bounds, order."""

from __future__ import annotations

import math
from typing import Any

import torch
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from torch import Tensor

from torchweather.atmosphere.weather import Fog, Mixture, Rain, Snow, Weather
from torchweather.sensors import BAYER_PATTERNS, Camera
from torchweather.transforms import BayerWeather

H, W = 12, 16
few = settings(max_examples=25, deadline=None, derandomize=True, suppress_health_check=[HealthCheck.too_slow])

rates = st.one_of(st.just(0.0), st.floats(0.1, 200.0))
snow_rates = st.one_of(st.just(0.0), st.floats(0.05, 10.0))
visibilities = st.one_of(st.just(math.inf), st.floats(6.0, 20000.0))
depths = st.one_of(st.just(math.inf), st.floats(0.01, 500.0))
shares = st.floats(0.0, 1.0, width=32)
seeds = st.integers(0, 2**32 - 1)


@st.composite
def weathers(draw: Any) -> Weather:
    return Mixture(Rain(draw(rates)), Snow(draw(snow_rates)), Fog(draw(visibilities)))


def camera_of(pattern: str = "RGGB") -> Camera:
    return Camera.from_intrinsics(200.0, 200.0, 7.5, 5.5, W, H, bayer_pattern=pattern)


def scene_of(seed: int, low: float, high: float) -> Tensor:
    values = torch.rand((1, H, W), generator=torch.Generator().manual_seed(seed))
    return min(low, high) + abs(high - low) * values


@few
@given(
    weather=weathers(),
    depth_m=depths,
    low=shares,
    high=shares,
    sky=shares,
    seed=seeds,
    pattern=st.sampled_from(BAYER_PATTERNS),
)
def test_light_is_mixed_and_never_made(
    weather: Weather, depth_m: float, low: float, high: float, sky: float, seed: int, pattern: str
) -> None:
    """Every pixel lies between the darkest and the brightest of scene, airlight and particles."""
    scene = scene_of(seed, low, high)
    transform = BayerWeather(weather, camera_of(pattern), depth=depth_m, airlight=sky, far_m=50.0)
    result = transform.run(scene, noise=transform.draw(scene, seed=seed))
    # Half of a flake's light is the ground's: the frame's below the horizon, or a tenth of the sky's.
    dark, bright = float(scene.min()), float(scene.max())
    flake = 0.45 * (sky + min(dark, 0.1 * sky)), 0.45 * (sky + max(bright, 0.1 * sky))
    drop = 0.94 * dark, 0.94 * max(bright, sky) + 0.06 * sky
    darkest, brightest = min(dark, sky, flake[0], drop[0]), max(bright, sky, flake[1], drop[1])
    assert bool(torch.isfinite(result.bayer).all())
    assert float(result.bayer.min()) >= darkest - 1e-6
    assert float(result.bayer.max()) <= brightest + 1e-6
    for share in (result.particle_mask, result.transmission):
        assert float(share.min()) >= 0.0
        assert float(share.max()) <= 1.0


@few
@given(mor_m=st.floats(6.0, 5000.0), factor=st.floats(1.01, 10.0), depth_m=depths, sky=shares)
def test_more_fog_never_raises_contrast(mor_m: float, factor: float, depth_m: float, sky: float) -> None:
    dark, bright = torch.full((1, H, W), 0.1), torch.full((1, H, W), 0.6)

    def contrast(visibility_m: float) -> Tensor:
        fog = BayerWeather(Fog(visibility_m), camera_of(), depth=depth_m, airlight=sky)
        return fog(bright) - fog(dark)

    assert bool((contrast(mor_m) <= contrast(mor_m * factor) + 1e-6).all())


@few
@given(rate=st.floats(0.2, 60.0), factor=st.floats(1.02, 3.0), seed=seeds, depth_m=st.floats(2.0, 100.0))
def test_more_rain_never_covers_less(rate: float, factor: float, seed: int, depth_m: float) -> None:
    scene = torch.full((1, H, W), 0.2)
    means = []
    for mm_per_h in (rate, rate * factor):
        transform = BayerWeather(Rain(mm_per_h), camera_of(), depth=depth_m, airlight=0.7, rate_capacity_mm_per_h=200.0)
        means.append(float(transform.run(scene, noise=transform.draw(scene, seed=seed)).particle_mask.double().mean()))
    assert means[1] >= means[0]


@few
@given(rate=st.floats(1.0, 100.0), seed=seeds, near_m=st.floats(1.0, 40.0), farther=st.floats(1.0, 5.0))
def test_a_farther_wall_never_hides_more(rate: float, seed: int, near_m: float, farther: float) -> None:
    """In the mean over the frame; the haze is a random field at each depth."""
    scene = torch.full((1, H, W), 0.2)
    transform = BayerWeather(Rain(rate), camera_of(), airlight=0.7)
    noise = transform.draw(scene, seed=seed)
    near, far = (
        transform.run(scene, torch.full((1, H, W), depth), noise).particle_mask.mean()
        for depth in (near_m, near_m * farther)
    )
    assert float(far) >= float(near) * (1 - 1e-5)


@few
@given(
    seed=st.integers(0, 2**63 - 1),
    position=st.integers(0, 3),
    rate=st.floats(0.5, 50.0),
)
def test_a_sample_does_not_depend_on_its_batch(seed: int, position: int, rate: float) -> None:
    scene = torch.full((4, 1, H, W), 0.3)
    transform = BayerWeather(Rain(rate), camera_of(), depth=20.0, airlight=0.7)
    own = torch.arange(4) * 1000 + 17
    own[position] = seed
    together = transform(scene, noise=transform.draw(scene, seed=own))
    alone = transform(scene[0], noise=transform.draw(scene[0], seed=seed))
    assert torch.equal(together[position], alone)
