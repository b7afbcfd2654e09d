"""The search: the nuisance it forgets, parameters it finds again, studies that lack nothing."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
import torch

from tests.gap.tiny_study import tiny_study
from torchweather.gap.baseline import targets
from torchweather.gap.candidates import Line
from torchweather.gap.lidar import LidarFrames
from torchweather.gap.search import AMPLITUDES, Node, Nuisance, Search, Setting, gains
from torchweather.gap.study import Study
from torchweather.gap.workflow import ALARM_P, find_gap_with, screen
from torchweather.stages.effects import Effect
from torchweather.stages.effects_lidar import EFFECTS
from torchweather.weather import Snow

RNG = np.random.default_rng
WEATHERS = (Snow(2.0), Snow(1.2))
SCREENED = (
    "lidar.window_loss",
    "lidar.threshold_shift",
    "lidar.extinction_scale",
    "lidar.range_noise",
    "lidar.range_bias",
    "lidar.crosstalk",
    "lidar.particle_backscatter",
)


def small(effects: Sequence[Effect] = (), seed: int = 0) -> Study:
    return tiny_study(effects, seed=seed, rows=16, columns=32, frames=5, weathers=WEATHERS)


def search_of(study: Study, seed: int = 0, effects: Sequence[Effect] = ()) -> Search:
    model = LidarFrames(study, effects=effects)
    return Search(model, targets(model, study.fit), seed, pool_frames=32)


@pytest.fixture(scope="module")
def null() -> Search:
    return search_of(small())


# ---- the nuisance ----------------------------------------------------------------------------------------------------


def nuisance(knobs: int = 2, others: int = 3, size: int = 40) -> Nuisance:
    response = RNG(1).normal(size=(size, knobs + others))
    return Nuisance(response, np.array([0.1, 0.2][:knobs]))


def matrix(one: Nuisance) -> Any:
    return one(np.eye(len(one.response)))


def test_the_projection_is_that_of_the_formula_and_symmetric() -> None:
    one = nuisance()
    g = one.response
    expected = np.eye(len(g)) - g @ np.linalg.inv(g.T @ g + np.eye(g.shape[1])) @ g.T
    np.testing.assert_allclose(matrix(one), expected, atol=1e-12)
    np.testing.assert_allclose(matrix(one), matrix(one).T, atol=1e-12)
    values = np.linalg.eigvalsh(matrix(one))
    assert values.min() > 0.0
    assert values.max() == pytest.approx(1.0, abs=1e-12)


def test_the_square_of_what_is_left_is_that_of_the_best_errors_with_their_prior() -> None:
    """x' M x = min over n of |x - G n|^2 + |n|^2: a linear fit with a prior of 1."""
    one, x = nuisance(), RNG(2).normal(size=40)
    padded = np.vstack([one.response, np.eye(5)])
    best, squares, *_ = np.linalg.lstsq(padded, np.concatenate([x, np.zeros(5)]), rcond=None)
    assert float(x @ one(x)) == pytest.approx(float(squares[0]), rel=1e-10)
    np.testing.assert_allclose(one.log_knobs(x), best[:2] * np.array([0.1, 0.2]), rtol=1e-10)


def test_a_knob_error_within_its_record_costs_its_prior_alone() -> None:
    response = np.zeros((40, 1))
    response[:, 0] = 5.0 * RNG(3).normal(size=40)
    one = Nuisance(response, np.array([0.1]))
    norm = float(response[:, 0] @ response[:, 0])
    for sds in (-1.0, 0.5, 2.0):
        x = sds * response[:, 0]
        # |G n|^2 / (1 + |G|^2 ) = n^2 (1 - 1 / (1 + |G|^2)): the knob's own prior and no more.
        assert float(x @ one(x)) == pytest.approx(sds**2 * norm / (1.0 + norm), rel=1e-10)
        assert one.log_knobs(x)[0] == pytest.approx(sds * 0.1 * norm / (1.0 + norm), rel=1e-10)


