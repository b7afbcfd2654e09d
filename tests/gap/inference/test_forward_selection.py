"""Forward selection on a simulator whose answer is known, its candidates, and a search for a single effect.

The linear simulator (``linear_simulator.py``) has by algebra what must be found: which effects, how strong, and what is
left that no effect explains.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tests.gap.linear_simulator import DIRECTIONS, SIZE, UNKNOWN, LinearSimulator, effect, strength_of, unknown
from tests.gap.tiny_study import tiny_study
from torchweather.atmosphere.weather import Snow
from torchweather.gap.find import find_gap
from torchweather.gap.gap_report import gap_report
from torchweather.gap.inference import forward_selection
from torchweather.gap.inference.candidate_fits import (
    Candidate,
    _start,
    best_of_each_set,
    best_templates,
    hidden_templates,
    pairs_from_rest,
    unscaled_templates,
)
from torchweather.gap.inference.config import METHOD, NUMERICS
from torchweather.gap.inference.forward_selection import (
    GapResult,
    _that_earn,
    _verdict,
    _without_idle,
    find_gap_with,
)
from torchweather.gap.inference.global_test import _tail, located_templates, run_global_test
from torchweather.gap.inference.held_out import HeldOut
from torchweather.gap.inference.likelihood import SimulatorLikelihood
from torchweather.gap.inference.residual_tests import ResidualTest
from torchweather.gap.inference.response_templates import ResponseTemplate, delta_chi2
from torchweather.gap.inference.simulated_conditions import ParameterPoint
from torchweather.gap.inference.simulated_distribution import observations
from torchweather.gap.inference.starting_points import ParameterGrid, parameter_grids
from torchweather.gap.inference.systematics import BoundedStep, Systematics
from torchweather.gap.sensors.lidar.frames import LidarFrames
from torchweather.gap.study.study import Study
from torchweather.lidar.effects.all import EFFECTS, LidarWindowLoss

RNG = np.random.default_rng
WEATHERS = (Snow(2.0), Snow(1.2))
WINDOW, EXTINCTION, NOISE, WET, BIAS = DIRECTIONS


def searched(*hidden: tuple[str, float], allowed: Sequence[str] | None = None, **more: Any) -> GapResult:
    """The search on frames with hidden effects, each of a strength."""
    return find_gap_with(LinearSimulator([effect(*one) for one in hidden], **more), effects=allowed)


def found_in(result: GapResult) -> dict[str, float]:
    """Effects of the final point and their strengths; none where none is named."""
    if result.fit is None:
        return {}
    return {name: strength_of(name, values) for name, values in result.fit.point.values.items()}


def likelihood_of(model: LinearSimulator) -> SimulatorLikelihood:
    """The fitted conditions against the simulator."""
    return SimulatorLikelihood(model, observations(model, model.fit), 0)


def template(name: str, values: dict[str, float], response: Any) -> ResponseTemplate:
    return ResponseTemplate(ParameterGrid(EFFECTS[name], (values,)), 0, values, np.asarray(response, dtype=np.float64))


def fit_of(values: dict[str, dict[str, float]], misfit: float) -> Any:
    """A fit as far as candidates are compared."""
    point = SimpleNamespace(values=values, without=lambda name: None)
    return SimpleNamespace(point=point, misfit=misfit, nuisance=None, base=None)


NOTHING = Systematics(np.zeros((4, 1)), np.zeros(1), 1)
TEMPLATES = [
    template("lidar.window_loss", {"loss_db": 1.0}, [1.0, 0.0, 0.0, 0.0]),
    template("lidar.window_loss", {"loss_db": 3.0}, [3.0, 0.5, 0.0, 0.0]),
    template("lidar.range_noise", {"std_m": 0.1}, [0.0, 2.0, 0.0, 0.0]),
    template("lidar.crosstalk", {"probability": 0.1}, [0.0, 0.0, 1.0, 0.0]),
]


# ---- names -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(4))
def test_nothing_is_named_where_nothing_is_hidden(seed: int) -> None:
    """Nor where the record is off by what it states, nor of an effect that the model has."""
    for more in ({}, {"record": 0.15}, {"effects": [effect(WINDOW, 0.5)]}):
        result = searched(seed=seed, **more)
        assert result.verdict == "none"
        assert found_in(result) == {}
        assert result.global_test.p_value > METHOD.alarm_p
        assert result.after.gap < 1.3 * result.after.floor


@pytest.mark.parametrize("name", list(DIRECTIONS))
@pytest.mark.parametrize("record", [0.0, 0.1])
def test_a_hidden_effect_is_named_with_its_strength(name: str, record: float) -> None:
    result = searched((name, 0.5), record=record)
    assert result.verdict == "named"
    assert list(found_in(result)) == [name]
    # Its bins hold 200 to 700 squares of 0.5 units: the strength is known to 1.3 %, and four of them.
    assert found_in(result)[name] == pytest.approx(0.5, rel=0.1)
    assert result.after.gap < 1.3 * result.after.floor < result.before.gap


def test_the_weaker_an_effect_the_less_it_alarms_and_below_noise_it_is_not_named() -> None:
    results = [searched((WINDOW, strength)) for strength in (0.02, 0.05, 0.1, 0.2)]
    assert [result.verdict for result in results] == ["none", "named", "named", "named"]
    chances = [result.global_test.p_value for result in results]
    assert chances == sorted(chances, reverse=True)
    assert chances[0] > METHOD.alarm_p > chances[1]


@pytest.mark.parametrize(
    "hidden",
    [
        [(WINDOW, 2.0), (NOISE, 0.3)],
        [(WINDOW, 2.0), (EXTINCTION, 0.3)],  # a third of whose bins the first one moves as well
        [(NOISE, 0.3), (BIAS, -0.3)],
        [(WINDOW, 0.5), (EXTINCTION, 0.4), (BIAS, -0.5)],
    ],
)
def test_several_hidden_effects_are_named_with_their_strengths(hidden: list[tuple[str, float]]) -> None:
    result = searched(*hidden)
    assert result.verdict == "named"
    assert found_in(result) == pytest.approx(dict(hidden), abs=0.05)


def test_no_more_than_so_many_effects_are_named() -> None:
    result = searched((NOISE, 0.3), (BIAS, -0.5), (WINDOW, 0.5), (EXTINCTION, 0.5))
    assert len(found_in(result)) == NUMERICS.max_effects
    assert result.verdict in ("named_and_rest", "unknown")


def test_a_limit_of_frames_ends_the_search_with_what_was_fitted_first() -> None:
    """Three effects take some thousand frames; with the limit in the midst of them the first one is still named."""
    hidden = [effect(WINDOW, 0.5), effect(EXTINCTION, 0.4), effect(BIAS, -0.5)]
    whole = find_gap_with(LinearSimulator(hidden), max_frames=10**6)
    assert not whole.search.exhausted
    assert found_in(whole) == found_in(find_gap_with(LinearSimulator(hidden)))
    short = find_gap_with(LinearSimulator(hidden), max_frames=1)
    assert short.search.exhausted
    assert short.search.simulated_frames < 0.7 * whole.search.simulated_frames
    assert len(short.rounds) == 1
    assert len(short.rounds[0]) == 1


def test_pairs_start_from_rest_whatever_the_record_was_led_to() -> None:
    hidden = [effect(NOISE, 0.5), effect(EXTINCTION, 0.5)]
    search = likelihood_of(LinearSimulator(hidden, record=0.15))
    base = search.begin()
    assert any(base.point.log_intensity.values())
    templates = run_global_test(search, [EFFECTS[name] for name in DIRECTIONS], base, 0).templates
    one = replace(base, point=ParameterPoint({EXTINCTION: {}}))
    proposed = pairs_from_rest(search, base, one, templates, 30.0)
    assert {NOISE, EXTINCTION} in [{*point.values, other.id} for point, other, _ in proposed]
    assert EXTINCTION not in [other.id for _, other, _ in proposed]  # what is there already is not what is added
    for point, _, amplitude in proposed:
        assert amplitude > 0.0
        assert not point.log_intensity
        assert not point.open


def test_a_set_that_was_fitted_twice_is_no_rival_of_itself() -> None:
    fits = [
        SimpleNamespace(misfit=misfit, point=ParameterPoint({key: {} for key in names}))
        for misfit, names in ((5.0, (NOISE, WINDOW)), (4.0, (WINDOW, NOISE)), (9.0, (WINDOW, BIAS)), (6.0, (BIAS,)))
    ]
    found = best_of_each_set([Candidate(next(iter(one.point.values)), one, 1.0) for one in fits])
    assert [one.fit.misfit for one in found] == [4.0, 6.0, 9.0]


@pytest.mark.parametrize(("share", "simulated"), [(1.0, 1), (0.25, 4)])
def test_a_step_is_doubled_only_where_the_least_lies_beyond_it(
    share: float, simulated: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """From 0.1 units to the least at 0.5, at once or by a quarter: four quarters are the least, eight are too many.

    A linear simulator that promised its least behind the step would fall by half of the slope times the step.
    """
    search = likelihood_of(LinearSimulator([effect(WINDOW, 0.5)]))
    base = search.begin()
    name = (WINDOW, "loss_db")

    def at(strength: float) -> ParameterPoint:
        return replace(search.origin, values={WINDOW: {"loss_db": strength}})

    def cost(strength: float) -> float:
        return base.nuisance.cost(search.departure(base.base, search.mean(at(strength))))

    costs = np.array([cost(strength) for strength in (0.0, 0.1, 0.2)])
    curvature = 0.5 * float(np.diff(costs, 2)[0]) / 0.01
    least = 0.1 - (costs[2] - costs[0]) / 0.2 / (2.0 * curvature)
    assert least == pytest.approx(0.5, abs=0.02)
    step = share * (least - 0.1)
    left = cost(0.1) - curvature * (least - 0.1) * step
    means: list[float] = []
    mean = search.mean
    monkeypatch.setattr(search, "mean", lambda *given: means.append(0.0) or mean(*given))
    whole = BoundedStep(np.array([step]), np.zeros(len(base.nuisance.offset)), left)
    found = search._along(at(0.1), [name], whole, cost(0.1), base.base, base.nuisance)
    assert found is not None
    assert found[1].values[WINDOW]["loss_db"] == pytest.approx(least, abs=0.02)
    assert len(means) - 1 == simulated  # and one for the cost at the start


@pytest.mark.parametrize("beside", [NOISE, EXTINCTION])
def test_a_further_effect_must_earn_its_place(beside: str) -> None:
    """By what noise gains, by two standard deviations on held-out conditions, and a share of what acts there."""
    for strength, number in ((0.04, 1), (0.05, 1), (0.15, 2), (0.2, 2)):
        result = searched((WINDOW, 2.0), (beside, strength))
        assert len(found_in(result)) == number, strength
        if number > 1:
            gained = result.rounds[-1][0].gain
            assert gained > np.quantile(result.global_test.best_null, 0.99)
            held = [one[0].held for one in result.rounds]
            assert held[0].misfit - held[1].misfit > METHOD.held_gain


def test_an_effect_that_is_an_error_of_the_record_is_not_named_beside_another() -> None:
    hidden = ((WINDOW, 0.5), (EXTINCTION, 0.3))
    assert set(found_in(searched(*hidden))) == {WINDOW, EXTINCTION}
    result = searched(*hidden, as_record=frozenset([EXTINCTION]))
    assert list(found_in(result)) == [WINDOW]
    assert result.verdict == "named_and_rest"


def test_effects_that_are_idle_beside_others_go() -> None:
    search = likelihood_of(LinearSimulator([effect(NOISE, 0.5)]))
    base = search.begin()
    three = {
        name: {one.name: float(getattr(effect(name, strength), one.name)) for one in EFFECTS[name].arguments}
        for name, strength in ((WINDOW, 0.01), (NOISE, 0.5), (BIAS, 0.01))
    }
    whole = search.fit(ParameterPoint(three), base.nuisance, base.base)
    kept = _without_idle(search, Candidate(BIAS, whole, 100.0), 30.0)
    assert set(kept.point.values) == {NOISE, BIAS}  # the last one earns its place elsewhere
    assert kept.misfit < whole.misfit + 60.0


def test_an_effect_that_was_led_to_where_it_does_nothing_goes(monkeypatch: pytest.MonkeyPatch) -> None:
    """Whatever a fit without it comes to: drops on the window that cover nothing are no drops."""
    search = likelihood_of(LinearSimulator([effect(NOISE, 0.5)]))
    base = search.begin()
    two = {
        name: {one.name: float(getattr(effect(name, strength), one.name)) for one in EFFECTS[name].arguments}
        for name, strength in ((WINDOW, 0.0), (NOISE, 0.5))
    }
    point = ParameterPoint(two)
    whole = replace(search.fit(point, base.nuisance, base.base), point=point)
    worse = replace(whole, point=point.without(WINDOW), misfit=whole.misfit + 500.0)
    monkeypatch.setattr(search, "fit", lambda *arguments: worse)
    assert set(_without_idle(search, Candidate(NOISE, whole, 100.0), 30.0).point.values) == {NOISE}


@pytest.mark.parametrize(("behind", "fits"), [(1.0, 1), (-1.0, 2)])
def test_others_are_fitted_alone_only_where_they_may_come_near(behind: float, fits: int) -> None:
    """30 is what noise gains; 40 more, and no fit brings back what a linear simulator would not."""
    asked: list[int] = []

    def fit(point: ParameterPoint, *given: Any) -> Any:
        asked.append(given[2] if len(given) > 2 else NUMERICS.max_iterations)
        return fit_of(point.values, 480.0)

    search: Any = SimpleNamespace(
        fit=fit, promised=lambda one: 400.0 + 30.0 + NUMERICS.rival_chi2 + behind, model=SimpleNamespace(forms={})
    )
    two = {WINDOW: {"loss_db": 1.0}, NOISE: {"std_m": 0.1}}
    whole: Any = SimpleNamespace(point=ParameterPoint(two), misfit=400.0, nuisance=None, base=None)
    kept = _without_idle(search, Candidate(NOISE, whole, 100.0), 30.0)
    assert set(kept.point.values) == {WINDOW, NOISE}
    assert asked == [0, NUMERICS.max_iterations][:fits]


# ---- what no effect explains -----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("scatters", "verdict"), [(0.0, "named"), (2.0, "named"), (5.0, "named_and_rest"), (20.0, "unknown")]
)
def test_what_an_effect_leaves_decides_between_a_name_a_rest_and_no_name(scatters: float, verdict: str) -> None:
    result = searched((WINDOW, 0.5), unknown=unknown(scatters))
    assert result.verdict == verdict
    assert found_in(result)[WINDOW] == pytest.approx(0.5, rel=0.1)


@pytest.mark.parametrize(("scatters", "verdict"), [(1.0, "none"), (2.0, "none"), (5.0, "unknown"), (10.0, "unknown")])
def test_what_no_effect_explains_is_unknown_once_it_is_sure(scatters: float, verdict: str) -> None:
    result = searched(unknown=unknown(scatters))
    assert result.verdict == verdict
    assert (result.global_test.p_value < METHOD.sure_alarm_p) == (verdict == "unknown")


def test_a_pattern_that_all_conditions_have_need_not_be_sure_in_each() -> None:
    """Of two scatters in every condition: noise in any two, an alarm in eight."""
    few, many = (searched(unknown=unknown(2.0), conditions=number) for number in (2, 8))
    assert (few.verdict, many.verdict) == ("none", "unknown")
    assert few.global_test.common_p_value > METHOD.alarm_p > many.global_test.common_p_value


def test_an_effect_that_is_not_allowed_is_not_explained_by_another() -> None:
    result = searched((WINDOW, 0.5), allowed=[NOISE])
    assert result.verdict == "unknown"
    assert result.global_test.misfit - result.rounds[0][0].fit.misfit < 0.01 * result.global_test.misfit


@pytest.mark.parametrize(
    ("elsewhere", "verdict"),
    [(0.5, "named"), (0.7, "named_and_rest"), (1.0, "unknown"), (0.0, "unknown")],
)
def test_a_name_must_hold_on_conditions_that_are_held_out(elsewhere: float, verdict: str) -> None:
    result = searched((WINDOW, 0.5), elsewhere=[effect(WINDOW, elsewhere)] if elsewhere else [])
    assert result.verdict == verdict


def test_an_effect_may_hide_behind_what_is_left_open() -> None:
    """As strong as what is open may well be it is none; far beyond that it is named, with its strength."""
    like = {"open_as": (WINDOW, 0.05)}
    assert searched(**like).verdict == "none"
    assert searched(**like, drift=3.0).verdict == "none"
    for strength, verdict in ((0.1, "none"), (0.5, "named"), (1.0, "named")):
        result = searched((WINDOW, strength), **like)
        assert result.verdict == verdict
        if verdict == "named":
            assert found_in(result)[WINDOW] == pytest.approx(strength, abs=4 * 0.05)
    other = searched((EXTINCTION, 0.3), **like)
    assert list(found_in(other)) == [EXTINCTION]


# ---- gates, on plain numbers -----------------------------------------------------------------------------------------


BEFORE = HeldOut(gap=2.0, floor=1.0, spread=0.05, misfit=400.0, p_value=0.0)
EXPLAINED = HeldOut(gap=1.2, floor=1.0, spread=0.05, misfit=110.0, p_value=0.0)


def global_test(
    misfit: float = 1200.0,
    p_value: float = 1e-9,
    excess: float = 0.0,
    residual_p: float = 1.0,
    residual_common_p: float = 1.0,
    common_p: float = 1.0,
) -> Any:
    """Noise gains 30 at most; some statistics exceed theirs."""
    residual_test = SimpleNamespace(
        beyond_chance=lambda left: excess,
        p_value=lambda left: residual_p,
        common_p_value=lambda left: residual_common_p,
    )
    return SimpleNamespace(
        misfit=misfit, p_value=p_value, common_p_value=common_p, threshold=30.0, residual_test=residual_test
    )


def test_the_global_test_is_read_under_its_old_name_with_a_warning() -> None:
    alarm, held = global_test(), HeldOut(1.0, 1.0, 0.05, 1.0, p_value=0.0)
    result = GapResult("none", None, (), alarm, held, held, np.zeros(4), SimpleNamespace(), 0.0)  # type: ignore[arg-type]
    with pytest.warns(DeprecationWarning, match="is GapResult.global_test now"):
        assert result.screening is alarm


def left_by(misfit: float) -> Any:
    """A fit."""
    return SimpleNamespace(misfit=misfit, residual=np.zeros(4), nuisance=NOTHING)


@pytest.mark.parametrize(
    ("share", "verdict"),
    [
        (0.0, "named"),
        (0.5 * METHOD.rest_share, "named"),
        (METHOD.rest_share + 0.01, "named_and_rest"),
        (METHOD.unknown_share - 0.01, "named_and_rest"),
        (METHOD.unknown_share + 0.01, "unknown"),
        (0.9, "unknown"),
    ],
)
def test_what_is_left_decides_between_a_name_a_rest_and_no_name(share: float, verdict: str) -> None:
    """Of 1,000 that the effect explains and what it leaves, where that is no noise."""
    excess = 1000.0 * share / (1.0 - share)
    for sure in ({"residual_p": 0.5 * METHOD.residual_p}, {"residual_common_p": 0.5 * METHOD.residual_p}):
        assert _verdict(global_test(excess=excess, **sure), left_by(200.0), BEFORE, EXPLAINED) == verdict
    noise = global_test(excess=excess, residual_p=2.0 * METHOD.residual_p, residual_common_p=2.0 * METHOD.residual_p)
    assert _verdict(noise, left_by(200.0), BEFORE, EXPLAINED) == "named"


@pytest.mark.parametrize(
    ("before", "after", "verdict"),
    [(2.0, 1.08, "named_and_rest"), (2.0, 1.12, "unknown"), (1.4, 1.0, "unknown")],
    ids=["repaired", "not quite", "held-out conditions hardly show it"],
)
def test_what_repairs_held_out_conditions_is_a_name_of_another_form(before: float, after: float, verdict: str) -> None:
    """However much it leaves where it was fitted."""
    found = global_test(excess=1000.0, residual_p=0.5 * METHOD.residual_p)
    held = HeldOut(gap=after, floor=1.0, spread=0.05, misfit=110.0, p_value=0.0)
    assert _verdict(found, left_by(200.0), replace(BEFORE, gap=before), held) == verdict


def test_what_an_effect_does_not_simulate_is_a_rest_and_no_reason_against_it() -> None:
    """A receiver that is more sensitive sees surfaces where clear air showed none; the model has none there."""
    places = np.repeat(np.arange(2), 5)
    test = ResidualTest(places, np.ones((2, 10), bool), np.ones((2, 10)))
    found = global_test()
    found.residual_test = test
    fit = left_by(200.0)
    fit.residual, fit.nuisance = np.tile(np.where(places == 1, 8.0, 0.0), 2), SimpleNamespace(left=lambda one: one)
    assert _verdict(found, fit, BEFORE, EXPLAINED) == "unknown"  # 640 of 1,640
    assert _verdict(found, fit, BEFORE, EXPLAINED, np.tile(places == 1, 2)) == "named_and_rest"
    assert _verdict(found, fit, BEFORE, EXPLAINED, np.tile(places == 0, 2)) == "unknown"


@pytest.mark.parametrize(
    ("gain", "p_value", "verdict"),
    [
        (29.0, 0.5 * METHOD.sure_alarm_p, "unknown"),
        (29.0, 2.0 * METHOD.sure_alarm_p, "none"),
        (31.0, 2.0 * METHOD.sure_alarm_p, "named"),
    ],
)
def test_what_noise_gains_is_no_name(gain: float, p_value: float, verdict: str) -> None:
    """Although something is missing, if that is sure."""
    found = global_test(misfit=1200.0, p_value=p_value)
    assert _verdict(found, left_by(1200.0 - gain), BEFORE, EXPLAINED) == verdict


@pytest.mark.parametrize(("common_p", "verdict"), [(0.9 * METHOD.alarm_p, "unknown"), (1.1 * METHOD.alarm_p, "none")])
def test_a_pattern_that_all_conditions_have_need_not_be_explained(common_p: float, verdict: str) -> None:
    """An alarm is enough where an effect explains no more than noise, or held-out conditions speak against it."""
    found = global_test(p_value=2.0 * METHOD.sure_alarm_p, common_p=common_p)
    assert _verdict(found, left_by(1200.0 - 29.0), BEFORE, EXPLAINED) == verdict
    worse = HeldOut(gap=2.1, floor=1.0, spread=0.05, misfit=1000.0, p_value=0.0)
    assert _verdict(found, left_by(1200.0 - 60.0), BEFORE, worse) == verdict


@pytest.mark.parametrize(
    ("p_value", "verdict"), [(0.5 * METHOD.sure_alarm_p, "unknown"), (2.0 * METHOD.sure_alarm_p, "none")]
)
@pytest.mark.parametrize(
    ("explained", "least"),
    [(0.9 * METHOD.sure_gain, 0.0), (10.0 * METHOD.sure_gain, -9.0 * METHOD.sure_gain * METHOD.held_loss_share)],
    ids=["weak", "strong"],
)
def test_a_name_must_hold_on_held_out_conditions(p_value: float, verdict: str, explained: float, least: float) -> None:
    """They must not speak against a weak effect; a strong one may lose a little there."""
    found = global_test(misfit=210.0 + explained, p_value=p_value)
    for gained, expected in ((least - 0.1, verdict), (least + 0.1, "named")):
        after = HeldOut(gap=1.05, floor=1.0, spread=0.05, misfit=BEFORE.misfit - gained, p_value=0.0)
        assert _verdict(found, left_by(210.0), BEFORE, after) == expected


def test_a_held_out_gap_far_above_its_floor_is_a_rest() -> None:
    before = replace(BEFORE, gap=4.0)
    for gap, verdict in ((1.45, "named"), (1.55, "named_and_rest")):
        assert _verdict(global_test(), left_by(210.0), before, HeldOut(gap, 1.0, 0.05, 210.0, p_value=0.0)) == verdict


def test_held_out_conditions_say_how_likely_noise_leaves_as_much() -> None:
    result = searched((WINDOW, 2.0))
    assert result.before.p_value < METHOD.residual_p
    assert result.after.p_value > METHOD.left_by_noise


def test_a_held_out_gap_that_noise_may_well_leave_is_none() -> None:
    """In weather that comes in banks six frames differ from six others by more than the noise of their beams."""
    for before, gap, verdict in ((4.0, 1.55, "named_and_rest"), (2.4, 1.75, "unknown")):
        held = HeldOut(gap, 1.0, 0.05, 210.0, 0.9 * METHOD.left_by_noise)
        assert _verdict(global_test(), left_by(210.0), replace(BEFORE, gap=before), held) == verdict
        held = replace(held, p_value=1.1 * METHOD.left_by_noise)
        assert _verdict(global_test(), left_by(210.0), replace(BEFORE, gap=before), held) == "named"


@pytest.mark.parametrize(
    ("gap", "verdict"),
    [(2.9, "named_and_rest"), (8.5, "named_and_rest"), (9.5, "unknown")],  # of 20: 2, 18 and 22 % of the square
)
def test_effects_that_leave_held_out_conditions_far_off_are_not_what_is_missing(gap: float, verdict: str) -> None:
    """That over the floor's."""
    before = HeldOut(20.0, 1.0, 0.05, 16000.0, p_value=0.0)
    assert _verdict(global_test(), left_by(210.0), before, HeldOut(gap, 1.0, 0.05, 210.0, p_value=0.0)) == verdict
    far = HeldOut(100.0, 1.0, 0.05, 4e5, p_value=0.0)  # nearly all of it explained
    assert _verdict(global_test(), left_by(210.0), far, HeldOut(gap, 1.0, 0.05, 210.0, p_value=0.0)) == "named_and_rest"
    # A gap that was near its floor before says as much.
    for gap, near in ((1.55, "unknown"), (1.45, "named")):
        assert (
            _verdict(global_test(), left_by(210.0), replace(far, gap=2.0), HeldOut(gap, 1.0, 0.05, 210.0, p_value=0.0))
            == near
        )
    # ... but ten floors are not a rest, whatever was explained.
    assert (
        _verdict(global_test(), left_by(210.0), replace(far, gap=200.0), HeldOut(12.0, 1.0, 0.05, 210.0, p_value=0.0))
        == "unknown"
    )


