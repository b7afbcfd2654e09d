"""Loss over the range, from levels of the same objects in clear air and in weather: LiDAR and radar."""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from torchweather.atmosphere.weather import Weather
from torchweather.core.errors import InputValueError
from torchweather.evaluation.fit.least_squares import Model, Statistics
from torchweather.gap.study.study import Condition, Study
from torchweather.lidar.intensity import COUNTED, FULL_SCALE
from torchweather.lidar.sensor import Lidar
from torchweather.lidar.transform import LidarWeather
from torchweather.radar.attenuation import weather_attenuation_db_per_km
from torchweather.radar.sensor import Radar

__all__ = ["ESTIMATORS", "lidar_loss_per_m", "lidar_models", "radar_loss_db_per_km", "radar_models"]

ESTIMATORS = ("slope", "no_offset")
RANGE_BINS = 16
LEAST_BEAMS = 8  # of a bin in a frame
LENGTHS = 16
LEAST_STEPS = 10.0
HALF_STEP = 0.5
SAME_OBJECT_M = 0.3  # range noise of the presets is some centimetres
# Beams and targets whose return is lost more often are at the threshold: what is left of them is too bright.
SEEN_SHARE = 0.8

Array = NDArray[np.float64]
Mask = NDArray[np.bool_] | None
Models = dict[str, tuple[Statistics, Model]]


@lru_cache(maxsize=1024)
def lidar_loss_per_m(weather: Weather, lidar: Lidar) -> float:
    """Effective extinction of a weather, 1/m."""
    return float(LidarWeather(weather, lidar, beam_ends="max_range").extinction_per_m.sum())


@lru_cache(maxsize=1024)
def radar_loss_db_per_km(weather: Weather, radar: Radar) -> float:
    """Attenuation of a weather one way, dB/km."""
    return float(weather_attenuation_db_per_km(weather, radar))


def lidar_models(study: Study, condition: Condition, left_out: Mask) -> tuple[Models, dict[str, str]]:
    """Logarithms of paired intensities over the range.

    Args:
        study, condition: of a LiDAR.
        left_out: ``(H, W)``, True for beams that do not count.
    """
    lidar = study.sensor_as(Lidar)
    full_scale = FULL_SCALE[lidar.intensity_unit]
    if lidar.intensity_unit == "none":
        raise InputValueError("fit_weather: a LiDAR without intensities has no paired intensities to fit.")
    clear = [study.scene_of(condition).clear[k] for k in range(len(study.scene_of(condition).clear))]
    ranges, levels = (np.stack([np.asarray(f[name], dtype=np.float64) for f in clear]) for name in _LIDAR)
    usable = (ranges > 0).all(0) & (levels > 0).all(0) & (np.ptp(ranges, axis=0) < SAME_OBJECT_M)
    if full_scale is not None:
        usable &= levels.max(0) < full_scale  # clipped: the true level is not known
    if left_out is not None:
        usable &= ~left_out
    middle = ranges.mean(0)
    if full_scale is not None:
        usable &= levels.mean(0) >= LEAST_STEPS  # in steps of 1: darker objects are mostly rounding
    returned = []
    for frame in condition.frames:
        range_m, level = (np.asarray(frame[name], dtype=np.float64) for name in _LIDAR)
        returned.append(np.where(usable & (np.abs(range_m - middle) < SAME_OBJECT_M), level, np.nan))
    measured = np.stack(returned)
    if lidar.intensity_unit in COUNTED and (levels == np.floor(levels)).all():
        levels, measured = levels + HALF_STEP, measured + HALF_STEP  # integers are rounded down
    usable &= np.isfinite(measured).mean(0) >= SEEN_SHARE
    if usable.sum() < 2 * LEAST_BEAMS:
        return {}, dict.fromkeys(ESTIMATORS, f"{int(usable.sum())} beams see the same object in clear air and weather")
    edges = np.quantile(middle[usable], np.linspace(0.0, 1.0, RANGE_BINS + 1))
    bins = np.clip(np.searchsorted(edges, middle[usable], side="right") - 1, 0, RANGE_BINS - 1)
    mean = levels.mean(0)
    # All beams of a bin lose the same share: the ratio of their sums is not bent by rounding, as that of each is.
    in_weather, before = (_ratios(values[:, usable], mean[usable], bins) for values in (measured, levels))
    rounding = None if full_scale is None else _rounding(measured[:, usable], bins)
    range_m = np.stack([_weighted(middle[usable][bins == k], mean[usable][bins == k]) for k in range(RANGE_BINS)])
    # Two ways; intensities are powers.
    return _lines(Statistics(in_weather, before, rounding), range_m, -2.0, "extinction_per_m", "offset_log")


