"""The page of a validation: frames side by side, scores measured and simulated, trends, and what the study lacks."""

from __future__ import annotations

import json
import math
import statistics
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch

from torchweather.atmosphere.weather import Weather
from torchweather.camera.sensor import Camera
from torchweather.gap.comparison import FAMILY_LEVEL, Comparison
from torchweather.gap.severity import TrendComparison, knob_value
from torchweather.gap.simulation import simulate
from torchweather.gap.splits import severity
from torchweather.gap.study import Condition, Frame, Study
from torchweather.gap.validation import ConditionResult, Validation
from torchweather.io import atomic_folder
from torchweather.radar.sensor import Radar
from torchweather.report.lidar_figures import COLOURS
from torchweather.report.page import html_page
from torchweather.report.pictures import jpeg_uri, look_of, shrunk
from torchweather.report.radar_figures import bar_uri, power_scale
from torchweather.report.tables import number_text
from torchweather.report.validation_figures import (
    DIFFERS,
    NEARER_M,
    SIMULATED,
    Group,
    lidar_above_uri,
    link_series_uri,
    radar_above_uri,
    score_uri,
)

__all__ = ["write_validation"]

PICTURE_PX = 640
AXES = {"rate_mm_per_h": "mm/h", "mor_m": "visibility, m"}
KINDS = {"lidar": "LiDAR", "camera": "camera", "radar": "radar", "link": "microwave links"}
TITLES = {
    "haarpsi": "HaarPSI",
    "power_change_db": "Change of power",
    "power_rmse_db": "RMS change of power",
    "detected_share": "Detected share",
    "attenuation_db": "Mean attenuation",
}
# Verdict of a trend, in words.
GOES = {
    "expected": "worse at every step",
    "tied": "never better",
    "reversed": "better at every step",
    "broken": "up and down",
    "unjudged": "–",
}


def write_validation(
    out_dir: Path, study: Study, validation: Validation, *, self_check: bool = False
) -> dict[str, Any]:
    """Write ``index.html`` (self-contained) and ``validation.json``; nothing is written when anything fails.

    Args:
        out_dir: gets the files; what it held before stays, unless it has the same name.
        study: that was validated.
        validation: of the study.
        self_check: nothing was measured: the page says that its measured frames are simulated, too.

    Returns:
        What ``validation.json`` holds.
    """
    summary = {**validation.to_dict(), "self_check": self_check}
    groups = _groups(study, validation)
    names = list(groups[0].cells[0]) if groups and groups[0].cells else []
    page = html_page(
        "validation.html",
        summary=summary,
        kind=KINDS[study.kind],
        kind_id=study.kind,
        self_check=self_check,
        verdict=validation.verdict(),
        agrees=not validation.differing(),
        groups=groups,
        colours={**COLOURS, "differs": DIFFERS, "simulated": SIMULATED},
        nearer_m=NEARER_M,
        pictures=list(_pictures(study, validation)),
        bar=_bar(study),
        figures=[
            {"title": _title(name), "says": _says(groups[0].cells[0][name]), "picture": score_uri(name, groups)}
            for name in names
        ],
        matrix=[
            {"title": _title(name), "cells": [_cell(cell[name]) for g in groups for cell in g.cells]} for name in names
        ],
        trends=[_trend(trend, len(study.scenes) > 1 or study.kind == "link") for trend in validation.trends],
        numbers=[_numbers(group, names) for group in groups],
        quantities=_quantities(validation),
        findings=validation.findings,
        chance=f"{100 * FAMILY_LEVEL:g}",
        time=_time(validation),
        frames=_frames(validation),
        left_out=[f"{_title(name)}: {why}" for name, why in validation.left_out.items()],
    )
    with atomic_folder(Path(out_dir)) as staging:
        text = json.dumps(summary, indent=1, allow_nan=False)
        (staging / "validation.json").write_text(text + "\n", encoding="utf-8")
        (staging / "index.html").write_text(page, encoding="utf-8")
    return summary


# ---- groups of conditions --------------------------------------------------------------------------------------------


