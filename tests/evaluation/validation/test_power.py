"""Power of a validation: against a Monte Carlo, and no agreement where the visibility is wrong by a factor of 2."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from scipy import stats

from tests.gap import studies
from torchweather.atmosphere.weather import Fog, Rain, Snow, Weather
from torchweather.core.errors import InputValueError
from torchweather.evaluation.validation.comparison import Comparison, Sample, Shift
from torchweather.evaluation.validation.effect_power import named_effects
from torchweather.evaluation.validation.frame_scores import ScoreMeaning, frame_scores
from torchweather.evaluation.validation.power import changed_weather, crossing, detection_probability
from torchweather.evaluation.validation.run import Validation, validate
from torchweather.gap.study import embedded
from torchweather.gap.study.embedded import embedded_study
from torchweather.gap.study.simulation import simulate
from torchweather.gap.study.study import Frame, Study
from torchweather.stages.catalogue import EFFECTS

MEANING = ScoreMeaning(False, "m")


@pytest.mark.parametrize(("shift", "freedom"), [(0.0, 4.0), (3.0, 4.0), (-6.0, 2.0), (4.0, 30.0)])
def test_the_probability_is_that_of_drawn_tests(shift: float, freedom: float) -> None:
    """Student's t of drawn samples, one by one."""
    rng, bound, draws = np.random.default_rng(3), 3.0, 200_000
    drawn = (rng.standard_normal(draws) + shift) / np.sqrt(rng.chisquare(freedom, draws) / freedom)
    share = float(np.mean(np.abs(drawn) > bound))
    error = 4 * math.sqrt(share * (1 - share) / draws)
    assert detection_probability(2.5 * shift, 2.5, bound, freedom) == pytest.approx(share, abs=error + 2e-3)


def test_power_without_scatter_or_numbers() -> None:
    assert detection_probability(1.0, 0.0, 2.0, 4.0) == 1.0
    assert detection_probability(0.0, 0.0, 2.0, 4.0) == 0.0
    assert detection_probability(math.nan, 1.0, 2.0, 4.0) == 0.0
    assert detection_probability(math.inf, math.nan, 2.0, 4.0) == 1.0


def test_the_smallest_change_is_where_the_power_is_80_percent() -> None:
    assert crossing([2.0, 4.0], lambda factor: float(factor >= 1.5)) == pytest.approx(1.5, rel=2e-3)
    assert crossing([0.5], lambda factor: float(factor <= 0.7)) == pytest.approx(0.7, rel=2e-3)
    assert crossing([2.0, 4.0], lambda _: 0.5) == math.inf
    assert crossing([0.5, 0.25], lambda _: 0.5) == 0.0
    assert math.isnan(crossing([], lambda _: 1.0))


def compared(gap: float, change: float, *, paired: bool = False) -> Comparison:
    """Six frames of scatter 1, and a change of the score at half and twice the rate."""
    scatter = np.array([-1.0, -0.6, -0.2, 0.2, 0.6, 1.0])
    recorded = Sample(tuple(scatter))
    shifts = tuple(
        Shift(factor, recorded, Sample(tuple(scatter + change * math.log2(factor)))) for factor in (0.5, 2.0)
    )
    measured = Sample(tuple(scatter[::-1] - gap))
    return Comparison("mde", MEANING, measured, recorded, Sample((0.0,)), paired=paired, shifts=shifts)


def test_agreement_takes_power() -> None:
    assert compared(0.0, 0.5).verdict == "not decided"
    # Beyond the bound from twice the rate by luck: such frames would have shown it with less than 80 %.
    assert compared(0.0, 1.15).verdict == "not decided"
    assert compared(0.0, 5.0).verdict == "agrees"
    assert compared(5.0, 5.0).verdict == "differs"
    assert replace(compared(0.0, 5.0), shifts=()).verdict == "not decided"
    # No difference, but no nearer to the record than to twice the rate.
    near = compared(-0.95, 1.6)
    assert near.verdict == "not decided"
    assert replace(near, shifts=None).verdict == "agrees"


