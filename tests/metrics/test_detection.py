"""Average precision: cases counted by hand, pycocotools on random ones, and inputs that are none."""

from __future__ import annotations

import contextlib
import io
import math
import sys
from typing import Any

import numpy as np
import pytest
import torch

from torchweather.core.errors import TorchweatherError
from torchweather.metrics.box_overlap import bev_iou
from torchweather.metrics.detection import average_precision

BOX = [0.0, 0.0, 10.0, 10.0]


def squares(*places: float) -> list[list[float]]:
    """Boxes of 10 by 10 that stand side by side."""
    return [[x, 0.0, x + 10.0, 10.0] for x in places]


def one_class(hits: list[bool], truths: int) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    """An image with so many truths, and detections that are hits or not, the surest first."""
    places, next_hit = [], 0
    for number, hit in enumerate(hits):
        places.append(100.0 * next_hit if hit else 1e5 + 100.0 * number)
        next_hit += hit
    found = {"boxes": squares(*places), "scores": np.linspace(0.9, 0.1, len(hits)), "labels": ["car"] * len(hits)}
    there = {"boxes": squares(*(100.0 * k for k in range(truths))), "labels": ["car"] * truths}
    return [found], [there]


@pytest.mark.parametrize(
    ("hits", "truths", "interpolation", "wanted"),
    [
        ([True, True], 2, "pascal", 1.0),
        ([True, False], 2, "pascal", 0.5),
        ([False, True], 2, "pascal", 0.25),
        # Precision 1, 1/2, 2/3 at recall 1/4, 1/4, 1/2.
        ([True, False, True], 4, "pascal", 0.25 * 1 + 0.25 * 2 / 3),
        # Recalls 0, 0.01 ... 0.25 have precision 1, those to 0.50 have 2/3.
        ([True, False, True], 4, "coco", (26 * 1 + 25 * 2 / 3) / 101),
        # Recalls 1/40 ... 10/40 have precision 1, those to 20/40 have 2/3.
        ([True, False, True], 4, "kitti", (10 * 1 + 10 * 2 / 3) / 40),
        ([True], 1, "coco", 1.0),
        ([True], 1, "kitti", 1.0),
        ([False, False], 3, "coco", 0.0),
        ([], 3, "coco", 0.0),
    ],
)
def test_precision_counted_by_hand(hits: list[bool], truths: int, interpolation: str, wanted: float) -> None:
    found, there = one_class(hits, truths)
    [score] = average_precision(found, there, interpolation=interpolation)
    assert score.value == pytest.approx(wanted, abs=1e-15)
    assert (score.truths, score.detections, score.recall) == (truths, len(hits), sum(hits) / truths)


def random_case(seed: int, images: int = 12, classes: int = 3) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    """Truths, some to be ignored, and detections near them, with misses, false alarms, duplicates and equal scores."""
    draw = np.random.default_rng(seed)
    detections, truths = [], []
    for _ in range(images):
        count = int(draw.integers(0, 7))
        corner, size = draw.uniform(0, 100, (count, 2)), draw.uniform(5, 60, (count, 2))
        boxes, labels = np.concatenate([corner, corner + size], 1), draw.integers(0, classes, count)
        truths.append({"boxes": boxes, "labels": labels, "ignore": draw.random(count) < 0.15})
        again = draw.integers(0, max(count, 1), int(draw.integers(0, 12)) if count else 0)
        moved = boxes[again] + draw.normal(0, 4, (len(again), 4))
        wrong = draw.uniform(0, 100, (2, 2))
        found = np.concatenate(
            [np.sort(moved.reshape(-1, 2, 2), 1).reshape(-1, 4), np.concatenate([wrong, wrong + 20], 1)]
        )
        names = np.concatenate([labels[again], draw.integers(0, classes, 2)])
        detections.append({"boxes": found, "labels": names, "scores": draw.integers(1, 12, len(found)) / 12})
    return detections, truths


