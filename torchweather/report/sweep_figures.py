"""Figures of the sweep's page: a score against the weather, and points from above."""

from __future__ import annotations

from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray
from torch import Tensor

from torchweather.evaluation.sweep import Series
from torchweather.report.figures import MUTED, SHADES, STYLE, plain_axes, png_figure_uri, svg_uri
from torchweather.report.lidar_figures import AHEAD_M, COLOURS, axes_from_above

__all__ = ["ACROSS", "AXES", "MISS", "NAMES", "points_above_uri", "score_uri"]

NAMES = {
    "psnr": "PSNR, dB",
    "ssim": "SSIM",
    "ms_ssim": "MS-SSIM",
    "cw_ssim": "CW-SSIM",
    "iw_ssim": "IW-SSIM",
    "dss": "DSS",
    "vif": "VIF",
    "vsi": "VSI",
    "fsim": "FSIM",
    "sr_sim": "SR-SIM",
    "haarpsi": "HaarPSI",
    "gmsd": "GMSD",
    "ms_gmsd": "MS-GMSD",
    "mdsi": "MDSI",
    "sdm": "SDM",
    "rmse": "RMSE, m",
    "mde": "MDE, m",
    "mmde": "MMDE, m",
    "hd": "HD, m",
    "hd95": "HD95, m",
}
"""Of the scores, as the page writes them, with their unit."""

ACROSS = {"camera": 3, "lidar": 6, "radar": 6}  # pictures in a row: frames are wide
AXES = {"rate_mm_per_h": "rate, mm/h", "mor_m": "visibility, m"}
BETTER = {"up": "↑ better", "down": "↓ better"}
MISS = "#c2570c"  # orange beside the blues and greens of the weathers: told apart by every eye
LOG_FROM = 8.0  # a knob that spans more than this factor gets a logarithmic axis
MARGIN = 0.07

Floats = NDArray[np.float64]


def score_uri(series: Series, metric: str, *, follows: bool) -> str:
    """A score against the weather: mean as a line, lowest and highest of subjects and seeds as a band.

    The weather gets heavier to the right, so visibility falls to the right.
    """
    values = np.array([level.value for level in series.levels])
    log = bool(values.max() > LOG_FROM * values.min())
    place = np.log10(values) if log else values
    scores = series.scores[metric]
    shown = np.where(np.isfinite(scores), scores, np.nan)
    there = ~np.isnan(shown).all(1)
    shades = SHADES[series.levels[0].kind]
    colour = shades[len(shades) // 2] if follows else MISS
    with mpl.rc_context({**STYLE, "font.size": 9.0}):
        figure = Figure(figsize=(3.0, 2.2))
        axes = figure.add_axes((0.19, 0.2, 0.77, 0.655))
        plain_axes(axes)
        if there.any():
            low, high = np.nanmin(shown[there], 1), np.nanmax(shown[there], 1)
            axes.fill_between(place[there], low, high, color=colour, alpha=0.22, linewidth=0)
            axes.plot(place[there], np.nanmean(shown[there], 1), "-o", color=colour, linewidth=1.8, markersize=4)
        else:
            axes.text(0.5, 0.5, "not finite", transform=axes.transAxes, ha="center", color=MUTED)
        axes.set_xticks(place, labels=[f"{value:g}" for value in values])
        axes.minorticks_off()
        span = np.ptp(place)
        ends = (place.min() - MARGIN * span, place.max() + MARGIN * span)
        axes.set_xlim(ends if values[-1] > values[0] else ends[::-1])
        axes.margins(y=0.12)
        if there.any() and np.nanmin(shown) == np.nanmax(shown) == 0.0:
            axes.set_ylim(-0.1, 1.0)  # of distances that are all 0 nothing below it is shown
        axes.yaxis.set_major_locator(MaxNLocator(4))
        axes.ticklabel_format(axis="y", useOffset=False)
        axes.set_xlabel(AXES[series.levels[0].knob], labelpad=2)
        axes.set_title(NAMES.get(metric, metric), loc="left", pad=5)
        axes.set_title(
            BETTER[series.directions[metric]], loc="right", pad=5, color=MUTED, fontsize=8.5, weight="normal"
        )
        return svg_uri(figure)


def points_above_uri(points: Tensor, clear: Tensor) -> str:
    """Detections from above, the sensor at the origin, ahead is up; those of clear air as rings."""
    with mpl.rc_context({**STYLE, "font.size": 9.0}):
        figure, axes = axes_from_above(8.0, AHEAD_M + 20.0)
        ring: dict[str, Any] = {"markersize": 7, "markerfacecolor": "none", "markeredgecolor": COLOURS["lost"]}
        axes.plot(-clear[:, 1].numpy(), clear[:, 0].numpy(), "o", zorder=3, **ring)
        axes.plot(-points[:, 1].numpy(), points[:, 0].numpy(), ".", color=COLOURS["object"], markersize=5, zorder=4)
        return png_figure_uri(figure, dpi=150)
