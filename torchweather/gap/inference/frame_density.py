"""Density of the weather from frame to frame: gusts and banks move all entries of a frame together.

The mean of a few such frames is off as if the weather record were. That is no noise of each entry, it is a nuisance
that all have in common. With the logarithm of the densities normal, of standard deviation s, those of n frames have

    a mean that is off by s / sqrt(n), and a mean square that is off by s^2 sqrt(2 / n)

The first moves a mean vector along its slope, the second along its curvature.

References:
    GAP.md 3 (2, 4).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping

import numpy as np
from numpy.typing import NDArray

from torchweather.gap.inference.simulated_distribution import SimulatedDistribution
from torchweather.gap.statistics.frame_statistics import COUNTED, Layout
from torchweather.pipeline.effect import Effect

__all__ = ["density_errors", "log_density_sd", "without_density_errors"]

Floats = NDArray[np.float64]


def log_density_sd(effects: Iterable[tuple[type[Effect], Mapping[str, float]]]) -> float:
    """Standard deviation s of the logarithm of the density of frames, by effects with their parameters."""
    return math.hypot(*(values[effect.frame_density] for effect, values in effects if effect.frame_density))


def density_errors(frames: int, simulated: int, low: Floats, middle: Floats, high: Floats) -> tuple[Floats, Floats]:
    """Changes ``(P,)`` of a mean vector by one standard deviation of either error.

    Args:
        frames: n, measured.
        simulated: frames, whose mean is off as well.
        low, middle, high: mean vectors ``(P,)`` with the logarithm of the weather's intensity less by s, as it is, and
            more by s.

    Example:
        >>> straight = density_errors(4, 10**9, np.array([1.0]), np.array([2.0]), np.array([3.0]))
        >>> [one.round(3).tolist() for one in straight]
        [[0.5], [0.0]]
    """
    few = math.sqrt(1.0 / frames + 1.0 / simulated)
    return 0.5 * few * (high - low), math.sqrt(0.5) * few * (high + low - 2.0 * middle)


def without_density_errors(
    base: SimulatedDistribution,
    still: SimulatedDistribution,
    errors: Mapping[str, tuple[Floats, Floats]],
    layout: Layout,
) -> SimulatedDistribution:
    """A distribution whose scatter has no part by the density of frames.

    Args:
        base: with it.
        still: that of weather that is the same in all frames: no entry has less scatter.
        errors: condition to the changes of its mean vector.
        layout: of the vectors.
    """
    counts = layout.each(lambda group: group.kind in COUNTED)

    def narrower(scatter: Mapping[str, Floats], least: Mapping[str, Floats]) -> dict[str, Floats]:
        found = {}
        for name, own in scatter.items():
            apart = np.sqrt(np.maximum(own**2 - np.square(errors[name]).sum(0), least[name] ** 2))
            # Elements of all frames together differ by what frames do. A mean of them has no more noise for it.
            alone = np.where(layout.averages, least[name], np.where(counts, apart, own))
            found[name] = np.where(still.used[name], np.minimum(alone, own), own)
        return found

    return base.with_scatter(narrower(base.sd, still.sd), narrower(base.total, still.total))
