"""Sets of effects, scored on response templates before any is fitted in the simulator.

With S the responses of a set, a their amplitudes, G the changes per standard deviation of each nuisance, x where the
nuisances stand and L the inverse of their covariance, a residual r leaves

    min over a, d of |r - S a - G d|^2 + (x + d)' L (x + d),   0 <= a <= 1.35, low <= x + d <= high.

The bounds of the nuisances matter. Without them a record that would have to be off by ten standard deviations beside
one effect costs little more than the effect that is missing, and the right pair is not looked at.

References:
    GAP.md 3 (6). Least squares within bounds: Stark & Parker 1995 (scipy's ``lsq_linear``).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import lsq_linear

from torchweather.gap.inference.config import METHOD
from torchweather.gap.inference.response_templates import ResponseTemplate, pair_delta_chi2
from torchweather.gap.inference.systematics import Systematics

__all__ = ["BoundedMisfit", "EffectSet", "best_effect_pairs"]

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class EffectSet:
    """Effects that act together.

    Args:
        templates: one of each effect.
        amplitudes: of their responses.
        gain: by which they lower the misfit, with the nuisances within their bounds.
    """

    templates: tuple[ResponseTemplate, ...]
    amplitudes: tuple[float, ...]
    gain: float


class BoundedMisfit:
    """The least misfit of a residual beside some responses, with the nuisances within their bounds.

    Args:
        residual: ``(C P,)``.
        nuisance: where they stand.
        low, high: ``(K,)`` bounds of where they may stand, in standard deviations.
    """

    def __init__(self, residual: Floats, nuisance: Systematics, low: Floats, high: Floats) -> None:
        self.residual, self.response = residual, nuisance.response
        factor = np.linalg.cholesky(nuisance.precision)
        # Rows of the prior: |C (x + d)|^2 with C'C = L.
        self._prior, self._aside = factor.T, -factor.T @ nuisance.offset
        self._low, self._high = low - nuisance.offset, high - nuisance.offset
        self.alone = self([])[0]

    def __call__(self, responses: Sequence[Floats]) -> tuple[float, Floats]:
        """The misfit and the amplitude of each response."""
        number = len(responses)
        columns = np.column_stack([*responses, self.response])
        prior = np.concatenate([np.zeros((len(self._prior), number)), self._prior], 1)
        matrix = np.concatenate([columns, prior])
        target = np.concatenate([self.residual, self._aside])
        # As few rows as columns: what the columns do not reach is the same whatever they do.
        orthogonal, upper = np.linalg.qr(matrix)
        low = np.concatenate([np.full(number, METHOD.template_amplitudes[0]), self._low])
        high = np.concatenate([np.full(number, METHOD.template_amplitudes[1]), self._high])
        found = lsq_linear(upper, orthogonal.T @ target, (low, high), method="bvls").x
        return float(((target - matrix @ found) ** 2).sum()), found[:number]


def best_effect_pairs(
    templates: Sequence[ResponseTemplate], nuisance: Systematics, misfit: BoundedMisfit, least: float
) -> list[EffectSet]:
    """Pairs of different effects that gain more than some amount over the best of them alone, best first.

    Of each pair the templates that explain most without the bounds are taken.

    Args:
        templates: responses.
        nuisance: where they stand.
        misfit: of the residual, with their bounds.
        least: that a pair must gain over the best single one.
    """
    gain = pair_delta_chi2(templates, nuisance.left(misfit.residual), nuisance)
    names = np.array([template.id for template in templates])
    best: dict[frozenset[str], tuple[int, int]] = {}
    for one, other in zip(*np.unravel_index(np.argsort(-gain, axis=None), gain.shape), strict=True):
        if names[one] != names[other] and len(best) < METHOD.pairs_screened:
            best.setdefault(frozenset((names[one], names[other])), (int(one), int(other)))
    places = {place for pair in best.values() for place in pair}
    alone = {place: misfit.alone - misfit([templates[place].response])[0] for place in places}
    found = []
    for pair in best.values():
        some = tuple(templates[place] for place in pair)
        there, amplitudes = misfit([template.response for template in some])
        if misfit.alone - there >= max(alone.values()) + least and amplitudes.min() > 0.0:
            found.append(EffectSet(some, tuple(float(one) for one in amplitudes), misfit.alone - there))
    return sorted(found, key=lambda one: -one.gain)
