"""Copies of modules with other buffers; the copy shares everything else with the original."""

from __future__ import annotations

import copy
from typing import TypeVar

from torch import Tensor, nn

__all__ = ["with_buffers"]

M = TypeVar("M", bound=nn.Module)


def with_buffers(module: M, **buffers: Tensor) -> M:
    """A module like another one, with other values of some buffers; submodules and other buffers are shared.

    Args:
        module: it stays as it is, whatever is assigned to the copy.
        buffers: by name.

    Example:
        >>> import torch
        >>> norm = nn.BatchNorm1d(1)
        >>> float(with_buffers(norm, running_mean=torch.ones(1)).running_mean), float(norm.running_mean)
        (1.0, 0.0)
    """
    found = copy.copy(module)
    found._modules, found._parameters = dict(module._modules), dict(module._parameters)
    found._buffers = {**module._buffers, **buffers}
    return found
