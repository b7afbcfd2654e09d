"""Figures of the gap's page: statistics along their axes before and after, responses of the effects that were fitted,
the map of what is left, the curve that nothing explains, and the held-out gap beside its floor."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from torchweather.gap.gap_report import Curve, ResidualMap, Response
from torchweather.report.correlation_figures import MARKS
from torchweather.report.figures import INK, MUTED, STYLE, plain_axes, svg_uri
from torchweather.report.gap_words import axis_name, edge_text, effect_name, group_name
from torchweather.report.tables import number_text

__all__ = ["AFTER", "BAND", "BEFORE", "curve_uri", "gap_uri", "residual_uri", "response_uri", "unknown_uri"]

BEFORE, AFTER = "#e03131", "#1c7ed6"
BAND = "#dde3e9"
# Departures within so many scatters are drawn to scale, larger ones nearly as their logarithm (asinh).
TO_SCALE = 3.0
TICKS = (-1000, -300, -100, -30, -10, -3, 0, 3, 10, 30, 100, 300, 1000)
MOST_LABELS = 12
ROOM = 1.25
# Of the effects of a response figure, the best first; told apart without colour by their dashes.
LINES = (("#1c7ed6", "-"), ("#e8590c", (0, (5, 2))), ("#2b8a3e", (0, (2, 1.5))), ("#862e9c", (0, (5, 1.5, 1, 1.5))))
SHORT = 9.95  # from which a number of a map has no decimals
LETTER = 0.073  # inch, of a label of a map
# Root mean square departures of a map: where its colours begin (chance) and end.
MAP_FROM, MAP_TO = 1.0, 30.0
LEAST_SPAN = 4.0  # in scatters, either side of zero, so that a curve inside the band looks small

Floats = NDArray[np.float64]


def curve_uri(curves: Sequence[Curve]) -> str:
    """One statistic along its axis in all conditions: before as filled marks, after as hollow ones, the band grey.

    Args:
        curves: of one statistic and axis, one a condition; at most as many conditions as ``MARKS`` are told apart.
    """
    first = curves[0]
    bins = np.arange(len(first.edges) - 1)
    known = [v for one in curves for v in (one.before, one.after) if v is not None and np.isfinite(v).any()]
    with mpl.rc_context({**STYLE, "font.size": 9.5}):
        figure = Figure(figsize=(5.6, 3.1))
        axes = _departures(figure, (0.125, 0.185, 0.845, 0.785), known, first, "measured − simulated, scatters")
        aside = np.linspace(-0.22, 0.22, len(curves)) if len(curves) > 1 else np.zeros(1)
        for number, (one, shift) in enumerate(zip(curves, aside, strict=True)):
            mark = MARKS[number % len(MARKS)]
            line: dict[str, Any] = {"marker": mark, "markersize": 4.5, "linewidth": 1.0}
            axes.plot(bins + shift, _scaled(one.before), color=BEFORE, alpha=0.85, zorder=3, **line)
            if one.after is not None:
                hollow: dict[str, Any] = {"color": AFTER, "markerfacecolor": "white", "markeredgewidth": 1.2}
                axes.plot(bins + shift, _scaled(one.after), zorder=4, **hollow, **line)
        return svg_uri(figure)


def response_uri(responses: Sequence[Response]) -> str:
    """Measured change beside the response of each fitted effect, one statistic along its axis, all conditions together.

    Args:
        responses: of one statistic and axis, the measurement first; at most as many effects as ``LINES``.
    """
    first, *effects = responses
    bins = np.arange(len(first.edges) - 1)
    known = [one.values for one in responses if np.isfinite(one.values).any()]
    with mpl.rc_context({**STYLE, "font.size": 9.5}):
        figure = Figure(figsize=(5.6, 3.3))
        axes = _departures(figure, (0.125, 0.175, 0.845, 0.67), known, first, "change, scatters")
        for one, (colour, dashes) in zip(effects[: len(LINES)], LINES, strict=False):
            label = effect_name(one.effect or "")
            axes.plot(bins, _scaled(one.values), color=colour, linestyle=dashes, linewidth=1.6, zorder=3, label=label)
        dots: dict[str, Any] = {"color": INK, "marker": "o", "linestyle": "none", "markersize": 4.5}
        axes.plot(bins, _scaled(first.values), zorder=4, label="measured", **dots)
        figure.legend(loc="upper left", bbox_to_anchor=(0.115, 1.0), ncols=3, frameon=False, fontsize=9.0)
        return svg_uri(figure)


def residual_uri(residuals: ResidualMap) -> str:
    """Statistics by conditions, the departure as a colour and a number, before and with the best fit."""
    panels = [("the simulation as it is", residuals.before)]
    if residuals.after is not None:
        panels.append(("with the best fit", residuals.after))
    shown = [bool(np.isfinite(row).any()) for row in residuals.before]
    labels = [group_name(*group) for group, keep in zip(residuals.groups, shown, strict=True) if keep]
    columns = len(residuals.conditions)
    # Wide enough for the title of a panel.
    cell, row = max(0.55, 1.7 / columns), 0.235
    left = 0.2 + LETTER * max(map(len, labels), default=0)
    width = left + len(panels) * (columns * cell + 0.3)
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
        return svg_uri(figure)


def unknown_uri(axis: str, curve: Mapping[str, Any], formula: Mapping[str, Any] | None) -> str:
    """The curve that no effect explains in natural units with its central 90 %, and the simplest formula through it.

    Args:
        axis: its name.
        curve, formula: of the answer's ``unknown``.
    """
    edges = tuple(float(edge) for edge in curve["edges"])
    value, low, high = (_numbers(curve[name]) for name in ("value", "low", "high"))
    bins = np.arange(len(value))
    with mpl.rc_context({**STYLE, "font.size": 9.5}):
        figure = Figure(figsize=(6.4, 3.5))
        axes = figure.add_axes((0.135, 0.165, 0.84, 0.735))
        plain_axes(axes)
        axes.grid(axis="x", visible=False)
        axes.axhline(0.0, color=MUTED, linewidth=0.8, zorder=1)
        known = np.isfinite(value)
        axes.bar(bins[known], (high - low)[known], bottom=low[known], width=0.86, color="#f3c6c6", zorder=2)
        axes.plot(bins, value, "o", color=BEFORE, markersize=4.5, zorder=4, label="measured − simulated, central 90 %")
        if formula is not None:
            line = _numbers(formula["values"])
            axes.plot(bins, line, color=INK, linewidth=1.4, zorder=5, label="mean of the formula over each bin")
        _bins_along(axes, axis, edges)
        axes.set_ylabel(str(curve["unit"]))
        figure.legend(loc="upper left", bbox_to_anchor=(0.125, 1.005), ncols=2, frameon=False, fontsize=9.0)
        return svg_uri(figure)


def gap_uri(gap: Mapping[str, Any], *, added: bool) -> str:
    """The held-out gap before and after beside the floor, from zero.

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
        axes.text(floor, -0.62, f"floor {number_text(floor)}", color=MUTED, fontsize=9.5, ha="center", va="bottom")
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
        axes.set_xlabel("departure on held-out conditions, root mean square, scatters")
        return svg_uri(figure)


