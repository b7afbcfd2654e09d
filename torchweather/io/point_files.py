"""Point clouds stored as bare float32 rows: KITTI's four columns, nuScenes' five."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from torchweather.core.atomic import atomic_write
from torchweather.core.errors import TorchweatherError
from torchweather.io.stored_points import PointField, PointLayout, StoredPoints

__all__ = ["FLOAT32_ROWS", "read_float32_file", "write_float32_file"]


@dataclass(frozen=True)
class _Rows:
    columns: tuple[str, ...]
    meaning: str  # of the columns, for messages


FLOAT32_ROWS = {
    "kitti": _Rows(("x", "y", "z", "intensity"), "x, y, z in metres, reflectance"),
    "nuscenes": _Rows(("x", "y", "z", "intensity", "ring"), "x, y, z in metres, intensity, ring"),
}


def read_float32_file(path: str | os.PathLike[str], format: str) -> StoredPoints:
    """The columns of a file of little-endian float32 rows, finite; one row at least.

    Args:
        path: the file.
        format: ``kitti`` or ``nuscenes``.
    """
    source, rows = Path(path), FLOAT32_ROWS[format]
    columns = len(rows.columns)
    try:
        size = source.stat().st_size
        odd_bytes = size % (4 * columns)
        table: npt.NDArray[Any] = np.zeros(0, "<f4") if odd_bytes else np.fromfile(source, dtype="<f4")
    except OSError as error:
        raise TorchweatherError(f"{source}: cannot be read ({error}).") from error
    if table.size == 0:
        others = [name for name, other in FLOAT32_ROWS.items() if size and size % (4 * len(other.columns)) == 0]
        hint = f" Rows of {others[0]} would fit (format={others[0]!r})." if others else ""
        raise TorchweatherError(
            f"{source}: wanted rows of {columns} float32 numbers ({rows.meaning}), {4 * columns} bytes each; got "
            f"{size} bytes. The file is empty, truncated or has other columns.{hint}"
        )
    table = table.reshape(-1, columns)
    if not bool(np.isfinite(table).all()):
        bad = int((~np.isfinite(table)).any(1).sum())
        raise TorchweatherError(
            f"{source}: wanted finite numbers ({rows.meaning}); got NaN or infinity in {bad} of {len(table)} rows. "
            "Give a beam without return the coordinates 0, 0, 0, or drop the row; in most rows: other columns."
        )
    fields = tuple(PointField(name, "<f4") for name in rows.columns)
    return StoredPoints(PointLayout(format, fields), tuple(table[:, k] for k in range(columns)))


def write_float32_file(path: str | os.PathLike[str], stored: StoredPoints) -> None:
    """Write float32 rows: as many columns as the format has, finite, one row at least."""
    rows = FLOAT32_ROWS[stored.layout.format]
    names = tuple(one.name for one in stored.layout.fields)
    if len(names) != len(rows.columns):
        raise TorchweatherError(
            f"{path}: {stored.layout.format} holds {len(rows.columns)} columns ({rows.meaning}); got "
            f"{', '.join(names)}. Choose {len(rows.columns)} of them with columns=(...)."
        )
    table = np.stack([np.asarray(array) for array in stored.arrays], axis=1).astype("<f4", copy=False)
    if not table.size:
        raise TorchweatherError(
            f"{path}: {stored.layout.format} has no header and cannot hold an empty cloud: the file could not be told "
            "from a broken one. Write .pcd or .npz."
        )
    if not bool(np.isfinite(table).all()):
        raise TorchweatherError(
            f"{path}: {stored.layout.format} holds finite numbers; got NaN or inf. Mark beams without a return by "
            "range 0 (lost='zero') or leave them out (lost='drop')."
        )
    with atomic_write(path) as unfinished:
        table.tofile(unfinished)
