"""Figures of the validation page: scores over the weather, and frames side by side."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import matplotlib as mpl
import numpy as np
import torch
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from torchweather.evaluation.validation.comparison import Comparison
from torchweather.evaluation.validation.frame_scores import radar_points
from torchweather.gap.study.study import Frame
from torchweather.pipeline.point_kind import PointKind
from torchweather.report.figures import INK, MUTED, STYLE, plain_axes, svg_uri
from torchweather.report.lidar_figures import birds_eye_uri
from torchweather.report.lidar_views import WeatherCloud
from torchweather.report.radar_figures import axes_ahead, coloured_points

__all__ = [
    "DIFFERS",
    "NEARER_M",
    "SIMULATED",
    "Group",
    "lidar_above_uri",
    "link_series_uri",
    "radar_above_uri",
    "score_uri",
]

SIMULATED, DIFFERS = "#1c7ed6", "#e03131"
FLOOR, FLOOR_EDGE = "#e6ebf0", "#9aa7b4"
GAP_BETWEEN_GROUPS = 0.8  # of the distance between two levels
ASIDE = 0.13  # measured to the left, simulated to the right of the level
DECADES_FOR_LOG = 1.5
LOG_TICKS = tuple(10.0**power for power in range(-6, 7))
# A return so much nearer than the clear frame's is something in the air: well above the range noise of any preset
# (some centimetres), well below what stands apart in a street.
NEARER_M = 0.5

Array = NDArray[Any]


@dataclass(frozen=True)
class Group:
    """Conditions of one weather in one scene, in order of severity, as the page shows them.

    Args:
        title: of the group.
        axis: what the ticks are, with unit.
        ticks: one for each condition.
        cells: comparisons by score, one dictionary for each condition.
    """

    title: str
    axis: str
    ticks: tuple[str, ...]
    cells: tuple[dict[str, Comparison], ...]


def score_uri(name: str, groups: Sequence[Group]) -> str:
    """A score over the severity of each weather: measured, simulated, and the floor of clear against clear frames."""
    cells = [cell[name] for group in groups for cell in group.cells]
    floors = [(cell.floor.mean, _error(cell.floor.standard_error)) for cell in cells]
    means = [value for cell in cells for value in (cell.measured.mean, cell.simulated.mean, cell.floor.mean)]
    finite = np.array([value for value in means if math.isfinite(value)])
    log = bool(len(finite)) and finite.min() > 0 and math.log10(finite.max() / finite.min()) > DECADES_FOR_LOG
    scale = np.log10 if log else np.positive
    with mpl.rc_context({**STYLE, "font.size": 9.5}):
        figure = Figure(figsize=(4.1, 2.55))
        axes = figure.add_axes((0.145, 0.2, 0.845, 0.775))
        plain_axes(axes)
        axes.grid(axis="x", visible=False)
        axes.margins(y=0.08)
        places: list[float] = []
        ticks: list[str] = []
        x, number = 0.0, 0
        for group in groups:
            first = x
            for tick, cell in zip(group.ticks, group.cells, strict=True):
                _floor(axes, x, *floors[number], scale)
                _pair(axes, x, cell[name], scale)
                places.append(x)
                ticks.append(tick)
                x, number = x + 1.0, number + 1
            middle = (first + x - 1.0) / 2
            axes.annotate(
                group.axis, (middle, 0), (0, -19), ("data", "axes fraction"), "offset points", ha="center", va="top",
                fontsize=9, color=INK,
            )  # fmt: skip
            x += GAP_BETWEEN_GROUPS
        axes.set_xlim(-0.6, x - GAP_BETWEEN_GROUPS - 0.4)
        axes.set_xticks(places, labels=ticks)
        axes.tick_params(axis="x", length=0, labelsize=8.0)
        if log:
            inside = [t for t in LOG_TICKS if finite.min() / 10 <= t <= finite.max() * 10]
            low, high = axes.get_ylim()
            axes.set_yticks([math.log10(t) for t in inside], labels=[f"{t:g}" for t in inside])
            axes.set_ylim(low, high)
        return svg_uri(figure)


def _error(value: float) -> float:
    return value if math.isfinite(value) else 0.0


def _ends(mean: float, error: float, scale: Any) -> tuple[float, float]:
    """Two standard errors either way; on a logarithmic axis not below a tenth of the mean."""
    low = mean - 2 * error
    return scale(max(low, mean / 10) if scale is np.log10 else low), scale(mean + 2 * error)


def _floor(axes: Axes, x: float, mean: float, error: float, scale: Any) -> None:
    if not math.isfinite(mean):
        return
    low, high = _ends(mean, error, scale)
    axes.fill_between([x - 0.5, x + 0.5], low, high, color=FLOOR, linewidth=0, zorder=1)
    axes.plot([x - 0.5, x + 0.5], [scale(mean)] * 2, color=FLOOR_EDGE, linewidth=1.2, zorder=1)


def _pair(axes: Axes, x: float, cell: Comparison, scale: Any) -> None:
    """Measured and simulated mean with two standard errors; a red line between them where they differ."""
    places = (x - ASIDE, x + ASIDE)
    samples = (cell.measured, cell.simulated)
    if cell.verdict == "differs" and all(math.isfinite(sample.mean) for sample in samples):
        axes.plot(places, [scale(sample.mean) for sample in samples], color=DIFFERS, linewidth=4, alpha=0.45, zorder=2)
    for place, sample, colour, marker in zip(places, samples, (INK, SIMULATED), ("o", "D"), strict=True):
        if not math.isfinite(sample.mean):
            continue
        low, high = _ends(sample.mean, _error(sample.standard_error), scale)
        axes.plot([place, place], [low, high], color=colour, linewidth=1.3, zorder=3)
        filled = colour if marker == "o" else "white"
        size = 4.6 if marker == "o" else 4.2
        axes.plot(place, scale(sample.mean), marker, color=filled, markeredgecolor=colour, markersize=size, zorder=4)


def lidar_above_uri(frame: Frame, clear: Frame, direction: Array) -> str:
    """A scan from above, coloured by how its returns compare with a clear scan's, beam by beam.

    Args:
        frame, clear: ``range_m (H, W)``, 0 where no return.
        direction: ``(H, W, 3)`` unit vectors.
    """
    beams = torch.from_numpy(np.array(direction, dtype=np.float32)).reshape(-1, 3)
    found, before = (
        torch.from_numpy(np.array(each["range_m"], dtype=np.float32)).reshape(-1) for each in (frame, clear)
    )
    kind = torch.full(found.shape, int(PointKind.OBJECT), dtype=torch.int8)
    kind[(before == 0) | (found < before - NEARER_M)] = int(PointKind.PARTICLE)
    kind[found == 0] = int(PointKind.LOST)
    lost = (found == 0) & (before > 0)
    cloud = WeatherCloud(found[:, None] * beams, kind, lost, {}, {})
    return birds_eye_uri(cloud, WeatherCloud(before[:, None] * beams, kind, torch.zeros_like(lost), {}, {}))


def radar_above_uri(frame: Frame, clear: Frame, geometry: Frame, scale_db: tuple[float, float], far_m: float) -> str:
    """Detections from above, coloured by power; a cross where the clear frame detects and this one does not.

    Args:
        frame, clear: ``power_db``, ``range_m (N,)``.
        geometry: ``azimuth_rad``, ``elevation_rad (N,)``.
        scale_db: ends of the scale of colours.
        far_m: end of the picture ahead.
    """
    points = radar_points(frame, geometry)
    power = np.asarray(frame["power_db"])
    gone = np.isfinite(clear["power_db"]) & ~np.isfinite(power)
    lost = radar_points({**clear, "power_db": np.where(gone, clear["power_db"], np.nan)}, geometry).numpy()
    with mpl.rc_context({**STYLE, "font.size": 10.0}):
        half, rings_m = 0.42 * far_m, tuple(np.arange(25.0, far_m, 25.0))
        box = (0.15, 0.12, 0.83, 0.865)
        figure, axes = axes_ahead((3.3, 3.9), box, half, far_m, rings_m=rings_m, tick_m=25 if half > 25 else 10)
        axes.plot(-lost[:, 1], lost[:, 0], "x", color=DIFFERS, markersize=4.5, markeredgewidth=1.1, zorder=5)
        coloured_points(axes, points, torch.from_numpy(power[np.isfinite(power)]), scale_db, size=15.0)
        return svg_uri(figure)


def link_series_uri(measured: Frame, simulated: Frame, link: int) -> str:
    """Attenuation of one link over time, measured and simulated, over the rain on its path.

    Args:
        measured, simulated: ``time_s (T,)``, ``attenuation_db (T, L)``, ``rain_mm_per_h (T, L, P)``.
        link: which.
    """
    hours = (np.asarray(measured["time_s"], dtype=np.float64) - float(measured["time_s"][0])) / 3600.0
    rain = np.asarray(measured["rain_mm_per_h"], dtype=np.float64)[:, link].mean(-1)
    with mpl.rc_context({**STYLE, "font.size": 10.0}):
        figure = Figure(figsize=(10.4, 3.6))
        above = figure.add_axes((0.06, 0.42, 0.93, 0.56))
        below = figure.add_axes((0.06, 0.13, 0.93, 0.22), sharex=above)
        plain_axes(above)
        plain_axes(below)
        above.plot(hours, np.asarray(measured["attenuation_db"])[:, link], color=INK, linewidth=1.3, label="measured")
        above.plot(
            hours, np.asarray(simulated["attenuation_db"])[:, link], color=SIMULATED, linewidth=1.1, label="simulated"
        )
        above.set_ylabel("attenuation, dB")
        above.tick_params(labelbottom=False)
        above.legend(frameon=False, fontsize=9.5, loc="upper right")
        below.fill_between(hours, 0, rain, color=MUTED, linewidth=0, alpha=0.6)
        below.set_ylim(bottom=0)
        below.set_ylabel("rain, mm/h")
        below.set_xlabel("hours from the first sample")
        above.set_xlim(hours[0], hours[-1])
        return svg_uri(figure)