@pytest.mark.parametrize(
    ("hidden", "bins", "verdict"),
    [
        (((WINDOW, 2.0), (NOISE, 1.0), (EXTINCTION, 1.0)), UNKNOWN, "unknown"),
        (((WINDOW, 2.0), (NOISE, 1.0), (EXTINCTION, 1.0)), DIRECTIONS[WINDOW][1], "named_and_rest"),
        (((WINDOW, 2.0), (NOISE, 1.0)), UNKNOWN, "named_and_rest"),
    ],
    ids=["elsewhere", "form", "fewer effects"],
)
def test_as_many_effects_as_are_searched_for_are_no_answer_where_more_is_left_than_their_forms(
    hidden: tuple[tuple[str, float], ...], bins: slice, verdict: str
) -> None:
    """A hundredth of the squares is left, some four floors: a tilt of the window's form, or another effect elsewhere.
    Beside two effects that is a rest; three may only imitate together what is missing."""
    tilt = np.zeros(SIZE)
    tilt[bins] = np.linspace(-1.0, 1.0, bins.stop - bins.start)
    tilt *= 25.0 / np.sqrt((tilt**2).sum())
    result = searched(*hidden, unknown=tilt)
    assert result.verdict == verdict
    assert METHOD.residual_gap < result.after.gap / result.after.floor < METHOD.unexplained_gap
    assert found_in(result) == pytest.approx(dict(hidden), rel=0.2)  # the tilt draws the extinction beside it along
    answer = gap_report(result, "ab" * 32, 0).to_dict()
    assert {one["name"] for one in answer["closest"]} == (set(dict(hidden)) if verdict == "unknown" else set())
    assert {one["name"] for one in answer["effects"]} == (set() if verdict == "unknown" else set(dict(hidden)))