def by_pycocotools(
    detections: list[dict[str, Any]], truths: list[dict[str, Any]], thresholds: list[float], areas: list[list[float]]
) -> np.ndarray:  # type: ignore[type-arg]
    """Average precision (class, threshold, area) as pycocotools itself gives it; -1 where there is no truth."""
    from pycocotools.coco import COCO
    from pycocotools.cocoeval import COCOeval

    def entries(images: list[dict[str, Any]]) -> list[dict[str, Any]]:
        listed = []
        for number, image in enumerate(images, 1):
            for k, (x, y, right, bottom) in enumerate(np.asarray(image["boxes"]).tolist()):
                listed.append(
                    {
                        "id": len(listed) + 1,
                        "image_id": number,
                        "category_id": int(image["labels"][k]) + 1,
                        "bbox": [x, y, right - x, bottom - y],
                        "area": (right - x) * (bottom - y),
                        "iscrowd": int(image.get("ignore", np.zeros(99))[k]),
                        "score": float(image.get("scores", np.zeros(99))[k]),
                    }
                )
        return listed

    with contextlib.redirect_stdout(io.StringIO()):
        reference = COCO()
        reference.dataset = {
            "info": {},
            "images": [{"id": k + 1} for k in range(len(truths))],
            "categories": [{"id": k + 1} for k in range(3)],
            "annotations": entries(truths),
        }
        reference.createIndex()
        evaluation = COCOeval(reference, reference.loadRes(entries(detections)), "bbox")
        evaluation.params.iouThrs = np.array(thresholds)
        evaluation.params.areaRng = areas
        evaluation.params.maxDets = [1000]
        evaluation.evaluate()
        evaluation.accumulate()
    return evaluation.eval["precision"].mean(1)[..., 0].transpose(1, 0, 2)  # type: ignore[no-any-return]


@pytest.mark.parametrize("seed", range(8))
def test_the_score_is_that_of_pycocotools(seed: int) -> None:
    detections, truths = random_case(seed)
    thresholds, areas = [0.3, 0.5, 0.75, 0.9], [[0.0, 1e10], [0.0, 500.0], [500.0, 1e10]]
    for image in (*detections, *truths):
        boxes = image["boxes"]
        image["range_m"] = (boxes[:, 2] - boxes[:, 0]) * (boxes[:, 3] - boxes[:, 1])  # the area stands for the distance
    wanted = by_pycocotools(detections, truths, thresholds, areas)
    found = average_precision(detections, truths, thresholds=thresholds, ranges_m=[tuple(each) for each in areas])
    values = np.array([score.value for score in found]).reshape(wanted.shape)
    assert (wanted > 0.05).sum() > 10  # there is something to compare
    assert np.array_equal(np.isnan(values), wanted == -1)
    # pycocotools adds 2e-16 to the number of detections.
    np.testing.assert_allclose(np.nan_to_num(values, nan=-1.0), wanted, rtol=0, atol=1e-12)


@pytest.mark.parametrize("seed", range(4))
def test_boxes_on_the_ground_follow_the_rule_of_boxes_in_images(seed: int) -> None:
    detections, truths = random_case(seed)

    def on_ground(image: dict[str, Any]) -> dict[str, Any]:
        low, high = np.split(np.asarray(image["boxes"]), 2, axis=1)
        flat = np.concatenate([(low + high) / 2, high - low, np.full((len(low), 1), math.pi)], 1)
        return {**image, "boxes": flat}

    options: dict[str, Any] = {"thresholds": [0.31, 0.52, 0.73], "interpolation": "pascal"}
    flat = average_precision(detections, truths, **options)
    ground = average_precision([*map(on_ground, detections)], [*map(on_ground, truths)], overlap=bev_iou, **options)
    assert len({score.value for score in flat}) > 3
    assert [score.value for score in ground] == pytest.approx([score.value for score in flat], abs=1e-12, nan_ok=True)


def test_a_turned_car_is_missed_where_a_straight_one_is_found() -> None:
    car = [20.0, 0.0, 4.5, 1.8, 0.0]
    turned = [20.0, 0.0, 4.5, 1.8, 0.8]  # shares a rhombus: overlaps by 0.39
    truth = [{"boxes": [car], "labels": ["car"]}]
    for box, wanted in ((car, 1.0), (turned, 0.0)):
        [score] = average_precision([{"boxes": [box], "scores": [1.0], "labels": ["car"]}], truth, overlap=bev_iou)
        assert score.value == wanted


