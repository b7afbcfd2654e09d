"""Clear frames against clear frames: what disagrees there is not weather.

The first half of a scene's clear frames is held against the second, and that difference against those of halves drawn
at random: a laser that warms up, a car that drives off, a scanner that turns.

References:
    GAP.md 3 (3).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from torchweather.gap.inference.config import NUMERICS, SCATTER
from torchweather.gap.inference.simulated_distribution import FrameModel
from torchweather.gap.statistics.frame_statistics import Pool

__all__ = ["ClearAir", "clear_air"]

LEAST_SCATTER = 1e-9


@dataclass(frozen=True)
class ClearAir:
    """Agreement of the clear frames of a scene with each other.

    Args:
        scene: id.
        p_value: probability that halves drawn at random differ as much as the first from the second.
        statistic, axis: of the entry that differs most.
        z: that difference in units of the random halves'.
    """

    scene: str
    p_value: float
    statistic: str
    axis: str
    z: float


def clear_air(model: FrameModel, seed: int) -> list[ClearAir]:
    """Scenes whose clear frames can be halved, each with how well its halves agree."""
    found = []
    layout = model.layout
    groups = [group for group in layout.groups for _ in range(group.bins)]
    binned = layout.each(lambda group: group.kind not in ("between", "slope", "persistence"))
    for name in model.clear_frames:
        pool = Pool(layout, model.clear(name))
        number = len(pool)
        if number < SCATTER.clear_frames_min:
            continue
        half = number // 2
        order = np.argsort(np.random.default_rng([seed, 6700417]).random((NUMERICS.clear_splits, number)), 1)
        order = np.concatenate([np.arange(number)[None], order])
        apart = pool.vectors(order[:, :half]) - pool.vectors(order[:, -half:])
        counts = binned & pool.enough(half)
        scatter = apart[1:].std(0)
        z = np.where(counts & (scatter > LEAST_SCATTER), apart / np.maximum(scatter, LEAST_SCATTER), 0.0)
        misfit = (z**2).sum(1)
        place = int(np.abs(z[0]).argmax())
        p_value = (1 + int((misfit[1:] >= misfit[0] * (1.0 - 1e-12)).sum())) / (NUMERICS.clear_splits + 1)
        found.append(ClearAir(name, p_value, groups[place].statistic, groups[place].axis, float(z[0, place])))
    return found
