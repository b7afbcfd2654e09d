"""The correlation's folder: its numbers, its conditions, and a page with the ranking and the pictures."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from torchweather import __version__
from torchweather.io import atomic_folder, write_table
from torchweather.metrics.coefficients import Coefficient, abs_interval
from torchweather.metrics.correlation import Correlation, MetricCorrelation
from torchweather.metrics.d34_claim import D34_CLAIM
from torchweather.report import parts
from torchweather.report.correlation_figures import MARKS, metric_name, ranking_uri, scatter_uri, weather_colours
from torchweather.report.page import storable, write_json, write_report
from torchweather.report.report import Report, Section
from torchweather.report.tables import NO_VALUE, fixed_text

__all__ = ["correlation_page", "correlation_summary", "write_correlation"]

GLYPHS = dict(zip(MARKS, "●■▲◆▼✚", strict=True))
SURE = 0.05  # p-value from which on a partial correlation is set in bold
FEW = 4  # names that a sentence can hold
VERDICTS = ("agrees", "contradicts", "cannot be judged")


def write_correlation(
    out_dir: Path, found: Correlation, *, performance: str = "performance", notes: tuple[str, ...] = ()
) -> dict[str, Any]:
    """Write what was found.

    Args:
        out_dir: gets ``correlation.json``, ``conditions.csv`` and ``index.html`` (self-contained). What it held before
            stays, unless it has the same name. Nothing is written when anything fails.
        found: by ``correlate``.
        performance: what the performance is, for the axes.
        notes: what a reader must know of the detector and the data.

    Returns:
        What ``correlation.json`` holds. Numbers that are not finite are the texts ``inf``, ``-inf`` and ``nan``.
    """
    summary = correlation_summary(found, performance=performance, notes=notes)
    with atomic_folder(Path(out_dir)) as staging:
        write_table(staging / "conditions.csv", found.to_dict()["table"])
        write_json(staging / "correlation.json", summary)
        write_report(correlation_page(found, summary), staging / "index.html")
    return summary


def correlation_summary(
    found: Correlation, *, performance: str = "performance", notes: tuple[str, ...] = ()
) -> dict[str, Any]:
    """All numbers, as JSON can hold them."""
    summary: dict[str, Any] = storable(
        {
            "torchweather": __version__,
            "performance": performance,
            "notes": list(notes),
            **found.to_dict(),
            "d34_claim": {
                "place": D34_CLAIM.place,
                "text": D34_CLAIM.text,
                "not_high": list(D34_CLAIM.not_high),
                "highly": found.highly,
                **{verdict.replace(" ", "_"): _count(found, verdict) for verdict in VERDICTS},
                "metrics": found.to_dict()["claim"],
            },
        }
    )
    del summary["claim"], summary["highly"]
    return summary


def _count(found: Correlation, verdict: str) -> int:
    return sum(each.verdict == verdict for each in found.claim)


# ---- the page ------------------------------------------------------------------------------------------------------


def correlation_page(found: Correlation, summary: Mapping[str, Any]) -> Report:
    """The page of a correlation.

    Args:
        found: by ``correlate``.
        summary: of ``correlation_summary``.
    """
    what = summary["performance"]
    ranked = [each for each in found.metrics if each.rank is not None]
    facts = [
        ("version", summary["torchweather"]),
        ("conditions", f"{summary['conditions']}" + (f", by {', '.join(summary['by'])}" if summary["by"] else "")),
        ("bootstrap", f"{summary['resamples']} resamples of conditions, seed {summary['seed']}"),
    ]
    if summary["scored_only"] or summary["performed_only"]:
        left_out = f"{summary['scored_only']} without performance, {summary['performed_only']} without scores"
        facts.append(("left out", left_out))
    claims = [one for one in (_ranking(found, ranked), _claim(found)) if one is not None]
    return Report(
        title=f"What scores say about {what}",
        head=f"torchweather: scores against {what}",
        lead=[
            parts.Paragraph(_lead(found, ranked, summary), "lead"),
            parts.Facts(facts),
            *map(parts.Note, summary["notes"]),
        ],
        sections=[
            *([Section("", [parts.Columns(claims)])] if claims else []),
            Section(f"{what[:1].upper()}{what[1:]} against each score", _charts(found, what)),
            Section("Numbers", [_numbers(found), *(parts.Paragraph(reason, "key") for reason in _reasons(found))]),
        ],
        footer=_how_to_read(found, summary),
    )


def _lead(found: Correlation, ranked: list[MetricCorrelation], summary: Mapping[str, Any]) -> str:
    if not ranked:
        return f"No score has a coefficient over these {summary['conditions']} conditions."
    best, rho = ranked[0], ranked[0].spearman
    shared = [
        metric_name(other.metric, unit=False)
        for other in found.metrics
        if other is not best and other.rank_interval is not None and other.rank_interval[0] == 1
    ]
    text = (
        f"Over {summary['conditions']} conditions of weather {metric_name(best.metric, unit=False)} goes with "
        f"{summary['performance']} most closely: Spearman's rho {_number(rho.value)}, 95\u00a0% interval "
        f"{_interval(rho.low, rho.high)}."
    )
    if shared:
        names = ", ".join(shared) if len(shared) <= FEW else f"{len(shared)} other scores"
        each = "it" if len(shared) == 1 else "each of them"
        text += f" {names} may be as close: the bootstrap puts {each} first, too."
    high = sum(abs_interval(each.spearman)[0] >= found.highly for each in ranked)
    return f"""{text} {high} of {len(ranked)} scores have a rho of {found.highly:g} or more in size over their
        whole interval."""


def _ranking(found: Correlation, ranked: list[MetricCorrelation]) -> tuple[str, list[parts.Part]] | None:
    if not ranked:
        return None
    hollow = [each.metric for each in found.claim if not each.claimed_high]
    key = f"Dashed: {found.highly:g}, from which on a correlation counts as high here."
    if found.claim:
        key += " Hollow: D3.4 says that it does not correlate highly."
    picture = ranking_uri(ranked, found.highly, hollow)
    alt = "Size of Spearman's rho of every score, with intervals"
    return "Ranking", [parts.Figure(picture, alt, look="chart medium"), parts.Paragraph(key, "key")]


def _claim(found: Correlation) -> tuple[str, list[parts.Part]] | None:
    """The claim of D3.4 about each score beside the correlation found."""
    if not found.claim:
        return None
    looks = {"agrees": "left", "contradicts": "left no"}
    rows = [
        (
            metric_name(each.metric, unit=False),
            "high" if each.claimed_high else "not high",
            parts.markup('{} <span class="pale">{}</span>', _number(each.found), _interval(each.low, each.high)),
            parts.Cell(each.verdict, look=looks.get(each.verdict, "pale")),
        )
        for each in found.claim
    ]
    agrees, contradicts, open_ = (_count(found, verdict) for verdict in VERDICTS)
    note = f"""From {D34_CLAIM.place}; it gives no threshold. What is found here agrees for {agrees} of
        {len(found.claim)} scores, contradicts for {contradicts} and cannot be judged for {open_}: a score is judged
        only where its whole interval lies on one side of {found.highly:g}. D3.4's VIF rises with fog, which swapped
        arguments give."""
    heads = [parts.Column(title, "left") for title in ("D3.4 says", "Size of rho, 95 %", "Found")]
    return (
        "The claim of D3.4",
        [parts.Paragraph(D34_CLAIM.text, "says"), parts.Note(note), parts.Table(["Score", *heads], rows, look="tight")],
    )


def _charts(found: Correlation, what: str) -> list[parts.Part]:
    data = found.data
    kinds = data.kind or ["all conditions"] * len(data.performance)
    keys = [
        parts.Key(kind, colour, glyph=GLYPHS[MARKS[number % len(MARKS)]])
        for number, (kind, colour) in enumerate(weather_colours(kinds).items())
    ]
    key = "A mark is a condition: the mean of its frames and seeds."
    infinite = [metric_name(each.metric, unit=False) for each in found.metrics if each.infinite]
    if infinite:
        key += f" Infinite scores (equal images) are not drawn: {', '.join(infinite)}."
    figures = [
        parts.Figure(
            scatter_uri(each, data.scores[each.metric], data.performance, kinds, what),
            f"{what} against {metric_name(each.metric, unit=False)}",
            look="chart",
        )
        for each in found.metrics
    ]
    legend = [parts.Legend(keys, chart=True)] if data.kind else []
    return [*legend, parts.Paragraph(key, "key"), parts.Pictures(figures, across=4)]


def _numbers(found: Correlation) -> parts.Table:
    heads = (
        *("Rank", "Spearman's<br>rho", "Kendall's<br>tau-b", "Pearson's<br>r", "Given level,<br>ranks"),
        *("Given level,<br>linear", "Error by<br>score", "by<br>level", "by<br>mean", "Condi-<br>tions"),
    )
    return parts.Table(["Score", *map(parts.markup, heads)], [_row(each) for each in found.metrics], look="roomy tops")


def _row(each: MetricCorrelation) -> list[parts.Cell | str]:
    """A metric in the table."""
    ranks, error = each.rank_interval, each.prediction
    bold = "strong" if error.rmse < error.rmse_of_level else ""
    return [
        metric_name(each.metric, unit=False),
        parts.Cell(
            NO_VALUE if each.rank is None else f"{each.rank}", [] if ranks is None else [f"{ranks[0]} to {ranks[1]}"]
        ),
        *(_coefficient(one) for one in (each.spearman, each.kendall, each.pearson)),
        *(
            parts.Cell(_number(one.value), [_p_value(one.p_value)], "strong" if one.p_value < SURE else "")
            for one in (each.partial_rank, each.partial)
        ),
        parts.Cell(_number(error.rmse, 3), look=bold),
        _number(error.rmse_of_level, 3),
        _number(error.rmse_of_mean, 3),
        f"{each.conditions}",
    ]


def _coefficient(one: Coefficient) -> parts.Cell:
    return parts.Cell(_number(one.value), [_interval(one.low, one.high), _p_value(one.p_value)])


def _reasons(found: Correlation) -> list[str]:
    """Reasons for missing numbers, each once, with its metrics."""
    reasons: dict[str, list[str]] = {}
    for each in found.metrics:
        for what, one in (
            ("no coefficient", each.spearman),
            ("no partial correlation of ranks", each.partial_rank),
            ("no linear partial correlation", each.partial),
        ):
            if one.reason:
                reasons.setdefault(f"{what}: {one.reason}", []).append(metric_name(each.metric, unit=False))
    everywhere = len(found.metrics)
    return [
        f"{'All metrics' if len(names) == everywhere else ', '.join(names)}: {reason}."
        for reason, names in reasons.items()
    ]


def _how_to_read(found: Correlation, summary: Mapping[str, Any]) -> Section:
    coefficients = """
        - Spearman's rho and Kendall's tau ask for the order only, Pearson's r for a straight line. The sign is that of
          the score: those that are better when lower have a negative one.
        - Intervals hold 95 % of bootstrap samples of whole conditions. They are too narrow for few conditions, and for
          conditions that share a scene.
        - Small under a rank: the places that 95 % of the samples give the score.
    """
    level = f"""
        - Scores and detectors both get worse in heavier weather, so both go together even where a score says nothing
          about a detector. Here the kind of weather and a straight line in its severity are taken out first.
        - Bold: p below {SURE:g}. Of {len(found.metrics)} scores that say nothing more, one in twenty would be bold.
    """
    error = f"""
        - Root mean square error of {summary["performance"]} predicted for a condition from all others: by a straight
          line in the score, by one in the level for each weather, by their mean.
        - Bold: the score predicts better than the level of the weather does.
        - An infinite score is left out of lines; ranks take it.
    """
    files = parts.markup(
        "torchweather {} · all conditions in {}, all numbers of this page in {}",
        summary["torchweather"],
        parts.link("conditions.csv"),
        parts.link("correlation.json"),
    )
    named = {"Coefficients": coefficients, "Given the level": level, "Error": error}
    columns = parts.Columns([(title, [parts.Listing(parts.items(text))]) for title, text in named.items()])
    return Section("How to read it", [columns, parts.Fine(files)])


def _number(value: float, digits: int = 2) -> str:
    """A number with a proper minus; a dash where there is none."""
    return fixed_text(value, digits) if math.isfinite(value) else NO_VALUE


def _interval(low: float, high: float) -> str:
    return "" if math.isnan(low) else f"{_number(low)} to {_number(high)}"


def _p_value(value: float) -> str:
    if math.isnan(value):
        return ""
    return "p < 0.001" if value < 0.001 else f"p = {value:.2g}" if value < 0.1 else f"p = {value:.2f}"
