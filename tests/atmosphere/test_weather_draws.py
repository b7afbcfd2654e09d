"""Weather drawn from laws: each part from its own stream, and the densest that a law allows."""

from __future__ import annotations

import math

import pytest

from torchweather import Fog, Mixture, Rain, Snow
from torchweather.core.distributions import LogUniform, Uniform


def test_parts_of_a_mixture_are_drawn_apart() -> None:
    """Rain and snow with the same law of the rate would otherwise always fall together."""
    law = Uniform(1.0, 2.0)
    rates = [[part.intensity for part in Mixture(Rain(law), Snow(law)).drawn(seed).parts] for seed in range(20)]
    assert all(rain != snow for rain, snow in rates)
    assert Rain(law).drawn(3) == Rain(law).drawn(3)


@pytest.mark.parametrize(
    ("weather", "densest"),
    [
        (Rain(LogUniform(1.0, 50.0)), 50.0),
        (Snow(Uniform(0.5, 3.0)), 3.0),
        (Fog(mor_m=LogUniform(50.0, 1000.0)), 50.0),
    ],
)
def test_the_densest_weather_of_a_law(weather: Rain | Snow | Fog, densest: float) -> None:
    assert math.isclose(float(weather.densest().intensity), densest)
