"""Double validation metric: what a model gets wrong on average, and what it gets wrong in the scatter."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from torchweather.core.arguments import check_arguments
from torchweather.core.errors import InputTypeError, InputValueError, check_finite, check_one_of
from torchweather.core.precision import outside_autocast

__all__ = ["CENTRES", "DoubleValidation", "double_validation"]

CENTRES = ("median", "mean")


class DoubleValidation(NamedTuple):
    """Both in the unit of the quantity."""

    bias: Tensor
    scatter: Tensor


@outside_autocast
def double_validation(simulated: Tensor, measured: Tensor, *, centre: str = "median") -> DoubleValidation:
    """Bias and scatter of a simulated scalar quantity against a measured one.

    The bias is the difference of the centres, ``c(simulated) - c(measured)``. The scatter is the area between the two
    empirical distribution functions after the bias is taken off: ``integral |F(x + bias) - G(x)| dx``.

    Args:
        simulated, measured: ``(..., N)`` and ``(..., M)`` samples of real numbers of any type, finite, at least one
            each; one batch shape.
        centre: ``median`` (the mean of the middle two of an even number) or ``mean``.

    Returns:
        ``bias`` ``(...)``, positive where the simulation is larger, and ``scatter`` ``(...)``, 0 or more, float64; 0
        and 0 for equal samples, in any order.

    References:
        METRICS.md 4; Rosenberger et al. 2022.

    Example:
        >>> found = double_validation(torch.tensor([4.0, 5.0, 6.0]), torch.tensor([0.0, 1.0, 2.0]))
        >>> float(found.bias), float(found.scatter)
        (4.0, 0.0)
    """
    check_arguments("double_validation(simulated: Tensor, measured: Tensor, centre: str)", simulated, measured, centre)
    name = "double_validation"
    check_one_of("centre", centre, CENTRES, owner=name)
    for which, sample in (("simulated", simulated), ("measured", measured)):
        if not isinstance(sample, Tensor) or sample.ndim < 1 or not sample.shape[-1]:
            came = tuple(sample.shape) if isinstance(sample, Tensor) else type(sample).__name__
            raise InputValueError(f"{name}: {which} must be a tensor (..., N) of one value or more; got {came}.")
        if sample.is_complex() or sample.dtype == torch.bool:
            raise InputTypeError(f"{name}: {which} must hold real numbers; got {sample.dtype}.")
        check_finite(which, sample, owner=name)
    if simulated.shape[:-1] != measured.shape[:-1]:
        raise InputValueError(
            f"{name}: both must have one batch shape; got {tuple(simulated.shape)} and {tuple(measured.shape)}."
        )
    # Narrower types end at 65504 (half) or keep no halves from 2^23 on (single).
    x, y = simulated.double().sort(-1).values, measured.double().sort(-1).values
    bias = _centre(x, centre) - _centre(y, centre)
    return DoubleValidation(bias, _area(x - bias[..., None], y))


def _centre(ascending: Tensor, centre: str) -> Tensor:
    if centre == "mean":
        return ascending.mean(-1)
    n = ascending.shape[-1]
    return 0.5 * (ascending[..., (n - 1) // 2] + ascending[..., n // 2])


def _area(x: Tensor, y: Tensor) -> Tensor:
    """Area between the empirical distribution functions of samples ``(..., N)`` and ``(..., M)``."""
    n, m = x.shape[-1], y.shape[-1]
    value, order = torch.cat((x, y), -1).sort(-1)
    # Steps of the two functions times n m: whole numbers, so equal samples enclose exactly nothing.
    step = torch.where(order < n, m, -n)
    between = step.cumsum(-1)[..., :-1].abs().to(value.dtype) / (n * m)
    return (between * value.diff(dim=-1)).sum(-1)
