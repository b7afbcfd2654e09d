"""Distributions of a parameter: their laws, their plain form, and weathers that are drawn from them."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import yaml

import torchweather as tw
from torchweather.atmosphere.weather import parse_weather, weather_from_dict
from torchweather.core.distributions import Choice, Distribution, LogUniform, Uniform, distribution_from

EACH = [Uniform(1, 50), LogUniform(0.5, 20), Choice([10, 25, 50]), Choice([1.0, 2.0], weights=[3, 1])]


@pytest.mark.parametrize("one", EACH, ids=repr)
def test_the_plain_form_goes_through_yaml_and_back(one: Distribution) -> None:
    assert distribution_from(yaml.safe_load(yaml.safe_dump(one.to_dict())), owner="x") == one


def test_shares_of_the_probability_become_values() -> None:
    u = np.linspace(0, 1, 1001, endpoint=False)
    assert [Uniform(2, 6).at(value) for value in (0.0, 0.25, 0.5)] == [2.0, 3.0, 4.0]
    logs = np.log([LogUniform(1, 100).at(float(value)) for value in u])
    np.testing.assert_allclose(np.diff(logs), math.log(100) / 1001, rtol=1e-6)
    chosen = [Choice(["a", "b", "c"], weights=[1, 0, 3]).at(float(value)) for value in u]
    assert (chosen.count("a"), chosen.count("b")) == (251, 0)
    assert Choice([1, 2], weights=[1, 0]).at(math.nextafter(1.0, 0.0)) == 1


def test_a_pair_is_uniform_and_every_number_of_a_weather_may_be_drawn() -> None:
    assert tw.Rain(rate_mm_per_h=(1, 50)) == tw.Rain(rate_mm_per_h=Uniform(1, 50))
    snow = tw.Snow(rate_mm_per_h=Choice([1, 2]), temperature_c=Uniform(-10, 0), melt_fraction=Uniform(0, 0.3))
    drawn = snow.drawn(3)
    assert drawn.rate_mm_per_h in (1, 2)
    assert -10 <= drawn.temperature_c <= 0 <= drawn.melt_fraction <= 0.3
    assert not drawn.random
    assert snow.drawn(3) == drawn != snow.drawn(4)


def test_fields_and_parts_have_streams_of_their_own() -> None:
    both = tw.Snow(rate_mm_per_h=(0.1, 1), melt_fraction=Uniform(0, 1))
    shares = np.array([[(one.rate_mm_per_h - 0.1) / 0.9, one.melt_fraction] for one in map(both.drawn, range(400))])
    assert abs(np.corrcoef(shares.T)[0, 1]) < 4 / math.sqrt(400)
    alone = tw.Rain((1, 50)).drawn(9)
    assert tw.Mixture(tw.Rain((1, 50)), tw.Fog(mor_m=(50, 400))).drawn(9).parts[1] == alone


def test_a_random_weather_goes_through_its_plain_form() -> None:
    weather = tw.Mixture(tw.Rain(rate_mm_per_h=LogUniform(1, 50)), tw.Fog(mor_m=(50, 400)))
    assert weather_from_dict(yaml.safe_load(yaml.safe_dump(weather.to_dict()))) == weather
    assert set(weather.random) == {"rain.rate_mm_per_h", "fog.mor_m"}
    densest = weather.densest()
    assert (densest.parts[0].mor_m, densest.parts[1].rate_mm_per_h) == (50.0, 50.0)


def test_the_command_line_knows_ranges_where_they_are_wanted() -> None:
    assert parse_weather("rain:rate=1..50+fog:mor=100", random=True).parts[1] == tw.Rain(rate_mm_per_h=(1, 50))
    with pytest.raises(ValueError, match=r"weather 'rain:rate=1..50': rate_mm_per_h must be a number here"):
        parse_weather("rain:rate=1..50")


@pytest.mark.parametrize(
    ("make", "match"),
    [
        (lambda: Uniform(5, 5), "low must be below high; got 5, 5"),
        (lambda: Uniform(0, math.inf), "finite numbers"),
        (lambda: LogUniform(0, 5), "low must be above 0; got 0. Uniform takes 0"),
        (lambda: Choice([]), "one or more"),
        (lambda: Choice([1, 2], weights=[1]), "a weight of 0 or more for each of 2 values"),
        (lambda: distribution_from({"unifrom": [1, 2]}, owner="rate"), "rate: expected a number.*uniform"),
        (lambda: distribution_from({"uniform": [1]}, owner="rate"), r"rate: uniform must be \[low, high\]"),
        (lambda: distribution_from({"uniform": [1, 2], "weights": [1]}, owner="rate"), "choice also with weights"),
        (lambda: tw.Rain(rate_mm_per_h=(-1, 5)), "rate_mm_per_h must lie .*mm/h.*got -1"),
        (lambda: tw.Rain(rate_mm_per_h=(1, 2, 3)), r"a pair \(low, high\)"),
        (lambda: tw.Fog(mor_m=(0, 50)), "mor_m must be.* above 0"),
        (lambda: tw.Snow(rate_mm_per_h=1.0, melt_fraction=Uniform(0, 1.5)), "melt_fraction must lie"),
        (lambda: tw.Rain(rate_mm_per_h=(1, 5)).intensity, "has yet|must be a number here"),
        (lambda: tw.Rain(rate_mm_per_h=(1, 5)).distribution(), "must be a number here"),
    ],
)
def test_what_cannot_be_drawn_is_refused(make: Callable[[], Any], match: str) -> None:
    with pytest.raises(ValueError, match=match):
        make()
