"""The haze's noise by one convolution for all shells: few operations, as a graph holds them.

``haze.py`` adds shifted maps tap by tap, in bands that stay in the cache. This module gives the same sums.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

if TYPE_CHECKING:
    from torchweather.camera.particles.population import AtRate, Population

__all__ = ["streaky_maps"]

Array = NDArray[np.float32]
ROWS_AT_ONCE = 16  # that one window of the convolution gives: a matrix product has as many rows


def streaky_maps(fields: Tensor, tables: AtRate, population: Population) -> Tensor:
    """White noise ``(1, J, H, W)`` of all shells with the correlation of their streaks.

    Args:
        fields: the noise; it repeats at the frame's edges.
        tables: the population's tables at the sample's rate.
        population: the particles.
    """
    steep = population.haze_steep
    kernel = _kernel(tables, population)
    turned = fields if steep else fields.transpose(-1, -2)
    smooth = _correlated(turned, kernel)
    return smooth if steep else smooth.transpose(-1, -2)


def _kernel(tables: AtRate, population: Population) -> Tensor:
    """Weights ``(J, rows, columns)`` of each shell, the rows along its streaks."""
    along, taps_along = _trimmed(tables.kernel_along, population.taps_along)
    across, taps_across = _trimmed(tables.kernel_across, population.taps_across)
    places = torch.from_numpy(_places(taps_along, taps_across, population.haze_slope)).to(along)
    shells = len(along)
    return (along.view(shells, -1, 1, 1) * across.view(shells, 1, -1, 1) * places).sum(2)


def _trimmed(kernel: Tensor, taps: tuple[int, ...]) -> tuple[Tensor, int]:
    """Weights ``(J, 2 most + 1)`` of a kernel ``(1, J, weights)`` as far as each shell's taps count, and ``most``."""
    most, middle = max(taps), kernel.shape[-1] // 2
    own = kernel[0, :, middle - most : middle + most + 1]
    if min(taps) == most:
        return own, most
    counts = np.abs(np.arange(-most, most + 1)) <= np.array(taps)[:, None]
    return own * torch.from_numpy(counts.astype(np.float32)).to(own), most


def _places(taps_along: int, taps_across: int, slope: float) -> Array:
    """Share ``(along, across, columns)`` of each pair of taps in each column of the kernel.

    A tap along the streak is aside by ``slope`` columns a row. A fraction of a column is blended of two columns with
    weights of equal energy, so that the variance of the noise stays.
    """
    lean = math.ceil(taps_along * abs(slope))
    reach = lean + taps_across
    places = np.zeros((2 * taps_along + 1, 2 * taps_across + 1, 2 * reach + 1), np.float32)
    for row, tap in enumerate(range(-taps_along, taps_along + 1)):
        whole = math.floor(tap * slope)
        share = tap * slope - whole
        energy = math.hypot(1 - share, share)
        for place, aside in enumerate(range(-taps_across, taps_across + 1)):
            column = reach + whole + aside
            places[row, place, column] = (1 - share) / energy
            if share:
                places[row, place, column + 1] = share / energy
    return places


def _correlated(fields: Tensor, kernel: Tensor) -> Tensor:
    """Correlation of maps ``(1, J, H, W)`` that repeat at their edges with weights ``(J, rows, columns)``."""
    shells, taps_rows, taps_columns = kernel.shape
    height, width = fields.shape[-2:]
    windows = (height + ROWS_AT_ONCE - 1) // ROWS_AT_ONCE
    rows_of_window = ROWS_AT_ONCE + taps_rows - 1
    # Every row of a window has the kernel at its own place in the window.
    place = np.arange(rows_of_window) - np.arange(ROWS_AT_ONCE)[:, None]
    place = np.where((place >= 0) & (place < taps_rows), place, taps_rows).flatten()
    padded = torch.nn.functional.pad(kernel, (0, 0, 0, 1))
    weights = padded.index_select(1, torch.from_numpy(place).to(kernel.device))
    weights = weights.reshape(shells * ROWS_AT_ONCE, 1, rows_of_window, taps_columns)
    rows = torch.arange(windows * ROWS_AT_ONCE + taps_rows - 1, device=fields.device) - taps_rows // 2
    band = fields.index_select(-2, _repeated(rows, height))
    reach = taps_columns // 2
    aside = torch.arange(reach, device=fields.device)
    before, after = _repeated(aside - reach, width), _repeated(aside + width, width)
    band = torch.cat([band.index_select(-1, before), band, band.index_select(-1, after)], -1)
    found = torch.nn.functional.conv2d(band, weights, stride=(ROWS_AT_ONCE, 1), groups=shells)
    split = found.view(1, shells, ROWS_AT_ONCE, windows, width).transpose(2, 3)
    return split.reshape(1, shells, windows * ROWS_AT_ONCE, width)[..., :height, :]


def _repeated(place: Tensor, size: int) -> Tensor:
    """Places modulo a size, which may be that of a graph's input."""
    return torch.remainder(place, place.new_full((1,), size))
