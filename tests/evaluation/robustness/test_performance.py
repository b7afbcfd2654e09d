"""Ground truth and what is counted against it, by hand."""

from __future__ import annotations

import importlib.util
import json
import math
from pathlib import Path

import numpy as np
import pytest
import torch

from torchweather.core.errors import TorchweatherError
from torchweather.evaluation.robustness import BoxTruth, LabelTruth, read_boxes_truth, read_label_truth
from torchweather.evaluation.robustness.performance import BoxCounter, LabelCounter
from torchweather.io import PointLabels, write_image, write_labels

CLASSES = {0: "road", 1: "car"}


def test_intersection_over_union_is_counted_over_all_frames() -> None:
    counter = LabelCounter(CLASSES, ())
    counter.add(np.array([0, 0, 1, 1]), LabelTruth(np.array([0, 1, 1, 255])))  # the last one is not judged
    counter.add(np.array([1, 0]), LabelTruth(np.array([1, 0])))
    found = counter.performance()
    assert found.by_class == pytest.approx({"road": 2 / 3, "car": 2 / 3})
    assert found.value == pytest.approx(2 / 3)


def test_a_class_predicted_on_the_weather_is_a_false_alarm() -> None:
    counter = LabelCounter(CLASSES, ())
    counter.add(np.array([0, 1, 1]), LabelTruth(np.array([0, 1, 1])), np.array([False, False, True]))
    assert counter.performance().by_class == pytest.approx({"road": 1.0, "car": 0.5})


def test_a_class_without_truth_has_no_part_in_the_mean() -> None:
    counter = LabelCounter(CLASSES, ())
    counter.add(np.array([0, 1]), LabelTruth(np.array([0, 0])))
    found = counter.performance()
    assert math.isnan(found.by_class["car"])
    assert found.value == 0.5


def test_a_class_of_which_the_weather_took_all_has_nothing_left() -> None:
    clear, foggy = LabelCounter(CLASSES, ()), LabelCounter(CLASSES, ())
    clear.add(np.array([0, 0]), LabelTruth(np.array([0, 1])))
    foggy.add(np.array([0]), LabelTruth(np.array([0])))
    found = foggy.performance(clear.performance())
    assert found.by_class == {"road": 1.0, "car": 0.0}
    assert found.value == 0.5


def test_average_precision_is_the_mean_over_thresholds_and_classes() -> None:
    counter = BoxCounter({0: "car", 1: "person"}, (0.5, 0.9))
    truth = BoxTruth(np.array([[0, 0, 10, 10], [20, 0, 30, 10.0]]), ("car", "person"), np.zeros(2, bool))
    found = {"boxes": [[0, 0, 10, 8], [20, 0, 30, 10]], "scores": [0.9, 0.9], "labels": ["car", "person"]}
    counter.add(found, truth)  # the car overlaps by 0.8: a hit at 0.5 alone
    assert counter.performance().by_class == pytest.approx({"car": 0.5, "person": 1.0})
    assert counter.performance().value == pytest.approx(0.75)


def test_a_region_to_be_ignored_holds_any_number_of_boxes_as_coco_has_it() -> None:
    """The boxes cover a hundredth of the region each: by intersection over union they would be false alarms."""
    counter = BoxCounter({0: "car"}, (0.5,))
    region = [0.0, 0.0, 100.0, 100.0]
    truth = BoxTruth(np.array([region, [200, 0, 210, 10.0]]), ("car", "car"), np.array([True, False]))
    inside = [[10.0 * k, 50.0, 10.0 * k + 10, 60.0] for k in range(5)]
    half_out = [[94.0, 0.0, 106.0, 10.0]]  # half of it: a hit of the region at 0.5
    found = {"boxes": [*inside, *half_out, [200, 0, 210, 10]], "scores": [0.9] * 6 + [0.1], "labels": ["car"] * 7}
    counter.add(found, truth)
    assert counter.performance().value == 1.0
    assert counter.judged == {"car": 1}
    outside = {**found, "boxes": [*inside, [95.0, 0.0, 106.0, 10.0], [200, 0, 210, 10]]}
    counter = BoxCounter({0: "car"}, (0.5,))
    counter.add(outside, truth)  # less than half of it: a false alarm
    assert counter.performance().value == 0.5


