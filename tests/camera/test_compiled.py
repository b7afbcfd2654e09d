"""Camera transforms under torch.compile: batches of rain and snow give what they give without it."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
import torch
from torch import Tensor

import torchweather as tw
from torchweather.camera.rgb import AsBayer

# torch's own, and for this release of Python alone.
pytestmark = pytest.mark.filterwarnings("ignore:Guards may run slower on Python 3.13.0:RuntimeWarning")

CAMERA = tw.Camera.from_intrinsics(fx=60.0, fy=60.0, cx=23.5, cy=15.5, width=48, height=32)
WEATHERS = {
    "rain": tw.Rain(25),
    "snow": tw.Snow(2),
    "fog": tw.Fog(mor_m=60),
    "sleet in fog": tw.Mixture(tw.Fog(mor_m=200), tw.Rain(10), tw.Snow(1)),
}


@pytest.fixture(autouse=True)
def _fresh_compiler() -> Iterator[None]:
    torch.compiler.reset()
    yield
    torch.compiler.reset()


def _frames(batch: int) -> tuple[Tensor, Tensor]:
    generator = torch.Generator().manual_seed(3)
    frames = torch.rand(batch, 1, 32, 48, generator=generator)
    return frames, 5 + 60 * torch.rand(batch, 1, 32, 48, generator=generator)


def _agree(compiled: Tensor, eager: Tensor) -> None:
    assert compiled.shape == eager.shape
    assert float((compiled.double() - eager.double()).abs().max()) < 1e-6


def _check(backend: str, name: str, batches: tuple[int, ...]) -> None:
    transform = tw.BayerWeather(WEATHERS[name], CAMERA, airlight=0.7)
    compiled = torch.compile(transform, backend=backend)
    for batch in batches:
        frames, depth = _frames(batch)
        noise = transform.draw(frames, seed=1)
        _agree(compiled(frames, depth, noise), transform(frames, depth, noise))


def test_a_batch() -> None:
    _check("eager", "sleet in fog", (2,))


@pytest.mark.long
@pytest.mark.parametrize("name", WEATHERS)
@pytest.mark.parametrize("backend", ["eager", "aot_eager", "inductor"])
def test_batches_on_backends(backend: str, name: str) -> None:
    _check(backend, name, (2, 3, 1))


@pytest.mark.long
def test_a_rate_for_each_sample_draws_and_pictures() -> None:
    frames, depth = _frames(3)
    rain = tw.BayerRain(tw.Rain(torch.tensor([0.0, 5.0, 40.0])), CAMERA, airlight=0.7)
    _agree(torch.compile(rain, backend="eager")(frames, depth, seed=4), rain(frames, depth, seed=4))
    pictures = AsBayer(tw.BayerSnow(tw.Snow(2), CAMERA, airlight=0.7))
    colour = frames.expand(-1, 3, -1, -1)
    noise = pictures.draw(colour, seed=2)
    _agree(torch.compile(pictures, backend="eager")(colour, depth, noise), pictures(colour, depth, noise))
