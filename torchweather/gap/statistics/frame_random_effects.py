"""Random effects of whole frames, and errors of a model's means: nuisances that the simulator cannot be moved along.

The scatter of an entry says how far it departs, not that all entries of a frame go together, as they do when a scale or
a clock is off.

References:
    GAP.md 3 (2). Variance components: Searle, Casella & McCulloch 1992.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from collections.abc import Set as AbstractSet
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from torchweather.gap.inference.config import NUMERICS, SCATTER
from torchweather.gap.inference.simulated_distribution import FrameModel, Observation, SimulatedDistribution
from torchweather.gap.statistics.frame_statistics import PARTICLE_AXIS, TINY, Layout, Pool

__all__ = ["FrameDeparture", "clear_errors", "clear_means", "frame_departures", "model_errors", "widened"]

Floats = NDArray[np.float64]

Column = Callable[[Mapping[int, Floats]], Floats]
"""Departures ``(P,)`` of some conditions, by their place, to one whitened column ``(C P,)``."""


@dataclass(frozen=True)
class FrameDeparture:
    """One of the ways in which a whole frame departs from others, by one standard deviation.

    Args:
        entries: ``(P,)``.
        even: the statistic that it shifts evenly, if it is of that kind.
    """

    entries: Floats
    even: str | None = None


def frame_departures(model: FrameModel, measured: Sequence[Observation]) -> list[FrameDeparture]:
    """Departures of means and spreads of objects by whole frames, from the differences of clear frames of all scenes.

    The sum of their squares is the variance of a frame. The noise of a frame's elements is in the scatter of each entry
    already: of the even shift of a statistic, and of the residual of each frame, the excess over it counts.
    """
    layout = model.layout
    # Clear frames hardly have particles; the few that one has say nothing of those in weather.
    moved = layout.each(lambda group: group.axis != PARTICLE_AXIS and group.kind in ("mean", "spread"))
    statistic = layout.each(lambda group: group.statistic)
    scenes = {target.condition.scene: target.clear_frames for target in measured}
    degrees_of_freedom = sum(scenes.values()) - len(scenes)
    if degrees_of_freedom < 1:
        return []
    residuals: list[Floats] = []  # summed up in square: the variance of a frame
    evenly: dict[str, float] = {}  # variance of a mean over all elements
    noises: dict[str, float] = {}  # what the noise of those makes of it
    found, expected = np.zeros(layout.size), np.zeros(layout.size)
    for scene, number in scenes.items():
        pool = Pool(layout, model.clear(scene))
        each = pool.vectors(np.arange(number)[:, None])
        # Departures from the mean of the others are larger than those from the mean of all.
        less = (number - 1) / number
        portioned = Pool(layout, model.clear(scene, NUMERICS.portions))
        noise = less**2 * (portioned.element_noise(NUMERICS.portions, 1, number) ** 2).sum(1).mean(0)
        apart = np.where(moved, each - each.mean(0), 0.0) * less
        for name, (values, variance) in pool.averages(noise).items():
            even = (values - values.mean()) * less
            apart -= even[:, None] * (layout.averages & (statistic == name))
            excess = float((even**2).sum()) - (number - 1) * variance
            evenly[name] = evenly.get(name, 0.0) + excess / degrees_of_freedom
            noises[name] = noises.get(name, 0.0) + (number - 1) * variance / degrees_of_freedom
        found += (apart**2).sum(0) / degrees_of_freedom
        expected += noise * (number - 1) / degrees_of_freedom
        residuals += list(apart / math.sqrt(degrees_of_freedom))
    share = np.zeros(layout.size)
    for name in set(statistic[moved]):
        own = moved & (statistic == name) & (found > 0)
        if own.any():
            share[own] = max(1.0 - 1.0 / float(np.mean(found[own] / np.maximum(expected[own], TINY))), 0.0)
    widening = math.sqrt(widened(degrees_of_freedom))
    one_frame = [FrameDeparture(widening * np.sqrt(share) * residual) for residual in residuals if share.any()]
    # A few frames do not tell how an even shift of all entries looks: it is known.
    few = degrees_of_freedom < SCATTER.few_degrees
    well_may_be = SCATTER.well_may_be_sd * math.sqrt(2.0 / degrees_of_freedom) if few else 0.0
    for name, excess in evenly.items():
        # Two frames that are alike by chance, to the noise of their elements, make no steady sensor.
        variance = max(excess, well_may_be * noises[name])
        entries = layout.averages & (statistic == name)
        one_frame += [FrameDeparture(widening * math.sqrt(variance) * entries, name)] if variance > 0 else []
    return one_frame


def clear_errors(
    departures: Sequence[FrameDeparture], measured: Sequence[Observation], simulated: AbstractSet[str], column: Column
) -> list[Floats]:
    """Columns of what whole frames do: the error of each scene's clear mean moves all its conditions alike; the mean of
    a condition's own frames has one of its own.

    Args:
        departures: of one frame (``frame_departures``).
        measured: the conditions.
        simulated: statistics whose even shift by the clear mean's error the simulator can be moved along.
        column: makes one.
    """
    scenes = {target.condition.scene: target.clear_frames for target in measured}
    columns = []
    for scene, number in scenes.items():
        own = [place for place, target in enumerate(measured) if target.condition.scene == scene]
        for departure in departures:
            if departure.even not in simulated:
                columns.append(column(dict.fromkeys(own, departure.entries / math.sqrt(number))))
            columns += [column({place: departure.entries / math.sqrt(measured[place].frames)}) for place in own]
    return columns


def clear_means(model: FrameModel, measured: Sequence[Observation]) -> dict[str, Floats]:
    """Vector ``(P,)`` of all clear frames of each scene."""
    found = {}
    for scene in dict.fromkeys(target.condition.scene for target in measured):
        pool = Pool(model.layout, model.clear(scene))
        found[scene] = pool.vectors(np.arange(len(pool))[None])[0]
    return found


def model_errors(
    layout: Layout,
    measured: Sequence[Observation],
    base: SimulatedDistribution,
    clear: Mapping[str, Floats],
    column: Column,
) -> list[Floats]:
    """Columns of how well a model knows what weather does to means: in every condition, and in all alike.

    Args:
        layout: of the vectors.
        measured: the conditions.
        base: the model.
        clear: vectors of clear air (``clear_means``).
        column: makes one.
    """
    averages = layout.averages
    each = {
        place: np.where(
            averages,
            SCATTER.weather_mean_rel_error * (base.mean[target.condition.id] - clear[target.condition.scene]),
            0.0,
        )
        for place, target in enumerate(measured)
    }
    return [column(each), *(column({place: own}) for place, own in each.items())]


def widened(degrees_of_freedom: int) -> float:
    """Variance at which the normal law reaches as far, one time in 10,000, as Student's of a scatter known from so many
    degrees of freedom.

    Example:
        >>> round(widened(14), 2), round(widened(2), 1)
        (1.9, 660.5)
    """
    tail = 0.5 * SCATTER.frame_noise_p
    return float((stats.t.isf(tail, degrees_of_freedom) / stats.norm.isf(tail)) ** 2)