def _groups(study: Study, validation: Validation) -> list[Group]:
    """Conditions by scene and weather, in order of severity; of links the classes of rain of each series."""
    if study.kind == "link":
        return [
            Group(
                each.label,
                f"{each.label}: rain from, mm/h",
                tuple(
                    score.name.removeprefix("attenuation_db_from_").removesuffix("_mm_per_h") for score in each.scores
                ),
                tuple({"attenuation_db": score} for score in each.scores),
            )
            for each in validation.conditions
            if each.scores
        ]
    rows: dict[tuple[str, str], list[tuple[Weather | None, ConditionResult]]] = {}
    for condition, result in zip(study.conditions, validation.conditions, strict=True):
        kind = "clear" if condition.weather is None else condition.weather.kind
        rows.setdefault((condition.scene, kind), []).append((condition.weather, result))
    groups = []
    for (scene, kind), members in rows.items():
        members.sort(key=lambda member: 0.0 if member[0] is None else severity(member[0]))
        first = members[0][0]
        where = f"{scene}: " if len(study.scenes) > 1 else ""
        groups.append(
            Group(
                f"{where}{kind}",
                f"{where}{kind}" + ("" if first is None else f", {AXES[first.knob_name]}"),
                tuple("" if weather is None else f"{knob_value(weather):g}" for weather, _ in members),
                tuple({score.name: score for score in result.scores} for _, result in members),
            )
        )
    return groups


# ---- pictures --------------------------------------------------------------------------------------------------------


def _pictures(study: Study, validation: Validation) -> Iterator[dict[str, Any]]:
    """Clear, measured and simulated frame side by side, for the strongest of each weather of each scene."""
    if study.kind == "link":
        for condition in study.conditions:
            measured = condition.frames[0]
            simulated = simulate(study, condition, seed=validation.seed)
            rain = np.nanmean(np.nan_to_num(np.asarray(measured["rain_mm_per_h"], dtype=np.float64)), axis=(0, 2))
            link = int(rain.argmax())
            about = f"{condition.id}, link {link}: the one with the most rain"
            yield {"label": about, "wide": link_series_uri(measured, simulated, link)}
        return
    strongest: dict[tuple[str, str], Condition] = {}
    for condition in study.conditions:
        if condition.weather is not None:
            key = (condition.scene, condition.weather.kind)
            held = strongest.get(key)
            if held is None or held.weather is None or severity(condition.weather) > severity(held.weather):
                strongest[key] = condition
    labels = {result.id: result.label for result in validation.conditions}
    for condition in strongest.values():
        scene = study.scene_of(condition)
        clear = scene.clear[0]
        simulated = simulate(study, condition, seed=validation.seed)
        where = f"{condition.scene}: " if len(study.scenes) > 1 else ""
        drawn = _drawn(study, clear, [clear, condition.frames[0], simulated], scene.geometry)
        yield {
            "label": f"{where}{labels[condition.id]}",
            "row": [
                {"label": label, "picture": picture}
                for label, picture in zip(("clear", "measured", "simulated"), drawn, strict=True)
            ],
        }


def _drawn(study: Study, clear: Frame, frames: Sequence[Frame], geometry: Frame) -> list[str]:
    if isinstance(study.sensor, Camera):
        linear = [torch.from_numpy(np.array(frame["bayer"], dtype=np.float32))[None] for frame in (clear, *frames)]
        depth_m = torch.from_numpy(np.array(geometry["depth_m"], dtype=np.float32))[None]
        look = look_of(linear[0], depth_m, study.sensor)
        pattern = study.sensor.bayer_pattern
        return [jpeg_uri(shrunk(look.develop(each, pattern), PICTURE_PX), quality=90) for each in linear[1:]]
    if study.kind == "lidar":
        return [lidar_above_uri(frame, clear, study.beams["direction"]) for frame in frames]
    scale, far_m = _radar_scale(study)
    return [radar_above_uri(frame, clear, geometry, scale, far_m) for frame in frames]


def _radar_scale(study: Study) -> tuple[tuple[float, float], float]:
    """Ends of the scale of powers, dB, and of the pictures ahead, m."""
    powers = [np.asarray(scene.clear[0]["power_db"], dtype=np.float64) for scene in study.scenes.values()]
    known = np.concatenate([power[np.isfinite(power)] for power in powers])
    farthest = max(float(np.max(scene.geometry["range_m"])) for scene in study.scenes.values())
    scale = power_scale(torch.from_numpy(known), 0.05, 0.95) if len(known) else (-10.0, 0.0)
    return scale, 10.0 * math.ceil(farthest / 10.0)


def _bar(study: Study) -> str | None:
    if not isinstance(study.sensor, Radar):
        return None
    return bar_uri("points", _radar_scale(study)[0], "power of the detections, dB")


# ---- words and numbers -----------------------------------------------------------------------------------------------


