"""Figures of recorded snow beside simulated snow: statistics, and a frame from the side and by its angles."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
import torch
from parts.shared import write_figure
from parts.side_views import write_side_views
from parts.snow_beams import SCANNER
from parts.snow_echoes import RULES
from parts.snow_tables import ELEVATION_EDGES_DEG, HISTOGRAM_EDGES_M, RANGE_EDGES_M, SECTORS
from torch import Tensor

import torchweather as tw


def draw(found: dict[str, Any], runs: Mapping[tuple[str, str, float], Any], path: Path) -> None:
    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    figure, axes = plt.subplots(2, 3, figsize=(15, 8.5), layout="constrained")
    rates = sorted({rate for _, _, rate in runs})
    colours = [plt.get_cmap("viridis")(0.9 * k / max(len(rates) - 1, 1)) for k in range(len(rates))]
    middles = [0.5 * (a + b) for a, b in pairwise(RANGE_EDGES_M)]
    names = list(dict.fromkeys(name for name, _, _ in runs))
    for axis, name in zip(axes[0], names, strict=True):
        for colour, rate in zip(colours, rates, strict=True):
            for rule, style in zip(RULES, ("-", ":"), strict=True):
                values = runs[name, rule, rate]["snow, given the object's range"]
                label = f"{rate:g} mm/h" if style == "-" else None
                axis.plot(middles, [max(v, 1e-4) for v in values], style, color=colour, label=label)
        axis.plot(middles, found["snow, given the object's range"], "ko", label="WADS")
        axis.set(xlabel="range of the object in m", ylabel="share of beams with a snow echo", yscale="log")
        axis.set_ylim(1e-3, 1.2)
        axis.set_title(
            name.replace(" with ", "\nwith ") + "\nsolid: strongest and last; dotted: last and strongest other", size=9
        )
    axes[0, 0].legend(fontsize=8)

    ranges, levels, sectors = axes[1]
    for axis, key, edges in (
        (ranges, "histogram", HISTOGRAM_EDGES_M),
        (levels, "snow without object, by elevation", ELEVATION_EDGES_DEG),
        (sectors, "snow by azimuth sector", [-180.0 + 360.0 / SECTORS * k for k in range(SECTORS + 1)]),
    ):
        axis.stairs(found[key], edges, color="k", fill=True, alpha=0.25, label="WADS")
        for colour, rate in zip(colours, rates, strict=True):
            axis.stairs(runs[names[-1], RULES[0], rate][key], edges, color=colour, label=f"{rate:g} mm/h")
        axis.set_title("lines: " + names[-1] + ",\nstrongest and last", size=9)
    ranges.set(xlabel="range of the snow echo in m", ylabel="share per metre", xlim=(0, 25))
    levels.set(xlabel="elevation of the beam in degrees", ylabel="share of beams without object that return snow")
    sectors.set(xlabel="azimuth of the beam in degrees (x to y)", ylabel="share of reporting beams with a snow echo")
    write_figure(path, figure, dpi=100)


def write_views(points: Tensor, snow: Tensor, folder: Path, seed: int) -> None:
    """A recorded frame ``(N, 4)`` from the side, and snow of 1 mm/h in the same frame without its flakes."""
    clear = points[~snow]
    rows = np.unique(clear.numpy(), axis=0, return_index=True)[1]  # a beam with a single echo has it twice
    clear = clear[np.sort(rows)]
    sensor = tw.Lidar.preset(SCANNER, return_mode="strongest")
    simulation = tw.LidarSnow(tw.Snow(rate_mm_per_h=1.0), sensor, complete_scan=True)
    with torch.no_grad():
        result = simulation.run(clear, simulation.draw(clear, seed=seed))
    assert isinstance(result.points, Tensor)
    assert isinstance(result.kind, Tensor)
    clouds = {
        "recorded": (points, snow),
        "simulated, 1 mm/h": (result.points, result.kind == tw.PointKind.PARTICLE),
    }
    write_side_views(clear, clouds, folder / "wads_side.png", folder / "wads_angles.png")
