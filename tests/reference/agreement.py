"""Whether two samples come from one distribution: shares, one-dimensional laws and joint laws of two echoes.

Each test has a stated level: samples of one distribution exceed its critical value with that probability, up to
the large-sample approximation it names (atoms make it rarer).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.stats import chi2, norm

__all__ = ["Joint", "joint_test", "ks_critical", "ks_distance", "share_z", "share_z_of_expected", "z_critical"]

Array = NDArray[np.float64]

LEVEL = 1e-3  # probability of a false alarm of one comparison
FEWEST_PER_CELL = 10.0  # expected counts below about 5 spoil the chi-square law (Cochran 1954)


def ks_distance(first: ArrayLike, second: ArrayLike) -> float:
    """Largest difference of the two empirical distribution functions (Kolmogorov-Smirnov)."""
    a, b = np.sort(np.asarray(first, dtype=np.float64)), np.sort(np.asarray(second, dtype=np.float64))
    if not (a.size and b.size and np.isfinite(a).all() and np.isfinite(b).all()):
        raise ValueError(f"ks_distance: both samples must be finite and not empty; got {a.size} and {b.size} values")
    values = np.concatenate([a, b])
    below_a = np.searchsorted(a, values, side="right") / a.size
    below_b = np.searchsorted(b, values, side="right") / b.size
    return float(np.abs(below_a - below_b).max())


def ks_critical(n_first: int, n_second: int, level: float = LEVEL) -> float:
    """Distance exceeded with probability ``level`` by samples of one continuous distribution.

    ``sqrt(-ln(level / 2) / 2) sqrt((n + m) / (n m))``, the first term of Kolmogorov's series (Smirnov 1948); good to
    1 % of itself from 50 values on, and never too small for a level below 0.1.
    """
    return math.sqrt(-math.log(level / 2.0) / 2.0 * (n_first + n_second) / (n_first * n_second))


def share_z(hits_first: int, n_first: int, hits_second: int, n_second: int) -> float:
    """Difference of two shares in its standard deviation under one common share (0 where both are 0 or both 1)."""
    pooled = (hits_first + hits_second) / (n_first + n_second)
    deviation = math.sqrt(pooled * (1.0 - pooled) * (1.0 / n_first + 1.0 / n_second))
    return 0.0 if deviation == 0.0 else (hits_first / n_first - hits_second / n_second) / deviation


def share_z_of_expected(hits: int, n: int, probability: float) -> float:
    """Difference of a share and its probability in binomial standard deviations."""
    deviation = math.sqrt(probability * (1.0 - probability) / n)
    if deviation == 0.0:
        return 0.0 if hits == n * probability else math.inf
    return (hits / n - probability) / deviation


def z_critical(level: float = LEVEL) -> float:
    """Size of a standard normal variate that is exceeded, up or down, with probability ``level``."""
    return float(norm.isf(level / 2.0))


@dataclass(frozen=True)
class Joint:
    """A two-sample chi-square test over cells."""

    statistic: float
    n_free: int  # degrees of freedom
    p_value: float


def joint_test(first: ArrayLike, second: ArrayLike, n_bins: int = 12) -> Joint:
    """Two-sample test of the joint law of several variates, ``(N, k)`` against ``(M, k)``.

    Each column is cut at the quantiles of both samples together, so that cells hold similar counts; the product of
    the cuts gives ``n_bins^k`` cells. Cells in which a sample expects fewer than 10 are pooled into one,
    which is left out if it expects fewer than 10 itself. Values that
    occur often (an object's own range) keep a bin to themselves where that is their quantile.

    Args:
        first: one row per beam, finite.
        second: the same of the other sample.
        n_bins: bins of each column.
    """
    a, b = np.asarray(first, dtype=np.float64), np.asarray(second, dtype=np.float64)
    if a.ndim != 2 or b.ndim != 2 or a.shape[1] != b.shape[1] or not (len(a) and len(b)):
        raise ValueError(f"joint_test: needs (N, k) and (M, k), neither empty; got {a.shape} and {b.shape}")
    if not (np.isfinite(a).all() and np.isfinite(b).all()):
        raise ValueError("joint_test: the samples must be finite")
    both = np.concatenate([a, b])
    cell = np.zeros(len(both), dtype=np.int64)
    for column in both.T:
        cuts = np.unique(np.quantile(column, np.linspace(0.0, 1.0, n_bins + 1)[1:-1], method="inverted_cdf"))
        cell = cell * (n_bins + 1) + np.searchsorted(cuts, column, side="left")
    n_cells = (n_bins + 1) ** a.shape[1]
    counts = np.stack([np.bincount(cell[: len(a)], minlength=n_cells), np.bincount(cell[len(a) :], minlength=n_cells)])
    return _chi_square(counts.astype(np.float64))


def _chi_square(counts: Array) -> Joint:
    """Homogeneity of the two rows of counts."""
    shares = counts.sum(axis=1, keepdims=True) / counts.sum()
    expected = shares * counts.sum(axis=0, keepdims=True)
    thin = expected.min(axis=0) < FEWEST_PER_CELL
    pooled = counts[:, thin].sum(axis=1, keepdims=True)
    counts = np.concatenate([counts[:, ~thin], pooled], axis=1)
    expected = shares * counts.sum(axis=0, keepdims=True)
    filled = expected.min(axis=0) >= FEWEST_PER_CELL
    counts, expected = counts[:, filled], expected[:, filled]
    statistic = float(((counts - expected) ** 2 / expected).sum())
    n_free = max(int(filled.sum()) - 1, 0)
    return Joint(statistic, n_free, float(chi2.sf(statistic, n_free)) if n_free else 1.0)
