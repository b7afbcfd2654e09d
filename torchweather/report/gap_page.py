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
from torchweather.gap.places import DEPARTS
from torchweather.gap.study.study import Study
from torchweather.io import atomic_folder
from torchweather.report import parts
from torchweather.report.correlation_figures import MARKS
from torchweather.report.findings import study_alerts, study_section
from torchweather.report.gap_effects import (
    by_statistic,
    deciding_section,
    ranking_section,
    unexplained_parts,
    what_section,
)
from torchweather.report.gap_figures import AFTER, BAND, BEFORE, curve_uri, gap_uri, residual_uri
from torchweather.report.gap_picture import BY_CHANCE, departing, places_uri
from torchweather.report.gap_words import (
    WHOLE,
    along,
    axis_name,
    edge_text,
    effect_name,
    excess_text,
    gap_sentence,
    headline,
    listed,
    probability_text,
    signed_decimal,
    statistic_name,
    verdict_sentence,
)
from torchweather.report.page import write_report
from torchweather.report.report import Report, Section
from torchweather.report.tables import NO_VALUE, number_text, signed_text

__all__ = ["gap_page", "write_gap"]

GLYPHS = "●■▲◆▼✚"  # of MARKS
COMPARED = {
    "lidar": "Beams are compared with the clear frames of their scene and sorted into bins along physical axes.",
    "camera": "Pixels are compared with the clear frames of their scene and sorted into bins along physical axes.",
    "radar": "Targets are compared with the clear frames of their scene and sorted into bins along physical axes.",
    "link": "Attenuations of links are sorted by length, frequency and time since rain.",
}
# Past so many of its own standard deviations a record is called wrong.
FAR_OFF = 2.0
# The transform of each kind of study; links have none.
CODE = {
    "lidar": ("LidarWeather", "weather, sensor"),
    "camera": ("BayerWeather", "weather, sensor"),
    "radar": ("RadarAttenuation", "weather, sensor"),
}
MODEL = """from torchweather import {0}
from torchweather.gap.gap_report import read_model

repaired = {0}({1}, effects=read_model("model.yaml"))"""
EMPIRICAL = """from torchweather import {0}
from torchweather.gap.gap_report import read_model

copied = read_model("model.yaml").apply({0}({1}), empirical=True)"""


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
    where = [
        *_picture(study, report, answer),
        *_where(study, report, answer),
        *_confined(searched, effects),
        *_limits(answer),
    ]
    sections = [Section("Where", where)]
    if not nothing:
        sections += [what_section(answer), ranking_section(answer, report.responses)]
    sections += [_left(study, report, answer)]
    if not nothing:
        sections.append(deciding_section(answer, searched, study))
    sections += [_record(study, answer), _model(study, answer), study_section(findings)]
    gap = {name: number_text(answer["gap"][name]) for name in ("before", "after", "floor")}
    fitted, held = (len(answer["conditions"][split]) for split in ("fit", "holdout"))
    facts = [
        ("chance if nothing were missing", probability_text(answer["p_value"])),
        ("held-out departure, standard deviations", gap["before"])
        if nothing
        else ("held-out departure, before → after", f"{gap['before']} → {gap['after']}"),
        ("a perfect model", gap["floor"]),
    ]
    left = "" if nothing else excess_text(answer["gap"])
    facts += [("share of the excess that is left", left)] if left else []
    facts.append(("conditions, fitted and held out", f"{fitted} and {held}"))
    return Report(
        title=headline(answer),
        head=f"torchweather: {headline(answer)}",
        lead=[
            parts.Verdict(verdict_sentence(answer)),
            *study_alerts(findings),
            *_record_alert(study, answer),
            parts.Facts(facts),
        ],
        sections=sections,
        footer=_how_to_read(study, answer, report.study_sha256),
    )


# ---- where -----------------------------------------------------------------------------------------------------------


def _picture(study: Study, report: GapReport, answer: Mapping[str, Any]) -> list[parts.Part]:
    """The frame or scan of the condition that departs most, its departing places in colour."""
    places = report.places
    if places is None:
        return []
    weather = {one.id: weather_label(one.weather) for one in study.conditions}
    name = f"{places.condition} ({weather[places.condition]})" if weather.get(places.condition) else places.condition
    before, of = departing(places, places.before)
    by_chance = f"about {round(BY_CHANCE * of)}" if BY_CHANCE * of >= 1 else "one or none"
    text = f"""{places.values.quantity.capitalize()}, {places.values.unit}, in the condition that departs most, {name}:
        mean of what was measured less the mean of what was simulated. A place is coloured where the two are more than
        {DEPARTS:g} standard deviations of chance apart: {before} of {of}. By chance alone it would be {by_chance}."""
    if before <= max(1.0, BY_CHANCE * of) and answer["verdict"] != "none":
        least = number_text(DEPARTS * float(np.nanmedian(places.chance)))
        text += f""" With {places.frames} frames a single place stands out only where it departs by {least}
            {places.values.unit} or more, at the median of the places. The curves below add many places up: they show
            less."""
    alt = f"{places.values.quantity}, measured less simulated, at {of} places of {places.condition}"
    return [parts.Paragraph(text), parts.Figure(places_uri(places), alt, look="wide")]


