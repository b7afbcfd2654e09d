"""Several exposures merged into one frame: each pixel against a merge pixel by pixel, streaks against their length."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from torchweather.atmosphere.weather import Fog, Mixture, Rain
from torchweather.camera.hdr import HdrWeather
from torchweather.core.random import derived_seed
from torchweather.sensors import Camera
from torchweather.transforms import BayerWeather

CAMERA = Camera.from_intrinsics(400.0, 400.0, 79.5, 59.5, 160, 120)
TIMES_S = (0.016, 0.004, 0.001)
OPTIONS: dict[str, Any] = {"depth": 40.0, "airlight": 0.02}


def scene() -> Tensor:
    """Dark, middle and bright stripes, 1 at the saturation of the shortest exposure."""
    frame = torch.full((1, 120, 160), 0.01)
    frame[..., 56:112] = 0.1
    frame[..., 112:] = 0.6
    return frame


def hdr(**more: Any) -> HdrWeather:
    return HdrWeather(Rain(60.0), CAMERA, exposures_s=TIMES_S, **{**OPTIONS, **more})


def test_each_pixel_is_from_the_longest_exposure_that_is_not_saturated() -> None:
    found = hdr().run(scene(), seed=4)
    # One exposure after another by a transform of its own, and one pixel after another.
    frames = []
    for number, time in enumerate(TIMES_S):
        own = BayerWeather(
            Rain(60.0), Camera.from_intrinsics(400.0, 400.0, 79.5, 59.5, 160, 120, exposure_s=time), **OPTIONS
        )
        frames.append(own(scene(), seed=derived_seed(4, f"exposure{number}")).numpy())
    full = [TIMES_S[-1] / time for time in TIMES_S]
    merged, exposure = np.zeros_like(frames[0]), np.zeros(frames[0].shape, np.int64)
    for place in np.ndindex(*merged.shape):
        number = next((k for k in (0, 1) if frames[k][place] < 0.95 * full[k]), 2)
        merged[place], exposure[place] = frames[number][place], number
    assert np.array_equal(found.bayer.numpy(), merged)
    assert np.array_equal(found.exposure.numpy(), exposure)
    shares = [float((found.exposure[..., 4 + 56 * k : 52 + 56 * k] == k).float().mean()) for k in range(2)]
    assert min(shares) > 0.9
    assert float((found.exposure[..., 112:] == 2).float().mean()) > 0.99


def streak_px(difference: Tensor) -> float:
    """Mean length of what stands in a column without a gap, pixels."""
    marked = torch.nn.functional.pad((difference.abs() > 1e-3 * difference.abs().max()).int(), (0, 0, 1, 1))
    runs = int((marked.diff(dim=-2) == 1).sum())
    return float(marked.sum()) / runs


def test_streaks_are_as_long_as_the_exposure_of_their_pixel() -> None:
    """Drops within 2 to 4 m of 400 px: a fall of 4 to 9 m/s is 10 to 30 px in 16 ms, 0.6 to 2 px in 1 ms."""
    near = {"near_m": 2.0, "far_m": 4.0, "airlight": 0.4}
    dark, bright = torch.full((1, 120, 160), 0.01), torch.full((1, 120, 160), 0.6)
    transform = hdr(**near)
    lengths = []
    for frame, wanted in ((dark, 0), (bright, 2)):
        found = transform.run(frame, seed=9)
        assert float((found.exposure == wanted).float().mean()) > 0.8
        own = torch.where(found.exposure == wanted, found.bayer - frame, 0.0)
        lengths.append(streak_px(own[0]))
    assert lengths[0] > 3.0 * lengths[1]


def test_fog_alone_is_the_same_in_all_exposures() -> None:
    transform = HdrWeather(Fog(60.0), CAMERA, exposures_s=(0.01, 0.001), **OPTIONS)
    found = transform.run(scene(), seed=1)
    assert torch.equal(found.frames[0], found.frames[1])
    assert torch.equal(found.bayer, BayerWeather(Fog(60.0), CAMERA, **OPTIONS)(scene()))


def test_no_weather_gives_the_frame_back() -> None:
    still = HdrWeather(Mixture(Rain(0.0), Fog(float("inf"))), CAMERA, exposures_s=TIMES_S, **OPTIONS)
    assert torch.equal(still(scene(), seed=1), scene())


def test_the_same_noise_gives_the_same_frame_and_batches_their_own() -> None:
    transform, batch = hdr(), torch.stack([scene(), scene()])
    noise = transform.draw(batch, seed=3)
    assert torch.equal(transform(batch, noise=noise), transform(batch, seed=3))
    assert torch.equal(transform(batch, seed=3)[1], transform(scene(), seed=4))
    assert not torch.equal(transform(batch, seed=3)[0], transform(batch, seed=3)[1])


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: HdrWeather(Rain(1.0), CAMERA, exposures_s=(0.01,)), "two or more different times"),
        (lambda: HdrWeather(Rain(1.0), CAMERA, exposures_s=(0.01, 0.01)), "two or more different times"),
        (lambda: HdrWeather(Rain(1.0), CAMERA, exposures_s=(0.01, -1.0)), "exposure_s"),
        (lambda: hdr(saturation=0.0), "saturation must lie in 0.1..1; got 0"),
        (lambda: hdr(exposure_control="mean"), "exposure_control is of one exposure"),
        (lambda: hdr()(torch.zeros(1, 120, 160, dtype=torch.uint8)), "expected a linear floating-point frame"),
        (lambda: hdr()(scene(), noise={}, seed=1), "either noise or seed"),
    ],
)
def test_bad_input_is_refused(call: Any, message: str) -> None:
    with pytest.raises((ValueError, TypeError), match=message):
        call()