def test_without_pycocotools_it_is_said_before_the_work(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(importlib.util, "find_spec", lambda _: None)
    with pytest.raises(TorchweatherError, match=r"torchweather\[detection\]"):
        BoxCounter(CLASSES, (0.5,))


def coco(folder: Path) -> Path:
    path = folder / "annotations.json"
    values = {
        "images": [{"id": 7, "file_name": "images/a.png"}, {"id": 8, "file_name": "b.png"}],
        "annotations": [
            {"id": 1, "image_id": 7, "category_id": 3, "bbox": [1, 2, 3, 4]},
            {"id": 2, "image_id": 7, "category_id": 3, "bbox": [1, 2, 5, 5], "iscrowd": 1},
            {"id": 3, "image_id": 7, "category_id": 9, "bbox": [0, 0, 1, 1]},
        ],
        "categories": [{"id": 3, "name": "car"}, {"id": 9, "name": "tree"}],
    }
    path.write_text(json.dumps(values))
    return path


def test_boxes_are_read_from_coco_and_crowds_ignored(tmp_path: Path) -> None:
    found = read_boxes_truth(coco(tmp_path), CLASSES)
    assert list(found) == ["a", "b"]
    assert found["a"].boxes.tolist() == [[1, 2, 4, 6], [1, 2, 6, 7]]
    assert found["a"].labels == ("car", "car")
    assert found["a"].ignore.tolist() == [False, True]
    assert found["b"].boxes.shape == (0, 4)


def test_a_truth_that_is_none_is_named(tmp_path: Path) -> None:
    with pytest.raises(TorchweatherError, match=r"no such file; expected JSON with ground truth"):
        read_boxes_truth(tmp_path / "none.json", CLASSES)
    with pytest.raises(TorchweatherError, match=r"no category of the detector; it has car, tree, the detector cat"):
        read_boxes_truth(coco(tmp_path), {0: "cat"})
    (tmp_path / "list.json").write_text("[]")
    with pytest.raises(TorchweatherError, match=r"expected ground truth as COCO's JSON"):
        read_boxes_truth(tmp_path / "list.json", CLASSES)
    broken = json.loads(coco(tmp_path).read_text())
    broken["annotations"][0]["bbox"] = [0, 0, -1, 1]
    (tmp_path / "broken.json").write_text(json.dumps(broken))
    with pytest.raises(TorchweatherError, match="bbox must be left, top, width, height"):
        read_boxes_truth(tmp_path / "broken.json", CLASSES)


def test_labels_are_read_from_images_and_label_files(tmp_path: Path) -> None:
    write_image(tmp_path / "a.png", torch.tensor([[[0, 1], [1, 255]]], dtype=torch.uint8))
    assert read_label_truth(tmp_path, "a", "camera", (2, 2)).classes.tolist() == [[0, 1], [1, 255]]
    with pytest.raises(TorchweatherError, match=r"a\.png: expected one class a pixel, 2 x 3"):
        read_label_truth(tmp_path, "a", "camera", (2, 3))
    write_labels(tmp_path / "c.label", PointLabels(torch.tensor([0, 1]), torch.tensor([0, 5])))
    assert read_label_truth(tmp_path, "c", "lidar", (2,)).classes.tolist() == [0, 1]
    with pytest.raises(TorchweatherError, match=r"no ground truth for b; expected b with \.label"):
        read_label_truth(tmp_path, "b", "lidar", (2,))


def test_boxes_of_an_image_on_its_side_are_refused() -> None:
    truth = BoxTruth(np.zeros((0, 4)), (), np.zeros(0, bool), (48, 64))
    truth.check_size((48, 64), "0.jpg")
    with pytest.raises(TorchweatherError, match=r"0\.jpg: .* of 64 x 48 px; the frame has 48 x 64\. .*EXIF"):
        truth.check_size((64, 48), "0.jpg")
    with pytest.raises(TorchweatherError, match="scale the boxes"):
        truth.check_size((96, 128), "0.jpg")
