"""The haze's noise by two convolutions for all shells: few operations, as a graph holds them.

``haze.py`` adds shifted maps tap by tap, in bands that stay in the cache. This module gives the same sums.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from torchweather.pipeline.graph_operations import repeated

if TYPE_CHECKING:
    from torchweather.camera.particles.population import AtRate, Population

__all__ = ["streaky_maps"]

Array = NDArray[np.float32]


def streaky_maps(fields: Tensor, tables: AtRate, population: Population) -> Tensor:
    """White noise ``(1, J, H, W)`` of all shells with the correlation of their streaks.

    Args:
        fields: the noise; it repeats at the frame's edges.
        tables: the population's tables at the sample's rate, the kernels ``trimmed``.
        population: the particles.
    """
    along, across = tables.kernel_along, tables.kernel_across
    shells, slope = along.shape[1], population.haze_slope
    leaning = along.view(shells, 1, -1, 1)
    if slope:
        leaning = leaning * torch.from_numpy(_places(along.shape[2] // 2, slope)).to(along)
    straight = across.view(shells, 1, 1, -1)
    if not population.haze_steep:
        leaning, straight = leaning.transpose(2, 3), straight.transpose(2, 3)
    down, aside = (leaning.shape[axis] // 2 + straight.shape[axis] // 2 for axis in (2, 3))
    maps = torch.nn.functional.conv2d(repeated(fields, down, aside), leaning, groups=shells)
    return torch.nn.functional.conv2d(maps, straight, groups=shells)


def _places(taps: int, slope: float) -> Array:
    """Share ``(along, columns)`` of each tap along a streak in each column.

    A tap is aside by ``slope`` columns a row. A fraction of a column is blended of two columns with weights of equal
    energy, so that the variance of the noise stays.
    """
    lean = math.ceil(taps * abs(slope))
    places = np.zeros((2 * taps + 1, 2 * lean + 1), np.float32)
    for row, tap in enumerate(range(-taps, taps + 1)):
        whole = math.floor(tap * slope)
        share = tap * slope - whole
        energy = math.hypot(1 - share, share)
        places[row, lean + whole] = (1 - share) / energy
        if share:
            places[row, lean + whole + 1] = share / energy
    return places