def _where(study: Study, report: GapReport, answer: Mapping[str, Any]) -> list[parts.Part]:
    """Curves of the statistics that depart most, and the bins that stand out."""
    text = """The statistics that depart most, measured less simulated. Above: in their own unit. Below: in standard
        deviations of chance, which are how far one simulation departs from another at the measured number of frames.
        Inside the grey band, one standard deviation either side, there is nothing to explain."""
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
        heads += [parts.Column("Mean departure", "left"), "Standard deviations"]
        found += [
            parts.Heading("The bins that depart most, all conditions together"),
            parts.Table(heads, [_bin(one) for one in answer["where"]]),
        ]
    return found


def _legends(study: Study, curves: Sequence[Curve], answer: Mapping[str, Any]) -> list[parts.Legend]:
    """Colours of before and after, and the mark of each condition."""
    keys = [parts.Key("the simulation as it is", BEFORE)]
    if any(one.after is not None for one in curves):
        best = "with the best that the catalogue has" if answer["verdict"] == "unknown" else "with what was found"
        keys.append(parts.Key(best, AFTER, look="open"))
    keys.append(parts.Key("one standard deviation of chance", BAND, look="band"))
    weather = {one.id: weather_label(one.weather) for one in study.conditions}
    marks = [
        parts.Key(f"{name}: {weather[name]}" if weather.get(name) else name, glyph=GLYPHS[number % len(MARKS)])
        for number, name in enumerate(dict.fromkeys(one.condition for one in curves))
    ]
    return [parts.Legend(keys, chart=True), parts.Legend(marks)]


def _bin(one: Mapping[str, Any]) -> tuple[str, ...]:
    """A bin that stands out."""
    ends = ("", "") if one["axis"] in WHOLE else (edge_text(one["axis"], one[end]) for end in ("from", "to"))
    departure = f"{signed_text(one['departure'], plus=True)} {one['unit']}" if "departure" in one else NO_VALUE
    return statistic_name(one["statistic"]), axis_name(one["axis"]), *ends, departure, signed_decimal(one["z"])


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


# ---- what remains --------------------------------------------------------------------------------------------------


def _left(study: Study, report: GapReport, answer: Mapping[str, Any]) -> Section:
    """Held-out conditions, what no effect explains, and the map of all statistics."""
    title = "Held-out conditions" if answer["verdict"] == "none" else "What remains"
    found = _held_out(study, answer)
    if answer["unknown"]:
        found += unexplained_parts(answer["unknown"], found=bool(answer["effects"]))
    elif answer["verdict"] == "unknown":
        text = """No single bin stands out once the best effect is fitted: the departure is spread over many
            statistics."""
        found.append(parts.Paragraph(text))
    if report.residuals is not None:
        text = """Root mean square departure over the bins of each statistic, in standard deviations of chance: about 1
            is chance, a dash has too little to count. The shade grows with the logarithm, from 1 to 30. At the right is
            the bin that departs most in the simulation as it is, in the unit of the statistic, the mean of all
            conditions. Neighbouring rows look at the same returns along other axes."""
        picture = parts.Figure(
            residual_uri(report.residuals), "Departure of every statistic in every condition", look="chart map"
        )
        found += [parts.Heading("Every statistic, every condition", id="map"), parts.Paragraph(text), picture]
    return Section(title, found, id="held-out")


def _held_out(study: Study, answer: Mapping[str, Any]) -> list[parts.Part]:
    gap = {name: number_text(answer["gap"][name]) for name in ("before", "after", "floor")}
    low, high = (number_text(end) for end in answer["gap"]["interval_after"])
    text = """Nothing was fitted to the held-out conditions but their weather record. Their departure is a root mean
        square over all statistics, in standard deviations of chance. """
    alt = f"Held-out departure before {gap['before']} and after {gap['after']}, a perfect model {gap['floor']}"
    if answer["verdict"] == "none":
        text += "Nothing was added, so before and after are one. "
        alt = f"Held-out departure {gap['before']}, a perfect model {gap['floor']}"
    text += gap_sentence(answer)
    if answer["verdict"] != "none":
        text += f" The 90 % interval of the departure after is {low} to {high}."
    held, fitted = (", ".join(_named(study, answer["conditions"][split])) or "nothing" for split in ("holdout", "fit"))
    picture = gap_uri(answer["gap"], added=answer["verdict"] != "none")
    return [
        parts.Paragraph(text),
        parts.Figure(picture, alt, look="chart medium"),
        parts.Note(f"Held out: {held}. Fitted: {fitted}."),
    ]


