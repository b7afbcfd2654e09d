"""Arrays of numpy from tensors of any type."""

from __future__ import annotations

from typing import Any

import torch
from numpy.typing import NDArray
from torch import Tensor

__all__ = ["as_numpy"]


def as_numpy(tensor: Tensor) -> NDArray[Any]:
    """The values as an array on the CPU; bfloat16, which numpy has not, as float32.

    Example:
        >>> as_numpy(torch.ones(2, dtype=torch.bfloat16)).dtype
        dtype('float32')
    """
    values = tensor.detach().cpu()
    found: NDArray[Any] = (values.float() if values.dtype == torch.bfloat16 else values).numpy()
    return found
