"""The correlation's folder: its numbers, its conditions, and a page with the ranking and the pictures."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

from torchweather import __version__
from torchweather.io import atomic_folder, write_table
from torchweather.metrics.coefficients import Coefficient, abs_interval
from torchweather.metrics.correlation import Correlation, MetricCorrelation
from torchweather.metrics.d34_claim import D34_CLAIM
from torchweather.report.correlation_figures import (
    MARKS,
    metric_name,
    ranking_uri,
    scatter_uri,
    weather_colours,
)
from torchweather.report.page import html_page

__all__ = ["correlation_summary", "write_correlation"]

GLYPHS = dict(zip(MARKS, "●■▲◆▼✚", strict=True))
NO_VALUE = "–"
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
        text = json.dumps(summary, indent=1, allow_nan=False) + "\n"
        (staging / "correlation.json").write_text(text, encoding="utf-8")
        (staging / "index.html").write_text(_page(found, summary, performance), encoding="utf-8")
    return summary


def correlation_summary(
    found: Correlation, *, performance: str = "performance", notes: tuple[str, ...] = ()
) -> dict[str, Any]:
    """All numbers, as JSON can hold them."""
    summary: dict[str, Any] = _storable(
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


def _storable(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _storable(entry) for key, entry in value.items()}
    if isinstance(value, (list, tuple)):
        return [_storable(entry) for entry in value]
    return str(value) if isinstance(value, float) and not math.isfinite(value) else value


# ---- the page ------------------------------------------------------------------------------------------------------


def _page(found: Correlation, summary: dict[str, Any], performance: str) -> str:
    ranked = [each for each in found.metrics if each.rank is not None]
    kinds = found.data.kind or ["all conditions"] * len(found.data.performance)
    colours = weather_colours(kinds)
    return html_page(
        "correlation.html",
        summary=summary,
        best=_best(ranked[0], found) if ranked else None,
        high=sum(abs_interval(each.spearman)[0] >= found.highly for each in ranked),
        ranked=len(ranked),
        ranking=ranking_uri(ranked, found.highly, [each.metric for each in found.claim if not each.claimed_high])
        if ranked
        else None,
        legend=[
            {"name": kind, "colour": colour, "glyph": GLYPHS[MARKS[number % len(MARKS)]]}
            for number, (kind, colour) in enumerate(colours.items())
        ]
        if found.data.kind
        else [],
        charts=[
            {
                "name": metric_name(each.metric, unit=False),
                "picture": scatter_uri(
                    each, found.data.scores[each.metric], found.data.performance, kinds, performance
                ),
            }
            for each in found.metrics
        ],
        rows=[_row(each) for each in found.metrics],
        infinite=[metric_name(each.metric, unit=False) for each in found.metrics if each.infinite],
        reasons=_reasons(found),
        claims=[
            {
                "name": metric_name(each.metric, unit=False),
                "says": "high" if each.claimed_high else "not high",
                "found": _number(each.found),
                "interval": _interval(each.low, each.high),
                "verdict": each.verdict,
            }
            for each in found.claim
        ],
    )


def _best(each: MetricCorrelation, found: Correlation) -> dict[str, str]:
    shared = [
        metric_name(other.metric, unit=False)
        for other in found.metrics
        if other is not each and other.rank_interval is not None and other.rank_interval[0] == 1
    ]
    return {
        "name": metric_name(each.metric, unit=False),
        "rho": _number(each.spearman.value),
        "interval": _interval(each.spearman.low, each.spearman.high),
        "shared": ", ".join(shared) if len(shared) <= FEW else f"{len(shared)} other scores",
        "they": "it" if len(shared) == 1 else "each of them",
    }


def _row(each: MetricCorrelation) -> dict[str, Any]:
    """A metric in the table."""
    ranks = each.rank_interval
    return {
        "name": metric_name(each.metric, unit=False),
        "conditions": each.conditions,
        "rank": NO_VALUE if each.rank is None else str(each.rank),
        "ranks": "" if ranks is None else f"{ranks[0]} to {ranks[1]}",
        "coefficients": [_cell(c) for c in (each.spearman, each.kendall, each.pearson)],
        "partial": [
            {"text": _number(p.value), "p": _p_value(p.p_value), "sure": p.p_value < SURE}
            for p in (each.partial_rank, each.partial)
        ],
        "error": _number(each.prediction.rmse, digits=3),
        "of_level": _number(each.prediction.rmse_of_level, digits=3),
        "of_mean": _number(each.prediction.rmse_of_mean, digits=3),
        "better": each.prediction.rmse < each.prediction.rmse_of_level,
    }


def _cell(coefficient: Coefficient) -> dict[str, str]:
    return {
        "text": _number(coefficient.value),
        "interval": _interval(coefficient.low, coefficient.high),
        "p": _p_value(coefficient.p_value),
    }


def _reasons(found: Correlation) -> list[str]:
    """Why numbers are missing, each reason once, with its metrics."""
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


def _number(value: float, *, digits: int = 2) -> str:
    """A number with a proper minus; a dash where there is none."""
    if not math.isfinite(value):
        return NO_VALUE
    return f"{value:.{digits}f}".replace("-", "−")


def _interval(low: float, high: float) -> str:
    return "" if math.isnan(low) else f"{_number(low)} to {_number(high)}"


def _p_value(value: float) -> str:
    if math.isnan(value):
        return ""
    return "p < 0.001" if value < 0.001 else f"p = {value:.2g}" if value < 0.1 else f"p = {value:.2f}"
