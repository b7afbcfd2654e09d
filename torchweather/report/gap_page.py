"""The page of the search for a missing effect: the verdict, where it shows, what else it could be, what is left."""

from __future__ import annotations

import math
import platform
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch

from torchweather import __version__
from torchweather.gap.diagnosis import diagnose
from torchweather.gap.gap_report import Curve, GapReport, Response
from torchweather.gap.severity import weather_label
from torchweather.gap.study import Study
from torchweather.io import atomic_folder
from torchweather.report.correlation_figures import MARKS
from torchweather.report.gap_figures import (
    AFTER,
    BAND,
    BEFORE,
    curve_uri,
    gap_uri,
    residual_uri,
    response_uri,
    unknown_uri,
)
from torchweather.report.gap_words import (
    WHOLE,
    axis_name,
    confidence_text,
    edge_text,
    effect_name,
    exact_twins,
    formula_words,
    group_name,
    headline,
    parameter_rows,
    probability_text,
    signed_text,
    statistic_name,
    verdict_sentence,
)
from torchweather.report.page import html_page
from torchweather.report.tables import number_text
from torchweather.stages.catalogue import EFFECTS

__all__ = ["write_gap"]

GLYPHS = "●■▲◆▼✚"  # of MARKS
# Past so many of its own standard deviations a record is called wrong.
FAR_OFF = 2.0
BAR_PX = 150


def write_gap(
    out_dir: Path, study: Study, report: GapReport, *, effects: Sequence[str] | None = None
) -> dict[str, Any]:
    """Write ``gap.json``, ``model.yaml`` and ``report.html`` (self-contained); nothing where anything fails.

    Args:
        out_dir: gets the files; what it held before stays, unless it has the same name.
        study: that was searched.
        report: of the study.
        effects: ids that the search was confined to; ``None`` is the whole catalogue of the sensor.

    Returns:
        What ``gap.json`` holds.
    """
    answer = report.to_dict()
    searched = [name for name in answer["catalogue"] if effects is None or name in effects]
    page = html_page(
        "gap.html",
        answer=answer,
        version=__version__,
        sha256=report.study_sha256,
        headline=headline(answer),
        sentence=verdict_sentence(answer),
        p_value=probability_text(answer["p_value"]),
        colours={"before": BEFORE, "after": AFTER, "band": BAND},
        figures=_figures(report.curves),
        marks=_marks(study, report.curves),
        with_after=any(one.after is not None for one in report.curves),
        where=[_bin(one) for one in answer["where"]],
        rest=_rest(answer["unknown"]) if answer["unknown"] else None,
        found=[_found(effect, answer, searched, study) for effect in answer["effects"]],
        responses=_responses(report.responses),
        residuals=None if report.residuals is None else residual_uri(report.residuals),
        versions=f"torch {torch.__version__}, numpy {np.__version__}, Python {platform.python_version()}",
        searched=[effect_name(name) for name in searched],
        confined=effects is not None,
        ranking=_ranking(answer),
        gap_picture=gap_uri(answer["gap"], added=answer["verdict"] != "none"),
        gap={name: number_text(answer["gap"][name]) for name in ("before", "after", "floor")},
        interval=[number_text(end) for end in answer["gap"]["interval_after"]],
        held=_named(study, answer["conditions"]["holdout"]),
        fitted=_named(study, answer["conditions"]["fit"]),
        records=_records(study, answer["nuisance"]["by_condition"]),
        rate_factor=f"{100 * (answer['nuisance']['rate_factor'] - 1):+.1f} %".replace("-", "−"),
        findings=diagnose(study),
        seconds=number_text(answer["seconds"]),
    )
    with atomic_folder(Path(out_dir)) as staging:
        report.write(staging)
        (staging / "report.html").write_text(page, encoding="utf-8")
    return answer


def _named(study: Study, conditions: Sequence[str]) -> list[str]:
    """Conditions with their weather, where it is not their name."""
    weather = {one.id: weather_label(one.weather) for one in study.conditions if one.weather is not None}
    return [f"{name} ({weather[name]})" if name in weather else name for name in conditions]


