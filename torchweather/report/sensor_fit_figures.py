"""The figure of ``torchweather fit-sensor``: elevations, heights and near-range response with their intervals."""

from __future__ import annotations

from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from torchweather.core.atomic import atomic_write
from torchweather.lidar import NearResponseFit, PatternFit
from torchweather.lidar.sensor import Lidar
from torchweather.report.figures import MUTED, STYLE, plain_axes

__all__ = ["draw_sensor_fit"]

# Smaller differences of elevation are rounding: the axis shows no less.
LEAST_DEG = 0.005
MEASURED, GIVEN = "#14487f", "#c2570c"


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


def _elevations(axes: Axes, pattern: PatternFit, lidar: Lidar, name: str) -> None:
    plain_axes(axes)
    known = np.asarray(lidar.elevations_deg) if lidar.elevations_deg is not None else None
    if known is not None and len(known) == pattern.rings:
        axes.axhline(0.0, color=GIVEN, linewidth=1.5, label=name)
        axes.errorbar(
            pattern.elevations_deg,
            pattern.elevations_deg - known,
            pattern.elevation_interval_deg,
            fmt="o",
            markersize=3,
            linewidth=1,
            color=MEASURED,
            label="measured, 95 % interval",
        )
        axes.set_xlabel("elevation, degrees")
        axes.set_ylabel("measured - preset, degrees")
        if np.nanmax(np.abs(pattern.elevations_deg - known)) < LEAST_DEG:
            axes.set_ylim(-LEAST_DEG, LEAST_DEG)
    else:
        ring = np.arange(pattern.rings)
        axes.errorbar(
            ring,
            pattern.elevations_deg,
            pattern.elevation_interval_deg,
            fmt="o",
            markersize=3,
            color=MEASURED,
            label="measured, 95 % interval",
        )
        if known is not None:
            axes.plot(np.arange(len(known)), known, ".", color=GIVEN, label=name)
        axes.set_xlabel("ring")
        axes.set_ylabel("elevation, degrees")
    axes.set_title(f"Elevations: {pattern.rings} rings, {pattern.columns} columns")
    axes.legend(frameon=False, fontsize=8)


def _heights(axes: Axes, pattern: PatternFit, lidar: Lidar, name: str) -> None:
    plain_axes(axes)
    known = np.isfinite(pattern.height_interval_m)
    axes.errorbar(
        pattern.elevations_deg[known],
        pattern.heights_m[known],
        pattern.height_interval_m[known],
        fmt="o",
        markersize=3,
        linewidth=1,
        color=MEASURED,
        label="measured, 95 % interval",
    )
    if not known.all():
        axes.plot(
            pattern.elevations_deg[~known], pattern.heights_m[~known], "x", color=MUTED, label="not told by the sweeps"
        )
    if lidar.elevations_deg is not None:
        heights = lidar.origin_heights_m or (0.0,) * len(lidar.elevations_deg)
        axes.plot(lidar.elevations_deg, heights, ".", markersize=3, color=GIVEN, label=name)
    axes.set_xlabel("elevation, degrees")
    axes.set_ylabel("height of the beams' start, m")
    axes.set_title("Heights over the cloud's origin")
    axes.legend(frameon=False, fontsize=8)


def _response(axes: Axes, near: NearResponseFit, lidar: Lidar, name: str) -> None:
    import torch

    plain_axes(axes)
    axes.errorbar(
        near.range_m,
        near.response,
        near.spread,
        fmt="o",
        markersize=3,
        color=MEASURED,
        label="measured, spread of a bin",
    )
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
