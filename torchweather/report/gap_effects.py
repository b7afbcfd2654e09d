"""Effects on the gap's page: those found, their rivals, the unexplained residual, the ranking."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, TypeVar

from torchweather.gap.gap_report import Curve, Response
from torchweather.gap.study.study import Study
from torchweather.report import parts
from torchweather.report.gap_figures import response_uri, unknown_uri
from torchweather.report.gap_words import (
    WHOLE,
    along,
    axis_name,
    bound_sentence,
    confidence_text,
    edge_text,
    effect_name,
    exact_twins,
    formula_words,
    group_name,
    listed,
    parameter_rows,
    posterior_text,
    signed_decimal,
    statistic_name,
)
from torchweather.report.report import Section
from torchweather.report.tables import number_text, signed_text
from torchweather.stages.catalogue import EFFECTS

__all__ = ["by_statistic", "deciding_section", "ranking_section", "unexplained_parts", "what_section"]

BAR_PX = 80
Drawn = TypeVar("Drawn", Curve, Response)


def by_statistic(curves: Sequence[Drawn]) -> dict[tuple[str, str], list[Drawn]]:
    """Curves of each statistic along each axis."""
    found: dict[tuple[str, str], list[Drawn]] = {}
    for one in curves:
        found.setdefault((one.statistic, one.axis), []).append(one)
    return found


# ---- what ------------------------------------------------------------------------------------------------------------


def what_section(answer: Mapping[str, Any]) -> Section:
    """Effects that were found, with their parameters.

    Args:
        answer: in the format ``torchweather-gap/1``.
    """
    found = [part for effect in answer["effects"] for part in _found(effect)]
    if not answer["effects"]:
        text = "No effect of the catalogue explains the departure. With the best of them fitted, this is {}."
        found.append(parts.Paragraph(parts.markup(text, parts.link("#held-out", "what remains"))))
    return Section("What", found, id="what")


def _found(effect: Mapping[str, Any]) -> list[parts.Part]:
    """An effect with its parameters."""
    name = effect["name"]
    declared = EFFECTS[name]
    small = f"{declared.title}; in the literature: {declared.term}"
    if declared.percollect:
        small += f"; PerCollECT: {declared.percollect}"
    heads: parts.Heads = ["Parameter", "Value", parts.Column("Unit", "unit"), "90 % interval", "Does nothing at"]
    at_bound = effect.get("at_bound", {})
    rows = [
        (
            parts.markup("<code>{}</code>", row["name"]),
            parts.Cell(
                row["value"],
                [row["words"].rpartition(" ")[2]] if row["unit"] == "rad" else [],
                look=_far(row, at_bound),
            ),
            row["unit"],
            parts.Cell(
                row["interval"] or "not fitted",
                [f"the {at_bound[row['name']]} value searched"] if row["name"] in at_bound else [],
            ),
            row["identity"] or "any value",
        )
        for row in parameter_rows(effect)
    ]
    note = f"""Confidence {confidence_text(effect["confidence"])}: its posterior, below, times the share of right names
        in development studies."""
    if effect.get("beside_bound"):
        names = listed([effect_name(one) for one in effect["beside_bound"]])
        note += f""" It is lowered: {names} beside it ends where the search does, so this effect may stand for a part of
            that one."""
    found: list[parts.Part] = [
        parts.Heading(effect_name(name).capitalize(), small),
        parts.Table(heads, rows, look="short"),
        parts.Note(note),
    ]
    found += [parts.Alert(bound_sentence(effect, *one), "At the end of what is searched:") for one in at_bound.items()]
    return found


def _far(row: Mapping[str, str], at_bound: Mapping[str, str]) -> str:
    return "far" if row["name"] in at_bound else ""


# ---- what data would decide ------------------------------------------------------------------------------------------


def deciding_section(answer: Mapping[str, Any], searched: Sequence[str], study: Study) -> Section:
    """Data that would distinguish the effects from those that they could be mistaken for.

    Args:
        answer: in the format ``torchweather-gap/1``.
        searched: ids of the effects that were searched for.
        study: that was searched.
    """
    found = [part for effect in answer["effects"] for part in _deciding(effect, answer, searched, study)]
    if not answer["effects"]:
        found = _to_find_out(answer)
    return Section("What data would decide", found, id="decide")


def _to_find_out(answer: Mapping[str, Any]) -> list[parts.Part]:
    """Data on a departure that no effect explains."""
    text = """The verdict would be firmer with conditions in which the cause can be switched off: the same weather with
        another unit of the sensor, or dry frames with the suspected part alone."""
    one = answer["unknown"]
    if one and one["axis"] not in WHOLE:
        text += f" They should cover the {along(one['axis'])} evenly, as the departure runs along it."
    return [parts.Paragraph(text)]


def _deciding(
    effect: Mapping[str, Any], answer: Mapping[str, Any], searched: Sequence[str], study: Study
) -> list[parts.Part]:
    """Rivals of one effect, and what acts exactly like it."""
    name = effect["name"]
    declared = EFFECTS[name]
    rivals = dict.fromkeys([*effect["confusable_with"], *declared.confusable_with])
    rivals = {rival: None for rival in rivals if rival in answer["catalogue"]}
    found: list[parts.Part] = [parts.Heading(effect_name(name).capitalize())] if len(answer["effects"]) > 1 else []
    if rivals:
        heads: parts.Heads = ["Could be mistaken for", parts.Column("With these data", "left")]
        rows_of_rivals = [
            (
                effect_name(rival),
                parts.Cell(
                    _status(rival, effect, answer, searched), look="far" if rival in effect["confusable_with"] else ""
                ),
                _data_between(name, rival),
            )
            for rival in rivals
        ]
        found.append(parts.Table([*heads, parts.Column("Distinguished by", "words")], rows_of_rivals, look="tops"))
    else:
        found.append(parts.Note(f"The catalogue lists nothing that {effect_name(name)} could be mistaken for."))
    with_intensity = getattr(study.sensor, "intensity_unit", "none") != "none"
    found += [
        parts.Alert(f"{twin} acts exactly alike. It would be with {data}.", "Cannot be told apart with these data:")
        for twin, data in exact_twins(name, with_intensity=with_intensity)
    ]
    return found


def _status(rival: str, effect: Mapping[str, Any], answer: Mapping[str, Any], searched: Sequence[str]) -> str:
    """Status of a rival effect with these data."""
    if rival in effect["confusable_with"]:
        return "cannot be excluded"
    if rival in {one["name"] for one in answer["effects"]}:
        return "found, too"
    if rival in {one["name"] for one in answer["candidates"]}:
        return "fits worse"
    return "explains less, by its response alone" if rival in searched else "was not searched for"


def _data_between(name: str, rival: str) -> str:
    """Data that distinguish two effects, after the catalogue's entry of either."""
    other = EFFECTS[rival].confusable_with if rival in EFFECTS else {}
    return EFFECTS[name].confusable_with.get(rival) or other.get(name) or "the catalogue does not say"


