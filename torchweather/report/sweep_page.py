"""The sweep's folder: its table, its summary, and a page with the curves, the counts and what explains each miss."""

from __future__ import annotations

import json
import math
import os
import platform
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor
from tqdm import tqdm

from torchweather import __version__
from torchweather.camera.depth import EXACT, least_sure
from torchweather.core.errors import InputValueError, check_one_of
from torchweather.evaluation.sweep import (
    CameraSubject,
    Level,
    LidarSubject,
    Series,
    Subject,
    columns_of,
    judged,
    samples,
    series_of,
)
from torchweather.evaluation.sweep.misses import explain_miss
from torchweather.evaluation.sweep.run import plan
from torchweather.evaluation.sweep.trends import BY_RANKS, Judgement, SeriesTrends
from torchweather.io import atomic_folder, atomic_write, write_table
from torchweather.report.figures import SHADES
from torchweather.report.frames import Frame
from torchweather.report.lidar_figures import COLOURS, birds_eye_uri
from torchweather.report.page import html_page
from torchweather.report.pictures import jpeg_uri, shrunk
from torchweather.report.sweep_clouds import flat_pictures, weather_clouds
from torchweather.report.sweep_figures import AXES, MISS, NAMES, points_above_uri, score_uri

__all__ = ["TABLES", "write_sweep"]

TABLES = ("csv", "parquet")
"""Formats of the table."""

SMALL, LARGE = 1e-4, 1e4  # numbers beyond are written with an exponent, or as whole ones
PICTURE_PX = 480  # columns of a picture
SENSORS = {"camera": "camera frames", "lidar": "LiDAR clouds", "radar": "radar detections"}


def write_sweep(
    out_dir: Path,
    subjects: Sequence[Subject],
    levels: Sequence[Level],
    seeds: Sequence[int],
    names: Sequence[str] | None = None,
    *,
    sensor: str,
    table: str = "csv",
    notes: Sequence[str] = (),
    progress: bool = True,
) -> dict[str, Any]:
    """Sweep weather over subjects and write what came out.

    Args:
        out_dir: gets the table (``scores.csv`` or ``scores.parquet``), ``summary.json`` and ``index.html``
            (self-contained). What it held before stays, unless it has the same name. Nothing is written when anything
            fails.
        subjects, levels, seeds, names: as in ``torchweather.evaluation.sweep.sweep``; subjects of one sensor.
        sensor: its name, for the page.
        table: ``csv`` or ``parquet``.
        notes: what a reader must know of the subjects.
        progress: show a progress bar.

    Returns:
        What ``summary.json`` holds. Numbers that are not finite are the texts ``inf``, ``-inf`` and ``nan``.
    """
    check_one_of("table", table, TABLES, owner="write_sweep")
    kinds = {subject.sensor for subject in subjects}
    if len(kinds) > 1:
        raise InputValueError(f"write_sweep: wanted subjects of one sensor; got {', '.join(sorted(kinds))}.")
    started = time.perf_counter()
    total = sum(len(fits) for _, fits in plan(subjects, levels)) * len(seeds)
    with atomic_folder(Path(out_dir)) as staging:
        found = []
        with tqdm(total=total, desc="sweep", unit="sample", disable=not progress) as bar:
            for sample in samples(subjects, levels, seeds, names):
                found.append(sample)
                bar.update()
        write_table(staging / f"scores.{table}", columns_of(found))
        series = series_of(found)
        trends = [judged(one) for one in series]
        records = [_record(one, trend) for one, trend in zip(series, trends, strict=True)]
        summary = {
            "torchweather": __version__,
            "sensor": sensor,
            "subjects": [subject.name for subject in subjects],
            "seeds": list(seeds),
            "table": f"scores.{table}",
            "notes": list(notes),
            "depth": least_sure(*(getattr(subject, "depth_confidence", EXACT) for subject in subjects)),
            "machine": {
                "torch": torch.__version__,
                "processor": platform.machine(),
                "cores": os.cpu_count(),
                "threads": torch.get_num_threads(),
                "device": "cpu",
            },
            "series": records,
            "seconds": round(time.perf_counter() - started, 3),
        }
        by_name = {subject.name: subject for subject in subjects}
        parts = [
            _part(record, one, trend, by_name[one.subjects[0]])
            for record, one, trend in zip(records, series, trends, strict=True)
        ]
        text = json.dumps(summary, indent=1, allow_nan=False) + "\n"
        with atomic_write(staging / "summary.json") as unfinished:
            unfinished.write_text(text, encoding="utf-8")
        with atomic_write(staging / "index.html") as unfinished:
            page = html_page("sweep.html", summary=summary, parts=parts, kind=SENSORS[subjects[0].sensor], miss=MISS)
            unfinished.write_text(page, encoding="utf-8")
    return summary


