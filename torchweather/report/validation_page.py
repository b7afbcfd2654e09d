"""The page of a validation: frames side by side, scores measured and simulated, trends, and what the study lacks."""

from __future__ import annotations

import math
import statistics
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from markupsafe import Markup

from torchweather.atmosphere.weather import Weather
from torchweather.evaluation.validation.comparison import FAMILY_LEVEL, UNDECIDED, Comparison
from torchweather.evaluation.validation.effect_power import EffectStrength
from torchweather.evaluation.validation.power import FACTOR, FURTHER, POWER
from torchweather.evaluation.validation.run import ConditionResult, Validation
from torchweather.evaluation.validation.severity import TrendComparison, knob_value
from torchweather.gap.study.splits import severity
from torchweather.gap.study.study import Study
from torchweather.io import atomic_folder
from torchweather.report import parts
from torchweather.report.findings import study_alerts, study_section
from torchweather.report.page import write_json, write_report
from torchweather.report.report import Report, Section
from torchweather.report.tables import NO_VALUE, signed_text
from torchweather.report.validation_figures import DIFFERS, FLOOR, SIMULATED, Group, score_uri
from torchweather.report.validation_pictures import link_pictures, side_by_side

__all__ = ["validation_page", "write_validation"]

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
    page = validation_page(study, validation, summary)
    with atomic_folder(Path(out_dir)) as staging:
        write_json(staging / "validation.json", summary)
        write_report(page, staging / "index.html")
    return summary


def validation_page(study: Study, validation: Validation, summary: Mapping[str, Any]) -> Report:
    """The page of a validation.

    Args:
        study: that was validated.
        validation: of the study.
        summary: what ``validation.json`` holds.
    """
    kind, is_link = KINDS[study.kind], study.kind == "link"
    groups = _link_groups(validation) if is_link else _groups(study, validation)
    names = list(groups[0].cells[0]) if groups and groups[0].cells else []
    counts = sorted({result.frames for result in validation.conditions})
    facts = [
        ("version", summary["torchweather"]),
        ("seed", f"{summary['seed']}"),
        ("series" if is_link else "conditions", f"{len(summary['conditions'])}"),
    ]
    if not is_link:
        facts.append(("frames of each", f"{counts[0]}" if len(counts) == 1 else f"{counts[0]} to {counts[-1]}"))
    checked = """The frames called measured come from the library itself, with clear frames and random numbers of their
        own. So everything should agree: this page shows what agreement looks like, and how far apart two runs of one
        model are."""
    self_check = [parts.Alert(checked, "Nothing was measured here.")] if summary["self_check"] else []
    beside = "simulation" if summary["self_check"] else "measurement"
    return Report(
        title=f"Simulation beside {beside}: {kind}",
        head=f"torchweather: simulation beside measurement, {kind}",
        lead=[
            parts.Verdict(validation.verdict()),
            *study_alerts(validation.findings),
            *self_check,
            parts.Facts(facts),
        ],
        sections=[
            *_power(validation),
            *_effects(validation),
            Section("Side by side", link_pictures(study, validation) if is_link else side_by_side(study, validation)),
            _scores(groups, names, validation, is_link=is_link),
            *_trends(validation, named=len(study.scenes) > 1 or is_link),
            _distributions(validation, is_link=is_link),
            study_section(validation.findings),
        ],
        footer=_how_to_read(validation, summary, is_link=is_link),
    )


def _link_groups(validation: Validation) -> list[Group]:
    """Classes of rain of each series."""
    return [
        Group(
            each.label,
            f"{each.label}: rain from, mm/h",
            tuple(score.name.removeprefix("attenuation_db_from_").removesuffix("_mm_per_h") for score in each.scores),
            tuple({"attenuation_db": score} for score in each.scores),
        )
        for each in validation.conditions
        if each.scores
    ]


def _groups(study: Study, validation: Validation) -> list[Group]:
    """Conditions by scene and weather, in order of severity."""
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
                f"{where}{kind}" + ("" if first is None else f", {AXES[first.intensity_name]}"),
                tuple("" if weather is None else f"{knob_value(weather):g}" for weather, _ in members),
                tuple({score.name: score for score in result.scores} for _, result in members),
            )
        )
    return groups


# ---- power -----------------------------------------------------------------------------------------------------------


