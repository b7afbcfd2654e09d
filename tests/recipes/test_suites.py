"""Suites: five severities a weather that get heavier, what is wrong is named, recipes and suites are told apart."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
import yaml

from torchweather.atmosphere.weather import Fog, Mixture, Rain
from torchweather.core.errors import TorchweatherError
from torchweather.recipes.pipelines import list_pipelines
from torchweather.recipes.recipes import list_recipes, read_recipe, recipes_folder
from torchweather.recipes.suites import FORMAT, list_suites, read_suite

RATES = [1.0, 2.0, 3.0, 4.0, 5.0]


def well() -> dict[str, Any]:
    return {
        "format": FORMAT,
        "title": "rain",
        "sensor": {"kind": "camera"},
        "weathers": {"rain": {"rate_mm_per_h": [*RATES]}},
    }


def written(folder: Path, values: object) -> Path:
    path = folder / "mine.yaml"
    path.write_text(yaml.safe_dump(values))
    return path


def test_there_is_one_for_every_sensor_and_a_severity_is_the_same_weather_for_all() -> None:
    suites = list_suites()
    assert [suite.sensor_kind for suite in suites] == ["camera", "lidar", "radar"]
    first = suites[0].conditions()
    assert all(suite.conditions() == first for suite in suites)
    assert [(c.name, c.severity) for c in first] == [(n, k) for n in ("rain", "fog", "snow") for k in range(1, 6)]
    for before, after in pairwise(first):
        if before.name == after.name:
            assert (after.value < before.value) == (after.name == "fog")
            assert before.weather != after.weather


def test_suites_are_no_recipes_and_recipes_no_suites() -> None:
    files = list(recipes_folder().rglob("*.yaml"))
    names = [one.name for listed in (list_recipes(), list_pipelines(), list_suites()) for one in listed]
    assert len(names) == len(set(names)) == len(files)
    with pytest.raises(TorchweatherError, match=r"wanted a suite of format.*got 'torchweather-recipe/1'"):
        read_suite(recipes_folder() / "camera" / "fog-30m.yaml")
    with pytest.raises(TorchweatherError, match=r"wanted a recipe of format.*got 'torchweather-suite/1'"):
        read_recipe(recipes_folder() / "camera" / "robustness.yaml")


def test_a_mixture_varies_in_the_parts_that_have_a_list(tmp_path: Path) -> None:
    values = well()
    parts = [{"kind": "rain", "rate_mm_per_h": [*RATES]}, {"kind": "fog", "mor_m": 300.0}]
    values["weathers"] = {"rain-in-fog": {"parts": parts}}
    conditions = read_suite(written(tmp_path, values)).conditions()
    assert [c.value for c in conditions] == RATES
    assert conditions[2].weather == Mixture(Rain(3.0), Fog(mor_m=300.0))
    assert (conditions[2].kind, conditions[2].name, conditions[2].severity) == ("rain", "rain-in-fog", 3)


def test_a_name_that_is_near_is_suggested_and_a_short_one_must_be_told_apart() -> None:
    with pytest.raises(ValueError, match=r"could be camera/robustness, lidar/robustness, radar/robustness"):
        read_suite("robustness")
    with pytest.raises(ValueError, match=r"Did you mean 'lidar/robustness'"):
        read_suite("lidr/robustness")


def without(key: str) -> Callable[[dict[str, Any]], object]:
    return lambda values: values.pop(key)


WRONG: dict[str, tuple[Callable[[dict[str, Any]], object], str]] = {
    "format": (lambda v: v.update(format="torchweather-suite/9"), "wanted a suite of format"),
    "unknown key": (lambda v: v.update(wheathers={}), "unknown key 'wheathers'.*Did you mean 'weathers'"),
    "no title": (without("title"), "lacks 'title'"),
    "sensor kind": (lambda v: v.update(sensor={"kind": "lider"}), "sensor.kind.*Did you mean 'lidar'"),
    "sensor preset": (lambda v: v["sensor"].update(preset="lucid-tritom"), "Did you mean 'lucid-triton'"),
    "option": (lambda v: v.update(options={"airligth": 1}), "unknown option 'airligth'.*Did you mean 'airlight'"),
    "no weathers": (lambda v: v.update(weathers={}), "weathers must be keys"),
    "weather kind": (lambda v: v.update(weathers={"rian": {"mor_m": RATES}}), "Did you mean 'rain'"),
    "field": (lambda v: v["weathers"]["rain"].update(siz="x"), "siz"),
    "four": (lambda v: v["weathers"].update(rain={"rate_mm_per_h": RATES[:4]}), r"wanted 5 severities.*\[4\]"),
    "no list": (lambda v: v["weathers"].update(rain={"rate_mm_per_h": 5.0}), "wanted 5 severities.*no list"),
    "falling": (lambda v: v["weathers"].update(rain={"rate_mm_per_h": RATES[::-1]}), "must get heavier.*5 before 4"),
    "negative": (
        lambda v: v["weathers"].update(rain={"rate_mm_per_h": [-1.0, *RATES[:4]]}),
        "rate_mm_per_h must lie in",
    ),
    "text": (lambda v: v["weathers"].update(rain={"rate_mm_per_h": ["a", *RATES[:4]]}), "rain|float"),
}


@pytest.mark.parametrize("what", list(WRONG))
def test_what_is_wrong_in_a_file_is_named_with_the_file(what: str, tmp_path: Path) -> None:
    change, message = WRONG[what]
    values = well()
    change(values)
    path = written(tmp_path, values)
    with pytest.raises(TorchweatherError, match=message) as caught:
        read_suite(path)
    assert str(path) in str(caught.value)


def test_a_file_that_is_no_yaml_or_not_there_is_named(tmp_path: Path) -> None:
    (tmp_path / "broken.yaml").write_text("a: [")
    with pytest.raises(TorchweatherError, match="wanted a suite in YAML"):
        read_suite(tmp_path / "broken.yaml")
    with pytest.raises(TorchweatherError, match="no such file"):
        read_suite(tmp_path / "none.yaml")
