"""Maps of LiDAR frames: from above, and over azimuth and elevation."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from effect_drawing import MAP_TITLE, STRONG
from effect_panels import Run
from lidar_frames import Beams
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap

import torchweather as tw

__all__ = ["FromAbove", "LostMap", "RangeImage"]


@dataclass(frozen=True)
class FromAbove:
    """Particle returns of one frame of the first and the last run from above."""

    half_m: float
    behind_only: bool = False
    instead: Mapping[str, Any] = field(default_factory=dict)

    def draw(self, axes: Axes, beams: Beams, runs: Sequence[Run]) -> None:
        """Draw the runs."""
        x, y, _ = beams.directions.numpy().T
        objects = beams.hit
        axes.set_title(runs[-1].label, loc="left", **MAP_TITLE)
        axes.plot((x * beams.range_m)[objects], (y * beams.range_m)[objects], ",", color="#dde3e9", zorder=1)
        for run, size in ((runs[0], 2.5), (runs[-1], 1.4)):
            seen, range_m = run.frames.particle[0], run.frames.range_m[0]
            axes.plot((x * range_m)[seen], (y * range_m)[seen], "o", markersize=size, mew=0, color=run.colour, zorder=2)
        axes.plot(0.0, 0.0, "^", color="#1b2733", markersize=5, zorder=3)
        half = self.half_m
        axes.set(
            xlim=(-half, 0.4 * half if self.behind_only else half),
            ylim=(-half, half) if not self.behind_only else (-0.7 * half, 0.7 * half),
        )
        axes.set_aspect("equal")
        axes.set(xlabel="x, forward, m", ylabel="y, left, m")


@dataclass(frozen=True)
class RangeImage:
    """Range of one frame of the last run over azimuth and elevation."""

    half_deg: float
    most_m: float
    instead: Mapping[str, Any] = field(default_factory=dict)

    def draw(self, axes: Axes, beams: Beams, runs: Sequence[Run]) -> None:
        """Draw the runs."""
        axes.set_title(runs[-1].label, loc="left", **MAP_TITLE)
        frames = runs[-1].frames
        seen = (frames.range_m[0] > 0) & (np.abs(beams.azimuth_deg) <= self.half_deg)
        shown = axes.scatter(
            beams.azimuth_deg[seen],
            beams.elevation_deg[seen],
            c=frames.range_m[0][seen],
            s=6.0,
            marker="s",
            linewidths=0,
            cmap="viridis_r",
            vmin=0.0,
            vmax=self.most_m,
        )
        bar = axes.figure.colorbar(shown, ax=axes, pad=0.02)
        bar.set_label("range, m")
        axes.set(xlim=(self.half_deg, -self.half_deg), xlabel="azimuth, degrees", ylabel="elevation, degrees")


@dataclass(frozen=True)
class LostMap:
    """Share of the frames of the last run in which a beam lost its object, over azimuth and elevation."""

    half_deg: float
    instead: Mapping[str, Any] = field(default_factory=dict)

    def draw(self, axes: Axes, beams: Beams, runs: Sequence[Run]) -> None:
        """Draw the runs."""
        axes.set_title(runs[-1].label, loc="left", **MAP_TITLE)
        share = 100.0 * (runs[-1].frames.kind == tw.PointKind.LOST).mean(0)
        seen = beams.hit & (np.abs(beams.azimuth_deg) <= self.half_deg)
        shown = axes.scatter(
            beams.azimuth_deg[seen],
            beams.elevation_deg[seen],
            c=share[seen],
            s=3.5,
            marker="s",
            linewidths=0,
            cmap=LinearSegmentedColormap.from_list("lost", ("#d5e3f0", STRONG)),
            vmin=0.0,
            vmax=100.0,
        )
        bar = axes.figure.colorbar(shown, ax=axes, pad=0.02)
        bar.set_label("lost, %")
        axes.set(xlim=(self.half_deg, -self.half_deg), xlabel="azimuth, degrees", ylabel="elevation, degrees")