def test_a_further_effect_helps_where_it_was_not_fitted() -> None:
    hidden = ((WINDOW, 2.0), (NOISE, 0.15))
    assert set(found_in(searched(*hidden))) == {WINDOW, NOISE}
    assert list(found_in(searched(*hidden, elsewhere=[effect(WINDOW, 2.0)]))) == [WINDOW]


# ---- the alarm -------------------------------------------------------------------------------------------------------


def test_the_chance_of_an_excess_is_counted_and_beyond_the_nulls_that_of_a_gumbel_law() -> None:
    null = RNG(1).gumbel(10.0, 2.0, 1000)
    assert _tail(null, float(np.quantile(null, 0.9))) == pytest.approx(0.1, abs=0.002)  # counted
    # Beyond: 1 - exp(-exp(-(x - 10) / 2)); scale and place of 1,000 draws are known to 4 %.
    for value in (30.0, 40.0):
        assert np.log(_tail(null, value)) == pytest.approx(-(value - 10.0) / 2.0, rel=0.1)
    assert 0.0 < _tail(null, 100.0) < 1e-18


def test_only_grids_near_the_best_are_simulated_whole() -> None:
    """Of the effects whose gain comes near that of the best."""
    search = likelihood_of(LinearSimulator([effect(WINDOW, 0.5)]))
    found = run_global_test(search, [EFFECTS[name] for name in DIRECTIONS], search.begin(), 0)
    grids = {name: parameter_grids(EFFECTS[name], []) for name in DIRECTIONS}
    every = {name: sum(len(grid.points) for grid in own) for name, own in grids.items()}
    first = {name: sum(len(grid.first) for grid in own) for name, own in grids.items()}
    asked = {name: sum(one.id == name for one in found.templates) for name in DIRECTIONS}
    assert {name for name in DIRECTIONS if asked[name] == every[name] > first[name]} == {WINDOW}
    assert all(asked[name] == first[name] for name in (NOISE, BIAS))
    gain = {
        name: max(g for one, g in zip(found.templates, found.gains, strict=True) if one.id == name) for name in asked
    }
    assert max(gain, key=lambda name: gain[name]) == WINDOW
    assert gain[NOISE] < NUMERICS.refined_share * gain[WINDOW]


