"""Tests of the residual, statistic by statistic: a departure of a few entries does not drown in the noise of others.

Of each statistic along each axis the squares of its whitened entries are held against those of noise, and so is the
pattern that all conditions have in common: what acts alike in each of them is a few numbers there. Of shares and counts
of what hardly ever happens the expected square is taken (``SimulatedDistribution.expected``).

References:
    GAP.md 3 (7): look at the groups of statistics that the effects leave unchanged.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
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
        noise: ``(G,)`` mean square that an entry has by noise.
    """

    places: NDArray[np.intp]
    used: NDArray[np.bool_]
    noise: Floats

    @property
    def counted(self) -> Floats:
        """Number ``(G,)`` of entries that count, over all conditions."""
        return self._summed(self.used.sum(0))

    def squares(self, left: Floats) -> Floats:
        """Summed squares ``(G,)`` of what is left ``(C P,)``."""
        return self._summed((left.reshape(self.used.shape) ** 2).sum(0))

    def mean_square(self, expected: Floats) -> Floats:
        """Mean ``(G,)`` of squares ``(C, P)`` over the entries that count."""
        return self._summed(expected.sum(0)) / np.maximum(self.counted, 1.0)

    def p_value(self, left: Floats) -> float:
        """Probability that noise leaves as much in the group that departs most, of as many groups as there are."""
        return self._least(self.squares(left), self.counted)

    def common_p_value(self, left: Floats) -> float:
        """The same of what the conditions have in common: each entry summed over those where it counts, two at least,
        over the root of their number, which noise leaves as it was."""
        number = self.used.sum(0)
        common = number > 1
        pattern = (left.reshape(self.used.shape) * self.used).sum(0) / np.sqrt(np.maximum(number, 1))
        return self._least(self._summed(common * pattern**2), self._summed(common))

    def _summed(self, values: NDArray[Any]) -> Floats:
        """Values ``(P,)`` summed by group."""
        return np.asarray(np.bincount(self.places, values, len(self.noise)), dtype=np.float64)

    def _least(self, squares: Floats, counted: Floats) -> float:
        """Probability of the least likely of some sums of squares, of so many entries each."""
        some = counted > 0
        each = chi2.sf(squares[some] / self.noise[some], counted[some])
        return float(min(1.0, some.sum() * each.min())) if some.any() else 1.0

    def excess(self, left: Floats) -> float:
        """Sum of the excess of groups over what noise leaves."""
        return float(np.maximum(self.squares(left) - self.noise * self.counted, 0.0).sum())


def residual_test(search: SimulatorLikelihood, base: Fit, overdispersion: float) -> ResidualTest:
    """The noise of the model as it is.

    Args:
        search: its simulator.
        base: the model without added effects, its nuisances fitted.
        overdispersion: how much larger in square noise is taken than stated.
    """
    groups, names = search.model.layout.groups, [target.condition.id for target in search.measured]
    places = np.repeat(np.arange(len(groups)), [group.bins for group in groups])
    found = ResidualTest(places, np.stack([base.base.used[name] for name in names]), np.ones(len(groups)))
    expected = np.stack([base.base.expected[name] for name in names]) * found.used
    level = found.mean_square(expected)
    return replace(found, noise=overdispersion * np.maximum(level, METHOD.least_level))
