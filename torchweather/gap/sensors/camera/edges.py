"""Sharpness of camera frames: regression of differences across edges on those of the clear scene, class by class.

The sum of ``before * after`` over pairs of cells is linear in the frame: for each clear frame that a frame is compared
with it is one product of a sparse matrix with the frame.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.sparse
import torch
from numpy.typing import NDArray
from torch import Tensor

from torchweather.gap.sensors.camera.bins import Key
from torchweather.gap.sensors.camera.scene import DEPTH_CLASSES_M, CameraScene

__all__ = ["SHARED_CELLS", "Edges", "lag_name"]

SHARED_CELLS = 4.0  # neighbouring cells that one streak or one blurred edge makes depend on each other
CLASSES = len(DEPTH_CLASSES_M) - 1

Floats = NDArray[np.float64]


def lag_name(lag: tuple[int, int]) -> str:
    """A lag in pixels down and to the right, as part of a name.

    Example:
        >>> lag_name((8, -2))
        '16_-4_px'
    """
    return f"{2 * lag[0]}_{2 * lag[1]}_px"


class Edges:
    """Pairs of cells across the edges of a scene, each weighed with the square of its clear difference.

    Args:
        scene: with its clear frames.
        green: ``(K + 1, h, w)`` of the references.
    """

    def __init__(self, scene: CameraScene, green: Tensor) -> None:
        clear = green.flatten(1).double().numpy()
        self.place: dict[Key, slice] = {}
        self._cells, self.number = clear.shape[1], CLASSES * len(scene.sharp)
        firsts: list[Any] = []
        seconds: list[Any] = []
        bins: list[Any] = []
        befores: list[Floats] = []
        scales: list[Floats] = []
        for lag, pairs in scene.sharp.items():
            start = len(bins) * CLASSES
            self.place[f"edge_contrast_{lag_name(lag)}", "depth_m"] = slice(start, start + CLASSES)
            first, second = pairs.first.numpy(), pairs.second.numpy()
            before = clear[:, second] - clear[:, first]
            firsts.append(first)
            seconds.append(second)
            bins.append(start + pairs.depth_class.numpy())
            befores.append(before)
            scales.append(SHARED_CELLS * np.maximum(_mean_square(before), 1e-12))
        self.first, self.second, self.bin = (np.concatenate(parts) for parts in (firsts, seconds, bins))
        self.before = np.concatenate(befores, 1)  # (K + 1, P)
        self.scale = np.stack(scales, 1).repeat(CLASSES, 1)  # (K + 1, bins)
        self._whole: dict[int, Any] = {}
        self._numbers = self.numbers(torch.arange(len(clear)), torch.zeros(self._cells, dtype=torch.long), 1)

    def totals(self, green: Tensor, row: Tensor, portion: Tensor | None, portions: int) -> Floats:
        """Sums of ``before * after`` ``(F * portions, bins)``.

        Args:
            green: ``(F, h, w)`` of the frames.
            row: ``(F,)`` reference of each.
            portion: ``(h w,)`` of each cell, that of a pair's first one counts; ``None``: all are one.
            portions: number of them.
        """
        found = [
            (self._matrix(clear, portion, portions) @ frame).reshape(portions, -1) / self.scale[clear]
            for clear, frame in zip(row.tolist(), green.flatten(1).double().numpy(), strict=True)
        ]
        return np.concatenate(found)

    def numbers(self, row: Tensor, portion: Tensor | None, portions: int) -> Floats:
        """Sums of ``before^2`` ``(F * portions, bins)``."""
        if portion is None:
            found: Floats = self._numbers[row.numpy()]
            return found
        return np.concatenate(
            [self.summed(self.before[k] ** 2, portion, portions) / self.scale[k] for k in row.tolist()]
        )

    def summed(self, values: Floats, portion: Tensor | None, portions: int) -> Floats:
        """Sums ``(portions, bins)`` of a value of each pair ``(P,)``."""
        place = self._place(portion)
        found: Floats = np.bincount(place, values, minlength=portions * self.number).astype(np.float64)
        return found.reshape(portions, self.number)

    def _place(self, portion: Tensor | None) -> NDArray[np.int64]:
        found: NDArray[np.int64] = self.bin if portion is None else portion.numpy()[self.first] * self.number + self.bin
        return found

    def _matrix(self, row: int, portion: Tensor | None, portions: int) -> Any:
        """Sparse ``(portions * bins, cells)`` for the reference of a row; kept where all is one portion."""
        if portion is None and row in self._whole:
            return self._whole[row]
        before, place = self.before[row], self._place(portion)
        entries = (np.concatenate([before, -before]), (np.tile(place, 2), np.concatenate([self.second, self.first])))
        found = scipy.sparse.csr_array(entries, shape=(portions * self.number, self._cells))
        if portion is None:
            self._whole[row] = found
        return found


def _mean_square(values: Floats) -> Floats:
    """Over the pairs, ``(K + 1,)``; 0 where there is none."""
    found: Floats = (values**2).sum(1) / max(values.shape[1], 1)
    return found
