"""The workflow: its gates on numbers made by hand, its candidates, and a search for a single effect."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tests.gap.tiny_study import tiny_study
from torchweather.atmosphere.weather import Snow
from torchweather.gap.find import find_gap
from torchweather.gap.inference import forward_selection as workflow
from torchweather.gap.inference import global_test as screening_module
from torchweather.gap.inference.candidate_fits import (
    LEAST_AMPLITUDE,
    MUCH_SCALED,
    Candidate,
    Proposal,
    _start,
    best_pairs,
    best_templates,
    hidden_templates,
    scattering,
    unscaled_templates,
)
from torchweather.gap.inference.forward_selection import (
    ALARM_P,
    HELD_LOSS,
    REST_P,
    REST_SHARE,
    SURE_GAIN,
    SURE_P,
    UNKNOWN_SHARE,
    _fitted_on_top,
    _on_top,
    _rounds,
    _verdict,
)
from torchweather.gap.inference.global_test import (
    OVERDISPERSION,
    REFINED,
    _tail,
    global_test,
    located_templates,
    overdispersion,
)
from torchweather.gap.inference.held_out import HeldOut
from torchweather.gap.inference.likelihood import Fit, ParameterPoint, SimulatorLikelihood
from torchweather.gap.inference.response_templates import ResponseTemplate, delta_chi2
from torchweather.gap.inference.simulated_distribution import observations
from torchweather.gap.inference.starting_points import ParameterGrid, parameter_grids
from torchweather.gap.inference.systematics import Systematics
from torchweather.gap.sensors.lidar.frames import LidarFrames
from torchweather.gap.statistics.frame_statistics import Group, Layout
from torchweather.gap.study.study import Study
from torchweather.lidar.effects.all import EFFECTS, LidarWindowLoss

RNG = np.random.default_rng
WEATHERS = (Snow(2.0), Snow(1.2))
BEFORE = HeldOut(gap=2.0, floor=1.0, spread=0.05, misfit=400.0)
EXPLAINED = HeldOut(gap=1.05, floor=1.0, spread=0.05, misfit=110.0)


def screening(
    misfit: float = 1200.0,
    p_value: float = 1e-9,
    excess: float = 0.0,
    rest_p: float = 1.0,
    rest_common_p: float = 1.0,
    common_p: float = 1.0,
) -> Any:
    """Noise gains 30 at most; some statistics exceed theirs."""
    rest = SimpleNamespace(
        excess=lambda left: excess, p_value=lambda left: rest_p, common_p_value=lambda left: rest_common_p
    )
    noise = np.full(100, 30.0)
    return SimpleNamespace(misfit=misfit, p_value=p_value, common_p_value=common_p, best_null=noise, rest=rest)


def left_by(misfit: float) -> Any:
    """A fit."""
    return SimpleNamespace(misfit=misfit, residual=np.zeros(4), nuisance=NOTHING)


def node(name: str, values: dict[str, float], response: Any) -> ResponseTemplate:
    return ResponseTemplate(ParameterGrid(EFFECTS[name], (values,)), 0, values, np.asarray(response, dtype=np.float64))


NOTHING = Systematics(np.zeros((4, 1)), np.zeros(1), 1)
NODES = [
    node("lidar.window_loss", {"loss_db": 1.0}, [1.0, 0.0, 0.0, 0.0]),
    node("lidar.window_loss", {"loss_db": 3.0}, [3.0, 0.5, 0.0, 0.0]),
    node("lidar.range_noise", {"std_m": 0.1}, [0.0, 2.0, 0.0, 0.0]),
    node("lidar.crosstalk", {"probability": 0.1}, [0.0, 0.0, 1.0, 0.0]),
]


# ---- gates -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("share", "verdict"),
    [
        (0.0, "named"),
        (0.5 * REST_SHARE, "named"),
        (REST_SHARE + 0.01, "named_and_rest"),
        (UNKNOWN_SHARE - 0.01, "named_and_rest"),
        (UNKNOWN_SHARE + 0.01, "unknown"),
        (0.9, "unknown"),
    ],
)
def test_what_is_left_decides_between_a_name_a_rest_and_no_name(share: float, verdict: str) -> None:
    """Of 1,000 that the effect explains and what it leaves, where that is no noise."""
    excess = 1000.0 * share / (1.0 - share)
    for sure in ({"rest_p": 0.5 * REST_P}, {"rest_common_p": 0.5 * REST_P}):
        assert _verdict(screening(excess=excess, **sure), left_by(200.0), BEFORE, EXPLAINED) == verdict
    noise = screening(excess=excess, rest_p=2.0 * REST_P, rest_common_p=2.0 * REST_P)
    assert _verdict(noise, left_by(200.0), BEFORE, EXPLAINED) == "named"


@pytest.mark.parametrize(
    ("gain", "p_value", "verdict"),
    [(29.0, 0.5 * SURE_P, "unknown"), (29.0, 2.0 * SURE_P, "none"), (31.0, 2.0 * SURE_P, "named")],
)
def test_what_noise_gains_is_no_name(gain: float, p_value: float, verdict: str) -> None:
    """Although something is missing, if that is sure."""
    found = screening(misfit=1200.0, p_value=p_value)
    assert _verdict(found, left_by(1200.0 - gain), BEFORE, EXPLAINED) == verdict


@pytest.mark.parametrize(("common_p", "verdict"), [(0.9 * ALARM_P, "unknown"), (1.1 * ALARM_P, "none")])
def test_a_pattern_that_all_conditions_have_need_not_be_explained(common_p: float, verdict: str) -> None:
    """An alarm is enough where an effect explains no more than noise, or held-out conditions speak against it."""
    found = screening(p_value=2.0 * SURE_P, common_p=common_p)
    assert _verdict(found, left_by(1200.0 - 29.0), BEFORE, EXPLAINED) == verdict
    worse = HeldOut(gap=2.1, floor=1.0, spread=0.05, misfit=1000.0)
    assert _verdict(found, left_by(1200.0 - 60.0), BEFORE, worse) == verdict


@pytest.mark.parametrize(("p_value", "verdict"), [(0.5 * SURE_P, "unknown"), (2.0 * SURE_P, "none")])
@pytest.mark.parametrize(
    ("explained", "least"),
    [(0.9 * SURE_GAIN, 0.0), (10.0 * SURE_GAIN, -9.0 * SURE_GAIN * HELD_LOSS)],
    ids=["weak", "strong"],
)
def test_a_name_must_hold_on_held_out_conditions(p_value: float, verdict: str, explained: float, least: float) -> None:
    """They must not speak against a weak effect; a strong one may lose a little there."""
    found = screening(misfit=210.0 + explained, p_value=p_value)
    for gained, expected in ((least - 0.1, verdict), (least + 0.1, "named")):
        after = HeldOut(gap=1.05, floor=1.0, spread=0.05, misfit=BEFORE.misfit - gained)
        assert _verdict(found, left_by(210.0), BEFORE, after) == expected


def test_a_held_out_gap_far_above_its_floor_is_a_rest() -> None:
    for gap, verdict in ((1.45, "named"), (1.55, "named_and_rest")):
        assert _verdict(screening(), left_by(210.0), BEFORE, HeldOut(gap, 1.0, 0.05, 210.0)) == verdict


@pytest.mark.parametrize(
    ("gap", "verdict"),
    [(2.9, "named_and_rest"), (4.0, "named_and_rest"), (5.0, "unknown")],  # of 20: 1.9, 3.8 and 6 % of the square
)
def test_effects_that_leave_held_out_conditions_far_off_are_not_what_is_missing(gap: float, verdict: str) -> None:
    """That over the floor's."""
    before = HeldOut(20.0, 1.0, 0.05, 16000.0)
    assert _verdict(screening(), left_by(210.0), before, HeldOut(gap, 1.0, 0.05, 210.0)) == verdict
    far = HeldOut(100.0, 1.0, 0.05, 4e5)  # nearly all of it explained
    assert _verdict(screening(), left_by(210.0), far, HeldOut(gap, 1.0, 0.05, 210.0)) == "named_and_rest"
    # ... but ten floors are not a rest, whatever was explained.
    assert _verdict(screening(), left_by(210.0), replace(far, gap=200.0), HeldOut(12.0, 1.0, 0.05, 210.0)) == "unknown"


