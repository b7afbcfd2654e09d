"""Figures of the pages: maps with colour bars, transmission against distance, histograms of the raw signal."""

from __future__ import annotations

import io
import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from numpy.typing import NDArray

from torchweather.report.pictures import data_uri

__all__ = [
    "SHADES",
    "STYLE",
    "Curve",
    "histogram_uri",
    "map_uri",
    "plain_axes",
    "png_figure_uri",
    "svg_uri",
    "transmission_uri",
]

Array = NDArray[np.float64]

INK, MUTED, GRID = "#1b2733", "#5f6f7e", "#e6ebf0"
# Light to dark with the strength of the weather.
SHADES = {
    "rain": ("#7fb3e0", "#3d83c4", "#14487f"),
    "fog": ("#2f2a4a", "#5e5791", "#938cc2", "#c3bde0"),
    "snow": ("#8accc0", "#3a9d8f", "#0f5f57"),
    "mixture": ("#a4508b",),
}
CLEAR_FILL, CLEAR_EDGE = "#dfe4ea", "#9aa7b4"
COLOUR_INK = {"red": "#b3261e", "green": "#1f7a3d", "clear": "#5f6f7e", "blue": "#1d4fa8"}
BIN = 0.01  # width of a histogram bin, share of saturation
# Logarithmic axes are drawn as linear ones of log10: matplotlib's own take ten times as long.
LOG_FLOOR = -2.0
SHARE_TICKS = (0.01, 0.1, 1.0, 10.0, 100.0)
DISTANCE_TICKS_M = (2.0, 5.0, 10.0, 20.0, 50.0, 100.0, 200.0)
MAP_TICKS = (0.001, 0.01, 0.1, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0, 200.0)

STYLE: dict[Any, Any] = {
    "font.size": 10.0,
    "font.family": ["DejaVu Sans"],
    "axes.edgecolor": "#b8c3cd",
    "axes.labelcolor": INK,
    "axes.linewidth": 0.8,
    "axes.titlesize": 10.5,
    "axes.titleweight": "bold",
    "xtick.color": MUTED,
    "ytick.color": MUTED,
    "text.color": INK,
    "svg.hashsalt": "torchweather",  # the same page for the same numbers
}


@dataclass(frozen=True)
class Curve:
    """Transmission against distance for one strength of a weather.

    Args:
        label: for the legend.
        line_m, line: what the equations expect.
        dot_m, dot: what was rendered.
    """

    label: str
    line_m: Array
    line: Array
    dot_m: Array
    dot: Array


def svg_uri(figure: Figure) -> str:
    """The figure as an SVG that a page can carry, on no ground; the same numbers give the same text."""
    memory = io.BytesIO()
    nameless = dict.fromkeys(("Date", "Creator", "Format", "Type"))
    figure.savefig(memory, format="svg", metadata=nameless, transparent=True)
    return data_uri(re.sub(rb"\n\s*", b"\n", memory.getvalue()), "image/svg+xml")


def png_figure_uri(figure: Figure, dpi: int) -> str:
    """The figure as a PNG that a page can carry."""
    memory = io.BytesIO()
    figure.savefig(memory, format="png", dpi=dpi, metadata={"Software": None})
    return data_uri(memory.getvalue(), "image/png")


def plain_axes(axes: Axes) -> None:
    """Axes as all figures of the pages have them: no frame above and to the right, a pale grid."""
    axes.spines[["top", "right"]].set_visible(False)
    axes.grid(color=GRID, linewidth=0.8)
    axes.set_axisbelow(True)


def _log(share: Array) -> Array:
    return np.log10(np.maximum(share, 10**LOG_FLOOR))


def _log_ticks(axis: Axis, values: Sequence[float]) -> None:
    axis.set_ticks([float(np.log10(v)) for v in values], labels=[f"{v:g}" for v in values])


def _wrapped(label: str) -> str:
    """A label that fits beside the figure."""
    return label.replace(" in ", "\nin ")


def _shade(kind: str, number: int) -> str:
    shades = SHADES[kind]
    return shades[min(number, len(shades) - 1)]


def transmission_uri(curves: Sequence[Curve], kind: str, distance: str) -> str:
    """Share of the scene's light that arrives, against distance: expectation as lines, rendered pixels as dots."""
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(5.6, 3.7))
        axes = figure.add_axes((0.125, 0.15, 0.845, 0.83))
        plain_axes(axes)
        for number, curve in enumerate(curves):
            colour = _shade(kind, number)
            axes.plot(np.log10(curve.line_m), curve.line, color=colour, linewidth=2, label=curve.label)
            axes.plot(np.log10(curve.dot_m), curve.dot, "o", color=colour, markersize=5, markeredgecolor="white")
        _log_ticks(axes.xaxis, DISTANCE_TICKS_M)
        axes.set_xlim(np.log10(DISTANCE_TICKS_M[0]), np.log10(DISTANCE_TICKS_M[-1]))
        lowest = min(float(curve.line[curve.line_m <= DISTANCE_TICKS_M[-1]].min()) for curve in curves)
        axes.set_ylim(max(0.0, np.floor(10 * lowest - 0.5) / 10), 1.02)
        axes.set_xlabel(f"{distance}, m")
        axes.set_ylabel("share of the scene's light left")
        axes.plot([], [], "o", color=MUTED, markersize=5, label="rendered pixels")
        # Where the curves are not: fog's fall early, those of rain and snow late.
        axes.legend(frameon=False, fontsize=9, loc="lower left" if kind in ("rain", "snow") else "upper right")
        return svg_uri(figure)


