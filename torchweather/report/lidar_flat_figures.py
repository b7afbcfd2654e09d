"""Pictures of point clouds from the side, with the ground, and by azimuth and elevation, one below the other."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import matplotlib as mpl
import numpy as np
import torch
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray
from torch import Tensor

from torchweather.lidar import GroundPlane, fit_ground
from torchweather.pipeline.point_kind import PointKind
from torchweather.report.figures import STYLE, png_figure_uri
from torchweather.report.lidar_figures import AZIMUTHS_DEG, COLOURS
from torchweather.report.lidar_views import WeatherCloud
from torchweather.report.view_flat import UNDER_M, USUAL_HEIGHT_M, WITHIN_M
from torchweather.report.view_words import count_text

__all__ = ["UNDER_COLOUR", "angle_views_uri", "side_views_uri", "under_the_ground"]

UNDER_COLOUR = "#d6006c"
GROUND, GROUND_LINE = "#f1e8dc", "#a8792f"
AHEAD_M, ABOVE_M, BELOW_M, DEEPEST_M = 60.0, 7.0, 3.0, 14.0
ELEVATIONS_DEG = (-30.0, 15.0)
WIDTH, EACH, GAP, FOOT, HEAD = 11.8, 1.5, 0.30, 0.48, 0.26  # inches
SIZES = {"object": 0.9, "lost": 1.0, "particle": 1.3}
FEW, LARGE = 200, 4.0  # particles up to which each gets a mark that the eye finds

Array = NDArray[Any]
Named = Sequence[tuple[str, WeatherCloud]]


def under_the_ground(points: Tensor, plane: GroundPlane | None) -> Tensor:
    """Mask ``(N,)`` of points ``(N, 3 or more)`` more than 0.3 m under the ground, within 40 m."""
    if plane is None:
        return torch.zeros(len(points), dtype=torch.bool)
    xyz = points[:, :3].double().numpy()
    under = (plane.height_above(xyz) < -UNDER_M) & (np.hypot(xyz[:, 0], xyz[:, 1]) < WITHIN_M)
    return torch.from_numpy(under)


def side_views_uri(clouds: Named, clear: WeatherCloud) -> str:
    """Clouds from the side: x to the right, height up, the ground as a line; particles under it are marked.

    Args:
        clouds: label and cloud, in the sensor's frame.
        clear: the same beams in clear air, whose ground is drawn.
    """
    plane = _ground(clear)
    height_m = -USUAL_HEIGHT_M if plane is None else plane.height_m
    deepest_m = height_m - BELOW_M
    for _, cloud in clouds:
        particles = cloud.points[cloud.kind == PointKind.PARTICLE]
        found = particles[under_the_ground(particles, plane), 2]
        if len(found):
            deepest_m = min(deepest_m, float(found.double().quantile(0.01)) - 0.5)
    limits = (max(deepest_m, height_m - DEEPEST_M), height_m + ABOVE_M)

    def draw(axes: Axes) -> None:
        axes.set_xlim(-AHEAD_M, AHEAD_M)
        axes.set_ylim(*limits)
        axes.set_ylabel("height, m", labelpad=1)
        if plane is not None:
            ends = np.array([-AHEAD_M, AHEAD_M])
            line = plane.height_m + plane.slope_x * ends
            axes.fill_between(ends, line, limits[0], color=GROUND, zorder=0, linewidth=0)
            axes.plot(ends, line, color=GROUND_LINE, linewidth=1.2, zorder=6)
        axes.plot(0, 0, marker="^", color="white", markeredgecolor="#1b2733", markersize=6, zorder=9)

    def place(points: Tensor) -> tuple[Array, Array]:
        # The road's cross slope is taken out, so that the ground is a line.
        slope_y = 0.0 if plane is None else plane.slope_y
        return points[:, 0].numpy(), (points[:, 2] - slope_y * points[:, 1]).numpy()

    return _stacked(clouds, clear, plane, draw, place, "x (ahead), m", None)


def angle_views_uri(clouds: Named, clear: WeatherCloud) -> str:
    """Clouds as the sensor sees them: azimuth to the side, ahead in the middle, elevation up.

    Args:
        clouds: label and cloud, in the sensor's frame; beams need not be organised.
        clear: the same beams in clear air.
    """
    points = clear.points[clear.kind == PointKind.OBJECT]
    low, high = ELEVATIONS_DEG
    if len(points):
        quantiles = np.quantile(_angles(points)[1], (0.001, 0.999))
        low, high = max(low, float(quantiles[0]) - 2.0), min(high, float(quantiles[1]) + 5.0)

    def draw(axes: Axes) -> None:
        axes.set_xlim(180, -180)
        axes.set_ylim(low, high)
        axes.set_ylabel("elevation, °", labelpad=1)

    return _stacked(clouds, clear, _ground(clear), draw, _angles, "azimuth, ° (0 is ahead, 90 is left)", AZIMUTHS_DEG)


def _angles(points: Tensor) -> tuple[Array, Array]:
    x, y, z = points[:, :3].double().unbind(-1)
    azimuth = torch.rad2deg(torch.atan2(y, x))
    return azimuth.numpy(), torch.rad2deg(torch.atan2(z, (x * x + y * y).sqrt())).numpy()


def _ground(clear: WeatherCloud) -> GroundPlane | None:
    points = clear.points[clear.kind == PointKind.OBJECT]
    return fit_ground(points[:, :3].numpy()) if len(points) else None


def _stacked(
    clouds: Named,
    clear: WeatherCloud,
    plane: GroundPlane | None,
    draw: Callable[[Axes], None],
    place: Callable[[Tensor], tuple[Array, Array]],
    across: str,
    ticks: Sequence[int] | None,
) -> str:
    height = len(clouds) * (EACH + GAP) - GAP + FOOT + HEAD
    with mpl.rc_context({**STYLE, "font.size": 9.5}):
        figure = Figure(figsize=(WIDTH, height))
        for number, (label, cloud) in enumerate(clouds):
            bottom = FOOT + (len(clouds) - 1 - number) * (EACH + GAP)
            axes = figure.add_axes((0.052, bottom / height, 0.935, EACH / height))
            draw(axes)
            limits = (*axes.get_xlim(), *axes.get_ylim())
            particles = cloud.points[cloud.kind == PointKind.PARTICLE]
            under = under_the_ground(particles, plane)
            size = SIZES["particle"] if len(particles) > FEW else LARGE
            layers = (
                (cloud.points[cloud.kind == PointKind.OBJECT], COLOURS["object"], SIZES["object"]),
                (clear.points[: len(cloud.lost)][cloud.lost], COLOURS["lost"], SIZES["lost"]),
                (particles[~under], COLOURS["particle"], size),
                (particles[under], UNDER_COLOUR, 1.6 * size),
            )
            for points, colour, dot in layers:
                axes.plot(*place(points), ".", color=colour, markersize=dot, markeredgewidth=0, zorder=3)
            axes.set_xlim(limits[:2])
            axes.set_ylim(limits[2:])
            below = int(under.sum())
            told = f"{label}: {count_text(below)} of {count_text(len(particles))} particles under the ground"
            axes.set_title(told if below else label, loc="left", pad=3, color=UNDER_COLOUR if below else "black")
            last = number == len(clouds) - 1
            if ticks is not None:
                axes.set_xticks(list(ticks), labels=[f"{tick:d}" if last else "" for tick in ticks])
            elif not last:
                axes.tick_params(labelbottom=False)
            if last:
                axes.set_xlabel(across, labelpad=1)
        return png_figure_uri(figure, dpi=130)
