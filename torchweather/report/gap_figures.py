"""Figures of the gap's page: statistics along their axes before and after, responses of the effects that were fitted,
the map of all statistics, the curve that nothing explains, and the held-out departure beside a perfect model's.

Curves have two panels: in the statistic's own unit, and in standard deviations of chance.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from itertools import pairwise
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, NullLocator
from numpy.typing import NDArray

from torchweather.gap.gap_report import BinDeparture, Curve, ResidualMap, Response
from torchweather.report.correlation_figures import MARKS
from torchweather.report.figures import INK, MUTED, STYLE, plain_axes, svg_uri
from torchweather.report.gap_words import WHOLE, axis_name, curve_unit, edge_text, effect_name, group_name
from torchweather.report.tables import number_text, signed_text

__all__ = ["AFTER", "BAND", "BEFORE", "curve_uri", "gap_uri", "residual_uri", "response_uri", "unknown_uri"]

BEFORE, AFTER = "#e03131", "#1c7ed6"
BAND = "#dde3e9"
# Departures within LINEAR_TO standard deviations have a linear axis; beyond it those past TO_SCALE are drawn nearly as
# their logarithm (asinh).
LINEAR_TO, TO_SCALE = 15.0, 3.0
TICKS = (-1000, -300, -100, -30, -10, -3, 0, 3, 10, 30, 100, 300, 1000)
MOST_LABELS = 12
ROOM = 1.25
# Of the effects of a response figure, the best first; told apart without colour by their dashes.
LINES = (("#1c7ed6", "-"), ("#e8590c", (0, (5, 2))), ("#2b8a3e", (0, (2, 1.5))), ("#862e9c", (0, (5, 1.5, 1, 1.5))))
SHORT = 9.95  # from which a number of a map has no decimals
NO_DEPARTURE = 0.05  # standard deviations, of a row of a map
LARGEST = "as it is: the largest, measured less simulated"
LETTER = 0.073  # inch, of a label of a map
# Root mean square departures of a map: where its colours begin (chance) and end.
MAP_FROM, MAP_TO = 1.0, 30.0
LEAST_SPAN = 4.0  # in standard deviations, either side of zero, so that a curve inside the band looks small

CENTRAL_90 = 1.6449  # standard deviations of a normal law
CLASSES: dict[str, dict[int, str]] = {"target_class": {}, "isolated": {0: "extended", 1: "thin"}}  # axes without edges

Floats = NDArray[np.float64]


def curve_uri(curves: Sequence[Curve]) -> str:
    """One statistic along its axis in all conditions: before as filled marks, after as hollow ones, the band grey.

    Args:
        curves: of one statistic and axis, one a condition; at most as many conditions as ``MARKS`` are told apart.
    """
    first = curves[0]
    bins = np.arange(len(first.edges) - 1)
    natural = [one.natural for one in curves if one.natural is not None]
    with mpl.rc_context({**STYLE, "font.size": 9.5}):
        figure, panels = _panels(len(natural) == len(curves))
        known = _known([one.before for one in curves] + [one.after for one in curves])
        _departures(panels[-1], known, first, "measured − simulated")
        if len(panels) > 1:
            values = _known([one.before for one in natural] + [one.after for one in natural])
            chance = _middle([one.chance for one in natural])
            _natural(panels[0], values, first, f"measured − simulated,\n{natural[0].unit}", chance)
        aside = np.linspace(-0.22, 0.22, len(curves)) if len(curves) > 1 else np.zeros(1)
        for number, (one, shift) in enumerate(zip(curves, aside, strict=True)):
            drawn = [(panels[-1], one.before, one.after)]
            if len(panels) > 1 and one.natural is not None:
                drawn.append((panels[0], one.natural.before, one.natural.after))
            line: dict[str, Any] = {"marker": MARKS[number % len(MARKS)], "markersize": 4.5, "linewidth": 1.0}
            for axes, before, after in drawn:
                axes.plot(bins + shift, before, color=BEFORE, alpha=0.85, zorder=3, **line)
                if after is not None:
                    hollow: dict[str, Any] = {"color": AFTER, "markerfacecolor": "white", "markeredgewidth": 1.2}
                    axes.plot(bins + shift, after, zorder=4, **hollow, **line)
        return svg_uri(figure)


def response_uri(responses: Sequence[Response]) -> str:
    """Measured change beside the response of each fitted effect, one statistic along its axis, all conditions together.

    Args:
        responses: of one statistic and axis, the measurement first; at most as many effects as ``LINES``.
    """
    first, *effects = responses
    bins = np.arange(len(first.edges) - 1)
    with mpl.rc_context({**STYLE, "font.size": 9.5}):
        figure, panels = _panels(all(one.natural is not None for one in responses), legend=True)
        _departures(panels[-1], _known([one.values for one in responses]), first, "change")
        shown: list[tuple[Axes, Callable[[Response], Any]]] = [(panels[-1], lambda one: one.values)]
        if len(panels) > 1:
            _natural(panels[0], _known([one.natural for one in responses]), first, f"change,\n{first.unit}", None)
            shown.append((panels[0], lambda one: one.natural))
        for axes, values in shown:
            for one, (colour, dashes) in zip(effects[: len(LINES)], LINES, strict=False):
                label = effect_name(one.effect or "") if axes is panels[0] else None
                line: dict[str, Any] = {
                    "color": colour,
                    "linestyle": dashes,
                    "linewidth": 1.6,
                    "marker": ".",
                    "markersize": 4,
                }
                axes.plot(bins, values(one), zorder=3, label=label, **line)
            dots: dict[str, Any] = {"color": INK, "marker": "o", "linestyle": "none", "markersize": 4.5}
            axes.plot(bins, values(first), zorder=4, label="measured" if axes is panels[0] else None, **dots)
        figure.legend(loc="upper left", bbox_to_anchor=(0.115, 1.0), ncols=3, frameon=False, fontsize=9.0)
        return svg_uri(figure)


def residual_uri(residuals: ResidualMap) -> str:
    """Statistics by conditions, the departure as a colour and a number, before and with the best fit; beside them the
    largest departure of each in its own unit."""
    panels = [("the simulation as it is", residuals.before)]
    if residuals.after is not None:
        panels.append(("with the best fit", residuals.after))
    shown = [bool(np.isfinite(row).any()) for row in residuals.before]
    labels = [group_name(*group) for group, keep in zip(residuals.groups, shown, strict=True) if keep]
    columns = len(residuals.conditions)
    # Wide enough for the title of a panel.
    cell, row = max(0.55, 1.7 / columns), 0.235
    left = 0.2 + LETTER * max(map(len, labels), default=0)
    # A row that shows 0.0 everywhere has no departure to speak of.
    quiet = [not bool((row[np.isfinite(row)] >= NO_DEPARTURE).any()) for row in residuals.before]
    natural = [
        _in_own_unit(*group, None if none else one)
        for group, one, none in zip(residuals.groups, residuals.largest, quiet, strict=False)
    ]
    natural = [one for one, keep in zip(natural, shown, strict=False) if keep]
    right = 0.1 + LETTER * max(len(one) for one in (*natural, LARGEST)) if natural else 0.0
    width = left + len(panels) * (columns * cell + 0.3) + right
    longest = max(map(len, residuals.conditions), default=0)
    slanted = longest * LETTER > cell  # names that would run into each other
    height = 0.75 + row * len(labels) + (0.6 * LETTER * longest if slanted else 0.0)
    with mpl.rc_context({**STYLE, "font.size": 9.0}):
        figure = Figure(figsize=(width, height))
        for number, (title, values) in enumerate(panels):
            start = left + number * (columns * cell + 0.3)
            box = (start / width, 0.1 / height, columns * cell / width, row * len(labels) / height)
            axes = figure.add_axes(box)
            part = values[np.array(shown)]
            share = np.log(np.clip(part, MAP_FROM, MAP_TO) / MAP_FROM) / math.log(MAP_TO / MAP_FROM)
            axes.imshow(np.where(np.isfinite(part), share, np.nan), cmap="OrRd", vmin=0.0, vmax=1.15, aspect="auto")
            for (y, x), value in np.ndenumerate(part):
                dark = np.isfinite(value) and share[y, x] > 0.65
                text = f"{value:.{0 if value >= SHORT else 1}f}" if np.isfinite(value) else "–"
                axes.text(x, y, text, ha="center", va="center", fontsize=8.0, color="white" if dark else INK)
            axes.set_xticks(range(columns), labels=residuals.conditions)
            axes.xaxis.tick_top()
            if slanted:
                for label in axes.get_xticklabels():
                    label.set(rotation=40.0, ha="left", rotation_mode="anchor")
            axes.set_yticks(range(len(labels)), labels=labels if number == 0 else [""] * len(labels))
            axes.tick_params(length=0, labelcolor=INK)
            axes.set_title(title, fontsize=9.5, pad=6)
            for side in axes.spines.values():
                side.set_visible(False)
        for place, text in enumerate(natural):
            axes.text(columns - 0.5 + 0.1 / cell, place, text, va="center", fontsize=8.5, color=INK)
        if natural:
            axes.text(columns - 0.5 + 0.1 / cell, -1.0, LARGEST, va="bottom", fontsize=8.5, color=MUTED)
        return svg_uri(figure)


def _in_own_unit(statistic: str, axis: str, one: BinDeparture | None) -> str:
    """A bin's departure in the unit of its statistic, and where the bin lies."""
    if one is None:
        return ""
    found = f"{signed_text(one.value, plus=True)} {one.unit}"
    if axis in WHOLE or axis in CLASSES:
        return found
    low, high = (edge_text(axis, end) for end in (one.low, one.high))
    unit = axis_name(axis).rpartition(", ")[2] if ", " in axis_name(axis) else ""
    where = f"above {low}" if high == "∞" else f"{low} to {high}"
    return f"{found}, {where} {unit}".rstrip()


