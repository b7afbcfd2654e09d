"""Boxes, scores and classes as detectors give them, as boxes in pixels of the input with one class each."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from torchweather.core.errors import TorchweatherError
from torchweather.evaluation.robustness.declaration import Declaration

__all__ = ["READERS", "unbatched"]

Array = NDArray[Any]
Outputs = Mapping[str, list[Array]]
Found = tuple[Array, Array, Array]
"""Boxes ``(N, 4)`` in the declared form, scores ``(N,)``, numbers of classes ``(N,)``."""


def unbatched(name: str, array: Array, dimensions: int) -> Array:
    """An output without its batch of 1."""
    found = array[0] if array.ndim == dimensions + 1 and len(array) == 1 else array
    if found.ndim != dimensions:
        raise TorchweatherError(
            f"decoder: output {name} must have {dimensions} dimensions, or a batch of 1 before them; got shape "
            f"{array.shape}."
        )
    return found


def read_boxes(outputs: Outputs, declaration: Declaration, taken: tuple[int, int]) -> Found:
    """Boxes and scores apart, with labels, or with scores of every class, of which the best counts."""
    boxes = unbatched("boxes", outputs["boxes"][0], 2)
    scores = unbatched("scores", outputs["scores"][0], 1 if "labels" in outputs else 2)
    if boxes.shape[-1:] != (4,) or len(scores) != len(boxes):
        raise TorchweatherError(
            f"decoder boxes: expected boxes (N, 4) and scores of as many; got {boxes.shape} and {scores.shape}."
        )
    if "labels" not in outputs:
        return boxes, scores.max(-1), scores.argmax(-1)
    labels = unbatched("labels", outputs["labels"][0], 1)
    if len(labels) != len(boxes):
        raise TorchweatherError(f"decoder boxes: expected a label a box, {len(boxes)}; got {len(labels)}.")
    return boxes, scores, labels


def read_yolov8(outputs: Outputs, declaration: Declaration, taken: tuple[int, int]) -> Found:
    """``(4 + K, N)``: every class of a place that is sure enough is a detection."""
    packed = unbatched("packed", outputs["packed"][0], 2).T
    _check_width("yolov8 (4 + K, N)", packed, 5)
    return _by_class(packed[:, :4], _active(packed[:, 4:], declaration), declaration)


def read_yolov5(outputs: Outputs, declaration: Declaration, taken: tuple[int, int]) -> Found:
    """``(N, 5 + K)``: a score is objectness times that of the class."""
    packed = unbatched("packed", outputs["packed"][0], 2)
    _check_width("yolov5 (N, 5 + K)", packed, 6)
    active = _active(packed[:, 4:], declaration)
    return _by_class(packed[:, :4], active[:, :1] * active[:, 1:], declaration)


def read_end_to_end(outputs: Outputs, declaration: Declaration, taken: tuple[int, int]) -> Found:
    """``(N, 6)``: box, score, label."""
    packed = unbatched("packed", outputs["packed"][0], 2)
    if packed.shape[-1] != 6:
        raise TorchweatherError(f"decoder end-to-end: expected packed (N, 6); got {packed.shape}.")
    return packed[:, :4], packed[:, 4], packed[:, 5]


def read_mmdeploy(outputs: Outputs, declaration: Declaration, taken: tuple[int, int]) -> Found:
    """``(N, 5)``: box and score, with labels ``(N,)``."""
    boxes, labels = unbatched("boxes", outputs["boxes"][0], 2), unbatched("labels", outputs["labels"][0], 1)
    if boxes.shape[-1] != 5 or len(labels) != len(boxes):
        raise TorchweatherError(
            f"decoder mmdeploy: expected boxes (N, 5) and labels of as many; got {boxes.shape} and {labels.shape}."
        )
    return boxes[:, :4], boxes[:, 4], labels


def read_detr(outputs: Outputs, declaration: Declaration, taken: tuple[int, int]) -> Found:
    """A set of queries: softmax with "no object" as the last class, or sigmoid of every class on its own."""
    logits, boxes = unbatched("logits", outputs["logits"][0], 2), unbatched("boxes", outputs["boxes"][0], 2)
    if boxes.shape[-1] != 4 or len(logits) != len(boxes):
        raise TorchweatherError(
            f"decoder detr: expected boxes (N, 4) and logits of as many; got {boxes.shape} and {logits.shape}."
        )
    scores = _active(logits, declaration)
    if declaration.options["activation"] != "softmax":
        return _by_class(boxes, scores, declaration)
    return boxes, scores[:, :-1].max(-1), scores[:, :-1].argmax(-1)


def read_nanodet(outputs: Outputs, declaration: Declaration, taken: tuple[int, int]) -> Found:
    """Levels of a grid, each side's distance as a distribution over whole strides (distribution focal loss).

    The distance is the mean of the distribution, times the stride: Li et al. 2020, "Generalized focal loss".
    """
    options = declaration.options
    boxes, scores = [], []
    for stride, level_scores, level_boxes in zip(options["strides"], outputs["scores"], outputs["boxes"], strict=True):
        level = unbatched("scores", level_scores, 2)
        sides = unbatched("boxes", level_boxes, 2)
        rows, columns = (-(-side // stride) for side in taken)
        if len(level) != rows * columns or len(sides) != rows * columns or sides.shape[-1] % 4:
            raise TorchweatherError(
                f"decoder nanodet: expected {rows} x {columns} places of stride {stride} of an input of {taken[0]} x "
                f"{taken[1]} px, with 4 numbers a bin; got scores {level.shape} and boxes {sides.shape}."
            )
        shares = _softmax(sides.reshape(len(sides), 4, -1).astype(np.float64))
        distance = (shares * np.arange(shares.shape[-1])).sum(-1) * stride
        y, x = np.mgrid[:rows, :columns].reshape(2, -1) * stride + options["centre"] * stride
        left, top, right, bottom = distance.T
        boxes.append(np.stack([x - left, y - top, x + right, y + bottom], 1))
        scores.append(level)
    return _by_class(np.concatenate(boxes), _active(np.concatenate(scores), declaration), declaration)


def _by_class(boxes: Array, scores: Array, declaration: Declaration) -> Found:
    """Every class of a place as a detection of its own, if it is declared and sure enough."""
    numbers = np.array([number for number in declaration.classes if number < scores.shape[1]], dtype=np.int64)
    chosen = scores[:, numbers]
    rows, columns = np.nonzero(chosen >= declaration.options["threshold"])
    return boxes[rows], chosen[rows, columns], numbers[columns]


def _active(values: Array, declaration: Declaration) -> Array:
    """Scores in [0, 1] of what the model gives."""
    activation = declaration.options["activation"]
    values = values.astype(np.float64)
    if activation == "sigmoid":
        return np.asarray(1 / (1 + np.exp(-values.clip(-500, 500))))
    return _softmax(values) if activation == "softmax" else values


def _softmax(values: Array) -> Array:
    shifted = np.exp(values - values.max(-1, keepdims=True))
    found: Array = shifted / shifted.sum(-1, keepdims=True)
    return found


def _check_width(name: str, packed: Array, least: int) -> None:
    if packed.shape[-1] < least:
        raise TorchweatherError(
            f"decoder {name}: expected {least} numbers a place or more; got {packed.shape[-1]} of {packed.shape[0]}."
        )


READERS: dict[str, Callable[[Outputs, Declaration, tuple[int, int]], Found]] = {
    "boxes": read_boxes,
    "yolov8": read_yolov8,
    "yolov5": read_yolov5,
    "end-to-end": read_end_to_end,
    "mmdeploy": read_mmdeploy,
    "detr": read_detr,
    "nanodet": read_nanodet,
}
"""By the decoder."""
