"""Forward-selection gate: chi-square that an added effect must gain beyond the model error of those found.

A stage that is off by a share e of what it does leaves ``e s`` of its signature s, anywhere along it. Of that an added
effect with the signature u, of length one, explains at most ``e^2 (sum |u| |s|)^2``: all of it where it acts as the
first one, none where that does nothing.

References:
    GAP.md 3 (7).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from torchweather.gap.inference.config import NUMERICS
from torchweather.gap.inference.likelihood import Fit, SimulatorLikelihood

__all__ = ["explained_beside", "response_of"]

Floats = NDArray[np.float64]


def explained_beside(search: SimulatorLikelihood, fit: Fit, responses: Floats) -> Floats:
    """Of what the effects of a fit explain the most that another with such a response could take part in.

    Args:
        search: its simulator.
        fit: with the effects that were found.
        responses: ``(K, C P)`` whitened changes by added ones, of any length.

    Returns:
        ``(K,)`` ``(sum |u| |s|)^2``, each at most ``|s|^2``.
    """
    names = [target.condition.id for target in search.measured]
    change = [fit.base.mean[name] - search.start.mean[name] for name in names]
    done = np.abs(fit.nuisance(search.whitened(fit.base, change)))
    added = np.abs(fit.nuisance(responses))
    norm = np.maximum((added**2).sum(-1), 1e-12)
    found: Floats = (added @ done) ** 2 / norm
    return found


def response_of(search: SimulatorLikelihood, fit: Fit, name: str) -> Floats:
    """Change by one effect of a fit where it stands, ``(C P,)``."""
    there, here = (search.mean(point, NUMERICS.screen_frames) for point in (fit.point, fit.point.without(name)))
    return search.whitened(fit.base, [new - old for new, old in zip(there, here, strict=True)])
