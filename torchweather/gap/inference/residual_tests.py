"""Tests of the residual, statistic by statistic: a departure of a few entries does not drown in the noise of others.

Of each statistic along each axis the squares of its whitened entries are held against those of noise, and so is the
pattern that all conditions have in common: what acts alike in each of them is a few numbers there. Each entry has the
square that noise is expected to leave of it (``SimulatedDistribution.expected``): a statistic of a few bins that hold
events, and of many that never do, is one of a few entries. One event where hardly any is expected makes a square far
above that; and a scatter that few frames tell is no sure measure: the sum follows the law of F. What a model of a
sensor is not known to (``SimulatedDistribution.model``) is one departure that all conditions have in common.

References:
    GAP.md 3 (7): look at the groups of statistics that the effects leave unchanged. Satterthwaite 1946 (a sum of
    squares of different scatter). Snedecor 1934 (F: squares over a scatter that is itself estimated).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2, f

from torchweather.gap.inference.config import SCATTER
from torchweather.gap.inference.likelihood import SimulatorLikelihood
from torchweather.gap.inference.profiled_conditions import Fit

__all__ = ["ResidualTest", "residual_test"]

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class ResidualTest:
    """Noise of the squares of each group of entries.

    Args:
        places: ``(P,)`` group of each entry.
        used: ``(C, P)`` entries that count.
        noise: ``(C, P)`` square of an entry that noise leaves at the mean.
        event: ``(C, P)`` square that one event beyond the expected ones makes of an entry; 0 of what has none.
        degrees_of_freedom: ``(C, P)``, with which that noise is known.
        model: ``(C, P)`` square that the error of a model leaves beside it, the same departure in all conditions.
        scene: ``(C,)`` number of the scene of each condition, whose clear frames make one error of its noise; one scene
            where it is left out.
    """

    places: NDArray[np.intp]
    used: NDArray[np.bool_]
    noise: Floats
    event: Floats | float = 0.0
    degrees_of_freedom: Floats | float = np.inf
    model: Floats | float = 0.0
    scene: NDArray[np.intp] | int = 0

    @property
    def groups(self) -> int:
        """Number G of groups."""
        return int(self.places.max()) + 1

    def squares(self, left: Floats) -> Floats:
        """Summed squares ``(G,)`` of what is left ``(C P,)``."""
        return self._summed((left.reshape(self.used.shape) ** 2).sum(0))

    def p_value(self, left: Floats) -> float:
        """Probability that noise leaves as much in the group that departs most, of as many groups as there are."""
        level, uneven = self._levels()
        return self._least(level, uneven, self._unsure(self.noise * self.used), self.squares(left))

    def common_p_value(self, left: Floats) -> float:
        """The same of what the conditions have in common: each entry summed over those where it counts, two at least,
        over the root of their number, which noise leaves as it was."""
        number = np.maximum(self.used.sum(0), 1)
        common = self.used.sum(0) > 1
        pattern = common * (left.reshape(self.used.shape) * self.used).sum(0) / np.sqrt(number)
        noise = common * self.noise * self.used / number
        model = common * np.square((np.sqrt(self.model) * self.used).sum(0)) / number
        level = noise.sum(0) + model
        uneven = level**2 + common * (self._of_events() / number**2).sum(0)
        sums = [self._summed(one) for one in (level, uneven, pattern**2)]
        return self._least(sums[0], sums[1], self._unsure(noise), sums[2])

    def _levels(self) -> tuple[Floats, Floats]:
        """Means ``(G,)`` of the sums of squares, and half the variances that they have about those."""
        model = self.model * self.used
        level = (self.noise + self.model) * self.used
        uneven = (level**2 + self._of_events()).sum(0) + np.square(model.sum(0)) - (model**2).sum(0)
        return self._summed(level.sum(0)), self._summed(uneven)

    def _unsure(self, noise: Floats) -> Floats:
        """``(G,)`` level of each group over its degrees of freedom.

        The error of the noise is one in all bins and conditions of a scene, and another one in each scene.
        """
        scenes = np.broadcast_to(self.scene, len(noise))
        level, found = self._summed(noise.sum(0)), np.zeros(self.groups)
        for scene in np.unique(scenes):
            own = scenes == scene
            of_scene = self._summed(noise[own].sum(0))
            found += of_scene * self._summed((noise / self.degrees_of_freedom)[own].sum(0))
        return found / np.maximum(level, 1e-300)

    def _of_events(self) -> Floats:
        """``(C, P)`` half the variance of an entry's square by rare events, beyond that of a normal number."""
        rare = np.maximum(1.0 - self.noise, 0.0)
        return np.asarray(0.5 * self.noise * rare * self.event * self.used, dtype=np.float64)

    def _summed(self, values: NDArray[Any]) -> Floats:
        """Values ``(P,)`` summed by group."""
        return np.asarray(np.bincount(self.places, values, self.groups), dtype=np.float64)

    @staticmethod
    def _least(level: Floats, uneven: Floats, unsure: Floats, squares: Floats) -> float:
        """Probability of the least likely of some sums of squares.

        Args:
            level: ``(G,)`` their means.
            uneven: half the variances that they have about those.
            unsure: the levels over the degrees of freedom with which they are known (``_unsure``).
            squares: the sums.
        """
        some = level > 0
        if not some.any():
            return 1.0
        level, uneven, unsure, squares = level[some], uneven[some], unsure[some], squares[some]
        entries = level**2 / uneven
        known = unsure * SCATTER.known_degrees <= level
        degrees_of_freedom = level / np.where(known, level, unsure)
        each = np.where(
            known, chi2.sf(squares * level / uneven, entries), f.sf(squares / level, entries, degrees_of_freedom)
        )
        return float(min(1.0, some.sum() * each.min()))

    def beyond_chance(self, left: Floats) -> float:
        """Sum of what the squares of groups exceed noise by, less what chance makes of it: groups that lie below what
        noise leaves count as 0.

        A normal number of variance v is above its mean by ``sqrt(v / (2 pi))`` on average, counted so.
        """
        level, uneven = self._levels()
        over = np.maximum(self.squares(left) - level, 0.0).sum()
        return float(max(over - np.sqrt(uneven / np.pi).sum(), 0.0))


def residual_test(search: SimulatorLikelihood, base: Fit) -> ResidualTest:
    """The noise of the model as it is.

    Args:
        search: its simulator.
        base: the model without added effects, its nuisances fitted.
    """
    layout, names = search.model.layout, [target.condition.id for target in search.measured]
    places = np.repeat(np.arange(len(layout.groups)), [group.bins for group in layout.groups])
    used, expected, event, degrees_of_freedom, known_to = (
        np.stack([getattr(base.base, field)[name] for name in names])
        for field in ("used", "expected", "event", "degrees_of_freedom", "model")
    )
    numbered = {one: place for place, one in enumerate(dict.fromkeys(one.condition.scene for one in search.measured))}
    scene = np.array([numbered[target.condition.scene] for target in search.measured])
    noise = np.maximum(expected, SCATTER.least_level)
    return ResidualTest(places, used, noise, event, degrees_of_freedom, known_to, scene)
