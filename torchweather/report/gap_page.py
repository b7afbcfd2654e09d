"""The page of the search for a missing effect: the verdict, where it shows, held-out conditions, weather record."""

from __future__ import annotations

import math
import platform
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch

from torchweather import __version__
from torchweather.evaluation.validation.severity import weather_label
from torchweather.gap.diagnosis import diagnose
from torchweather.gap.gap_report import Curve, GapReport
from torchweather.gap.study.study import Study
from torchweather.io import atomic_folder
from torchweather.report import parts
from torchweather.report.correlation_figures import MARKS
from torchweather.report.findings import study_alerts, study_section
from torchweather.report.gap_effects import along, by_statistic, ranking_section, what_section
from torchweather.report.gap_figures import AFTER, BAND, BEFORE, curve_uri, gap_uri, residual_uri
from torchweather.report.gap_words import (
    WHOLE,
    axis_name,
    edge_text,
    effect_name,
    headline,
    probability_text,
    statistic_name,
    verdict_sentence,
)
from torchweather.report.page import write_report
from torchweather.report.report import Report, Section
from torchweather.report.tables import NO_VALUE, number_text

__all__ = ["gap_page", "write_gap"]

GLYPHS = "●■▲◆▼✚"  # of MARKS
# Past so many of its own standard deviations a record is called wrong.
FAR_OFF = 2.0
MODEL = """from torchweather import LidarWeather
from torchweather.gap.gap_report import read_model

repaired = LidarWeather(weather, sensor, effects=read_model("model.yaml"))"""
EMPIRICAL = """from torchweather import LidarWeather
from torchweather.gap.gap_report import read_model

copied = read_model("model.yaml").apply(LidarWeather(weather, sensor), empirical=True)"""


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
    page = gap_page(study, report, effects=effects)
    with atomic_folder(Path(out_dir)) as staging:
        report.write(staging)
        write_report(page, staging / "report.html")
    return report.to_dict()


def gap_page(study: Study, report: GapReport, *, effects: Sequence[str] | None = None) -> Report:
    """The page of a search; arguments as ``write_gap``."""
    answer, findings = report.to_dict(), diagnose(study)
    searched = [name for name in answer["catalogue"] if effects is None or name in effects]
    nothing = answer["verdict"] == "none"
    sections = [Section("Where", [*_where(study, report, answer), *_confined(searched, effects), *_limits(answer)])]
    if not nothing:
        sections += [what_section(answer, searched, study), ranking_section(answer, report.responses)]
    if report.residuals is not None:
        sections.append(_map(report))
    sections += [_held_out(study, answer), _record(study, answer), _model(answer), study_section(findings)]
    gap = {name: number_text(answer["gap"][name]) for name in ("before", "after", "floor")}
    fitted, held = (len(answer["conditions"][split]) for split in ("fit", "holdout"))
    facts = [
        ("chance if nothing were missing", probability_text(answer["p_value"])),
        ("held-out gap", gap["before"])
        if nothing
        else ("held-out gap, before → after", f"{gap['before']} → {gap['after']}"),
        ("floor", gap["floor"]),
        ("conditions, fitted and held out", f"{fitted} and {held}"),
    ]
    return Report(
        title=headline(answer),
        head=f"torchweather: {headline(answer)}",
        lead=[parts.Verdict(verdict_sentence(answer)), *study_alerts(findings), parts.Facts(facts)],
        sections=sections,
        footer=_how_to_read(answer, report.study_sha256),
    )


# ---- where -----------------------------------------------------------------------------------------------------------


def _where(study: Study, report: GapReport, answer: Mapping[str, Any]) -> list[parts.Part]:
    """Curves of the statistics that depart most, and the bins that stand out."""
    text = """How far the measured frames are from the simulated ones, for the statistics that are farthest apart. The
        unit is the scatter of the simulation itself at the measured number of frames: inside the grey band, ±1, there
        is nothing to explain."""
    if answer["verdict"] == "none":
        text += " Single marks outside are chance."
    found: list[parts.Part] = [parts.Paragraph(text)]
    if report.curves:
        figures = [
            parts.Figure(
                curve_uri(members),
                f"{statistic_name(statistic)}, measured less simulated, by {along(axis)}",
                title=statistic_name(statistic),
                small=f"by {along(axis)}",
                look="chart",
            )
            for (statistic, axis), members in by_statistic(report.curves).items()
        ]
        found += [*_legends(study, report.curves, answer), parts.Pictures(figures, across=2, look="roomy")]
    else:
        found.append(parts.Paragraph("No statistic has enough in it to be compared."))
    if answer["where"]:
        heads: parts.Heads = ["Statistic", parts.Column("Axis", "words"), "From", "To"]
        rows = [_bin(one) for one in answer["where"]]
        found += [
            parts.Heading("The bins that stand out most, all conditions together"),
            parts.Table([*heads, "Departure, scatters"], rows),
        ]
    return found


