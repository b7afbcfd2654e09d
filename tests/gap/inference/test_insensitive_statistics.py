"""What the effects found so far leave as it was."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from torchweather.gap.inference.config import METHOD, SCATTER
from torchweather.gap.inference.insensitive_statistics import (
    fresh_delta_chi2,
    gained_elsewhere,
    insensitive_statistics,
    shown_elsewhere,
)
from torchweather.gap.inference.response_templates import ResponseTemplate
from torchweather.gap.inference.starting_points import ParameterGrid
from torchweather.gap.inference.systematics import Systematics
from torchweather.gap.statistics.frame_statistics import Group, Layout
from torchweather.lidar.effects.all import EFFECTS

LAYOUT = Layout(
    (
        Group("ratio", "x", "mean", (0.0, 1.0, 2.0)),
        Group("apart", "x", "mean", (0.0, 1.0, 2.0)),
        Group("ratio", "y", "mean", (0.0, 1.0)),
    ),
    (),
    (),
    (),
)


def search(used: list[bool]) -> Any:
    names = ("c0", "c1")
    start = SimpleNamespace(
        mean={name: np.zeros(5) for name in names},
        sd={name: np.full(5, 0.5) for name in names},
        used={name: np.array(used) for name in names},
    )
    measured = [SimpleNamespace(condition=SimpleNamespace(id=name)) for name in names]
    return SimpleNamespace(model=SimpleNamespace(layout=LAYOUT), start=start, measured=measured)


def fit(change: list[float]) -> Any:
    return SimpleNamespace(base=SimpleNamespace(mean={"c0": np.zeros(5), "c1": np.array(change)}))


def test_a_statistic_is_touched_as_a_whole_in_all_conditions() -> None:
    """Root mean square over three entries of two conditions: one that moves by 0.5 d / sqrt(6)."""
    least = SCATTER.sensitive_rms * 0.5 * np.sqrt(6.0)
    for size, still in ((0.98, True), (1.02, False)):
        found = insensitive_statistics(search([True] * 5), fit([0.0, 0.0, 0.0, 0.0, size * least]))
        np.testing.assert_array_equal(found, [still, still, True, True, still] * 2)


def test_entries_that_do_not_count_touch_nothing() -> None:
    found = insensitive_statistics(search([True, True, True, True, False]), fit([0.0, 0.0, 0.0, 0.0, 99.0]))
    assert found.all()
    assert not insensitive_statistics(search([True, True, False, False, True]), fit([0.0] * 5))[[2, 3, 7, 8]].any()


def test_a_gain_is_that_of_the_entries_alone() -> None:
    grid = ParameterGrid(EFFECTS["lidar.range_noise"], ({"std_m": 0.1}, {"std_m": 0.2}))
    templates = [
        ResponseTemplate(grid, place, values, np.array(response))
        for place, (values, response) in enumerate(zip(grid.points, ([100.0, 3.0, 0.0], [0.0, 0.0, 5.0]), strict=True))
    ]
    left = np.array([-100.0, 3.0, 1.0])
    nothing = Systematics(np.zeros((3, 1)), np.zeros(1), 0)
    # Of the first the amplitude is 1 in the second entry: 2 * 9 - 9; of the second 0.2: 1.
    assert fresh_delta_chi2(templates, left, nothing, np.array([False, True, True])) == pytest.approx(
        {"lidar.range_noise": 9.0}
    )
    assert fresh_delta_chi2(templates, left, nothing, np.array([False, False, True])) == pytest.approx(
        {"lidar.range_noise": 1.0}
    )
    assert fresh_delta_chi2(templates, left, nothing, np.zeros(3, bool)) == {"lidar.range_noise": 0.0}


def test_what_a_nuisance_took_from_a_residual_is_taken_from_the_response() -> None:
    """A clock moves both entries together, far more than a bias does; what it leaves of a bias still counts fully."""
    grid = ParameterGrid(EFFECTS["lidar.range_bias"], ({"offset_m": 0.1},))
    template = ResponseTemplate(grid, 0, grid.points[0], np.array([40.0, 48.0]))
    clock = Systematics(np.array([[1e4], [1e4]]), np.zeros(1), 0)
    left = clock.left(0.5 * template.response)  # -2 and 2 about
    # Half a response: 2 * 0.5 * 16 - 0.25 * 32.
    assert fresh_delta_chi2([template], left, clock, np.ones(2, bool)) == pytest.approx(
        {"lidar.range_bias": 8.0}, rel=1e-3
    )


@pytest.mark.parametrize(
    ("total", "elsewhere", "shown"),
    [
        (40.0, 30.0, True),
        (40.0, 19.0, False),  # less than noise may gain there
        (30.0 / METHOD.fresh_share - 1.0, 30.0, True),
        (30.0 / METHOD.fresh_share + 1.0, 30.0, False),  # nearly all of its gain is where the first effect acts
    ],
)
def test_an_effect_shows_elsewhere_if_no_small_share_of_its_gain_lies_there(
    total: float, elsewhere: float, shown: bool
) -> None:
    """The larger one of the gains of its templates counts."""
    grid = ParameterGrid(EFFECTS["lidar.range_noise"], ({"std_m": 0.1}, {"std_m": 0.2}))
    templates = [ResponseTemplate(grid, place, grid.points[place], np.zeros(1)) for place in range(2)]
    found = shown_elsewhere(templates, np.array([total, 1.0]), {"lidar.range_noise": elsewhere}, 20.0)
    assert found == (["lidar.range_noise"] if shown else [])


def test_what_another_fit_gains_elsewhere_is_of_entries_that_the_first_leaves_as_they_were() -> None:
    """A first effect moves the ratios, of either axis: what is gained in the other two entries counts."""
    first = fit([0.0, 0.0, 0.0, 0.0, 99.0])
    nuisance = Systematics(np.zeros((10, 1)), np.zeros(1), 0)
    residual = np.array([1.0, 2.0, 3.0, 1.0, 5.0] * 2)
    before = SimpleNamespace(base=first.base, nuisance=nuisance, residual=residual)
    after = SimpleNamespace(base=first.base, nuisance=nuisance, residual=np.array([0.0, 0.0, 1.0, 0.0, 0.0] * 2))
    assert gained_elsewhere(search([True] * 5), before, after) == pytest.approx(2.0 * (9.0 - 1.0 + 1.0), rel=1e-12)
