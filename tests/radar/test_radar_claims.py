"""D3.4's claim of more radar detections in rain and snow than in clear air: which ingredient of a simulator makes them.

A small version of examples/radar_point_counts.py, whose docstring says what its columns a to e are.
"""

from __future__ import annotations

import importlib.util
import math
import statistics
import sys
from pathlib import Path
from types import ModuleType
from typing import Any
from unittest import mock

import pytest
import torch
from scipy import special

import torchweather as tw
from torchweather.radar import map_noise_dbm

EXAMPLE = Path(__file__).parents[2] / "examples" / "radar_point_counts.py"
SEEDS = 5
WEATHERS = ("clear", "rain 50 mm/h", "fog 20 m", "snow 1 mm/h")
OHM = 50.0
CAR_M = 28.0


@pytest.fixture(scope="module")
def example() -> ModuleType:
    spec = importlib.util.spec_from_file_location("radar_point_counts", EXAMPLE)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # its dataclasses look themselves up there
    with mock.patch.object(sys, "path", [str(EXAMPLE.parent), *sys.path]):  # examples share parts
        spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def radar() -> tw.Radar:
    return tw.Radar.preset("awr1843-like")


@pytest.fixture(scope="module")
def run(example: ModuleType, radar: tw.Radar) -> dict[str, Any]:
    targets = example.radar_view(example.test_track(), radar).scatterers
    noises = [example.white_noise(radar, targets, seed) for seed in range(SEEDS)]
    thresholds = example.clear_thresholds(radar, targets, noises, OHM)
    every = example.weathers()
    rows = {name: example.count(radar, targets, every[name], noises, thresholds, CAR_M, OHM) for name in WEATHERS}
    return {"rows": rows, "losses": example.against_loss(radar, targets, noises, thresholds["c"], OHM)}


def points(run: dict[str, Any], weather: str, column: str) -> list[int]:
    found: list[int] = run["rows"][weather]["points"][column]
    return found


def rise(run: dict[str, Any], weather: str, column: str) -> tuple[float, float]:
    """Points more than in clear air, and three standard errors of that: the same noise in both, paired frame by frame.

    One point more or less in one of the frames is the least scatter there is.
    """
    pairs = zip(points(run, weather, column), points(run, "clear", column), strict=True)
    more = [here - clear for here, clear in pairs]
    return statistics.fmean(more), 3.0 * max(statistics.stdev(more), 1.0) / math.sqrt(SEEDS)


@pytest.mark.parametrize("weather", WEATHERS[1:])
def test_attenuation_alone_adds_no_point(run: dict[str, Any], weather: str) -> None:
    more, scatter = rise(run, weather, "b")
    assert more <= scatter


def test_rain_takes_points(run: dict[str, Any]) -> None:
    more, scatter = rise(run, "rain 50 mm/h", "b")
    assert more < -scatter


@pytest.mark.parametrize("weather", ["rain 50 mm/h", "snow 1 mm/h"])
def test_points_that_are_added_are_the_weathers_own(run: dict[str, Any], weather: str) -> None:
    row = run["rows"][weather]
    more = [a - b for a, b in zip(row["points"]["a"], row["points"]["b"], strict=True)]
    scatter = 3.0 * max(statistics.stdev(more), 1.0) / math.sqrt(SEEDS)
    assert statistics.fmean(more) > scatter
    # With targets in the frame the detector sees no more of the weather than on an empty road.
    assert statistics.fmean(more) <= statistics.fmean(row["alone"]) + scatter


def test_fog_and_clear_air_have_no_echo_of_their_own(run: dict[str, Any]) -> None:
    for weather in ("clear", "fog 20 m"):
        row = run["rows"][weather]
        assert row["points"]["a"] == row["points"]["b"]
        # False alarms: 1e-4 x 32,768 cells, of which few pass the beam's own threshold of 12 dB; 3 are allowed a frame.
        assert max(row["alone"]) <= 3


