"""Scatter of a condition's vector in three parts: its own frames', the simulated sample's, the clear frames'.

Simulated frames start in turn from the K clear frames of their scene. What differs between frames of one clear frame is
the weather's; what differs between clear frames is the sensor's noise, which only K frames show. A
measured condition has n fresh frames of both:

    variance of (measured - simulated mean) = (W + B) / n + W / N + B / K

with W and B the variances of one frame within and between clear frames and N simulated frames.

References:
    Variance components: Searle, Casella & McCulloch 1992.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from torchweather.gap.statistics.frame_statistics import TINY, Layout, Pool

__all__ = ["FrameComponents", "between_share", "frame_components"]

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class FrameComponents:
    """Variances of the vector of n frames.

    Args:
        within: ``(P,)`` W / n, of frames that start from one clear frame; 0 of entries that are no sums over bins.
        between: ``(P,)`` B / n, between clear frames, an unbiased estimate that may be below 0.
        unsure: ``(P,)`` relative variance of a variance that is estimated from these frames: 2 / N for normal ones,
            more where a few of them stand out.
        of_scalars: ``(S,)`` share of a scalar's variance between clear frames.
    """

    within: Floats
    between: Floats
    unsure: Floats
    of_scalars: Floats


def frame_components(pool: Pool, number: int) -> FrameComponents:
    """Components of the vector of so many frames, by what each frame of a pool does to it.

    Args:
        pool: simulated frames with the clear frame that each started from.
        number: n, of measured frames.
    """
    influence = pool.influence(number)
    start = pool.start
    groups = [np.flatnonzero(start == one) for one in np.unique(start)]
    frames, clear = len(pool), len(groups)
    means = np.stack([influence[own].mean(0) for own in groups])
    squares = sum(((influence[own] - mean) ** 2).sum(0) for own, mean in zip(groups, means, strict=True))
    within = squares / max(frames - clear, 1) if frames > clear else np.zeros(influence.shape[1])
    repeats = frames / clear
    between = means.var(0, ddof=1) - within / repeats if clear > 1 else np.zeros_like(within)
    apart = influence - influence.mean(0)
    second = np.maximum((apart**2).mean(0), TINY**2)
    unsure = np.maximum((apart**4).mean(0) / second**2 - 1.0, 0.0) / frames
    scalar = pool.frames.scalar
    of_clear = np.stack([scalar[own].mean(0) for own in groups]).var(0)
    share = np.clip(of_clear / np.maximum(scalar.var(0), TINY**2), 0.0, 1.0)
    # Influence is that of one frame on the vector of n; the vector scatters by n times its variance.
    return FrameComponents(number * within, number * between, unsure, share)


def between_share(layout: Layout, components: Mapping[str, FrameComponents]) -> Floats:
    """``(P,)`` share of the variance that lies between clear frames: of each statistic, over its bins and conditions.

    Of one entry K clear frames tell too little.
    """
    name = layout.each(lambda group: f"{group.statistic} {group.kind}")
    found = np.zeros(layout.size)
    for one in set(name[: layout.bins]):
        own = name == one
        between = whole = 0.0
        for part in components.values():
            total = part.within[own] + np.maximum(part.between[own], 0.0)
            some = total > TINY**2
            between += float((part.between[own][some] / total[some]).sum())
            whole += float(((part.within[own] + part.between[own])[some] / total[some]).sum())
        found[own] = min(max(between / whole, 0.0), 1.0) if whole > 0 else 0.0
    return found