def test_effects_with_a_place_are_tried_anew_where_a_first_one_leaves_most() -> None:
    """Weaker returns everywhere, most of all in one sector; behind them a smaller sector, found once they are in."""
    hidden = [EFFECTS["lidar.sector_loss"](azimuth_rad=-1.5, width_rad=0.8, loss_db=3.0)]
    hidden += [EFFECTS["lidar.spray"](strength=8.0, azimuth_rad=1.8, width_rad=0.8)]
    study = tiny_study(hidden, seed=4, rows=16, columns=64, clear=4, weathers=WEATHERS)
    search = SimulatorLikelihood(model := LidarFrames(study), observations(model, study.fit), 0, pool_frames=32)
    base = search.begin()
    first = ParameterPoint({"lidar.sector_loss": {"azimuth_rad": -1.5, "width_rad": 0.8, "loss_db": 3.0}})
    fit = search.fit(first, base.nuisance, base.base, 1)
    found = located_templates(search, [EFFECTS["lidar.spray"], EFFECTS["lidar.window_loss"]], fit)
    assert {template.id for template in found} == {"lidar.spray"}
    # Sectors of the statistics are 0.39 rad wide.
    assert min(abs(template.values["azimuth_rad"] - 1.8) for template in found) < 0.6
    best = found[int(delta_chi2(found, fit.nuisance.left(fit.residual)[None], fit.nuisance)[0].argmax())]
    assert best.values["azimuth_rad"] == pytest.approx(1.8, abs=0.6)


