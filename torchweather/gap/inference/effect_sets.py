"""Sets of effects, scored on response templates before any is fitted in the simulator.

Record and systematics stay within their bounds (``bounded_step``). Without them a record that would have to be off by
ten standard deviations beside one effect costs little more than the effect that is missing, and the right pair is not
looked at.

References:
    GAP.md 3 (6).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from torchweather.gap.inference.config import METHOD
from torchweather.gap.inference.response_templates import ResponseTemplate, pair_delta_chi2
from torchweather.gap.inference.systematics import Bounds, Systematics, bounded_step

__all__ = ["EffectSet", "best_effect_pairs"]

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


def best_effect_pairs(
    templates: Sequence[ResponseTemplate], residual: Floats, nuisance: Systematics, bounds: Bounds, least: float
) -> list[EffectSet]:
    """Pairs of different effects that gain more than some amount over the best of them alone, best first.

    Of each pair the templates that explain most without the bounds are taken.

    Args:
        templates: responses.
        residual: ``(C P,)``.
        nuisance: where they stand, and
        bounds: where they may.
        least: that a pair must gain over the best single one.
    """

    def scored(*some: ResponseTemplate) -> EffectSet:
        columns = np.stack([template.response for template in some], 1)
        low, high = (np.full(len(some), end) for end in METHOD.template_amplitudes)
        found = bounded_step(residual, nuisance, bounds, columns, Bounds(low, high))
        return EffectSet(some, tuple(float(one) for one in found.amplitudes), alone - found.misfit)

    nothing = np.zeros((len(residual), 0))
    alone = bounded_step(residual, nuisance, bounds, nothing, Bounds(np.zeros(0), np.zeros(0))).misfit
    gain = pair_delta_chi2(templates, nuisance.left(residual), nuisance)
    names = np.array([template.id for template in templates])
    best: dict[frozenset[str], tuple[ResponseTemplate, ResponseTemplate]] = {}
    for one, other in zip(*np.unravel_index(np.argsort(-gain, axis=None), gain.shape), strict=True):
        if names[one] != names[other] and len(best) < METHOD.pairs_screened:
            best.setdefault(frozenset((names[one], names[other])), (templates[one], templates[other]))
    singles = {id(template): template for pair in best.values() for template in pair}
    needed = max((scored(template).gain for template in singles.values()), default=0.0) + least
    pairs = [scored(*pair) for pair in best.values()]
    worth = [pair for pair in pairs if pair.gain >= needed and min(pair.amplitudes) > 0.0]
    return sorted(worth, key=lambda pair: -pair.gain)
