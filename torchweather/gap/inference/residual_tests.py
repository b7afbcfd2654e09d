"""Tests of the residual, statistic by statistic: a departure of a few entries does not drown in the noise of others.

Of each statistic along each axis the squares of its whitened entries are held against those of noise, and so is the
pattern that all conditions have in common: what acts alike in each of them is a few numbers there. Each entry has the
square that noise is expected to leave of it (``SimulatedDistribution.expected``): a statistic of a few bins that hold
events, and of many that never do, is one of a few entries.

References:
    GAP.md 3 (7): look at the groups of statistics that the effects leave unchanged. Satterthwaite 1946 (a sum of
    squares of different scatter).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from torchweather.gap.inference.config import METHOD
from torchweather.gap.inference.likelihood import Fit, SimulatorLikelihood

__all__ = ["ResidualTest", "residual_test"]

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class ResidualTest:
    """Noise of the squares of each group of entries.

    Args:
        places: ``(P,)`` group of each entry.
        used: ``(C, P)`` entries that count.
        noise: ``(C, P)`` square of an entry that noise leaves at the mean.
    """

    places: NDArray[np.intp]
    used: NDArray[np.bool_]
    noise: Floats

    @property
    def groups(self) -> int:
        """Number G of groups."""
        return int(self.places.max()) + 1

    def squares(self, left: Floats) -> Floats:
        """Summed squares ``(G,)`` of what is left ``(C P,)``."""
        return self._summed((left.reshape(self.used.shape) ** 2).sum(0))

    def p_value(self, left: Floats) -> float:
        """Probability that noise leaves as much in the group that departs most, of as many groups as there are."""
        level = self.noise * self.used
        return self._least(self.squares(left), self._summed(level.sum(0)), self._summed((level**2).sum(0)))

    def common_p_value(self, left: Floats) -> float:
        """The same of what the conditions have in common: each entry summed over those where it counts, two at least,
        over the root of their number, which noise leaves as it was."""
        number = self.used.sum(0)
        common = number > 1
        pattern = (left.reshape(self.used.shape) * self.used).sum(0) / np.sqrt(np.maximum(number, 1))
        level = common * (self.noise * self.used).sum(0) / np.maximum(number, 1)
        return self._least(self._summed(common * pattern**2), self._summed(level), self._summed(level**2))

    def _summed(self, values: NDArray[Any]) -> Floats:
        """Values ``(P,)`` summed by group."""
        return np.asarray(np.bincount(self.places, values, self.groups), dtype=np.float64)

    @staticmethod
    def _least(squares: Floats, level: Floats, level_2: Floats) -> float:
        """Probability of the least likely of some sums of squares of normal entries.

        Args:
            squares: ``(G,)``.
            level, level_2: ``(G,)`` sums of the entries' variances and of their squares.
        """
        some = level > 0
        scale = level_2[some] / level[some]
        each = chi2.sf(squares[some] / scale, level[some] / scale)
        return float(min(1.0, some.sum() * each.min())) if some.any() else 1.0

    def excess(self, left: Floats) -> float:
        """Sum of the excess of groups over what noise leaves."""
        return float(np.maximum(self.squares(left) - self._summed((self.noise * self.used).sum(0)), 0.0).sum())


def residual_test(search: SimulatorLikelihood, base: Fit, overdispersion: float) -> ResidualTest:
    """The noise of the model as it is.

    Args:
        search: its simulator.
        base: the model without added effects, its nuisances fitted.
        overdispersion: how much larger in square noise is taken than stated.
    """
    groups, names = search.model.layout.groups, [target.condition.id for target in search.measured]
    places = np.repeat(np.arange(len(groups)), [group.bins for group in groups])
    used = np.stack([base.base.used[name] for name in names])
    expected = np.stack([base.base.expected[name] for name in names])
    return ResidualTest(places, used, overdispersion * np.maximum(expected, METHOD.least_level))
