"""Single pixels that stand out, frame by frame, so kept that those which do so in every frame can be counted.

Optics spread the light of a point over the pixels about it; what a pixel itself adds stays in it. Pixels that stand out
while those about them do not are summed up in a few cells, each in a cell and with a sign that its place decides. The
sum over the cells of the products of two frames is then the number of pixels that stand out in both: those that do so
in one alone add nothing on the average, and scatter by the root of the product of their numbers over that of the cells.

References:
    Charikar, Chen & Farach-Colton 2002 (count sketch). EMVA 1288 (defect pixels).
"""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

__all__ = ["LONE_SD", "LONE_SHARE", "LonePixels", "lone_pixels"]

Floats = NDArray[np.float64]

# Standard deviations of its noise by which a pixel departs, and share of it by which none about it does; set on
# development studies of the bench.
LONE_SD, LONE_SHARE = 12.0, 0.15
ABOUT = [(down, right) for down in (-1, 0, 1) for right in (-1, 0, 1) if (down, right) != (0, 0)]


def lone_pixels(relative: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Frame, row and column of the pixels that stand out alone, none at the border.

    Args:
        relative: ``(F, H, W)`` departures, in standard deviations.

    Example:
        >>> relative = torch.zeros(1, 5, 8)
        >>> relative[0, 2, 2], relative[0, 2, 5:7] = 20.0, 20.0  # one alone, two beside each other
        >>> [one.tolist() for one in lone_pixels(relative)]
        [[0], [2], [2]]
    """
    size = relative.abs()
    height, width = size.shape[1:]
    # Places in the flat array; most have a neighbour as far out, so few are left after the first.
    size, far = size.flatten(), torch.from_numpy(np.flatnonzero((size >= LONE_SD).numpy()))
    row, column = far // width % height, far % width
    far = far[(row > 0) & (row < height - 1) & (column > 0) & (column < width - 1)]
    for down, right in ABOUT:
        far = far[size[far + down * width + right] < LONE_SHARE * size[far]]
    return far // (height * width), far // width % height, far % width


class LonePixels:
    """Frames to cells.

    Args:
        modelled: ``(K + 1, 1, H, W)`` what frames are compared with.
        noise_variance: c and v of the variance ``c + v I`` of the mean of two pixels.
        cells: number of them.
    """

    def __init__(self, modelled: Tensor, noise_variance: tuple[float, float], cells: int) -> None:
        self._modelled, self.cells = modelled[:, 0], cells
        constant, growing = noise_variance
        self._sd = (2.0 * (constant + growing * modelled[-1, 0])).sqrt()
        rng = np.random.default_rng(67867979)
        shape = tuple(self._sd.shape)
        self._cell, self._sign = rng.integers(0, cells, shape), rng.choice([-1.0, 1.0], shape)

    def __call__(self, bayer: Tensor, row: Tensor) -> Floats:
        """Cells ``(F, cells)`` of frames ``(F, 1, H, W)``; ``row (F,)`` says what each is compared with."""
        relative = (bayer[:, 0] - self._modelled[row]).div_(self._sd)
        frame, down, right = lone_pixels(relative)
        side = relative[frame, down, right].sign().double().numpy()
        place = (down.numpy(), right.numpy())
        index = frame.numpy() * self.cells + self._cell[place]
        found = np.bincount(index, self._sign[place] * side, len(bayer) * self.cells).astype(np.float64)
        return found.reshape(len(bayer), self.cells)
