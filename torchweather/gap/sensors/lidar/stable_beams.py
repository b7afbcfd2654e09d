"""Beams of clear frames that see one surface, and those that do not: the share that a comparison can use."""

from __future__ import annotations

from dataclasses import dataclass

from torch import Tensor

__all__ = ["SAME_SURFACE_M", "BeamShares", "beam_shares", "one_range"]

# Nearer to the surface than this a return is the surface's: several times the range noise of a scanner.
SAME_SURFACE_M = 0.35


@dataclass(frozen=True)
class BeamShares:
    """Of the beams that return in a clear frame; they sum to 1, or all are 0 where none returns.

    Args:
        stable: see one surface in every frame.
        missing: lack a return in some of them.
        moved: return in all of them, from ranges that are no one surface.
    """

    stable: float
    missing: float
    moved: float


def one_range(range_m: Tensor) -> Tensor:
    """Mask ``(N,)`` of the beams whose returns ``(K, N)`` come from one surface; 0 is no return."""
    returns = range_m > 0
    far, near = range_m.amax(0), range_m.masked_fill(~returns, float("inf")).amin(0)
    return (far == 0) | (far - near < 2.0 * SAME_SURFACE_M)


def beam_shares(range_m: Tensor) -> BeamShares:
    """Shares of the beams that see one surface in all clear frames, and of the others.

    Args:
        range_m: ``(K, N)`` of K frames, 0 where a beam has no return.

    Example:
        >>> import torch
        >>> beam_shares(torch.tensor([[9.0, 9.0, 9.0, 0.0], [9.1, 0.0, 12.0, 0.0]]))
        BeamShares(stable=0.3333333333333333, missing=0.3333333333333333, moved=0.3333333333333333)
    """
    returns = range_m > 0
    number = max(int(returns.any(0).sum()), 1)
    always = returns.all(0)
    missing = int((returns.any(0) & ~always).sum())
    moved = int((always & ~one_range(range_m)).sum())
    return BeamShares((int(always.sum()) - moved) / number, missing / number, moved / number)
