"""Figures of the correlation's page: the ranking of the metrics, and each metric against the performance."""

from __future__ import annotations

from collections.abc import Sequence

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from torchweather.metrics.coefficients import abs_interval
from torchweather.metrics.correlation import MetricCorrelation
from torchweather.report.figures import INK, MUTED, SHADES, STYLE, plain_axes, svg_uri
from torchweather.report.sweep_figures import NAMES

__all__ = ["MARKS", "metric_name", "ranking_uri", "scatter_uri", "weather_colours"]

Floats = NDArray[np.float64]

# Of weathers that are none of rain, fog and snow; told apart by every eye.
OTHERS = ("#c2570c", "#6b7785", "#b08a00")
MARKS = "os^DvP"
"""Marks of the weathers in their order, so that colour is not the only difference."""
HIGH = "#14487f"


def metric_name(metric: str, *, unit: bool = True) -> str:
    """A score as the pages write it.

    Example:
        >>> metric_name("ms_ssim"), metric_name("hd95"), metric_name("hd95", unit=False)
        ('MS-SSIM', 'HD95, m', 'HD95')
    """
    name = NAMES.get(metric, metric)
    return name if unit else name.partition(", ")[0]


def weather_colours(kinds: Sequence[str]) -> dict[str, str]:
    """A colour for each kind of weather, in the order of their first condition.

    Example:
        >>> list(weather_colours(["rain", "fog", "rain", "dust"]))
        ['rain', 'fog', 'dust']
    """
    free = iter(OTHERS * len(kinds))
    found: dict[str, str] = {}
    for kind in dict.fromkeys(kinds):
        weather = kind.split()[-1]
        shades = SHADES.get("mixture" if "+" in weather else weather)
        colour = shades[len(shades) // 2] if shades else next(free)
        found[kind] = colour if colour not in found.values() else next(free)
    return found


def ranking_uri(metrics: Sequence[MetricCorrelation], highly: float, low_claims: Sequence[str]) -> str:
    """Size of Spearman's rho of each metric with its 95 % interval, the largest on top.

    Args:
        metrics: those that have a rank.
        highly: drawn as a line.
        low_claims: metrics of which D3.4 says that they do not correlate highly; drawn hollow.
    """
    row, head, foot, side = 0.27, 0.12, 0.52, 1.05  # inches
    width, height = 6.2, head + foot + row * len(metrics)
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(width, height))
        axes = figure.add_axes((side / width, foot / height, 1 - (side + 0.75) / width, 1 - (foot + head) / height))
        plain_axes(axes)
        axes.grid(axis="y", visible=False)
        axes.axvline(highly, color=MUTED, linewidth=1.0, linestyle=(0, (4, 3)), zorder=1)
        for place, each in enumerate(metrics):
            low, high = abs_interval(each.spearman)
            hollow = each.metric in low_claims
            axes.plot((low, high), (place, place), color=HIGH, linewidth=2.2, alpha=0.45, solid_capstyle="round")
            face = "white" if hollow else HIGH
            size = abs(each.spearman.value)
            axes.plot(size, place, "o", markersize=6.5, markerfacecolor=face, markeredgecolor=HIGH, zorder=4)
            text = f"{each.spearman.value:+.2f}".replace("-", "−")
            axes.text(1.045, place, text, va="center", fontsize=9, color=INK, clip_on=False)
        axes.set_ylim(len(metrics) - 0.4, -0.6)
        axes.set_xlim(0.0, 1.02)
        axes.set_yticks(range(len(metrics)), labels=[metric_name(each.metric, unit=False) for each in metrics])
        axes.tick_params(axis="y", length=0, labelcolor=INK)
        axes.set_xticks(np.linspace(0, 1, 6))
        axes.set_xlabel("size of Spearman's rho, with its 95 % interval; at the right with its sign")
        return svg_uri(figure)


def scatter_uri(each: MetricCorrelation, scores: Floats, performance: Floats, kinds: Sequence[str], label: str) -> str:
    """The performance against one metric, a dot a condition, coloured by the weather."""
    colours = weather_colours(kinds)
    finite = np.isfinite(scores)
    with mpl.rc_context({**STYLE, "font.size": 9.0}):
        figure = Figure(figsize=(3.0, 2.35))
        axes = figure.add_axes((0.185, 0.185, 0.785, 0.69))
        plain_axes(axes)
        for number, (kind, colour) in enumerate(colours.items()):
            rows = finite & np.array([other == kind for other in kinds])
            mark = MARKS[number % len(MARKS)]
            axes.plot(scores[rows], performance[rows], mark, color=colour, markersize=5, markeredgewidth=0, alpha=0.85)
        axes.margins(0.08)
        axes.xaxis.set_major_locator(MaxNLocator(4))
        axes.yaxis.set_major_locator(MaxNLocator(5))
        axes.ticklabel_format(useOffset=False)
        axes.set_ylabel(label, labelpad=2)
        axes.set_title(metric_name(each.metric), loc="left", pad=5)
        rho = "" if np.isnan(each.spearman.value) else f"ρ = {each.spearman.value:+.2f}".replace("-", "−")
        axes.set_title(rho, loc="right", pad=5, color=MUTED, fontsize=8.5, weight="normal")
        return svg_uri(figure)