def _legends(study: Study, curves: Sequence[Curve], answer: Mapping[str, Any]) -> list[parts.Legend]:
    """Colours of before and after, and the mark of each condition."""
    keys = [parts.Key("the simulation as it is", BEFORE)]
    if any(one.after is not None for one in curves):
        best = "with the best that the catalogue has" if answer["verdict"] == "unknown" else "with what was found"
        keys.append(parts.Key(best, AFTER, look="open"))
    keys.append(parts.Key("scatter of the simulation", BAND, look="band"))
    weather = {one.id: weather_label(one.weather) for one in study.conditions}
    marks = [
        parts.Key(f"{name}: {weather[name]}" if weather.get(name) else name, glyph=GLYPHS[number % len(MARKS)])
        for number, name in enumerate(dict.fromkeys(one.condition for one in curves))
    ]
    return [parts.Legend(keys, chart=True), parts.Legend(marks)]


def _bin(one: Mapping[str, Any]) -> tuple[str, ...]:
    """A bin that stands out."""
    ends = ("", "") if one["axis"] in WHOLE else (edge_text(one["axis"], one[end]) for end in ("from", "to"))
    z = f"{one['z']:+.1f}".replace("-", "−")
    return statistic_name(one["statistic"]), axis_name(one["axis"]), *ends, z


def _confined(searched: Sequence[str], effects: Sequence[str] | None) -> list[parts.Part]:
    """A warning where only some effects were searched for."""
    if effects is None:
        return []
    these = "these effects were" if len(searched) > 1 else "one effect was"
    names = ", ".join(effect_name(name) for name in searched)
    text = f"Only {these} searched for: {names}. Others of the catalogue may explain as much."
    return [parts.Alert(text)]


def _limits(answer: Mapping[str, Any]) -> list[parts.Part]:
    """Warnings where parts of the picture were said to be no change of the scene, or the search ended early."""
    found: list[parts.Part] = []
    if names := answer.get("ignored_parts", []):
        text = f"Parts of the picture that may have changed were ignored: {', '.join(names)}. The search counts them."
        found.append(parts.Alert(text))
    asked = answer.get("max_frames", {})
    if asked.get("reached", False):
        text = f"The search stopped at its limit of {asked['limit']:,} simulated frames."
        found.append(parts.Alert(f"{text} Effects that were not tried may explain as much, or something besides."))
    return found


def _map(report: GapReport) -> Section:
    text = """Root mean square departure over the bins of each statistic, in units of the simulation's scatter: about 1
        is chance, a dash has too little to count. Neighbouring rows look at the same returns along other axes."""
    assert report.residuals is not None
    alt = "Departure of every statistic in every condition"
    picture = parts.Figure(residual_uri(report.residuals), alt, look="chart map")
    return Section("Every statistic, every condition", [parts.Paragraph(text), picture], id="map")


# ---- held-out conditions, the record and the model -------------------------------------------------------------------


def _held_out(study: Study, answer: Mapping[str, Any]) -> Section:
    gap = {name: number_text(answer["gap"][name]) for name in ("before", "after", "floor")}
    low, high = (number_text(end) for end in answer["gap"]["interval_after"])
    if answer["verdict"] == "none":
        text = "Nothing was added, so before and after are one."
        scores, alt = gap["before"], f"Held-out gap {gap['before']}, floor {gap['floor']}"
    else:
        text = """Conditions that nothing was fitted to, before and after the effect is added. The weather record is
            fitted in both."""
        scores = f"{gap['before']} before and {gap['after']} after (90 % interval {low} to {high})"
        alt = f"Held-out gap before {gap['before']} and after {gap['after']}, floor {gap['floor']}"
    text += f" A simulation that lacks nothing scores the floor, {gap['floor']}; this one {scores}."
    held, fitted = (", ".join(_named(study, answer["conditions"][split])) or "nothing" for split in ("holdout", "fit"))
    picture = gap_uri(answer["gap"], added=answer["verdict"] != "none")
    return Section(
        "Held-out conditions",
        [
            parts.Paragraph(text),
            parts.Figure(picture, alt, look="chart medium"),
            parts.Note(f"Held out: {held}. Fitted: {fitted}."),
        ],
        id="held-out",
    )


