"""Attenuation that links measured: loss minus its dry baseline, and the links whose dry air is quiet."""

from __future__ import annotations

import numpy as np
from parts.link_recordings import MARGIN_MIN, STEP_MIN, Array, Recording

WET_MM_PER_H = 0.1
HEAVY_MM_PER_H = 2.0  # correlations are of rain above
FIRST_MINUTES = (-10, -5, 0, 5)  # of a step after its label: -5 is a label at its end, 0 at its start
GAP_MIN = 5  # longest that is interpolated
NEAR_RAIN_STEPS = 3  # 15 min
MEDIAN_STEPS, CARRIED_STEPS = 36, 72  # 3 h, 6 h
MEDIAN_SAMPLES, DRY_SAMPLES = 5, 8  # dry ones at least: in those 3 h; on a link, to tell its noise
NOISE_DB = 0.8
BAND_GHZ = (10.0, 40.0)


def last_row(valid: Array) -> Array:
    """The row of the last valid entry so far, ``(rows, links)``; far before the first where there is none."""
    rows = np.where(valid, np.arange(len(valid))[:, None], -(10**9))
    return np.maximum.accumulate(rows, axis=0)


def close_gaps(loss_db: Array, longest: int = GAP_MIN) -> Array:
    """Linear over gaps of up to ``longest`` rows; longer ones stay nan."""
    valid = np.isfinite(loss_db)
    before, after = last_row(valid), len(valid) - 1 - last_row(valid[::-1])[::-1]
    row, link = np.nonzero(~valid & (after - before - 1 <= longest))
    first, last = before[row, link], after[row, link]
    share = (row - first) / (last - first)
    closed = loss_db.copy()
    closed[row, link] = (1.0 - share) * loss_db[first, link] + share * loss_db[last, link]
    return closed


def means(samples: Array, number: int) -> Array:
    """Means of ``number`` rows each, of what there is; nan where there is nothing."""
    parts = samples[: len(samples) // number * number].reshape(-1, number, samples.shape[1])
    return np.asarray(np.ma.masked_invalid(parts).mean(1).filled(np.nan))


def step_means(samples: Array, first_minute: int) -> Array:
    """5-min means, ``(steps, links)``, of minutes as ``on_clock`` gives them."""
    return means(samples[MARGIN_MIN + first_minute : len(samples) - MARGIN_MIN + first_minute], STEP_MIN)


def dry_steps(rain_mm_per_h: Array) -> Array:
    """More than 15 min from any rain above ``WET_MM_PER_H``; where the reference is missing, it may rain."""
    wet = np.pad(~(rain_mm_per_h <= WET_MM_PER_H), ((NEAR_RAIN_STEPS, NEAR_RAIN_STEPS), (0, 0)))
    return np.asarray(~np.any([wet[k : k + len(rain_mm_per_h)] for k in range(2 * NEAR_RAIN_STEPS + 1)], axis=0))


def baseline_db(loss_db: Array, dry: Array) -> Array:
    """Median of the dry samples of the last 3 h, carried forward up to 6 h; nan where they are too few."""
    padded = np.pad(np.where(dry, loss_db, np.nan), ((MEDIAN_STEPS - 1, 0), (0, 0)), constant_values=np.nan)
    window = np.lib.stride_tricks.sliding_window_view(padded, MEDIAN_STEPS, 0)
    median = np.full_like(loss_db, np.nan)
    for link in range(loss_db.shape[1]):  # one at a time: all together take gigabytes
        ordered = np.sort(window[:, link])  # nan last
        number = np.isfinite(ordered).sum(1)
        middle = np.stack([np.maximum(number - 1, 0) // 2, number // 2], 1)
        median[:, link] = np.where(number < MEDIAN_SAMPLES, np.nan, np.take_along_axis(ordered, middle, 1).mean(1))
    last = last_row(np.isfinite(median))
    age = np.arange(len(median))[:, None] - last
    return np.where(age <= CARRIED_STEPS, np.take_along_axis(median, np.maximum(last, 0), 0), np.nan)


def correlation(samples: Array, rain_mm_per_h: Array) -> float:
    """Of the samples with the rain, where it is above ``HEAVY_MM_PER_H``."""
    both = (rain_mm_per_h > HEAVY_MM_PER_H) & np.isfinite(samples)
    return float(np.corrcoef(samples[both], rain_mm_per_h[both])[0, 1])


def measured_db(recording: Recording) -> tuple[Array, int]:
    """Loss minus baseline, ``(steps, links)``, under the label that correlates best with the reference; that label."""
    dry = dry_steps(recording.rain_mm_per_h)
    closed = close_gaps(recording.loss_db)
    losses_db = {first_minute: step_means(closed, first_minute) for first_minute in FIRST_MINUTES}
    found = [(loss_db - baseline_db(loss_db, dry), first_minute) for first_minute, loss_db in losses_db.items()]
    return max(found, key=lambda one: correlation(one[0], recording.rain_mm_per_h))


def quiet_links(recording: Recording, attenuation_db: Array, longer_than_km: float) -> Array:
    """Links in the band whose dry samples scatter by less than ``NOISE_DB``, ``(links,)``."""
    dry = dry_steps(recording.rain_mm_per_h)
    noise_db = np.ma.masked_array(attenuation_db, ~dry | np.isnan(attenuation_db)).std(0).filled(np.inf)
    in_band = (recording.frequency_ghz >= BAND_GHZ[0]) & (recording.frequency_ghz <= BAND_GHZ[1])
    known = (dry.sum(0) >= DRY_SAMPLES) & (noise_db < NOISE_DB)
    return np.asarray(in_band & known & (recording.length_km > longer_than_km))