def _power(validation: Validation) -> list[Section]:
    """The smallest change that each condition would have shown."""
    if all(each.smallest_change is None for each in validation.conditions):
        return []
    text = f"""The smallest factors of rate or visibility that the same number of frames would have flagged with
        {100 * POWER:.0f} % power, by simulation. A comparison agrees only where a factor of {FACTOR:g} either way would
        have been flagged, and is excluded. Otherwise it is not decided."""
    rows = []
    for result in validation.conditions:
        if (changes := result.smallest_change) is None:
            continue
        known = [(score.name, factors) for score in result.scores if (factors := score.smallest_change)]
        best = min(known, key=lambda each: max(each[1][1], 1.0 / max(each[1][0], 1e-9)))[0]
        shown = math.isfinite(changes[1]) or changes[0] > 0
        rows.append(
            (
                result.label,
                f"{result.frames}",
                result.verdict,
                *_factors(changes),
                _title(best) if shown else NO_VALUE,
            )
        )
    heads: parts.Heads = ["Condition", "Frames", parts.Column("Verdict", "left"), "Less, factor", "More, factor"]
    heads.append(parts.Column("Most sensitive score", "left"))
    return [
        Section("What these frames could have shown", [parts.Paragraph(text), parts.Table(heads, rows)], id="power")
    ]


def _factors(changes: tuple[float, float]) -> tuple[str, str]:
    below, above = changes
    low = NO_VALUE if math.isnan(below) else f"× {below:.2f}" if below > 0 else f"below {1 / FURTHER:g}"
    return low, NO_VALUE if math.isnan(above) else f"× {above:.2f}" if math.isfinite(above) else f"above {FURTHER:g}"


def _effects(validation: Validation) -> list[Section]:
    """The smallest strength of each effect that each condition would have shown."""
    results = [each for each in validation.conditions if each.effects or each.not_tried]
    if not results:
        return []
    text = f"""The smallest strength of each effect that the same frames would have flagged with {100 * POWER:.0f} %
        power, if it acted on the measured frames alone. One parameter is varied from its identity, the others keep
        their defaults. Typical is the size that the catalogue states. A value after "more than" or "beyond" was
        simulated, and would not have been flagged."""
    found: dict[str, dict[str, EffectStrength]] = {}
    for result in results:
        for each in result.smallest_effects:
            found.setdefault(each.effect, {})[result.id] = each
    rows = [
        (
            name,
            *_varied(next(iter(own.values()))),
            *(_strength(own[result.id]) if result.id in own else NO_VALUE for result in results),
        )
        for name, own in found.items()
    ]
    several = len({each.scene for each in results}) > 1
    heads: parts.Heads = [parts.Column("Effect", "left"), parts.Column("Parameter", "left"), "Typical"]
    heads += [f"{each.scene}: {each.label}" if several else each.label for each in results]
    reasons = {name: why for result in results for name, why in result.not_tried.items()}
    notes = [parts.Note(f"Not tried. {name}: {why}") for name, why in reasons.items()]
    table = [parts.Table(heads, rows)] if rows else []
    return [
        Section("Effects that these frames could have shown", [parts.Paragraph(text), *table, *notes], id="effects")
    ]


def _varied(one: EffectStrength) -> tuple[str, str]:
    return one.parameter + (f", {one.unit}" if one.unit else ""), f"{one.typical:.3g}"


def _strength(one: EffectStrength) -> str:
    """Smallest value that is flagged; the farthest one that is not."""
    if math.isfinite(one.strength):
        return f"{one.value:.3g}"
    return f"{'beyond' if one.most < one.typical else 'more than'} {one.most:.3g}"


# ---- scores ----------------------------------------------------------------------------------------------------------