# ---- candidates ------------------------------------------------------------------------------------------------------


def test_of_each_effect_the_best_template_is_fitted_if_it_is_worth_it() -> None:
    found = best_templates(TEMPLATES, np.array([1.5, 1.3, 0.3, 0.0]), NOTHING)
    # Gains: 1 x 2 a 1.5 - a^2 of at most 1.35; 26.5 / 9.25; 1.69; 0.09, too little.
    assert [(one.id, one.values) for one, _ in found] == [
        ("lidar.window_loss", {"loss_db": 3.0}),
        ("lidar.range_noise", {"std_m": 0.1}),
    ]
    assert [amplitude for _, amplitude in found] == pytest.approx([5.15 / 9.25, 0.65], rel=1e-12)


def test_what_begins_at_a_threshold_is_also_fitted_from_a_point_as_it_stands() -> None:
    """Counts that grow as the square: of what is left the strongest explains most if scaled to a tenth, the second as
    it is. Where none is scaled by as much, and of an effect with a few points, there is one beginning."""
    effect, strengths = EFFECTS["lidar.crosstalk"], (0.01, 0.02, 0.03, 0.04, 0.08)
    grid = ParameterGrid(effect, tuple({"probability": one} for one in strengths))
    responses = [[0.2, 0.0, 0.0], [0.9, 0.1, 0.0], [2.0, 1.0, 0.0], [3.0, 4.0, 0.0], [9.0, 9.0, 1.0]]
    templates = [
        ResponseTemplate(grid, k, dict(values), np.array(response))
        for k, (values, response) in enumerate(zip(grid.points, responses, strict=True))
    ]
    nuisance, left = Systematics(np.zeros((3, 1)), np.zeros(1), 1), np.array([1.0, 0.5, 0.0])
    assert unscaled_templates(templates, [(templates[4], 0.1)], left, nuisance) == [(templates[1], 1.0)]
    assert unscaled_templates(templates, [(templates[4], 0.9 * NUMERICS.threshold_amplitude)], left, nuisance) == [
        (templates[1], 1.0)
    ]
    assert unscaled_templates(templates, [(templates[2], 1.1 * NUMERICS.threshold_amplitude)], left, nuisance) == []
    few = [replace(one, grid=ParameterGrid(effect, grid.points[:3])) for one in templates[:3]]
    assert unscaled_templates(few, [(few[2], 0.1)], left, nuisance) == []