def histogram_uri(
    clear: Sequence[tuple[str, Array]], weathers: Sequence[tuple[str, Sequence[tuple[str, Array]]]], kind: str
) -> str:
    """Histograms of the linear raw signal per colour of the filter array, clear frame against weathers.

    Args:
        clear: (colour, values) per colour of the filter array.
        weathers: (label, the same).
        kind: of the weather.
    """
    edges = np.arange(0.0, 1.0 + BIN, BIN)
    ends = [np.quantile(v, 0.999) for _, v in clear] + [np.quantile(v, 0.999) for _, w in weathers for _, v in w]
    last = min(1.0, max(0.2, float(max(ends)) + 0.04))
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(10.4, 3.1))
        for number, (colour, values) in enumerate(clear):
            axes = figure.add_axes((0.062 + number * 0.268, 0.165, 0.238, 0.745))
            plain_axes(axes)
            share = np.histogram(values, edges)[0] * (100 / len(values))
            axes.stairs(_log(share), edges, baseline=LOG_FLOOR, fill=True, color=CLEAR_FILL, label="Clear")
            axes.stairs(_log(share), edges, baseline=LOG_FLOOR, color=CLEAR_EDGE, linewidth=0.8)
            for place, (label, colours) in enumerate(weathers):
                seen = colours[number][1]
                share = np.histogram(seen, edges)[0] * (100 / len(seen))
                axes.stairs(
                    _log(share),
                    edges,
                    baseline=LOG_FLOOR,
                    color=_shade(kind, place),
                    linewidth=1.5,
                    label=_wrapped(label),
                )
            _log_ticks(axes.yaxis, SHARE_TICKS)
            axes.set_ylim(LOG_FLOOR, 2.0)
            axes.set_xlim(0, last)
            axes.set_title(colour, color=COLOUR_INK[colour], loc="left")
            axes.set_xlabel("linear signal, share of saturation")
            if number == 0:
                axes.set_ylabel(f"pixels per {BIN:g} of signal, %")
            else:
                axes.tick_params(labelleft=False)
            if number == len(clear) - 1:
                axes.legend(frameon=False, fontsize=9, loc="upper left", bbox_to_anchor=(1.03, 1.02))
        return svg_uri(figure)


def map_uri(values: Array, label: str, *, low: float, high: float, log: bool, beyond: str | None = None) -> str:
    """A map ``(H, W)`` as a picture with a colour bar in a perceptually uniform scale.

    Args:
        values: the map; what is not finite is drawn in pale grey.
        label: of the colour bar, with unit.
        low, high: its ends.
        log: logarithmic.
        beyond: what the grey means.
    """
    factor = max(1, round(values.shape[1] / 900))
    h, w = (n // factor * factor for n in values.shape)
    small = values[:h, :w].reshape(h // factor, factor, w // factor, factor).mean((1, 3))
    scale = np.log10 if log else np.positive
    shown = np.where(np.isfinite(small), scale(np.clip(small, low, high)), np.nan)
    height = 6.4 * values.shape[0] / values.shape[1]
    footer = 0.62  # inches below the map for its colour bar
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(6.4, height + footer))
        axes = figure.add_axes((0.0, footer / (height + footer), 1.0, height / (height + footer)))
        colours = mpl.colormaps["viridis"].with_extremes(bad="#eef1f4")
        image = axes.imshow(
            shown, norm=Normalize(scale(low), scale(high)), cmap=colours, interpolation="nearest", aspect="auto"
        )
        axes.set_axis_off()
        below = figure.add_axes((0.03, 0.46 / (height + footer), 0.94, 0.09 / (height + footer)))
        ticks = [t for t in MAP_TICKS if low <= t <= high] if log else [low + k * (high - low) / 5 for k in range(6)]
        bar = figure.colorbar(image, cax=below, orientation="horizontal", ticks=[float(scale(t)) for t in ticks])
        bar.set_ticklabels([f"{tick:g}" for tick in ticks])
        below.minorticks_off()
        below.tick_params(labelsize=9, length=2)
        bar.outline.set_visible(False)
        bar.set_label(label if beyond is None else f"{label}   (grey: {beyond})", labelpad=2)
        memory = io.BytesIO()
        figure.savefig(memory, format="jpeg", dpi=140, pil_kwargs={"quality": 84, "optimize": True})
    return data_uri(memory.getvalue(), "image/jpeg")
