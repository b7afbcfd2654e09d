"""What must not be taken for a missing effect, and how much of a residual it explains.

With G the whitened change per standard deviation of each nuisance and x where they stand, a residual r leaves

    min over d of |r - G d|^2 + |x + d|^2,   d = (G'G + 1)^-1 (G'r - x).

References:
    GAP.md 3 (4).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["Nuisance"]

Floats = NDArray[np.float64]


class Nuisance:
    """What is not the model's fault, and how much of a residual it explains.

    Args:
        response: ``(C P, K)`` G: whitened change per standard deviation of each.
        offset: ``(K,)`` x: where they stand, in standard deviations from the record.
        moving: number of those that the simulator can be moved along, the first ones.
    """

    def __init__(self, response: Floats, offset: Floats, moving: int) -> None:
        self.response, self.offset, self.moving = response, offset, moving
        normal = response.T @ response + np.eye(response.shape[1])
        self._inverse = np.linalg.inv(normal)
        self._fixed = np.linalg.inv(normal[moving:, moving:])

    def moved(self, offset: Floats) -> Nuisance:
        """The same nuisances, standing elsewhere."""
        found = Nuisance.__new__(Nuisance)
        found.response, found.offset, found.moving = self.response, offset, self.moving
        found._inverse, found._fixed = self._inverse, self._fixed
        return found

    def __call__(self, vectors: Floats) -> Floats:
        """``(1 - G (G'G + 1)^-1 G') y`` of vectors ``(..., C P)``."""
        found: Floats = vectors - (vectors @ self.response) @ self._inverse @ self.response.T
        return found

    def step(self, residual: Floats) -> Floats:
        """``(K,)`` by how far they move to explain a residual best, in standard deviations."""
        found: Floats = self._inverse @ (self.response.T @ residual - self.offset)
        return found

    def left(self, residual: Floats) -> Floats:
        """A residual ``(C P,)`` without what the nuisances explain."""
        found: Floats = residual - self.response @ self.step(residual)
        return found

    def cost(self, residual: Floats) -> float:
        """A residual squared where the moving ones stand, and what it costs that they do."""
        along = self.response[:, self.moving :].T @ residual
        return float(residual @ residual - along @ self._fixed @ along + (self.offset**2).sum())

    def misfit(self, residual: Floats) -> float:
        """What is left, squared, with what the moved nuisances cost."""
        step = self.step(residual)
        rest = residual - self.response @ step
        return float(rest @ rest + ((self.offset + step) ** 2).sum())
