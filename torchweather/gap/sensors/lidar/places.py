"""Cells of a LiDAR scan: shares of lost and of new returns, intensities and ranges less those of the clear frames."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from torchweather.gap.natural_units import DB_PER_NEPER
from torchweather.gap.places import CellValues, Point, quantity_of
from torchweather.gap.sensors.lidar.frames import LidarFrames
from torchweather.gap.sensors.lidar.scene import FAINTEST
from torchweather.gap.sensors.lidar.stable_beams import SAME_SURFACE_M
from torchweather.gap.study.conditions import Condition

__all__ = ["lidar_cells"]

Floats = NDArray[np.float64]

ROWS, COLUMNS = 16, 48  # of cells, at most
BESIDE = 4  # rows and columns of beams in a cell, at least
FEWEST = 3  # beams of a frame in a cell, for a mean
FARTHEST_M = 120.0  # of the picture of a frame: lightest
QUANTITIES = {
    **dict.fromkeys(("lost", "beyond"), "lost"),
    **dict.fromkeys(
        ("new", "particle", "near_particle", "clustered", "log_particle", "zero_intensity_share_of"), "new"
    ),
    **dict.fromkeys(("log_intensity", "zero_intensity"), "intensity"),
    "range": "range",
}
NAMES = {
    "lost": ("beams that lost their return", "% of beams"),
    "new": ("beams that return in front of their surface, or where there is none", "% of beams"),
    "intensity": ("intensity over clear air's", "dB"),
    "range": ("range less clear air's", "m"),
}


def lidar_cells(
    model: LidarFrames, condition: Condition, statistic: str, before: Point, after: Point | None, seeds: Sequence[int]
) -> CellValues:
    """Cells of a condition's scans; arguments as ``places.PlacesOf``."""
    scene, (height, width) = model.scenes[condition.scene], model.grid
    quantity = quantity_of(statistic, QUANTITIES, "intensity" if model.sensor.intensity_unit != "none" else "lost")
    rows, columns = _edges(height, ROWS), _edges(width, COLUMNS)
    cell = (np.searchsorted(rows, np.arange(height), "right") - 1)[:, None] * (len(columns) - 1) + (
        np.searchsorted(columns, np.arange(width), "right") - 1
    )
    number = (len(rows) - 1) * (len(columns) - 1)
    counted = scene.stable if quantity != "new" else scene.stable | scene.empty[-1]

    def of(range_m: Tensor, intensity: Tensor) -> Floats:
        return _in_cells(*_values(model, condition, quantity, range_m, intensity), cell.ravel(), number)

    frames = [condition.frames[place] for place in range(len(condition.frames))]
    range_m, intensity = (
        torch.stack([torch.from_numpy(np.asarray(frame[name], dtype=np.float32)).reshape(-1) for frame in frames])
        for name in ("range_m", "intensity")
    )
    beams = np.bincount(cell.ravel(), counted.numpy(), number)
    half = 50.0 / np.maximum(beams * len(frames), 1.0) if quantity in ("lost", "new") else np.zeros(number)
    azimuth = np.degrees(
        np.unwrap(torch.atan2(model.direction[:, 1], model.direction[:, 0]).view(height, width)[height // 2])
    )
    step = (azimuth[-1] - azimuth[0]) / max(width - 1, 1)
    name, unit = NAMES[quantity]
    return CellValues(
        name,
        unit,
        of(range_m, intensity),
        of(*model.simulated_scans(condition, *before, seeds)),
        None if after is None else of(*model.simulated_scans(condition, *after, seeds)),
        half,
        shape=(len(rows) - 1, len(columns) - 1),
        x_name="azimuth, degrees",
        y_name="ring, from the first",
        extent=(float(azimuth[0] - 0.5 * step), float(azimuth[-1] + 0.5 * step), float(height), 0.0),
        frame=_picture(range_m[0].view(height, width).numpy()),
    )


def _values(
    model: LidarFrames, condition: Condition, quantity: str, range_m: Tensor, intensity: Tensor
) -> tuple[Floats, NDArray[np.bool_]]:
    """Value of each beam ``(F, N)``, and which beams count."""
    scene = model.scenes[condition.scene]
    surface, clear = scene.reference_range_m[-1], scene.reference_intensity[-1].clamp_min(FAINTEST)
    if quantity == "lost":
        found, counts = 100.0 * (range_m <= 0), scene.stable
    elif quantity == "new":
        near = (range_m > 0) & ((range_m < surface - SAME_SURFACE_M) | scene.empty[-1])
        found, counts = 100.0 * near, scene.stable | scene.empty[-1]
    else:
        counts = scene.stable & (range_m > 0) & ((range_m - surface).abs() < SAME_SURFACE_M)
        if quantity == "intensity":
            counts = counts & (intensity > 0)
            found = DB_PER_NEPER * torch.log(intensity.clamp_min(FAINTEST) / clear)
        else:
            found = range_m - surface
    return found.double().numpy(), counts.expand(range_m.shape).numpy()


def _in_cells(values: Floats, counts: NDArray[np.bool_], cell: NDArray[np.intp], number: int) -> Floats:
    """Mean of each frame in each cell ``(F, cells)``; NaN where too few beams count."""
    found = np.full((len(values), number), np.nan)
    for place, (own, some) in enumerate(zip(values, counts, strict=True)):
        beams = np.bincount(cell, some, number)
        total = np.bincount(cell, np.where(some, own, 0.0), number)
        found[place] = np.where(beams >= FEWEST, total / np.maximum(beams, 1.0), np.nan)
    return found


def _edges(number: int, most: int) -> NDArray[np.intp]:
    return np.linspace(0, number, max(min(number // BESIDE, most), 1) + 1).round().astype(np.intp)


def _picture(range_m: NDArray[np.float32]) -> Floats:
    """Near is dark, far is light, no return is nearly white."""
    near = np.log(np.clip(range_m, 1.0, FARTHEST_M)) / np.log(FARTHEST_M)
    return np.where(range_m > 0, 0.3 + 0.5 * near, 0.95).astype(np.float64)