@pytest.mark.parametrize("paired", [False, True])
def test_power_is_the_share_of_drawn_studies_that_differ(paired: bool) -> None:
    found = compared(0.0, 1.6, paired=paired)
    rng, draws, differ = np.random.default_rng(5), 400, 0
    deviation = found._deviation(None)
    for _ in range(draws):
        if paired:
            sides = (np.zeros(6), 1.6 + deviation * rng.standard_normal(6))
        else:
            sides = (rng.normal(1.6, deviation, 6), rng.normal(0.0, deviation, 6))
        measured, simulated = (Sample(tuple(each)) for each in sides)
        differ += Comparison("mde", MEANING, measured, simulated, Sample((0.0,)), paired=paired).verdict == "differs"
    power = found.power(2.0)
    assert power == pytest.approx(differ / draws, abs=4 * math.sqrt(power * (1 - power) / draws) + 0.01)


def test_the_statement_for_machines() -> None:
    stated = compared(0.0, 5.0).to_dict()["power"]
    below, above = stated["smallest_factor_below"], stated["smallest_factor_above"]
    assert 0.5 < below < 1 < above < 2
    assert below == pytest.approx(1 / above, rel=1e-2)  # the change is the same either way
    assert [each["factor"] for each in stated["at_factors"]] == [0.5, 2.0]
    assert compared(0.0, 0.1).smallest_change == (0.0, math.inf)
    assert replace(compared(0.0, 5.0), shifts=None).to_dict()["power"] is None


def test_weathers_that_no_law_holds_for_are_left_out() -> None:
    assert changed_weather(Rain(10.0), 0.5) == Rain(5.0)
    assert changed_weather(Fog(mor_m=100.0), 2.0) == Fog(mor_m=200.0)
    assert changed_weather(Fog.rehearse(10), 0.5) is None


WHOLE = (Fog(mor_m=200.0), Fog(mor_m=60.0), Snow(1.0))
NAMES = {"camera": ["psnr"], "lidar": ["mde", "sdm"], "radar": None}


