"""What the figures of a bench must reach."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

__all__ = ["BARS", "against_bars"]

# Figure of the table, its entry, whether it must be at least or at most, and what. A share of alarms among nulls of the
# screen is at most 4 in 400.
BARS: tuple[tuple[str, str, str, float], ...] = (
    ("singles_identifiable_exact", "share", "least", 0.97),
    ("singles_wrong_asserted", "share", "most", 0.02),
    ("singles_identifiable_unknown", "share", "most", 0.03),
    ("pairs_both", "share", "least", 0.93),
    ("screen_nulls_alarm", "share", "most", 0.01),
    ("nulls_alarm", "share", "most", 0.0),
    ("outside_unknown", "share", "least", 0.95),
    ("coverage_90", "share", "least", 0.87),
    ("interval_width_over_known", "median", "most", 3.0),
    ("gap_after_within_1.15_floor", "share", "least", 0.9),
    ("other_metrics_after_over_before", "median", "most", 0.25),
    ("seconds", "median", "most", 30.0),
)


def against_bars(table: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Each bar with what was reached; ``holds`` is ``None`` where nothing was counted.

    Args:
        table: of ``score``.
    """
    found = []
    for figure, entry, side, limit in BARS:
        value = table[figure][entry]
        holds = None if value is None else bool(value >= limit if side == "least" else value <= limit)
        found.append({"figure": figure, f"at_{side}": limit, "reached": value, "holds": holds})
    return found
