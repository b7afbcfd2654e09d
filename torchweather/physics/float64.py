"""Numbers and tensors brought together as float64 (or complex128) tensors on one device."""

from __future__ import annotations

import numbers
from typing import Any, TypeAlias

import numpy as np
import torch
from torch import Tensor

from torchweather.core.exceptions import InputTypeError, InputValueError

__all__ = ["Quantity", "to_complex128", "to_float64"]

_SMALLEST, _LARGEST = 1e-100, 1e100  # products of several beyond these leave the range of float64
Quantity: TypeAlias = float | int | Tensor
"""A plain number or a tensor; every physics function takes either."""


def to_float64(*values: Quantity) -> tuple[Tensor, ...]:
    """The values as float64 tensors on the device of the first tensor among them (the CPU if there is none).

    Gradients pass through; shapes are left alone.

    Example:
        >>> to_float64(1, torch.tensor([2.0]))
        (tensor(1., dtype=torch.float64), tensor([2.], dtype=torch.float64))
    """
    device = next((value.device for value in values if isinstance(value, Tensor)), torch.device("cpu"))
    # Stating the type matters: a Python float would first become float32.
    found = tuple(
        _real(value).to(device, torch.float64) if isinstance(value, Tensor) else _tensor(value, torch.float64, device)
        for value in values
    )
    return found


def to_complex128(*values: complex | Tensor) -> tuple[Tensor, ...]:
    """The values as complex128 tensors on the device of the first tensor among them.

    Example:
        >>> to_complex128(1.5 + 0.1j)
        (tensor(1.5000+0.1000j, dtype=torch.complex128),)
    """
    device = next((value.device for value in values if isinstance(value, Tensor)), torch.device("cpu"))
    found = tuple(
        value.to(device, torch.complex128) if isinstance(value, Tensor) else _tensor(value, torch.complex128, device)
        for value in values
    )
    return found


def _real(value: Tensor) -> Tensor:
    if value.is_complex() or value.dtype == torch.bool:
        raise InputTypeError(f"torchweather.physics: expected real numbers; got {value.dtype} {tuple(value.shape)}.")
    return value


def _tensor(value: Any, dtype: torch.dtype, device: torch.device) -> Tensor:
    """A tensor of a number, an array or nested lists."""
    kind = numbers.Complex if dtype.is_complex else numbers.Real
    try:
        return torch.tensor(_number(value, kind), dtype=dtype, device=device)
    except InputTypeError:
        raise
    except (TypeError, ValueError, RuntimeError, OverflowError) as error:
        raise InputTypeError(
            f"torchweather.physics: expected numbers that make a tensor; got {value!r} ({error})."
        ) from error


def _number(value: Any, kind: Any = numbers.Real) -> Any:
    """A plain number, an array of them or nested lists; anything else is refused."""
    if isinstance(value, (np.ndarray, list, tuple)):
        return value
    if isinstance(value, bool) or not isinstance(value, kind):
        raise InputTypeError(f"torchweather.physics: expected a number or a tensor of numbers; got {value!r}.")
    try:
        size = abs(complex(value))  # numpy's float32 does not compare with the bounds
    except OverflowError:
        size = 2.0 * _LARGEST
    if 0.0 < size < _SMALLEST or _LARGEST < size < float("inf"):
        raise InputValueError(f"torchweather.physics: no quantity is as small or large as {value!r}. Check its unit.")
    return value
