"""Verdict on simulated over measured values: their ratio, its interval, and what the same data would have shown."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import stats

__all__ = ["BOUND", "Row", "markdown", "row_of"]

BOUND = 1.5  # a factor that data must be able to show before agreement counts
LEVEL, POWER = 0.9, 0.8


@dataclass(frozen=True)
class Row:
    """One comparison.

    Args:
        recording, quantity: what was compared.
        units: independent parts of the recording (blocks, links, frames).
        ratio, low, high: simulated over measured, geometric mean of the units, with its central 90 % interval.
        seen_from: smallest factor that these units would have shown with 80 % power.
    """

    recording: str
    quantity: str
    units: int
    ratio: float
    low: float
    high: float
    seen_from: float

    @property
    def verdict(self) -> str:
        """``inconsistent``, ``consistent within`` a factor, or ``not decided``."""
        if not self.low <= 1.0 <= self.high:
            return "inconsistent"
        if self.seen_from > BOUND:
            return "not decided"
        return f"consistent within {max(self.high, 1.0 / self.low):.2f}"


def row_of(recording: str, quantity: str, ratios: Sequence[float]) -> Row:
    """A comparison from the ratios of independent units.

    The interval is Student's t of their logarithms. A factor is seen with 80 % power where it is as large as the half
    width of the interval and the 80 % quantile of the error together.
    """
    logs = np.log(np.asarray(ratios, dtype=np.float64))
    logs = logs[np.isfinite(logs)]
    freedom = len(logs) - 1
    if freedom < 1:
        raise ValueError(f"{recording}, {quantity}: expected 2 or more units with a finite ratio; got {len(logs)}.")
    error = float(logs.std(ddof=1)) / math.sqrt(len(logs))
    reach, more = (float(stats.t.ppf(q, freedom)) * error for q in ((1.0 + LEVEL) / 2.0, POWER))
    middle = float(logs.mean())
    ends = (math.exp(middle - reach), math.exp(middle + reach))
    return Row(recording, quantity, len(logs), math.exp(middle), *ends, math.exp(reach + more))


def markdown(rows: Sequence[Row]) -> str:
    """A table of the rows."""
    lines = [
        "| recording | quantity | units | simulated / measured | seen from | verdict |",
        "| --- | --- | --- | --- | --- | --- |",
    ]
    lines += [
        f"| {row.recording} | {row.quantity} | {row.units} | {row.ratio:.2f} ({row.low:.2f} to {row.high:.2f}) "
        f"| {row.seen_from:.2f} | {row.verdict} |"
        for row in rows
    ]
    return "\n".join(lines)
