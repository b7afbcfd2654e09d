"""The figure of ``torchweather fit-sensor``: elevations, heights and near-range response with their intervals."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
import torch
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from torchweather.core.atomic import atomic_write
from torchweather.lidar import NearResponseFit, PatternFit
from torchweather.lidar.sensor import Lidar
from torchweather.report.figures import MUTED, STYLE, plain_axes

__all__ = ["draw_sensor_fit"]

# Smaller differences of elevation are rounding: the axis shows no less.
LEAST_DEG = 0.005
MEASURED, GIVEN = "#14487f", "#c2570c"
Floats = NDArray[Any]


def draw_sensor_fit(path: Path, pattern: PatternFit, near: NearResponseFit | None, lidar: Lidar, name: str) -> None:
    """Draw the fitted values beside those of the sensor that the fit began with.

    Args:
        path: ``.png`` to write.
        pattern: fitted.
        near: fitted response, where the files show one.
        lidar: the sensor that the fit began with.
        name: of that sensor, for the legend.
    """
    panels = 2 if near is None else 3
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(4.6 * panels, 3.9), dpi=110, layout="constrained")
        axes = figure.subplots(1, panels)
        _elevations(axes[0], pattern, lidar, name)
        _heights(axes[1], pattern, lidar, name)
        if near is not None:
            _response(axes[2], near, lidar, name)
        with atomic_write(path) as unfinished:
            figure.savefig(unfinished, format="png", metadata={"Software": None})


def _measured(axes: Axes, x: Floats, y: Floats, spread: Floats, label: str = "measured, 95 % interval") -> None:
    """Measured values with their spread."""
    plain_axes(axes)
    axes.errorbar(x, y, spread, fmt="o", markersize=3, linewidth=1, color=MEASURED, label=label)


def _elevations(axes: Axes, pattern: PatternFit, lidar: Lidar, name: str) -> None:
    known = np.asarray(lidar.elevations_deg) if lidar.elevations_deg is not None else None
    spread = pattern.elevation_interval_deg
    if known is not None and len(known) == pattern.rings:
        axes.axhline(0.0, color=GIVEN, linewidth=1.5, label=name)
        off = pattern.elevations_deg - known
        _measured(axes, pattern.elevations_deg, off, spread)
        axes.set_xlabel("elevation, degrees")
        axes.set_ylabel("measured - preset, degrees")
        if np.nanmax(np.abs(off)) < LEAST_DEG:
            axes.set_ylim(-LEAST_DEG, LEAST_DEG)
    else:
        _measured(axes, np.arange(pattern.rings), pattern.elevations_deg, spread)
        if known is not None:
            axes.plot(np.arange(len(known)), known, ".", color=GIVEN, label=name)
        axes.set_xlabel("ring")
        axes.set_ylabel("elevation, degrees")
    axes.set_title(f"Elevations: {pattern.rings} rings, {pattern.columns} columns")
    axes.legend(frameon=False, fontsize=8)


def _heights(axes: Axes, pattern: PatternFit, lidar: Lidar, name: str) -> None:
    known = np.isfinite(pattern.height_interval_m)
    elevations, heights = pattern.elevations_deg, pattern.heights_m
    _measured(axes, elevations[known], heights[known], pattern.height_interval_m[known])
    if not known.all():
        axes.plot(elevations[~known], heights[~known], "x", color=MUTED, label="not told by the sweeps")
    if lidar.elevations_deg is not None:
        given = lidar.origin_heights_m or (0.0,) * len(lidar.elevations_deg)
        axes.plot(lidar.elevations_deg, given, ".", markersize=3, color=GIVEN, label=name)
    axes.set_xlabel("elevation, degrees")
    axes.set_ylabel("height of the beams' start, m")
    axes.set_title("Heights over the cloud's origin")
    axes.legend(frameon=False, fontsize=8)


def _response(axes: Axes, near: NearResponseFit, lidar: Lidar, name: str) -> None:
    _measured(axes, near.range_m, near.response, near.spread, "measured, spread of a bin")
    way = np.geomspace(max(1.0, near.range_m.min() / 1.5), near.range_m.max(), 200)
    label = f"min(1, R / {near.near_full_m:.1f} m)^{near.near_power:.2f}"
    axes.plot(way, near.xi(way), color=MEASURED, linewidth=1.5, label=label)
    axes.plot(way, lidar.near_response(torch.from_numpy(way)).numpy(), color=GIVEN, linewidth=1.5, label=name)
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.set_ylim(bottom=max(1e-3, 0.3 * near.response.min()))
    axes.set_xlabel("range, m")
    axes.set_ylabel("response, share of the far one")
    axes.set_title(f"Near-range response, K = {near.photon_constant:,.0f}")
    axes.legend(frameon=False, fontsize=8)