# ---- where -----------------------------------------------------------------------------------------------------------


def _figures(curves: Sequence[Curve]) -> list[dict[str, str]]:
    """A picture for each statistic along each axis."""
    groups: dict[tuple[str, str], list[Curve]] = {}
    for one in curves:
        groups.setdefault((one.statistic, one.axis), []).append(one)
    return [
        {
            "title": statistic_name(statistic),
            "axis": axis_name(axis).partition(",")[0].removesuffix(" in clear air"),
            "picture": curve_uri(members),
        }
        for (statistic, axis), members in groups.items()
    ]


def _marks(study: Study, curves: Sequence[Curve]) -> list[dict[str, str]]:
    """What each mark of the figures stands for."""
    by_id = {one.id: one for one in study.conditions}
    shown = dict.fromkeys(one.condition for one in curves)
    return [
        {
            "glyph": GLYPHS[number % len(MARKS)],
            "id": name,
            "weather": weather_label(by_id[name].weather) if name in by_id else "",
        }
        for number, name in enumerate(shown)
    ]


def _bin(one: Mapping[str, Any]) -> dict[str, str]:
    """A bin that stands out."""
    whole = one["axis"] in WHOLE
    return {
        "statistic": statistic_name(one["statistic"]),
        "axis": axis_name(one["axis"]),
        "from": "" if whole else edge_text(one["axis"], one["from"]),
        "to": "" if whole else edge_text(one["axis"], one["to"]),
        "z": f"{one['z']:+.1f}".replace("-", "−"),
    }


# ---- what ------------------------------------------------------------------------------------------------------------


def _rest(one: Mapping[str, Any]) -> dict[str, Any]:
    """What no effect explains: its bin, its curve, its formula, its stage."""
    whole = len(one["curve"]["value"]) == 1
    curve, formula, stage = one["curve"], one["formula"], one["empirical"]
    words = None
    if formula is not None:
        words = {
            "shape": formula_words(formula["name"]),
            "text": formula["text"].replace("-", "−"),
            "chi2": number_text(formula["chi2_per_dof"]),
        }
    valid = None
    if stage is not None:
        everywhere = stage["axis"] == "every_beam"
        valid = {
            "kind": stage["kind"].replace("_", " "),
            "axis": axis_name(stage["axis"]),
            "from": "" if everywhere else edge_text(stage["axis"], stage["measured_from"]),
            "to": "" if everywhere else edge_text(stage["axis"], stage["measured_to"]),
        }
    return {
        **_bin(one),
        "name": group_name(one["statistic"], one["axis"]),
        "picture": None if whole else unknown_uri(one["axis"], curve, formula),
        "single": _single(curve) if whole else "",
        "unit": curve["unit"],
        "formula": words,
        "stage": valid,
        "why_not": one["why_not"],
    }


def _single(curve: Mapping[str, Any]) -> str:
    """A curve of one bin in words."""
    value, low, high = (curve[name][0] for name in ("value", "low", "high"))
    if value is None:
        return ""
    return f"{signed_text(value)} ({signed_text(low)} to {signed_text(high)})"


def _responses(responses: Sequence[Response]) -> list[dict[str, str]]:
    """A picture of the responses for each statistic."""
    groups: dict[tuple[str, str], list[Response]] = {}
    for one in responses:
        groups.setdefault((one.statistic, one.axis), []).append(one)
    return [
        {
            "title": statistic_name(statistic),
            "axis": axis_name(axis).partition(",")[0].removesuffix(" in clear air"),
            "picture": response_uri(members),
        }
        for (statistic, axis), members in groups.items()
    ]


