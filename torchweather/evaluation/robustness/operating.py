"""The operating point: the least score of the boxes that a user of the detector would act on."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from torchweather.metrics.detection_curve import MatchedBoxes

__all__ = ["DECLARED", "MAX_F1", "OperatingPoint", "operating_point"]

DECLARED = "declared"
MAX_F1 = "maximum F1 on the clear frames"


@dataclass(frozen=True)
class OperatingPoint:
    """A least score and what it gives in clear air.

    Args:
        threshold: least score of a box.
        origin: ``DECLARED`` or ``MAX_F1``.
        precision, recall: in clear air, over all classes that have a truth; NaN where there is nothing to divide by.
    """

    threshold: float
    origin: str
    precision: float
    recall: float


def operating_point(clear: Sequence[MatchedBoxes], declared: float | None = None) -> OperatingPoint:
    """The declared least score, or that with the highest F1 in clear air.

    ``F1 = 2 hits / (detections + truths)``, over all classes that have a truth. Of equal ones the highest score.

    Args:
        clear: matched boxes of all classes, at one overlap.
        declared: least score of the declaration.

    Example:
        >>> car = MatchedBoxes("car", 0.5, (0.0, math.inf), np.array([0.9, 0.6, 0.2]), np.array([True, True, False]),
        ...     np.array([0, 0, 0]), np.array([2.0]))
        >>> found = operating_point([car])
        >>> found.threshold, found.precision, found.recall
        (0.6, 1.0, 1.0)
    """
    judged = [each for each in clear if each.truths.sum() > 0]
    truths = sum(float(each.truths.sum()) for each in judged)
    scores = np.concatenate([each.scores for each in judged] or [np.zeros(0)])
    hits = np.concatenate([each.hits for each in judged] or [np.zeros(0, bool)])
    origin = DECLARED
    threshold = declared
    if threshold is None:
        origin = MAX_F1
        order = np.argsort(-scores, kind="stable")
        f1 = 2 * np.cumsum(hits[order]) / (np.arange(1, len(scores) + 1) + truths)
        # A threshold takes all boxes of its score: only the last of equal scores is a choice.
        last = np.append(np.diff(scores[order]) != 0, True)[: len(scores)]
        threshold = float(scores[order][np.argmax(np.where(last, f1, -1.0))]) if len(scores) else 0.0
    taken = scores >= threshold
    count, right = float(taken.sum()), float(hits[taken].sum())
    return OperatingPoint(
        float(threshold), origin, right / count if count else math.nan, right / truths if truths else math.nan
    )
