"""Point clouds stored as bare float32 rows."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from torchweather.errors import TorchweatherError

__all__ = ["read_float32_rows"]


def read_float32_rows(path: str | os.PathLike[str], columns: int, meaning: str) -> Tensor:
    """Rows of little-endian float32 numbers.

    Args:
        path: the file.
        columns: numbers per row.
        meaning: of the columns, for messages.

    Returns:
        ``(N, columns)`` float32, finite.
    """
    source = Path(path)
    try:
        numbers = np.fromfile(source, dtype="<f4")
        odd_bytes = source.stat().st_size % (4 * columns)
    except OSError as error:
        raise TorchweatherError(f"{source}: cannot be read ({error}).") from error
    if numbers.size == 0 or odd_bytes:
        raise TorchweatherError(
            f"{source}: wanted rows of {columns} float32 numbers ({meaning}), {4 * columns} bytes each; got "
            f"{source.stat().st_size} bytes. The file is empty, truncated or has other columns."
        )
    rows = torch.from_numpy(numbers.astype(np.float32).reshape(-1, columns))
    if not bool(torch.isfinite(rows).all()):
        raise TorchweatherError(f"{source}: wanted finite numbers ({meaning}); got NaN or inf. Other columns, perhaps?")
    return rows
