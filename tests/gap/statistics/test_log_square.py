"""Means of ln(1 + square) of normal errors: against adaptive quadrature, and back to the standard deviation."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.integrate import quad

from torchweather.gap.statistics.log_square import mean_log_square, spread_of_log_square

SPREADS = (1e-3, 0.1, 0.7, 1.0, 3.0, 100.0, 1e6)


@pytest.mark.parametrize("spread", SPREADS)
def test_the_mean_is_that_of_adaptive_quadrature(spread: float) -> None:
    def density(z: float) -> float:
        return math.log1p((spread * z) ** 2) * math.exp(-0.5 * z * z) / math.sqrt(2.0 * math.pi)

    bend = [1.0 / spread] if spread > 0.1 else None
    expected = 2.0 * quad(density, 0.0, 40.0, points=bend, limit=500, epsabs=0.0, epsrel=1e-11)[0]
    assert float(mean_log_square(np.array([spread]))[0]) == pytest.approx(expected, rel=1e-9)


def test_a_spread_comes_back_from_its_mean() -> None:
    """Straight lines between 801 nodes over nine decades, in logarithms: half a step squared times the bend."""
    spread = np.geomspace(1e-5, 1e6, 1234)
    found = spread_of_log_square(mean_log_square(spread))
    np.testing.assert_allclose(found, spread, rtol=(math.log(1e9) / 800) ** 2 / 8)
    np.testing.assert_array_equal(spread_of_log_square(np.array([0.0, -0.3])), 0.0)


def test_a_drawn_error_has_its_spread() -> None:
    """A million draws: the mean is known to 0.001 and its slope in ln(s) is 0.8 at s = 2."""
    drawn = 2.0 * np.random.default_rng(0).normal(size=1_000_000)
    assert float(spread_of_log_square(np.log1p(drawn**2).mean())) == pytest.approx(2.0, rel=4 * 0.001 / 0.8)
