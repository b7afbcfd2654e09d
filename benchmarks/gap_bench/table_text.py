"""A score as Markdown: figures with their bars, and what was missed."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

from torchweather.stages.catalogue import EFFECTS

__all__ = ["bars_table", "other_figures_table", "missed_table", "short_name"]

Row = Mapping[str, Any]
WORDS = {
    "singles_identifiable_exact": "single effects, identifiable, d' of 10 or more: exact name",
    "singles_wrong_asserted": "single effects: a wrong name asserted",
    "singles_identifiable_unknown": "single effects, identifiable, d' of 10 or more: called unknown",
    "pairs_both": "pairs: both names",
    "screen_nulls_alarm": "nothing hidden, global test alone: alarms",
    "nulls_alarm": "nothing hidden, whole workflow: alarms",
    "outside_unknown": "outside of the catalogue: called unknown",
    "coverage_90": "90 % intervals of parameters: hold the truth",
    "interval_width_over_known": "width of intervals over those of a fit that knows the effect, median",
    "gap_after_near_floor": "exact answers: held-out gap after within {floors:g} floors",
    "other_metrics_after_over_before": "exact answers: gap on metrics never used, after over before, median",
    "seconds": "seconds a study, median",
    "singles_exact": "single effects, all: exact name",
    "singles_in_confusion_set": "single effects, all: exact, or a name that was sealed as confusable",
    "several_wrong_asserted": "pairs and triples: a wrong name asserted",
    "triples_all": "triples: all names",
    "outside_detected": "outside of the catalogue: an alarm",
    "outside_right_axis": "outside of the catalogue, where alarmed: right axis",
    "decoys_right": "decoys: right answer",
    "coverage_90_same_form": "90 % intervals, effects of the catalogue's own form: hold the truth",
}
OTHER_FIGURES = (
    "singles_exact",
    "singles_in_confusion_set",
    "triples_all",
    "several_wrong_asserted",
    "outside_detected",
    "outside_right_axis",
    "decoys_right",
    "coverage_90_same_form",
)
HOLDS = {True: "yes", False: "**no**", None: "not counted"}


def bars_table(table: Row, bars: Sequence[Row]) -> str:
    """Every bar, what was reached, and whether it holds."""
    lines = ["| figure | bar | reached | Wilson 95 % | holds |", "| --- | --- | --- | --- | --- |"]
    for one in bars:
        side = "at_least" if "at_least" in one else "at_most"
        figure = table[one["figure"]]
        counts = "share" in figure
        limit = f"{round(100 * one[side], 1):g} %" if counts else f"{one[side]:g}"
        bar = f"{'>=' if side == 'at_least' else '<='} {limit}"
        reached = _share(figure) if counts else _number(one["reached"])
        if figure.get("alone"):  # seconds
            reached += f" ({figure['alone']} searched alone)"
        interval = _interval(figure) if counts else ""
        words = WORDS[one["figure"]].format(floors=figure.get("floors", 1.0))
        lines.append(f"| {words} | {bar} | {reached} | {interval} | {HOLDS[one['holds']]} |")
    return "\n".join(lines)


def other_figures_table(table: Row) -> str:
    """Figures without a bar."""
    lines = ["| figure | reached | Wilson 95 % |", "| --- | --- | --- |"]
    for name in OTHER_FIGURES:
        lines.append(f"| {WORDS[name]} | {_share(table[name])} | {_interval(table[name])} |")
    for level, figure in sorted(table["by_level"].items(), key=lambda one: float(one[0])):
        lines.append(f"| single effects, d' of {level}: exact name | {_share(figure)} | {_interval(figure)} |")
    for weather, figure in sorted(table["by_weather"].items()):
        lines.append(f"| single effects in {weather}: exact name | {_share(figure)} | {_interval(figure)} |")
    off = table["parameter_off_over_departure"]
    lines.append(
        f"| error of a parameter over its departure, same form: median of {off['of']} | {_number(off['median'])} | |"
    )
    return "\n".join(lines)


def missed_table(cases: Sequence[Row]) -> str:
    """Effects of the catalogue that were not named exactly: what was hidden, and what was said."""
    lines = ["| hidden | d' | in | said | studies |", "| --- | --- | --- | --- | --- |"]
    missed = Counter(
        (_names(one["true"]), one["level"], one["weather"], _names(one["names"]) or one["verdict"])
        for one in cases
        if one["family"] in ("single", "pair", "triple") and not one["exact"]
    )
    for (hidden, level, weather, said), number in sorted(missed.items()):
        lines.append(f"| {hidden} | {level:g} | {weather} | {said} | {number} |")
    return "\n".join(lines)


def _names(names: Sequence[str]) -> str:
    return " + ".join(short_name(name).replace("_", " ") for name in names)


def short_name(name: str) -> str:
    """Of effects of the catalogue, joined by plus signs, without their sensor; others as they are."""
    return " + ".join(one.partition(".")[2] if one in EFFECTS else one for one in name.split(" + "))


def _share(figure: Row) -> str:
    return f"{figure['hits']} of {figure['of']}" + (f" ({_percent(figure['share'])} %)" if figure["of"] else "")


def _interval(figure: Row) -> str:
    ends = figure["wilson_95"]
    return "" if ends is None else f"{_percent(ends[0])} to {_percent(ends[1])} %"


def _percent(share: float) -> str:
    """A share in percent; with one decimal below 10 %, and above 99 % where it is not all."""
    percent = 100.0 * share
    return f"{percent:.1f}" if round(percent, 1) < 10.0 or 99.0 < percent < 100.0 else f"{percent:.0f}"


def _number(value: float | None) -> str:
    return "" if value is None else f"{value:.3g}"
