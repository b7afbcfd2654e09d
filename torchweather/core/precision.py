"""Arithmetic in the dtype of the arguments, whatever a surrounding ``torch.autocast`` asks for."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import ParamSpec, TypeVar

import torch

__all__ = ["outside_autocast"]

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
