"""Degrees of freedom behind a gain: how surely the noise is known that it is measured by.

A few clear frames of a scene tell the scatter of some statistics. Their noise is the same in all bins and conditions of
that scene, so each statistic has one error of its scatter there. As far as clear frames make it, it is taken for one
error of all statistics: noise that is stronger in one of them is so in the others. Another scene has other ones.

References:
    Student 1908. Satterthwaite 1946 (degrees of a weighted sum of variances). Wallace 1959 (the normal number as
    unlikely as one of Student's, to 4 %).
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from torchweather.gap.inference.simulated_distribution import SimulatedDistribution
from torchweather.gap.statistics.frame_statistics import Layout

__all__ = ["StatisticDegrees", "as_of_known_noise", "beyond_known_noise"]

Floats = NDArray[np.float64]


class StatisticDegrees:
    """Degrees of freedom of the scatter of each statistic.

    Args:
        layout: of the vectors.
        base: their distribution.
        scenes: condition to its scene, in the order of the conditions.
    """

    def __init__(self, layout: Layout, base: SimulatedDistribution, scenes: Mapping[str, str]) -> None:
        names = list(scenes)
        statistics = [group.statistic for group in layout.groups for _ in range(group.bins)]
        numbers = {one: place for place, one in enumerate(dict.fromkeys(statistics))}
        numbered = {one: place for place, one in enumerate(dict.fromkeys(scenes.values()))}
        self.scenes, self.statistics = len(numbered), len(numbers)
        own = np.array([numbers[one] for one in statistics])
        self.places = np.concatenate([numbered[scene] * self.statistics + own for scene in scenes.values()])
        used, expected, degrees_of_freedom, told = (
            np.concatenate([getattr(base, field)[name] for name in names])
            for field in ("used", "expected", "degrees_of_freedom", "told_by_clear")
        )
        self.level = self._summed(used * expected)
        # One over the degrees of freedom: what each statistic has for itself, and what all have in common.
        self.own, self.common = (
            self._summed(used * expected * share / degrees_of_freedom) / np.maximum(self.level, 1e-300)
            for share in (1.0 - told, told)
        )

    def _summed(self, values: Floats) -> Floats:
        """Values ``(C P,)`` summed by scene and statistic."""
        return np.asarray(np.bincount(self.places, values, self.scenes * self.statistics), dtype=np.float64)

    def of(self, response: Floats) -> float:
        """Degrees of freedom of the noise along a whitened response ``(C P,)``; ``inf`` where it is known."""
        return self._together(self._summed(response**2))

    @property
    def of_all(self) -> float:
        """Those of the noise of all statistics together."""
        return self._together(self.level)

    def _together(self, weight: Floats) -> float:
        share = (weight / max(float(weight.sum()), 1e-300)).reshape(self.scenes, self.statistics)
        own, common = (values.reshape(share.shape) for values in (self.own, self.common))
        found = float((share**2 * own).sum() + (share.sum(1) * (share * common).sum(1)).sum())
        return 1.0 / found if found > 0.0 else float("inf")


def as_of_known_noise(square: Floats | float, degrees_of_freedom: Floats | float) -> Floats:
    """Square of a normal number that is as unlikely as a square in units of a scatter with degrees of freedom.

    Example:
        >>> float(as_of_known_noise(25.0, 10.0).round(2)), float(as_of_known_noise(25.0, 1e9).round(2))
        (11.93, 25.0)
    """
    nu = np.minimum(np.asarray(degrees_of_freedom, dtype=np.float64), 1e15)
    return np.asarray(_scale(nu) * nu * np.log1p(np.asarray(square) / nu), dtype=np.float64)


def beyond_known_noise(square: float, degrees_of_freedom: float) -> float:
    """The other way: a square over a scatter with degrees of freedom, as unlikely as one of a normal number.

    Example:
        >>> round(beyond_known_noise(11.93, 10.0), 1)
        25.0
    """
    nu = min(degrees_of_freedom, 1e15)
    return float(nu * np.expm1(min(square / (_scale(nu) * nu), 700.0)))


def _scale(nu: Floats | float) -> Floats | float:
    return ((8.0 * nu + 1.0) / (8.0 * nu + 3.0)) ** 2
