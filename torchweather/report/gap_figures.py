"""Figures of the gap's page: statistics along their axes before and after, and the held-out gap beside its floor."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from torchweather.gap.gap_report import Curve
from torchweather.report.correlation_figures import MARKS
from torchweather.report.figures import INK, MUTED, STYLE, plain_axes, svg_uri
from torchweather.report.gap_words import axis_name, edge_text
from torchweather.report.tables import number_text

__all__ = ["AFTER", "BAND", "BEFORE", "curve_uri", "gap_uri"]

BEFORE, AFTER = "#e03131", "#1c7ed6"
BAND = "#dde3e9"
# Departures within so many scatters are drawn to scale, larger ones nearly as their logarithm (asinh).
TO_SCALE = 3.0
TICKS = (-1000, -300, -100, -30, -10, -3, 0, 3, 10, 30, 100, 300, 1000)
MOST_LABELS = 12
ROOM = 1.25
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
        axes = figure.add_axes((0.125, 0.185, 0.845, 0.785))
        plain_axes(axes)
        axes.grid(axis="x", visible=False)
        axes.axhspan(_scaled(-1.0), _scaled(1.0), color=BAND, linewidth=0, zorder=0)
        axes.axhline(0.0, color=MUTED, linewidth=0.8, zorder=1)
        aside = np.linspace(-0.22, 0.22, len(curves)) if len(curves) > 1 else np.zeros(1)
        for number, (one, shift) in enumerate(zip(curves, aside, strict=True)):
            mark = MARKS[number % len(MARKS)]
            line: dict[str, Any] = {"marker": mark, "markersize": 4.5, "linewidth": 1.0}
            axes.plot(bins + shift, _scaled(one.before), color=BEFORE, alpha=0.85, zorder=3, **line)
            if one.after is not None:
                hollow: dict[str, Any] = {"color": AFTER, "markerfacecolor": "white", "markeredgewidth": 1.2}
                axes.plot(bins + shift, _scaled(one.after), zorder=4, **hollow, **line)
        lowest = min([-LEAST_SPAN, *(float(np.nanmin(values)) for values in known)])
        highest = max([LEAST_SPAN, *(float(np.nanmax(values)) for values in known)])
        axes.set_ylim(_scaled(ROOM * lowest), _scaled(ROOM * highest))
        ticks = [tick for tick in TICKS if ROOM * lowest <= tick <= ROOM * highest]
        axes.set_yticks([_scaled(tick) for tick in ticks], labels=[f"{tick}".replace("-", "−") for tick in ticks])
        labels = [edge_text(first.axis, edge) for edge in first.edges]
        every = math.ceil(len(labels) / MOST_LABELS)
        axes.set_xticks(np.arange(len(labels))[::every] - 0.5, labels=labels[::every])
        axes.set_xlim(-0.5, len(bins) - 0.5)
        axes.set_xlabel(axis_name(first.axis), labelpad=3)
        axes.set_ylabel("measured − simulated, scatters")
        axes.yaxis.set_label_coords(-0.1, 0.5)
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


def _scaled(value: Any) -> Any:
    """Departures on the scale of the figure."""
    return np.arcsinh(np.asarray(value, dtype=np.float64) / TO_SCALE)
