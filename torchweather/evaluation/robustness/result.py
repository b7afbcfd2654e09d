"""Result of a robustness run."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from torchweather.evaluation.robustness.intervals import Interval
from torchweather.evaluation.robustness.operating import OperatingPoint
from torchweather.evaluation.robustness.performance import Performance
from torchweather.evaluation.robustness.rates import Rates, rates
from torchweather.recipes.suite import Condition

__all__ = ["ConditionResult", "RobustnessResult"]


@dataclass(frozen=True)
class ConditionResult:
    """The performance in one weather and severity.

    Args:
        condition: which.
        value: mean over the seeds, in [0, 1].
        by_seed: of each seed.
        by_class: mean over the seeds.
        interval: 95 % interval of ``value`` over the frames; ``None`` where there is none.
        difference: 95 % interval of ``value`` minus clear air, over the same frames.
        class_intervals: 95 % intervals of every class over the frames.
    """

    condition: Condition
    value: float
    by_seed: tuple[float, ...]
    by_class: Mapping[str, float]
    interval: Interval | None = None
    difference: Interval | None = None
    class_intervals: Mapping[str, Interval] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class RobustnessResult:
    """Everything that a run found.

    Args:
        measure: ``AP`` or ``mIoU``.
        clear: performance in clear air.
        conditions: in every weather and severity.
        scores: tidy table of the metrics' scores, as a sweep's.
        frames: names of the frames.
        thresholds: overlaps from which on a box is a hit.
        clear_interval: 95 % interval of the performance in clear air over the frames.
        operating: least score of the boxes that are shown; ``None`` of segmentation.
        depth: how sure the least sure depth is (``exact``, ``measured``, ``completed``, ``guessed``), or empty.
        resamples: draws of the frames behind the intervals.
        clear_class_intervals: 95 % intervals of every class in clear air.
        truths: classes that are judged, and how many boxes, pixels or points of them.
    """

    measure: str
    clear: Performance
    conditions: tuple[ConditionResult, ...]
    scores: Mapping[str, list[Any]]
    frames: tuple[str, ...]
    thresholds: tuple[float, ...] = field(default=(0.5,))
    clear_interval: Interval | None = None
    operating: OperatingPoint | None = None
    depth: str = ""
    resamples: int = 0
    clear_class_intervals: Mapping[str, Interval] = field(default_factory=dict)
    truths: Mapping[str, int] = field(default_factory=dict)

    @property
    def by_weather(self) -> dict[str, list[ConditionResult]]:
        """The conditions of each weather, lightest first."""
        found: dict[str, list[ConditionResult]] = {}
        for each in self.conditions:
            found.setdefault(each.condition.name, []).append(each)
        return found

    def rates(self, baseline: Mapping[str, Sequence[float]] | None = None) -> Rates:
        """Resilience rate and corruption error."""
        values = {name: [each.value for each in group] for name, group in self.by_weather.items()}
        return rates(self.clear.value, values, baseline)

    def performance_table(self) -> dict[str, list[Any]]:
        """A row a condition and seed, as ``torchweather correlate`` takes it; clear air has no weather and no row."""
        columns: dict[str, list[Any]] = {
            name: [] for name in ("weather", "knob", "value", "severity", "seed", self.measure)
        }
        classes = list(self.clear.by_class)
        columns |= {f"{self.measure}_{name}": [] for name in classes}
        for each in self.conditions:
            one = each.condition
            for seed, value in enumerate(each.by_seed):
                by_class = [each.by_class.get(name, math.nan) for name in classes]
                row = (one.name, one.knob, one.value, one.severity, seed, value, *by_class)
                for column, entry in zip(columns.values(), row, strict=True):
                    column.append(entry)
        return columns
