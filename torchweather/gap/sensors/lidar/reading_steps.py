"""Readings in whole steps: intensities of files that keep hundredths or integers.

A sensor rounds once, after the weather. A simulated frame starts from a clear frame that was rounded already: its
readings are put back within their step first, and the result is rounded as the sensor does, downwards. What lies below
the first step is read as 0: drops of rain, and dark surfaces. Without this, every reading of particles is too
bright by half a step, and none is 0.

References:
    GAP.md 3 (1): a simulated frame differs from a measured one by the model alone.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor

from torchweather.core.random import keyed_stream

__all__ = ["frames_within_steps", "in_steps", "reading_step", "within_steps"]

INSIDE_STEP = (0.002, 0.998)  # of a step, away from the rounding of float32 at its ends
# Of the median reading, a step below which rounding is no more than other noise.
FINEST = 0.002
PLACES = 24  # of a level between the ends of the steps that it was read in
NARROWEST = 0.01  # standard deviation of a reading, in steps, however even they are
FEWEST_LEVELS = 10  # values, below which a grid is no sign of rounding
ON_GRID = 0.01  # of a step, by which a rounded float32 may lie beside it


def reading_step(intensity: Tensor) -> float:
    """The step of readings, in their unit; 0 where they lie on no grid, on one too fine to matter, or are so few values
    that a made-up scene may have them: most must have a neighbour one step off.

    Args:
        intensity: readings of returns, any shape; those of 0 say nothing.

    Example:
        >>> reading_step(0.01 * torch.arange(40.0)), reading_step(torch.tensor([0.1, 0.2, 0.5]))
        (0.01, 0.0)
    """
    values = intensity[intensity > 0].double()
    if not len(values):
        return 0.0
    unique = torch.unique(values)
    apart = torch.diff(unique, prepend=unique.new_zeros(1))
    step = float(apart[apart > 1e-6 * unique[-1]].min())
    if step < FINEST * float(values.median()) or len(unique) < FEWEST_LEVELS:
        return 0.0
    # The largest reading tells the step best.
    step = float(unique[-1] / torch.round(unique[-1] / step))
    places = unique / step
    on_grid = bool(((places - places.round()).abs() < ON_GRID).all())
    return round(step, 9) if on_grid and float((apart < 1.5 * step).double().mean()) > 0.5 else 0.0


def within_steps(intensity: Tensor, step: float, seed: int) -> Tensor:
    """Readings of one frame put back within their steps, evenly.

    Args:
        intensity: any shape, on a grid of ``step``.
        step: as of ``reading_step``.
        seed: of the places.
    """
    low, high = INSIDE_STEP
    share = keyed_stream(seed, "gap.intensity_within_step").random(size=tuple(intensity.shape))
    return intensity + step * torch.as_tensor(low + (high - low) * share, dtype=intensity.dtype)


def frames_within_steps(
    intensity: Tensor, seen: Tensor, step: float, least: Tensor, seed: int, *, one_level: bool = False
) -> tuple[Tensor, Tensor]:
    """Readings of several frames of one scene put back within their steps, each as it may have been.

    A beam has one level in all frames and noise that grows with it, of the size that all readings show. Of a beam
    that reads the same in all frames the level lies anywhere in the step; where readings alternate, near the edge. For
    each frame the level is drawn from its posterior, in which levels are as frequent as the readings of all beams say,
    and the reading from the normal law about the level, within its own step.

    Args:
        intensity: ``(K, N)`` on a grid of ``step``.
        seen: ``(K, N)`` where there is a return; others stay as they are.
        step: as of ``reading_step``.
        least: ``(N,)`` reading at the threshold of detection: what was seen lies above it.
        seed: of the draws.
        one_level: draw the level of a beam once, as it is in a recording; else for each frame, so that frames differ by
            what the readings leave open.

    Returns:
        ``(K, N)``, of which ``in_steps`` makes ``intensity`` again, and ``(N,)``, the relative variance of each level
        that the readings leave open.
    """
    place = torch.round(intensity.double() / step)
    # Rounded down, the mean of many beams follows the scale of a frame all the same. Levels are those at scale 1.
    scale = _scales(place + 0.5, seen)[:, None]
    number = seen.double().sum(0).clamp_min(1.0)
    read = (place + 0.5) / scale
    level = torch.where(seen, read, 0.0).sum(0) / number
    spread = (_relative_spread(read, seen) * level).clamp_min(NARROWEST)
    lowest, highest = place / scale, (place + 1.0) / scale
    first, last = ((place + one) / scale for one in INSIDE_STEP)
    first = torch.minimum(torch.maximum(first, (least.double() / step).clamp_max(1e9) / scale), last)
    low = torch.where(seen, first, torch.inf).amin(0).clamp_max(float(highest.max()))
    high = torch.where(seen, last, -torch.inf).amax(0).maximum(low)
    tried = low + (high - low) * (torch.arange(PLACES, dtype=torch.float64) + 0.5)[:, None] / PLACES
    fits = _density(place[seen], tried).log()
    for row in range(len(place)):
        chance = _below((highest[row] - tried) / spread) - _below((lowest[row] - tried) / spread)
        fits += torch.where(seen[row], chance.clamp_min(1e-12).log(), 0.0)
    chance = (fits - fits.amax(0)).exp()
    rising = chance.cumsum(0)
    chance, rising = chance / rising[-1], rising / rising[-1]
    mean = (chance * tried).sum(0)
    unsure = (chance * (tried - mean).square()).sum(0) / mean.square().clamp_min(1e-12)
    stream = keyed_stream(seed, "gap.frames_within_steps")
    found = torch.empty_like(place)
    for row in range(len(place)):
        along, within, share = torch.from_numpy(stream.random(size=(3, place.shape[1])))
        if row == 0 or not one_level:
            cell = (rising < along).sum(0).clamp_max(PLACES - 1)
            drawn = low + (high - low) * (cell + within) / PLACES
        start, end = (_below((one[row] - drawn) / spread) for one in (first, last))
        below = start + share * (end - start)
        value = drawn + spread * math.sqrt(2.0) * torch.erfinv((2.0 * below - 1.0).clamp(-1.0 + 1e-12, 1.0 - 1e-12))
        found[row] = scale[row] * torch.minimum(torch.maximum(value, first[row]), last[row])
    return torch.where(seen, (step * found).to(intensity.dtype), intensity), unsure


def _scales(level: Tensor, seen: Tensor) -> Tensor:
    """Scale ``(K,)`` of each frame over the mean of all, by the beams that every frame sees."""
    both = seen.all(0)
    total = level[:, both].sum(1)
    return total / total.mean() if float(total.min()) > 0 else torch.ones_like(total)


def _density(places: Tensor, levels: Tensor) -> Tensor:
    """Relative frequency of levels, above 0: linear between the middles of the steps, where it counts the readings."""
    counts = torch.bincount(places.long(), minlength=2).double() + 0.5
    at = (levels - 0.5).clamp(0.0, len(counts) - 1.0)
    below = at.floor().long().clamp_max(len(counts) - 2)
    return counts[below] + (at - below) * (counts[below + 1] - counts[below])


def _relative_spread(level: Tensor, seen: Tensor) -> float:
    """Standard deviation of a beam's readings ``(K, N)`` between frames over their level, without what rounding makes.

    Rounded down, two numbers differ by as much as before in the mean over all places within a step: by
    ``2 sd / sqrt(pi)`` where they are normal.
    """
    both = seen[1:] & seen[:-1]
    apart = torch.where(both, (level[1:] - level[:-1]).abs(), 0.0).sum()
    among = torch.where(both, 0.5 * (level[1:] + level[:-1]), 0.0).sum()
    return float(0.5 * math.sqrt(math.pi) * apart / among.clamp_min(1e-12))


def _below(value: Tensor) -> Tensor:
    """Probability of a standard normal number below some values."""
    return 0.5 * (1.0 + torch.erf(value / math.sqrt(2.0)))


def in_steps(intensity: Tensor, step: float) -> Tensor:
    """Readings rounded down to whole steps; as they are where ``step`` is 0."""
    return intensity if step == 0 else torch.floor(intensity / step) * step