def test_a_truth_outside_the_range_is_no_miss_and_its_detection_no_false_alarm() -> None:
    near, far = [10.0, 0.0, 4.0, 2.0, 0.0], [60.0, 0.0, 4.0, 2.0, 0.0]
    truth = [{"boxes": [near, far], "labels": ["car", "car"]}]
    found = [{"boxes": [near, far, [61.0, 30.0, 4.0, 2.0, 0.0]], "scores": [0.5, 0.8, 0.9], "labels": ["car"] * 3}]
    scores = average_precision(
        found, truth, overlap=bev_iou, interpolation="pascal", ranges_m=[(0, 30), (30, math.inf), (100, 200)]
    )
    assert [(score.value, score.truths, score.detections) for score in scores[:2]] == [(1.0, 1, 1), (0.5, 1, 2)]
    assert math.isnan(scores[2].value)
    assert (scores[2].truths, scores[2].detections) == (0, 0)


def test_the_lower_bound_of_a_range_belongs_to_it() -> None:
    truth = [{"boxes": squares(0.0), "labels": [1], "range_m": [30.0]}]
    found = [{"boxes": squares(0.0), "labels": [1], "scores": [1.0], "range_m": [29.0]}]
    near, far = average_precision(found, truth, ranges_m=[(0, 30), (30, 60)])
    assert (near.truths, far.truths) == (0, 1)
    assert far.value == 1.0


def test_a_false_alarm_of_unknown_distance_counts_in_every_range() -> None:
    truth = [{"boxes": squares(0.0, 100.0), "labels": [1, 1], "range_m": [10.0, 50.0]}]
    found = {"boxes": squares(500.0, 0.0, 100.0), "labels": [1, 1, 1], "scores": [0.9, 0.8, 0.7]}
    ranges: Any = [(0, 30), (30, 60)]
    unknown = average_precision([found], truth, ranges_m=ranges, interpolation="pascal")
    assert [score.value for score in unknown] == [0.5, 0.5]
    known = average_precision(
        [{**found, "range_m": [10.0, math.nan, math.nan]}], truth, ranges_m=ranges, interpolation="pascal"
    )
    assert [score.value for score in known] == [0.5, 1.0]


def test_a_second_detection_of_one_truth_is_a_false_alarm() -> None:
    found = [{"boxes": [BOX, BOX], "scores": [0.9, 0.8], "labels": ["car", "car"]}]
    [score] = average_precision(
        found, [{"boxes": [BOX, *squares(50.0)], "labels": ["car", "car"]}], interpolation="pascal"
    )
    assert (score.value, score.detections) == (0.5, 2)


def test_detections_on_an_ignored_truth_do_not_count() -> None:
    truth = [{"boxes": squares(0.0, 50.0), "labels": ["car", "car"], "ignore": [True, False]}]
    found = [{"boxes": squares(0.0, 0.0, 50.0), "scores": [0.9, 0.8, 0.7], "labels": ["car"] * 3}]
    [score] = average_precision(found, truth)
    assert (score.value, score.truths, score.detections) == (1.0, 1, 1)


def test_classes_do_not_mix_and_one_without_truth_has_no_score() -> None:
    truth = [{"boxes": squares(0.0, 50.0), "labels": ["car", "person"]}]
    found = [{"boxes": squares(0.0, 50.0, 90.0), "scores": [0.9, 0.8, 0.7], "labels": ["car", "car", "van"]}]
    scores = {score.label: score for score in average_precision(found, truth)}
    assert list(scores) == ["car", "person", "van"]
    assert scores["car"].value == 1.0
    assert (scores["person"].value, scores["person"].recall) == (0.0, 0.0)
    assert math.isnan(scores["van"].value)
    assert scores["van"].detections == 1
    assert scores["car"].to_dict()["label"] == "car"