def test_the_projection_is_idempotent_where_the_response_is_large_and_none_where_it_is_small() -> None:
    g = RNG(4).normal(size=(40, 3))
    strong, weak = (matrix(Nuisance(scale * g, np.full(3, 0.1))) for scale in (1e4, 1e-4))
    # 1 / (1 + |G|^2) of what it takes is left: |G|^2 = 40 x 1e8.
    np.testing.assert_allclose(strong @ strong, strong, atol=1e-8)
    np.testing.assert_allclose(strong @ g, 0.0, atol=1e-7)
    np.testing.assert_allclose(weak, np.eye(40), atol=1e-6)


def node(response: Any) -> Node:
    return Node(Line(EFFECTS["lidar.window_loss"], ({"loss_db": 1.0},)), 0, {"loss_db": 1.0}, response)


def test_a_gain_is_what_the_best_amplitude_takes_off_the_square() -> None:
    one = nuisance()
    x, responses = RNG(5).normal(size=(6, 40)), RNG(6).normal(size=(4, 40))
    found = gains([node(response) for response in responses], x, one)
    amplitudes = np.linspace(*AMPLITUDES, 20_001)
    for place, (row, response) in enumerate((a, b) for a in x for b in responses):
        left = row - amplitudes[:, None] * response
        lost = float(row @ one(row)) - np.einsum("ak,ak->a", left, one(left))
        assert found.ravel()[place] == pytest.approx(lost.max(), abs=1e-5)


def test_a_gain_is_never_negative_and_the_whole_square_of_a_response_itself() -> None:
    one, response = nuisance(), RNG(7).normal(size=40)
    assert gains([node(response)], -response[None], one)[0, 0] == 0.0
    square = float(response @ one(response))
    assert gains([node(response)], response[None], one)[0, 0] == pytest.approx(square, rel=1e-12)
    # No more than 1.35 times a response is believed: 2 a 3 - a^2 squares.
    expected = (6.0 * AMPLITUDES[1] - AMPLITUDES[1] ** 2) * square
    assert gains([node(response)], 3.0 * response[None], one)[0, 0] == pytest.approx(expected, rel=1e-12)


def test_null_residuals_have_the_moments_of_noise_and_nuisance(null: Search) -> None:
    one = null.nuisance(null.origin, null.start)
    counted = np.concatenate([null.start.used[aim.condition.id] for aim in null.measured])
    number = 4000
    found = null.null_residuals(one, number, 0)
    variance = counted + (one.response**2).sum(1)
    # 4,000 draws: 5 x sqrt(2 / 4,000) = 11 %.
    np.testing.assert_allclose(found.var(0), variance, rtol=0.12, atol=1e-12)
    assert (np.abs(found.mean(0)) <= 5.0 * np.sqrt(variance / number)).all()
    # What M leaves of noise with that covariance is one for each entry that counts: E x'Mx = tr(M (1 + G G')) = P.
    misfit = np.einsum("rk,rk->r", found, one(found))
    expected = counted.sum()
    assert misfit.mean() == pytest.approx(expected, abs=5.0 * math.sqrt(2.0 * expected / number))


# ---- the simulator ---------------------------------------------------------------------------------------------------


def test_same_seeds_give_the_same_search() -> None:
    study = small()
    first, again, other = search_of(study), search_of(study), search_of(study, seed=1)
    np.testing.assert_array_equal(first.residual(first.start), again.residual(again.start))
    setting = Setting({"lidar.window_loss": {"loss_db": 1.0}})
    for mine, theirs in zip(first.mean(setting), again.mean(setting), strict=True):
        np.testing.assert_array_equal(mine, theirs)
    assert not np.array_equal(first.residual(first.start), other.residual(other.start))


def test_one_thread_and_two_agree() -> None:
    before, found = torch.get_num_threads(), []
    study = tiny_study(rows=8, columns=32, weathers=(Snow(2.0), Snow(1.0), Snow(1.2)))
    setting = Setting({"lidar.window_loss": {"loss_db": 1.0}})
    try:
        for threads in (1, 2):
            torch.set_num_threads(threads)
            found.append(np.concatenate(search_of(study).mean(setting)))
    finally:
        torch.set_num_threads(before)
    # Conditions run side by side, each on one thread.
    np.testing.assert_allclose(found[0], found[1], rtol=1e-12, atol=1e-12)


