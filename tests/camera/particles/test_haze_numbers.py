"""White noise of the haze by keys: the rows that a frame takes are those of the whole draw, the others are left out."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

from torchweather.atmosphere.weather import Rain
from torchweather.camera.particles.haze import haze_depth
from torchweather.camera.particles.haze_numbers import numbers_of_keys
from torchweather.camera.particles.population import Population
from torchweather.camera.state import CameraState
from torchweather.core.random import normals_of_key
from torchweather.sensors import Camera
from torchweather.transforms import BayerRain

HEIGHT, WIDTH = 90, 64
KEY = torch.tensor([[7, 9]])


def street(wind: float) -> tuple[Population, CameraState]:
    """A population, and a frame whose lower part is near, with a far pixel in its last rows but one."""
    camera = Camera.from_intrinsics(60.0, 60.0, (WIDTH - 1) / 2, (HEIGHT - 1) / 2, WIDTH, HEIGHT, exposure_s=0.01)
    transform = BayerRain(Rain(20.0, wind_m_per_s=(0.0, -wind, 0.0)), camera, airlight=0.5)
    depth_m = torch.full((1, HEIGHT, WIDTH), torch.inf)
    depth_m[:, 20:] = 0.8
    depth_m[:, 70, 3] = 4.0
    state = transform.state_of(torch.full((1, HEIGHT, WIDTH), 0.2), depth_m)
    return transform.chain.stages["particle_veil"].parts[0], state  # type: ignore[union-attr, index, return-value]


@pytest.mark.parametrize("wind", [0.0, 3.0, 60.0])  # upright, leaning, nearly along the rows
def test_a_frame_takes_the_same_haze_of_some_rows_as_of_all(wind: float) -> None:
    population, state = street(wind)
    tables = population.at_rate(1)
    shape = (len(population.haze_shells), HEIGHT, WIDTH)
    whole = torch.from_numpy(normals_of_key(KEY[0].numpy().view("uint64"), shape))[None]
    some = numbers_of_keys(KEY, population, state, tables)
    drawn = (some != 0).any(-1)
    assert torch.equal(some, torch.where(drawn[..., None], whole, 0.0))
    assert bool(drawn[0, 0].all())
    assert not bool(drawn[0, -1].all())
    assert bool(drawn[0, -1, -1])  # beside row 0 of an image that repeats

    def haze(numbers: Tensor) -> Tensor:
        return haze_depth(population, state, {"rain_haze": numbers}, tables, 0, HEIGHT)[0]

    assert torch.equal(haze(some), haze(whole))


def test_a_shell_behind_the_whole_band_is_left_out() -> None:
    """The rows of a band alone decide which shells it has; its haze is that of the whole frame."""
    population, state = street(0.0)
    tables = population.at_rate(1)
    noise = {"rain_haze": numbers_of_keys(KEY, population, state, tables)}
    whole = haze_depth(population, state, noise, tables, 0, HEIGHT)[0]
    for first, last in ((0, 20), (20, 60), (60, HEIGHT)):
        band = haze_depth(population, state, noise, tables, first, last)[0]
        assert torch.equal(band, whole[..., first:last, :])