def test_the_chance_of_an_excess_is_counted_and_beyond_the_nulls_that_of_a_gumbel_law() -> None:
    null = RNG(1).gumbel(10.0, 2.0, 1000)
    assert _tail(null, float(np.quantile(null, 0.9))) == pytest.approx(0.1, abs=0.002)  # counted
    # Beyond: 1 - exp(-exp(-(x - 10) / 2)); scale and place of 1,000 draws are known to 4 %.
    for value in (30.0, 40.0):
        assert np.log(_tail(null, value)) == pytest.approx(-(value - 10.0) / 2.0, rel=0.1)
    assert 0.0 < _tail(null, 100.0) < 1e-18


# ---- further effects -------------------------------------------------------------------------------------------------


def further(
    monkeypatch: pytest.MonkeyPatch,
    misfit: float,
    gain: float,
    threshold: float = 0.0,
    excess: float = 0.0,
    rest_p: float = 1.0,
    refitted: float = 0.0,
    lost: float = math.inf,
    helped: float = 10.0,
    beside: float = math.inf,
) -> list[str]:
    """Effects that are kept where the best one leaves a misfit, and so much more than noise does, and another one
    lowers it by a gain, of which the best one would gain a part by itself, fitted again; the other one by itself would
    lose so much. On held-out conditions each lowers the misfit by ``helped``. Where the other one acts ``beside`` is
    explained, all of it at most."""

    def fitted(values: dict[str, dict[str, float]], misfit: float, gain: float) -> Candidate:
        fit: Any = SimpleNamespace(
            setting=ParameterPoint(values),
            misfit=misfit,
            nuisance=NOTHING,
            base=None,
            residual=np.array([0.0, 100.0, 100.0, 0.0]),
        )
        return Candidate(list(values)[-1], fit, gain)

    window, noise = {"lidar.window_loss": {"loss_db": 1.0}}, {"lidar.range_noise": {"std_m": 0.1}}
    third = {**window, **noise, "lidar.crosstalk": {"probability": 0.1}}
    rounds = [
        fitted(window, misfit, 1200.0 - misfit),
        fitted({**window, **noise}, misfit - gain, gain),
        fitted(third, misfit - gain, 0.0),
    ]
    held = [HeldOut(1.0, 1.0, 0.05, 300.0 - helped * place) for place in range(3)]
    asked: list[tuple[list[str], str]] = []

    def next_one(search: Any, base: Any, proposed: Sequence[Proposal], misfit: float, say: Any) -> list[Candidate]:
        found = []
        for setting, node, _ in proposed:
            assert (list(setting.values), node.id) not in asked  # once beside what was found
            asked.append((list(setting.values), node.id))
            place = next((k for k, one in enumerate(rounds) if one.id == node.id), None)
            nothing = fitted({**setting.values, node.id: {}}, misfit + 5.0, -5.0)
            found.append(nothing if place is None else rounds.pop(place))
        return sorted(found, key=lambda one: one.fit.misfit)

    monkeypatch.setattr(workflow, "fitted", next_one)
    monkeypatch.setattr(workflow, "held_out", lambda *given: held.pop(0))
    monkeypatch.setattr(workflow, "insensitive_statistics", lambda *given: np.zeros(4, bool))
    acts = min(beside, 1200.0 - misfit)
    monkeypatch.setattr(workflow, "response_of", lambda search, fit, name: np.ones(4))
    monkeypatch.setattr(
        workflow, "explained_beside", lambda search, fit, responses: np.full(np.shape(responses)[0], acts)
    )

    def fit(setting: ParameterPoint, nuisance: Any, base: Any) -> Any:
        if list(setting.values) == list(window):
            return SimpleNamespace(misfit=misfit - refitted)
        assert list(setting.values) == list(noise)
        return fitted(noise, misfit - gain + lost, 0.0).fit

    search: Any = SimpleNamespace(
        origin=ParameterPoint(), seed=0, model=SimpleNamespace(as_record=frozenset()), fit=fit
    )
    other: Any = SimpleNamespace(origin=ParameterPoint(), settle=lambda start: SimpleNamespace(misfit=300.0))
    given = {**vars(screening(excess=excess, rest_p=rest_p)), "best_null": np.full(100, threshold)}
    found = SimpleNamespace(**given, nodes=NODES)
    monkeypatch.setattr(
        workflow, "_further", lambda search, found, best: [n for n in NODES if n.id not in best.fit.setting.values]
    )
    base: Any = SimpleNamespace(nuisance=NOTHING, residual=np.array([30.0, 0.0, 0.0, 0.0]))
    singles = [rounds.pop(0)]
    kept = _rounds(search, other, base, found, singles, lambda text: None)  # type: ignore[arg-type]
    assert [len(one[0].fit.setting.values) for one in kept] == list(range(1, len(kept) + 1))
    return list(kept[-1][0].fit.setting.values)


