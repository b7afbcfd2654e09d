"""The simplest formula of a curve: what was put in comes out, and noise is nothing."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from torchweather.gap.statistics.formula import bounded, simplest_formula

Floats = NDArray[np.float64]

RANGE_M = (0.0, 4.0, 8.0, 12.0, 17.0, 23.0, 30.0, 40.0, 55.0, 75.0, 110.0, 1000.0)
AZIMUTH_RAD = tuple(float(v) for v in np.linspace(-math.pi, math.pi, 17))
DRAWS = 40
CURVES: dict[str, tuple[str, tuple[float, ...], Callable[[Floats], Floats]]] = {
    "constant": ("constant", RANGE_M, lambda x: np.ones_like(x)),
    "linear": ("linear", RANGE_M, lambda x: -0.02 + 0.004 * x),
    "logarithm": ("logarithm", RANGE_M, lambda x: -0.5 + 0.3 * np.log(x)),
    "quadratic": ("quadratic", RANGE_M, lambda x: 0.1 - 0.02 * x + 2e-4 * x**2),
    "exponential_approach": ("exponential_approach", RANGE_M, lambda x: 0.4 * (1.0 - np.exp(-x / 15.0))),
    "power": ("power", RANGE_M, lambda x: 2e-4 * x**2),
    "step": ("step", RANGE_M, lambda x: np.where(x < 23.0, 0.0, 0.5)),
    "sine": ("sine", AZIMUTH_RAD, lambda x: 0.1 * np.sin(3.0 * x + 0.4)),
    "sine beside an offset": ("sine", AZIMUTH_RAD, lambda x: 0.03 + 0.1 * np.sin(x - 2.0)),
}


def means(edges: tuple[float, ...], function: Callable[[Floats], Floats]) -> Floats:
    """Of a function over each bin, by many points."""
    ends = bounded(edges)
    share = (np.arange(400) + 0.5) / 400
    found: Floats = function(ends[:-1, None] + np.diff(ends)[:, None] * share).mean(1)
    return found


def axis_of(edges: tuple[float, ...]) -> str:
    return "azimuth_rad" if edges is AZIMUTH_RAD else "range_m"


@pytest.mark.parametrize("name", CURVES)
def test_a_formula_is_found_in_its_own_data_at_signal_to_noise_ten(name: str) -> None:
    wanted, edges, function = CURVES[name]
    rng = np.random.default_rng(1)
    curve = means(edges, function)
    sd = (float(curve.std()) if wanted != "constant" else 1.0) / 10.0
    found = []
    for _ in range(DRAWS):
        one = simplest_formula(edges, curve + sd * rng.normal(size=len(curve)), np.full(len(curve), sd), axis_of(edges))
        found.append("none" if one is None else one.name)
    assert found.count(wanted) >= 0.9 * DRAWS


@pytest.mark.parametrize("edges", [RANGE_M, AZIMUTH_RAD], ids=["range", "azimuth"])
def test_noise_is_a_constant(edges: tuple[float, ...]) -> None:
    rng = np.random.default_rng(2)
    bins = len(edges) - 1
    found = [simplest_formula(edges, rng.normal(size=bins), np.ones(bins), axis_of(edges)) for _ in range(2 * DRAWS)]
    assert sum(one is not None and one.name == "constant" for one in found) >= 0.9 * 2 * DRAWS


@pytest.mark.parametrize(
    ("name", "wanted"),
    [
        ("linear", {"offset": -0.02, "slope": 0.004}),
        ("quadratic", {"offset": 0.1, "slope": -0.02, "curvature": 2e-4}),
        ("step", {"below": 0.0, "above": 0.5, "at": 23.0}),
        ("sine", {"amplitude": 0.1, "phase_rad": 0.4, "times": 3.0}),
    ],
)
def test_its_parameters_are_those_of_the_curve_itself(name: str, wanted: dict[str, float]) -> None:
    """Not of the bins' middles: wide bins flatten a sine and lift a parabola."""
    _, edges, function = CURVES[name]
    found = simplest_formula(edges, means(edges, function), np.full(len(edges) - 1, 1e-3), axis_of(edges))
    assert found is not None
    # 1e-3 a bin; of the parabola the curvature is over 1000 m^2 and better known.
    assert found.parameters == pytest.approx(wanted, rel=0.02, abs=1e-3)
    np.testing.assert_allclose(found.values, means(edges, function), atol=1e-3)
    assert found.chi2_per_dof < 0.5


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("linear", "-0.02 + 0.004 range_m"),
        ("quadratic", "0.1 - 0.02 range_m + 0.0002 range_m^2"),
        ("exponential_approach", "0.4 (1 - exp(-range_m / 15))"),
        ("power", "0.0002 range_m^2"),
        ("sine", "0.1 sin(3 azimuth_rad + 0.4)"),
        ("sine beside an offset", "0.03 + 0.1 sin(azimuth_rad - 2)"),
        ("constant", "1"),
    ],
)
def test_it_is_written_with_the_name_of_its_axis(name: str, text: str) -> None:
    _, edges, function = CURVES[name]
    found = simplest_formula(edges, means(edges, function), np.full(len(edges) - 1, 1e-3), axis_of(edges))
    assert found is not None
    # The length of an approach is one of a list.
    numbers, wanted = _numbers(found.text), _numbers(text)
    assert _words(found.text) == _words(text)
    assert numbers == pytest.approx(wanted, rel=0.08)