# ---- what no effect explains -----------------------------------------------------------------------------------------


def unexplained_parts(one: Mapping[str, Any], *, found: bool) -> list[parts.Part]:
    """The bin, the curve, the formula and the stage of what no effect explains; ``found``: beside effects."""
    name = group_name(one["statistic"], one["axis"])
    z = signed_decimal(one["z"])
    best = "the simulation with what was found" if found else "the best that the catalogue can do"
    text = f"""{name}: of all statistics this one departs most significantly from {best}. Errors of the weather record
        and of the clear frames are allowed for. A spread counts for what no mean along another axis explains."""
    if one["axis"] in WHOLE:
        text += f" {z} standard deviations."
    else:
        ends = " to ".join(edge_text(one["axis"], one[end]) for end in ("from", "to"))
        text += f" It is largest from {ends} ({axis_name(one['axis'])}): {z} standard deviations."
    shown: list[parts.Part] = [
        parts.Heading("Unexplained residual" if found else "What no effect explains", name, id="rest"),
        parts.Paragraph(text),
    ]
    curve, stage = one["curve"], one["empirical"]
    if len(curve["value"]) > 1:
        alt = f"{name}, measured less simulated, {curve['unit']}"
        shown.append(parts.Figure(unknown_uri(one["axis"], curve, one["formula"]), alt, look="chart medium"))
    rows = [_formula(one), ("Empirical stage", _stage(one))]
    shown.append(parts.Table(["", parts.Column("", "words")], rows, look="short bare"))
    copies = """The empirical stage copies the curve and has no cause: it does nothing outside the measured range, and
        other weather, scenes or sensors may differ. """
    missing = parts.markup(
        "{}No effect of the catalogue does this; one can be added as a {}.",
        copies if stage else "",
        parts.link("#add", "stage of one's own"),
    )
    return [*shown, parts.Note(missing)]


def _formula(one: Mapping[str, Any]) -> tuple[str, str]:
    curve, formula = one["curve"], one["formula"]
    if len(curve["value"]) == 1:
        return "Measured less simulated", f"{_single(curve)}, {curve['unit']}" if _single(curve) else ""
    if formula is None:
        return (
            "Simplest formula",
            """none: no constant, line, logarithm, power, exponential approach, parabola, step or
            sine describes it""",
        )
    return "Simplest formula", parts.markup(
        "{}: <code>{}</code>, {}; χ² per degree of freedom {}",
        *(formula_words(formula["name"]), formula["text"].replace("-", "−")),
        *(curve["unit"], number_text(formula["chi2_per_dof"])),
    )