@pytest.mark.parametrize(
    ("gained", "also"),
    [
        (-5.0, True),  # what only makes things worse keeps nothing out
        (150.0, True),  # less than was promised: others that promise half of it may be better
        (250.0, False),  # those promise less
        (300.0, False),  # the promise is kept
    ],
)
def test_where_a_promise_is_not_kept_others_are_fitted(
    monkeypatch: pytest.MonkeyPatch, gained: float, also: bool
) -> None:
    crosstalk, noise = NODES[3], NODES[2]
    left = np.array([0.0, 20.0, 100.0, 0.0])
    fit: Any = SimpleNamespace(setting=ParameterPoint(), misfit=1000.0, nuisance=NOTHING, residual=left)
    promises = delta_chi2([crosstalk, noise], left[None], NOTHING)[0]
    assert promises[0] == pytest.approx(268.0, abs=1.0)
    assert 0.5 * 150.0 < promises[1] < 0.5 * 250.0
    asked: list[str] = []

    def one_by_one(search: Any, base: Any, proposed: Sequence[Proposal], misfit: float, say: Any) -> list[Candidate]:
        found = []
        for _, node, _ in proposed:
            asked.append(node.id)
            gain = {crosstalk.id: gained, noise.id: 400.0}[node.id]
            own: Any = SimpleNamespace(misfit=misfit - gain)
            found.append(Candidate(node.id, own, gain))
        return found

    monkeypatch.setattr(workflow, "fitted", one_by_one)
    proposed = [(ParameterPoint(), crosstalk, 1.0)]
    found = _fitted_on_top(
        None,  # type: ignore[arg-type]
        fit,
        Candidate("first", fit, 100.0),
        [crosstalk, noise],
        proposed,
        30.0,
        lambda text: None,
    )
    assert asked == [crosstalk.id, *([noise.id] if also else [])]
    assert found[0].id == (noise.id if also else crosstalk.id)


