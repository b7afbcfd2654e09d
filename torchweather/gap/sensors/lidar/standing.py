"""Azimuth, range and width of what stands in the measured frames and not in the clear ones, beam by beam.

The map of returns has cells of 0.1 rad, in which several columns of beams lie. A thin thing stands in one of them.
Particles return from a beam in one frame, what stands returns from the same beams in nearly all.
"""

from __future__ import annotations

import math
from collections.abc import Iterable

import torch
from torch import Tensor

__all__ = ["place_of_standing"]

# Set on things of 0.02 to 0.1 rad that stand in ten development studies; none is a threshold of a verdict: they say
# where a search begins.
WITHIN_RAD = 0.2  # of the azimuth that is looked near
WITHIN_RANGE = (0.6, 1.6)  # factors on the range that is looked near
ONE_RANGE_M = 1.0  # returns of one thing in one beam lie within
MOST_FRAMES = 0.8  # in which a beam returns from it, at least; of the clear frames at most a half do
LEAST_BEAMS = 3
LEAST_OF_PEAK = 0.25  # beams of a column that is part of it, over those of its best column
# Quantile of all columns that is taken for what returns everywhere, as fog does: what stands fills fewer than the rest.
BACKGROUND = 0.25


def place_of_standing(
    azimuth_rad: Tensor,
    spacing_rad: float,
    frames: Iterable[tuple[Tensor, Tensor]],
    near_azimuth_rad: float,
    near_range_m: float,
) -> tuple[float, float, float] | None:
    """Azimuth of the middle, rad, range, m, and width, rad, of what stands near a place.

    ``None`` where nothing does, or where it reaches farther than is looked.

    Args:
        azimuth_rad: ``(N,)`` of the beams.
        spacing_rad: of neighbouring columns.
        frames: ranges, m, of measured frames ``(F, N)`` and of clear frames ``(K, N)`` of each condition; 0 of none.
        near_azimuth_rad, near_range_m: that place.

    Example:
        >>> azimuth = torch.tensor([-0.02, 0.0, 0.02, 0.04]).repeat(3)
        >>> clear = torch.full((2, 12), 20.0)
        >>> measured = clear.clone()
        >>> measured[:, azimuth == 0.02] = 8.0  # a pole, in front of three beams of one column
        >>> [round(one, 3) for one in place_of_standing(azimuth, 0.02, [(measured, clear)], 0.05, 10.0)]
        [0.02, 8.0, 0.02]
    """
    aside = torch.remainder(azimuth_rad - near_azimuth_rad + math.pi, 2.0 * math.pi) - math.pi
    low, high = (factor * near_range_m for factor in WITHIN_RANGE)
    asides, ranges = [], []
    for measured, clear in frames:
        near = (measured > low) & (measured < high) & (aside.abs() < WITHIN_RAD)
        middle = torch.where(near, measured, math.nan).nanmedian(0).values
        stays = (near & ((measured - middle).abs() < ONE_RANGE_M)).float().mean(0) >= MOST_FRAMES
        there_before = ((clear - middle).abs() < ONE_RANGE_M).float().mean(0) > 0.5
        stands = stays & ~there_before
        asides.append(aside[stands])
        ranges.append(middle[stands])
    found, middles = torch.cat(asides), torch.cat(ranges)
    column = torch.round(found / spacing_rad).long() + math.ceil(WITHIN_RAD / spacing_rad)
    number = torch.bincount(column, minlength=2 * math.ceil(WITHIN_RAD / spacing_rad) + 1).double()
    number -= torch.quantile(number, BACKGROUND)
    peak = int(number.argmax())
    if number[peak] < LEAST_BEAMS:
        return None
    part = (number >= LEAST_OF_PEAK * number[peak]).tolist()
    first = last = peak
    while first > 0 and part[first - 1]:
        first -= 1
    while last + 1 < len(part) and part[last + 1]:
        last += 1
    own = (column >= first) & (column <= last)
    left, right = float(found[own].min()), float(found[own].max())
    if max(-left, right) > WITHIN_RAD - spacing_rad:
        return None
    azimuth = math.remainder(near_azimuth_rad + 0.5 * (left + right), 2.0 * math.pi)
    return azimuth, float(middles[own].median()), right - left + spacing_rad
