"""The robustness run's folder: its tables, its numbers, its page, and the correlation of scores and performance."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from torchweather.evaluation.robustness import Declaration, Rates, RobustnessResult
from torchweather.evaluation.robustness.baseline import reference_of
from torchweather.evaluation.robustness.frames import Look
from torchweather.evaluation.robustness.remarks import interval_text, remarks
from torchweather.evaluation.sweep import Level
from torchweather.io import atomic_folder, atomic_write, write_table
from torchweather.report.correlation_page import write_correlation
from torchweather.report.page import html_page
from torchweather.report.robustness_figures import LEGENDS, look_uri, performance_uri
from torchweather.report.robustness_summary import correlation_of, plain, summary_of, table_of
from torchweather.report.sweep_figures import NAMES

__all__ = ["write_robustness"]

NO_VALUE = "–"
MEANINGS = {
    "AP": "average precision, COCO's 101 recalls, mean over the classes that have a truth",
    "mIoU": "intersection over union, mean over the classes that have a truth",
}


def write_robustness(
    out_dir: Path,
    ask: Callable[[Callable[[Look], object]], RobustnessResult],
    declaration: Declaration,
    *,
    model: str,
    recipe: str,
    sensor: str,
    seed: int,
    baseline: dict[str, Any] | None = None,
    notes: Sequence[str] = (),
) -> dict[str, Any]:
    """Run and write what came out.

    Args:
        out_dir: gets ``index.html`` (self-contained), ``robustness.json``, ``robustness.csv`` (a row a weather and
            severity), ``performance.csv`` (a row a storm too), ``scores.csv``, and, from four conditions with scores
            on, ``correlation/``. What it held before stays, unless it has the same name. Nothing is written when
            anything fails.
        ask: runs, and hands on what the first frame looks like; ``run_robustness`` with everything but ``look``.
        declaration: of the detector.
        model, recipe, sensor: their names, for the page.
        seed: of the run.
        baseline: as ``read_baseline`` gives it.
        notes: what a reader must know of the data.

    Returns:
        What ``robustness.json`` holds. Numbers that are not defined are None.
    """
    looks: list[Look] = []
    with atomic_folder(Path(out_dir)) as staging:
        result = ask(looks.append)
        found = result.rates(None if baseline is None else reference_of(baseline, result))
        correlation, said = correlation_of(result)
        summary = summary_of(result, found, declaration, model=model, recipe=recipe, sensor=sensor, seed=seed)
        summary["baseline"] = None if baseline is None else baseline["model"]
        if found.reference == "clear" and result.clear.value == 1.0:
            said.append("The detector makes no error in clear air, so none can be relative to it; give --baseline.")
        summary["notes"] = list(dict.fromkeys([*remarks(result), *notes, *said]))
        summary["correlation"] = None
        write_table(staging / "performance.csv", result.performance_table())
        write_table(staging / "robustness.csv", table_of(summary))
        if result.scores["metric"]:
            write_table(staging / "scores.csv", result.scores)
        if correlation is not None:
            shown = write_correlation(staging / "correlation", correlation, performance=result.measure)
            summary["correlation"] = [
                {"metric": each["metric"], "spearman": each["spearman"]["value"], "rank": each["rank"]}
                for each in shown["metrics"]
            ]
        with atomic_write(staging / "robustness.json") as unfinished:
            unfinished.write_text(json.dumps(plain(summary), indent=1, allow_nan=False) + "\n", encoding="utf-8")
        with atomic_write(staging / "index.html") as unfinished:
            unfinished.write_text(_page(summary, result, found, declaration, looks), encoding="utf-8")
    written: dict[str, Any] = plain(summary)
    return written


# ---- the page -------------------------------------------------------------------------------------------------------


def _page(
    summary: dict[str, Any], result: RobustnessResult, found: Rates, declaration: Declaration, looks: list[Look]
) -> str:
    groups = result.by_weather
    point = result.operating
    least = 0.0 if point is None else point.threshold
    clear_look = [look for look in looks if look.condition is None]
    there = [each for each in result.conditions if not math.isnan(each.value)]
    worst = min(there, key=lambda each: each.value) if there else None
    return html_page(
        "robustness.html",
        summary=summary,
        meaning=MEANINGS[result.measure],
        clear=_text(result.clear.value),
        clear_interval=interval_text(result.clear_interval),
        resilience=_percent(found.mean_resilience),
        error=_text(found.mean_corruption_error),
        worst=None if worst is None else {"text": _level(worst.condition).text, "value": _text(worst.value)},
        severities=max(len(group) for group in groups.values()),
        legend=[
            {"colour": colour, "name": name.format(threshold="" if point is None else f"{point.threshold:.2f}")}
            for colour, name in LEGENDS[declaration.task]
        ],
        upright=declaration.sensor == "lidar",
        classes=_classes(result),
        parts=[
            {
                "name": name,
                "title": name[:1].upper() + name[1:],
                "labels": [f"{each.condition.value:g} {_level(each.condition).unit}" for each in group],
                "cells": [
                    {
                        "text": _text(each.value),
                        "interval": interval_text(each.interval),
                        "shade": _shade(each.value, result.clear.value),
                    }
                    for each in group
                ],
                "resilience": _percent(found.resilience[name]),
                "error": _text(found.corruption_error[name]),
                "chart": performance_uri(group, result.clear.value, result.measure),
                "pictures": [
                    {
                        "label": "Clear" if look.condition is None else _level(look.condition).text,
                        "uri": look_uri(look, least),
                    }
                    for look in (*clear_look, *(k for k in looks if k.condition and k.condition.name == name))
                ],
                "scores": _score_rows(summary, name),
            }
            for name, group in groups.items()
        ],
    )


def _level(condition: Any) -> Level:
    """The condition in the words of a sweep."""
    return Level(condition.name, condition.kind, condition.knob, condition.value, condition.severity, condition.weather)


def _classes(result: RobustnessResult) -> list[dict[str, Any]]:
    if len(result.clear.by_class) < 2:
        return []
    return [
        {
            "name": name,
            "clear": _text(clear),
            "interval": interval_text(result.clear_class_intervals.get(name)),
            "truths": f"{result.truths[name]:,}".replace(",", " "),
            "cells": [
                _text(float(np.mean([each.by_class.get(name, math.nan) for each in group])))
                for group in result.by_weather.values()
            ],
        }
        for name, clear in result.clear.by_class.items()
        if name in result.truths
    ]


def _score_rows(summary: dict[str, Any], weather: str) -> list[dict[str, Any]]:
    conditions = [each for each in summary["conditions"] if each["weather"] == weather]
    rho = {each["metric"]: each["spearman"] for each in summary["correlation"] or []}
    return [
        {
            "name": NAMES.get(metric, metric),
            "cells": [_text(each["scores"][metric], digits=3) for each in conditions],
            "rho": _text(rho[metric]) if metric in rho and not isinstance(rho[metric], str) else NO_VALUE,
        }
        for metric in conditions[0]["scores"]
    ]


def _shade(value: float, clear: float) -> float:
    """Opacity of a cell: the share of the clear performance that is lost."""
    return 0.0 if math.isnan(value) or not clear > 0 else round(min(max(1 - value / clear, 0.0), 1.0) * 0.55, 3)


def _percent(value: float) -> str:
    return NO_VALUE if math.isnan(value) else f"{100 * value:.0f} %"


def _text(value: float, *, digits: int = 2) -> str:
    if math.isinf(value):
        return "∞" if value > 0 else "−∞"
    return NO_VALUE if math.isnan(value) else f"{value:.{digits}f}".replace("-", "−")