def _title(name: str) -> str:
    return TITLES.get(name, name.upper().replace("_", "-"))


def _says(cell: Comparison) -> str:
    """Unit, and which way is nearer to clear air."""
    better = "higher is nearer to clear" if cell.meaning.higher_is_better else "lower is nearer to clear"
    return f"{cell.meaning.unit}; {better}" if cell.meaning.unit else better


def _text(value: float, sign: bool = False) -> str:
    if math.isnan(value):
        return "–"
    text = "∞" if math.isinf(value) else number_text(abs(value))
    before = "−" if value < 0 else "+" if sign and value > 0 else ""
    return before + text


def _cell(cell: Comparison) -> dict[str, str]:
    """Gap in standard errors, and how to show it."""
    at_floor = cell.side_of_floor("measured") == cell.side_of_floor("simulated") == "at"
    value = cell.in_errors
    text = "–" if math.isnan(value) else f"{value:+.1f}".replace("-", "−") if math.isfinite(value) else "∞"
    if cell.verdict == "differs":
        return {"text": text if text != "–" else "∞", "look": "differs"}
    if cell.verdict == "unjudged":
        return {"text": "–", "look": "unjudged"}
    return {"text": text, "look": "floor" if at_floor else "agrees"}


def _numbers(group: Group, names: Sequence[str]) -> dict[str, Any]:
    """All numbers of a group, a row for each condition and score."""
    rows = []
    for tick, cells in zip(group.ticks, group.cells, strict=True):
        for name in names:
            cell = cells[name]
            rows.append(
                {
                    "tick": tick,
                    "title": _title(name),
                    "measured": _with_error(cell.measured.mean, cell.measured.standard_error),
                    "simulated": _with_error(cell.simulated.mean, cell.simulated.standard_error),
                    "floor": _with_error(cell.floor.mean, cell.floor.standard_error),
                    "gap": _text(cell.gap, sign=True),
                    "share": "–"
                    if math.isnan(cell.share_of_effect)
                    else f"{100 * cell.share_of_effect:+.0f}\u202f%".replace("-", "−"),
                    "look": cell.verdict,
                }
            )
    return {"title": group.axis, "rows": rows}


def _with_error(mean: float, error: float) -> str:
    return _text(mean) if math.isnan(error) else f"{_text(mean)} ± {_text(error)}"


def _trend(trend: TrendComparison, named: bool) -> dict[str, Any]:
    agreement = {name: trend.agreement(name) for name in trend.measured.metrics}
    apart = [
        f"{_title(name)}: measured {GOES[trend.measured.metrics[name].verdict]}, simulated "
        f"{GOES[trend.simulated.metrics[name].verdict]}"
        for name, agrees in agreement.items()
        if agrees is False
    ]
    close = [_title(name) for name, agrees in agreement.items() if agrees is None]
    return {
        "label": f"{trend.scene}: {trend.weather}" if named else trend.weather,
        "levels": len(trend.values),
        "measured": trend.measured.expected,
        "simulated": trend.simulated.expected,
        "out_of": len(agreement),
        "agree": sum(agrees is True for agrees in agreement.values()),
        "apart": apart,
        "close": close,
    }


def _quantities(validation: Validation) -> list[dict[str, Any]]:
    return [
        {
            "label": result.label
            if len({each.scene for each in validation.conditions}) < 2
            else f"{result.scene}: {result.label}",
            "rows": [
                {
                    "name": each.name + (f", {each.unit}" if each.unit else ""),
                    "measured": _text(each.measured_median),
                    "simulated": _text(each.simulated_median),
                    "bias": _text(each.bias, sign=True),
                    "floor_bias": _text(abs(each.floor_bias)),
                    "scatter": _text(each.scatter),
                    "floor_scatter": _text(each.floor_scatter),
                    "rmse": None if math.isnan(each.rmse) else _text(each.rmse),
                }
                for each in result.quantities
            ],
        }
        for result in validation.conditions
    ]


def _time(validation: Validation) -> dict[str, str]:
    seconds = [each for result in validation.conditions for each in result.simulation_s]
    return {
        "median": f"{1e3 * statistics.median(seconds):.3g}",
        "most": f"{1e3 * max(seconds):.3g}",
        "count": str(len(seconds)),
    }


def _frames(validation: Validation) -> str:
    counts = sorted({result.frames for result in validation.conditions})
    return str(counts[0]) if len(counts) == 1 else f"{counts[0]} to {counts[-1]}"
