"""Every layout of a detector's outputs gives the same boxes, by hand."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from torchweather.core.errors import TorchweatherError
from torchweather.evaluation.robustness import Declaration, read_declaration
from torchweather.evaluation.robustness.decoders import decode_boxes
from torchweather.evaluation.robustness.placement import Placement

# A frame of 100 x 200 px in an input of 64 x 64 px: half a scale of 0.32, a border above and below.
LETTERBOX = Placement((100, 200), (64, 64), top=16, left=0, height=32, width=64)
# In the input: a car and a person, whose scores in the other class are low.
CAR, PERSON = [16.0, 24.0, 32.0, 40.0], [40.0, 20.0, 48.0, 44.0]
SCORES = [[0.9, 0.1], [0.2, 0.8]]
# The same in the frame: x / 0.32, (y - 16) / 0.32.
IN_FRAME = {"car": [50.0, 25.0, 100.0, 75.0], "person": [125.0, 12.5, 150.0, 87.5]}


def declaration(folder: Path, decoder: str, outputs: dict[str, Any], **options: Any) -> Declaration:
    values = {
        "format": "torchweather-detector/1",
        "title": "by hand",
        "sensor": "camera",
        "input": {"name": "image", "size": [64, 64], "fit": "letterbox"},
        "decoder": decoder,
        "outputs": outputs,
        "classes": ["car", "person"],
        "options": {"threshold": 0.3, **options},
    }
    path = folder / "model.yaml"
    path.write_text(yaml.safe_dump(values))
    return read_declaration(path)


def centred(box: list[float]) -> list[float]:
    left, top, right, bottom = box
    return [(left + right) / 2, (top + bottom) / 2, right - left, bottom - top]


def logit(share: float) -> float:
    return math.log(share / (1 - share))


def packed_yolov8() -> np.ndarray[Any, Any]:
    places = [[*centred(box), *scores] for box, scores in zip((CAR, PERSON), SCORES, strict=True)]
    return np.array(places + [[1.0, 1.0, 1.0, 1.0, 0.01, 0.02]] * 20, np.float32).T[None]


def packed_yolov5() -> np.ndarray[Any, Any]:
    """Objectness 0.5 and scores twice as high."""
    places = [[*centred(box), 0.5, *(2 * s for s in scores)] for box, scores in zip((CAR, PERSON), SCORES, strict=True)]
    return np.array(places + [[1.0, 1.0, 1.0, 1.0, 0.0, 0.9, 0.9]] * 20, np.float32)[None]


FIXED = np.array([[*CAR, 0.9], [*PERSON, 0.8]], np.float32)
LABELS = np.array([0, 1], np.int64)
SET = np.array([centred(CAR), centred(PERSON), [32, 32, 9, 9]], np.float32)[None] / 64
# Softmax over car, person, no object: the shares are those of the logarithms.
SOFTMAX = np.log(np.array([[[0.9, 0.05, 0.05], [0.1, 0.8, 0.1], [0.02, 0.03, 0.95]]], np.float32))
SIGMOID = np.vectorize(logit)(np.array([[*SCORES, [0.01, 0.02]]], np.float32))

LAYOUTS: dict[str, tuple[str, dict[str, Any], dict[str, Any]]] = {
    "yolov8": ("yolov8", {"packed": packed_yolov8()}, {}),
    "yolov5": ("yolov5", {"packed": packed_yolov5()}, {}),
    "end-to-end": ("end-to-end", {"packed": np.concatenate([FIXED, LABELS[:, None]], 1)[None]}, {}),
    "mmdeploy": ("mmdeploy", {"boxes": FIXED[None], "labels": LABELS[None]}, {}),
    "boxes": ("boxes", {"boxes": FIXED[:, :4], "scores": FIXED[:, 4], "labels": LABELS}, {}),
    "boxes, by class": ("boxes", {"boxes": FIXED[None, :, :4], "scores": np.array([SCORES])}, {}),
    "boxes, yxyx": (
        "boxes",
        {"boxes": FIXED[:, [1, 0, 3, 2]] / 64, "scores": FIXED[:, 4], "labels": LABELS.astype(np.float32)},
        {"form": "yxyx", "normalised": True},
    ),
    "detr": ("detr", {"logits": SOFTMAX, "boxes": SET}, {}),
    "detr, sigmoid": ("detr", {"logits": SIGMOID, "boxes": SET}, {"activation": "sigmoid"}),
}


@pytest.mark.parametrize("name", list(LAYOUTS))
def test_every_layout_gives_the_boxes_in_the_frame(name: str, tmp_path: Path) -> None:
    decoder, outputs, options = LAYOUTS[name]
    declared = declaration(tmp_path, decoder, {role: role for role in outputs}, **options)
    found = decode_boxes({role: [array] for role, array in outputs.items()}, declared, LETTERBOX)
    assert dict(zip(found["labels"], found["scores"], strict=True)) == pytest.approx(
        {"car": 0.9, "person": 0.8}, abs=1e-6
    )
    for label, box in zip(found["labels"], found["boxes"], strict=True):
        assert box == pytest.approx(IN_FRAME[label], abs=1e-4)


def test_of_a_set_the_best_class_counts_though_no_object_is_surer(tmp_path: Path) -> None:
    """Average precision needs the unsure boxes as well."""
    declared = declaration(tmp_path, "detr", {"logits": "l", "boxes": "b"})
    logits = np.log(np.array([[[0.4, 0.05, 0.55]]], np.float32))
    found = decode_boxes({"logits": [logits], "boxes": [SET[:, :1]]}, declared, LETTERBOX)
    assert found["labels"] == ["car"]
    assert found["scores"] == pytest.approx([0.4])


def distances(bins: int, *sides: float) -> list[float]:
    """Logits of four distributions whose means are the sides, in strides: between two whole bins."""
    found = []
    for side in sides:
        shares = np.full(bins, 1e-9)
        low = int(side)
        shares[low] += 1 - (side - low)
        shares[min(low + 1, bins - 1)] += side - low
        found += np.log(shares).tolist()
    return found


def test_distributions_of_levels_are_means_times_the_stride(tmp_path: Path) -> None:
    """Places count in rows; the centre of the first one lies half a stride from the corner."""
    bins = 8
    scores = [np.zeros((1, (64 // stride) ** 2, 2), np.float32) for stride in (8, 16)]
    sides = [np.zeros((1, (64 // stride) ** 2, 4 * bins), np.float32) for stride in (8, 16)]
    # The car from the place (row 4, column 3) of stride 8, centre (28, 36); the person from (1, 2) of 16: (40, 24).
    for level, place, stride, (x, y), box, wanted in (
        (0, 4 * 8 + 3, 8, (28, 36), CAR, SCORES[0]),
        (1, 1 * 4 + 2, 16, (40, 24), PERSON, SCORES[1]),
    ):
        left, top, right, bottom = box
        scores[level][0, place] = wanted
        sides[level][0, place] = distances(
            bins, (x - left) / stride, (y - top) / stride, (right - x) / stride, (bottom - y) / stride
        )
    names = {"scores": ["s8", "s16"], "boxes": ["b8", "b16"]}
    declared = declaration(tmp_path, "nanodet", names, strides=[8, 16])
    found = decode_boxes({"scores": scores, "boxes": sides}, declared, LETTERBOX)
    assert found["labels"] == ["car", "person"]
    for label, box in zip(found["labels"], found["boxes"], strict=True):
        assert box == pytest.approx(IN_FRAME[label], abs=1e-3)
    with pytest.raises(TorchweatherError, match=r"expected 8 x 8 places of stride 8 .* got scores \(16, 2\)"):
        decode_boxes({"scores": scores[::-1], "boxes": sides[::-1]}, declared, LETTERBOX)


def test_dense_heads_give_every_class_of_a_place_and_suppress_within_a_class(tmp_path: Path) -> None:
    packed = packed_yolov8()
    packed[0, 4:, 0] = 0.9, 0.7  # the car's place is sure of a person as well
    packed[0, :, 5] = packed[0, :, 0]
    packed[0, 4:, 5] = 0.6, 0.0
    packed[0, 0, 5] += 1.0  # a copy, moved by a pixel
    declared = declaration(tmp_path, "yolov8", {"packed": "o"})
    found = decode_boxes({"packed": [packed]}, declared, LETTERBOX)
    assert sorted(zip(found["labels"], found["scores"].round(3), strict=True)) == [
        ("car", 0.9),
        ("person", 0.7),
        ("person", 0.8),
    ]
    apart = declaration(tmp_path, "yolov8", {"packed": "o"}, nms_iou=None)
    assert len(decode_boxes({"packed": [packed]}, apart, LETTERBOX)["labels"]) == 4


def test_boxes_are_cut_at_the_frame_and_those_in_the_border_left_out(tmp_path: Path) -> None:
    boxes = np.array([[-8.0, 10.0, 16.0, 32.0], [5.0, 2.0, 20.0, 14.0]], np.float32)
    declared = declaration(tmp_path, "boxes", {"boxes": "b", "scores": "s", "labels": "l"})
    outputs = {"boxes": [boxes], "scores": [np.array([0.9, 0.9])], "labels": [np.array([0, 0])]}
    found = decode_boxes(outputs, declared, LETTERBOX)
    assert found["boxes"] == pytest.approx(np.array([[0.0, 0.0, 50.0, 50.0]]))