def _named(study: Study, conditions: Sequence[str]) -> list[str]:
    """Conditions with their weather, where it is not their name."""
    weather = {one.id: weather_label(one.weather) for one in study.conditions if one.weather is not None}
    return [f"{name} ({weather[name]})" if name in weather else name for name in conditions]


def _record(study: Study, answer: Mapping[str, Any]) -> Section:
    """Fitted shift of the weather record of each condition."""
    text = """A recorded rate or visibility has an error of its own. It is fitted within its stated uncertainty, so that
        it does not pass for an effect."""
    found: list[parts.Part] = [parts.Paragraph(text)]
    by_id = {one.id: one for one in study.conditions}
    rows, far = [], False
    for name, factor in answer["nuisance"]["by_condition"].items():
        one = by_id.get(name)
        sd = 0.0 if one is None else one.rel_sd
        off = math.log(factor) / sd if sd > 0 else math.nan
        far |= abs(off) > FAR_OFF
        rows.append(
            (
                name,
                "" if one is None else weather_label(one.weather),
                f"{100 * sd:.3g} %" if sd > 0 else "not stated",
                _percent(factor),
                parts.Cell(
                    NO_VALUE if math.isnan(off) else f"{off:+.1f}".replace("-", "−"),
                    look="far" if abs(off) > FAR_OFF else "",
                ),
            )
        )
    if not rows:
        found.append(parts.Paragraph("It was not moved."))
        return Section("The weather record", found, id="record")
    heads: parts.Heads = ["Condition", parts.Column("Recorded", "left"), "Stated uncertainty", "Moved by"]
    found.append(parts.Table([*heads, "In its standard deviations"], rows, look="short"))
    rate_factor = _percent(answer["nuisance"]["rate_factor"])
    found.append(
        parts.Note(
            f"""All conditions together, by the precision of their records: {rate_factor} of weather (of rates; for fog
            of one over the visibility)."""
        )
    )
    if far:
        text = """Past two of its standard deviations either the record is wrong, or something acts like more or less
            weather."""
        found.append(parts.Note(text))
    return Section("The weather record", found, id="record")


def _percent(factor: float) -> str:
    """A factor as a change in per cent, with its sign."""
    return f"{100 * (factor - 1):+.1f} %".replace("-", "−")


def _model(answer: Mapping[str, Any]) -> Section:
    file = parts.link("model.yaml")
    if answer["effects"]:
        found: list[parts.Part] = [parts.Code(MODEL)]
    elif answer["verdict"] == "none":
        found = [parts.Paragraph(parts.markup("The model stays as it is; {} adds nothing.", file))]
    else:
        own = parts.markup("""No effect was added: one that does not explain the gap would hide it. An effect of one's
            own is a class with parameters and a place in the chain (<code>torchweather.pipeline.effect.Effect</code>,
            <code>register_effect</code>); the search then tries it with the others.""")
        found = [parts.Paragraph(own)]
    if answer["unknown"] and answer["unknown"]["empirical"]:
        text = "With the empirical stage, for use within its measured range only:"
        found += [parts.Paragraph(text), parts.Code(EMPIRICAL)]
    return Section("Add it to the model" if answer["effects"] else "The model", found, id="add")


def _how_to_read(answer: Mapping[str, Any], sha256: str) -> Section:
    beams = """Beams are compared with the clear frames of their scene and sorted into bins along physical axes. Shares,
        counts and spreads are transformed so that their scatter hardly depends on their size; nothing is compared point
        with point."""
    confidence = parts.markup("""Confidence is the weight of an effect among those that were fitted, after the misfit
        that each leaves. It says nothing of effects that the catalogue does not have: these are what the held-out gap
        and the verdict <em>unknown</em> are for. A name means that the effect acts like this one on these data.""")
    clear = [
        f"""Clear frames of {one["scene"]}, first half against second: p = {one["p_value"]:.2g}; most in
        {one["statistic"]} along {one["axis"]} ({one["z"]:+.1f} times what halves drawn at random differ by)."""
        for one in answer.get("clear_air") or []
    ]
    made = parts.markup(
        "torchweather {} · torch {}, numpy {}, Python {} · seed {} · {} s · study {} · all numbers in {} · "
        "what was added in {}",
        *(__version__, torch.__version__, np.__version__, platform.python_version(), answer["seed"]),
        *(number_text(answer["seconds"]), sha256, parts.link("gap.json"), parts.link("model.yaml")),
    )
    return Section("How to read this page", [parts.Fine(text) for text in (beams, confidence, *clear, made)])
