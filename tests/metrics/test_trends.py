"""Trends on scores whose answer is known, and their bootstrap."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from torchweather.metrics.trends import SceneTrends, expected_trends


def one(levels: list[Any], direction: str = "down", **options: Any) -> Any:
    return expected_trends({"road": {"score": levels}}, {"score": direction}, **options)["road"].metrics["score"]


@pytest.mark.parametrize(
    ("levels", "verdict"),
    [
        ([1, 2, 3], "expected"),
        ([3, 2, 1], "reversed"),
        ([1, 3, 2], "broken"),
        ([1, 2, 2], "tied"),
        ([2, 2, 2], "tied"),
        ([2, 2, 1], "broken"),
        ([3, 3, 1], "broken"),
        ([1, None, 2], "expected"),
        ([1, math.nan, 1], "tied"),
        ([None, None, 2], "unjudged"),
        ([[], 1, 2], "expected"),
        ([1, 2, math.inf], "expected"),
        ([1, math.inf, math.inf], "tied"),
        ([], "unjudged"),
    ],
)
def test_verdicts_of_a_score_that_is_better_when_lower(levels: list[Any], verdict: str) -> None:
    assert one(levels).verdict == verdict


def test_higher_is_better_turns_the_verdict() -> None:
    assert one([3, 2, 1], "up").verdict == "expected"
    assert one([1, 2, 3], "up").verdict == "reversed"
    assert one([math.inf, 30.0, 20.0], "up").verdict == "expected"


def test_missing_levels_are_named_and_weaken_the_evidence() -> None:
    trend = one([1, None, 2, 3])
    assert trend.missing == (1,)
    assert trend.levels == 3
    assert trend.chance == pytest.approx(1 / 6)
    assert one([1, 2]).chance == 0.5


def test_scores_closer_than_the_tie_are_equal() -> None:
    assert one([1.0, 1.05, 2.0]).verdict == "expected"
    assert one([1.0, 1.05, 2.0], tie_within=0.1).verdict == "tied"
    assert one([1.0, 0.95, 2.0], tie_within=0.1).verdict == "tied"
    assert one([1.0, 0.8, 2.0], tie_within=0.1).verdict == "broken"


def test_counts_leave_out_what_cannot_be_judged() -> None:
    scores = {"a": {"up": [3, 2], "down": [1, 2], "gone": [None, 1]}, "b": {"up": [2, 3], "down": [1, 1]}}
    found = expected_trends(scores, {"up": "up", "down": "down", "gone": "up"})
    assert (found["a"].expected, found["a"].out_of) == (2, 2)
    assert (found["b"].expected, found["b"].out_of) == (0, 2)
    assert found["a"].coin_flip
    assert not expected_trends({"c": {"up": [3, 2, 1]}}, {"up": "up"})["c"].coin_flip


def test_random_scores_show_the_trend_as_often_as_chance_says() -> None:
    draws = np.random.default_rng(1).random((4000, 4))
    shown = np.mean([one(list(row)).verdict == "expected" for row in draws])
    # 4000 draws of probability 1/24: standard error 0.0032, four of them
    assert shown == pytest.approx(1 / 24, abs=0.0127)


# ---- bootstrap -----------------------------------------------------------------------------------------------------


def frames(means: list[float], spread: float, number: int = 40, seed: int = 2) -> list[Any]:
    generator = np.random.default_rng(seed)
    return [mean + spread * generator.standard_normal(number) for mean in means]


def test_the_score_of_a_level_is_the_mean_of_its_frames() -> None:
    assert one([[0.0, 4.0], [3.0, 3.0], [4.0]]).verdict == "expected"  # medians and maxima would say otherwise
    assert one([[1.0, math.nan], [2.0, 2.0]]).verdict == "expected"


@pytest.mark.parametrize("paired", [False, True])
def test_a_level_of_both_infinities_has_no_score(paired: bool) -> None:
    found = one([[1.0, 1.1], [math.inf, -math.inf], [2.0, 2.1]], paired=paired)
    assert (found.verdict, found.missing, found.levels, found.confidence) == ("expected", (1,), 2, 1.0)
    one_sided = one([[1.0, 1.1], [2.0, 2.1], [math.inf, 3.0]], paired=paired)
    # Infinite in 3 of 4 draws and 3 in the fourth, always more than 2.1.
    assert (one_sided.verdict, one_sided.missing, one_sided.confidence) == ("expected", (), 1.0)


def test_confidence_is_there_with_several_frames_only() -> None:
    assert one([1, 2, 3]).confidence is None
    assert one([[1, 1.1], [2, 2.1], [3]]).confidence is None
    assert one([[1, math.nan], [2, 2.1]]).confidence is None
    assert one([[1, 1.1], [2, 2.1]]).confidence == 1.0


def test_confidence_of_two_levels_follows_from_their_standard_errors() -> None:
    first, second = frames([0.0, 0.1], 0.5, 50)
    found = one([first, second], resamples=20000)
    error = math.sqrt((first.var() + second.var()) / 50)
    wanted = 0.5 * (1.0 + math.erf((second.mean() - first.mean()) / error / math.sqrt(2.0)))
    # 20 000 samples: standard error below 0.0036, four of them; the mean of 50 frames is normal to 0.01
    assert found.confidence == pytest.approx(wanted, abs=0.025)
    assert 0.1 < found.confidence < 0.999


def test_frames_of_one_scene_are_drawn_together_when_paired() -> None:
    base = 5.0 * np.random.default_rng(3).standard_normal(30)
    levels = [base, base + 0.1, base + 0.2]
    assert one(levels, paired=True).confidence == 1.0
    assert one(levels).confidence < 0.6
    with pytest.raises(ValueError, match=r"paired levels need as many frames each; got \[2, 3\]"):
        one([[1, 2], [1, 2, 3]], paired=True)


def scene(seed: int = 0, resamples: int = 1000) -> SceneTrends:
    scores = {"a": frames([0.0, 0.1, 0.2], 0.3), "b": frames([0.0, 1.0, 2.0], 0.3), "c": frames([2.0, 1.0, 0.0], 0.3)}
    return expected_trends({"s": scores}, dict.fromkeys("abc", "down"), seed=seed, resamples=resamples)["s"]


def test_the_interval_of_the_count_holds_what_is_sure_and_what_is_not() -> None:
    found = scene()
    assert found.interval is not None
    assert found.interval == (1, 2)  # b always, c never, a at times
    assert found.metrics["b"].confidence == 1.0
    assert found.metrics["c"].confidence == 0.0
    confidence = found.metrics["a"].confidence
    assert confidence is not None
    assert 0.1 < confidence < 0.95
    mixed = {"a": frames([0.0, 1.0], 0.3), "b": [1.0, 2.0]}
    assert expected_trends({"s": mixed}, {"a": "down", "b": "down"})["s"].interval is None


def test_one_seed_gives_one_answer() -> None:
    assert scene(seed=4) == scene(seed=4)
    assert scene(seed=4) != scene(seed=5)


# ---- mistakes ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("scores", "options", "said"),
    [
        ({"a": [1, 2], "b": [1, 2, 3]}, {}, r"one entry per level; got \[2, 3\]"),
        ({"c": [1, 2]}, {}, "direction of c must be 'up'"),
        ({"d": [1, 2]}, {}, "got 'sideways'"),
        ({"a": [[[1.0]], [[2.0]]]}, {}, r"scores \(F,\); got \(1, 1\)"),
        ({"a": [1, 2]}, {"tie_within": -1.0}, "tie_within must be 0 or more"),
        ({"a": [1, 2]}, {"tie_within": math.nan}, "tie_within must be 0 or more"),
        ({"a": [1, 2]}, {"resamples": 0}, "resamples must be 1 or more"),
    ],
)
def test_mistakes_are_named(scores: dict[str, Any], options: dict[str, Any], said: str) -> None:
    with pytest.raises(ValueError, match=said):
        expected_trends({"road": scores}, {"a": "up", "b": "down", "d": "sideways"}, **options)