def unknown_uri(axis: str, curve: Mapping[str, Any], formula: Mapping[str, Any] | None) -> str:
    """The curve that no effect explains in natural units with its central 90 % and the simplest formula through it;
    below, the same in standard deviations.

    Args:
        axis: its name.
        curve, formula: of the answer's ``unknown``.
    """
    edges = tuple(float(edge) for edge in curve["edges"])
    unit, factor = curve_unit(str(curve["unit"]))
    value, low, high = (factor * _numbers(curve[name]) for name in ("value", "low", "high"))
    bins = np.arange(len(value))
    with mpl.rc_context({**STYLE, "font.size": 9.5}):
        figure, (axes, below) = _panels(True, legend=True)
        known = np.isfinite(value)
        first = Response("", axis, edges, None, value)
        _natural(axes, [low[known], high[known]] if known.any() else [], first, unit, None)
        axes.bar(bins[known], (high - low)[known], bottom=low[known], width=0.86, color="#f3c6c6", zorder=2)
        axes.plot(bins, value, "o", color=BEFORE, markersize=4.5, zorder=4, label="measured − simulated, 90 %")
        if formula is not None:
            line = factor * _numbers(formula["values"])
            axes.plot(bins, line, color=INK, linewidth=1.4, zorder=5, label="formula, mean over each bin")
        error = 0.5 * (high - low) / CENTRAL_90
        z = np.where(error > 0, value / np.where(error > 0, error, 1.0), np.nan)
        _departures(below, _known([z]), first, "measured − simulated")
        below.plot(bins, z, "o", color=BEFORE, markersize=4.5, zorder=4)
        figure.legend(loc="upper left", bbox_to_anchor=(0.125, 1.005), ncols=2, frameon=False, fontsize=9.0)
        return svg_uri(figure)


