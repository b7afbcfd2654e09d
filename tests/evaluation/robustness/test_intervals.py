"""Intervals over frames, the operating point, and the sentences that go with few frames and rises."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from torchweather.atmosphere.weather import Rain
from torchweather.evaluation.robustness import BoxTruth, LabelTruth, Performance
from torchweather.evaluation.robustness.intervals import Interval, Resampling
from torchweather.evaluation.robustness.operating import operating_point
from torchweather.evaluation.robustness.performance import BoxCounter, LabelCounter
from torchweather.evaluation.robustness.remarks import remarks
from torchweather.evaluation.robustness.result import ConditionResult, RobustnessResult
from torchweather.metrics import average_precision
from torchweather.metrics.detection import matched_boxes
from torchweather.recipes.suite import Condition

CLASSES = {0: "car", 1: "person"}


def frames(count: int, seed: int = 0) -> list[tuple[dict[str, Any], BoxTruth]]:
    """Cars and persons in a row; some are missed, some boxes are false, scores are often equal."""
    draw = np.random.default_rng(seed)
    made = []
    for _ in range(count):
        number = int(draw.integers(1, 5))
        left = np.arange(number) * 20.0
        boxes = np.stack([left, left * 0, left + 10, left * 0 + 10], 1)
        labels = [CLASSES[int(k)] for k in draw.integers(0, 2, number)]
        seen = draw.random(number) < 0.7
        false = np.array([[500.0, 0, 510, 10]])
        found = {
            "boxes": np.concatenate([boxes[seen], false]),
            "scores": draw.integers(1, 8, int(seen.sum()) + 1) / 8,
            "labels": [*(label for label, s in zip(labels, seen, strict=True) if s), "car"],
        }
        made.append((found, BoxTruth(boxes, tuple(labels), np.zeros(number, bool))))
    return made


def counted(made: list[tuple[dict[str, Any], BoxTruth]]) -> BoxCounter:
    counter = BoxCounter(CLASSES, (0.5, 0.75))
    for found, truth in made:
        counter.add(found, truth)
    return counter


def test_frames_drawn_twice_count_as_two_frames() -> None:
    """The fast way over weights gives what the score gives of the listed frames, for every draw."""
    made = frames(6)
    weights = np.random.default_rng(1).multinomial(6, np.full(6, 1 / 6), size=12).astype(float)
    found = counted(made).resampled(weights)
    for row, fast in zip(weights, found["car"], strict=True):
        listed = [frame for frame, times in zip(made, row, strict=True) for _ in range(int(times))]
        truths = [{"boxes": truth.boxes, "labels": list(truth.labels)} for _, truth in listed]
        slow = average_precision([one for one, _ in listed], truths, thresholds=(0.5, 0.75))
        wanted = [each.value for each in slow if each.label == "car"]
        assert fast == pytest.approx(np.mean(wanted), abs=1e-12, nan_ok=True)


def test_a_draw_without_a_class_has_no_mean() -> None:
    counter = counted(frames(2))
    truths = [set(truth.labels) for _, truth in frames(2)]
    weights = np.array([[2.0, 0.0], [0.0, 2.0], [1.0, 1.0]])
    found = counter.resampled(weights)
    for k in range(2):
        assert math.isnan(found[""][k]) == (truths[k] != truths[0] | truths[1])
    assert found[""][2] == pytest.approx(counter.performance().value)


def test_the_mean_over_frames_has_the_interval_of_the_textbook() -> None:
    """IoU of frames that are right or wrong as a whole is a share: the interval is that of a binomial."""
    counter = LabelCounter({0: "road"}, ())
    right = np.arange(200) % 2 == 0
    for each in right:
        counter.add(np.zeros(10, int) if each else np.full(10, 9), LabelTruth(np.zeros(10, int)))
    drawn = Resampling(200, seed=3, resamples=4000)
    found = drawn.interval(drawn.values([counter])[""])
    assert found is not None
    half = 1.96 * math.sqrt(0.25 / 200)
    # 4000 draws: the quantile itself scatters by 0.003 (its density at 2 sigma).
    assert (found.low, found.high) == pytest.approx((0.5 - half, 0.5 + half), abs=0.01)


def test_intervals_are_repeated_by_the_seed_and_four_frames_have_none() -> None:
    counter = counted(frames(8))
    first, again, other = (Resampling(8, seed=seed, resamples=200) for seed in (5, 5, 6))
    assert np.array_equal(first.weights, again.weights)
    assert not np.array_equal(first.weights, other.weights)
    interval = first.interval(first.values([counter])[""])
    assert interval is not None
    assert interval.low < counter.performance().value < interval.high
    few = Resampling(4, seed=5)
    assert few.interval(few.values([counted(frames(4))])[""]) is None
    with pytest.raises(ValueError, match="resamples must be 0 or more"):
        Resampling(3, resamples=-1)


def test_the_operating_point_has_the_highest_f1_and_takes_all_boxes_of_a_score() -> None:
    boxes = [[20.0 * k, 0.0, 20.0 * k + 10, 10.0] for k in range(4)]
    truth = [{"boxes": boxes[:3], "labels": ["car"] * 3}]
    # By falling score: right, right and wrong (equal scores), right. F1: 2/4, 4/6, 6/7.
    found = [{"boxes": [boxes[0], boxes[1], boxes[3], boxes[2]], "scores": [0.9, 0.6, 0.6, 0.3], "labels": ["car"] * 4}]
    point = operating_point(matched_boxes(found, truth))
    assert (point.threshold, point.precision, point.recall) == (0.3, 0.75, 1.0)
    found[0]["boxes"] = [boxes[0], boxes[1], boxes[3], [900.0, 0, 910, 10]]
    assert operating_point(matched_boxes(found, truth)).threshold == 0.6
    # One hit at 0.9, F1 2/3; at 0.6 the other one and three false alarms, 4/7, though the hit alone would make 1.
    truth = [{"boxes": boxes[:2], "labels": ["car"] * 2}]
    wrong = [[900.0 + 20 * k, 0, 910 + 20 * k, 10] for k in range(3)]
    tied = [{"boxes": [*boxes[:2], *wrong], "scores": [0.9, *[0.6] * 4], "labels": ["car"] * 5}]
    assert operating_point(matched_boxes(tied, truth)).threshold == 0.9


def test_a_declared_operating_point_is_taken_and_nothing_to_judge_has_none() -> None:
    truth = [{"boxes": [[0.0, 0, 10, 10], [20.0, 0, 30, 10]], "labels": ["car"] * 2}]
    found = [{"boxes": [[0.0, 0, 10, 10], [900.0, 0, 910, 10]], "scores": [0.9, 0.6], "labels": ["car"] * 2}]
    declared = operating_point(matched_boxes(found, truth), declared=0.7)
    assert (declared.threshold, declared.origin, declared.precision) == (0.7, "declared", 1.0)
    nothing = operating_point([])
    assert math.isnan(nothing.precision)
    assert math.isnan(nothing.recall)


def result(value: float, difference: Interval | None, count: int = 13) -> RobustnessResult:
    condition = Condition("rain", "rain", "rate_mm_per_h", 2.5, 1, Rain(2.5))
    each = ConditionResult(condition, value, (value,), {}, Interval(0.7, 0.95), difference)
    names = tuple(map(str, range(count)))
    return RobustnessResult("AP", Performance(0.8, {}), (each,), {}, names, clear_interval=Interval(0.7, 0.9))


def test_few_frames_are_called_few_with_their_number() -> None:
    assert any(
        "13 frames are few: the 95 % interval in clear air is 0.70 to 0.90" in sentence
        for sentence in remarks(result(0.7, Interval(-0.2, 0.0)))
    )
    assert not any("are few" in sentence for sentence in remarks(result(0.7, Interval(-0.2, 0.0), count=30)))


def test_a_rise_in_weather_is_explained_by_its_interval() -> None:
    [chance] = [each for each in remarks(result(0.82, Interval(-0.01, 0.04))) if "above" in each]
    assert "AP in rain of 2.5 is 0.820, above 0.800 in clear air" in chance
    assert "contains the clear value" in chance
    assert "no sign of a gain" in chance
    [helped] = [each for each in remarks(result(0.9, Interval(0.05, 0.12))) if "above" in each]
    assert "does not contain 0" in helped
    assert not [each for each in remarks(result(0.8, Interval(-0.1, 0.1))) if "above" in each]


def test_guessed_depth_is_the_first_remark() -> None:
    found = remarks(replace(result(0.7, None), depth="guessed"))
    assert found[0].startswith("The depth of the frames is guessed")
    assert not any("guessed" in each for each in remarks(replace(result(0.7, None), depth="completed")))


def test_few_boxes_of_a_class_are_named() -> None:
    found = remarks(replace(result(0.7, None), truths={"car": 35, "truck": 3}))
    assert any("truck 3" in each and "car 35" not in each for each in found)