def test_scores_are_ranked_over_all_images() -> None:
    truth = [{"boxes": [BOX], "labels": [0]}, {"boxes": [], "labels": []}]
    found = [
        {"boxes": [BOX], "scores": [0.4], "labels": [0]},
        {"boxes": [BOX], "scores": [0.6], "labels": [0]},  # a false alarm that is surer
    ]
    [score] = average_precision(found, truth, interpolation="pascal")
    assert score.value == 0.5


def test_nothing_at_all_gives_no_scores() -> None:
    assert average_precision([], []) == []
    empty: dict[str, Any] = {"boxes": torch.zeros(0, 4), "labels": []}
    assert average_precision([{**empty, "scores": []}], [empty]) == []


def test_tensors_arrays_and_lists_are_one(capsys: pytest.CaptureFixture[str]) -> None:
    detections, truths = random_case(3)
    wanted = [score.to_dict() for score in average_precision(detections, truths)]

    def converted(image: dict[str, Any], to: Any) -> dict[str, Any]:
        return {key: to(value) for key, value in image.items()}

    for to in (torch.as_tensor, lambda value: np.asarray(value).tolist()):
        found = average_precision([converted(i, to) for i in detections], [converted(i, to) for i in truths])
        assert str([score.to_dict() for score in found]) == str(wanted)
    assert capsys.readouterr().out == ""  # pycocotools prints


GOOD = {"boxes": [BOX], "scores": [0.5], "labels": ["car"]}
TRUE = {"boxes": [BOX], "labels": ["car"]}


@pytest.mark.parametrize(
    ("found", "there", "options", "said"),
    [
        ([GOOD], [], {}, "one entry an image; got 1 and 0"),
        ([TRUE], [TRUE], {}, r"detections\[0\] must have boxes, labels, scores"),
        ([GOOD], [GOOD], {}, r"truths\[0\] must have boxes, labels \(and may have range_m, ignore\)"),
        ([{**GOOD, "scores": [math.nan]}], [TRUE], {}, "scores must be finite"),
        ([{**GOOD, "boxes": [[0, 0, math.nan, 1]]}], [TRUE], {}, "boxes must be finite"),
        ([{**GOOD, "scores": [1, 2]}], [TRUE], {}, r"one value a box, \(1,\); got \(2,\)"),
        ([{**GOOD, "labels": []}], [TRUE], {}, "0 labels and 1 boxes"),
        ([{**GOOD, "boxes": [[0, 0, 1]]}], [TRUE], {}, r"\(N, 4\)"),
        ([{**GOOD, "boxes": [[5, 0, 1, 1]]}], [TRUE], {}, "inside out"),
        ([{**GOOD, "boxes": [["a", 0, 1, 1]]}], [TRUE], {}, "must be numbers"),
        ([GOOD], [{**TRUE, "labels": [3]}], {}, "all numbers or all text; got int, str"),
        ([GOOD], [TRUE], {"thresholds": [0.0]}, "must lie in"),
        ([GOOD], [TRUE], {"thresholds": []}, "one entry or more"),
        ([GOOD], [TRUE], {"interpolation": "cocos"}, "Did you mean 'coco'"),
        ([GOOD], [TRUE], {"ranges_m": [(30, 10)]}, "0 <= low < high"),
        ([GOOD], [TRUE], {"ranges_m": [(0, 30)]}, r"truths\[0\] must have range_m"),
        ([GOOD], [{**TRUE, "range_m": [math.nan]}], {"ranges_m": [(0, 30)]}, "must be finite"),
    ],
)
def test_what_cannot_be_scored_is_refused(found: Any, there: Any, options: dict[str, Any], said: str) -> None:
    with pytest.raises(ValueError, match=said):
        average_precision(found, there, **options)


def test_without_pycocotools_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delitem(sys.modules, "torchweather.metrics.coco_matching", raising=False)
    monkeypatch.setitem(sys.modules, "pycocotools", None)
    monkeypatch.setitem(sys.modules, "pycocotools.coco", None)
    with pytest.raises(TorchweatherError, match=r"torchweather\[detection\]"):
        average_precision([GOOD], [TRUE])
