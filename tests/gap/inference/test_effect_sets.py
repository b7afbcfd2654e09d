"""Sets of effects on templates: against least squares of every pair, and where bounds of the nuisances decide."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import lsq_linear

from torchweather.gap.inference.config import NUMERICS
from torchweather.gap.inference.effect_sets import best_effect_pairs, best_single_effects
from torchweather.gap.inference.response_templates import ResponseTemplate
from torchweather.gap.inference.starting_points import ParameterGrid
from torchweather.gap.inference.systematics import Bounds, Systematics
from torchweather.lidar.effects.all import EFFECTS

RNG = np.random.default_rng
NAMES = ("lidar.window_loss", "lidar.range_noise", "lidar.crosstalk", "lidar.wet_target")


def templates(responses: np.ndarray) -> list[ResponseTemplate]:
    """One of each effect."""
    grids = [ParameterGrid(EFFECTS[name], ({},)) for name in NAMES]
    return [ResponseTemplate(grid, 0, {}, one) for grid, one in zip(grids, responses, strict=False)]


@pytest.mark.parametrize(("bound", "close"), [(np.inf, True), (4.0, False)])
def test_a_pair_that_needs_a_record_far_off_stays_behind_within_bounds(bound: float, close: bool) -> None:
    """The first two effects are hidden. The fourth, and a badly known record twelve of its units off, look the same."""
    responses = np.zeros((4, 30))
    responses[0, :10], responses[1, 10:20], responses[2, 20:22], responses[3, 10:20] = 3.0, 6.0, 1.0, 1.2
    responses[3, 22:30] = 0.1
    response = np.zeros((30, 1))
    response[10:20, 0] = 0.4
    nuisance = Systematics(response, np.zeros(1), 1, np.array([[0.05]]))
    residual, bounds = responses[0] + responses[1], Bounds(np.array([-bound]), np.array([bound]))
    gains = {
        frozenset(template.id for template in one.templates): one.gain
        for one in best_effect_pairs(templates(responses), residual, nuisance, bounds, 1.0)
    }
    true, other = gains[frozenset(NAMES[:2])], gains[frozenset((NAMES[0], NAMES[3]))]
    assert true == max(gains.values())
    assert (true - other < 10.0) == close


def test_pairs_are_of_different_effects_each_once_best_first_and_better_than_one_alone() -> None:
    generator = RNG(7)
    responses = generator.normal(size=(4, 40))
    nuisance = Systematics(np.zeros((40, 1)), np.zeros(1), 1)
    residual = responses.T @ np.array([3.0, 1.0, 0.5, 0.0]) + 0.1 * generator.normal(size=40)
    bounds = Bounds(np.full(1, -np.inf), np.full(1, np.inf))

    def gain(*places: int) -> float:
        """By least squares of the amplitudes that lie within 0 and 1.35."""
        columns = responses[list(places)].T
        found = lsq_linear(columns, residual, NUMERICS.template_amplitudes)
        return float((residual**2).sum() - 2.0 * found.cost)

    found = best_effect_pairs(templates(responses), residual, nuisance, bounds, 0.0)
    keys = [frozenset(template.id for template in one.templates) for one in found]
    assert len(set(keys)) == len(keys)
    assert all(len(key) == 2 for key in keys)
    gains = [one.gain for one in found]
    assert gains == sorted(gains, reverse=True)
    alone = max(gain(place) for place in range(4))
    assert all(one >= alone for one in gains)
    assert gains[0] == pytest.approx(max(gain(*pair) for pair in itertools.combinations(range(4), 2)))
    least = gains[0] - alone + 1e-6
    assert best_effect_pairs(templates(responses), residual, nuisance, bounds, least) == []


@pytest.mark.parametrize(("bound", "best"), [(2.0, NAMES[0]), (np.inf, NAMES[1])])
def test_what_a_nuisance_has_gone_far_to_stand_for_is_told_with_the_nuisance_near(bound: float, best: str) -> None:
    """The first effect is hidden, in two entries twice as strong as its response. A gain ten of its units off looks as
    it does in the others, another effect as in those two."""
    responses = np.zeros((3, 20))
    responses[0], responses[1, :2], responses[2, 2:4] = 1.0, 1.0, 0.1
    response = np.r_[np.full(2, 0.02), np.full(18, 0.1)][:, None]
    nuisance = Systematics(response, np.array([9.0]), 1, np.array([[1e-4]]))
    residual = responses[0] + responses[1] - 9.0 * response[:, 0]
    some = templates(responses) + [replace(one, number=1, response=0.5 * one.response) for one in templates(responses)]
    found = best_single_effects(some, residual, nuisance, Bounds(np.array([-bound]), np.array([bound])))
    names = [one.templates[0].id for one in found]
    assert names[0] == best
    assert sorted(names) == sorted(NAMES[:3])
    gains = [one.gain for one in found]
    assert gains == sorted(gains, reverse=True)
