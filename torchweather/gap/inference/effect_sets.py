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

from torchweather.gap.inference.config import NUMERICS
from torchweather.gap.inference.response_templates import ResponseTemplate, pair_delta_chi2
from torchweather.gap.inference.systematics import Bounds, Systematics, bounded_step, moving_only

__all__ = ["EffectSet", "SetScores", "best_effect_pairs", "best_single_effects"]

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


class SetScores:
    """Gains of sets of effects on their response templates, with the nuisances within bounds.

    Args:
        templates: responses.
        residual: ``(C P,)``.
        nuisance: where they stand, and
        bounds: where they may.
    """

    def __init__(
        self, templates: Sequence[ResponseTemplate], residual: Floats, nuisance: Systematics, bounds: Bounds
    ) -> None:
        self.templates = templates
        responses = np.stack([template.response for template in templates], 1)
        self.residual, self.nuisance, self.responses = moving_only(residual, nuisance, responses)
        self.bounds = Bounds(bounds.low[: nuisance.moving], bounds.high[: nuisance.moving])
        self.alone = self._misfit(())[0]

    def __call__(self, *places: int) -> EffectSet:
        """The set of the templates at some places."""
        misfit, amplitudes = self._misfit(places)
        return EffectSet(tuple(self.templates[one] for one in places), amplitudes, self.alone - misfit)

    def _misfit(self, places: tuple[int, ...]) -> tuple[float, tuple[float, ...]]:
        low, high = (np.full(len(places), end) for end in NUMERICS.template_amplitudes)
        columns = self.responses[:, list(places)]
        found = bounded_step(self.residual, self.nuisance, self.bounds, columns, Bounds(low, high))
        return found.misfit, tuple(float(one) for one in found.amplitudes)


def best_single_effects(
    templates: Sequence[ResponseTemplate], residual: Floats, nuisance: Systematics, bounds: Bounds
) -> list[EffectSet]:
    """The best template of each effect, with the nuisances within bounds, best first.

    Args:
        templates: responses.
        residual: ``(C P,)``.
        nuisance: where they stand, and
        bounds: where they may.
    """
    scored = SetScores(templates, residual, nuisance, bounds)
    best: dict[str, EffectSet] = {}
    for place, template in enumerate(templates):
        one = scored(place)
        if template.id not in best or one.gain > best[template.id].gain:
            best[template.id] = one
    return sorted(best.values(), key=lambda one: -one.gain)


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
    scored = SetScores(templates, residual, nuisance, bounds)
    gain = pair_delta_chi2(templates, nuisance.left(residual), nuisance)
    names = np.array([template.id for template in templates])
    best: dict[frozenset[str], tuple[int, int]] = {}
    for one, other in zip(*np.unravel_index(np.argsort(-gain, axis=None), gain.shape), strict=True):
        if names[one] != names[other] and len(best) < NUMERICS.pairs_screened:
            best.setdefault(frozenset((names[one], names[other])), (int(one), int(other)))
    singles = {place for pair in best.values() for place in pair}
    needed = max((scored(place).gain for place in singles), default=0.0) + least
    pairs = [scored(*pair) for pair in best.values()]
    worth = [pair for pair in pairs if pair.gain >= needed and min(pair.amplitudes) > 0.0]
    return sorted(worth, key=lambda pair: -pair.gain)
