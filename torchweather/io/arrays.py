"""Arrays of files as tensors, and the readers of ``.npy`` and ``.npz`` that they come from."""

from __future__ import annotations

import os
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from torchweather.core.archives import read_archive, read_array, read_named_array, write_archive
from torchweather.core.errors import TorchweatherError

__all__ = ["array_to_tensor", "read_archive", "read_array", "read_named_array", "write_archive"]

_READABLE = (np.uint8, np.uint16, np.int16, np.int32, np.float16, np.float32, np.float64)


def array_to_tensor(array: npt.NDArray[Any], path: str | os.PathLike[str], wanted: str) -> Tensor:
    """A tensor with memory of its own, in native byte order; other than image dtypes are refused."""
    if array.dtype.newbyteorder("=") not in [np.dtype(t) for t in _READABLE]:
        raise TorchweatherError(
            f"{path}: expected {wanted} as uint8, uint16, int16, int32 or float; got {array.dtype}."
        )
    return torch.from_numpy(np.array(array, dtype=array.dtype.newbyteorder("="), order="C", copy=True))