def _bins_along(axes: Axes, axis: str, edges: Sequence[float]) -> None:
    """Bins side by side, their edges as labels."""
    labels = [edge_text(axis, edge) for edge in edges]
    every = math.ceil(len(labels) / MOST_LABELS)
    axes.set_xticks(np.arange(len(labels))[::every] - 0.5, labels=labels[::every])
    axes.set_xlim(-0.5, len(edges) - 1.5)
    axes.set_xlabel(axis_name(axis), labelpad=3)


def _departures(
    figure: Figure, box: tuple[float, float, float, float], known: Sequence[Floats], first: Curve | Response, label: str
) -> Axes:
    """Axes with departures up, with some room, the bins of a curve along, and a band of chance."""
    axes = figure.add_axes(box)
    plain_axes(axes)
    axes.grid(axis="x", visible=False)
    axes.axhspan(_scaled(-1.0), _scaled(1.0), color=BAND, linewidth=0, zorder=0)
    axes.axhline(0.0, color=MUTED, linewidth=0.8, zorder=1)
    _bins_along(axes, first.axis, first.edges)
    axes.set_ylabel(label)
    axes.yaxis.set_label_coords(-0.1, 0.5)
    lowest = min([-LEAST_SPAN, *(float(np.nanmin(values)) for values in known)])
    highest = max([LEAST_SPAN, *(float(np.nanmax(values)) for values in known)])
    axes.set_ylim(_scaled(ROOM * lowest), _scaled(ROOM * highest))
    ticks = [tick for tick in TICKS if ROOM * lowest <= tick <= ROOM * highest]
    axes.set_yticks([_scaled(tick) for tick in ticks], labels=[f"{tick}".replace("-", "−") for tick in ticks])
    return axes


def _numbers(values: Sequence[float | None]) -> Floats:
    """With NaN for ``None``."""
    return np.array([np.nan if one is None else one for one in values], dtype=np.float64)


def _scaled(value: Any) -> Any:
    """Departures on the scale of the figure."""
    return np.arcsinh(np.asarray(value, dtype=np.float64) / TO_SCALE)
