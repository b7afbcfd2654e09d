"""Corruption error and resilience rate, by hand."""

from __future__ import annotations

import math

import pytest

from torchweather.evaluation.robustness import rates


def test_a_detector_that_the_weather_does_not_touch_keeps_all_and_has_the_error_of_clear_air() -> None:
    found = rates(0.7, {"rain": [0.7, 0.7], "fog": [0.7, 0.7]})
    assert found.mean_resilience == pytest.approx(1.0)
    assert found.mean_corruption_error == pytest.approx(1.0)
    assert found.reference == "clear"


def test_the_rates_are_those_of_the_papers() -> None:
    """Robo3D, 3.3: RR = sum of Acc over S Acc_clear; Hendrycks and Dietterich: sum of errors over the baseline's."""
    mine, theirs = {"rain": [0.8, 0.6], "fog": [0.5, 0.1]}, {"rain": [0.6, 0.4], "fog": [0.5, 0.3]}
    found = rates(0.9, mine, theirs)
    assert found.resilience == pytest.approx({"rain": 1.4 / 1.8, "fog": 0.6 / 1.8})
    assert found.mean_resilience == pytest.approx(2.0 / 3.6)
    assert found.corruption_error == pytest.approx({"rain": 0.6 / 1.0, "fog": 1.4 / 1.2})
    assert found.mean_corruption_error == pytest.approx((0.6 + 1.4 / 1.2) / 2)
    assert found.reference == "baseline"
    alone = rates(0.9, mine)
    assert alone.corruption_error == pytest.approx({"rain": 0.6 / 0.2, "fog": 1.4 / 0.2})


def test_where_a_divisor_is_zero_there_is_no_rate() -> None:
    assert math.isnan(rates(1.0, {"rain": [0.5]}).mean_corruption_error)
    assert math.isnan(rates(0.0, {"rain": [0.0]}).mean_resilience)


def test_other_conditions_or_what_is_no_performance_are_refused() -> None:
    with pytest.raises(ValueError, match="same weathers and severities"):
        rates(0.5, {"rain": [0.5, 0.4]}, {"rain": [0.5]})
    with pytest.raises(ValueError, match=r"performance \(rain\) must lie in 0\.\.1"):
        rates(0.5, {"rain": [50.0]})
    with pytest.raises(ValueError, match="one weather or more"):
        rates(0.5, {})
