"""Sets of effects on templates: against a search over a grid, and where bounds of the nuisances decide."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from torchweather.gap.inference.config import METHOD
from torchweather.gap.inference.effect_sets import BoundedMisfit, best_effect_pairs
from torchweather.gap.inference.response_templates import ResponseTemplate
from torchweather.gap.inference.starting_points import ParameterGrid
from torchweather.gap.inference.systematics import Systematics, together
from torchweather.lidar.effects.all import EFFECTS

RNG = np.random.default_rng
NAMES = ("lidar.window_loss", "lidar.range_noise", "lidar.crosstalk", "lidar.wet_target")


def templates(responses: np.ndarray) -> list[ResponseTemplate]:
    """One of each effect."""
    grids = [ParameterGrid(EFFECTS[name], ({},)) for name in NAMES]
    return [ResponseTemplate(grid, 0, {}, one) for grid, one in zip(grids, responses, strict=False)]


def free(number: int) -> tuple[np.ndarray, np.ndarray]:
    return np.full(number, -np.inf), np.full(number, np.inf)


@pytest.mark.parametrize("seed", range(3))
def test_the_misfit_within_bounds_is_the_least_of_all_on_a_grid(seed: int) -> None:
    """Two amplitudes in steps of 0.0135, one nuisance in steps of 0.02 that may go from -1 to 0.5."""
    generator = RNG(seed)
    responses, response = generator.normal(size=(2, 6)), generator.normal(size=(6, 1))
    residual = responses.T @ np.array([0.5, 1.0]) + 3.0 * response[:, 0]
    misfit = BoundedMisfit(residual, Systematics(response, np.array([0.2]), 1), np.array([-1.0]), np.array([0.5]))
    amplitude = np.linspace(0.0, METHOD.template_amplitudes[1], 101)
    place = np.linspace(-1.0, 0.5, 76)
    first, second, stands = np.meshgrid(amplitude, amplitude, place, indexing="ij")
    left = residual - first[..., None] * responses[0] - second[..., None] * responses[1]
    left = left - (stands - 0.2)[..., None] * response[:, 0]
    costs = (left**2).sum(-1) + stands**2
    found, amplitudes = misfit(list(responses))
    # Half a step off in each of three directions costs at most the curvature there.
    curvature = (responses**2).sum() * 0.0135**2 + ((response**2).sum() + 1.0) * 0.02**2
    assert found - 1e-9 <= costs.min() <= found + curvature
    assert (amplitudes >= 0.0).all()
    assert (amplitudes <= METHOD.template_amplitudes[1]).all()


def test_without_bounds_the_misfit_is_that_of_the_nuisances() -> None:
    generator = RNG(4)
    nuisance = Systematics(generator.normal(size=(20, 5)), generator.normal(size=5), 5, together(5, 3))
    residual = generator.normal(size=20)
    assert BoundedMisfit(residual, nuisance, *free(5)).alone == pytest.approx(nuisance.misfit(residual), rel=1e-9)


@pytest.mark.parametrize(("bound", "close"), [(np.inf, True), (4.0, False)])
def test_a_pair_that_needs_a_record_far_off_stays_behind_within_bounds(bound: float, close: bool) -> None:
    """The first two effects are hidden. The fourth, and a badly known record twelve of its units off, look the same."""
    responses = np.zeros((4, 30))
    responses[0, :10], responses[1, 10:20], responses[2, 20:22], responses[3, 10:20] = 3.0, 6.0, 1.0, 1.2
    responses[3, 22:30] = 0.1
    response = np.zeros((30, 1))
    response[10:20, 0] = 0.4
    nuisance = Systematics(response, np.zeros(1), 1, np.array([[0.05]]))
    misfit = BoundedMisfit(responses[0] + responses[1], nuisance, np.array([-bound]), np.array([bound]))
    gains = {
        frozenset(template.id for template in one.templates): one.gain
        for one in best_effect_pairs(templates(responses), nuisance, misfit, 1.0)
    }
    true, other = gains[frozenset(NAMES[:2])], gains[frozenset((NAMES[0], NAMES[3]))]
    assert true == max(gains.values())
    assert (true - other < 10.0) == close


def test_pairs_are_of_different_effects_each_once_best_first_and_better_than_one_alone() -> None:
    generator = RNG(7)
    responses = generator.normal(size=(4, 40))
    nuisance = Systematics(np.zeros((40, 1)), np.zeros(1), 1)
    residual = responses.T @ np.array([3.0, 1.0, 0.5, 0.0]) + 0.1 * generator.normal(size=40)
    misfit = BoundedMisfit(residual, nuisance, *free(1))
    found = best_effect_pairs(templates(responses), nuisance, misfit, 0.0)
    keys = [frozenset(template.id for template in one.templates) for one in found]
    assert len(set(keys)) == len(keys)
    assert all(len(key) == 2 for key in keys)
    gains = [one.gain for one in found]
    assert gains == sorted(gains, reverse=True)
    alone = max(misfit.alone - misfit([one])[0] for one in responses)
    assert all(gain >= alone for gain in gains)
    least = gains[0] - alone + 1e-6
    assert best_effect_pairs(templates(responses), nuisance, misfit, least) == []
    pairs = itertools.combinations(range(4), 2)
    assert gains[0] == pytest.approx(max(misfit.alone - misfit([responses[a], responses[b]])[0] for a, b in pairs))