def radar_models(study: Study, condition: Condition, left_out: Mask) -> tuple[Models, dict[str, str]]:
    """Powers of targets, such as corner reflectors, over the range; those that fluctuate in clear air weigh little."""
    scene = study.scene_of(condition)
    clear = np.stack([np.asarray(scene.clear[k]["power_db"], dtype=np.float64) for k in range(len(scene.clear))])
    measured = np.stack([np.asarray(frame["power_db"], dtype=np.float64) for frame in condition.frames])
    usable = np.isfinite(clear).all(0) & (np.isfinite(measured).mean(0) >= SEEN_SHARE)
    if left_out is not None:
        usable &= ~left_out
    if usable.sum() < 4:
        return {}, dict.fromkeys(ESTIMATORS, f"{int(usable.sum())} targets are detected in clear air and in weather")
    range_m = np.asarray(scene.geometry["range_m"], dtype=np.float64)[usable]
    rows = Statistics(measured[:, usable], clear[:, usable])
    return _lines(rows, range_m / 1000.0, -2.0, "attenuation_db_per_km", "offset_db")


_LIDAR = ("range_m", "intensity")


def _ratios(levels: Array, mean: Array, bins: NDArray[np.int64]) -> Array:
    """Logarithm of the sum of levels over that of clear means, ``(frames, bins)``; NaN of too few beams."""
    found = np.full((len(levels), RANGE_BINS), np.nan)
    for k in range(RANGE_BINS):
        inside = levels[:, bins == k]
        there = np.isfinite(inside)
        seen, known = np.nansum(inside, axis=1), (there * mean[bins == k]).sum(1)
        enough = (there.sum(1) >= LEAST_BEAMS) & (seen > 0)
        found[enough, k] = np.log(seen[enough] / known[enough])
    return found


def _rounding(levels: Array, bins: NDArray[np.int64]) -> Array:
    """Deviation of these logarithms by steps of 1, which round beams apart and frames alike, ``(bins,)``."""
    found = np.zeros(RANGE_BINS)
    for k in range(RANGE_BINS):
        inside = levels[:, bins == k]
        total = np.nansum(inside) / len(levels)
        found[k] = np.sqrt((bins == k).sum() / 12.0) / total if total > 0 else 0.0
    return found


def _weighted(range_m: Array, level: Array) -> Array:
    """Ranges of equal shares of the clear level, ``(LENGTHS,)``."""
    if not len(range_m):
        return np.zeros(LENGTHS)
    order = np.argsort(range_m)
    share = np.cumsum(level[order]) - level[order] / 2
    found: Array = np.interp((np.arange(LENGTHS) + 0.5) / LENGTHS * level.sum(), share, range_m[order])
    return found


def _lines(rows: Statistics, distance: Array, ways: float, loss: str, offset: str) -> tuple[Models, dict[str, str]]:
    length = torch.from_numpy(np.ascontiguousarray(distance))

    def lost(loss: Tensor) -> Tensor:
        if length.ndim == 1:
            return ways * length * loss
        return torch.logsumexp(ways * length * loss, -1) - math.log(length.shape[-1])  # mean of what passes

    def slope(parameters: Tensor, clear: Tensor) -> Tensor:
        return clear + parameters[1] + lost(parameters[0])

    def no_offset(parameters: Tensor, clear: Tensor) -> Tensor:
        return clear + lost(parameters[0])

    start = torch.zeros(2, dtype=torch.float64)
    return {
        "slope": (rows, Model(slope, start, (loss, offset))),
        "no_offset": (rows, Model(no_offset, start[:1], (loss,))),
    }, {}
