"""The sweep's folder: its table, its summary, and a page with the curves, the counts and what explains each miss."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from torchweather import __version__
from torchweather.camera.depth import EXACT, least_sure
from torchweather.core.errors import InputValueError, check_one_of
from torchweather.evaluation.sweep import Level, Series, Subject, columns_of, judged, samples, series_of
from torchweather.evaluation.sweep.misses import explain_miss
from torchweather.evaluation.sweep.run import plan
from torchweather.evaluation.sweep.trends import BY_RANKS, Judgement, SeriesTrends
from torchweather.io import atomic_folder, write_table
from torchweather.report import parts
from torchweather.report.machine import machine, machine_text
from torchweather.report.page import storable, write_json, write_report
from torchweather.report.report import Report, Section
from torchweather.report.sweep_figures import ACROSS, AXES, NAMES, score_uri
from torchweather.report.sweep_pictures import DEVELOPED, flat_pictures, legend, level_pictures
from torchweather.report.tables import NO_VALUE

__all__ = ["TABLES", "sweep_page", "write_sweep"]

TABLES = ("csv", "parquet")
"""Formats of the table."""

SMALL, LARGE = 1e-4, 1e4  # numbers beyond are written with an exponent, or as whole ones
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
        raise InputValueError(f"write_sweep: expected subjects of one sensor; got {', '.join(sorted(kinds))}.")
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
            "depth": least_sure(*(getattr(subject, "depth_confidence", "") or EXACT for subject in subjects)),
            "machine": machine(),
            "series": records,
            "seconds": round(time.perf_counter() - started, 3),
        }
        write_json(staging / "summary.json", summary)
        page = sweep_page(summary, series, trends, subjects)
        write_report(page, staging / "index.html")
    return summary


# ---- numbers --------------------------------------------------------------------------------------------------------


def _record(series: Series, trends: SeriesTrends) -> dict[str, Any]:
    """A series for the summary."""
    first = series.levels[0]
    record: dict[str, Any] = {
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
        "facts": {name: values.mean(1).tolist() for name, values in series.facts.items()},
        "facts_clear": {name: float(value) for name, value in series.clear.items()},
        "times_s": {"render_s": round(series.render_s, 6), "score_s": round(series.score_s, 6)},
    }
    found: dict[str, Any] = storable(record)
    return found


def _metric(series: Series, judgement: Judgement) -> dict[str, Any]:
    scores = series.scores[judgement.metric]
    # The deviation of an infinite score is no number.
    finite = np.isfinite(scores).all(1) & (scores.shape[1] > 1)
    spread = [float(row.std(ddof=1)) if ok else math.nan for row, ok in zip(scores, finite, strict=True)]
    return {
        "better": series.directions[judgement.metric],
        "mean": scores.mean(1).tolist(),
        "std": spread,
        "follows": judgement.follows,
        "verdict": judgement.trend.verdict,
        "confidence": judgement.trend.confidence,
        "page_p": judgement.page_p,
        "why": [] if judgement.follows else explain_miss(series, judgement),
    }


# ---- the page -------------------------------------------------------------------------------------------------------

FACTS = {
    "mean": "Mean of the frame (linear light, 1 is white)",
    "contrast": "Its standard deviation",
    "points": "Points",
    "pair_distance_m": "Mean distance between two points, m",
    "range_m": "Median range, m",
}


def sweep_page(
    summary: Mapping[str, Any], series: Sequence[Series], trends: Sequence[SeriesTrends], subjects: Sequence[Subject]
) -> Report:
    """The page of a sweep.

    Args:
        summary: what ``summary.json`` holds.
        series, trends: of the sweep, and what was judged of each.
        subjects: that were swept.
    """
    kind, names, by_name = SENSORS[subjects[0].sensor], summary["subjects"], {one.name: one for one in subjects}
    lead = """The same clear data in weather of rising severity, scored against the clear data. A score follows the
        weather if its mean gets worse at every step."""
    facts = [
        ("version", summary["torchweather"]),
        ("sensor", summary["sensor"]),
        ("subjects", f"{len(names)}" if len(names) > 3 else ", ".join(names)),
        ("seeds", ", ".join(map(str, summary["seeds"]))),
        ("machine", machine_text(summary["machine"])),
    ]
    read = parts.markup("""How to read it. Over the levels of one weather a seed keeps its random field: the storm
        stays, the rate rises. The noise of the sensor is in the clear and in the weathered data alike. Times are
        means of one sample on this machine, the first of its kind included. Scores are defined in the documentation
        under Metrics. A score that follows sees the weather; whether a detector suffers is another question
        (<code>torchweather correlate</code>).""")
    made = parts.markup(
        "torchweather {} · {:.0f} s in all · every score in {}, all numbers of this page in {}",
        *(summary["torchweather"], summary["seconds"], parts.link(summary["table"]), parts.link("summary.json")),
    )
    sections = [
        _section(number, record, one, judged_, by_name[one.subjects[0]])
        for number, (record, one, judged_) in enumerate(zip(summary["series"], series, trends, strict=True), start=1)
    ]
    return Report(
        title=f"Scores of {kind} against weather" + (": depth guessed" if summary["depth"] == "guessed" else ""),
        head=f"torchweather: scores of {kind} against weather",
        lead=[parts.Paragraph(lead, "lead"), parts.Facts(facts), *map(parts.Note, summary["notes"])],
        sections=[Section("", [_overview(summary["series"], series)]), *sections],
        footer=Section("", [parts.Fine(read), parts.Fine(made)]),
    )


def _overview(records: Sequence[Mapping[str, Any]], series: Sequence[Series]) -> parts.Table:
    scenes = len({one.scene for one in series})
    rows = []
    for number, (record, one) in enumerate(zip(records, series, strict=True), start=1):
        times, title = record["times_s"], parts.link(f"#part-{number}", _title(one))
        rows.append(
            (
                parts.markup("{}, {}", title, one.scene) if scenes > 1 else title,
                parts.Cell(
                    f"{record['expected']} of {record['out_of']}",
                    look="no" if any(not metric["follows"] for metric in record["metrics"].values()) else "",
                ),
                NO_VALUE if record["interval"] is None else "{} to {}".format(*record["interval"]),
                *(f"{times['render_s']:.2f}", f"{times['score_s']:.2f}"),
            )
        )
    heads = ["Weather", "Scores that follow", "95 % of resamples", "Rendering, s", "Scoring, s"]
    return parts.Table(heads, rows, look="half")


def _section(number: int, record: Mapping[str, Any], series: Series, trends: SeriesTrends, subject: Subject) -> Section:
    """A series: its count, its pictures, its curves, and why scores do not follow."""
    misses = [
        (NAMES.get(name, name).split(",")[0], " ".join(record["metrics"][name]["why"]))
        for name, one in trends.metrics.items()
        if not one.follows
    ]
    drawn_from = "frames and seeds" if len(series.subjects) > 1 else "the seeds"
    count = parts.markup("<strong>{} of {}</strong> scores follow the weather.", record["expected"], record["out_of"])
    keys = legend(subject)
    small = f"clear to heaviest, seed {series.seeds[0]}" + DEVELOPED.get(subject.sensor, "")
    axis = f"line: mean; band: lowest to highest of {drawn_from}; heavier to the right"
    if misses:
        axis = parts.markup('{}; <span class="no">orange: does not follow</span>', axis)
    charts = [
        parts.Figure(
            score_uri(series, name, follows=one.follows),
            f"{NAMES.get(name, name)} against {AXES[series.levels[0].knob]}",
            look="chart",
        )
        for name, one in trends.metrics.items()
    ]
    found: list[parts.Part] = [
        parts.Paragraph(count, "count"),
        parts.Note(_chance(record, series, trends, drawn_from)),
        parts.Heading(series.subjects[0], small),
        *([parts.Legend(keys)] if keys else []),
        parts.Pictures(level_pictures(series, subject), across=ACROSS[subject.sensor], look="keep"),
        *flat_pictures(series, subject),
        parts.Heading("Scores", axis),
        parts.Pictures(charts, across=3 if len(charts) <= 6 else 4, look="keep"),
    ]
    if misses:
        scores = "one score does" if len(misses) == 1 else f"{len(misses)} scores do"
        found += [parts.Heading(f"Why {scores} not follow"), parts.Facts(misses, "reasons")]
    found.append(_numbers(record, series, trends))
    return Section(f"{_title(series)}, {series.scene}", found, id=f"part-{number}")


def _title(series: Series) -> str:
    level = series.levels[0]
    values = ", ".join(f"{one.value:g}" for one in series.levels)
    more = level.name.removeprefix(level.kind).lstrip(":")
    return f"{level.kind.capitalize()} {values}\N{NO-BREAK SPACE}{level.unit}" + (f" ({more})" if more else "")


def _chance(record: Mapping[str, Any], series: Series, trends: SeriesTrends, drawn_from: str) -> str:
    """Bootstrap interval of the count of scores that follow, and the count expected by chance."""
    text = ""
    if record["interval"] is not None:
        low, high = record["interval"]
        text = f"In 95 % of bootstrap samples of {drawn_from}, {low} to {high} do. "
    flip = ": a coin flip" if len(series.levels) == 2 else ""
    text += f"A score in random order would follow with a probability of {record['chance']:.2g}{flip}."
    by_ranks = ", ".join(NAMES[name].split(",")[0] for name in trends.metrics if name in BY_RANKS)
    if by_ranks and len(series.seeds) > 1:
        text += f""" {by_ranks} follows too if the seeds agree in ranking the levels (Page's test, 5 %): it is the
            distance of a single point."""
    return text


def _numbers(record: Mapping[str, Any], series: Series, trends: SeriesTrends) -> parts.Table:
    """Means of the scores, and of the data themselves."""
    rows: list[Sequence[parts.Cell | str] | str] = []
    for name, one in trends.metrics.items():
        metric = record["metrics"][name]
        arrow = "↑" if metric["better"] == "up" else "↓"
        cells = [
            parts.Cell(_text(mean), () if std == "nan" else [f"± {std:.2g}"])
            for mean, std in zip(metric["mean"], metric["std"], strict=True)
        ]
        verdict = parts.Cell(_verdict(one), look="" if one.follows else "no")
        rows.append([f"{NAMES.get(name, name)} {arrow}", "", *cells, verdict])
    rows.append("The data themselves")
    for name, values in series.facts.items():
        rows.append([FACTS[name], _text(series.clear[name]), *map(_text, values.mean(1)), ""])
    mean = parts.Column(parts.markup("Mean <small>± standard deviation</small>"))
    levels = [f"{level.value:g} {level.unit}" for level in series.levels]
    return parts.Table([mean, "Clear", *levels, parts.Column("Follows", "left")], rows, look="roomy inline")


def _verdict(judgement: Judgement) -> str:
    if judgement.follows:
        return "yes" if judgement.page_p is None else "yes, by the seeds' ranks"
    words = {"tied": "no: equal levels", "reversed": "no: reversed", "unjudged": "not judged"}
    return words.get(judgement.trend.verdict, "no")


def _text(value: float | str) -> str:
    if isinstance(value, str):
        return value.replace("inf", "∞")
    if not math.isfinite(value):
        return NO_VALUE if math.isnan(value) else "∞"
    if value == 0 or abs(value) < SMALL:
        return "0" if value == 0 else f"{value:.1e}"
    return f"{value:,.0f}".replace(",", " ") if abs(value) >= LARGE else f"{value:.4g}"