@pytest.mark.parametrize(
    ("misfit", "threshold", "excess", "needed"),
    [
        (300.0, 0.0, 100.0, 60.0),  # 0.6 of the excess: less than 0.1 of 900
        (600.0, 0.0, 400.0, 60.0),  # 0.1 of what is explained, less than 0.6 of 400
        (210.0, 0.0, 10.0, 29.7),  # what any must add: 0.03 of 990; 0.6 of the excess is 6
        (190.0, 0.0, 0.0, 30.3),  # nothing is left
        (300.0, 75.0, 100.0, 75.0),  # what noise gains
    ],
)
def test_a_further_effect_explains_most_of_what_is_left_or_a_tenth_of_all(
    monkeypatch: pytest.MonkeyPatch, misfit: float, threshold: float, excess: float, needed: float
) -> None:
    """Of a rest that is no noise."""
    monkeypatch.setattr(workflow, "_confusable", lambda name, other: True)  # it compares with the first
    for off, number in ((-0.5, 1), (0.5, 2)):
        assert len(further(monkeypatch, misfit, needed + off, threshold, excess, rest_p=0.5 * REST_P)) == number


@pytest.mark.parametrize(
    ("threshold", "beside", "needed"),
    [
        (20.0, 5000.0, 150.0),  # 3 % of all
        (20.0, 1000.0, 30.0),  # of what is explained where it acts
        (20.0, 0.0, 20.0),  # what noise gains, where the first one does nothing
    ],
)
def test_beside_a_rest_that_is_noise_a_further_effect_compares_with_the_first_where_it_acts(
    monkeypatch: pytest.MonkeyPatch, threshold: float, beside: float, needed: float
) -> None:
    for off, number in ((-0.5, 1), (0.5, 2)):
        kept = further(monkeypatch, 1200.0 - 5000.0, needed + off, threshold, excess=150.0, beside=beside)
        assert len(kept) == number


@pytest.mark.parametrize(("rest_p", "needed"), [(2.0 * REST_P, 150.0), (0.5 * REST_P, 90.0)])
def test_what_explains_most_of_a_rest_that_is_no_noise_need_not_compare_with_the_first(
    monkeypatch: pytest.MonkeyPatch, rest_p: float, needed: float
) -> None:
    """Of 5,000 that is explained 3 % are 150; of an excess of 150 six tenths are 90."""
    for gain, number in ((needed - 1.0, 1), (needed + 1.0, 2)):
        assert len(further(monkeypatch, 1200.0 - 5000.0, gain, excess=150.0, rest_p=rest_p)) == number


def test_what_may_be_taken_for_the_first_compares_with_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(workflow, "_confusable", lambda name, other: (name, other) == CONFUSED)
    for gain, number in ((149.0, 1), (151.0, 2)):
        assert len(further(monkeypatch, 1200.0 - 5000.0, gain, excess=150.0, rest_p=0.5 * REST_P)) == number


