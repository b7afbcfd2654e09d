"""Integral of t^(s-1) exp(-t) between two bounds: what moments of gamma-shaped distributions are made of."""

from __future__ import annotations

import torch
from torch import Tensor

__all__ = ["incomplete_gamma_between"]


def incomplete_gamma_between(shape: Tensor, low: Tensor, high: Tensor) -> Tensor:
    """``int_low^high t^(s-1) e^-t dt / Gamma(s)``, accurate in either tail and differentiable in the bounds.

    Args:
        shape: s, above 0; no gradient.
        low: lower bound, 0 or more.
        high: upper bound, ``low`` or more.

    Returns:
        A share in [0, 1], float64, broadcast.

    Example:
        >>> one = torch.tensor(1.0, dtype=torch.float64)
        >>> incomplete_gamma_between(one, 0 * one, one)  # 1 - 1/e
        tensor(0.6321, dtype=torch.float64)
    """
    shape = shape.detach()
    # Beyond the mean the two lower integrals are both nearly 1 and their difference loses all digits: use the upper.
    upper = low > shape
    # The derivative at 0 is infinite for s < 1, but a bound at 0 is a fixed end of the domain: keep it off the graph.
    at_zero = low <= 0
    low_safe = torch.where(at_zero, torch.ones_like(low), low)
    below_low = torch.where(at_zero, 0.0, torch.special.gammainc(shape, low_safe))
    above_low = torch.where(at_zero, 1.0, torch.special.gammaincc(shape, low_safe))
    high_safe = torch.where(high <= 0, torch.ones_like(high), high)
    below_high = torch.where(high <= 0, 0.0, torch.special.gammainc(shape, high_safe))
    above_high = torch.where(high <= 0, 1.0, torch.special.gammaincc(shape, high_safe))
    return torch.where(upper, above_low - above_high, below_high - below_low)
