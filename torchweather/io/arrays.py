"""Single arrays from ``.npy`` and ``.npz`` files, without ever running what a file contains."""

from __future__ import annotations

import os
import zipfile
import zlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from torchweather.errors import TorchweatherError, nearest_name

__all__ = ["array_to_tensor", "read_array"]

_READABLE = (np.uint8, np.uint16, np.int16, np.int32, np.float16, np.float32, np.float64)


def read_array(path: str | os.PathLike[str], keys: Sequence[str]) -> npt.NDArray[Any]:
    """The array of a ``.npy`` file, or of a ``.npz`` archive: the first of ``keys`` it has, else its only array."""
    source = Path(path)
    try:
        with source.open("rb") as file:  # opened here, because numpy leaves a broken archive open
            loaded = np.load(file, allow_pickle=False)
            if isinstance(loaded, np.ndarray):
                return loaded
            names = list(loaded.files)
            for key in keys:
                if key in names:
                    return np.asarray(loaded[key])
            if len(names) == 1:
                return np.asarray(loaded[names[0]])
    except FileNotFoundError as error:
        raise TorchweatherError(f"{source}: no such file.") from error
    except (OSError, ValueError, EOFError, KeyError, zipfile.BadZipFile, zlib.error) as error:
        raise TorchweatherError(
            f"{source}: wanted one array as numpy.save or numpy.savez writes it; it cannot be read ({error}). "
            "The file may be truncated or hold pickled objects, which are never loaded."
        ) from error
    hint = nearest_name(keys[0], names) if keys else ""
    raise TorchweatherError(
        f"{source}: wanted an array named {' or '.join(keys)}, or a single array; "
        f"got {', '.join(names) or 'none'}.{hint}"
    )


def array_to_tensor(array: npt.NDArray[Any], path: str | os.PathLike[str], wanted: str) -> Tensor:
    """A tensor with memory of its own, in native byte order; other than image dtypes are refused."""
    if array.dtype.newbyteorder("=") not in [np.dtype(t) for t in _READABLE]:
        raise TorchweatherError(f"{path}: wanted {wanted} as uint8, uint16, int16, int32 or float; got {array.dtype}.")
    return torch.from_numpy(np.array(array, dtype=array.dtype.newbyteorder("="), order="C", copy=True))
