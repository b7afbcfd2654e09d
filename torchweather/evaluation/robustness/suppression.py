"""Non-maximum suppression: of boxes of one class that overlap, the surest stays."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["strongest"]

Array = NDArray[Any]


def strongest(boxes: Array, scores: Array, labels: Array, overlap: float) -> Array:
    """Places of the boxes that no surer one of their class overlaps by more, the surest first.

    Args:
        boxes: ``(N, 4)`` left, top, right, bottom.
        scores: ``(N,)``.
        labels: ``(N,)`` numbers of classes.
        overlap: intersection over union, in [0, 1].

    Example:
        >>> boxes = np.array([[0.0, 0, 10, 10], [0, 0, 10, 9], [20, 0, 30, 10]])
        >>> strongest(boxes, np.array([0.8, 0.9, 0.1]), np.array([0, 0, 0]), 0.5).tolist()
        [1, 2]
    """
    kept: list[Array] = []
    for label in np.unique(labels):
        places = np.flatnonzero(labels == label)
        places = places[np.argsort(-scores[places], kind="stable")]
        while len(places):
            kept.append(places[:1])
            rest = places[1:]
            places = rest[_iou(boxes[places[0]], boxes[rest]) <= overlap]
    found = np.concatenate(kept) if kept else np.zeros(0, dtype=np.int64)
    ordered: Array = found[np.argsort(-scores[found], kind="stable")]
    return ordered


def _iou(one: Array, others: Array) -> Array:
    """Intersection over union of one box with others; 0 where nothing has an area. No error for boxes inside out."""
    low, high = np.maximum(one[:2], others[:, :2]), np.minimum(one[2:], others[:, 2:])
    shared = (high - low).clip(0).prod(-1)
    union = (one[2:] - one[:2]).clip(0).prod() + (others[:, 2:] - others[:, :2]).clip(0).prod(-1) - shared
    found: Array = np.divide(shared, union, out=np.zeros_like(shared), where=union > 0)
    return found
