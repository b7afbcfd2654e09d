"""The haze of a graph, two convolutions, against sums of maps shifted tap by tap."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch

from torchweather.atmosphere.weather import Rain, Snow
from torchweather.camera.particles.haze import _streaky
from torchweather.camera.particles.haze_convolution import streaky_maps
from torchweather.camera.particles.population import Population, trimmed
from torchweather.camera.particles.veil import ParticleVeil
from torchweather.sensors import Camera

WEATHERS = {
    "fall straight": (Rain(30.0), {}),
    "lean": (Rain(30.0, wind_m_per_s=(0.0, 3.0, 0.0)), {}),
    "lean the other way": (Snow(2.0, wind_m_per_s=(0.0, -0.6, 0.0)), {}),
    "run aside": (Snow(2.0, wind_m_per_s=(0.0, 4.0, 0.0)), {}),
    "long exposure": (Rain(30.0), {"exposure_s": 0.02}),
}


def population_of(name: str) -> Population:
    weather, more = WEATHERS[name]
    camera = Camera.from_intrinsics(400.0, 400.0, 19.5, 15.5, 40, 32, **more)
    return ParticleVeil([weather], camera).parts[0]


@pytest.mark.parametrize("size", [(32, 40), (35, 7), (3, 61)])
@pytest.mark.parametrize("name", WEATHERS)
def test_two_convolutions_give_the_sums_of_shifted_maps(name: str, size: tuple[int, int]) -> None:
    population = population_of(name)
    tables = population.at_rate(1)
    shells = len(population.haze_shells)
    white = torch.randn(1, shells, *size, generator=torch.Generator().manual_seed(3))
    along = trimmed(tables.kernel_along, population.taps_along)
    across = trimmed(tables.kernel_across, population.taps_across)
    maps = streaky_maps(white, replace(tables, kernel_along=along, kernel_across=across), population)
    wanted = [_streaky(white, tables, 0, size[0], population, number) for number in range(shells)]
    # Sums of some hundred products in another order.
    torch.testing.assert_close(maps, torch.cat(wanted, 1), rtol=1e-5, atol=1e-5)
    assert float(maps.std()) > 0.3


def test_the_weathers_lean_to_both_sides_and_run_aside() -> None:
    found = [population_of(name) for name in WEATHERS]
    assert [one.haze_steep for one in found] == [True, True, True, False, True]
    assert found[0].haze_slope == 0.0
    assert found[1].haze_slope * found[2].haze_slope < 0
    assert max(found[4].taps_along) > max(found[0].taps_along)