def _number(value: float) -> float | str:
    """As JSON can hold it."""
    return float(value) if math.isfinite(value) else str(float(value))


# ---- numbers --------------------------------------------------------------------------------------------------------


def _record(series: Series, trends: SeriesTrends) -> dict[str, Any]:
    """A series for the summary."""
    first = series.levels[0]
    return {
        "scene": series.scene,
        "subjects": list(series.subjects),
        "weather": first.name,
        "knob": first.knob,
        "values": [level.value for level in series.levels],
        "weathers": [level.weather.to_dict() for level in series.levels],
        "expected": trends.expected,
        "out_of": trends.out_of,
        "interval": None if trends.interval is None else list(trends.interval),
        "chance": 1.0 / math.factorial(len(series.levels)),
        "metrics": {name: _metric(series, one) for name, one in trends.metrics.items()},
        "facts": {name: [_number(value) for value in values.mean(1)] for name, values in series.facts.items()},
        "facts_clear": {name: _number(value) for name, value in series.clear.items()},
        "times_s": {"render_s": round(series.render_s, 6), "score_s": round(series.score_s, 6)},
    }


def _metric(series: Series, judgement: Judgement) -> dict[str, Any]:
    scores = series.scores[judgement.metric]
    # The deviation of an infinite score is no number.
    finite = np.isfinite(scores).all(1) & (scores.shape[1] > 1)
    spread = [float(row.std(ddof=1)) if ok else math.nan for row, ok in zip(scores, finite, strict=True)]
    return {
        "better": series.directions[judgement.metric],
        "mean": [_number(value) for value in scores.mean(1)],
        "std": [_number(value) for value in spread],
        "follows": judgement.follows,
        "verdict": judgement.trend.verdict,
        "confidence": judgement.trend.confidence,
        "page_p": judgement.page_p,
        "why": [] if judgement.follows else explain_miss(series, judgement),
    }


# ---- the page -------------------------------------------------------------------------------------------------------


