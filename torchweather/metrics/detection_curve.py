"""Precision against recall of matched detections, over all images or over images drawn anew."""

from __future__ import annotations

import math
from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from torchweather.core.errors import check_one_of

__all__ = ["INTERPOLATIONS", "MatchedBoxes"]

Floats = NDArray[np.float64]
Area = Callable[[Floats, Floats], Floats]

# Recalls at which COCO reads the precision, as pycocotools rounds them.
COCO_RECALLS = np.linspace(0.0, 1.0, 101)
# Simonelli et al. 2019, "Disentangling monocular 3D object detection": KITTI's 40 recalls, without 0.
KITTI_RECALLS = np.arange(1, 41) / 40


@dataclass(frozen=True, eq=False)
class MatchedBoxes:
    """Detections of one class that count, the surest first, and the truths of every image.

    Args:
        label: the class.
        threshold: overlap from which on a detection is a hit.
        range_m: distances from the first (included) to the second (not).
        scores: ``(D,)``, falling.
        hits: ``(D,)`` bool; the others are false alarms.
        images: ``(D,)`` place of the image.
        truths: ``(I,)`` number of truths that count in every image.
    """

    label: Hashable
    threshold: float
    range_m: tuple[float, float]
    scores: Floats
    hits: NDArray[np.bool_]
    images: NDArray[np.int64]
    truths: Floats

    @classmethod
    def of_images(
        cls,
        matched: Sequence[Mapping[str, Any]],
        step: int,
        images: int,
        label: Hashable,
        threshold: float,
        range_m: tuple[float, float],
    ) -> MatchedBoxes:
        """From COCO's records of the images, at the threshold of number ``step``."""
        truths = np.zeros(images)
        scores, hits, counts, places = [np.zeros(0)], [np.zeros(0, bool)], [np.zeros(0, bool)], [np.zeros(0, np.int64)]
        for image in matched:
            place = int(image["image_id"]) - 1
            truths[place] = np.count_nonzero(np.asarray(image["gtIgnore"]) == 0)
            scores.append(np.asarray(image["dtScores"], dtype=np.float64))
            hits.append(image["dtMatches"][step] > 0)
            counts.append(~image["dtIgnore"][step].astype(bool))
            places.append(np.full(len(image["dtScores"]), place))
        score, hit, count, where = (np.concatenate(each) for each in (scores, hits, counts, places))
        order = np.argsort(-score, kind="stable")
        order = order[count[order]]
        return cls(label, threshold, range_m, score[order], hit[order], where[order], truths)

    @property
    def recall(self) -> float:
        """Share of the truths that any detection hits; NaN where there are none."""
        truths = float(self.truths.sum())
        return float(self.hits.sum()) / truths if truths else math.nan

    def average_precision(self, interpolation: str = "coco") -> float:
        """Area under precision against recall; NaN where the class has no truth that counts."""
        return float(self.resampled(np.ones((1, len(self.truths))), interpolation)[0])

    def resampled(self, weights: Floats, interpolation: str = "coco") -> Floats:
        """Average precision of images drawn anew.

        Args:
            weights: ``(B, I)``: how often each image was drawn.
            interpolation: ``coco``, ``pascal`` or ``kitti``.

        Returns:
            ``(B,)``; NaN where no truth was drawn. Images that were drawn twice count as two images.

        Example:
            >>> found = MatchedBoxes("car", 0.5, (0.0, math.inf), np.array([0.9, 0.8]), np.array([True, False]),
            ...     np.array([0, 1]), np.array([1.0, 1.0]))
            >>> found.resampled(np.array([[1.0, 1.0], [2.0, 0.0], [0.0, 2.0]]), "pascal")
            array([0.5, 1. , 0. ])
        """
        check_one_of("interpolation", interpolation, INTERPOLATIONS, owner=self)
        return np.array([self._area(row, INTERPOLATIONS[interpolation]) for row in weights])

    def _area(self, weights: Floats, area: Area) -> float:
        truths = float(weights @ self.truths)
        if not truths:
            return math.nan
        each = weights[self.images]
        drawn = each > 0
        hit = np.cumsum((each * self.hits)[drawn])
        recall, precision = hit / truths, hit / np.cumsum(each[drawn])
        # The best precision at this recall or a higher one.
        falling = np.maximum.accumulate(precision[::-1])[::-1]
        return float(area(recall, falling))


def _mean_at(recalls: Floats) -> Area:
    def mean(recall: Floats, precision: Floats) -> Floats:
        first = np.searchsorted(recall, recalls, side="left")
        return np.asarray(np.append(precision, 0.0)[first].mean())

    return mean


def _whole_area(recall: Floats, precision: Floats) -> Floats:
    return np.asarray(np.sum(np.diff(recall, prepend=0.0) * precision))


INTERPOLATIONS: dict[str, Area] = {
    "coco": _mean_at(COCO_RECALLS),
    "pascal": _whole_area,
    "kitti": _mean_at(KITTI_RECALLS),
}
