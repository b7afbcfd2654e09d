"""A detector's performance over many frames: average precision of boxes, intersection over union of labels."""

from __future__ import annotations

import importlib.util
import math
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from torchweather.core.errors import TorchweatherError
from torchweather.core.extras import install_hint
from torchweather.evaluation.robustness.truth import BoxTruth, LabelTruth
from torchweather.metrics.detection import matched_boxes
from torchweather.metrics.detection_curve import MatchedBoxes

__all__ = ["COUNTERS", "NAMES", "BoxCounter", "Counter", "LabelCounter", "Performance"]

NAMES = {"boxes": "AP", "segmentation": "mIoU"}
"""Of the performance, by the task of the decoder."""

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Performance:
    """Of one condition.

    Args:
        value: in [0, 1]; NaN where no class has a truth.
        by_class: likewise.
    """

    value: float
    by_class: Mapping[str, float]


class Counter(ABC):
    """Takes frame after frame and gives the performance over all.

    Args:
        classes: of the detector, number to name.
        thresholds: overlaps of boxes.
    """

    def __init__(self, classes: Mapping[int, str], thresholds: Sequence[float]) -> None:
        self.classes, self.thresholds = classes, tuple(thresholds)

    @abstractmethod
    def add(self, found: Any, truth: Any, weather: NDArray[np.bool_] | None = None) -> None:
        """One frame; ``weather`` says of each point of a cloud whether it is a particle."""

    @abstractmethod
    def performance(self, clear: Performance | None = None) -> Performance:
        """Over all frames so far; ``clear`` is that of the same frames in clear air."""

    @abstractmethod
    def resampled_classes(self, weights: Floats) -> dict[str, Floats]:
        """Performance of every class ``(B,)`` over frames drawn anew, ``weights`` ``(B, frames)`` times each."""

    def resampled(self, weights: Floats, clear: Counter | None = None) -> dict[str, Floats]:
        """Performance of every class that has a truth ``(B,)`` over frames drawn anew, and under "" their mean.

        The mean is NaN where a class has no truth in the frames that were drawn: over other classes it would be
        another quantity.

        Args:
            weights: ``(B, frames)``: how often each frame was drawn.
            clear: counts of the same frames in clear air.
        """
        found = self.resampled_classes(weights)
        if clear is not None:
            for name, values in clear.resampled_classes(weights).items():
                mine = found.get(name, np.full(len(weights), math.nan))
                found[name] = np.where(np.isnan(mine) & ~np.isnan(values), 0.0, mine)
        judged = self.judged if clear is None else clear.judged
        found = {name: values for name, values in found.items() if name in judged}
        mean = np.mean([*found.values()], axis=0) if found else np.full(len(weights), math.nan)
        return {**found, "": np.asarray(mean)}

    @property
    @abstractmethod
    def judged(self) -> dict[str, int]:
        """Classes that have a truth, and how many boxes, pixels or points of it."""


class BoxCounter(Counter):
    """Average precision: mean over thresholds for each class, then over the classes that have a truth."""

    def __init__(self, classes: Mapping[int, str], thresholds: Sequence[float]) -> None:
        super().__init__(classes, thresholds)
        if importlib.util.find_spec("pycocotools") is None:  # said now, and not when all frames are done
            raise TorchweatherError(f"average precision needs pycocotools. {install_hint('detection')}")
        self.found: list[dict[str, Any]] = []
        self.truths: list[dict[str, Any]] = []
        self._matched: list[MatchedBoxes] | None = None

    def add(self, found: Any, truth: BoxTruth, weather: NDArray[np.bool_] | None = None) -> None:
        """Boxes found in a frame and those that are there."""
        self.found.append(found)
        self.truths.append({"boxes": truth.boxes, "labels": list(truth.labels), "ignore": truth.ignore})
        self._matched = None

    @property
    def judged(self) -> dict[str, int]:
        """Classes that have a truth, and how many boxes."""
        counts = {str(each.label): int(each.truths.sum()) for each in self.matched}
        return {name: count for name, count in counts.items() if count}

    @property
    def matched(self) -> list[MatchedBoxes]:
        """Hits and false alarms of every class and threshold."""
        if self._matched is None:
            self._matched = matched_boxes(self.found, self.truths, thresholds=self.thresholds)
        return self._matched

    def performance(self, clear: Performance | None = None) -> Performance:
        """Average precision."""
        every = np.ones((1, len(self.found)))
        by_class = {name: float(values[0]) for name, values in self.resampled_classes(every).items()}
        return Performance(_mean([*by_class.values()]), by_class)

    def resampled_classes(self, weights: Floats) -> dict[str, Floats]:
        """Average precision of every class, mean over the thresholds."""
        every: dict[str, list[Floats]] = {}
        for each in self.matched:
            every.setdefault(str(each.label), []).append(each.resampled(weights))
        return {name: np.asarray(np.mean(values, axis=0)) for name, values in every.items()}


class LabelCounter(Counter):
    """Intersection over union of each class over all frames, and its mean over the classes that have a truth.

    Points that the weather brought belong to no class: a class predicted there is a false alarm. Points that it took
    are gone, neither right nor missed; a class of which it took all has 0. Pixels and points whose truth is no class of
    the detector are not judged.
    """

    def __init__(self, classes: Mapping[int, str], thresholds: Sequence[float]) -> None:
        super().__init__(classes, thresholds)
        # Of every frame: pixels or points of each class that are right, true and said.
        self.counts: list[NDArray[np.int64]] = []

    def add(self, found: Any, truth: LabelTruth, weather: NDArray[np.bool_] | None = None) -> None:
        """Classes predicted in a frame and those that are there."""
        false = np.zeros(truth.classes.shape, bool) if weather is None else weather
        judged = np.isin(truth.classes, [*self.classes]) | false
        counts = []
        for number in self.classes:
            here, said = (truth.classes == number) & ~false, (found == number) & judged
            counts.append((int((here & said).sum()), int(here.sum()), int(said.sum())))
        self.counts.append(np.array(counts, dtype=np.int64))

    def performance(self, clear: Performance | None = None) -> Performance:
        """Mean intersection over union."""
        by_class = {
            name: float(values[0]) for name, values in self.resampled_classes(np.ones((1, len(self.counts)))).items()
        }
        for name, value in by_class.items():
            # Else the mean would rise where the weather takes the last points of a hard class.
            if math.isnan(value) and clear is not None and not math.isnan(clear.by_class[name]):
                by_class[name] = 0.0
        return Performance(_mean([*by_class.values()]), by_class)

    def resampled_classes(self, weights: Floats) -> dict[str, Floats]:
        """Intersection over union of every class; NaN where no frame that was drawn has it."""
        hits, true, said = np.tensordot(weights, np.stack(self.counts), 1).transpose(2, 1, 0)  # (classes, B) each
        union = np.where(true > 0, true + said - hits, np.nan)
        return dict(zip(self.classes.values(), np.asarray(hits / union), strict=True))

    @property
    def judged(self) -> dict[str, int]:
        """Classes that have a truth, and how many pixels or points."""
        true = np.stack(self.counts).sum(0)[:, 1]
        return {name: int(count) for name, count in zip(self.classes.values(), true, strict=True) if count}


def _mean(values: Sequence[float]) -> float:
    there = [value for value in values if not math.isnan(value)]
    return float(np.mean(there)) if there else math.nan


COUNTERS: dict[str, type[Counter]] = {"boxes": BoxCounter, "segmentation": LabelCounter}
"""By the task of the decoder."""
