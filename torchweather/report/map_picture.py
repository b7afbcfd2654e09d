"""One picture of radar power maps side by side, seen from above, on one scale."""

from __future__ import annotations

import io
import math
from collections.abc import Mapping

import matplotlib as mpl
import numpy as np
import torch
from matplotlib.figure import Figure
from torch import Tensor

from torchweather.radar.power_map import RadarPowerMap
from torchweather.report.figures import INK, MUTED, STYLE

__all__ = ["from_above", "map_picture"]

DPI = 100
PIXELS = 560  # of a panel
SHOWN_DB = 50.0  # above the noise
LOWEST_DB = -5.0  # below it
BEYOND = 1.0  # columns of azimuth that a pixel may lie beside the nearest


def map_picture(maps: Mapping[str, RadarPowerMap], noise_db: float) -> bytes:
    """Maps of one recording beside each other.

    Args:
        maps: heading to map, all of the same axes and unit.
        noise_db: mean noise in that unit; colours count from it.

    Returns:
        A PNG. Forward is up; without an azimuth the panels show Doppler over range.
    """
    first = next(iter(maps.values()))
    turning = "azimuth" in first.axes.dims
    far = first.axes.range_m[-1] + 0.5 * first.range_bin_m
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=((PIXELS * len(maps) + 90) / DPI, (PIXELS + 90) / DPI), dpi=DPI, layout="constrained")
        axes = figure.subplots(1, len(maps), squeeze=False, sharey=True)[0]
        for place, (heading, one) in zip(axes, maps.items(), strict=True):
            if turning:
                grid, extent = from_above(one, PIXELS), (far, -far, -far, far)
                place.set_xlabel("y, m (left is positive)", color=INK)
            else:
                grid, extent = _over_range(one)
                place.set_xlabel("radial speed, m/s" if "doppler" in one.axes.dims else "", color=INK)
            shown = place.imshow(
                grid.numpy() - noise_db,
                extent=extent,
                cmap="magma",
                vmin=LOWEST_DB,
                vmax=SHOWN_DB,
                interpolation="nearest",
                aspect="equal" if turning else "auto",
            )
            place.set_title(heading, color=INK, loc="left")
            place.tick_params(colors=MUTED)
        axes[0].set_ylabel("forward, m" if turning else "range, m", color=INK)
        figure.colorbar(shown, ax=list(axes), label="power over the mean noise, dB", shrink=0.8)
        target = io.BytesIO()
        figure.savefig(target, format="png")
    return target.getvalue()


def from_above(power_map: RadarPowerMap, pixels: int) -> Tensor:
    """Power in dB on a square grid, forward up and left to the left; NaN where the map has no cell.

    Args:
        power_map: with range and azimuth; of other dimensions the strongest cell is shown.
        pixels: of a side.

    Returns:
        ``(pixels, pixels)`` float32.
    """
    axes = power_map.axes
    order = [axes.dims.index("range"), axes.dims.index("azimuth")]
    rest = [place for place in range(len(axes.dims)) if place not in order]
    decibels = power_map.decibels.cpu().permute(*order, *rest)
    decibels = decibels.reshape(*decibels.shape[:2], -1).amax(-1).float()
    range_m, azimuth = axes.axis("range"), torch.remainder(axes.axis("azimuth"), 2.0 * math.pi)
    far = float(range_m[-1]) + 0.5 * axes.range_bin_m
    middle = (torch.arange(pixels, dtype=torch.float64) + 0.5) / pixels * 2.0 * far - far
    left, forward = torch.meshgrid(-middle, -middle, indexing="xy")
    distance, angle = torch.hypot(forward, left), torch.remainder(torch.atan2(left, forward), 2.0 * math.pi)
    rows = ((distance - float(range_m[0])) / axes.range_bin_m).round().long()
    turned = azimuth.argsort()
    columns, off = _nearest(azimuth[turned], angle)
    inside = (rows >= 0) & (rows < len(range_m)) & (off <= BEYOND * max(axes.azimuth_bin_rad, 1e-3))
    grid = decibels[rows.clamp(0, len(range_m) - 1), turned[columns]]
    return torch.where(inside, grid, torch.nan)


def _nearest(rising: Tensor, angle: Tensor) -> tuple[Tensor, Tensor]:
    """Index of the nearest of rising angles on a circle, and how far it is off, rad."""
    above = torch.searchsorted(rising, angle.contiguous())
    choices = torch.stack([(above - 1) % len(rising), above % len(rising)])
    off = (rising[choices] - angle).abs()
    off = torch.minimum(off, 2.0 * math.pi - off)
    best = off.argmin(0, keepdim=True)
    return choices.gather(0, best)[0], off.gather(0, best)[0]


def _over_range(power_map: RadarPowerMap) -> tuple[Tensor, tuple[float, float, float, float]]:
    """A map without azimuth: range upwards, Doppler across, the strongest of what is left."""
    axes = power_map.axes
    names = [name for name in ("range", "doppler") if name in axes.dims]
    order = [axes.dims.index(name) for name in names]
    rest = [place for place in range(len(axes.dims)) if place not in order]
    decibels = power_map.decibels.cpu().permute(*order, *rest).float()
    flat = decibels.reshape(len(axes.range_m), len(axes.speed_m_per_s or (0.0,)), -1).amax(-1)
    speeds = np.asarray(axes.speed_m_per_s or (-0.5, 0.5))
    return flat.flip(0), (float(speeds[0]), float(speeds[-1]), axes.range_m[0], axes.range_m[-1])