def test_a_response_to_a_knob_is_that_of_a_study_whose_record_is_off(null: Search) -> None:
    """The column of a knob times n is the change that n standard deviations of the record make."""
    one = null.nuisance(null.origin, null.start)
    name = null.measured[0].condition.id
    sd = null.measured[0].knob_sd
    moved = null.mean(Setting({}, {name: sd}))[0] - null.mean(Setting({}, {name: -sd}))[0]
    np.testing.assert_allclose(one.response[:, 0], null.start.whitened(name, 0.5 * moved), atol=1e-9)
    assert np.abs(one.response[:, 0]).max() > 0.3
    assert one.log_knobs(one.response[:, 0])[0] == pytest.approx(sd, rel=0.5)


def test_a_derivative_is_the_change_per_unit_of_the_parameter(null: Search) -> None:
    name = ("lidar.window_loss", "loss_db")
    settings = [Setting({name[0]: {name[1]: value}}) for value in (1.0, 0.6, 1.4)]
    here, low, high = (null.mean(setting) for setting in settings)
    found = null._derivative(settings[0], name, here, null.start)
    expected = null.whitened(null.start, [(b - a) / 0.8 for a, b in zip(low, high, strict=True)])
    # A logarithm of intensities is linear in decibels; a few beams at the threshold are not.
    assert float(found @ expected) == pytest.approx(float(expected @ expected), rel=0.05)


# ---- parameters found again ------------------------------------------------------------------------------------------

HIDDEN = [
    ("lidar.window_loss", "loss_db", 2.0, 3.0),
    ("lidar.particle_backscatter", "gain_db", -3.0, -2.0),
    ("lidar.range_noise", "std_m", 0.05, 0.04),
    ("lidar.threshold_shift", "shift_db", 2.0, 1.5),
]


@pytest.mark.slow
@pytest.mark.parametrize(("name", "parameter", "truth", "start"), HIDDEN, ids=[one[0] for one in HIDDEN])
def test_a_hidden_parameter_is_found_within_three_standard_errors(
    name: str, parameter: str, truth: float, start: float
) -> None:
    """One study each: the errors are those of least squares, without what bootstrap adds (GAP.md 3 (8))."""
    search = search_of(small([EFFECTS[name](**{parameter: truth})], seed=1))
    fit = search.fit(Setting({name: {parameter: start}}))
    error = math.sqrt(float(fit.covariance[0, 0]))
    found = fit.setting.values[name][parameter]
    assert fit.names == ((name, parameter),)
    assert abs(found - truth) < 3.0 * error
    assert abs(found - truth) < 0.1 * abs(truth)
    assert error < 0.15 * abs(truth)  # three of them tell it from nothing, and from half and twice
    # What is left is what noise leaves.
    counted = sum(int(fit.base.used[aim.condition.id].sum()) for aim in search.measured)
    before = search.residual(search.start)
    assert fit.misfit < 1.3 * counted < float(before @ before)


# ---- studies that lack nothing ---------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1])
def test_a_study_that_lacks_nothing_raises_no_alarm(seed: int) -> None:
    search = search_of(small(seed=seed + 10))
    search.settle()
    one = search.nuisance(search.origin, search.start)
    found = screen(search, [EFFECTS[name] for name in SCREENED], one, seed)
    assert found.p_value > ALARM_P


@pytest.mark.slow
def test_a_hidden_effect_raises_an_alarm_and_with_it_in_the_model_there_is_none() -> None:
    window = EFFECTS["lidar.window_loss"](loss_db=1.0)
    study = small([window], seed=2)
    search = search_of(study)
    one = search.nuisance(search.origin, search.start)
    names = ["lidar.window_loss", "lidar.range_noise"]
    found = screen(search, [EFFECTS[name] for name in names], one, 0)
    assert found.p_value < 1e-6
    assert found.nodes[int(found.gains.argmax())].id == "lidar.window_loss"
    others = [name for name in SCREENED if name != "lidar.window_loss"]
    with_it = find_gap_with(LidarFrames(study, effects=[window]), study, effects=others)
    assert with_it.verdict == "none"
    assert with_it.screening.misfit < 1.3 * with_it.screening.counted < 0.5 * found.misfit