def _scores(groups: Sequence[Group], names: Sequence[str], validation: Validation, *, is_link: bool) -> Section:
    if is_link:
        text = """Mean attenuation of the links in classes of rain. A link in one rain is a pair, measured and
            simulated, so what counts is the scatter of the differences from link to link. The floor is dry air."""
    else:
        text = """Every measured and every simulated frame is scored against a clear frame. Where both score alike, the
            simulated weather did to the frame what the real one did, as far as this score sees. The floor is what clear
            frames score against each other."""
    marks = [
        parts.Key("measured", "#1b2733"),
        parts.Key("simulated", SIMULATED, look="diamond"),
        parts.Key("floor: clear against clear", FLOOR, look="band edge"),
        parts.Key("they differ", DIFFERS, look="gap"),
        parts.Key("bars: two standard errors"),
    ]
    figures = [
        parts.Figure(
            score_uri(name, groups),
            f"{_title(name)} over the weather, measured and simulated",
            title=_title(name),
            small=_says(groups[0].cells[0][name]),
            look="chart",
        )
        for name in names
    ]
    cells = {
        "": "they agree",
        "pale": "they agree, and neither is distinguishable from clear air",
        "differs": "they differ",
        "pale ": "cannot be judged",
        " ": "not decided",
    }
    shown = {"pale ": NO_VALUE, " ": "(+0.0)"}
    key = Markup(" &ensp; ").join(
        parts.markup('<span class="mark {}">{}</span> {}', look, shown.get(look, "+0.0"), text)
        for look, text in cells.items()
    )
    fine = """Means over frames ± standard error. Gap over effect: the gap as a share of what the measured weather did
        to the score, its distance from the floor. Flagged below and above: smallest factors of rate or visibility that
        this score would have shown."""
    return Section(
        "Scores against clear air",
        [
            parts.Paragraph(text),
            parts.Legend(marks, chart=True),
            parts.Pictures(figures, across=3),
            parts.Heading("Gap, simulated less measured, in standard errors"),
            parts.Paragraph(key, "key wide"),
            _matrix(groups, names),
            *(parts.Note(f"Left out. {_title(name)}: {why}.") for name, why in validation.left_out.items()),
            parts.Details("All numbers", [*(_numbers(group, names) for group in groups), parts.Fine(fine)]),
        ],
        id="scores",
    )


def _title(name: str) -> str:
    return TITLES.get(name, name.upper().replace("_", "-"))


def _says(cell: Comparison) -> str:
    """Unit, and which way is nearer to clear air."""
    better = "higher is nearer to clear" if cell.meaning.higher_is_better else "lower is nearer to clear"
    return f"{cell.meaning.unit}; {better}" if cell.meaning.unit else better


def _matrix(groups: Sequence[Group], names: Sequence[str]) -> parts.Table:
    """The gap of every score in every condition, in standard errors."""
    return parts.Table(
        ["Score", *(tick for group in groups for tick in group.ticks)],
        [(_title(name), *(_cell(cell[name]) for group in groups for cell in group.cells)) for name in names],
        look="matrix",
        over=[("", 1), *((group.axis, len(group.ticks)) for group in groups)],
    )


def _cell(cell: Comparison) -> parts.Cell:
    """Gap in standard errors, and how to show it."""
    at_floor = cell.side_of_floor("measured") == cell.side_of_floor("simulated") == "at"
    value = cell.in_errors
    text = NO_VALUE if math.isnan(value) else f"{value:+.1f}".replace("-", "−") if math.isfinite(value) else "∞"
    if cell.verdict == "differs":
        return parts.Cell(text if text != NO_VALUE else "∞", look="differs")
    if cell.verdict == "unjudged":
        return parts.Cell(NO_VALUE, look="pale")
    if cell.verdict == UNDECIDED:
        return parts.Cell(f"({text})", look="pale" if at_floor else "")
    return parts.Cell(text, look="pale" if at_floor else "")


def _numbers(group: Group, names: Sequence[str]) -> parts.Table:
    """All numbers of a group, a row for each condition and score."""
    rows: list[Sequence[parts.Cell | str]] = []
    for tick, cells in zip(group.ticks, group.cells, strict=True):
        for name in names:
            cell = cells[name]
            sides = (cell.measured, cell.simulated, cell.floor)
            share = cell.share_of_effect
            rows.append(
                (
                    *(tick, _title(name), *(_with_error(side.mean, side.standard_error) for side in sides)),
                    parts.Cell(signed_text(cell.gap, plus=True), look="differs" if cell.verdict == "differs" else ""),
                    NO_VALUE if math.isnan(share) else f"{100 * share:+.0f}\u202f%".replace("-", "−"),
                )
            )
            rows[-1] = (*rows[-1], *(_factors(cell.smallest_change) if cell.smallest_change else (NO_VALUE, NO_VALUE)))
    heads = ["Measured", "Simulated", "Floor", "Gap", "Gap over effect", "Flagged below", "Flagged above"]
    return parts.Table([group.axis, parts.Column("Score", "left"), *heads], rows)


