"""Ranges of results by defaults that no measurement fixes, and what ``explain`` prints of a receiver."""

from __future__ import annotations

import argparse
import math
import re
from dataclasses import replace
from pathlib import Path

import pytest
import torch

import torchweather as tw
from torchweather.core.errors import TorchweatherError
from torchweather.evaluation.sensitivity import (
    Change,
    Moved,
    changes,
    printed_uncertainty,
    results,
    sensitivity,
    uncertainty,
)
from torchweather.evaluation.sensitivity.ranges import SHARES
from torchweather.explain import explain, explanation_text

PAGE = Path(__file__).parents[3] / "docs" / "sensitivity.md"
OS1 = tw.Lidar.preset("ouster-os1-128")
FALSE, LOST = SHARES


def test_the_near_response_decides_the_false_returns_of_fog() -> None:
    """Reference: numbers of the review that asked for this page, by its own integration (issue 42, item 7)."""
    fog = tw.Fog(mor_m=100.0)
    assert results(fog, OS1)[FALSE] == pytest.approx(0.969, abs=0.002)
    assert results(fog, replace(OS1, near_power=2.0))[FALSE] == pytest.approx(0.267, abs=0.005)
    assert results(fog, replace(OS1, pulse_width_ns=5.0))[FALSE] == pytest.approx(0.475, abs=0.005)


def test_efficiencies_scale_the_extinction() -> None:
    rain = tw.Rain(10.0)
    default, full = (results(rain, OS1, options)["effective extinction 1/m"] for options in ({}, {"q_eff": 2.0}))
    assert full == pytest.approx(default * 2.0 / 1.1, rel=1e-6)


def test_a_factor_compares_shares_that_are_there() -> None:
    change = Change("a", "b", "c")
    assert Moved(change, FALSE, 1e-5, 9e-4).factor == 1.0
    assert Moved(change, FALSE, 0.0, 0.2).factor == math.inf
    assert Moved(change, LOST, 0.2, 0.1).factor == 0.5
    assert Moved(change, "attenuation dB/km", 1e-5, 2e-5).factor == 2.0
    assert Moved(change, "attenuation dB/km", 0.0, 0.0).factor == 1.0


def test_every_change_has_a_source_and_leaves_a_valid_weather_and_sensor() -> None:
    for weather in (tw.Rain(5.0), tw.Fog(mor_m=200.0), tw.Snow(1.0)):
        for sensor in (OS1, tw.Camera.preset("lucid-triton"), tw.Radar()):
            for change in changes(weather, sensor):
                assert change.source
                altered = change.of_weather(weather), change.of_sensor(sensor), change.option
                assert altered != (weather, sensor, {})


def test_uncertainty_is_the_hull_of_single_changes() -> None:
    moved = [one for one in sensitivity("snow:rate=1", "radar") if one.result == "attenuation dB/km"]
    value, least, largest = uncertainty("snow:rate=1", "radar")["attenuation dB/km"]
    assert value == moved[0].before
    assert least == min(value, *(one.after for one in moved))
    assert largest == max(value, *(one.after for one in moved)) > 5.0 * value  # wet flakes


@pytest.mark.long  # ten changes of a LiDAR; of a radar below
def test_every_printed_number_has_a_range_or_is_exact() -> None:
    """Efficiencies by hand: rain of q_eff 1 to 2 (1.1) and q_back 0.094 to 0.6 (0.2 at 865 nm)."""
    numbers = explain("rain:rate=25", OS1, receiver=True)
    found = printed_uncertainty("rain:rate=25", OS1, numbers)
    value, least, largest = found["backscatter efficiency, rain"]
    assert (value, least, largest) == pytest.approx((0.2, 0.094, 0.6))
    value, least, largest = found["backscatter 1/(m sr), laser"]
    assert largest / value == pytest.approx(3.0)
    assert least / value <= 0.47 + 1e-9
    value, least, largest = found["effective extinction 1/m, laser"]
    assert largest / value >= 2.0 / 1.1 - 1e-9
    assert found["pulse width ns"] == (10.0, 5.0, 15.0)
    assert found["range at 10 % m"][1:] == (40.0, 40.0)
    assert found[FALSE][0] == pytest.approx(numbers["receiver"]["false_return_share"], rel=1e-3)
    text = explanation_text(
        {
            **numbers,
            "uncertainty": {k: dict(zip(("value", "least", "largest"), v, strict=True)) for k, v in found.items()},
        }
    )
    assert re.search(r"range at 10 % m +40 +exact: no unmeasured default moves it", text)
    assert re.search(r"pulse width ns +10 +5 to 15", text)