def gap_uri(gap: Mapping[str, Any], *, added: bool) -> str:
    """The held-out departure before and after beside that of a perfect model, from zero.

    Args:
        gap: of the answer.
        added: whether an effect was added; without one there is nothing after.
    """
    floor, (low, high) = float(gap["floor"]), (float(end) for end in gap["interval_after"])
    rows = [("before", float(gap["before"]), BEFORE), ("after", float(gap["after"]), AFTER)]
    rows = rows if added else [("as it is", *rows[0][1:])]
    last = len(rows) - 1
    with mpl.rc_context({**STYLE, "font.size": 10.5}):
        height = 1.25 + 0.3 * len(rows)
        figure = Figure(figsize=(6.4, height))
        axes = figure.add_axes((0.11, 0.6 / height, 0.77, 1.0 - 0.9 / height))
        plain_axes(axes)
        axes.grid(axis="y", visible=False)
        axes.axvline(floor, color=MUTED, linewidth=1.2, linestyle=(0, (4, 3)), zorder=2)
        axes.text(
            floor, -0.62, f"a perfect model: {number_text(floor)}", color=MUTED, fontsize=9.5, ha="left", va="bottom"
        )
        axes.plot((low, high), (last, last), color=rows[-1][2], linewidth=5, alpha=0.3, solid_capstyle="butt", zorder=3)
        for place, (_, value, colour) in enumerate(rows):
            axes.plot(value, place, "o", color=colour, markersize=9, zorder=4)
            beside = (max(value, high) if place == last else value, place)
            text: dict[str, Any] = {"textcoords": "offset points", "va": "center", "fontweight": "bold"}
            axes.annotate(number_text(value), beside, (10, 0), **text)
        axes.set_ylim(last + 0.5, -0.55)
        axes.set_xlim(0.0, 1.06 * max(high, floor, 1e-9, *(value for _, value, _ in rows)))
        axes.set_yticks(range(len(rows)), labels=[label for label, _, _ in rows])
        axes.tick_params(axis="y", length=0, labelcolor=INK)
        axes.set_xlabel("departure of held-out conditions, root mean square, standard deviations")
        return svg_uri(figure)


