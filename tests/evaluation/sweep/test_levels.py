"""Levels of a weather from text: every value, lightest first, everything else as ``parse_weather`` takes it."""

from __future__ import annotations

import pytest

from torchweather.atmosphere.weather import Fog, Mixture, Rain, Snow
from torchweather.evaluation.sweep import parse_levels


def test_rates_rise_and_visibilities_fall() -> None:
    rain, fog = parse_levels("rain:rate=25,1,5"), parse_levels("fog:mor=30,400,100")
    assert [(level.severity, level.weather) for level in rain] == [(1, Rain(1.0)), (2, Rain(5.0)), (3, Rain(25.0))]
    assert [level.weather for level in fog] == [Fog(mor_m=mor) for mor in (400.0, 100.0, 30.0)]
    assert [level.value for level in fog] == [400.0, 100.0, 30.0]
    assert {(level.name, level.knob, level.unit) for level in fog} == {("fog", "mor_m", "m")}
    assert rain[2].text == "Rain 25 mm/h"


def test_other_arguments_hold_for_every_level() -> None:
    levels = parse_levels("snow:temperature_c=-3,rate=0.5,2,size_distribution=gunn-marshall")
    assert [level.weather for level in levels] == [
        Snow(rate, size_distribution="gunn-marshall", temperature_c=-3.0) for rate in (0.5, 2.0)
    ]
    assert {level.name for level in levels} == {"snow:temperature_c=-3,size_distribution=gunn-marshall"}


def test_one_part_of_a_mixture_varies() -> None:
    levels = parse_levels("rain:rate=10,5 + fog:mor=200")
    assert [level.weather for level in levels] == [Mixture(Rain(rate), Fog(mor_m=200.0)) for rate in (5.0, 10.0)]
    assert {(level.name, level.kind, level.knob) for level in levels} == {("rain+fog:mor=200", "rain", "rate_mm_per_h")}


def test_the_knob_s_full_name_is_taken() -> None:
    assert parse_levels("fog:mor_m=50,100") == parse_levels("fog:mor=100,50")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("rain:rate=5", "two or more values"),
        ("rain", "two or more values"),
        ("rain:rate=1,5+fog:mor=100,50", "one list of values"),
        ("rain:rate=1,5,temperature_c=1,2", "one list of values"),
        ("rain:rate=5,temperature_c=1,2", "a list must be of rate_mm_per_h of rain"),
        ("hail:rate=1,2", "a rate or visibility"),
        ("fog:rate=1,2", "a list must be of mor_m of fog"),
        ("rain:rate=1,x", "expected numbers"),
        ("rain:rate=5,1,5", "got 5 twice"),
        ("rain:rate=0,5", "above 0 and finite"),
        ("fog:mor=100,inf", "above 0 and finite"),
        ("rain:5,10", "expected key=value"),
        ("rain:rate=1,2,rate=3", "'rate' once"),
        ("rain:rate=1,9000", "9000"),
        ("rain:rate=1,2+hail:rate=1", "hail"),
        ("rain:rate=1,2,size_distribution=nonsense", "nonsense"),
    ],
)
def test_what_is_no_list_of_levels_is_refused(text: str, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        parse_levels(text)