def _words(text: str) -> list[str]:
    return [part for part in text.replace("(", " ").replace(")", " ").split() if not _is_number(part)]


def _numbers(text: str) -> list[float]:
    return [float(part) for part in text.replace("(", " ").replace(")", " ").split() if _is_number(part)]


def _is_number(part: str) -> bool:
    try:
        float(part)
    except ValueError:
        return False
    return True


def test_a_curve_that_no_formula_follows_has_none() -> None:
    zigzag = np.array([0.0, 1.0, 0.0, 0.0, -2.0, 0.0, 1.0, 0.0, 3.0, -1.0, 0.0])
    assert simplest_formula(RANGE_M, zigzag, np.full(11, 0.02), "range_m") is None


def test_a_formula_with_most_of_the_curve_is_one_though_not_within_its_errors() -> None:
    curve = means(RANGE_M, CURVES["logarithm"][2])
    rough = curve * np.where(np.arange(11) % 2, 1.1, 0.9)
    found = simplest_formula(RANGE_M, rough, np.full(11, 1e-3), "range_m")
    assert found is not None
    assert found.name == "logarithm"
    assert found.chi2_per_dof > 100


def test_an_axis_that_is_no_full_circle_follows_no_sine() -> None:
    curve = means(AZIMUTH_RAD, CURVES["sine"][2])
    found = simplest_formula(AZIMUTH_RAD, curve, np.full(16, 1e-3), "elevation_rad")
    assert found is None or found.name != "sine"


def test_bins_that_are_not_known_count_for_nothing() -> None:
    curve = means(RANGE_M, CURVES["linear"][2])
    curve[[0, 6, 10]] = np.nan
    found = simplest_formula(RANGE_M, curve, np.full(11, 1e-3), "range_m")
    assert found is not None
    assert found.parameters == pytest.approx({"offset": -0.02, "slope": 0.004}, rel=0.02, abs=1e-3)
    assert np.isfinite(found.values).all()


@pytest.mark.parametrize(("known", "wanted"), [(0, None), (1, "constant"), (2, "constant")])
def test_few_bins_allow_little(known: int, wanted: str | None) -> None:
    curve = np.full(11, np.nan)
    curve[:known] = 0.5
    found = simplest_formula(RANGE_M, curve, np.full(11, 0.1), "range_m")
    assert (None if found is None else found.name) == wanted


def test_a_bin_without_an_end_is_as_wide_as_its_neighbour() -> None:
    open_below: Any = (-30.0, -2.0, -1.0, 0.0, 30.0)
    assert bounded(open_below).tolist() == [-3.0, -2.0, -1.0, 0.0, 1.0]
    assert bounded(RANGE_M)[-1] == 145.0
    assert bounded(AZIMUTH_RAD).tolist() == list(AZIMUTH_RAD)
    assert bounded([0.0, 1000.0]).tolist() == [0.0, 1000.0]
