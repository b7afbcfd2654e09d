"""Pictures of a radar's frame: range-Doppler map, points from above, and the bars of their colours."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import matplotlib as mpl
import numpy as np
import torch
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap, Normalize
from matplotlib.figure import Figure
from matplotlib.patches import Polygon
from matplotlib.ticker import MaxNLocator
from torch import Tensor

from torchweather.radar.sensor import Radar
from torchweather.report.figures import STYLE, png_figure_uri
from torchweather.report.radar_views import RadarFrame

__all__ = ["OTHER", "above_uri", "axes_ahead", "bar_uri", "coloured_points", "map_uri", "power_scale"]

# Orange on dark and on white: told apart from either scale by every eye.
OTHER = "#ff7f0e"
MAP_COLOURS = mpl.colormaps["viridis"]
# Without the palest third, which is lost on white; the strongest is the darkest.
POINT_COLOURS = ListedColormap(mpl.colormaps["YlGnBu"](np.linspace(0.35, 1.0, 256)))
BOX, RING = "#8695a3", "#c3ccd5"
ASIDE_M = 25.0
STEP_DB = 10.0


def power_scale(power_dbm: Tensor, low: float, high: float) -> tuple[float, float]:
    """Ends of a scale of colours, whole tens of dBm, that hold the powers from one quantile to another.

    Example:
        >>> power_scale(torch.tensor([-127.0, -127.0, -91.0]), 0.5, 1.0)
        (-130.0, -90.0)
    """
    ordered = power_dbm.flatten().sort().values
    ends = [float(ordered[round(share * (len(ordered) - 1))]) for share in (low, high)]
    return STEP_DB * math.floor(ends[0] / STEP_DB), STEP_DB * math.ceil(ends[1] / STEP_DB)


def map_uri(frame: RadarFrame, radar: Radar, scale_dbm: tuple[float, float]) -> str:
    """Range-Doppler map with a mark at every cell that became a point; orange: of the weather or of noise."""
    speeds, ranges = radar.max_speed_m_per_s, radar.max_range_m
    half_speed, half_range = 0.5 * radar.speed_resolution_m_per_s, 0.5 * radar.range_resolution_m
    with mpl.rc_context({**STYLE, "font.size": 10.5}):
        figure = Figure(figsize=(3.3, 2.75))
        axes = figure.add_axes((0.165, 0.185, 0.81, 0.795))
        axes.imshow(
            frame.power_dbm.numpy(),
            extent=(-half_range, ranges - half_range, -speeds - half_speed, speeds - half_speed),
            origin="lower",
            aspect="auto",
            interpolation="nearest",
            cmap=MAP_COLOURS,
            norm=Normalize(*scale_dbm),
        )
        speed = (frame.cell[:, 0].numpy() - radar.chirps // 2) * radar.speed_resolution_m_per_s
        range_m = frame.cell[:, 1].numpy() * radar.range_resolution_m
        for which, colour in ((~frame.of_scene, OTHER), (frame.of_scene, "white")):
            chosen = which.numpy()
            axes.plot(
                range_m[chosen],
                speed[chosen],
                "o",
                color="none",
                markeredgecolor=colour,
                markersize=4.0,
                markeredgewidth=0.7,
            )
        axes.set_xlim(-half_range, ranges)
        axes.set_ylim(-speeds, speeds)
        # Ticks with decimals would push the label out.
        axes.yaxis.set_major_locator(MaxNLocator(nbins=8, integer=True, steps=[1, 2, 5, 10]))
        axes.set_xlabel("range, m", labelpad=1)
        axes.set_ylabel("speed, m/s", labelpad=-2)
        return png_figure_uri(figure, dpi=190)


def above_uri(frame: RadarFrame, boxes: Tensor, radar: Radar, scale_dbm: tuple[float, float]) -> str:
    """Points from above, the radar at the origin, ahead is up; boxes of the road users."""
    with mpl.rc_context({**STYLE, "font.size": 10.5}):
        box_in = (0.15, 0.105, 0.83, 0.885)
        figure, axes = axes_ahead((3.3, 4.6), box_in, ASIDE_M, radar.max_range_m, rings_m=(20.0, 40.0, 60.0), tick_m=20)
        for box in boxes.tolist():
            _outline(axes, box)
        points = frame.points
        other, scene = points[~frame.of_scene], points[frame.of_scene]
        axes.plot(-other[:, 1].numpy(), other[:, 0].numpy(), "x", color=OTHER, markersize=3.6, markeredgewidth=1.0)
        coloured_points(axes, scene, scene[:, 4], scale_dbm, size=16.0)
        return png_figure_uri(figure, dpi=190)


def axes_ahead(
    size: tuple[float, float],
    box: tuple[float, float, float, float],
    aside_m: float,
    far_m: float,
    *,
    rings_m: Sequence[float],
    tick_m: int,
) -> tuple[Figure, Axes]:
    """Axes of points from above, ahead is up: the radar as a triangle, arcs of equal range."""
    figure = Figure(figsize=size)
    axes = figure.add_axes(box)
    angle = np.linspace(-np.pi / 2, np.pi / 2, 121)
    for radius in rings_m:
        axes.plot(radius * np.sin(angle), radius * np.cos(angle), color=RING, linewidth=0.7, zorder=0)
    axes.plot(0, 0, marker="^", color="white", markeredgecolor="#1b2733", markersize=6, zorder=9, clip_on=False)
    axes.set_aspect("equal", adjustable="box")
    axes.set_xlim(-aside_m, aside_m)
    axes.set_ylim(0, far_m)
    axes.set_xticks([-tick_m, 0, tick_m], labels=[f"{tick_m}", "0", f"{tick_m}"])
    axes.set_xlabel("left and right, m", labelpad=1)
    axes.set_ylabel("ahead, m", labelpad=0)
    return figure, axes


def coloured_points(axes: Axes, points: Tensor, power: Tensor, scale: tuple[float, float], *, size: float) -> None:
    """Points from above, coloured by their power."""
    colours: dict[str, Any] = {"cmap": POINT_COLOURS, "norm": Normalize(*scale), "linewidths": 0.0, "zorder": 4}
    axes.scatter(-points[:, 1].numpy(), points[:, 0].numpy(), c=power.numpy(), s=size, **colours)


def _outline(axes: Axes, box: list[float]) -> None:
    """A box's outline on the ground."""
    x, y, _, length, width, _, yaw = box
    corners = torch.tensor([(1, 1), (1, -1), (-1, -1), (-1, 1)], dtype=torch.float64)
    corners = corners * torch.tensor([length / 2, width / 2], dtype=torch.float64)
    cos, sin = math.cos(yaw), math.sin(yaw)
    ahead = x + cos * corners[:, 0] - sin * corners[:, 1]
    left = y + sin * corners[:, 0] + cos * corners[:, 1]
    outline = torch.stack([-left, ahead], -1).numpy()
    axes.add_patch(Polygon(outline, closed=True, fill=False, edgecolor=BOX, linewidth=1.0, zorder=2))


def bar_uri(kind: str, scale_dbm: tuple[float, float], label: str) -> str:
    """Bar of the colours of the maps or of the points (``map``, ``points``)."""
    colours = {"map": MAP_COLOURS, "points": POINT_COLOURS}[kind]
    with mpl.rc_context({**STYLE, "font.size": 10.0}):
        figure = Figure(figsize=(4.6, 0.62))
        axes = figure.add_axes((0.03, 0.68, 0.94, 0.26))
        bar = figure.colorbar(
            mpl.cm.ScalarMappable(Normalize(*scale_dbm), colours), cax=axes, orientation="horizontal", extend="both"
        )
        bar.ax.xaxis.set_major_locator(MaxNLocator(nbins=8, integer=True, steps=[1, 2, 5, 10]))
        bar.outline.set_visible(False)
        bar.set_label(label, labelpad=1)
        axes.tick_params(labelsize=9, length=2)
        return png_figure_uri(figure, dpi=190)
