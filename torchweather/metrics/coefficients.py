"""Coefficients of correlation with bootstrap intervals."""

from __future__ import annotations

import math
import warnings
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["INTERVAL", "Coefficient", "abs_interval", "coefficients", "spread", "undefined", "weighted_spearman"]

Floats = NDArray[np.float64]

INTERVAL = (0.025, 0.975)
# A variance below this share of the whole one is rounding: the resample holds one value only.
ONE_VALUE = 1e-20


@dataclass(frozen=True)
class Coefficient:
    """A coefficient of correlation, in [-1, 1]."""

    value: float
    """NaN where it is not defined; ``reason`` says why."""
    low: float
    """Lower bound of the 95 % bootstrap interval."""
    high: float
    p_value: float
    """Of no correlation, two sided."""
    reason: str = ""


def undefined(reason: str) -> Coefficient:
    """A coefficient that has no value."""
    return Coefficient(math.nan, math.nan, math.nan, math.nan, reason)


def coefficients(x: Floats, y: Floats, counts: Floats) -> dict[str, Coefficient]:
    """Pearson's r, Spearman's rho and Kendall's tau-b of ``(n,)`` against ``(n,)``.

    Args:
        x: may hold infinite numbers: ranks take them as they are, Pearson's r leaves them out.
        y: finite.
        counts: how often each resample holds each condition, ``(resamples, n)``.

    Returns:
        ``pearson``, ``spearman``, ``kendall``.
    """
    finite = np.isfinite(x)
    return {
        "pearson": _coefficient(
            x[finite],
            y[finite],
            weighted_pearson(_centred(x[finite]), _centred(y[finite]), counts[:, finite]),
            "pearson",
        ),
        "spearman": _coefficient(x, y, weighted_spearman(x, y, counts), "spearman"),
        "kendall": _coefficient(x, y, weighted_kendall(x, y, counts), "kendall"),
    }


def _coefficient(x: Floats, y: Floats, resampled: Floats, method: str) -> Coefficient:
    if len(x) < 3:
        return undefined(f"{len(x)} finite scores do not suffice")
    for values, what in ((x, "scores are"), (y, "performances are")):
        if (values == values[0]).all():
            return undefined(f"all {what} equal")
    from scipy import stats  # takes half a second, which only a correlation has to wait for

    function = {"pearson": stats.pearsonr, "spearman": stats.spearmanr, "kendall": stats.kendalltau}[method]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # scipy's, about nearly equal scores: the interval shows it
        found = function(x, y)
    return Coefficient(float(found.statistic), *spread(resampled), float(found.pvalue))


def spread(resampled: Floats) -> tuple[float, float]:
    """95 % of the resamples lie between these; those without a value are left out."""
    there = resampled[np.isfinite(resampled)]
    if not len(there):
        return math.nan, math.nan
    low, high = np.quantile(there, INTERVAL)
    return float(low), float(high)


def abs_interval(coefficient: Coefficient) -> tuple[float, float]:
    """Bounds of the coefficient's size: 0 is the lower one where the interval holds both signs.

    Example:
        >>> abs_interval(Coefficient(-0.5, -0.8, 0.1, 0.05))
        (0.0, 0.8)
    """
    ends = sorted((abs(coefficient.low), abs(coefficient.high)))
    return (0.0 if coefficient.low < 0 < coefficient.high else ends[0]), ends[1]


# ---- coefficients of resamples, as weights of the conditions: no sorting, no loop ----------------------------------


def _centred(values: Floats) -> Floats:
    found: Floats = values - values.mean() if len(values) else values
    return found


def weighted_pearson(x: Floats, y: Floats, weight: Floats) -> Floats:
    """Pearson's r, ``(resamples,)``, of ``(n,)`` or ``(resamples, n)`` numbers held so many times."""
    total = weight.sum(-1, keepdims=True)
    with np.errstate(invalid="ignore", divide="ignore"):
        from_x, from_y = (v - (weight * v).sum(-1, keepdims=True) / total for v in (x, y))
        var_x, var_y = ((weight * v**2).sum(-1) for v in (from_x, from_y))
        least_x, least_y = (ONE_VALUE * (weight.shape[-1] * v**2).sum(-1) for v in (x, y))
        found = (weight * from_x * from_y).sum(-1) / np.sqrt(var_x * var_y)
    found[~((var_x > least_x) & (var_y > least_y))] = math.nan
    clipped: Floats = np.clip(found, -1.0, 1.0)
    return clipped


def weighted_spearman(x: Floats, y: Floats, weight: Floats) -> Floats:
    """Spearman's rho of each resample: Pearson's r of the mean ranks within it."""
    ranks = [_mean_ranks(v, weight) for v in (x, y)]
    middle = (weight.sum(-1, keepdims=True) + 1) / 2  # mean rank: what is left is exact in halves
    return weighted_pearson(ranks[0] - middle, ranks[1] - middle, weight)


def _mean_ranks(values: Floats, weight: Floats) -> Floats:
    below = (values[None, :] < values[:, None]).astype(np.float64)
    equal = (values[None, :] == values[:, None]).astype(np.float64)
    found: Floats = weight @ (below + equal / 2).T + 0.5
    return found


def weighted_kendall(x: Floats, y: Floats, weight: Floats) -> Floats:
    """Kendall's tau-b of each resample: pairs in order less pairs out of order, over the untied ones."""
    order_x, order_y = (np.sign((v[:, None] > v).astype(np.float64) - (v[:, None] < v)) for v in (x, y))

    def pairs(order: Floats) -> Floats:
        found: Floats = ((weight @ order) * weight).sum(-1)
        return found

    with np.errstate(invalid="ignore", divide="ignore"):
        found: Floats = pairs(order_x * order_y) / np.sqrt(pairs(order_x**2) * pairs(order_y**2))
    return found
