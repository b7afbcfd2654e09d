"""The numbers of a robustness run as ``robustness.json`` and ``robustness.csv`` hold them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

import numpy as np

from torchweather import __version__
from torchweather.evaluation.robustness import Declaration, Rates, RobustnessResult
from torchweather.evaluation.robustness.baseline import RESULT_FORMAT
from torchweather.evaluation.robustness.intervals import Interval
from torchweather.evaluation.robustness.remarks import headline_of_depth
from torchweather.metrics.condition_table import FEWEST
from torchweather.metrics.correlation import Correlation, correlate

__all__ = ["correlation_of", "plain", "summary_of", "table_of"]


def plain(value: Any) -> Any:
    """The value with numbers that JSON can hold: NaN and infinity become None."""
    if isinstance(value, Mapping):
        return {str(key): plain(entry) for key, entry in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain(entry) for entry in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def correlation_of(result: RobustnessResult) -> tuple[Correlation | None, list[str]]:
    """Scores against the performance, and why there is none."""
    if not result.scores["metric"]:
        return None, []
    if len(result.conditions) < FEWEST:
        return None, [f"{len(result.conditions)} conditions are too few for a correlation; {FEWEST} would do."]
    if all(math.isnan(each.value) for each in result.conditions):
        return None, ["No class has a truth, so there is no performance to correlate with."]
    return correlate(result.scores, result.performance_table(), performance_column=result.measure), []


def summary_of(
    result: RobustnessResult, found: Rates, declaration: Declaration, *, model: str, recipe: str, sensor: str, seed: int
) -> dict[str, Any]:
    """Everything of a run that ``robustness.json`` holds; intervals as their two ends."""
    means = _mean_scores(result)
    return {
        "format": RESULT_FORMAT,
        "torchweather": __version__,
        "model": model,
        "detector": declaration.title,
        "recipe": recipe,
        "sensor": sensor,
        "decoder": declaration.task,
        "measure": result.measure,
        "thresholds": list(result.thresholds),
        "seed": seed,
        "frames": list(result.frames),
        "clear": result.clear.value,
        "clear_interval": _ends(result.clear_interval),
        "clear_by_class": dict(result.clear.by_class),
        "clear_class_intervals": {name: _ends(ends) for name, ends in result.clear_class_intervals.items()},
        "truths": dict(result.truths),
        "headline": headline_of_depth(result),
        "depth": result.depth or None,
        "resamples": result.resamples,
        "operating_point": None if result.operating is None else asdict(result.operating),
        "conditions": [
            {
                "weather": each.condition.name,
                "kind": each.condition.kind,
                "knob": each.condition.knob,
                "value": each.condition.value,
                "severity": each.condition.severity,
                "performance": each.value,
                "interval": _ends(each.interval),
                "difference_interval": _ends(each.difference),
                "class_intervals": {name: _ends(ends) for name, ends in each.class_intervals.items()},
                "by_seed": list(each.by_seed),
                "by_class": dict(each.by_class),
                "scores": means.get((each.condition.name, each.condition.severity), {}),
            }
            for each in result.conditions
        ],
        "mean_corruption_error": found.mean_corruption_error,
        "mean_resilience_rate": found.mean_resilience,
        "corruption_error": dict(found.corruption_error),
        "resilience_rate": dict(found.resilience),
        "reference": found.reference,
    }


def _ends(interval: Interval | None) -> list[float] | None:
    return None if interval is None else [interval.low, interval.high]


def _mean_scores(result: RobustnessResult) -> dict[tuple[str, int], dict[str, float]]:
    """Mean of each metric over frames and storms, by weather and severity."""
    values: dict[tuple[str, int], dict[str, list[float]]] = {}
    table = result.scores
    for weather, severity, metric, score in zip(
        table["weather"], table["severity"], table["metric"], table["score"], strict=True
    ):
        values.setdefault((weather, severity), {}).setdefault(metric, []).append(score)
    return {key: {name: float(np.mean(v)) for name, v in by_metric.items()} for key, by_metric in values.items()}


def table_of(summary: dict[str, Any]) -> dict[str, list[Any]]:
    """A row a condition: performance, and the rates of its weather."""
    columns: dict[str, list[Any]] = {
        name: []
        for name in (
            *("weather", "knob", "value", "severity", summary["measure"], "low", "high", "clear"),
            *("resilience_rate", "corruption_error", "depth"),
        )
    }
    for each in summary["conditions"]:
        row = (
            *(each["weather"], each["knob"], each["value"], each["severity"], each["performance"]),
            *(each["interval"] or (math.nan, math.nan)),
            *(summary["clear"], summary["resilience_rate"][each["weather"]]),
            *(summary["corruption_error"][each["weather"]], summary["depth"] or ""),
        )
        for column, entry in zip(columns.values(), row, strict=True):
            column.append(entry)
    return columns
