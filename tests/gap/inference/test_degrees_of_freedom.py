"""Gains over noise that few frames tell: Student's law against scipy, degrees of freedom against drawn scatters."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.stats import chi2, t

from torchweather.gap.inference.degrees_of_freedom import StatisticDegrees, as_of_known_noise, beyond_known_noise
from torchweather.gap.inference.global_test import GlobalTest
from torchweather.gap.statistics.frame_statistics import Group, Layout

EDGES = (0.0, 1.0, 2.0)
LAYOUT = Layout((Group("floor", "x", "share", EDGES), Group("ratio", "x", "mean", EDGES)), (), (), ())


@pytest.mark.parametrize("degrees_of_freedom", [3.0, 7.0, 30.0])
@pytest.mark.parametrize("chance", [0.1, 1e-3, 1e-6])
def test_a_square_is_as_unlikely_as_that_of_a_normal_number(degrees_of_freedom: float, chance: float) -> None:
    square = float(t.isf(0.5 * chance, degrees_of_freedom)) ** 2
    found = float(as_of_known_noise(square, degrees_of_freedom))
    # Wallace's formula: to 4 % of the normal number.
    assert np.sqrt(found) == pytest.approx(float(np.sqrt(chi2.isf(chance, 1))), rel=0.04)
    assert beyond_known_noise(found, degrees_of_freedom) == pytest.approx(square, rel=1e-9)
    assert as_of_known_noise(square, np.inf) == pytest.approx(square, rel=1e-9)


def degrees_of(floor: float, ratio: float, used: list[bool], told: float = 0.0) -> StatisticDegrees:
    base: Any = SimpleNamespace(
        used={"c": np.array(used)},
        expected={"c": np.array([1.0, 0.5, 1.0, 1.0])},
        degrees_of_freedom={"c": np.array([floor, floor, ratio, ratio])},
        told_by_clear={"c": np.full(4, told)},
    )
    return StatisticDegrees(LAYOUT, base, {"c": "s0"})


def test_bins_of_a_statistic_share_the_error_of_its_scatter_and_statistics_do_not() -> None:
    known = degrees_of(7.0, np.inf, [True] * 4)
    assert known.of(np.array([1.0, 3.0, 0.0, 0.0])) == pytest.approx(7.0)
    assert known.of(np.array([0.0, 0.0, 1.0, 0.0])) == np.inf
    # Half of the square is known: the scatter of the whole is off by half of what that of the other is.
    assert known.of(np.array([1.0, 0.0, 1.0, 0.0])) == pytest.approx(28.0)
    assert degrees_of(7.0, 7.0, [True] * 4).of(np.array([1.0, 0.0, 0.0, 1.0])) == pytest.approx(14.0)
    # By the same clear frames both are off alike.
    assert degrees_of(7.0, 7.0, [True] * 4, told=1.0).of(np.array([1.0, 0.0, 0.0, 1.0])) == pytest.approx(7.0)
    assert degrees_of(7.0, 14.0, [False, False, True, True]).of_all == pytest.approx(14.0)


@pytest.mark.parametrize(("scene", "expected"), [("s0", 7.0), ("s1", 14.0)])
def test_scenes_have_clear_frames_of_their_own(scene: str, expected: float) -> None:
    """Two conditions that depart as much: of one scene their noise is off alike, of two each by its own error."""
    names = ("c", "d")
    base: Any = SimpleNamespace(
        used=dict.fromkeys(names, np.ones(4, bool)),
        expected=dict.fromkeys(names, np.ones(4)),
        degrees_of_freedom=dict.fromkeys(names, np.full(4, 7.0)),
        told_by_clear=dict.fromkeys(names, np.ones(4)),
    )
    known = StatisticDegrees(LAYOUT, base, {"c": "s0", "d": scene})
    assert known.of(np.ones(8)) == known.of_all == pytest.approx(expected)
    assert known.of(np.concatenate([np.ones(4), np.zeros(4)])) == pytest.approx(7.0)


def test_an_alarm_by_a_fitted_effect_knows_how_sure_its_noise_is() -> None:
    templates: Any = (SimpleNamespace(id="floor"), SimpleNamespace(id="ratio"))
    null = np.random.default_rng(0).chisquare(1, 1000)
    rest: Any = (0.0, 0, templates, np.zeros(2), null, null, np.array([4.0, np.inf]), np.inf, None)
    test = GlobalTest(np.zeros(4), *rest, 0.5, 0.5)
    assert test.raised(60.0, ["ratio"]).p_value < 1e-8
    assert test.raised(60.0, ["floor"]).p_value > 1e-4
    assert test.raised(0.0, ["floor"]).p_value == 0.5
    assert test.raised(60.0, ["of_no_response"]).p_value < 1e-8  # by the noise of all statistics
    assert test.threshold == pytest.approx(float(np.quantile(null, 1.0 - 2e-4)), rel=1e-6)
