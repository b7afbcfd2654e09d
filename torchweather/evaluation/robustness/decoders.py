"""A detector's outputs as boxes with scores and classes, or as the class of every pixel or point."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from torchweather.evaluation.robustness.box_forms import READERS, unbatched
from torchweather.evaluation.robustness.declaration import Declaration
from torchweather.evaluation.robustness.placement import Placement
from torchweather.evaluation.robustness.suppression import strongest

__all__ = ["TASKS", "decode_boxes", "decode_segmentation"]

Array = NDArray[Any]
Outputs = Mapping[str, list[Array]]


def decode_boxes(outputs: Outputs, declaration: Declaration, place: Placement | None) -> dict[str, Any]:
    """Boxes ``(N, 4)`` left, top, right, bottom in pixels of the frame, scores ``(N,)``, labels: names of classes.

    Boxes are cut at the edge of the frame; those that lie in the border of the input are left out.

    Args:
        outputs: arrays by role, one a level.
        declaration: how to read them.
        place: where the frame lies in the input.
    """
    assert place is not None
    options = declaration.options
    boxes, scores, labels = READERS[declaration.decoder](outputs, declaration, place.taken)
    boxes, scores, labels = boxes.astype(np.float64), scores.astype(np.float64), labels.astype(np.int64)
    kept = np.isin(labels, [*declaration.classes]) & (scores >= options["threshold"])
    kept &= np.isfinite(boxes).all(-1) & np.isfinite(scores)
    boxes, scores, labels = _corners(boxes[kept], options.get("form", "xyxy")), scores[kept], labels[kept]
    if options.get("normalised"):
        boxes = boxes * np.array([place.taken[1], place.taken[0]] * 2)
    if options["nms_iou"] is not None:
        alone = strongest(boxes, scores, labels, float(options["nms_iou"]))
        boxes, scores, labels = boxes[alone], scores[alone], labels[alone]
    boxes = place.to_frame(boxes)
    inside = (boxes[:, 2:] > boxes[:, :2]).all(-1)
    return {
        "boxes": boxes[inside],
        "scores": scores[inside],
        "labels": [declaration.classes[int(k)] for k in labels[inside]],
    }


def _corners(boxes: Array, form: str) -> Array:
    """Left, top, right, bottom."""
    if form == "yxyx":
        return boxes[:, [1, 0, 3, 2]]
    if form == "xyxy":
        return boxes
    low = boxes[:, :2] - (boxes[:, 2:] / 2 if form == "cxcywh" else 0.0)
    return np.concatenate([low, low + boxes[:, 2:]], 1)


def decode_segmentation(outputs: Outputs, declaration: Declaration, place: Placement | None) -> Array:
    """Number of the class of every pixel ``(H, W)`` of the frame, or of every point ``(N,)``."""
    [logits] = outputs["logits"]
    if place is None:
        return np.asarray(unbatched("logits", logits, 2).argmax(-1))
    maps = torch.as_tensor(unbatched("logits", logits, 3), dtype=torch.float32)
    return np.asarray(place.map_to_frame(maps).argmax(0).numpy())


TASKS: dict[str, Callable[[Outputs, Declaration, Placement | None], Any]] = {
    "boxes": decode_boxes,
    "segmentation": decode_segmentation,
}
"""By the task of the decoder."""
