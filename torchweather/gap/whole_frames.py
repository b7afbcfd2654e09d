"""What whole frames do, and how well a model knows means: nuisances that the simulator cannot be moved along.

The scatter of an entry says how far it departs, not that all entries of a frame go together, as they do when a scale or
a clock is off.

References:
    GAP.md 3 (2).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from torchweather.gap.baseline import Baseline, FrameModel, Target
from torchweather.gap.statistics import PARTICLE_AXIS, Pool

__all__ = ["clear_errors", "model_errors"]

Floats = NDArray[np.float64]

Column = Callable[[Mapping[int, Floats]], Floats]
"""Departures ``(P,)`` of some conditions, by their place, to one whitened column ``(C P,)``."""

KNOWN_TO = 0.005  # of what weather does to a mean: two implementations of one physics differ by as much
SELDOM = 1e-3  # how often noise of whole frames may reach farther than stated


def clear_errors(model: FrameModel, measured: Sequence[Target], column: Column) -> list[Floats]:
    """Columns of what whole frames do to means and spreads of objects, from how clear frames of all scenes differ.

    The error of each scene's clear mean moves all its conditions alike; the mean of a condition's own frames has one of
    its own.
    """
    layout = model.layout
    # Clear frames hardly have particles; the few that one has say nothing of those in weather.
    kinds = [group.kind if group.axis != PARTICLE_AXIS else "" for group in layout.groups]
    moved = np.repeat([kind in ("mean", "spread") for kind in kinds], [group.bins for group in layout.groups])
    scenes = {target.condition.scene: target.clear_frames for target in measured}
    degrees = sum(scenes.values()) - len(scenes)
    if degrees < 1:
        return []
    one_frame: list[Floats] = []  # summed up in square: the variance of a frame
    evenly: dict[str, float] = {}  # variance of a mean over all elements
    for scene, number in scenes.items():
        pool = Pool(layout, model.clear(scene))
        each = pool.vectors(np.arange(number)[:, None])
        # Departures from the mean of the others are larger than those from the mean of all.
        less = (number - 1) / number / math.sqrt(degrees)
        one_frame += list(np.where(moved, each - each.mean(0), 0.0) * less)
        for name, values in pool.averages().items():
            evenly[name] = evenly.get(name, 0.0) + float(((values - values.mean()) ** 2).sum()) * less**2
    # A few frames do not tell how an even shift of all entries looks: it is known.
    for name, variance in evenly.items():
        own_entries = [np.full(group.bins, group.is_average_of(name)) for group in layout.groups]
        one_frame.append(math.sqrt(variance) * np.concatenate(own_entries))
    one_frame = [departure * math.sqrt(widened(degrees)) for departure in one_frame]
    columns = []
    for scene, number in scenes.items():
        own = [place for place, target in enumerate(measured) if target.condition.scene == scene]
        for departure in one_frame:
            columns.append(column(dict.fromkeys(own, departure / math.sqrt(number))))
            columns += [column({place: departure / math.sqrt(measured[place].frames)}) for place in own]
    return columns


def model_errors(model: FrameModel, measured: Sequence[Target], base: Baseline, column: Column) -> list[Floats]:
    """Columns of how well a model knows what weather does to means: in every condition, and in all alike."""
    groups = model.layout.groups
    averages = np.concatenate([np.full(group.bins, group.is_average_of(group.statistic)) for group in groups])
    each = {
        place: np.where(averages, KNOWN_TO * base.mean[target.condition.id], 0.0)
        for place, target in enumerate(measured)
    }
    return [column(each), *(column({place: own}) for place, own in each.items())]


def widened(degrees: int) -> float:
    """Variance at which the normal law reaches as far, one time in 1,000, as Student's of a scatter known from so many
    degrees of freedom.

    Example:
        >>> round(widened(14), 2), round(widened(2), 1)
        (1.58, 92.2)
    """
    return float((stats.t.isf(0.5 * SELDOM, degrees) / stats.norm.isf(0.5 * SELDOM)) ** 2)
