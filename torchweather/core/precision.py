"""Arithmetic that keeps its precision under ``torch.autocast`` and in modules of half precision."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import ParamSpec, Self, TypeVar

import torch
from torch import Tensor, nn

__all__ = ["AtLeastSingle", "outside_autocast"]

# Devices whose autocast a training loop may have entered.
_DEVICES = ("cuda", "cpu", "mps", "xpu")

_P = ParamSpec("_P")
_R = TypeVar("_R")


def outside_autocast(function: Callable[_P, _R]) -> Callable[_P, _R]:
    """The function with ``torch.autocast`` switched off inside it.

    Autocast rounds the operands of products of matrices and of convolutions to 16 bits: 8 bits of mantissa in bfloat16.
    A score or a physical quantity then differs in its third digit, although its arguments are float32.

    Args:
        function: any function or method.

    Example:
        >>> product = outside_autocast(torch.matmul)
        >>> with torch.autocast("cpu", dtype=torch.bfloat16):
        ...     product(torch.ones(2, 2), torch.ones(2, 2)).dtype
        torch.float32
    """

    @functools.wraps(function)
    def exact(*args: _P.args, **kwargs: _P.kwargs) -> _R:
        for device in _DEVICES:
            if torch.is_autocast_enabled(device):
                with torch.autocast(device, enabled=False):
                    return exact(*args, **kwargs)
        return function(*args, **kwargs)

    return exact


class AtLeastSingle(nn.Module):
    """A module whose tables stay float32 when it, or a network around it, is moved to 16 bits.

    Extinctions, distances and logarithms of densities do not fit float16, and bfloat16 has two digits. Data may be of
    16 bits all the same: they are what a transform takes and gives.

    Example:
        >>> class Table(AtLeastSingle):
        ...     def __init__(self):
        ...         super().__init__()
        ...         self.register_buffer("values", torch.tensor([1e-9, 1e9]))
        >>> Table().half().values.dtype, nn.Sequential(Table()).double()[0].values.dtype
        (torch.float32, torch.float64)
    """

    def _apply(self, fn: Callable[[Tensor], Tensor], recurse: bool = True) -> Self:
        def kept(table: Tensor) -> Tensor:
            moved = fn(table)
            if moved.dtype not in (torch.float16, torch.bfloat16) or table.dtype == moved.dtype:
                return moved
            return table.to(moved.device)

        applied: Self = super()._apply(kept, recurse)  # type: ignore[no-untyped-call]
        return applied