@pytest.mark.parametrize("sensor", [pytest.param("camera", marks=pytest.mark.long), "radar"])
def test_the_spread_of_visibility_is_in_the_range_of_snow(sensor: str) -> None:
    numbers = explain("snow:rate=1", sensor)
    found = printed_uncertainty("snow:rate=1", sensor, numbers)
    value, least, largest = found["visibility (Mie) m"]
    assert value == numbers["mor_m"]
    assert least <= value / 3 * (1 + 1e-6)
    assert largest >= value / 0.3 * (1 - 1e-6)
    assert {name.rpartition(", ")[2] for name in found} >= {band["name"] for band in numbers["bands"]}


def test_a_mixture_is_refused() -> None:
    with pytest.raises(TorchweatherError, match="one at a time"):
        uncertainty("rain:rate=5+fog:mor=100", "radar")


def test_explain_prints_the_receiver_with_the_options_of_apply() -> None:
    from torchweather.cli.apply import add_arguments

    text = explanation_text(explain("rain:rate=5", OS1, receiver=True))
    parser = argparse.ArgumentParser()
    add_arguments(parser)
    named = set(re.findall(r"--[a-z0-9-]+", text))
    assert named == {
        *("--range-at-10-percent-m", "--near-start-m", "--near-full-m", "--near-power"),
        *("--pulse-width-ns", "--margin-db", "--q-back"),
    }
    assert named <= {option for action in parser._actions for option in action.option_strings}
    assert "near response of this preset is generic" in text
    measured = explanation_text(explain("rain:rate=5", tw.Lidar.preset("ouster-os2-128"), receiver=True))
    assert ("is generic" in measured) == (tw.Lidar.preset("ouster-os2-128").near_full_m == 10.0)


def test_a_camera_renders_half_of_the_extinction_of_drops_and_all_of_fog() -> None:
    for weather, share in (("rain:rate=25", 0.5), ("snow:rate=1", 0.5), ("fog:mor=100", 1.0)):
        for band in explain(weather, "camera")["bands"]:
            assert band["extinction_rendered_per_m"] == pytest.approx(share * band["extinction_per_m"], rel=1e-9)


def test_what_the_camera_renders_is_what_explain_prints() -> None:
    """Mean transmission of the drawn frames against exp(-rendered extinction x depth)."""
    camera = tw.Camera.preset("lucid-triton").resized(128, 96)
    wall = torch.full((1, 96, 128), 0.1)
    rain = tw.BayerRain(tw.Rain(50.0), camera, depth=30.0, near_m=0.5, airlight=0.5)
    covered = sum(float(rain.run(wall, seed=seed).particle_mask.mean()) for seed in range(4)) / 4
    alpha = explain("rain:rate=50", "camera")["bands"][1]["extinction_rendered_per_m"]
    x, y = ((torch.arange(size) - (size - 1) / 2) / focal for size, focal in ((128, camera.fx), (96, camera.fy)))
    way_m = 29.5 * torch.sqrt(1.0 + x.square() + y.square()[:, None])  # along each pixel's ray
    # 16 frames gave means that scatter by 1e-3 of their value; the table of the mask's mean is good to 0.5 %.
    assert covered == pytest.approx(float((1.0 - torch.exp(-alpha * way_m)).mean()), rel=0.01)


@pytest.mark.long  # a few seconds of tables; the short tests above cover the parts
def test_the_page_has_what_the_script_finds() -> None:
    text = PAGE.read_text(encoding="utf-8")
    for weather in ("rain:rate=25", "snow:rate=1"):
        for moved in sensitivity(weather, "radar:imaging-77ghz"):
            row = f"| {moved.change.default} | {moved.change.value} | {moved.result} |"
            strong = not 1 / 1.2 <= moved.factor <= 1.2
            section = text.split("## Radar")[1].split(f"### `{weather}`")[1].split("###")[0]
            assert (row in section) == strong
            if strong:
                assert f"{row} {moved.before:.3g} | {moved.after:.3g} |" in section
