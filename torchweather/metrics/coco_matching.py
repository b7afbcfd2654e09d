"""Detections matched to truths by pycocotools, whatever the boxes and their overlap."""

from __future__ import annotations

import contextlib
import io
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pycocotools.coco import COCO
from pycocotools.cocoeval import COCOeval

__all__ = ["match"]

Floats = NDArray[np.float64]


class _Evaluation(COCOeval):  # type: ignore[misc]
    """COCO's evaluation with overlaps that are known already."""

    def __init__(self, truths: COCO, detections: COCO, overlaps: Mapping[tuple[int, int], Floats]) -> None:
        super().__init__(truths, detections, "bbox")
        self.overlaps = overlaps

    def computeIoU(self, imgId: int, catId: int) -> Floats | list[Any]:
        """Overlap of the detections, the surest first, with the truths."""
        return self.overlaps.get((int(imgId), int(catId)), [])


def match(
    truths: Sequence[Mapping[str, Any]],
    detections: Sequence[Mapping[str, Any]],
    overlaps: Mapping[tuple[int, int], Floats],
    *,
    images: int,
    classes: int,
    thresholds: Sequence[float],
    ranges: Sequence[tuple[float, float]],
) -> list[list[list[Mapping[str, Any]]]]:
    """Hits among detections, per class, range and image.

    Args:
        truths: ``image_id`` and ``category_id`` from 1, ``area`` (what ``ranges`` bound), ``iscrowd`` (any number of
            detections on it are neither hits nor false alarms).
        detections: ``image_id``, ``category_id``, ``area``, ``score``, the surest first within an image.
        overlaps: of image and class, ``(detections, truths)`` in their order above.
        images, classes: numbers of them.
        thresholds: overlaps from which on a detection is a hit.
        ranges: low and high bound, both included.

    Returns:
        Class, then range: what ``COCOeval.evaluateImg`` gives of each image that has a truth or a detection.
    """
    evaluation = _Evaluation(_coco(truths, images, classes), _coco(detections, images, classes), overlaps)
    evaluation.params.iouThrs = np.asarray(thresholds, dtype=np.float64)
    evaluation.params.areaRng = [list(each) for each in ranges]
    evaluation.params.maxDets = [max(len(detections), 1)]
    with contextlib.redirect_stdout(io.StringIO()):
        evaluation.evaluate()
    found = iter(evaluation.evalImgs)
    return [
        [[each for each in (next(found) for _ in range(images)) if each is not None] for _ in ranges]
        for _ in range(classes)
    ]


def _coco(boxes: Sequence[Mapping[str, Any]], images: int, classes: int) -> COCO:
    coco = COCO()
    coco.dataset = {
        "images": [{"id": number} for number in range(1, images + 1)],
        "categories": [{"id": number} for number in range(1, classes + 1)],
        # From 1: pycocotools takes a match with number 0 for none.
        "annotations": [{"id": number, **box} for number, box in enumerate(boxes, 1)],
    }
    with contextlib.redirect_stdout(io.StringIO()):
        coco.createIndex()
    return coco
