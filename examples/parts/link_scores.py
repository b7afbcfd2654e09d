"""Scores of a model of links: RMSE, conditional bias by rain and path length, held-out halves, Markdown tables."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from parts.link_losses import WET_MM_PER_H, means
from parts.link_recordings import Array, Recording

HOUR_STEPS = 12
CELL_SAMPLES, HALVES = 30, 10  # a cell needs more


@dataclass(frozen=True)
class Rules:
    """What differs between the two sets."""

    rain_edges_mm_per_h: tuple[float, ...]
    length_edges_km: tuple[float, ...]
    longer_than_km: float = 0.0
    alternate_days: bool = False


GERMANY = Rules((0.1, 0.5, 1.0, 2.0, 5.0, 20.0), (0.5, 3.0, 5.0, 8.0, 12.0, 30.0), 0.5, alternate_days=True)
GOTHENBURG = Rules((0.1, 0.5, 1.0, 2.0, 5.0, 20.0, 30.0), (0.0, 1.0, 2.0, 4.0, 20.0))


def root_mean_square(error: Array) -> float:
    return float(np.sqrt((error**2).mean()))


def cell_statistics(recording: Recording, error: Array, judged: Array, rules: Rules) -> tuple[Array, Array, Array]:
    """Number, mean and standard deviation of the judged errors, each ``(rain cells, length cells)``."""
    edges = rules.rain_edges_mm_per_h, rules.length_edges_km
    rain, length, off = (x[judged] for x in np.broadcast_arrays(recording.rain_mm_per_h, recording.length_km, error))
    number, total, squares = (np.histogram2d(rain, length, edges, weights=w)[0] for w in (None, off, off**2))
    with np.errstate(invalid="ignore"):  # 0 / 0 in an empty cell
        mean = total / number
        return number, mean, np.sqrt(np.maximum(squares / number - mean**2, 0.0))


def conditional_bias_db(number: Array, mean: Array) -> float:
    """Mean over the cells of the absolute mean error."""
    return float(np.abs(mean[number > CELL_SAMPLES]).mean())


def scores(recording: Recording, error: Array, judged: Array, rules: Rules) -> tuple[float, float, float]:
    """RMSE of 5-min values in rain and of the means of hours with rain, conditional bias; of the judged samples."""
    wet = judged & (recording.rain_mm_per_h > WET_MM_PER_H)
    hours, rain = (means(np.where(judged, x, np.nan), HOUR_STEPS) for x in (error, recording.rain_mm_per_h))
    number, mean, _ = cell_statistics(recording, error, judged, rules)
    return root_mean_square(error[wet]), root_mean_square(hours[rain > WET_MM_PER_H]), conditional_bias_db(number, mean)


def odd_days(steps: int) -> Array:
    """``(steps, 1)``, the second day and every other one from there."""
    return np.asarray(np.arange(steps)[:, None] // (24 * HOUR_STEPS) % 2 == 1)


def held_out_links(chosen: Array, seed: int) -> Array:
    """A random half of the chosen links, ``(links,)``."""
    picked = np.random.default_rng(seed).permutation(np.flatnonzero(chosen))[: int(chosen.sum()) // 2]
    return np.isin(np.arange(chosen.size), picked)


def held_out_scores(recording: Recording, error: Array, known: Array, chosen: Array, rules: Rules) -> Array:
    """``scores`` of random halves of the chosen links, every other day where the rules say so, ``(HALVES, 3)``."""
    judged = known & (odd_days(len(error)) | (not rules.alternate_days))
    return np.array([scores(recording, error, judged & held_out_links(chosen, seed), rules) for seed in range(HALVES)])


def table(head: list[str], lines: list[list[str]]) -> None:
    print()
    for line in (head, ["---"] * len(head), *lines):
        print(f"| {' | '.join(line)} |")


def spans(edges: tuple[float, ...], unit: str) -> list[str]:
    return [f"{low:g} to {high:g} {unit}" for low, high in pairwise(edges)]
