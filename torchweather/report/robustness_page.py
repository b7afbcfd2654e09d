"""The robustness run's folder: its tables, its numbers, its page, and the correlation of scores and performance."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from torchweather.evaluation.robustness import ConditionResult, Declaration, Rates, RobustnessResult
from torchweather.evaluation.robustness.baseline import reference_of
from torchweather.evaluation.robustness.frames import Look
from torchweather.evaluation.robustness.remarks import interval_text, remarks
from torchweather.io import atomic_folder, write_table
from torchweather.report import parts
from torchweather.report.correlation_page import write_correlation
from torchweather.report.page import write_json, write_report
from torchweather.report.report import Report, Section
from torchweather.report.robustness_figures import LEGENDS, look_uri, performance_uri
from torchweather.report.robustness_summary import correlation_of, plain, summary_of, table_of
from torchweather.report.sweep_figures import ACROSS, NAMES
from torchweather.report.tables import NO_VALUE, fixed_text

__all__ = ["robustness_page", "write_robustness"]

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
        written: dict[str, Any] = plain(summary)
        write_json(staging / "robustness.json", written)
        write_report(robustness_page(summary, result, found, declaration, looks), staging / "index.html")
    return written


# ---- the page -------------------------------------------------------------------------------------------------------


def robustness_page(
    summary: Mapping[str, Any], result: RobustnessResult, found: Rates, declaration: Declaration, looks: Sequence[Look]
) -> Report:
    """The page of a robustness run.

    Args:
        summary: what ``robustness.json`` holds, with its notes and correlation.
        result, found: of the run, and its rates.
        declaration: of the detector.
        looks: what the first frame looks like, clear and in every condition.
    """
    measure, groups = result.measure, result.by_weather
    overview: list[parts.Part] = [
        _overview(result, found),
        parts.Pictures(
            [
                parts.Figure(
                    performance_uri(group, result.clear.value, measure), f"{measure} against {name}", look="chart"
                )
                for name, group in groups.items()
            ],
            across=3,
        ),
    ]
    if len(result.clear.by_class) > 1:
        overview.append(_classes(result, declaration))
    if summary["correlation"]:
        file = parts.link("correlation/index.html", f"scores against {measure}")
        text = parts.markup("Which scores of the data go with the detector's performance: {}.", file)
        overview.append(parts.Note(text))
    headline = f", {summary['headline']}" if summary["headline"] else ""
    return Report(
        title=f"{summary['detector']} in the weather{headline}",
        head=f"torchweather: robustness of {summary['detector']}"
        + (f" ({summary['headline']})" if summary["headline"] else ""),
        lead=_lead(summary, result, found),
        sections=[
            Section("", overview),
            *(
                Section(_title(name), _weather(name, group, summary, result, declaration, looks), id=f"part-{number}")
                for number, (name, group) in enumerate(groups.items(), start=1)
            ),
        ],
        footer=_how_to_read(summary, result),
    )


def _lead(summary: Mapping[str, Any], result: RobustnessResult, found: Rates) -> list[parts.Part]:
    """The answer in a sentence and three numbers, and what was run."""
    clear, interval = fixed_text(result.clear.value), interval_text(result.clear_interval)
    text = f"{result.measure} is {clear} in clear air{f' (95 % interval {interval})' if interval else ''}."
    there = [each for each in result.conditions if not math.isnan(each.value)]
    if there:
        worst = min(there, key=lambda each: each.value)
        level = worst.condition.text
        text += f" It is lowest in {level[:1].lower()}{level[1:]}: {fixed_text(worst.value)}."
    if summary["reference"] == "clear":
        relative = "the detector's own error in clear air"
    else:
        relative = f"the baseline, {summary['baseline']}"
    rate = "resilience rate (mRR): share of it that the weather leaves, mean over weathers"
    big = [
        (f"{result.measure} in clear air{f'; {interval} over the frames, 95 %' if interval else ''}", clear),
        (rate, _percent(found.mean_resilience)),
        (f"corruption error (mCE), relative to {relative}", fixed_text(found.mean_corruption_error)),
    ]
    facts = [
        ("model", summary["model"]),
        ("conditions", f"{summary['recipe']}, {len(summary['conditions'])}"),
        ("sensor", summary["sensor"]),
        ("frames", f"{len(summary['frames'])}"),
        *([("depth", summary["depth"])] if summary["depth"] else []),
        ("storms a frame", f"{len(result.conditions[0].by_seed)}, seed {summary['seed']}"),
        ("version", summary["torchweather"]),
    ]
    notes = map(parts.Note, summary["notes"])
    return [parts.Paragraph(text, "lead"), parts.Facts(big, "big"), parts.Facts(facts), *notes]


def _overview(result: RobustnessResult, found: Rates) -> parts.Table:
    """Performance by weather and severity, and the rates."""
    groups = result.by_weather
    most = max(len(group) for group in groups.values())
    clear = parts.Cell(fixed_text(result.clear.value), [interval_text(result.clear_interval)])
    rows: list[Sequence[parts.Cell | str]] = []
    for number, (name, group) in enumerate(groups.items(), start=1):
        cells = [
            parts.Cell(
                fixed_text(each.value),
                [interval_text(each.interval), f"{each.condition.value:g} {each.condition.unit}"],
                shade=_shade(each.value, result.clear.value),
            )
            for each in group
        ]
        rates = (_percent(found.resilience[name]), fixed_text(found.corruption_error[name]))
        title = parts.link(f"#part-{number}", _title(name))
        rows.append(
            [title, clear, *cells, *[""] * (most - len(group)), *(parts.Cell(one, look="strong") for one in rates)]
        )
    means = (_percent(found.mean_resilience), fixed_text(found.mean_corruption_error))
    rows.append(["Mean", *[""] * (most + 1), *(parts.Cell(one, look="strong") for one in means)])
    severities = ["Severity 1", *(f"{number}" for number in range(2, most + 1))]
    return parts.Table([result.measure, "Clear", *severities, "Resilience", "Corruption error"], rows, look="half")


def _title(name: str) -> str:
    return f"{name[:1].upper()}{name[1:]}"


def _classes(result: RobustnessResult, declaration: Declaration) -> parts.Table:
    rows: list[Sequence[parts.Cell | str]] = [
        (
            name,
            f"{result.truths[name]:,}".replace(",", " "),
            parts.Cell(fixed_text(clear), [interval_text(result.clear_class_intervals.get(name))]),
            *(
                fixed_text(float(np.mean([each.by_class.get(name, math.nan) for each in group])))
                for group in result.by_weather.values()
            ),
        )
        for name, clear in result.clear.by_class.items()
        if name in result.truths
    ]
    weathers = (f"{_title(name)}, mean" for name in result.by_weather)
    true = "Boxes" if declaration.task == "boxes" else "True"
    return parts.Table([f"{result.measure} by class", true, "Clear", *weathers], rows, look="half")


def _weather(
    name: str,
    group: Sequence[ConditionResult],
    summary: Mapping[str, Any],
    result: RobustnessResult,
    declaration: Declaration,
    looks: Sequence[Look],
) -> list[parts.Part]:
    """One weather: the first frame as the detector gets it, and the scores of the data."""
    threshold = None if result.operating is None else result.operating.threshold
    keys = [
        parts.Key(text.format(threshold="" if threshold is None else f"{threshold:.2f}"), colour)
        for colour, text in LEGENDS[declaration.task]
    ]
    first = summary["frames"][0]
    figures = []
    for look in looks:
        if look.condition is None or look.condition.name == name:
            label = "Clear" if look.condition is None else look.condition.text
            figures.append(parts.Figure(look_uri(look, threshold or 0.0), f"{first}, {label}", caption=label))
    shown: list[parts.Part] = [
        parts.Legend(keys),
        parts.Heading(f"{first}", "as the detector gets it, clear to heaviest, one storm"),
        parts.Pictures(figures, across=ACROSS[declaration.sensor], look="keep"),
    ]
    rows = list(_scores(summary, name))
    if rows:
        levels = [f"{each.condition.value:g} {each.condition.unit}" for each in group]
        heads = ["Score of the data, mean", *levels, f"rho to {result.measure}, all weathers"]
        shown.append(parts.Table(heads, rows, look="half"))
    return shown


def _scores(summary: Mapping[str, Any], weather: str) -> Iterator[Sequence[str]]:
    conditions = [each for each in summary["conditions"] if each["weather"] == weather]
    rho = {each["metric"]: each["spearman"] for each in summary["correlation"] or []}
    for metric in conditions[0]["scores"]:
        known = metric in rho and not isinstance(rho[metric], str)
        cells = (fixed_text(each["scores"][metric], 3) for each in conditions)
        yield [NAMES.get(metric, metric), *cells, fixed_text(rho[metric]) if known else NO_VALUE]


def _shade(value: float, clear: float) -> float:
    """Opacity of a cell: the share of the clear performance that is lost."""
    return 0.0 if math.isnan(value) or not clear > 0 else round(min(max(1 - value / clear, 0.0), 1.0) * 0.55, 3)


def _percent(value: float) -> str:
    return NO_VALUE if math.isnan(value) else f"{100 * value:.0f} %"


def _how_to_read(summary: Mapping[str, Any], result: RobustnessResult) -> Section:
    measure, boxes, own = result.measure, summary["decoder"] == "boxes", summary["reference"] == "clear"
    hit = f"; a box is a hit from an overlap of {', '.join(map(str, summary['thresholds']))} on" if boxes else ""
    performance = [f"{measure}: {MEANINGS[measure]}{hit}."]
    if not boxes:
        performance.append(
            """Objects to which the truth gives no class of the detector are not judged. Of a cloud, points that the
            weather brought belong to no class, so a class predicted there is a false alarm; points that it took are
            gone, and a class of which it took all has 0."""
        )
    if result.resamples:
        performance.append(
            f"""Intervals: 95 % percentiles of {result.resamples} draws of the frames with replacement (bootstrap, seed
            {summary["seed"]}); the same draws in clear air and in all conditions. They are about these frames' choice,
            not about another place or camera."""
        )
    point = result.operating
    if point is not None:
        declared = point.origin == "declared"
        performance.append(
            parts.markup(
                """Pictures show boxes from a score of {:.2f} on: {}. Regions to be ignored (<code>iscrowd</code>)
                follow COCO: a box of which they cover the share that makes a hit is neither right nor false.""",
                point.threshold,
                "declared as the operating threshold" if declared else "the score of maximum F1 on the clear frames",
            )
        )
    performance.append(
        "Over the severities of a weather a frame keeps its storm: the field stays, the weather gets heavier."
    )
    rate = """Performance in the weather over that in clear air, mean over the severities (Kong et al. 2023, Robo3D);
        mRR is the mean over weathers. 100 %: the weather does nothing."""
    over = "the detector in clear air: 1 is a detector that the weather does not touch"
    after = ", whose reference is a baseline detector: --baseline" if own else ""
    error = f"""Error 1 − {measure}, summed over the severities, over the same sum of
        {over if own else "the baseline: below 1 is better than it"} (after Hendrycks and Dietterich 2019{after}); mCE
        is the mean over weathers."""
    files = parts.markup(
        "torchweather {} · all numbers in {}, {} and {}",
        summary["torchweather"],
        *map(parts.link, ("robustness.json", "robustness.csv", "performance.csv")),
    )
    columns = {"Performance": performance, "Resilience rate": [rate], "Corruption error": [error]}
    lists = parts.Columns([(title, [parts.Listing(texts)]) for title, texts in columns.items()])
    return Section("How to read it", [lists, parts.Fine(files)])
