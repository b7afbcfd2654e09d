"""Pictures of point clouds: bird's-eye view and range image, coloured by what each point is."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import matplotlib as mpl
import numpy as np
import torch
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle
from numpy.typing import NDArray
from torch import Tensor

from torchweather.pipeline.point_kind import PointKind
from torchweather.report.figures import STYLE, png_figure_uri
from torchweather.report.lidar_views import WeatherCloud

__all__ = ["COLOURS", "axes_from_above", "birds_eye_uri", "range_images_uri"]

# Orange against blue and grey: told apart by every eye.
COLOURS = {"object": "#33424f", "particle": "#e8590c", "lost": "#8fb8e3"}
RING, RING_TEXT = "#c3ccd5", "#5f6f7e"
RINGS_M = (10.0, 25.0, 50.0, 75.0)
AHEAD_M, BEHIND_M, ASIDE_M = 80.0, 28.0, 33.0
# Objects of the range image: grey levels from near to far, in the logarithm of the range.
NEAR_M, FAR_M = 3.0, 100.0
NEAR_GREY, FAR_GREY = 0.16, 0.80
AZIMUTHS_DEG = range(-135, 181, 45)
FEW = 200  # points of the weather up to which each gets a mark that the eye finds

Array = NDArray[Any]


def birds_eye_uri(cloud: WeatherCloud, clear: WeatherCloud) -> str:
    """A cloud from above, the sensor at the origin, ahead is up; lost points where they were in clear air."""
    with mpl.rc_context({**STYLE, "font.size": 9.0}):
        figure, axes = axes_from_above()
        _dots(axes, clear.points[cloud.lost], COLOURS["lost"], 1.0)
        _dots(axes, cloud.points[cloud.kind == PointKind.OBJECT], COLOURS["object"], 0.9)
        particles = cloud.points[cloud.kind == PointKind.PARTICLE]
        _dots(axes, particles, COLOURS["particle"], 0.9 if len(particles) > FEW else 4.0)
        return png_figure_uri(figure, dpi=190)


def axes_from_above(behind_m: float = BEHIND_M, ahead_m: float = AHEAD_M) -> tuple[Figure, Axes]:
    """Axes of a cloud from above, ahead is up: the sensor as a triangle, circles of equal range with their radius."""
    figure = Figure(figsize=(3.3, 5.1))
    axes = figure.add_axes((0.125, 0.085, 0.865, 0.905))
    axes.plot(0, 0, marker="^", color="white", markeredgecolor="#1b2733", markersize=6, zorder=9)
    axes.set_aspect("equal")
    axes.set_xlim(-ASIDE_M, ASIDE_M)
    axes.set_ylim(-behind_m, ahead_m)
    axes.set_xticks([-25, 0, 25], labels=["25", "0", "25"])
    axes.set_yticks(np.arange(-25 if behind_m > 25 else 0, ahead_m, 25))
    axes.set_xlabel("left and right, m", labelpad=1)
    axes.set_ylabel("ahead, m", labelpad=-3)
    for radius in RINGS_M:
        axes.add_patch(Circle((0, 0), radius, fill=False, edgecolor=RING, linewidth=0.7, zorder=0))
        # On the ring, to the right of straight ahead, where it stays inside the picture.
        angle = math.radians(20 if radius > 20 else 45)
        place = (radius * math.sin(angle), radius * math.cos(angle))
        box = {"facecolor": "white", "edgecolor": "none", "pad": 0.6, "alpha": 0.85}
        axes.text(*place, f"{radius:g} m", fontsize=8, color=RING_TEXT, ha="center", va="center", bbox=box, zorder=8)
    return figure, axes


def _dots(axes: Axes, points: Tensor, colour: str, size: float) -> None:
    seen = (points[:, 0].abs() < AHEAD_M + 5) & (points[:, 1].abs() < ASIDE_M + 2)
    x, y = points[seen, 0].numpy(), points[seen, 1].numpy()
    axes.plot(-y, x, ".", color=colour, markersize=size, markeredgewidth=0, zorder=3)


def range_images_uri(clouds: Sequence[tuple[str, WeatherCloud]], directions: Tensor, grid: tuple[int, int]) -> str:
    """Clouds as the sensor sees them around it, one below the other: azimuth to the side, elevation up.

    Args:
        clouds: label and cloud.
        directions: ``(N, 3)`` of the beams.
        grid: rings and columns.
    """
    rows, columns, elevations = _cells(directions, grid)
    edges = np.concatenate([[0.0], (elevations[1:] + elevations[:-1]) / 2, [0.0]])
    edges[0], edges[-1] = 1.5 * elevations[0] - 0.5 * elevations[1], 1.5 * elevations[-1] - 0.5 * elevations[-2]
    each, gap, foot, head = 1.34, 0.30, 0.48, 0.26  # inches
    height = len(clouds) * (each + gap) - gap + foot + head
    width = 11.8
    with mpl.rc_context({**STYLE, "font.size": 9.5}):
        figure = Figure(figsize=(width, height))
        for number, (label, cloud) in enumerate(clouds):
            bottom = foot + (len(clouds) - 1 - number) * (each + gap)
            axes = figure.add_axes((0.052, bottom / height, 0.943, each / height))
            picture = np.ones((*grid, 3))
            picture[rows, columns] = _colours(cloud)
            axes.pcolorfast(np.linspace(180, -180, grid[1] + 1), edges, picture)
            axes.set_xlim(180, -180)
            axes.set_title(label, loc="left", pad=3)
            last = number == len(clouds) - 1
            axes.set_xticks(AZIMUTHS_DEG, labels=[f"{a:d}" if last else "" for a in AZIMUTHS_DEG])
            axes.set_yticks([-20, 0, 20])
            axes.set_ylabel("elevation, °", labelpad=1)
            if last:
                axes.set_xlabel("azimuth, ° (0 is ahead, 90 is left)", labelpad=1)
        return png_figure_uri(figure, dpi=130)


def _cells(directions: Tensor, grid: tuple[int, int]) -> tuple[Array, Array, Array]:
    """Row and column of each beam, rows from the lowest ring up, columns from 180 to -180 degrees; elevations, deg."""
    per_ring = directions.double().reshape(*grid, 3)
    elevation = torch.rad2deg(torch.asin(per_ring[..., 2].clamp(-1, 1))).mean(1)
    order = elevation.argsort()
    azimuth = torch.rad2deg(torch.atan2(per_ring[..., 1], per_ring[..., 0]))
    step = 360.0 / grid[1]
    # Every ring has its own phase: its first beam says which column it begins in, the others follow step by step.
    begins = torch.floor((180.0 - azimuth[:, :1]) / step)
    columns = torch.remainder(begins + torch.round((azimuth[:, :1] - azimuth) / step), grid[1]).long()
    rows = order.argsort()[:, None].expand(grid)
    return rows.reshape(-1).numpy(), columns.reshape(-1).numpy(), elevation[order].numpy()


def _colours(cloud: WeatherCloud) -> Array:
    """Colour of each beam: objects grey by range, particles, lost points; white without return."""
    found = np.ones((len(cloud.kind), 3))
    range_m = cloud.points[:, :3].norm(dim=-1).double().clamp(NEAR_M, FAR_M)
    grey = NEAR_GREY + (FAR_GREY - NEAR_GREY) * torch.log(range_m / NEAR_M) / math.log(FAR_M / NEAR_M)
    is_object = (cloud.kind == PointKind.OBJECT).numpy()
    found[is_object] = grey.numpy()[is_object, None]
    found[(cloud.kind == PointKind.PARTICLE).numpy()] = mpl.colors.to_rgb(COLOURS["particle"])
    found[cloud.lost.numpy()] = mpl.colors.to_rgb(COLOURS["lost"])
    return found
