"""Points that five simulators count in one weather, and against the loss of a frame."""

from __future__ import annotations

import math
import statistics
import warnings
from collections.abc import Sequence
from typing import Any

import torch
from parts.radar_as_published import (
    attenuation_db_per_km,
    fixed,
    nothing,
    number,
    published_noise_mw,
    simulator,
    tensor_of,
    thermal_sigma,
)
from torch import Tensor

import torchweather as tw
from torchweather.atmosphere.weather import Weather
from torchweather.core.errors import TorchweatherWarning
from torchweather.radar import Scatterers

RAIN_MM_PER_H, FOG_M, SNOW_MM_PER_H = (10.0, 25.0, 50.0), (10, 20, 30, 50), (1.0, 19.0)
LOSSES_DB = (0.0, 0.1, 0.25, 0.5, 1.0, 2.0, 3.0, 5.0, 10.0)
COLUMNS = ("a", "b", "c", "d", "e")
AS_PUBLISHED = {"rain_model": "d3_4", "fog_model": "d3_4", "snow_model": "d3_4"}


def weathers() -> dict[str, Weather | None]:
    found: dict[str, Weather | None] = {"clear": None}
    found |= {f"rain {rate:g} mm/h": tw.Rain(rate_mm_per_h=rate) for rate in RAIN_MM_PER_H}
    found |= {f"fog {mor_m} m": tw.Fog.rehearse(mor_m) for mor_m in FOG_M}
    with warnings.catch_warnings():
        # 19 mm/h is D3.4's own, beyond what the flakes' sizes were fitted to.
        warnings.simplefilter("ignore", TorchweatherWarning)
        found |= {f"snow {rate:g} mm/h": tw.Snow(rate_mm_per_h=rate, close_rate=rate > 10) for rate in SNOW_MM_PER_H}
    return found


def count(
    radar: tw.Radar,
    targets: Scatterers,
    weather: Weather | None,
    noises: Sequence[Tensor],
    thresholds: dict[str, float],
    loss_range_m: float,
    impedance_ohm: float,
) -> dict[str, Any]:
    """Points of each column and seed in one weather."""
    published = attenuation_db_per_km(weather, radar, "d3_4")
    loss_db = 2e-3 * loss_range_m * published
    sigma = math.sqrt(published_noise_mw(radar, loss_db, impedance_ohm))
    full, bare = simulator(radar, weather), simulator(radar, weather, clutter=False)
    signal = simulator(radar, weather, noise=False, clutter=False).cube(targets, {})
    as_published = simulator(radar, weather, noise=False, clutter=False, **AS_PUBLISHED).cube(targets, {})
    counts: dict[str, list[int]] = {column: [] for column in COLUMNS}
    alone: list[int] = []
    ranges: list[float] = []
    speeds: list[float] = []
    for seed, noise in enumerate(noises):
        drawn = full.draw(targets, seed=seed)
        counts["a"].append(len(tensor_of(full(targets, drawn))))
        own = tensor_of(full(nothing(), drawn))
        alone.append(len(own))
        ranges += torch.linalg.vector_norm(own[:, :3], dim=1).tolist()
        speeds += own[:, 3].tolist()
        counts["b"].append(number(bare, signal + thermal_sigma(radar) * noise))
        counts["c"].append(number(fixed(radar, thresholds["c"]), as_published + sigma * noise))
        counts["d"].append(number(bare, as_published + sigma * noise))
        counts["e"].append(number(fixed(radar, thresholds["e"]), signal + thermal_sigma(radar) * noise))
    return {
        "attenuation_db_per_km": attenuation_db_per_km(weather, radar, None),
        "published_attenuation_db_per_km": published,
        "published_loss_db": loss_db,
        "points": counts,
        "alone": alone,
        "alone_range_m": ranges,
        "alone_speed_m_per_s": speeds,
    }


def against_loss(
    radar: tw.Radar, targets: Scatterers, noises: Sequence[Tensor], power_mw: float, impedance_ohm: float
) -> dict[str, list[float]]:
    """Mean points of c where the frame loses so much: the signal weaker by the loss and the noise stronger by it."""
    signal = simulator(radar, noise=False).cube(targets, {})
    detector = fixed(radar, power_mw)
    found: dict[str, list[float]] = {"loss_db": list(LOSSES_DB), "both": [], "signal weaker only": []}
    for loss_db in LOSSES_DB:
        weaker = 10.0 ** (-loss_db / 20.0) * signal
        for name, noise_loss_db in (("both", loss_db), ("signal weaker only", 0.0)):
            sigma = math.sqrt(published_noise_mw(radar, noise_loss_db, impedance_ohm))
            found[name].append(statistics.fmean(number(detector, weaker + sigma * noise) for noise in noises))
    return found


def loss_for(points: int, table: dict[str, list[float]]) -> float:
    """Loss at which c has so many points, between the tabulated ones."""
    losses, counts = table["loss_db"], table["both"]
    for k in range(1, len(losses)):
        if counts[k - 1] <= points < counts[k]:
            return losses[k - 1] + (points - counts[k - 1]) / (counts[k] - counts[k - 1]) * (losses[k] - losses[k - 1])
    return math.nan
