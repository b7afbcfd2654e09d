"""Alarm of the whole model, on studies in which nothing is hidden."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tests.gap.tiny_study import tiny_study
from torchweather.core.threads import one_thread_an_operation
from torchweather.gap.inference.effect_forms import effect_class
from torchweather.gap.inference.global_test import best_of_places, first_templates, run_global_test
from torchweather.gap.inference.likelihood import SimulatorLikelihood
from torchweather.gap.inference.response_templates import ResponseTemplate
from torchweather.gap.inference.simulated_distribution import observations
from torchweather.gap.inference.starting_points import ParameterGrid, parameter_grids
from torchweather.gap.sensors.lidar.frames import LidarFrames
from torchweather.lidar.effects.all import EFFECTS

TOP: Any = ("on top", "scatter")  # of a point, with a scatter


# A lost beam or two where none was simulated: 24 of delta chi-square and 3e-7 by one statistic, as long as each event
# was counted along six axes, and a second one in a bin by as much as the first.
@pytest.mark.parametrize("seed", [0, 6])
def test_a_few_lost_beams_are_no_alarm(seed: int) -> None:
    model = LidarFrames(tiny_study([], seed=seed))
    with one_thread_an_operation():
        search = SimulatorLikelihood(model, observations(model, model.fit), 0)
        effects = [effect_class(model, name) for name in model.catalogue]
        found = run_global_test(search, effects, search.begin(), 0)
    assert found.p_value > 0.01


def test_a_null_is_tried_at_the_best_of_its_places() -> None:
    """Gains of chi-square at each of eight places, of which one was chosen: the best of eight, where a null may."""
    number, places = 20_000, 8
    rng = np.random.default_rng(4)
    every = rng.chisquare(1, (number, places))
    gains = np.stack([rng.chisquare(1, number), every[:, 0]], 1)
    found = best_of_places(gains, np.array([False, True]), places, 0)
    slow = np.maximum(gains[:, 0], every.max(1))
    for share in (0.5, 0.9, 0.99):
        # The error of a quantile of chi-square, five of those.
        here = np.quantile(slow, share)
        assert (found > here).mean() == pytest.approx(1.0 - share, abs=5.0 * np.sqrt(share * (1.0 - share) / number))
    alone = best_of_places(gains, np.array([False, False]), places, 0)
    np.testing.assert_array_equal(alone, gains.max(1))


def test_first_responses_of_mirrored_and_idle_effects_need_no_frames() -> None:
    """A range bias to either side, and grain sizes that this weather has not; a curved effect is simulated whole."""
    asked: list[tuple[str, int]] = []
    names = ("lidar.range_bias", "lidar.particle_sizes", "lidar.blind_zone")

    def templates(points: Sequence[tuple[ParameterGrid, int]], point: Any, base: Any) -> list[ResponseTemplate]:
        assert (point, base) == TOP
        asked.extend((grid.effect.id, place) for grid, place in points)
        found = []
        for grid, place in points:
            values = grid.points[place]
            bias = [values.get(name, 0.0) for name in ("offset_m", "walk_m_per_decade")]
            response = np.array([*bias, float(grid.effect.id == names[2])])  # nothing where there are no grains
            found.append(ResponseTemplate(grid, place, values, response))
        return found

    grids = [grid for name in names for grid in parameter_grids(EFFECTS[name], ())]
    search: Any = SimpleNamespace(templates=templates)
    found = first_templates(search, grids, *TOP)
    places = [(id(grid), place) for grid in grids for place in grid.first]
    assert sorted((id(one.grid), one.number) for one in found) == sorted(places)
    every = [(grid, place) for grid in grids for place in grid.first]
    slow = {(id(one.grid), one.number): one.response for one in templates(every, *TOP)}
    for one in found:
        np.testing.assert_allclose(one.response, slow[id(one.grid), one.number], rtol=1e-12)
    fast = asked[: len(asked) - len(slow)]
    assert fast.count(("lidar.range_bias", 0)) == 2  # of four grids
    assert ("lidar.particle_sizes", 0) not in fast
    assert 2 * sum(name == names[2] for name, _ in fast) == sum(name == names[2] for name, _ in asked)


def test_a_side_that_does_nothing_is_no_mirror() -> None:
    """What acts to one side alone, such as a threshold below all signals: the other side has its own weak response."""

    def templates(points: Sequence[tuple[ParameterGrid, int]], point: Any, base: Any) -> list[ResponseTemplate]:
        return [
            ResponseTemplate(grid, place, grid.points[place], np.array([min(grid.points[place]["shift_db"], 0.0)]))
            for grid, place in points
        ]

    two_sides = parameter_grids(EFFECTS["lidar.threshold_shift"], ())
    # One side that ends soon has no weak point of its own: nothing to turn the sign of.
    short = replace(two_sides[1], points=two_sides[1].points[:2])
    grids = [*two_sides, replace(two_sides[1], mirror=short), short]
    search: Any = SimpleNamespace(templates=templates)
    for one in first_templates(search, grids, *TOP):
        assert one.response[0] == min(one.values["shift_db"], 0.0)