def test_what_something_open_may_stand_for_is_what_looks_most_like_what_it_has_done() -> None:
    """The record stands 9 off, what is open -2: along (-2, 0, 2, 0), of which crosstalk explains 4."""
    response = np.array([[0.0, 1.0], [1.0, 0.0], [0.0, -1.0], [0.0, 0.0]])
    found = hidden_templates(TEMPLATES, Systematics(response, np.array([9.0, -2.0]), 2), slice(1, 2))
    (first, amplitude), *others = found
    assert (first.id, amplitude) == ("lidar.crosstalk", 1.35)  # twice its response, but no farther than that
    assert [expected for _, expected in others] == [0.0, 0.0]  # a window would do the opposite


@pytest.mark.parametrize(
    ("name", "values", "amplitude", "expected"),
    [
        ("lidar.window_loss", {"loss_db": 3.0}, 0.5, {"loss_db": 1.5}),
        ("lidar.window_loss", {"loss_db": 3.0}, 0.0, {"loss_db": 3.0 * NUMERICS.least_amplitude}),
        ("lidar.extinction_scale", {"factor": 2.0}, 0.25, {"factor": 1.25}),
        ("lidar.extinction_scale", {"factor": 0.0}, 1.35, {"factor": 0.0}),  # no less than nothing
        ("lidar.limited_extent", {"extent_m": 20.0}, 0.5, {"extent_m": 20.0}),  # its identity is infinitely far
        ("lidar.blind_zone", {"range_m": 2.0}, 0.3, {"range_m": 2.0}),  # a third of what it cuts lies not in a third
        # Where it is stays.
        (
            "lidar.sector_loss",
            {"azimuth_rad": 0.3, "width_rad": 0.5, "loss_db": 2.0},
            0.5,
            {"azimuth_rad": 0.3, "width_rad": 0.5, "loss_db": 1.0},
        ),
    ],
)
def test_a_fit_starts_at_the_amplitude_of_the_response(
    name: str, values: dict[str, float], amplitude: float, expected: dict[str, float]
) -> None:
    found = _start(template(name, values, np.zeros(4)), amplitude)
    assert {key: found[key] for key in expected} == pytest.approx(expected)
    assert list(found) == [parameter.name for parameter in EFFECTS[name].arguments]


