"""The algebra of nuisances and of responses against dense least squares and against grids of amplitudes."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from torchweather.gap.inference.config import NUMERICS
from torchweather.gap.inference.response_templates import ResponseTemplate, amplitudes, delta_chi2, pair_delta_chi2
from torchweather.gap.inference.starting_points import ParameterGrid
from torchweather.gap.inference.systematics import Bounds, Systematics, bounded_step, moving_only, together
from torchweather.lidar.effects.all import EFFECTS

RNG = np.random.default_rng
SIZE, MOVING, FIXED = 40, 3, 4


def nuisance(offset: Any = (0.0, 0.0, 0.0), scale: float = 1.0) -> Systematics:
    """Moving nuisances at an offset, and fixed ones, whose offset is always 0."""
    response = scale * RNG(1).normal(size=(SIZE, MOVING + FIXED))
    return Systematics(response, np.concatenate([offset, np.zeros(FIXED)]), MOVING)


OFFSETS = [(0.0, 0.0, 0.0), (0.7, -1.5, 3.0)]


def least_squares(one: Systematics, residual: Any, columns: slice = slice(None)) -> tuple[Any, float]:
    """min over d of |r - G d|^2 + |x + d|^2, the d of some columns, by one dense solution."""
    response, offset = one.response[:, columns], one.offset[columns]
    matrix = np.vstack([response, np.eye(response.shape[1])])
    wanted = np.concatenate([residual, -offset])
    step = np.linalg.lstsq(matrix, wanted, rcond=None)[0]
    return step, float(((wanted - matrix @ step) ** 2).sum())


@pytest.mark.parametrize("offset", OFFSETS)
def test_step_left_and_misfit_are_those_of_least_squares_with_a_prior(offset: Any) -> None:
    one, residual = nuisance(offset), RNG(2).normal(size=SIZE)
    step, squares = least_squares(one, residual)
    np.testing.assert_allclose(one.step(residual), step, rtol=1e-9)
    np.testing.assert_allclose(one.left(residual), residual - one.response @ step, rtol=1e-9, atol=1e-12)
    assert one.misfit(residual) == pytest.approx(squares, rel=1e-10)


@pytest.mark.parametrize("offset", OFFSETS)
def test_the_cost_moves_what_the_simulator_cannot_and_leaves_the_rest_where_it_stands(offset: Any) -> None:
    one, residual = nuisance(offset), RNG(3).normal(size=SIZE)
    _, squares = least_squares(one, residual, slice(MOVING, None))
    assert one.cost(residual) == pytest.approx(squares + float(np.square(offset).sum()), rel=1e-10)
    # Where all has been moved to its best, the cost is the misfit.
    step = one.step(residual)
    there = one.moved(one.offset[:MOVING] + step[:MOVING])
    after = residual - one.response[:, :MOVING] @ step[:MOVING]
    assert there.cost(after) == pytest.approx(one.misfit(residual), rel=1e-10)
    assert there.misfit(after) == pytest.approx(one.misfit(residual), rel=1e-10)
    np.testing.assert_allclose(there.step(after)[:MOVING], 0.0, atol=1e-10)


def test_moved_nuisances_are_new_ones_at_that_offset() -> None:
    one, residual = nuisance().moved(nuisance(OFFSETS[1]).offset[:MOVING]), RNG(4).normal(size=SIZE)
    same = nuisance(OFFSETS[1])
    assert one.misfit(residual) == same.misfit(residual)
    assert one.cost(residual) == same.cost(residual)
    np.testing.assert_array_equal(nuisance().offset, np.zeros(MOVING + FIXED))  # the first one stays


def test_what_is_put_behind_explains_as_well_and_is_taken_off_again() -> None:
    """Against nuisances that have had those columns from the beginning, with the precision of one gauge for the first
    ones."""
    one, columns, residual = of_one_gauge(OFFSETS[1]), RNG(9).normal(size=(SIZE, 2)), RNG(10).normal(size=SIZE)
    wider = one.beside(columns)
    number = MOVING + FIXED + 2
    whole = Systematics(
        np.hstack([one.response, columns]),
        np.concatenate([one.offset, np.zeros(2)]),
        MOVING,
        together(number, MOVING),
    )
    assert (wider.behind, one.behind) == (2, 0)
    assert wider.misfit(residual) == pytest.approx(whole.misfit(residual), rel=1e-10)
    assert wider.misfit(residual) < one.misfit(residual)
    # They stay behind where the others move, and where more is put behind them.
    there = wider.moved(np.zeros(MOVING)).beside(columns[:, :1])
    assert there.behind == 3
    again = there.without_behind()
    assert again.behind == 0
    assert again.misfit(residual) == pytest.approx(one.moved(np.zeros(MOVING)).misfit(residual), rel=1e-12)
    assert one.beside(columns[:, :0]) is one


def test_the_projection_is_that_of_the_formula() -> None:
    one = nuisance(OFFSETS[1])  # where they stand counts for nothing
    g = one.response
    expected = np.eye(SIZE) - g @ np.linalg.inv(g.T @ g + np.eye(g.shape[1])) @ g.T
    np.testing.assert_allclose(one(np.eye(SIZE)), expected, atol=1e-12)
    values = np.linalg.eigvalsh(expected)
    assert 0.0 < values.min() < values.max() == pytest.approx(1.0, abs=1e-12)
    residual = RNG(5).normal(size=SIZE)
    np.testing.assert_allclose(nuisance()(residual), nuisance().left(residual), atol=1e-12)


def test_the_projection_takes_all_where_the_response_is_large_and_nothing_where_it_is_small() -> None:
    strong, weak = (nuisance(scale=scale)(np.eye(SIZE)) for scale in (1e4, 1e-4))
    # 1 / (1 + |G|^2) of what it takes is left: |G|^2 = 40 x 1e8, less where columns are alike.
    np.testing.assert_allclose(strong @ strong, strong, atol=1e-8)
    np.testing.assert_allclose(strong @ nuisance().response, 0.0, atol=1e-7)
    np.testing.assert_allclose(weak, np.eye(SIZE), atol=1e-6)


def test_an_intensity_error_within_its_record_costs_its_prior_alone() -> None:
    response = 5.0 * RNG(6).normal(size=(SIZE, 1))
    one, norm = Systematics(response, np.zeros(1), 1), float((response**2).sum())
    for sds in (-1.0, 0.5, 2.0):
        # |G n|^2 / (1 + |G|^2) = n^2 (1 - 1 / (1 + |G|^2)): the intensity's own prior and no more.
        assert one.misfit(sds * response[:, 0]) == pytest.approx(sds**2 * norm / (1.0 + norm), rel=1e-10)
        assert one.step(sds * response[:, 0])[0] == pytest.approx(sds * norm / (1.0 + norm), rel=1e-10)


# ---- nuisances that go together --------------------------------------------------------------------------------------


def of_one_gauge(offset: Any = (0.0, 0.0, 0.0)) -> Systematics:
    """The moving ones have a part in common."""
    plain = nuisance(offset)
    return Systematics(plain.response, plain.offset, MOVING, together(MOVING + FIXED, MOVING))


def test_a_common_part_is_a_nuisance_of_its_own_that_moves_all_of_them() -> None:
    """Against least squares with one more unknown, from an offset of 0: either has half of the variance."""
    one, residual = of_one_gauge(), RNG(7).normal(size=SIZE)
    own, others = np.sqrt(0.5) * one.response[:, :MOVING], one.response[:, MOVING:]
    more = Systematics(np.hstack([own, others, own.sum(1, keepdims=True)]), np.zeros(MOVING + FIXED + 1), MOVING)
    assert one.misfit(residual) == pytest.approx(more.misfit(residual), rel=1e-10)
    np.testing.assert_allclose(one.left(residual), more.left(residual), rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(one(np.eye(SIZE)), more(np.eye(SIZE)), atol=1e-12)
    expected = np.sqrt(0.5) * (more.step(residual)[:MOVING] + more.step(residual)[-1])
    np.testing.assert_allclose(one.step(residual)[:MOVING], expected, rtol=1e-9)


def test_records_that_are_all_off_alike_cost_less_than_each_by_itself() -> None:
    """2 (1 + J)^-1 of three: two standard deviations alike cost 6, as does one alone, +2 and -2 cost 16; a single
    record has its own standard deviation."""
    nothing = np.zeros(SIZE)
    for place, cost in (((2.0, 2.0, 2.0), 6.0), ((2.0, 0.0, 0.0), 6.0), ((2.0, -2.0, 0.0), 16.0)):
        assert of_one_gauge(place).cost(nothing) == pytest.approx(cost, rel=1e-12)
        assert of_one_gauge().moved(np.array(place)).cost(nothing) == pytest.approx(cost, rel=1e-12)
    assert together(1, 1).tolist() == [[1.0]]


def test_the_cost_of_where_they_stand_and_the_step_from_there_agree() -> None:
    one, residual = of_one_gauge(OFFSETS[1]), RNG(8).normal(size=SIZE)
    step = one.step(residual)
    there = one.moved(one.offset[:MOVING] + step[:MOVING])
    after = residual - one.response[:, :MOVING] @ step[:MOVING]
    assert there.cost(after) == pytest.approx(one.misfit(residual), rel=1e-10)
    np.testing.assert_allclose(there.step(after)[:MOVING], 0.0, atol=1e-10)


def test_drawn_nuisances_have_their_covariance() -> None:
    one, number = of_one_gauge(), 200_000
    found = one.drawn(RNG(9), number)
    covariance = np.eye(MOVING + FIXED)
    covariance[:MOVING, :MOVING] = 0.5 * (np.eye(MOVING) + 1.0)
    expected = one.response @ covariance @ one.response.T
    # 200,000 draws: 5 x sqrt(2 / 200,000) = 1.6 % of the largest.
    np.testing.assert_allclose(found.T @ found / number, expected, atol=0.016 * np.abs(expected).max())


# ---- responses -------------------------------------------------------------------------------------------------------


def templates(responses: Any) -> list[ResponseTemplate]:
    grid = ParameterGrid(EFFECTS["lidar.window_loss"], ({"loss_db": 1.0},))
    return [ResponseTemplate(grid, 0, {"loss_db": 1.0}, response) for response in responses]


GRID = np.linspace(*NUMERICS.template_amplitudes, 541)  # steps of 0.0025


@pytest.mark.parametrize("offset", OFFSETS)
def test_an_amplitude_is_the_best_of_a_grid_and_a_gain_what_it_takes_off_the_misfit(offset: Any) -> None:
    one = nuisance(offset)
    # Along the first response, against it, and beyond the amplitudes that are believed.
    responses = RNG(7).normal(size=(4, SIZE))
    rows = np.stack([responses[0], -responses[1], 3.0 * responses[2], RNG(8).normal(size=SIZE)])
    left = np.stack([one.left(row) for row in rows])
    found, norm = amplitudes(templates(responses), left, one)
    gain = delta_chi2(templates(responses), left, one)
    np.testing.assert_allclose(norm, [float(response @ one(response)) for response in responses], rtol=1e-10)
    for place, row in enumerate(rows):
        for number, response in enumerate(responses):
            misfit = np.array([one.misfit(row - amplitude * response) for amplitude in GRID])
            # Half a step off the best amplitude, a grid misses its square times the norm.
            missed = 0.25 * (GRID[1] ** 2) * norm[number]
            assert 0.0 <= gain[place, number] - (misfit[0] - misfit.min()) + 1e-9 < missed + 2e-9
            assert found[place, number] == pytest.approx(GRID[misfit.argmin()], abs=0.51 * GRID[1])
    assert NUMERICS.template_amplitudes[0] in found
    assert NUMERICS.template_amplitudes[1] in found


def test_a_gain_is_the_whole_square_of_a_response_itself_and_none_of_its_opposite() -> None:
    one, response = nuisance(), RNG(9).normal(size=SIZE)
    square = float(response @ one(response))
    left = one(np.stack([response, -response, 3.0 * response]))
    # No more than 1.35 times a response is believed: 2 a 3 - a^2 squares.
    expected = [square, 0.0, (6.0 * NUMERICS.template_amplitudes[1] - NUMERICS.template_amplitudes[1] ** 2) * square]
    np.testing.assert_allclose(delta_chi2(templates([response]), left, one)[:, 0], expected, rtol=1e-12)


@pytest.mark.parametrize("seed", range(4))
def test_the_gain_of_a_pair_is_the_best_of_a_grid_of_both_amplitudes(seed: int) -> None:
    one = nuisance(OFFSETS[seed % 2])
    rng = RNG([10, seed])
    responses = rng.normal(size=(5, SIZE))
    responses[3] = 0.8 * responses[2] + 0.05 * rng.normal(size=SIZE)  # nearly the same
    residual = 0.9 * responses[0] + 0.4 * responses[1] - 0.5 * responses[4] + rng.normal(size=SIZE)
    left = one.left(residual)
    found = pair_delta_chi2(templates(responses), left, one)
    np.testing.assert_allclose(found, found.T, rtol=1e-9)
    first, second = np.meshgrid(GRID, GRID, indexing="ij")
    for i in range(5):
        for j in range(i):
            a, b = responses[i], responses[j]
            own, other, both = (float(x @ one(y)) for x, y in ((a, a), (b, b), (a, b)))
            gain = 2.0 * (first * float(a @ left) + second * float(b @ left))
            gain -= first**2 * own + second**2 * other + 2.0 * first * second * both
            missed = 0.25 * GRID[1] ** 2 * (own + other + 2.0 * abs(both))
            assert 0.0 <= found[i, j] - gain.max() + 1e-9 < missed + 2e-9
    alone = delta_chi2(templates(responses), left[None], one)[0]
    assert (found >= np.maximum(alone[:, None], alone[None]) - 1e-9).all()


def test_two_halves_of_a_residual_are_found_together() -> None:
    """Each alone explains little of a difference of nearly opposite things; both explain all of it."""
    one = Systematics(np.zeros((SIZE, 1)), np.zeros(1), 1)
    common, own = RNG(11).normal(size=(2, SIZE))
    first, second = common + 0.1 * own, -common + 0.1 * own
    residual = first + second
    single = delta_chi2(templates([first, second]), residual[None], one)[0]
    pair = pair_delta_chi2(templates([first, second]), residual, one)[0, 1]
    assert pair == pytest.approx(float(residual @ residual), rel=1e-9)
    assert single.max() < 0.1 * pair


@pytest.mark.parametrize("seed", range(3))
def test_a_step_within_bounds_leaves_the_least_of_all_on_a_grid(seed: int) -> None:
    """Two amplitudes in steps of 0.0135, one nuisance in steps of 0.02 that may go from -1 to 0.5."""
    generator = RNG(seed)
    columns, response = generator.normal(size=(6, 2)), generator.normal(size=(6, 1))
    residual = columns @ np.array([0.5, 1.0]) + 3.0 * response[:, 0]
    limits, bounds = Bounds(np.zeros(2), np.full(2, 1.35)), Bounds(np.array([-1.0]), np.array([0.5]))
    found = bounded_step(residual, Systematics(response, np.array([0.2]), 1), bounds, columns, limits)
    first, second, stands = np.meshgrid(*2 * [np.linspace(0.0, 1.35, 101)], np.linspace(-1.0, 0.5, 76), indexing="ij")
    left = residual - first[..., None] * columns[:, 0] - second[..., None] * columns[:, 1]
    costs = ((left - (stands - 0.2)[..., None] * response[:, 0]) ** 2).sum(-1) + stands**2
    # Half a step off in each of three directions costs at most the curvature there.
    curvature = (columns**2).sum() * 0.0135**2 + ((response**2).sum() + 1.0) * 0.02**2
    assert found.misfit - 1e-9 <= costs.min() <= found.misfit + curvature
    assert (found.amplitudes >= 0.0).all()
    assert (found.amplitudes <= 1.35).all()
    assert -1.0 <= 0.2 + found.aside[0] <= 0.5


@pytest.mark.parametrize("ridge", [0.0, 0.5])
def test_a_step_within_wide_bounds_is_that_of_the_normal_equations(ridge: float) -> None:
    generator = RNG(4)
    nuisance = Systematics(generator.normal(size=(20, 5)), generator.normal(size=5), 5, together(5, 3))
    columns, residual = generator.normal(size=(20, 2)) * [1.0, 1e-4], generator.normal(size=20)
    wide = Bounds(np.full(5, -1e9), np.full(5, 1e9)), columns, Bounds(np.full(2, -1e9), np.full(2, 1e9))
    held = ridge * np.sqrt((columns**2).sum(0))
    found = bounded_step(residual, nuisance, *wide, held)
    normal = columns.T @ nuisance(columns.T).T + np.diag(held**2)
    expected = np.linalg.solve(normal, columns.T @ nuisance.left(residual))
    assert found.amplitudes == pytest.approx(expected, rel=1e-6)
    assert found.aside == pytest.approx(nuisance.step(residual - columns @ expected), rel=1e-6)
    assert found.misfit == pytest.approx(nuisance.misfit(residual - columns @ expected), rel=1e-9)


@pytest.mark.parametrize("seed", range(3))
def test_without_nuisances_that_do_not_move_a_step_leaves_the_same(seed: int) -> None:
    """Three that move between bounds, two of them together, and four that do not, one with its own prior; any column
    and any two."""
    generator = RNG(seed)
    precision = together(7, 2)
    precision[5, 5] = 0.3
    offset = np.concatenate([generator.normal(size=6), [0.7]])
    nuisance = Systematics(generator.normal(size=(40, 7)), offset, 3, precision)
    columns, residual = generator.normal(size=(40, 4)), 2.0 * generator.normal(size=40)
    bounds = Bounds(np.r_[np.full(3, -0.5), np.full(4, -np.inf)], np.r_[np.full(3, 0.4), np.full(4, np.inf)])
    left, moving, few = moving_only(residual, nuisance, columns)
    assert few.shape == (8, 4)
    near = Bounds(bounds.low[:3], bounds.high[:3])
    for places in ([], [0], [2], [1, 3]):
        limits = Bounds(np.zeros(len(places)), np.full(len(places), 1.35))
        whole = bounded_step(residual, nuisance, bounds, columns[:, places], limits)
        found = bounded_step(left, moving, near, few[:, places], limits)
        assert found.misfit == pytest.approx(whole.misfit, rel=1e-9)
        assert found.amplitudes == pytest.approx(whole.amplitudes, abs=1e-6)
        assert found.aside == pytest.approx(whole.aside[:3], abs=1e-6)
