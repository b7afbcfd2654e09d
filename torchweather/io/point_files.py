"""Point clouds stored as bare rows: KITTI's four float32 columns, nuScenes' five, and others that the user states."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from torchweather.core.atomic import atomic_write
from torchweather.core.errors import TorchweatherError
from torchweather.io.row_layout import check_rows, likely_layout
from torchweather.io.stored_points import PointField, PointLayout, StoredPoints, row_dtype, unpacked

__all__ = ["FLOAT32_ROWS", "ROWS", "read_float32_file", "read_rows_file", "write_float32_file", "write_rows_file"]

ROWS = "rows"  # the format of rows whose columns the user states


@dataclass(frozen=True)
class _Rows:
    columns: tuple[str, ...]
    meaning: str  # of the columns, for messages


FLOAT32_ROWS = {
    "kitti": _Rows(("x", "y", "z", "intensity"), "x, y, z in metres, reflectance"),
    "nuscenes": _Rows(("x", "y", "z", "intensity", "ring"), "x, y, z in metres, intensity, ring"),
}


def read_float32_file(path: str | os.PathLike[str], format: str) -> StoredPoints:
    """The columns of a file of little-endian float32 rows; one row at least, of numbers that look like a cloud.

    Args:
        path: the file.
        format: ``kitti`` or ``nuscenes``.

    Raises:
        TorchweatherError: the file is missing, holds no whole rows, or numbers that fit another layout; the message
            names it. `read_rows_file` reads it as stated, without this check.
    """
    source, rows = Path(path), FLOAT32_ROWS[format]
    columns = len(rows.columns)
    content = _content(source)
    if not content.size or content.size % (4 * columns):
        rest = {name: content.size % (4 * len(other.columns)) for name, other in FLOAT32_ROWS.items()}
        others = [name for name, bytes_left in rest.items() if content.size and not bytes_left]
        hint = f" Rows of {others[0]} would fit (format={others[0]!r})." if others else ""
        hint = " ".join(part for part in (hint, likely_layout(content)) if part)
        raise TorchweatherError(
            f"{source}: expected rows of {columns} float32 numbers ({rows.meaning}), {4 * columns} bytes each; got "
            f"{content.size} bytes. The file is empty, truncated or has other columns.{hint}"
        )
    check_rows(content, columns, rows.meaning, source)
    table = content.view("<f4").reshape(-1, columns)
    fields = tuple(PointField(name, "<f4") for name in rows.columns)
    return StoredPoints(PointLayout(format, fields), tuple(table[:, k] for k in range(columns)))


def read_rows_file(path: str | os.PathLike[str], fields: tuple[PointField, ...]) -> StoredPoints:
    """The columns of a file of rows without a header, as stated; one row at least.

    Args:
        path: the file.
        fields: of a row, from `stated_fields`.
    """
    source, row = Path(path), row_dtype(fields)
    content = _content(source)
    if not content.size or content.size % row.itemsize:
        stated = ", ".join(f"{one.name} {np.dtype(one.dtype).name}" for one in fields)
        hint = likely_layout(content)
        raise TorchweatherError(
            f"{source}: expected rows of {row.itemsize} bytes, as stated ({stated}); got {content.size} bytes. The "
            f"file is empty, truncated or has other columns.{' ' + hint if hint else ''}"
        )
    return StoredPoints(PointLayout(ROWS, fields), unpacked(content.view(row), fields))


def _content(source: Path) -> npt.NDArray[np.uint8]:
    try:
        return np.fromfile(source, dtype=np.uint8)
    except OSError as error:
        raise TorchweatherError(f"{source}: cannot be read ({error}).") from error


def write_float32_file(path: str | os.PathLike[str], stored: StoredPoints) -> None:
    """Write float32 rows: as many columns as the format has, one row at least.

    Rows are finite, but for beams without a return in a file that marked them by NaN or infinity.
    """
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
            f"{path}: {stored.layout.format} has no header and cannot hold an empty cloud: it would look like a "
            "broken file. Write .pcd or .npz."
        )
    finite = np.isfinite(table)
    if stored.layout.no_return:
        finite |= ~finite[:, :3].any(axis=1, keepdims=True)
    if not bool(finite.all()):
        raise TorchweatherError(
            f"{path}: {stored.layout.format} holds finite numbers; got NaN or inf. Mark beams without a return by "
            "range 0 (lost='zero') or leave them out (lost='drop')."
        )
    with atomic_write(path) as unfinished:
        table.tofile(unfinished)


def write_rows_file(path: str | os.PathLike[str], stored: StoredPoints) -> None:
    """Write rows in the fields that were stated when the file was read; one row at least."""
    if not stored.rows:
        raise TorchweatherError(
            f"{path}: rows without a header cannot hold an empty cloud: it would look like a broken file. "
            "Write .pcd or .npz."
        )
    with atomic_write(path) as unfinished:
        stored.packed().tofile(unfinished)