def _found(
    effect: Mapping[str, Any], answer: Mapping[str, Any], searched: Sequence[str], study: Study
) -> dict[str, Any]:
    """An effect with its parameters, and what it could be mistaken for."""
    name = effect["name"]
    declared = EFFECTS[name]
    rivals = dict.fromkeys([*effect["confusable_with"], *declared.confusable_with])
    rivals = {rival: None for rival in rivals if rival in answer["catalogue"]}
    with_intensity = getattr(study.sensor, "intensity_unit", "none") != "none"
    return {
        "id": name,
        "name": effect_name(name),
        "title": declared.title,
        "term": declared.term,
        "percollect": declared.percollect,
        "confidence": confidence_text(effect["confidence"]),
        "parameters": parameter_rows(effect),
        "twins": exact_twins(name, with_intensity=with_intensity),
        "rivals": [
            {
                "name": effect_name(rival),
                "id": rival,
                "open": rival in effect["confusable_with"],
                "status": _status(rival, effect, answer, searched),
                "data": _data_between(name, rival),
            }
            for rival in rivals
        ],
    }


def _status(rival: str, effect: Mapping[str, Any], answer: Mapping[str, Any], searched: Sequence[str]) -> str:
    """What these data say of an effect that another could be mistaken for."""
    if rival in effect["confusable_with"]:
        return "cannot be excluded"
    if rival in {one["name"] for one in answer["effects"]}:
        return "found, too"
    if rival in {one["name"] for one in answer["candidates"]}:
        return "fits worse"
    return "explains less; not refitted" if rival in searched else "was not searched for"


def _data_between(name: str, rival: str) -> str:
    """What data would tell two effects apart, as the catalogue says it of either."""
    other = EFFECTS[rival].confusable_with if rival in EFFECTS else {}
    return EFFECTS[name].confusable_with.get(rival) or other.get(name) or "the catalogue does not say"


def _ranking(answer: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Fitted candidates, best first."""
    most = max((one["gain"] for one in answer["candidates"]), default=0.0)
    named = {effect["name"] for effect in answer["effects"]}
    rivals = {rival for effect in answer["effects"] for rival in effect["confusable_with"]}
    rows = []
    for one in answer["candidates"]:
        known = EFFECTS.get(one["name"])
        interval = {key: [value, value] for key, value in one["parameters"].items() if _departs(known, key, value)}
        values = parameter_rows({**one, "interval": interval})
        rows.append(
            {
                "id": one["name"],
                "name": effect_name(one["name"]),
                "title": known.title if known else "",
                "values": [f"{row['name']} {row['value']} {row['unit']}".strip() for row in values],
                "gain": number_text(max(one["gain"], 0.0)),
                "misfit": number_text(one["misfit"]),
                "bar": round(BAR_PX * max(one["gain"], 0.0) / most) if most > 0 else 0,
                "look": "named" if one["name"] in named else "rival" if one["name"] in rivals else "",
            }
        )
    return rows


def _departs(effect: Any, parameter: str, value: float | str) -> bool:
    """Whether a parameter is elsewhere than where it does nothing."""
    declared = {one.name: one.identity for one in effect.arguments} if effect else {}
    return declared.get(parameter) != float(value)


# ---- the record and the study ----------------------------------------------------------------------------------------


def _records(study: Study, nuisance: Mapping[str, float]) -> list[dict[str, str | bool]]:
    """How far the weather's record of each condition was moved."""
    by_id = {one.id: one for one in study.conditions}
    rows: list[dict[str, str | bool]] = []
    for name, factor in nuisance.items():
        one = by_id.get(name)
        sd = 0.0 if one is None else one.rel_sd
        off = math.log(factor) / sd if sd > 0 else math.nan
        rows.append(
            {
                "id": name,
                "weather": "" if one is None else weather_label(one.weather),
                "sd": f"{100 * sd:.3g} %" if sd > 0 else "not stated",
                "moved": f"{100 * (factor - 1):+.1f} %".replace("-", "−"),
                "in_sd": "–" if math.isnan(off) else f"{off:+.1f}".replace("-", "−"),
                "far": abs(off) > FAR_OFF,
            }
        )
    return rows