def test_nothing_is_fitted_on_top_that_does_not_promise_what_it_needs_where_it_acts(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A response that promises 200, where 3 % of what is explained are 194 or 208."""
    crosstalk = NODES[3]
    fit: Any = SimpleNamespace(setting=ParameterPoint(), nuisance=NOTHING, residual=np.array([0.0, 0.0, 75.0, 0.0]))
    promised = float(delta_chi2([crosstalk], fit.residual[None], NOTHING)[0][0])
    monkeypatch.setattr(workflow, "insensitive_statistics", lambda *given: np.zeros(4, bool))
    for explained, number in ((promised / 0.031, 1), (promised / 0.029, 0)):
        monkeypatch.setattr(
            workflow, "explained_beside", lambda search, fit, responses, value=explained: np.full(1, value)
        )
        fresh, proposed = _on_top(
            None,  # type: ignore[arg-type]
            [crosstalk],
            Candidate("first", fit, 5000.0),
            30.0,
            math.inf,
            math.inf,
        )
        assert (fresh, len(proposed)) == ({}, number)


CONFUSED = ("lidar.range_noise", "lidar.window_loss")


def test_the_catalogue_says_what_may_be_taken_for_what_in_either_place() -> None:
    assert "lidar.wet_target" in EFFECTS["lidar.ring_gain"].confusable_with
    assert workflow._confusable("lidar.ring_gain", "lidar.wet_target")
    assert workflow._confusable("lidar.wet_target", "lidar.ring_gain")
    assert not workflow._confusable(*CONFUSED)


def test_a_first_effect_that_was_not_at_its_best_is_no_merit_of_the_second(monkeypatch: pytest.MonkeyPatch) -> None:
    for refitted, number in ((41.0, 1), (39.0, 2)):  # of 100; 60 are needed
        kept = further(monkeypatch, 300.0, 100.0, excess=100.0, rest_p=0.5 * REST_P, refitted=refitted)
        assert len(kept) == number


def test_a_further_effect_helps_where_it_was_not_fitted(monkeypatch: pytest.MonkeyPatch) -> None:
    """By two standard deviations, also one that explains more than SURE_GAIN."""
    for gain in (0.9 * SURE_GAIN, 1.1 * SURE_GAIN):
        for helped, number in ((3.9, 1), (4.1, 2)):
            assert len(further(monkeypatch, 300.0, gain, excess=10.0, helped=helped)) == number


@pytest.mark.parametrize(
    ("lost", "kept"),
    [(49.0, ["lidar.range_noise"]), (51.0, ["lidar.window_loss", "lidar.range_noise"])],  # noise gains 50
)
def test_a_first_effect_that_only_stood_for_the_second_goes(
    monkeypatch: pytest.MonkeyPatch, lost: float, kept: list[str]
) -> None:
    assert further(monkeypatch, 300.0, 100.0, threshold=50.0, excess=100.0, lost=lost) == kept


def test_of_three_effects_the_one_that_is_idle_goes() -> None:
    explains = {"first": 10.0, "second": 500.0, "third": 500.0}

    def fit(setting: ParameterPoint, nuisance: Any, base: Any) -> Any:
        misfit = 1000.0 - sum(explains[name] for name in setting.values)
        return SimpleNamespace(setting=setting, misfit=misfit, nuisance=nuisance, base=base)

    whole = fit(ParameterPoint({name: {} for name in explains}), NOTHING, None)
    found = workflow._without_idle(SimpleNamespace(fit=fit), Candidate("third", whole, 500.0), 50.0)  # type: ignore[arg-type]
    assert list(found.setting.values) == ["second", "third"]
    # Two that are idle only each beside the other: one of them stays.
    explains.update(first=0.0, second=0.0)
    either = {1: 30.0, 2: -20.0, 3: -20.0}

    def alike(setting: ParameterPoint, nuisance: Any, base: Any) -> Any:
        return SimpleNamespace(setting=setting, misfit=either[len(setting.values)], nuisance=nuisance, base=base)

    whole = alike(ParameterPoint({name: {} for name in explains}), NOTHING, None)
    found = workflow._without_idle(SimpleNamespace(fit=alike), Candidate("third", whole, 500.0), 40.0)  # type: ignore[arg-type]
    assert list(found.setting.values) == ["second", "third"]


@pytest.mark.parametrize(
    ("open_sd", "gain", "without", "verdict"),
    [
        (3.0, 200.0, 0.0, "named"),
        (3.0, 1.0, 0.0, "none"),
        (3.0, 200.0, 199.0, "none"),  # the nuisances do as well where the effect led them, without it
        (3.0, 200.0, -50.0, "named"),
        (1.0, 200.0, 0.0, "none"),
    ],
)
def test_an_effect_may_hide_behind_what_is_left_open(
    monkeypatch: pytest.MonkeyPatch, open_sd: float, gain: float, without: float, verdict: str
) -> None:
    """Without an alarm candidates are fitted only where something open stands far off; their gain is then the alarm."""
    study = tiny_study(rows=8, columns=16, weathers=WEATHERS)
    asked = []

    def quiet(search: Any, effects: Any, base: Any, seed: int) -> Any:
        return replace(global_test(search, effects, base, seed), p_value=0.5, best_null=RNG(1).gumbel(8.0, 3.0, 1000))

    def begin(search: SimulatorLikelihood) -> Fit:
        found = settled(search)
        return replace(found, setting=replace(found.setting, open={"particle gain": open_sd}))

    def singles(search: Any, base: Fit, screening: Any, number: int, say: Any) -> list[Candidate]:
        asked.append(screening.p_value)
        values = {"lidar.window_loss": {"loss_db": 0.01}}
        fit = replace(base, setting=replace(base.setting, values=values), misfit=screening.misfit - gain)

        def settle(search: SimulatorLikelihood, setting: ParameterPoint) -> Any:
            assert (setting.values, setting.open) == ({}, {"particle gain": open_sd})
            return SimpleNamespace(residual=None, nuisance=SimpleNamespace(misfit=lambda _: screening.misfit - without))

        monkeypatch.setattr(SimulatorLikelihood, "settle", settle)
        return [Candidate("lidar.window_loss", fit, gain)]

    settled = SimulatorLikelihood.begin
    monkeypatch.setattr(workflow, "global_test", quiet)
    monkeypatch.setattr(SimulatorLikelihood, "begin", begin)
    monkeypatch.setattr(workflow, "_singles", singles)
    monkeypatch.setattr(workflow, "_rounds", lambda *given: [list(given[4])])
    monkeypatch.setattr(workflow, "_verdict", lambda *given: "named")
    found = find_gap(study, effects=["lidar.window_loss"])
    assert asked == ([0.5] if open_sd > 2.0 else [])
    assert found.verdict == verdict
    assert (found.answer["p_value"] < ALARM_P) == (verdict == "named")


def test_noise_is_the_less_known_the_fewer_clear_frames_tell_it() -> None:
    def of(*clear: tuple[str, int]) -> float:
        measured = [SimpleNamespace(condition=SimpleNamespace(scene=scene), clear_frames=n) for scene, n in clear]
        return overdispersion(SimpleNamespace(measured=measured))  # type: ignore[arg-type]

    assert of(("s0", 8), ("s0", 8)) == pytest.approx(OVERDISPERSION * (1.0 + 2.0 / 7.0))  # a scene counts once
    assert of(("s0", 8), ("s1", 5)) == pytest.approx(OVERDISPERSION * (1.0 + 2.0 / 11.0))
    assert of(("s0", 1)) == pytest.approx(3.0 * OVERDISPERSION)


class Responses:
    """A search whose responses are known: each effect's is turned from the residual by an angle."""

    def __init__(self, clear: int, turns: dict[str, float]) -> None:
        layout = Layout((Group("lost_share", "range_m", "share", (0.0, 1.0, 2.0)),), (), (), ())
        self.model = SimpleNamespace(layout=layout, sizes={})
        condition = SimpleNamespace(id="c0", scene="s0")
        self.measured = [SimpleNamespace(condition=condition, vector=np.zeros(2), clear_frames=clear)]
        ones = {"c0": np.ones(2)}
        self.start = SimpleNamespace(mean=ones, sd=ones, used={"c0": np.ones(2, bool)})
        self.origin, self.turns = ParameterPoint(), turns
        self.asked: list[list[tuple[str, int]]] = []

    def nodes(self, points: Any, setting: ParameterPoint, base: Any) -> list[ResponseTemplate]:
        self.asked.append([(line.effect.id, number) for line, number in points])
        return [
            ResponseTemplate(line, number, line.settings[number], 10.0 * np.array([np.cos(turn), np.sin(turn)]))
            for line, number in points
            for turn in [self.turns[line.effect.id]]
        ]

    def null_residuals(self, nuisance: Systematics, number: int, seed: int) -> Any:
        return RNG(seed).normal(size=(number, 2))


def test_only_lines_near_the_best_are_simulated_whole(monkeypatch: pytest.MonkeyPatch) -> None:
    """The share of the best gain is the squared cosine of the angle to the residual."""
    quiet = SimpleNamespace(p_value=lambda left: 1.0, common_p_value=lambda left: 1.0)
    monkeypatch.setattr(screening_module, "residual_test", lambda *given: quiet)
    shares = {
        "lidar.window_loss": 1.0,
        "lidar.crosstalk": 1.04 * REFINED,
        "lidar.range_noise": 0.96 * REFINED,
    }
    search: Any = Responses(8, {name: float(np.arccos(np.sqrt(share))) for name, share in shares.items()})
    base: Any = SimpleNamespace(residual=np.array([10.0, 0.0]), nuisance=Systematics(np.zeros((2, 1)), np.zeros(1), 1))
    found = global_test(search, [EFFECTS[name] for name in shares], base, 0)
    number = {name: sum(len(line.settings) for line in parameter_grids(EFFECTS[name], [])) for name in shares}
    first = [
        (line.effect.id, place)
        for name in shares
        for line in parameter_grids(EFFECTS[name], [])
        for place in line.first
    ]
    assert search.asked[0] == first
    whole = {name: sum(one == name for one, _ in [*search.asked[0], *search.asked[1]]) for name in shares}
    assert {name for name in shares if whole[name] == number[name]} == {"lidar.window_loss", "lidar.crosstalk"}
    assert not set(search.asked[0]) & set(search.asked[1])
    assert len(found.nodes) == len(found.gains) == sum(whole.values())
    # What noise gains is taken the larger, the fewer clear frames tell it.
    few: Any = Responses(2, search.turns)
    again = global_test(few, [EFFECTS[name] for name in shares], base, 0)
    assert found.best_null.max() > 1.0
    np.testing.assert_allclose(again.best_null, 3.0 / (1.0 + 2.0 / 7.0) * found.best_null, rtol=1e-9)


@pytest.mark.parametrize(("each", "common"), [(1.0, 1.0), (1e-9, 1.0), (1.0, 1e-9)])
def test_an_alarm_is_that_of_any_of_four_departures(
    monkeypatch: pytest.MonkeyPatch, each: float, common: float
) -> None:
    """Noise in the responses and in all entries; one statistic by itself, or what conditions have in common of one."""
    rest = SimpleNamespace(p_value=lambda left: each, common_p_value=lambda left: common)
    monkeypatch.setattr(screening_module, "residual_test", lambda *given: rest)
    search: Any = Responses(8, {"lidar.window_loss": 0.0})
    base: Any = SimpleNamespace(residual=np.array([0.5, 0.0]), nuisance=Systematics(np.zeros((2, 1)), np.zeros(1), 1))
    found = global_test(search, [EFFECTS["lidar.window_loss"]], base, 0)
    assert found.p_value == pytest.approx(min(1.0, 4.0 * min(each, common)))
    assert found.common_p_value == pytest.approx(min(1.0, 4.0 * common))


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
    assert {node.id for node in found} == {"lidar.spray"}
    # Sectors of the statistics are 0.39 rad wide.
    assert min(abs(node.values["azimuth_rad"] - 1.8) for node in found) < 0.6
    best = found[int(delta_chi2(found, fit.nuisance.left(fit.residual)[None], fit.nuisance)[0].argmax())]
    assert best.values["azimuth_rad"] == pytest.approx(1.8, abs=0.6)


# ---- candidates ------------------------------------------------------------------------------------------------------


def test_of_each_effect_the_best_setting_is_fitted_if_it_is_worth_it() -> None:
    found = best_templates(NODES, np.array([1.5, 1.3, 0.3, 0.0]), NOTHING)
    # Gains: 1 x 2 a 1.5 - a^2 of at most 1.35; 26.5 / 9.25; 1.69; 0.09, too little.
    assert [(one.id, one.values) for one, _ in found] == [
        ("lidar.window_loss", {"loss_db": 3.0}),
        ("lidar.range_noise", {"std_m": 0.1}),
    ]
    assert [amplitude for _, amplitude in found] == pytest.approx([5.15 / 9.25, 0.65], rel=1e-12)


def test_what_begins_at_a_threshold_is_also_fitted_from_a_setting_as_it_stands() -> None:
    """Counts that grow as the square: of what is left the strongest explains most if scaled to a tenth, the second as
    it is. Where none is scaled by as much, and of an effect with a few settings, there is one beginning."""
    effect, strengths = EFFECTS["lidar.crosstalk"], (0.01, 0.02, 0.03, 0.04, 0.08)
    line = ParameterGrid(effect, tuple({"probability": one} for one in strengths))
    responses = [[0.2, 0.0, 0.0], [0.9, 0.1, 0.0], [2.0, 1.0, 0.0], [3.0, 4.0, 0.0], [9.0, 9.0, 1.0]]
    nodes = [
        ResponseTemplate(line, k, dict(values), np.array(response))
        for k, (values, response) in enumerate(zip(line.settings, responses, strict=True))
    ]
    nuisance, left = Systematics(np.zeros((3, 1)), np.zeros(1), 1), np.array([1.0, 0.5, 0.0])
    assert unscaled_templates(nodes, [(nodes[4], 0.1)], left, nuisance) == [(nodes[1], 1.0)]
    assert unscaled_templates(nodes, [(nodes[4], 0.9 * MUCH_SCALED)], left, nuisance) == [(nodes[1], 1.0)]
    assert unscaled_templates(nodes, [(nodes[2], 1.1 * MUCH_SCALED)], left, nuisance) == []
    few = [replace(one, line=ParameterGrid(effect, line.settings[:3])) for one in nodes[:3]]
    assert unscaled_templates(few, [(few[2], 0.1)], left, nuisance) == []


def test_what_something_open_may_stand_for_is_what_looks_most_like_what_it_has_done() -> None:
    """The record stands 9 off, what is open -2: along (-2, 0, 2, 0), of which crosstalk explains 4."""
    response = np.array([[0.0, 1.0], [1.0, 0.0], [0.0, -1.0], [0.0, 0.0]])
    found = hidden_templates(NODES, Systematics(response, np.array([9.0, -2.0]), 2), slice(1, 2))
    (first, amplitude), *others = found
    assert (first.id, amplitude) == ("lidar.crosstalk", 1.35)  # twice its response, but no farther than that
    assert [expected for _, expected in others] == [0.0, 0.0]  # a window would do the opposite


def test_pairs_are_of_different_effects_each_once_best_first() -> None:
    gain = np.array([[9.0, 9.0, 5.0, 7.0], [9.0, 9.0, 6.0, 3.0], [5.0, 6.0, 9.0, 1.0], [7.0, 3.0, 1.0, 9.0]])
    found = best_pairs(NODES, gain, ParameterPoint(), 2.0)
    assert [{*setting.values, other.id} for setting, other, _ in found] == [
        {"lidar.window_loss", "lidar.crosstalk"},
        {"lidar.window_loss", "lidar.range_noise"},
    ]
    assert best_pairs(NODES, gain, ParameterPoint(), 8.0) == []


@pytest.mark.parametrize(
    ("name", "values", "amplitude", "expected"),
    [
        ("lidar.window_loss", {"loss_db": 3.0}, 0.5, {"loss_db": 1.5}),
        ("lidar.window_loss", {"loss_db": 3.0}, 0.0, {"loss_db": 3.0 * LEAST_AMPLITUDE}),
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
    found = _start(node(name, values, np.zeros(4)), amplitude)
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
    assert answer["p_value"] < ALARM_P
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


@pytest.mark.parametrize(("least", "kept"), [(99.0, [0.2]), (101.0, [])])
def test_an_effect_that_scatters_is_tried_at_its_likeliest_strength(least: float, kept: list[float]) -> None:
    """Where its response gains 100 in what is no mean: means are off either way, here against what it does."""
    values = (0.01, 0.1, 0.2, 0.9)
    misfit = dict(zip(values, (900.0, 600.0, 500.0, 700.0), strict=True))
    steps = ParameterGrid(EFFECTS["camera.patchy_fog"], tuple({"log_std": one} for one in values))
    nodes = [*NODES, *(ResponseTemplate(steps, one, steps.settings[one], np.zeros(4)) for one in (0, 2))]
    origin = ParameterPoint(log_intensity={"c0": 0.1})

    def fit(setting: ParameterPoint, nuisance: Any, base: Any, iterations: int) -> Any:
        assert (setting.log_intensity, nuisance, base, iterations) == ({"c0": 0.1}, NOTHING, "start", 0)
        return SimpleNamespace(setting=setting, misfit=misfit[setting.values["camera.patchy_fog"]["log_std"]])

    def mean(setting: ParameterPoint, frames: int) -> list[Any]:
        log_std = setting.values.get("camera.patchy_fog", {"log_std": 0.0})["log_std"]
        return [10.0 + log_std * np.array([50.0, 3.0, 4.0, 100.0])]

    start = SimpleNamespace(
        used={"c0": np.array([True, True, True, False])},
        total={"c0": np.array([1.0, 2.0, 2.0, 1.0])},
        z=lambda target: np.array([-80.0, 6.0, 8.0, 90.0]),  # the first is a mean, the last does not count
    )
    search: Any = SimpleNamespace(
        origin=origin,
        fit=fit,
        mean=mean,
        start=start,
        measured=[SimpleNamespace(condition=SimpleNamespace(id="c0"))],
        model=SimpleNamespace(layout=SimpleNamespace(averages=np.array([True, False, False, False]))),
    )
    base: Any = SimpleNamespace(nuisance=NOTHING, residual=np.zeros(4), base="start")
    found = scattering(search, base, nodes, least)
    assert [own.setting.values["camera.patchy_fog"]["log_std"] for own, _ in found] == kept
    for own, (setting, chosen, amplitude) in found:
        assert (setting, chosen.values, amplitude) == (origin, own.setting.values["camera.patchy_fog"], 1.0)


@pytest.mark.parametrize(("gain", "kept"), [(149.0, False), (151.0, True)])
def test_what_promised_nothing_must_be_clearly_better(monkeypatch: pytest.MonkeyPatch, gain: float, kept: bool) -> None:
    """Than the best of those that promised something, 100, by what noise gains, 50."""
    gained = {"lidar.range_noise": 40.0, "lidar.window_loss": 100.0, "lidar.crosstalk": gain}

    def fitted(search: Any, base: Any, proposed: Any, misfit: float, say: Any) -> list[Candidate]:
        assert [node.id for _, node, _ in proposed] == list(reversed(gained))  # what is hidden comes first
        found = [Candidate(node.id, Any, gained[node.id]) for _, node, _ in proposed]  # type: ignore[arg-type]
        return sorted(found, key=lambda one: -one.gain)

    monkeypatch.setattr(workflow, "fitted", fitted)
    monkeypatch.setattr(workflow, "stands_far", lambda setting: True)
    # What is open stands off along crosstalk, of which nothing is left.
    nuisance = Systematics(np.array([[0.0], [0.0], [1.0], [0.0]]), np.array([4.0]), 1)
    base: Any = SimpleNamespace(nuisance=nuisance, residual=np.array([30.0, 30.0, 0.0, 0.0]), setting=ParameterPoint())
    given = {**vars(screening()), "best_null": np.full(100, 50.0)}
    found = SimpleNamespace(**given, nodes=NODES)
    search: Any = SimpleNamespace(origin=ParameterPoint(), measured=[])
    singles = workflow._singles(search, base, found, 4, lambda text: None)  # type: ignore[arg-type]
    assert ("lidar.crosstalk" in [one.id for one in singles]) is kept
    assert {one.id for one in singles} >= {"lidar.window_loss", "lidar.range_noise"}


@pytest.mark.parametrize(("again", "best"), [(90.0, 100.0), (110.0, 110.0)])
def test_what_is_fitted_twice_is_a_candidate_once(monkeypatch: pytest.MonkeyPatch, again: float, best: float) -> None:
    """At its likeliest strength, by which frames scatter, and from its mean response."""

    def fitted(search: Any, base: Any, proposed: Any, misfit: float, say: Any) -> list[Candidate]:
        gain = {"own": again, "base": 100.0}[base.name]
        return [Candidate("lidar.window_loss", Any, gain)]  # type: ignore[arg-type]

    setting = ParameterPoint()
    node = NODES[0]
    monkeypatch.setattr(workflow, "fitted", fitted)
    monkeypatch.setattr(workflow, "scattering", lambda *given: [(SimpleNamespace(name="own"), (setting, node, 1.0))])
    base: Any = SimpleNamespace(
        nuisance=NOTHING, residual=np.array([30.0, 0.0, 0.0, 0.0]), setting=setting, name="base"
    )
    found = SimpleNamespace(**{**vars(screening()), "best_null": np.full(100, 50.0)}, nodes=NODES)
    search: Any = SimpleNamespace(origin=setting, measured=[])
    singles = workflow._singles(search, base, found, 4, lambda text: None)  # type: ignore[arg-type]
    assert [(one.id, one.gain) for one in singles] == [("lidar.window_loss", best)]
