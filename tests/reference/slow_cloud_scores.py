"""Cloud scores, point counts, trends and the double validation metric written down from METRICS.md in plain Python.

Every sum is a loop over points; nothing here is shared with the package. For clouds of a few dozen points.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence

__all__ = ["slow_cloud_scores", "slow_counts", "slow_double_validation", "slow_index_rmse", "slow_verdict"]

Point = Sequence[float]
Box = tuple[tuple[float, float], tuple[float, float], tuple[float, float]]
EVERYWHERE: Box = ((-math.inf, math.inf),) * 3
QUANTILES = 4096


def is_point(row: Point, box: Box = EVERYWHERE) -> bool:
    """Finite, not the zeros of a lost beam, in the box with its faces."""
    place = row[:3]
    if not all(math.isfinite(along) for along in place) or not any(along != 0.0 for along in place):
        return False
    return all(low <= along <= high for along, (low, high) in zip(place, box, strict=True))


def distance(p: Point, r: Point) -> float:
    return math.sqrt(sum((a - b) ** 2 for a, b in zip(p[:3], r[:3], strict=True)))


def nearest(points: list[Point], others: list[Point]) -> list[float]:
    found = []
    for p in points:
        least = math.inf
        for r in others:
            least = min(least, distance(p, r))
        found.append(least)
    return found


def mean(values: Sequence[float]) -> float:
    return math.fsum(values) / len(values)


def percentile(values: Sequence[float], percent: float) -> float:
    """Between the two ranks beside ``percent / 100 (n - 1)``."""
    ranked = sorted(values)
    rank = percent / 100.0 * (len(ranked) - 1)
    low = int(rank)
    high = min(low + 1, len(ranked) - 1)
    return ranked[low] + (rank - low) * (ranked[high] - ranked[low])


def signature(points: list[Point]) -> list[float]:
    """``Q(u)``: the least distance that a share ``u`` of all pairs does not exceed."""
    pairs = sorted(distance(points[i], points[j]) for i in range(len(points)) for j in range(i))
    found = []
    for k in range(QUANTILES):
        u = (k + 0.5) / QUANTILES
        if not pairs:
            found.append(0.0)
            continue
        rank = 0
        while (rank + 1) / len(pairs) < u:
            rank += 1
        found.append(pairs[rank])
    return found


def shape_distance(p: list[Point], r: list[Point]) -> float:
    q_p, q_r = signature(p), signature(r)
    apart = mean([abs(a - b) for a, b in zip(q_p, q_r, strict=True)])
    whole = mean(q_p) + mean(q_r) + apart
    return 0.0 if whole == 0.0 else 2.0 * apart / whole


def slow_cloud_scores(
    distorted: Sequence[Point], reference: Sequence[Point], box: Box = EVERYWHERE
) -> dict[str, float]:
    """All scores of two clouds of at least one point."""
    p, r = ([row for row in cloud if is_point(row, box)] for cloud in (distorted, reference))
    forth, back = nearest(p, r), nearest(r, p)
    count = len(p) + len(r)
    return {
        "sdm": shape_distance(p, r),
        "rmse": math.sqrt((sum(d * d for d in forth) + sum(d * d for d in back)) / count),
        "mde": (sum(forth) + sum(back)) / count,
        "mmde": max(mean(forth), mean(back)),
        "hd": max(max(forth), max(back)),
        "hd95": max(percentile(forth, 95.0), percentile(back, 95.0)),
        "chamfer": mean(forth) + mean(back),
        "chamfer_squared": mean([d * d for d in forth]) + mean([d * d for d in back]),
    }


def slow_index_rmse(distorted: Sequence[Point], reference: Sequence[Point], box: Box = EVERYWHERE) -> float:
    """Over the rows that are points in both clouds."""
    squares = []
    for p, r in zip(distorted, reference, strict=True):
        if is_point(p, box) and is_point(r, box):
            squares.append(distance(p, r) ** 2)
    return math.sqrt(mean(squares))


def slow_counts(cloud: Sequence[Point], kind: Sequence[int], box: Box, kinds: int = 3) -> list[int]:
    counts = [0] * kinds
    for row, which in zip(cloud, kind, strict=True):
        if is_point(row, box):
            counts[which] += 1
    return counts


def slow_double_validation(
    simulated: Sequence[float], measured: Sequence[float], centre: Callable[[Sequence[float]], float]
) -> tuple[float, float]:
    """Bias, and the area between the distribution functions, step by step between neighbouring values."""
    bias = centre(simulated) - centre(measured)
    moved = [value - bias for value in simulated]
    steps = sorted({*moved, *measured})
    area = 0.0
    for low, high in itertools.pairwise(steps):
        first = sum(value <= low for value in moved) / len(moved)
        second = sum(value <= low for value in measured) / len(measured)
        area += abs(first - second) * (high - low)
    return bias, area


def slow_verdict(levels: Sequence[float | None], higher_is_better: bool) -> str:
    """Of scores in order of rising severity; None where there is none."""
    there = [score for score in levels if score is not None]
    if len(there) < 2:
        return "unjudged"
    worse = better = 0
    for before, after in itertools.pairwise(there):
        if before != after:
            if (after < before) == higher_is_better:
                worse += 1
            else:
                better += 1
    steps = len(there) - 1
    if worse == steps:
        return "expected"
    if better == steps:
        return "reversed"
    return "broken" if better else "tied"