def _panels(two: bool, *, legend: bool = False) -> tuple[Figure, list[Axes]]:
    """A figure with one panel, or with the natural units above and standard deviations below."""
    height = (4.9 if two else 3.1) + (0.35 if legend else 0.0)
    figure = Figure(figsize=(5.6, height))
    top, bottom, between = (0.45 if legend else 0.1), 0.52, 0.18
    each = (height - top - bottom - between * two) / (1 + two)
    boxes = [(0.15, bottom / height, 0.82, each / height)]
    if two:
        boxes.insert(0, (0.15, (bottom + each + between) / height, 0.82, each / height))
    return figure, [figure.add_axes(box) for box in boxes]


def _bins_along(axes: Axes, axis: str, edges: Sequence[float], *, labelled: bool = True) -> None:
    """Bins side by side, their edges as labels; classes have theirs in the middle."""
    if axis in CLASSES:
        middles = [round(0.5 * (low + high)) for low, high in pairwise(edges)]
        labels = [CLASSES[axis].get(one, f"{one}") for one in middles]
        places = [float(one) for one in range(len(middles))]
    else:
        labels = [edge_text(axis, edge) for edge in edges]
        places = [one - 0.5 for one in range(len(edges))]
    every = math.ceil(len(labels) / MOST_LABELS)
    axes.set_xticks(places[::every], labels=labels[::every] if labelled else [""] * len(labels[::every]))
    axes.set_xlim(-0.5, len(edges) - 1.5)
    if labelled:
        axes.set_xlabel(axis_name(axis), labelpad=3)