def _named(study: Study, conditions: Sequence[str]) -> list[str]:
    """Conditions with their weather, where it is not their name."""
    weather = {one.id: weather_label(one.weather) for one in study.conditions if one.weather is not None}
    return [f"{name} ({weather[name]})" if name in weather else name for name in conditions]


# ---- the record and the model ----------------------------------------------------------------------------------------


def _moved(study: Study, answer: Mapping[str, Any]) -> list[tuple[str, str, float, float, float]]:
    """Of each condition its name, weather, stated uncertainty, fitted factor, and that in standard deviations."""
    by_id = {one.id: one for one in study.conditions}
    rows = []
    for name, factor in answer["nuisance"]["by_condition"].items():
        one = by_id.get(name)
        sd = 0.0 if one is None else one.rel_sd
        off = math.log(factor) / sd if sd > 0 else math.nan
        rows.append((name, "" if one is None else weather_label(one.weather), sd, factor, off))
    return rows


def _record_alert(study: Study, answer: Mapping[str, Any]) -> list[parts.Part]:
    """A warning beside the headline where the record had to move by more than it states."""
    far = [one for one in _moved(study, answer) if abs(one[4]) > FAR_OFF]
    if not far:
        return []
    each = [
        f"{name} by {_percent(factor)} ({abs(off):.1f} of its standard deviations)" for name, _, _, factor, off in far
    ]
    text = f"""The fit moved {listed(each)}. Either the record is wrong by more than it states, or something acts like
        more or less weather."""
    return [parts.Alert(text, "The weather record is in doubt.")]


def _record(study: Study, answer: Mapping[str, Any]) -> Section:
    """Fitted shift of the weather record of each condition."""
    text = """A recorded rate or visibility has an error of its own. It is fitted within its stated uncertainty, so that
        it does not pass for an effect."""
    found: list[parts.Part] = [parts.Paragraph(text)]
    rows = [
        (
            name,
            weather,
            f"{100 * sd:.3g} %" if sd > 0 else "not stated",
            _percent(factor),
            parts.Cell(NO_VALUE if math.isnan(off) else signed_decimal(off), look="far" if abs(off) > FAR_OFF else ""),
        )
        for name, weather, sd, factor, off in _moved(study, answer)
    ]
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
    return Section("The weather record", found, id="record")


def _percent(factor: float) -> str:
    """A factor as a change in per cent, with its sign."""
    return f"{signed_decimal(100 * (factor - 1))} %"


def _model(study: Study, answer: Mapping[str, Any]) -> Section:
    file = parts.link("model.yaml")
    code = CODE.get(study.kind)
    if answer["effects"] and code:
        moved = """<code>weather</code> is that of the frame to be made. On the recorded rates and visibilities of this
            study the effects were fitted together with {}."""
        record = parts.link("#record", "the shifts of the weather record")
        found: list[parts.Part] = [parts.Code(MODEL.format(*code)), parts.Note(parts.markup(moved, record))]
    elif answer["effects"]:
        found = [parts.Paragraph(parts.markup("The effects with their parameters are in {}.", file))]
    elif answer["verdict"] == "none":
        found = [parts.Paragraph(parts.markup("The model stays as it is; {} adds nothing.", file))]
    else:
        own = parts.markup("""No effect was added: one that does not explain the departure would hide it. An effect of
            one's own is a class with parameters and a place in the chain
            (<code>torchweather.pipeline.effect.Effect</code>, <code>register_effect</code>); the search then tries it
            with the others.""")
        found = [parts.Paragraph(own)]
    if answer["unknown"] and answer["unknown"]["empirical"] and code:
        text = "With the empirical stage, for use within its measured range only:"
        found += [parts.Paragraph(text), parts.Code(EMPIRICAL.format(*code))]
    return Section("Add it to the model" if answer["effects"] else "The model", found, id="add")


def _how_to_read(study: Study, answer: Mapping[str, Any], sha256: str) -> Section:
    missing = """Missing is what acts in the measured frames and not in the simulated ones. A departure is measured less
        simulated. Its standard deviation of chance is that of the difference between two simulations with as many
        frames as were measured: a departure of 1 is usual where nothing is missing."""
    compared = f"""{COMPARED[study.kind]} Shares, counts and spreads are transformed so that their standard deviation
        hardly depends on their size; nothing is compared point with point."""
    confidence = parts.markup("""The posterior of an effect is its probability among those that were fitted, all equally
        likely before. Confidence is that posterior times the share of right names of such verdicts in development
        studies. It covers no effect that the catalogue does not have: these are what the held-out departure and the
        verdict <em>unknown</em> are for. A name means that the effect acts like this one on these data.""")
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
    return Section(
        "How to read this page", [parts.Fine(text) for text in (missing, compared, confidence, *clear, made)]
    )
