"""Verdict of held-out conditions on effects that were fitted elsewhere.

References:
    GAP.md 4.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from torchweather.gap.inference.config import METHOD, NUMERICS
from torchweather.gap.inference.global_test import expected_square
from torchweather.gap.inference.likelihood import SimulatorLikelihood
from torchweather.gap.inference.profiled_conditions import Fit
from torchweather.gap.inference.residual_tests import residual_test

__all__ = ["HeldOut", "excess_left", "held_out"]


@dataclass(frozen=True)
class HeldOut:
    """The held-out conditions' departure, the weather's record refitted.

    Args:
        gap: its root mean square, in units of the simulator's own scatter.
        floor: what a perfect model has: noise alone, the nuisances refitted.
        spread: standard deviation of that floor from draw to draw.
        misfit: its square, summed.
        p_value: probability that noise leaves as much, in the group or the common pattern that departs most. A
            gap alone does not say so: of weather in banks a few frames differ from others by more than the noise of
            their elements, and noise leaves more than 1.
    """

    gap: float
    floor: float
    spread: float
    misfit: float
    p_value: float


def held_out(held: SimulatorLikelihood, fitted: Fit, seed: int) -> HeldOut:
    """The held-out departure at a point of effects."""
    counted = max(expected_square(held), 1.0)
    nulls = held.null_residuals(fitted.nuisance, NUMERICS.floor_draws, seed)
    left = np.einsum("rk,rk->r", nulls, fitted.nuisance(nulls))
    floor = np.sqrt(np.maximum(left, 0.0) / counted)  # rounding, where departures are millions of scatters
    gap = math.sqrt(max(fitted.misfit, 0.0) / counted)
    test, apart = residual_test(held, fitted), fitted.nuisance.left(fitted.residual)
    p_value = min(test.p_value(apart), test.common_p_value(apart))
    return HeldOut(gap, float(floor.mean()), float(floor.std()), fitted.misfit, p_value)


def excess_left(before: float, after: float, floor: float) -> float | None:
    """Share of the held-out departure beyond a perfect model's that is left; ``None`` where there is none to shrink.

    Example:
        >>> excess_left(3.0, 1.5, 1.0), excess_left(3.0, 0.9, 1.0), excess_left(1.0, 1.0, 1.0)
        (0.25, 0.0, None)
    """
    return max(after - floor, 0.0) / (before - floor) if before > METHOD.least_excess * floor else None