def _single(curve: Mapping[str, Any]) -> str:
    """A curve of one bin in words."""
    value, low, high = (curve[name][0] for name in ("value", "low", "high"))
    if value is None:
        return ""
    return f"{signed_text(value)} ({signed_text(low)} to {signed_text(high)})"


def _stage(one: Mapping[str, Any]) -> str:
    """The empirical stage in words, or why there is none."""
    stage = one["empirical"]
    if stage is None:
        return f"none: {one['why_not']}"
    valid = "every beam alike"
    if stage["axis"] != "every_beam":
        low, high = (edge_text(stage["axis"], stage[end]) for end in ("measured_from", "measured_to"))
        valid = f"valid between {low} and {high} ({axis_name(stage['axis'])})" if low else valid
    return parts.markup(
        "{}, {}; in {}, {} where it is wanted",
        *(stage["kind"].replace("_", " "), valid, parts.link("model.yaml"), parts.link("#add", "to be added")),
    )


# ---- ranking ---------------------------------------------------------------------------------------------------------


def ranking_section(answer: Mapping[str, Any], responses: Sequence[Response]) -> Section:
    """Candidates that were fitted, best first, and what each of them would do."""
    if not answer["candidates"]:
        return Section("Ranking", [parts.Paragraph("No effect was fitted.")], id="ranking")
    text = """Effects that were fitted in the simulator, one at a time. The posterior is the probability of each among
        these, all equally likely before. The misfit is the sum of squared departures in standard deviations, with the
        weather record and the mean of the clear frames fitted beside the effect; the gain is how much of it the effect
        takes away."""
    if not answer["effects"]:
        text += " No effect explains enough to be named."
    heads: parts.Heads = [
        "Effect",
        parts.Column("Best parameters", "words"),
        parts.Column("Posterior", "left"),
        "Gain",
        "Misfit left",
    ]
    found: list[parts.Part] = [
        parts.Paragraph(text),
        parts.Table(heads, list(_candidates(answer["candidates"], answer)), look="tops"),
    ]
    for one in answer.get("added", []):
        if one["candidates"]:
            beside = listed([effect_name(name) for name in one["beside"]])
            found += [
                parts.Heading(f"Beside {beside}" if beside else "Pairs", "fitted together with what was found before"),
                parts.Table(heads, list(_candidates(one["candidates"], answer)), look="tops"),
            ]
    if responses:
        curves = """Response curves: by how much each effect, at its best parameters, changes the simulation of the
            statistics that depart most, and what was measured. All conditions together; above in their own unit, below
            in standard deviations of chance."""
        figures = [
            parts.Figure(
                response_uri(members),
                f"{statistic_name(statistic)} by {along(axis)}: measured, and what each fitted effect would do",
                title=statistic_name(statistic),
                small=f"by {along(axis)}",
                look="chart",
            )
            for (statistic, axis), members in by_statistic(responses).items()
        ]
        found += [parts.Heading("What each of them would do"), parts.Paragraph(curves)]
        found.append(parts.Pictures(figures, across=2, look="roomy"))
    return Section("Ranking", found, id="ranking")


def _candidates(
    candidates: Sequence[Mapping[str, Any]], answer: Mapping[str, Any]
) -> Sequence[Sequence[parts.Cell | str]]:
    """Fitted candidates of a round, best first."""
    named = {effect["name"] for effect in answer["effects"]}
    rivals = {rival for effect in answer["effects"] for rival in effect["confusable_with"]}
    rows = []
    for one in candidates:
        name = one["name"]
        known = EFFECTS.get(name)
        interval = {key: [value, value] for key, value in one["parameters"].items() if _departs(known, key, value)}
        at_bound = one.get("at_bound", {})
        values = [
            f"{row['words']} (the {at_bound[row['name']]} searched)" if row["name"] in at_bound else row["words"]
            for row in parameter_rows({**one, "interval": interval})
        ]
        look = "named" if name in named else "rival" if name in rivals else ""
        rows.append(
            (
                parts.Cell(effect_name(name), [known.title if known else ""], "strong" if name in named else ""),
                ", ".join(values),
                parts.Cell(posterior_text(one["weight"]), look=look, bar_px=round(BAR_PX * one["weight"])),
                number_text(max(one["gain"], 0.0)),
                number_text(one["misfit"]),
            )
        )
    return rows


def _departs(effect: Any, parameter: str, value: float | str) -> bool:
    """True for a parameter away from its identity value."""
    declared = {one.name: one.identity for one in effect.arguments} if effect else {}
    return declared.get(parameter) != float(value)