@lru_cache
def ten_frames(kind: str, weathers: tuple[Weather, ...], frames: int = 10) -> Study:
    """A simulated study of ten frames a condition, or fewer."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(embedded, "CAMERA_PX", (48, 36))
        patch.setattr(embedded, "RINGS", 16)
        patch.setattr(embedded, "COLUMNS", 64)
        patch.setattr(embedded, "WEATHERS", weathers)
        return embedded_study(kind, clear_frames=4, frames=frames)


def simulated(kind: str, factor: float, weathers: tuple[Weather, ...]) -> Validation:
    """The same with a record that is wrong by a factor."""
    study = ten_frames(kind, weathers)
    scene = study.scenes["test-track"]
    wrong = Study.from_arrays(
        kind=kind,
        sensor=study.sensor,
        beams=study.beams or None,
        scenes=[{"id": "s0", "clear": list(scene.clear), "geometry": scene.geometry}],
        conditions=[
            {"id": c.id, "scene": "s0", "weather": changed_weather(c.weather, 1 / factor), "frames": list(c.frames)}
            for c in study.conditions
            if c.weather is not None
        ],
    )
    return validate(wrong, seed=2, names=NAMES[kind])


@pytest.mark.parametrize("factor", [0.5, 2.0])
@pytest.mark.parametrize(
    ("kind", "weathers"),
    [
        pytest.param("camera", WHOLE[1:2], marks=pytest.mark.long),
        ("radar", WHOLE[1:2]),
        *(pytest.param(kind, WHOLE, marks=pytest.mark.long) for kind in ("lidar", "camera", "radar")),
    ],
)
def test_a_record_wrong_by_a_factor_of_2_never_agrees(kind: str, factor: float, weathers: tuple[Weather, ...]) -> None:
    found = simulated(kind, factor, weathers)
    for condition in found.conditions:
        assert condition.verdict in ("differs", "not decided")
        assert {score.verdict for score in condition.scores} <= {"differs", "not decided", "unjudged"}
    if kind != "radar":  # where weather of this strength takes less than the targets fluctuate
        assert {condition.verdict for condition in found.conditions} == {"differs"}


def test_a_right_record_agrees_where_there_is_power() -> None:
    found = simulated("camera", 1.0, WHOLE[1:2])
    assert {condition.verdict for condition in found.conditions} == {"agrees"}
    assert found.verdict().startswith("These frames would have shown a rate or visibility wrong by a factor of 2")
    held = json.loads(json.dumps(found.to_dict(), allow_nan=False))
    for condition in held["conditions"]:
        below, above = condition["smallest_factors_flagged"]
        assert 0.5 < below < 1.0 < above < 2.0


def test_without_power_nothing_agrees() -> None:
    found = validate(embedded_study("radar", clear_frames=3, frames=3), names=["power_change_db"], power=False)
    assert found.counts()["agree"] == 0
    assert found.counts()["not_decided"] == 12
    assert "would have shown" not in found.verdict()


def test_the_bound_of_the_power_is_that_of_the_test() -> None:
    found = replace(compared(0.0, 5.0), level=0.01)
    assert found.power(1.0) == pytest.approx(0.01, abs=2e-3)  # no change: the level itself
    assert found.bound == pytest.approx(stats.t.isf(0.005, 10), rel=1e-9)


@pytest.mark.parametrize("kind", ["camera", "lidar", "radar"])
def test_what_a_mask_leaves_out_does_not_count(kind: str) -> None:
    study = studies.study(kind)
    scene = next(iter(study.scenes.values()))
    score, clear = frame_scores(study).score, scene.clear[0]
    key, value = {"camera": ("bayer", 0.9), "lidar": ("range_m", 1.5), "radar": ("power_db", 99.0)}[kind]
    mask = np.zeros(np.shape(clear[key]))
    mask.reshape(-1)[0] = 1
    odd = {**clear, key: np.where(mask != 0, value, clear[key])}
    masked = {**scene.geometry, "mask": mask}
    assert score(odd, clear, masked) == score(clear, clear, masked)
    assert score(odd, clear, scene.geometry) != score(clear, clear, scene.geometry)


# ---- named effects ---------------------------------------------------------------------------------------------------


def test_the_values_of_an_effect_at_its_strengths() -> None:
    """By hand, from the sizes of the catalogue."""
    found = {each.id: each for kind in ("lidar", "camera") for each in named_effects(kind, ["all"], "test")}
    assert found["lidar.window_loss"].text(0.25) == "loss_db = 0.5"
    assert found["camera.extinction_scale"].value(1.0) == pytest.approx(math.exp(0.5))
    assert found["camera.height_fog"].value(4.0) == pytest.approx(5.0)  # nothing where it is infinitely high
    assert found["lidar.last_return"].strength(4.0) == pytest.approx(2.0)  # a probability ends at 1
    light = found["camera.airlight_scale"].at(1.0).config()
    assert light == pytest.approx(dict.fromkeys(("red", "green", "blue"), math.exp(0.2)), rel=1e-6)
    assert "lidar.snow_cover" not in found
    assert [each.id for each in named_effects("lidar", ["lidar.snow_cover"], "test")] == ["lidar.snow_cover"]
    with pytest.raises(InputValueError, match=r"effect must be one of .*got 'lidar.window_los'"):
        named_effects("lidar", ["lidar.window_los"], "test")
    with pytest.raises(InputValueError, match="frames of a sensor; got a study of links"):
        named_effects("link", ["all"], "test")


def test_power_against_an_effect_is_that_against_the_same_change() -> None:
    found = compared(0.0, 1.6)
    assert found.shifts is not None
    half = replace(found.shifts[1], factor=1.0)
    found = replace(found, effects={"lidar.window_loss": (half, replace(half, factor=4.0))})
    assert found.power_of_effect("lidar.window_loss", 1.0) == pytest.approx(found.power(2.0))
    least = found.smallest_strength("lidar.window_loss")
    assert least == math.inf or found.power_of_effect("lidar.window_loss", least) == pytest.approx(0.8, abs=0.02)
    strong = replace(compared(0.0, 5.0), effects={"a": (replace(compared(0.0, 5.0).shifts[1], factor=1.0),)})  # type: ignore[index]
    assert strong.power_of_effect("a", strong.smallest_strength("a")) == pytest.approx(0.8, abs=0.02)
    assert 0.0 < strong.smallest_strength("a") < 1.0


EFFECT_IDS = ["radar.wet_rcs", "radar.volume_clutter", "radar.range_migration"]


def test_an_effect_of_the_stated_strength_is_flagged() -> None:
    """Known answer: measured frames that have the effect at three times the smallest strength differ."""
    study = ten_frames("radar", WHOLE[1:2])
    found = validate(study, seed=2, names=["power_change_db", "power_rmse_db"], effects=EFFECT_IDS)
    condition = found.conditions[0]
    gain, clutter = condition.smallest_effects
    assert (gain.effect, gain.parameter, gain.unit, gain.typical) == ("radar.wet_rcs", "gain_db", "dB", 2.0)
    assert 0.0 < gain.value < 8.0
    assert gain.score == "power_change_db"
    assert clutter.strength == math.inf  # echoes of drops are no targets
    assert clutter.score == ""
    assert list(condition.not_tried) == ["radar.range_migration"]
    for value, verdicts in ((3.0 * gain.value, {"differs"}), (0.0, {"agrees", "not decided"})):
        effect = EFFECTS["radar.wet_rcs"](gain_db=value)
        own = study.conditions[0]
        wet = [simulate(study, own, seed=77, number=number, effects=[effect]) for number in range(len(own.frames))]
        with_effect = validate(with_frames(study, wet), seed=2, names=["power_change_db"], power=False)
        assert {with_effect.conditions[0].scores[0].verdict} <= verdicts
    stated = json.loads(json.dumps(found.to_dict(), allow_nan=False))["conditions"][0]
    assert stated["smallest_effects_flagged"][0]["value"] == pytest.approx(gain.value)
    assert stated["scores"][0]["effects"]["radar.wet_rcs"]["smallest_strength"] == pytest.approx(gain.strength)


def with_frames(study: Study, frames: Sequence[Frame]) -> Study:
    """A study with other measured frames of its first condition."""
    scene, first = study.scenes["test-track"], study.conditions[0]
    return Study.from_arrays(
        kind=study.kind,
        sensor=study.sensor,
        beams=study.beams or None,
        scenes=[{"id": "s0", "clear": list(scene.clear), "geometry": scene.geometry}],
        conditions=[{"id": first.id, "scene": "s0", "weather": first.weather, "frames": list(frames)}],
    )


def test_effects_need_power() -> None:
    with pytest.raises(InputValueError, match="effects are for the power"):
        validate(ten_frames("radar", WHOLE[1:2]), effects=["all"], power=False)


@pytest.mark.parametrize("kind", ["camera", "lidar", "radar"])
def test_an_effect_at_its_identity_changes_no_simulated_frame(kind: str) -> None:
    study = ten_frames(kind, WHOLE[1:2], 1)
    condition = study.conditions[0]
    tried = named_effects(kind, [f"{kind}.{IDENTITIES[kind]}"], "test")[0]
    plain = simulate(study, condition, seed=3)
    for strength, same in ((0.0, True), (4.0, False)):
        frame = simulate(study, condition, seed=3, effects=[tried.at(strength)])
        # A range is the length of a vector there: the last digit of float32 on 100 m.
        pairs = [np.allclose(frame[key], plain[key], atol=1e-4, equal_nan=True) for key in plain]
        assert all(pairs) is same


IDENTITIES = {"camera": "exposure_gain", "lidar": "wet_target", "radar": "wet_radome"}
