"""Information of a metric on a detector beyond the kind of weather and its strength."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["PartialCorrelation", "Prediction", "partial_correlation", "prediction"]

Floats = NDArray[np.float64]

# What is left of a column below this share of its spread is rounding.
NOTHING_LEFT = 1e-9


@dataclass(frozen=True)
class PartialCorrelation:
    """Correlation of what the weather's level leaves unexplained."""

    value: float
    """NaN where it is not defined; ``reason`` says why."""
    p_value: float
    degrees_of_freedom: int
    reason: str = ""


@dataclass(frozen=True)
class Prediction:
    """Error of the performance predicted for a condition from all the others, in the performance's unit."""

    rmse: float
    """By a straight line in the metric; NaN where it is not defined."""
    rmse_of_mean: float
    """By the mean of the others."""
    rmse_of_level: float
    """By a straight line in the weather's level, one a kind of weather; NaN where no column tells the level."""
    conditions: int
    """With a finite score; all three errors are of these."""


def partial_correlation(
    x: Floats, y: Floats, kind: Sequence[str] | None, level: Floats | None, *, ranks: bool
) -> PartialCorrelation:
    """Pearson's r of the residuals of ``(n,)`` and ``(n,)`` after a straight line in the level, one a kind of weather.

    Args:
        x: scores; infinite ones are left out unless ``ranks``.
        y: performances.
        kind: of the weather.
        level: its strength within the kind.
        ranks: of scores and performances are taken first.
    """
    from scipy import stats  # takes half a second, which only a correlation has to wait for

    if kind is None or level is None:
        return PartialCorrelation(math.nan, math.nan, 0, "no columns weather and severity or value")
    keep = np.ones(len(x), bool) if ranks else np.isfinite(x)
    x, y, level = x[keep], y[keep], level[keep]
    kinds = [each for each, kept in zip(kind, keep, strict=True) if kept]
    if ranks:
        x, y = stats.rankdata(x), stats.rankdata(y)
    design = _design(kinds, level)
    free = len(x) - int(np.linalg.matrix_rank(design)) - 1
    if free < 2:
        return PartialCorrelation(math.nan, math.nan, max(free, 0), f"{len(x)} conditions do not suffice")
    left = []
    for values, what in ((x, "score"), (y, "performance")):
        residual = values - design @ np.linalg.lstsq(design, values, rcond=None)[0]
        if np.linalg.norm(residual) <= NOTHING_LEFT * np.linalg.norm(values):
            return PartialCorrelation(math.nan, math.nan, free, f"the level explains the {what} wholly")
        left.append(residual / np.linalg.norm(residual))
    value = float(np.clip(left[0] @ left[1], -1.0, 1.0))
    t = value * math.sqrt(free / max(1.0 - value**2, 1e-300))
    return PartialCorrelation(value, float(2 * stats.t.sf(abs(t), free)), free)


def _design(kind: Sequence[str], level: Floats) -> Floats:
    """A constant and a slope for each kind."""
    columns = []
    for name in sorted({*kind}):
        here = np.array([each == name for each in kind], dtype=np.float64)
        columns += [here, here * level]
    return np.stack(columns, 1) if columns else np.zeros((0, 0))


def prediction(x: Floats, y: Floats, kind: Sequence[str] | None, level: Floats | None) -> Prediction:
    """Root mean square errors of the performance, leaving out one condition at a time.

    A line needs two different values among the others; with one, their mean takes its place. A kind of weather that
    has no other condition is predicted by the mean of all others.
    """
    finite = np.isfinite(x)
    count = int(finite.sum())
    if count < 3:
        return Prediction(math.nan, math.nan, math.nan, count)
    rows = np.flatnonzero(finite)
    kinds = None if kind is None or level is None else np.array(list(kind))
    errors: list[list[float]] = [[], [], []]
    for row in rows:
        others = rows[rows != row]
        errors[0].append(_line(x[others], y[others], x[row]) - y[row])
        errors[1].append(float(y[others].mean()) - y[row])
        if kinds is not None and level is not None:
            alike = others[kinds[others] == kinds[row]]
            known = _line(level[alike], y[alike], level[row]) if len(alike) else float(y[others].mean())
            errors[2].append(known - y[row])
    by_metric, by_mean, by_level = (float(np.sqrt(np.mean(np.square(e)))) if e else math.nan for e in errors)
    constant = bool((x[rows] == x[rows[0]]).all())
    return Prediction(math.nan if constant else by_metric, by_mean, by_level, count)


def _line(x: Floats, y: Floats, at: float) -> float:
    """Value of the straight line of least squares."""
    offset = x - x.mean()
    total = float(offset @ offset)
    slope = float(offset @ y) / total if total > 0 and not (x == x[0]).all() else 0.0
    return float(y.mean() + slope * (at - x.mean()))