# ---- the whole -------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def study() -> Study:
    hidden = LidarWindowLoss(loss_db=1.0)
    return tiny_study([hidden], seed=2, rows=16, columns=32, clear=4, frames=4, weathers=WEATHERS)


def test_a_single_allowed_effect_is_found_with_its_parameter(study: Study) -> None:
    said: list[str] = []
    report = find_gap(study, effects=["lidar.window_loss"], progress=said.append)
    answer = report.to_dict()
    assert answer["verdict"] == "named"
    (effect,) = answer["effects"]
    assert effect["parameters"]["loss_db"] == pytest.approx(1.0, rel=0.1)
    low, high = effect["interval"]["loss_db"]
    assert low < 1.0 < high
    gap = answer["gap"]
    assert gap["after"] < 1.3 * gap["floor"] < gap["before"]
    assert answer["p_value"] < METHOD.alarm_p
    assert "fitting lidar.window_loss" in said
    assert [one["name"] for one in answer["candidates"]] == ["lidar.window_loss"]


def test_an_effect_that_the_model_has_is_not_missing(study: Study) -> None:
    report = find_gap(study, effects=["lidar.range_bias"], model_effects=[LidarWindowLoss(loss_db=1.0)])
    assert report.to_dict()["verdict"] == "none"
    assert report.effects == ()


def test_an_effect_that_there_is_not_is_refused_before_anything_is_simulated(study: Study) -> None:
    said: list[str] = []
    with pytest.raises(ValueError, match=r"effect must be one of .*Did you mean 'lidar.window_loss'"):
        find_gap(study, effects=["lidar.window_los"], progress=said.append)
    assert said == []