@pytest.mark.parametrize(("weather", "fall", "spread"), [("rain 50 mm/h", 5.17, 1.44), ("snow 1 mm/h", 0.96, 0.12)])
def test_the_weathers_own_points_are_near_and_move_as_what_falls(
    run: dict[str, Any], radar: tw.Radar, weather: str, fall: float, spread: float
) -> None:
    row = run["rows"][weather]
    ranges, speeds = torch.tensor(row["alone_range_m"]), torch.tensor(row["alone_speed_m_per_s"])
    # Noise alone would have its median in the middle of the range axis.
    assert ranges.median() < 0.25 * radar.max_range_m
    # Mean fall speed of the echoes and 3 sigma of it (``reflectivity_weighted_fall_speed``) under the view's steepest
    # angle, 28 degrees, and of the air's 0.5 m/s. Noise fills +-8.1 m/s: 0.6 and 0.25 of it would be inside.
    sine = math.sin(math.radians(28.0))
    fastest = fall * sine + 3.0 * math.hypot(0.5, spread * sine)
    inside = (speeds.abs() <= fastest).float().mean()
    assert inside > 0.9


def test_published_noise_with_a_fixed_threshold_makes_points_rise(run: dict[str, Any]) -> None:
    assert statistics.fmean(points(run, "clear", "c")) == 340.0  # the threshold was set so
    for weather in ("rain 50 mm/h", "fog 20 m"):
        more, scatter = rise(run, weather, "c")
        assert more > max(scatter, 340.0)
    losses = run["losses"]
    assert losses["both"] == sorted(losses["both"])


def test_neither_ingredient_does_it_without_the_other(run: dict[str, Any]) -> None:
    for column in ("d", "e"):
        for weather in WEATHERS[1:]:
            more, scatter = rise(run, weather, column)
            assert more <= scatter
    alone = run["losses"]["signal weaker only"]
    # Thousands of noise peaks are near the threshold; a weaker signal may lift one of them over it now and then.
    assert max(alone) <= alone[0] + 1.0
    assert alone[-1] < alone[0]


def test_a_quarter_of_a_decibel_gives_the_published_counts(example: ModuleType, run: dict[str, Any]) -> None:
    for count in (example.D34_RAIN, example.D34_SNOW):
        # The two losses of the table that enclose it; 25 mm/h as published takes 0.55 dB to the first car and back.
        assert 0.1 < example.loss_for(count, run["losses"]) < 0.5


def test_published_noise_is_the_formulas(example: ModuleType, radar: tw.Radar) -> None:
    # 4 x 50 ohm x 1.380649e-23 J/K x 290 K x 512 MHz = 4.100e-10
    assert example.published_noise_mw(radar, 0.0, 50.0) == pytest.approx(4.100e-10, rel=1e-3)
    assert example.published_noise_mw(radar, 10.0, 50.0) == pytest.approx(4.100e-9, rel=1e-3)


def test_noise_above_a_fixed_threshold_follows_its_gamma_law(example: ModuleType, radar: tw.Radar) -> None:
    sigma = math.sqrt(example.published_noise_mw(radar, 0.89, OHM))
    noise = torch.stack(
        [
            sigma * example.white_noise(radar, sys.modules["parts.radar_as_published"].nothing(), seed)
            for seed in range(SEEDS)
        ]
    )
    power = 10.0 ** (sys.modules["parts.radar_as_published"].simulator(radar).process(noise).power_dbm.double() / 10.0)
    # sigma is that of each of I and Q: twice its square is the power.
    mean = 2.0 * sigma**2 * 10.0 ** ((map_noise_dbm(radar) - radar.noise_power_dbm) / 10.0)
    looks, factor = radar.virtual_channels, 1.5
    share = float((power > factor * mean).double().mean())
    expected = float(special.gammaincc(looks, looks * factor))
    # Neighbouring cells of a Hann window share noise: about (1 + 2 (2/3)^2 + 2 (1/6)^2)^2 = 3.8 cells count as one.
    cells = power.numel() / 3.8
    assert share == pytest.approx(expected, abs=4.0 * math.sqrt(expected * (1.0 - expected) / cells))
