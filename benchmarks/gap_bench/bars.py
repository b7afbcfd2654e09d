"""What the figures of a bench must reach."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

__all__ = ["LIDAR_BARS", "Bar", "against_bars", "other_bars"]

Bar = tuple[str, str, str, float]
"""Figure of the table, its entry, whether it must be at ``least`` or at ``most``, and what."""

# A share of alarms among nulls of the screen is at most 4 in 400.
LIDAR_BARS: tuple[Bar, ...] = (
    ("singles_identifiable_exact", "share", "least", 0.97),
    ("singles_wrong_asserted", "share", "most", 0.02),
    ("singles_identifiable_unknown", "share", "most", 0.03),
    ("pairs_both", "share", "least", 0.93),
    ("screen_nulls_alarm", "share", "most", 0.01),
    ("nulls_alarm", "share", "most", 0.0),
    ("outside_unknown", "share", "least", 0.95),
    ("coverage_90", "share", "least", 0.87),
    ("interval_width_over_known", "median", "most", 3.0),
    ("gap_after_near_floor", "share", "least", 0.9),
    ("other_metrics_after_over_before", "median", "most", 0.25),
    ("seconds", "median", "most", 30.0),
)


def other_bars(seconds: float) -> tuple[Bar, ...]:
    """Bars of the camera and the radar, which may take so many seconds a study.

    A share of alarms among nulls of the whole workflow is at most 1 in 60.
    """
    return (
        ("singles_identifiable_exact", "share", "least", 0.92),
        ("singles_wrong_asserted", "share", "most", 0.03),
        ("pairs_both", "share", "least", 0.85),
        ("screen_nulls_alarm", "share", "most", 0.01),
        ("nulls_alarm", "share", "most", 1.0 / 60.0),
        ("outside_unknown", "share", "least", 0.9),
        ("coverage_90", "share", "least", 0.87),
        ("interval_width_over_known", "median", "most", 3.0),
        ("gap_after_near_floor", "share", "least", 0.9),
        ("seconds", "median", "most", seconds),
    )


def against_bars(table: Mapping[str, Any], bars: Sequence[Bar]) -> list[dict[str, Any]]:
    """Each bar with what was reached; ``holds`` is ``None`` where nothing was counted.

    Args:
        table: of ``score``.
        bars: of the sensor.
    """
    found = []
    for figure, entry, side, limit in bars:
        value = table[figure][entry]
        holds = None if value is None else bool(value >= limit if side == "least" else value <= limit)
        found.append({"figure": figure, f"at_{side}": limit, "reached": value, "holds": holds})
    return found
