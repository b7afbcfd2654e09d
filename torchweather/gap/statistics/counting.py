"""Scatter of stabilised counts and shares, from the law of counting: also where almost nothing was counted.

The square root of a count scatters by 1/2 where many are counted, by less where few are: of an expected 0.05 by 0.12.
What simulated frames have never shown may still happen; with Jeffreys' prior, S events in N frames give an expected
number of (S + 1/2) / N a frame. Most bins of some statistics can never hold an event. All empty bins together then
stand for as many events as there are bins with one (Good and Turing).

References:
    Anscombe 1948 (square root of counts), Jeffreys 1946, Good 1953.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.stats import poisson

from torchweather.gap.inference.config import SCATTER

__all__ = ["ANSCOMBE", "counted_variance", "expected_number", "one_event_sd", "root_variance", "unseen_events"]

Floats = NDArray[np.float64]

ANSCOMBE = 3.0 / 8.0
# Of the table: from where a count's root has the variance of its limit, 1/4, to 0.1 %, down to next to nothing.
TABLE_FROM, TABLE_TO, TABLE_PLACES = 1e-4, 60.0, 240


@lru_cache(maxsize=1)
def _table() -> tuple[Floats, Floats]:
    expected = np.geomspace(TABLE_FROM, TABLE_TO, TABLE_PLACES)
    number = np.arange(int(TABLE_TO + 12.0 * np.sqrt(TABLE_TO)))
    probability = poisson.pmf(number[None], expected[:, None])
    root = np.sqrt(number + ANSCOMBE)
    return np.log(expected), probability @ root**2 - (probability @ root) ** 2


def root_variance(expected: Floats) -> Floats:
    """Variance of ``sqrt(X + 3/8)`` of a Poisson count X with an expected number.

    Args:
        expected: any shape, 0 or more.

    Example:
        >>> root_variance(np.array([0.05, 1.0, 100.0])).round(3).tolist()
        [0.015, 0.179, 0.25]
    """
    logs, variance = _table()
    found: Floats = np.interp(np.log(np.clip(expected, TABLE_FROM, TABLE_TO)), logs, variance)
    return found


def unseen_events(counted: Floats) -> float:
    """Events for which each bin stands in which none was counted: those of all of them together are the bins with one.

    Args:
        counted: events of all bins, any shape, 0 or more.

    Returns:
        At most Jeffreys' half; half an event for all empty bins together where no bin has one.

    Example:
        >>> unseen_events(np.array([0.0] * 90 + [1.0] * 4 + [7.0])), unseen_events(np.array([0.0, 1.0, 1.0]))
        (0.05, 0.5)
    """
    once, never = int(((counted > 0.0) & (counted < 1.5)).sum()), int((counted <= 0.0).sum())
    return min((once + SCATTER.jeffreys_events) / max(never, 1), SCATTER.jeffreys_events)


def expected_number(
    counted: Floats, frames: Floats | float, number: int, prior: Floats | float = SCATTER.jeffreys_events
) -> Floats:
    """Expected number of events in ``number`` frames, after so many were counted in others.

    Args:
        counted: events, 0 or more.
        frames: independent ones in which they were counted.
        number: of frames.
        prior: events that are added to those.

    Example:
        >>> expected_number(np.array([0.0, 12.0]), 48, 6).tolist()
        [0.0625, 1.5625]
    """
    found: Floats = number * (np.asarray(counted, dtype=np.float64) + prior) / frames
    return found


def one_event_sd(expected: Floats) -> Floats:
    """Standard deviations by which a Poisson count departs that is one event above the expected number.

    The root of its deviance, ``2 ((m + 1) ln((m + 1) / m) - 1)`` for an expected m.

    Args:
        expected: m, any shape, above 0.

    Example:
        >>> one_event_sd(np.array([0.05, 1.0, 100.0])).round(2).tolist()
        [2.1, 0.88, 0.1]
    """
    found: Floats = np.sqrt(2.0 * ((expected + 1.0) * np.log1p(1.0 / expected) - 1.0))
    return found


def counted_variance(kind: str, weight: Floats, expected: Floats) -> Floats:
    """Variance of a stabilised ``count`` or ``share`` whose rarer outcome happens an expected number of times.

    Args:
        kind: ``count`` or ``share``.
        weight: elements of a share.
        expected: number of events; of a share, of what happens less often, at most half of its elements.

    Example:
        >>> counted_variance("share", np.array([400.0]), np.array([200.0])).round(6).tolist()  # 1 / (4 w)
        [0.000625]
    """
    if kind == "count":
        return root_variance(expected)
    some = np.maximum(weight, 1.0)
    # asin(sqrt(x / w)) has the derivative of sqrt(x) over sqrt(w (1 - x / w)); its count scatters by (1 - x / w) less.
    found: Floats = root_variance(np.minimum(expected, 0.5 * some)) / some
    return found