def _part(record: dict[str, Any], series: Series, trends: SeriesTrends, subject: Subject) -> dict[str, Any]:
    """A series for the page."""
    level = series.levels[0]
    shades = SHADES[level.kind]
    return {
        **record,
        "title": _title(series),
        "axis": AXES[level.knob],
        "colour": shades[len(shades) // 2],
        "pictures": _pictures(series, subject),
        "flats": flat_pictures(series, subject),
        "legend": _legend(subject),
        "upright": not isinstance(subject, CameraSubject),
        "charts": [
            {"name": NAMES.get(name, name), "picture": score_uri(series, name, follows=one.follows)}
            for name, one in trends.metrics.items()
        ],
        "rows": [_row(name, record["metrics"][name], one) for name, one in trends.metrics.items()],
        "misses": [
            {"name": NAMES.get(name, name).split(",")[0], "why": record["metrics"][name]["why"]}
            for name, one in trends.metrics.items()
            if not one.follows
        ],
        "by_ranks": [NAMES[name].split(",")[0] for name, one in trends.metrics.items() if name in BY_RANKS],
        "labels": [f"{one.value:g} {one.unit}" for one in series.levels],
        "facts_rows": _facts_rows(series),
    }


def _title(series: Series) -> str:
    level = series.levels[0]
    values = ", ".join(f"{one.value:g}" for one in series.levels)
    more = level.name.removeprefix(level.kind).lstrip(":")
    return f"{level.kind.capitalize()} {values}\N{NO-BREAK SPACE}{level.unit}" + (f" ({more})" if more else "")


def _row(name: str, record: dict[str, Any], judgement: Judgement) -> dict[str, Any]:
    if judgement.follows:
        verdict = "yes" if judgement.page_p is None else "yes, by the seeds' ranks"
    else:
        verdict = {"tied": "no: equal levels", "reversed": "no: reversed", "unjudged": "not judged"}.get(
            judgement.trend.verdict, "no"
        )
    cells = [
        {"mean": _text(mean), "std": "" if std == "nan" else f"{std:.2g}"}
        for mean, std in zip(record["mean"], record["std"], strict=True)
    ]
    arrow = "↑" if record["better"] == "up" else "↓"
    return {
        "name": NAMES.get(name, name),
        "arrow": arrow,
        "cells": cells,
        "verdict": verdict,
        "follows": judgement.follows,
    }


FACTS = {
    "mean": "Mean of the frame (linear light, 1 is white)",
    "contrast": "Its standard deviation",
    "points": "Points",
    "pair_distance_m": "Mean distance between two points, m",
    "range_m": "Median range, m",
}


def _facts_rows(series: Series) -> list[dict[str, Any]]:
    return [
        {"name": FACTS[name], "clear": _text(series.clear[name]), "cells": [_text(value) for value in values.mean(1)]}
        for name, values in series.facts.items()
    ]


def _text(value: float | str) -> str:
    if isinstance(value, str):
        return value.replace("inf", "∞")
    if not math.isfinite(value):
        return "–" if math.isnan(value) else "∞"
    if value == 0 or abs(value) < SMALL:
        return "0" if value == 0 else f"{value:.1e}"
    return f"{value:,.0f}".replace(",", " ") if abs(value) >= LARGE else f"{value:.4g}"


def _pictures(series: Series, subject: Subject) -> list[dict[str, str]]:
    """The first subject of the series, clear and in every level, with the first seed."""
    draw = _camera_pictures if isinstance(subject, CameraSubject) else _cloud_pictures
    labels = ["Clear", *(level.text for level in series.levels)]
    return [
        {"label": label, "picture": picture}
        for label, picture in zip(labels, draw(subject, series.levels, series.seeds[0]), strict=True)
    ]


def _camera_pictures(subject: Any, levels: Sequence[Level], seed: int) -> list[str]:
    frame = Frame(subject.name, subject.name, subject.data, subject.depth_m, subject.camera)
    data = [subject.reference, *(subject.render(level.weather, seed) for level in levels)]
    return [jpeg_uri(shrunk(frame.picture(one), PICTURE_PX)) for one in data]


def _cloud_pictures(subject: Any, levels: Sequence[Level], seed: int) -> list[str]:
    if not isinstance(subject, LidarSubject):
        clear = _there(subject.clear)
        clouds = [clear, *(_there(subject.render(level.weather, seed)) for level in levels)]
        return [points_above_uri(cloud, clear) for cloud in clouds]
    found = weather_clouds(subject, levels, seed)
    return [birds_eye_uri(cloud, found[0]) for cloud in found]


def _there(points: Tensor) -> Tensor:
    return points[(points[:, :3] != 0).any(-1)]


def _legend(subject: Subject) -> list[dict[str, str]]:
    if isinstance(subject, CameraSubject):
        return []
    if isinstance(subject, LidarSubject):
        names = {
            "object": "objects",
            "particle": "returns of the weather",
            "lost": "points that are lost, where they were",
        }
    else:
        names = {"object": "detections", "lost": "detections of clear air"}
    return [{"colour": COLOURS[kind], "name": name} for kind, name in names.items()]
