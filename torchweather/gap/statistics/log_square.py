"""Mean of ``ln(1 + square)`` of normal errors, and the standard deviation that it stands for.

A spread is compared by this mean: it grows with the standard deviation s of an error in units of clear air's, and
hardly with what lies far out. Of a normal error z of standard deviation 1 it is

    F(s) = E[ln(1 + s^2 z^2)]

References:
    Trapezoidal quadrature of an even integrand that falls off as a Gaussian: converges faster than any power.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

__all__ = ["mean_log_square", "spread_of_log_square"]

Floats = NDArray[np.float64]

LEAST_SPREAD, MOST_SPREAD, NODES = 1e-3, 1e6, 801
FARTHEST, POINTS = 9.0, 4001  # standard deviations: beyond are 1e-19; the logarithm bends within 1 / s


def mean_log_square(spread: Floats) -> Floats:
    """F of standard deviations, from 0 to a million.

    Example:
        >>> mean_log_square(np.array([0.0, 1.0])).round(4).tolist()
        [0.0, 0.5335]
    """
    # z = sinh(u) over the widest spread, in even steps of u: dense near 0, where the logarithm of a wide one bends.
    steps = np.linspace(0.0, np.arcsinh(FARTHEST * MOST_SPREAD), POINTS)
    z = np.sinh(steps) / MOST_SPREAD
    weight = np.exp(-0.5 * z**2) * np.cosh(steps) / MOST_SPREAD * np.sqrt(2.0 / np.pi) * steps[1]
    weight[0] *= 0.5
    flat = np.asarray(spread, dtype=np.float64).ravel()
    found = np.array([np.log1p((one * z) ** 2) @ weight for one in flat])
    return found.reshape(np.shape(spread))


def spread_of_log_square(mean: Floats) -> Floats:
    """Standard deviation s of F(s), to 3e-5 of itself; 0 where the mean is not above 0.

    Example:
        >>> spread_of_log_square(np.array([0.0, 0.5335])).round(3).tolist()
        [0.0, 1.0]
    """
    spread, value = _table()
    inside = np.clip(mean, value[0], value[-1])
    found: Floats = np.exp(np.interp(np.log(inside), np.log(value), np.log(spread)))
    # F(s) goes as s^2 below the table.
    below = np.maximum(mean, 0.0) < value[0]
    return np.where(below, spread[0] * np.sqrt(np.maximum(mean, 0.0) / value[0]), found)


@lru_cache(maxsize=1)
def _table() -> tuple[Floats, Floats]:
    spread = np.geomspace(LEAST_SPREAD, MOST_SPREAD, NODES)
    return spread, mean_log_square(spread)
