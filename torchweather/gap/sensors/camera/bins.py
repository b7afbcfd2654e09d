"""Sums over the bins of camera frames, as products with sparse matrices: an element is in few of many bins."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import scipy.sparse
from numpy.typing import NDArray
from torch import Tensor

__all__ = ["Binned", "Key", "Sums", "about", "frame_by_frame", "parted"]

Key = tuple[str, str]
"""A statistic and the axis along which its bins lie."""

Floats = NDArray[np.float64]
Sums = dict[Key, tuple[Floats, Floats, Floats]]
"""Statistic and axis to the sums ``(F * portions, bins)`` of weights, of values and of squares."""


class Binned:
    """Elements of a frame, summed up in the bins of some groups.

    Args:
        groups: statistic and axis to the bin of each element ``(N,)``, -1 for none, and the number of bins.
    """

    def __init__(self, groups: Mapping[Key, tuple[Tensor, int]]) -> None:
        self.place: dict[Key, slice] = {}
        self.number, rows, columns = 0, [], []
        for key, (bins, count) in groups.items():
            own = bins.numpy()
            inside = np.flatnonzero(own >= 0)
            rows.append(self.number + own[inside])
            columns.append(inside)
            self.place[key] = slice(self.number, self.number + count)
            self.number += count
            self._elements = len(own)
        self._bin = np.concatenate(rows).astype(np.int32)
        self._element = np.concatenate(columns).astype(np.int32)
        self._whole = self._matrix(None, 1)
        self._counts = np.bincount(self._bin, minlength=self.number).astype(np.float64)[None]

    def _matrix(self, portion: Tensor | None, portions: int) -> Any:
        """Sparse ``(portions * bins, N)``: 1 where an element is in a bin."""
        row = self._bin if portion is None else portion.numpy()[self._element] * self.number + self._bin
        ones, size = np.ones(len(row), np.float32), (portions * self.number, self._elements)
        return scipy.sparse.csr_array((ones, (row, self._element)), shape=size)

    def sums(self, values: Tensor, portion: Tensor | None, portions: int) -> Floats:
        """Sums ``(F * portions, bins)`` of values ``(N, F)``; ``portion (N,)`` tells the rows of a frame apart."""
        matrix = self._whole if portion is None else self._matrix(portion, portions)
        return frame_by_frame((matrix @ values.numpy()).astype(np.float64), portions)

    def counts(self, portion: Tensor | None, portions: int) -> Floats:
        """Number of elements in each bin, ``(portions, bins)``."""
        if portion is None:
            return self._counts
        row = portion.numpy()[self._element] * self.number + self._bin
        return np.bincount(row, minlength=portions * self.number).astype(np.float64).reshape(portions, self.number)


def frame_by_frame(sums: Floats, portions: int) -> Floats:
    """Sums ``(portions * bins, F)`` as ``(F * portions, bins)``."""
    parted = sums.reshape(portions, -1, sums.shape[1])
    return np.ascontiguousarray(np.moveaxis(parted, 2, 0)).reshape(-1, parted.shape[1])


def parted(place: Mapping[Key, slice], weight: Floats, value: Floats, square: Floats) -> Sums:
    """Sums ``(F * portions, bins)`` of several groups, each for itself."""
    return {key: (weight[:, own], value[:, own], square[:, own]) for key, own in place.items()}


def about(number: Floats, total: Floats, noise: Floats) -> Floats:
    """Sum of squares whose variance is that of noise: how elements of a bin differ otherwise is no scatter."""
    found: Floats = total**2 / np.maximum(number, 1e-12) + noise
    return found