def _natural(axes: Axes, known: Sequence[Floats], first: Curve | Response, label: str, chance: Floats | None) -> None:
    """Axes in natural units, linear, with a band of one standard deviation of chance in each bin."""
    plain_axes(axes)
    axes.grid(axis="x", visible=False)
    axes.axhline(0.0, color=MUTED, linewidth=0.8, zorder=1)
    _bins_along(axes, first.axis, first.edges, labelled=False)
    lowest = min([0.0, *(float(np.nanmin(values)) for values in known)])
    highest = max([0.0, *(float(np.nanmax(values)) for values in known)])
    if chance is not None and np.isfinite(chance).any():
        bins = np.arange(len(chance))
        some = np.isfinite(chance)
        axes.bar(bins[some], 2.0 * chance[some], bottom=-chance[some], width=1.0, color=BAND, zorder=0)
        widest = float(np.median(chance[some]))
        lowest, highest = min(lowest, -2.0 * widest), max(highest, 2.0 * widest)
    room = 0.12 * (highest - lowest) or 1.0
    axes.set_ylim(lowest - room, highest + room)
    axes.yaxis.set_major_formatter(FuncFormatter(lambda value, place: f"{value:.6g}".replace("-", "−")))
    axes.set_ylabel(label)
    axes.yaxis.set_label_coords(-0.105, 0.5)


def _departures(axes: Axes, known: Sequence[Floats], first: Curve | Response, label: str) -> None:
    """Axes with departures in standard deviations, the bins of a curve along, and a band of chance.

    Linear where the largest is within ``LINEAR_TO``; else on an axis that is nearly logarithmic far out, and says so.
    """
    plain_axes(axes)
    axes.grid(axis="x", visible=False)
    lowest = ROOM * min([-LEAST_SPAN, *(float(np.nanmin(values)) for values in known)])
    highest = ROOM * max([LEAST_SPAN, *(float(np.nanmax(values)) for values in known)])
    compressed = max(-lowest, highest) > LINEAR_TO
    if compressed:
        axes.set_yscale("function", functions=(_scaled, _unscaled))
        ticks = [tick for tick in TICKS if lowest <= tick <= highest]
        axes.set_yticks(ticks, labels=[f"{tick}".replace("-", "−") for tick in ticks])
        axes.yaxis.set_minor_locator(NullLocator())
    else:
        axes.yaxis.set_major_formatter(FuncFormatter(lambda value, place: f"{value:.6g}".replace("-", "−")))
    axes.axhspan(-1.0, 1.0, color=BAND, linewidth=0, zorder=0)
    axes.axhline(0.0, color=MUTED, linewidth=0.8, zorder=1)
    _bins_along(axes, first.axis, first.edges)
    # The panel above says what is drawn.
    note = f"logarithmic beyond ±{TO_SCALE:g}" if compressed else label
    axes.set_ylabel(f"standard deviations,\n{note}")
    axes.yaxis.set_label_coords(-0.105, 0.5)
    axes.set_ylim(lowest, highest)


def _known(values: Sequence[Floats | None]) -> list[Floats]:
    """Those with a number in them."""
    return [one for one in values if one is not None and np.isfinite(one).any()]


def _middle(values: Sequence[Floats]) -> Floats:
    """Median over the conditions in each bin; NaN where none has a number."""
    each = np.stack(values)
    found = np.full(each.shape[1], np.nan)
    some = np.isfinite(each).any(0)
    found[some] = np.nanmedian(each[:, some], 0)
    return found


def _numbers(values: Sequence[float | None]) -> Floats:
    """With NaN for ``None``."""
    return np.array([np.nan if one is None else one for one in values], dtype=np.float64)


def _scaled(value: Any) -> Any:
    """Departures on the scale of the figure."""
    return np.arcsinh(np.asarray(value, dtype=np.float64) / TO_SCALE)


def _unscaled(value: Any) -> Any:
    return TO_SCALE * np.sinh(np.asarray(value, dtype=np.float64))
