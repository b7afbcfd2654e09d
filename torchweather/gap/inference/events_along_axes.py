"""Correlations of counts of the same events along several axes: an event is one event on each of them.

A lost beam is a loss in a bin of range, in one of azimuth, in one of elevation. Portions of simulated frames show how
such entries go together where they hold events. Where they hold none, the axes are taken as independent: of two Poisson
counts with the expected numbers ``q_i L`` and ``p_j L`` of L events, the correlation is then ``sqrt(q_i p_j)``. Without
it one event at a place where none was simulated would depart in as many entries as there are axes.

References:
    GAP.md 3 (2, 4).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from torchweather.gap.inference.config import NUMERICS, SCATTER
from torchweather.gap.statistics.frame_statistics import COUNTED, Layout, Pool

__all__ = ["EventsAlongAxes", "events_along_axes"]

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class EventsAlongAxes:
    """Correlations of counted entries, axes independent, and how much is known of them otherwise.

    Args:
        correlation: ``(P, P)``; the unit matrix outside counted entries.
        unseen: ``(P,)`` share of the correlations that is taken from it: 1 where no event was simulated, 0 of entries
            that are no counts.
    """

    correlation: Floats
    unseen: Floats

    def mixed(self, seen: Floats, scatter_share: Floats) -> Floats:
        """Correlations ``(P, P)`` from those of simulated events and, as far as there were none, these.

        Args:
            seen: ``(P, P)`` of simulated events.
            scatter_share: ``(P,)`` share of an entry's scatter that they tell.
        """
        known, unknown = np.sqrt(1.0 - self.unseen) * scatter_share, np.sqrt(self.unseen)
        found: Floats = seen * np.outer(known, known) + self.correlation * np.outer(unknown, unknown)
        return found


def events_along_axes(layout: Layout, pools: Mapping[str, Pool]) -> EventsAlongAxes:
    """Events of the counted statistics of simulated frames, over all conditions.

    Args:
        layout: of the vectors.
        pools: condition to simulated frames.
    """
    seen, unseen = np.zeros(layout.size), np.zeros(layout.size)
    families: dict[str, list[slice]] = {}
    for group, part in zip(layout.binned, layout.slices, strict=False):
        if group.kind not in COUNTED:
            continue
        families.setdefault(layout.same_events.get(group.statistic, group.statistic), []).append(part)
        for pool in pools.values():
            weight, value = (getattr(pool.frames, name)[:, part].mean(0) for name in ("weight", "value"))
            seen[part] += value if group.kind == "count" else np.minimum(value, weight - value)
        unseen[part] = 1.0 / (1.0 + NUMERICS.portioned_frames * seen[part] / SCATTER.counting_prior_frames)
    correlation = np.zeros((layout.size, layout.size))
    for parts in families.values():
        totals = [NUMERICS.pool_frames * seen[part].sum() + SCATTER.jeffreys_events for part in parts]
        column = np.zeros((layout.size, len(parts)))
        for number, part in enumerate(parts):
            expected = NUMERICS.pool_frames * seen[part] + SCATTER.jeffreys_events
            # An axis that ends before the others covers less of the events.
            covered = totals[number] / max(totals)
            column[part, number] = np.sqrt(covered * expected / expected.sum())
        whole = column.sum(1)
        correlation += np.outer(whole, whole) - column @ column.T
    np.fill_diagonal(correlation, 1.0)
    return EventsAlongAxes(correlation, unseen)