@pytest.mark.parametrize(
    ("gain", "with_forms", "refitted", "alone", "earns"),
    [
        (31.0, 460.0, (500.0, 460.0), 480.0, True),
        (29.0, 460.0, (500.0, 460.0), 480.0, False),  # no more than noise
        (31.0, 471.0, (500.0, 440.0), 480.0, False),  # no more, where the form of the first may be another
        (31.0, 460.0, (489.0, 460.0), 480.0, False),  # nor where the first one is fitted with that error
        (31.0, 460.0, (489.0, 458.0), 480.0, True),
        (31.0, 460.0, (500.0, 460.0), 420.0, False),  # the first one, fitted again, leaves as little
        (60.0, 471.0, (500.0, 440.0), 420.0, False),  # that is looked at wherever a tenth is gained
    ],
)
def test_an_added_effect_must_gain_what_noise_seldom_does(
    gain: float,
    with_forms: float,
    refitted: tuple[float, float],
    alone: float,
    earns: bool,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """30; of 500 that a window leaves, also where its form is in error."""
    asked: list[list[str]] = []

    def seen(search: Any, fit: Any, names: Sequence[str]) -> Any:
        asked.append(list(names))
        return fit_of(fit.point.values, with_forms)

    def fitted_with_forms(search: Any, wide: Any, names: Sequence[str]) -> Any:
        assert list(names) == ["lidar.window_loss"]
        return fit_of(wide.point.values, refitted[NOISE in wide.point.values])

    monkeypatch.setattr(forward_selection, "beside_form_errors", seen)
    monkeypatch.setattr(forward_selection, "fitted_beside_form_errors", fitted_with_forms)
    window = {"lidar.window_loss": {"loss_db": 1.0}}
    best = Candidate("lidar.window_loss", fit_of(window, 500.0), 300.0)
    added = Candidate(NOISE, fit_of({**window, NOISE: {}}, 400.0), gain)
    search: Any = SimpleNamespace(fit=lambda *given: fit_of(window, alone))
    found, others_alone = _that_earn(search, best, fit_of(window, 500.0), [added], 30.0)
    assert [one.id for one in found] == [NOISE] * earns
    assert asked == [["lidar.window_loss"]] * (gain > 30.0)  # the form of the others, not its own
    if earns:
        assert found[0].misfit == refitted[1]
    # The first one, fitted from beside the second, is handed back where it was looked at.
    assert others_alone.misfit == (alone if earns or alone < 480.0 else 500.0)


def test_added_effects_are_compared_where_the_forms_of_the_others_may_be_in_error(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """One patches another form of the first: best where that is exact, it is none of them where it is not."""
    names = ("lidar.ring_gain", "lidar.crosstalk", "lidar.spray", "lidar.wet_target")
    with_forms = dict(zip(names, (499.0, 420.0, 390.0, 391.0 + NUMERICS.rival_chi2), strict=True))
    exact = dict(zip(names, (100.0, 300.0, 350.0, 351.0), strict=True))
    monkeypatch.setattr(
        forward_selection,
        "beside_form_errors",
        lambda search, fit, others: fit_of(fit.point.values, with_forms[next(iter(fit.point.values))]),
    )
    monkeypatch.setattr(forward_selection, "fitted_beside_form_errors", lambda search, wide, names: wide)
    best = Candidate("lidar.window_loss", fit_of({"lidar.window_loss": {}}, 500.0), 300.0)
    added = [Candidate(one, fit_of({one: {}}, exact[one]), 500.0 - exact[one]) for one in names]
    search: Any = SimpleNamespace(fit=lambda *given: fit_of({}, 500.0), promised=lambda fit: 0.0)
    found, _ = _that_earn(search, best, fit_of({}, 500.0), added, 30.0)
    assert [one.id for one in found] == ["lidar.spray", "lidar.crosstalk"]  # the last one is far behind


@pytest.mark.parametrize(("off", "refitted"), [(0.0, True), (NUMERICS.rival_chi2 + 1.0, False)])
def test_what_would_lie_far_behind_is_not_fitted_beside_the_errors_of_forms(
    off: float, refitted: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of two that add to the same, the second is seen 3,000 worse, and may make that good where its first is fitted:
    that is decided by what a linear simulator would leave, not by what it leaves before."""
    seen = {"lidar.spray": 390.0, "lidar.ring_gain": 3390.0}
    asked: list[str] = []

    def fitted(search: Any, wide: Any, names: Any) -> Any:
        asked.extend(wide.point.values)
        return wide

    monkeypatch.setattr(
        forward_selection,
        "beside_form_errors",
        lambda search, fit, others: fit_of(fit.point.values, seen[next(iter(fit.point.values))]),
    )
    monkeypatch.setattr(forward_selection, "fitted_beside_form_errors", fitted)
    best = Candidate("lidar.window_loss", fit_of({"lidar.window_loss": {}}, 5000.0), 300.0)
    added = [Candidate(one, fit_of({one: {}}, 350.0), 4650.0) for one in seen]
    search: Any = SimpleNamespace(fit=lambda *given: fit_of({}, 5000.0), promised=lambda fit: 390.0 + off)
    _that_earn(search, best, fit_of({"lidar.window_loss": {}}, 5000.0), added, 30.0)
    assert asked == ["lidar.window_loss", "lidar.spray"] + ["lidar.ring_gain"] * refitted


def test_first_effects_that_a_second_leads_to_more_are_fitted_before_it_is_judged(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A window that was left at half of its strength: beside another effect it goes to the whole, which is no merit of
    that one. The round begins again with it."""

    def stuck(search: SimulatorLikelihood, base: Any, global_test: Any, *more: Any) -> list[Candidate]:
        point = ParameterPoint({WINDOW: {DIRECTIONS[WINDOW][0]: 1.0}})
        fit = search.fit(point, base.nuisance, base.base, 0)
        return [Candidate(WINDOW, fit, global_test.misfit - fit.misfit)]

    monkeypatch.setattr(forward_selection, "_singles", stuck)
    monkeypatch.setattr(forward_selection, "pairs_from_rest", lambda *given: [])
    result = searched((WINDOW, 2.0), (NOISE, 0.3))
    first = result.rounds[0][0]
    assert strength_of(WINDOW, first.fit.point.values[WINDOW]) == pytest.approx(2.0, rel=0.05)
    assert first.gain == pytest.approx(result.global_test.misfit - first.fit.misfit, rel=1e-9)
    assert found_in(result) == pytest.approx({WINDOW: 2.0, NOISE: 0.3}, rel=0.05)
    assert result.rounds[1][0].gain == pytest.approx(first.fit.misfit - result.rounds[1][0].fit.misfit, rel=1e-9)


def test_beside_all_candidates_of_an_alarm_the_nuisances_are_fitted_anew(monkeypatch: pytest.MonkeyPatch) -> None:
    """The right effect may come third or fourth, where what is open has gone far."""
    asked: list[int] = []

    def fitted(*given: Any) -> list[Candidate]:
        asked.append(given[5] if len(given) > 5 else NUMERICS.profiled_beside)
        return original(*given)

    original = forward_selection.fitted
    monkeypatch.setattr(forward_selection, "fitted", fitted)
    searched((WINDOW, 0.5))
    assert asked[0] == NUMERICS.refitted > NUMERICS.profiled_beside
