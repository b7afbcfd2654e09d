"""Causes that must not be taken for a missing effect, and how much of a residual they explain.

With G the whitened change per standard deviation of each nuisance and x where they stand, a residual r leaves

    min over d of |r - G d|^2 + (x + d)' L (x + d),   d = (G'G + L)^-1 (G'r - L x),

where L is the inverse of their covariance: the unit matrix unless some go together. A fit moves them no farther than
their bounds: a record that would have to be off by ten standard deviations beside an effect is no explanation.

References:
    GAP.md 3 (4). Least squares within bounds: Stark & Parker 1995 (scipy's ``lsq_linear``).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import lsq_linear

__all__ = ["BoundedStep", "Bounds", "Systematics", "bounded_step", "moving_only", "together"]

Floats = NDArray[np.float64]


class Systematics:
    """Causes that are not the model's fault, and how much of a residual they explain.

    Args:
        response: ``(C P, K)`` G: whitened change per standard deviation of each.
        offset: ``(K,)`` x: where they stand, in standard deviations from the record.
        moving: number of those that the simulator can be moved along, the first ones.
        precision: ``(K, K)`` L; the others are independent of the moving ones.
        behind: number of the last ones, which were put behind the others (``beside``).
    """

    def __init__(
        self, response: Floats, offset: Floats, moving: int, precision: Floats | None = None, behind: int = 0
    ) -> None:
        self.response, self.offset, self.moving, self.behind = response, offset, moving, behind
        self.precision = np.eye(response.shape[1]) if precision is None else precision
        normal = response.T @ response + self.precision
        self._inverse = np.linalg.inv(normal)
        self._fixed = np.linalg.inv(normal[moving:, moving:])

    def moved(self, offset: Floats) -> Systematics:
        """The same nuisances with the moving ones standing elsewhere; the others stay."""
        found = Systematics.__new__(Systematics)
        found.response, found.moving, found.behind = self.response, self.moving, self.behind
        found.offset = np.concatenate([offset, self.offset[self.moving :]])
        found.precision = self.precision
        found._inverse, found._fixed = self._inverse, self._fixed
        return found

    def beside(self, columns: Floats) -> Systematics:
        """These and, behind them, independent others of unit variance ``(C P, M)``, which no simulator moves."""
        known, added = self.response.shape[1], columns.shape[1]
        if not added:
            return self
        precision = np.eye(known + added)
        precision[:known, :known] = self.precision
        response = np.concatenate([self.response, columns], 1)
        offset = np.concatenate([self.offset, np.zeros(added)])
        return Systematics(response, offset, self.moving, precision, self.behind + added)

    def without_behind(self) -> Systematics:
        """These without the ones that were put behind them."""
        kept = self.response.shape[1] - self.behind
        return Systematics(self.response[:, :kept], self.offset[:kept], self.moving, self.precision[:kept, :kept])

    def __call__(self, vectors: Floats) -> Floats:
        """``(1 - G (G'G + L)^-1 G') y`` of vectors ``(..., C P)``."""
        found: Floats = vectors - (vectors @ self.response) @ self._inverse @ self.response.T
        return found

    def step(self, residual: Floats) -> Floats:
        """``(K,)`` by how far they move to explain a residual best, in standard deviations."""
        found: Floats = self._inverse @ (self.response.T @ residual - self.precision @ self.offset)
        return found

    def left(self, residual: Floats) -> Floats:
        """A residual ``(C P,)`` without what the nuisances explain."""
        found: Floats = residual - self.response @ self.step(residual)
        return found

    def cost(self, residual: Floats) -> float:
        """A residual squared where the moving ones stand, and what it costs that they do."""
        along = self.response[:, self.moving :].T @ residual
        return float(residual @ residual - along @ self._fixed @ along + self._unlikely(self.offset))

    def misfit(self, residual: Floats) -> float:
        """Square of the residual, with the cost of the moved nuisances."""
        step = self.step(residual)
        unexplained = residual - self.response @ step
        return float(unexplained @ unexplained + self._unlikely(self.offset + step))

    def drawn(self, generator: np.random.Generator, number: int) -> Floats:
        """Residuals ``(number, C P)`` that nuisances alone make."""
        factor = np.linalg.cholesky(np.linalg.inv(self.precision))
        found: Floats = generator.normal(size=(number, len(factor))) @ factor.T @ self.response.T
        return found

    def _unlikely(self, offset: Floats) -> float:
        return float(offset @ self.precision @ offset)


@dataclass(frozen=True)
class Bounds:
    """Ends between which numbers may lie.

    Args:
        low, high: ``(K,)``.
    """

    low: Floats
    high: Floats


@dataclass(frozen=True)
class BoundedStep:
    """The best explanation of a residual within bounds.

    Args:
        amplitudes: ``(M,)`` of the columns.
        aside: ``(K,)`` step of the nuisances, in standard deviations.
        misfit: that is left, with the cost of the moved nuisances.
    """

    amplitudes: Floats
    aside: Floats
    misfit: float


def bounded_step(
    residual: Floats,
    nuisance: Systematics,
    bounds: Bounds,
    columns: Floats,
    limits: Bounds,
    ridge: Floats | float = 0.0,
) -> BoundedStep:
    """Amplitudes of some columns, and a step of the nuisances, that leave least of a residual.

        min over a, d of |r - S a - G d|^2 + (x + d)' L (x + d) + |ridge a|^2

    Args:
        residual: ``(C P,)`` r.
        nuisance: G, x and L.
        bounds: of where the nuisances stand, x + d.
        columns: ``(C P, M)`` S.
        limits: of the amplitudes a.
        ridge: ``(M,)`` what keeps amplitudes small that nothing tells apart; no part of ``misfit``.
    """
    number, moved = columns.shape[1], nuisance.response.shape[1]
    prior = np.linalg.cholesky(nuisance.precision).T
    matrix = np.block([[columns, nuisance.response], [np.zeros((moved, number)), prior]])
    target = np.concatenate([residual, -prior @ nuisance.offset])
    held = np.concatenate([np.diag(np.broadcast_to(ridge, number)), np.zeros((number, moved))], 1)
    # As few rows as columns, each of length one: what the columns do not reach is the same whatever they do.
    scale = np.maximum(np.sqrt((matrix**2).sum(0) + (held**2).sum(0)), 1e-12)
    orthogonal, upper = np.linalg.qr(np.concatenate([matrix, held]) / scale)
    low = np.concatenate([limits.low, bounds.low - nuisance.offset]) * scale
    high = np.concatenate([limits.high, bounds.high - nuisance.offset]) * scale
    wanted = orthogonal.T @ np.concatenate([target, np.zeros(number)])
    found = lsq_linear(upper, wanted, (low, np.maximum(high, low + 1e-12)), method="bvls").x / scale
    return BoundedStep(found[:number], found[number:], float(((target - matrix @ found) ** 2).sum()))


def moving_only(residual: Floats, nuisance: Systematics, columns: Floats) -> tuple[Floats, Systematics, Floats]:
    """The same question without the nuisances that no simulator moves, in as few rows as there are columns.

    Whatever explains a residual and whatever step the moving ones take, the others are at their best beside it: with
    ``[G_f, Z] = Q R`` the square that is left of ``Z`` is that of the lower right block of R.

    Args:
        residual: ``(C P,)``.
        nuisance: K of them.
        columns: ``(C P, M)``, all that may explain the residual.

    Returns:
        Residual ``(M + K' + 1,)``, the K' nuisances that move, and columns ``(M + K' + 1, M)``. With any of them
        ``bounded_step`` leaves the same misfit as with the whole.
    """
    moving, number = nuisance.moving, columns.shape[1]
    fixed = nuisance.response[:, moving:]
    prior = np.linalg.cholesky(nuisance.precision[moving:, moving:]).T
    stay = np.zeros((len(prior), number + moving + 1))
    stay[:, -1] = -prior @ nuisance.offset[moving:]
    wanted = np.concatenate([columns, nuisance.response[:, :moving], residual[:, None]], 1)
    upper = np.linalg.qr(np.block([[fixed, wanted], [prior, stay]]), mode="r")
    left: Floats = np.asarray(upper, dtype=np.float64)[len(prior) :, len(prior) :]
    reduced = Systematics(left[:, number:-1], nuisance.offset[:moving], moving, nuisance.precision[:moving, :moving])
    return left[:, -1], reduced, left[:, :number]


def together(number: int, some: int) -> Floats:
    """Precision ``(number, number)`` where half of the variance of each of the first ``some`` is common to them.

    Covariance ``(1 + J) / 2``, its inverse ``2 (1 - J / (some + 1))``.

    Example:
        >>> together(3, 2).round(3).tolist()
        [[1.333, -0.667, 0.0], [-0.667, 1.333, 0.0], [0.0, 0.0, 1.0]]
    """
    found = np.eye(number)
    found[:some, :some] = 2.0 * (np.eye(some) - 1.0 / (some + 1.0))
    return found