def _with_error(mean: float, error: float) -> str:
    return signed_text(mean) if math.isnan(error) else f"{signed_text(mean)} ± {signed_text(error)}"


# ---- trends and distributions ----------------------------------------------------------------------------------------


def _trends(validation: Validation, *, named: bool) -> list[Section]:
    if not validation.trends:
        return []
    text = "A score follows the weather where it gets worse at every step of severity."
    heads: parts.Heads = ["Weather", "Steps", "Follow, measured", "Follow, simulated", "Go alike"]
    heads.append(parts.Column("Where not", "words"))
    table = parts.Table(heads, [_trend(trend, named) for trend in validation.trends])
    return [Section("Trends over severity", [parts.Paragraph(text), table], id="trends")]


def _trend(trend: TrendComparison, named: bool) -> tuple[str, ...]:
    agreement = {name: trend.agreement(name) for name in trend.measured.metrics}
    words = "; ".join(
        f"{_title(name)}: measured {GOES[trend.measured.metrics[name].verdict]}, simulated "
        f"{GOES[trend.simulated.metrics[name].verdict]}"
        for name, agrees in agreement.items()
        if agrees is False
    )
    close = ", ".join(_title(name) for name, agrees in agreement.items() if agrees is None)
    if close:
        words += f"{'. ' if words else ''}Too close to call: {close}"
    return (
        f"{trend.scene}: {trend.weather}" if named else trend.weather,
        f"{len(trend.values)}",
        f"{trend.measured.expected} of {len(agreement)}",
        f"{trend.simulated.expected} of {len(agreement)}",
        f"{sum(agrees is True for agrees in agreement.values())} of {len(agreement)}",
        words,
    )


def _distributions(validation: Validation, *, is_link: bool) -> Section:
    text = f"""The double validation metric of sensor-model validation. Bias: simulated less measured median. Scatter:
        area between the two distribution functions once the bias is taken off. In brackets the same for one half of the
        clear frames against the other{": dry samples here" if is_link else ""}."""
    several = len({each.scene for each in validation.conditions}) > 1
    rows: list[Sequence[parts.Cell | str] | str] = []
    for result in validation.conditions:
        rows.append(f"{result.scene}: {result.label}" if several else result.label)
        for each in result.quantities:
            floors = (signed_text(abs(each.floor_bias)), signed_text(each.floor_scatter))
            found = (signed_text(each.bias, plus=True), signed_text(each.scatter))
            row = [
                each.name + (f", {each.unit}" if each.unit else ""),
                signed_text(each.measured_median),
                signed_text(each.simulated_median),
                *(parts.markup('{} <span class="pale">({})</span>', *pair) for pair in zip(found, floors, strict=True)),
            ]
            rows.append([*row, signed_text(each.rmse)] if is_link else row)
    heads = ["Quantity, unit", "Measured median", "Simulated median", "Bias", "Scatter"]
    table = parts.Table([*heads, "RMS difference"] if is_link else heads, rows)
    return Section("Distributions", [parts.Paragraph(text), table], id="quantities")


def _how_to_read(validation: Validation, summary: Mapping[str, Any], *, is_link: bool) -> Section:
    differ = f"""Two means differ where their gap exceeds what chance does: Student's t with the scatter of the
        measured, the simulated and the clear frames, at a level that leaves {100 * FAMILY_LEVEL:g} % for one false
        difference or more on the whole page. Few frames make that bound wide; then the power is low, and nothing is
        decided. Frames count as independent; those that follow each other within seconds are not, and then
        differences are called too readily. The uncertainty of the weather record is not in the scatter."""
    why = parts.markup("""The page shows what disagrees, not why: <code>torchweather gap</code> looks for the effect
        that is missing.""")
    seconds = [each for result in validation.conditions for each in result.simulation_s]
    made = parts.markup(
        "Run time: {} ms a simulated {} (median of {}; {} ms at most, with the set-up of a transform). "
        "torchweather {} · seed {} · study {} · all numbers in {}",
        *(f"{1e3 * statistics.median(seconds):.3g}", "series" if is_link else "frame", len(seconds)),
        *(f"{1e3 * max(seconds):.3g}", summary["torchweather"], summary["seed"], summary["study_sha256"]),
        parts.link("validation.json"),
    )
    return Section("How to read this page", [parts.Fine(text) for text in (differ, why, made)])
