"""Intervals of a detector's performance: frames drawn anew (bootstrap), the same in every condition."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from torchweather.core.errors import InputValueError
from torchweather.evaluation.robustness.performance import Counter

__all__ = ["CONFIDENCE", "RESAMPLES", "Interval", "Resampling"]

RESAMPLES = 1000  # a percentile of 2.5 % then rests on 25 values; Efron and Tibshirani 1993, section 13.3
CONFIDENCE = 0.95
FEWEST_FRAMES = 5
"""Fewer frames get no interval: even of 5 simulated frames it holds the true AP in 79 % of draws only."""
FEWEST_VALUES = 40  # the 2.5 % of which are one value
Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Interval:
    """From ``low`` to ``high``, both included."""

    low: float
    high: float

    def __contains__(self, value: float) -> bool:
        return self.low <= value <= self.high


class Resampling:
    """Percentile intervals over frames drawn with replacement (Efron and Tibshirani 1993, chapter 13).

    One draw of the frames serves clear air and all conditions, so differences are those of the same frames.

    Args:
        frames: number of frames.
        seed: of the draws.
        resamples: number of draws; 0: no intervals. Of fewer than 5 frames there are none either.

    Example:
        >>> drawn = Resampling(13, seed=0, resamples=500)
        >>> drawn.weights.shape, bool((drawn.weights.sum(1) == 13).all())
        ((500, 13), True)
    """

    def __init__(self, frames: int, *, seed: int = 0, resamples: int = RESAMPLES) -> None:
        if resamples < 0:
            raise InputValueError(f"robustness: resamples must be 0 or more draws of the frames; got {resamples}.")
        draws = resamples if frames >= FEWEST_FRAMES else 0
        generator = np.random.default_rng(np.random.SeedSequence(seed % 2**64))
        self.weights: Floats = generator.multinomial(frames, np.full(frames, 1 / frames), size=draws).astype(np.float64)

    def values(self, counters: Sequence[Counter], clear: Counter | None = None) -> dict[str, Floats]:
        """Performance over each draw ``(B,)`` by class, and under "" their mean; mean over the storms."""
        every = [each.resampled(self.weights, clear) for each in counters]
        return {name: np.asarray(np.mean([one[name] for one in every], axis=0)) for name in every[0]}

    @staticmethod
    def interval(values: Floats) -> Interval | None:
        """Of the central 95 % of the values that are defined; ``None`` where those are too few for a percentile."""
        there = values[~np.isnan(values)]
        if len(there) < FEWEST_VALUES:
            return None
        tail = 50.0 * (1.0 - CONFIDENCE)
        low, high = np.percentile(there, [tail, 100.0 - tail])
        return Interval(float(low), float(high))
