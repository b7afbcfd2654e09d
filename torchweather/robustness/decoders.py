"""A detector's outputs as boxes with scores and classes, or as the class of every pixel or point."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import torch
import torch.nn.functional as F
from numpy.typing import NDArray

from torchweather.errors import TorchweatherError
from torchweather.metrics import box_iou
from torchweather.robustness.declaration import Declaration

__all__ = ["DECODERS", "decode_boxes", "decode_segmentation"]

Array = NDArray[Any]


def decode_boxes(
    outputs: Mapping[str, Array], declaration: Declaration, taken: tuple[int, int], frame: tuple[int, int]
) -> dict[str, Any]:
    """Boxes ``(N, 4)`` left, top, right, bottom in pixels of the frame, scores ``(N,)``, labels: names of classes.

    Args:
        outputs: ``boxes``, ``scores`` and perhaps ``labels``.
        declaration: how to read them.
        taken: height and width of what the model got.
        frame: height and width of the frame.
    """
    boxes = _unbatched("boxes", outputs["boxes"], 2)
    scores = _unbatched("scores", outputs["scores"], 2 if "labels" not in outputs else 1)
    if boxes.shape[-1:] != (4,) or len(scores) != len(boxes):
        raise TorchweatherError(
            f"decoder boxes: wanted boxes (N, 4) and scores of as many; got {boxes.shape} and {scores.shape}."
        )
    if "labels" in outputs:
        labels = _unbatched("labels", outputs["labels"], 1).astype(np.int64)
    else:
        labels, scores = scores.argmax(-1), scores.max(-1)
    if len(labels) != len(boxes):
        raise TorchweatherError(f"decoder boxes: wanted a label a box, {len(boxes)}; got {len(labels)}.")
    boxes, scores = boxes.astype(np.float64), scores.astype(np.float64)
    options = declaration.options
    known = np.isin(labels, [*declaration.classes])
    kept = known & (scores >= options["threshold"]) & np.isfinite(boxes).all(-1) & np.isfinite(scores)
    boxes, scores, labels = boxes[kept], scores[kept], labels[kept]
    if options["form"] == "cxcywh":
        half = boxes[:, 2:] / 2
        boxes = np.concatenate([boxes[:, :2] - half, boxes[:, :2] + half], 1)
    height, width = (1.0, 1.0) if options["normalised"] else taken
    boxes = boxes * (np.array([frame[1], frame[0]] * 2) / np.array([width, height] * 2))
    if options["nms_iou"] is not None:
        alone = _strongest(boxes, scores, labels, float(options["nms_iou"]))
        boxes, scores, labels = boxes[alone], scores[alone], labels[alone]
    return {"boxes": boxes, "scores": scores, "labels": [declaration.classes[int(k)] for k in labels]}


def _strongest(boxes: Array, scores: Array, labels: Array, overlap: float) -> Array:
    """Places of the boxes that no surer one of their class overlaps by more."""
    order = np.argsort(-scores, kind="stable")
    iou = box_iou(torch.as_tensor(boxes), torch.as_tensor(boxes)).numpy() if len(boxes) else np.zeros((0, 0))
    kept: list[int] = []
    for place in order:
        if all(labels[other] != labels[place] or iou[other, place] <= overlap for other in kept):
            kept.append(int(place))
    return np.array(kept, dtype=np.int64)


def decode_segmentation(
    outputs: Mapping[str, Array], declaration: Declaration, taken: tuple[int, int], frame: tuple[int, int]
) -> Array:
    """Number of the class of every pixel ``(H, W)`` of the frame, or of every point ``(N,)``."""
    if declaration.sensor == "lidar":
        return np.asarray(_unbatched("logits", outputs["logits"], 2).argmax(-1))
    logits = _unbatched("logits", outputs["logits"], 3)
    if logits.shape[1:] != frame:
        logits = F.interpolate(torch.as_tensor(logits, dtype=torch.float32)[None], size=frame, mode="bilinear")[
            0
        ].numpy()
    return np.asarray(logits.argmax(0))


def _unbatched(name: str, array: Array, dimensions: int) -> Array:
    found = array[0] if array.ndim == dimensions + 1 and len(array) == 1 else array
    if found.ndim != dimensions:
        raise TorchweatherError(
            f"decoder: output {name} must have {dimensions} dimensions, or a batch of 1 before them; got shape "
            f"{array.shape}."
        )
    return found


DECODERS: dict[str, Callable[[Mapping[str, Array], Declaration, tuple[int, int], tuple[int, int]], Any]] = {
    "boxes": decode_boxes,
    "segmentation": decode_segmentation,
}
"""By the name that a declaration gives."""
