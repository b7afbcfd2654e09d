"""How well a detector does over many frames: average precision of boxes, intersection over union of labels."""

from __future__ import annotations

import importlib.util
import math
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from torchweather.errors import TorchweatherError
from torchweather.metrics import average_precision
from torchweather.robustness.truth import BoxTruth, LabelTruth

__all__ = ["COUNTERS", "NAMES", "BoxCounter", "Counter", "LabelCounter", "Performance"]

NAMES = {"boxes": "AP", "segmentation": "mIoU"}
"""Of the performance, by the decoder."""


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


class BoxCounter(Counter):
    """Average precision: mean over thresholds for each class, then over the classes that have a truth."""

    def __init__(self, classes: Mapping[int, str], thresholds: Sequence[float]) -> None:
        super().__init__(classes, thresholds)
        if importlib.util.find_spec("pycocotools") is None:  # said now, and not when all frames are done
            raise TorchweatherError("average precision needs pycocotools: install torchweather[detection].")
        self.found: list[dict[str, Any]] = []
        self.truths: list[dict[str, Any]] = []

    def add(self, found: Any, truth: BoxTruth, weather: NDArray[np.bool_] | None = None) -> None:
        """Boxes found in a frame and those that are there."""
        self.found.append(found)
        self.truths.append({"boxes": truth.boxes, "labels": list(truth.labels), "ignore": truth.ignore})

    def performance(self, clear: Performance | None = None) -> Performance:
        """Average precision."""
        every: dict[str, list[float]] = {}
        for each in average_precision(self.found, self.truths, thresholds=self.thresholds):
            every.setdefault(str(each.label), []).append(each.value)
        by_class = {name: float(np.mean(values)) for name, values in every.items()}
        return Performance(_mean([*by_class.values()]), by_class)


class LabelCounter(Counter):
    """Intersection over union of each class over all frames, and its mean over the classes that have a truth.

    Points that the weather brought belong to no class: a class predicted there is a false alarm. Points that it took
    are gone, neither right nor missed; a class of which it took all has 0. Pixels and points whose truth is no class of
    the detector are not judged.
    """

    def __init__(self, classes: Mapping[int, str], thresholds: Sequence[float]) -> None:
        super().__init__(classes, thresholds)
        self.hits = dict.fromkeys(classes, 0)
        self.true = dict.fromkeys(classes, 0)
        self.said = dict.fromkeys(classes, 0)

    def add(self, found: Any, truth: LabelTruth, weather: NDArray[np.bool_] | None = None) -> None:
        """Classes predicted in a frame and those that are there."""
        false = np.zeros(truth.classes.shape, bool) if weather is None else weather
        judged = np.isin(truth.classes, [*self.classes]) | false
        for number in self.classes:
            here, said = (truth.classes == number) & ~false, (found == number) & judged
            self.hits[number] += int((here & said).sum())
            self.true[number] += int(here.sum())
            self.said[number] += int(said.sum())

    def performance(self, clear: Performance | None = None) -> Performance:
        """Mean intersection over union."""
        by_class = {}
        for number, name in self.classes.items():
            union = self.true[number] + self.said[number] - self.hits[number]
            # Else the mean would rise where the weather takes the last points of a hard class.
            all_lost = clear is not None and not math.isnan(clear.by_class[name])
            by_class[name] = self.hits[number] / union if self.true[number] else 0.0 if all_lost else math.nan
        return Performance(_mean([*by_class.values()]), by_class)


def _mean(values: Sequence[float]) -> float:
    there = [value for value in values if not math.isnan(value)]
    return float(np.mean(there)) if there else math.nan


COUNTERS: dict[str, type[Counter]] = {"boxes": BoxCounter, "segmentation": LabelCounter}
"""By the decoder."""
