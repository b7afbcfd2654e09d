"""Where an effect is looked for that the nuisances can look like."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from torchweather.gap.inference import candidate_fits
from torchweather.gap.inference.candidate_fits import (
    _begun,
    _least,
    _profiled_along,
    from_rest,
    refined,
)
from torchweather.gap.inference.config import NUMERICS
from torchweather.gap.inference.profiled_conditions import Fit
from torchweather.gap.inference.response_templates import ResponseTemplate
from torchweather.gap.inference.simulated_conditions import ParameterPoint
from torchweather.gap.inference.starting_points import ParameterGrid, parameter_grids
from torchweather.gap.inference.systematics import Bounds, Systematics
from torchweather.lidar.effects.all import EFFECTS

BASE: Any = SimpleNamespace(note="the fit without effects")


def test_the_least_of_a_parabola_is_found_between_its_points() -> None:
    place = np.array([1.0, 1.13, 1.015, 0.985])  # in no order
    assert _least(place, 425.0 + 9e3 * (place - 1.064) ** 2) == pytest.approx(1.064, rel=1e-9)


def test_the_least_is_not_looked_for_beyond_the_points() -> None:
    place = np.array([0.0, 1.0, 2.0])
    assert _least(place, (place - 5.0) ** 2) == 2.0
    assert _least(place, (place + 5.0) ** 2) == 0.0
    # A hill has no least but its ends.
    assert _least(place, np.array([3.0, 4.0, 2.0])) == 2.0


@pytest.mark.parametrize(("truth", "farther"), [(1.064, 0), (0.93, 1), (0.7, 4), (1.6, 5)])
def test_nuisances_are_profiled_beside_weak_strengths_of_either_sign_and_on_along_a_valley(
    truth: float, farther: int
) -> None:
    """The misfit is a parabola of the factor: it is found exactly, whatever sign the response was of. Of the weak
    strengths 0.88 and 1.13 are the farthest; beyond them each step is 1.4 times the departure, until one is worse."""
    asked = []

    def profile_beside(point: ParameterPoint, like: Any, rounds: int) -> Any:
        assert (like, rounds) == (BASE, NUMERICS.profile_rounds)
        factor = point.values["lidar.extinction_scale"]["factor"]
        asked.append(factor)
        return point, factor, 200.0 + 5e4 * (factor - truth) ** 2

    search: Any = SimpleNamespace(profile_beside=profile_beside, model=SimpleNamespace(sizes={}))
    (grid, _) = parameter_grids(EFFECTS["lidar.extinction_scale"], [])
    template = ResponseTemplate(grid, 0, grid.points[0], np.zeros(3))
    point, nuisance = _profiled_along(search, BASE, ParameterPoint(), template, 200.0 + 5e4 * (1.0 - truth) ** 2)
    assert point.values["lidar.extinction_scale"]["factor"] == pytest.approx(truth, abs=1e-6)
    assert nuisance == pytest.approx(truth, abs=1e-6)  # those of the same fit
    assert len(asked) == 5 + farther
    assert min(asked) < 1.0 < max(asked)


def test_an_effect_whose_identity_is_infinitely_far_is_profiled_at_its_points() -> None:
    asked = []

    def profile_beside(point: ParameterPoint, like: Any, rounds: int) -> Any:
        asked.append(point.values["lidar.limited_extent"]["extent_m"])
        return point, None, abs(asked[-1] - 90.0)

    search: Any = SimpleNamespace(profile_beside=profile_beside, model=SimpleNamespace(sizes={}))
    (grid,) = parameter_grids(EFFECTS["lidar.limited_extent"], [])
    found, _ = _profiled_along(
        search, BASE, ParameterPoint(), ResponseTemplate(grid, 0, grid.points[0], np.zeros(3)), math.inf
    )
    assert found.values["lidar.limited_extent"]["extent_m"] == min(asked, key=lambda one: abs(one - 90.0))
    assert len(asked) == 3


@pytest.mark.parametrize(
    ("misfits", "best", "rounds"),
    [
        ([90.0, 80.0, 70.0, 60.0], 70.0, NUMERICS.reweightings),  # no more than so often
        ([90.0, 89.0, 10.0], 89.0, 2),  # a round that gains little is the last
        ([100.0 + NUMERICS.converged_chi2, 10.0], 100.0, 1),  # none that is worse is taken
    ],
)
def test_a_fit_is_taken_up_with_the_scatter_where_it_stands(misfits: list[float], best: float, rounds: int) -> None:
    asked = []

    def fit(point: str, nuisance: Any, base: Any) -> Any:
        assert nuisance == ("nuisance", point, base)  # of the same place
        asked.append(point)
        number = len(asked)
        return SimpleNamespace(point=f"point {number}", base=f"base {number}", misfit=misfits[number - 1])

    search: Any = SimpleNamespace(fit=fit, nuisance=lambda point, base: ("nuisance", point, base), exhausted=False)
    start: Any = SimpleNamespace(point="point 0", base="base 0", misfit=100.0)
    assert refined(search, start).misfit == best
    assert asked == [f"point {number}" for number in range(rounds)]


@pytest.mark.parametrize(("farthest", "amplitude"), [(4.0, 1.0 - NUMERICS.far_sd / 8.0), (1.0, 1.0 - 1.0 / 8.0)])
def test_from_rest_nothing_stands_farther_than_it_may_and_by_no_more_than_two_of_its_units(
    farthest: float, amplitude: float
) -> None:
    """What departs is eight units of a gain that costs nothing, and looks like a window: that stands for the rest."""
    gain, pattern = np.ones(10), np.tile([0.5, -0.5], 5)
    nuisance = Systematics(gain[:, None], np.array([3.9]), 1, np.array([[1e-9]]))
    bounds = Bounds(np.array([-farthest]), np.array([farthest]))
    search: Any = SimpleNamespace(bounds=lambda own: bounds if own is nuisance else None, measured=[])
    base: Any = SimpleNamespace(nuisance=nuisance, residual=8.0 * gain - 3.9 * gain)
    grid = ParameterGrid(EFFECTS["lidar.window_loss"], ({"loss_db": 1.0},))
    (found,) = from_rest(search, base, [ResponseTemplate(grid, 0, grid.points[0], 8.0 * gain + pattern)])
    assert found[0].id == "lidar.window_loss"
    assert found[1] == pytest.approx(amplitude, abs=0.01)


def begun_at(truth: float, amplitude: float, number: int) -> tuple[Any, list[float]]:
    """Where a fit of crosstalk begins, and what was tried, on a simulator whose misfit is least at a probability."""
    tried: list[float] = []

    def fit(point: ParameterPoint, nuisance: Any, base: Any, iterations: int) -> Any:
        assert (nuisance, base, iterations) == ("nuisances", "without it", 0)
        tried.append(next(iter(point.values["lidar.crosstalk"].values())))
        return SimpleNamespace(point=point, base=f"scatter {tried[-1]:g}", misfit=abs(math.log(tried[-1] / truth)))

    (grid,) = parameter_grids(EFFECTS["lidar.crosstalk"], [])
    template = ResponseTemplate(grid, number, grid.points[number], np.zeros(3))
    base: Any = SimpleNamespace(nuisance="nuisances", base="without it")
    search: Any = SimpleNamespace(fit=fit)
    return _begun(search, base, ParameterPoint(), template, amplitude), tried


def test_a_fit_begins_at_a_weaker_point_where_the_share_of_a_strong_response_is_too_much() -> None:
    """A share of the response to many events is not that to the first few: it asks for far too many of them."""
    (grid,) = parameter_grids(EFFECTS["lidar.crosstalk"], [])
    weak, strong = grid.points[0]["probability"], grid.points[-1]["probability"]
    found, tried = begun_at(weak, 0.02, len(grid.points) - 1)
    assert found.point.values["lidar.crosstalk"]["probability"] == pytest.approx(weak)
    assert found.base == f"scatter {weak:g}"  # of where it begins
    # The share first, then from weak to strong until one is worse: no further frames.
    assert tried == pytest.approx([max(0.02, NUMERICS.least_amplitude) * strong, weak, grid.points[1]["probability"]])
    # Most of a response is expected: nothing else is tried.
    found, tried = begun_at(weak, 0.9, len(grid.points) - 1)
    assert tried == pytest.approx([0.9 * strong])


def test_a_fit_has_the_scatter_of_its_start(monkeypatch: pytest.MonkeyPatch) -> None:
    """The scatter without an effect takes its first events for miracles, and the fit takes the effect away."""
    start: Any = SimpleNamespace(point=ParameterPoint({"lidar.crosstalk": {}}), base="its own", nuisance="there")
    asked: list[Any] = []

    def fit(point: ParameterPoint, nuisance: Any, base: Any, iterations: int) -> Any:
        asked.append((nuisance, base))
        return SimpleNamespace(point=point, misfit=3.0, base=base, nuisance=nuisance)

    def unmoved(search: Any, point: ParameterPoint, name: str, like: Any) -> ParameterPoint:
        asked.append((like.nuisance, like.base))
        return point

    monkeypatch.setattr(candidate_fits, "_begun", lambda *arguments: start)
    monkeypatch.setattr(candidate_fits, "located", unmoved)
    monkeypatch.setattr(candidate_fits, "refined", lambda search, one: one)
    monkeypatch.setattr(candidate_fits, "is_another", lambda model, values: False)
    (grid,) = parameter_grids(EFFECTS["lidar.crosstalk"], [])
    template = ResponseTemplate(grid, 0, grid.points[0], np.ones(2))
    base: Any = Fit(ParameterPoint(), None, np.zeros(2), lambda values: values, 5.0, np.zeros((0, 0)), ())  # type: ignore[arg-type]
    search: Any = SimpleNamespace(fit=fit, exhausted=False, model=None)
    (found,) = candidate_fits.fitted(search, base, [(ParameterPoint(), template, 1.0)], 5.0, lambda text: None)
    assert asked == [("there", "its own"), ("there", "its own")]
    assert found.gain == 2.0
