"""A point file's content as it is stored: named fields, each in its own dtype; what every format reads and writes."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from torchweather.core.errors import TorchweatherError

__all__ = ["PointField", "PointLayout", "StoredPoints"]

# PCD's name for bytes that stand for nothing.
PADDING = "_"


@dataclass(frozen=True)
class PointField:
    """A field of a point file.

    Args:
        name: as the file has it; ``_`` is padding.
        dtype: numpy's name with byte order, ``<f4``.
        count: numbers per point; a field of several becomes the columns ``name_0``, ``name_1``, ..., one of 0 none.
    """

    name: str
    dtype: str
    count: int = 1

    @property
    def is_padding(self) -> bool:
        """True where the field holds no numbers."""
        return self.name == PADDING or self.count == 0

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of the columns that the field becomes; none for padding."""
        if self.is_padding:
            return ()
        return (self.name,) if self.count == 1 else tuple(f"{self.name}_{k}" for k in range(self.count))


@dataclass(frozen=True)
class PointLayout:
    """Layout of the points of a file, kept so that it can be written back as it was.

    Args:
        format: ``kitti``, ``nuscenes``, ``rows``, ``pcd``, ``ply``, ``npz``, ``csv``, ``las`` or ``ros``.
        fields: in the order of the file.
        encoding: variant within the format, such as ``ascii`` or ``binary_compressed``.
        header: the header's own bytes, used again where nothing in it changed.
        trailer: bytes behind the last point that stand for nothing (a line feed in nuScenes' radar files).
        viewpoint: of a PCD file whose sensor is not in the origin, x, y, z, metres, and the quaternion w, x, y, z of
            its axes in the file's frame.
        zero_rows: whether a file with a viewpoint has rows of x = y = z = 0, which hold no return there;
            ``None`` without one.
        no_return: what the file has for the position of a beam without a return: ``nan``, ``inf`` or ``-inf``;
            ``None`` where it has none.
    """

    format: str
    fields: tuple[PointField, ...]
    encoding: str = ""
    header: bytes = field(default=b"", repr=False)
    trailer: bytes = field(default=b"", repr=False)
    no_return: str | None = None
    viewpoint: tuple[float, ...] | None = None
    zero_rows: bool | None = None


@dataclass(frozen=True, eq=False)
class StoredPoints:
    """Fields of a file and their numbers.

    Args:
        layout: how they are stored.
        arrays: of each field, ``(N,)``, or ``(N, count)`` where it counts more than one; padding is ``None``.
        grid: ``(H, W)`` of an organised cloud.
    """

    layout: PointLayout
    arrays: tuple[npt.NDArray[Any] | None, ...]
    grid: tuple[int, int] | None = None

    @property
    def rows(self) -> int:
        """Number of points."""
        return next((array.shape[0] for array in self.arrays if array is not None), 0)

    @property
    def row_dtype(self) -> np.dtype[Any]:
        """One point as packed bytes."""
        return row_dtype(self.layout.fields)

    def packed(self) -> npt.NDArray[Any]:
        """All points as packed rows, padding zero."""
        rows = np.zeros(self.rows, self.row_dtype)
        for number, array in enumerate(self.arrays):
            if array is not None:
                rows[f"f{number}"] = array
        return rows


def row_dtype(fields: tuple[PointField, ...]) -> np.dtype[Any]:
    """A packed row; field number k is named ``f<k>``, because files may repeat a name."""
    return np.dtype(
        [(f"f{k}", one.dtype, (one.count,)) if one.count != 1 else (f"f{k}", one.dtype) for k, one in enumerate(fields)]
    )


def unpacked(rows: npt.NDArray[Any], fields: tuple[PointField, ...]) -> tuple[npt.NDArray[Any] | None, ...]:
    """The fields of packed rows; padding is ``None``."""
    return tuple(None if one.is_padding else rows[f"f{k}"] for k, one in enumerate(fields))


def spread(columns: list[npt.NDArray[Any]], fields: tuple[PointField, ...]) -> tuple[npt.NDArray[Any] | None, ...]:
    """Columns of a text table gathered to fields; padding takes columns too but is ``None``."""
    arrays: list[npt.NDArray[Any] | None] = []
    position = 0
    for one in fields:
        mine = columns[position : position + one.count]
        position += one.count
        if one.is_padding:
            arrays.append(None)
        else:
            arrays.append(mine[0] if one.count == 1 else np.stack(mine, axis=1))
    return tuple(arrays)


def text_columns(stored: StoredPoints) -> list[npt.NDArray[Any]]:
    """The numbers of all fields column by column, padding zero: the inverse of `spread`."""
    columns: list[npt.NDArray[Any]] = []
    for one, array in zip(stored.layout.fields, stored.arrays, strict=True):
        if array is None:
            columns += [np.zeros(stored.rows, one.dtype)] * one.count
        else:
            columns += [array] if one.count == 1 else list(array.T)
    return columns


def check_rows_fit(source: Path, rows: int, row_bytes: int, available_bytes: int, what: str = "points") -> None:
    """Refuse a header that promises more than the file holds, before any memory is taken for it."""
    if rows * row_bytes > available_bytes:
        raise TorchweatherError(
            f"{source}: expected {rows} {what} of at least {row_bytes} bytes, those of its header; got "
            f"{available_bytes} bytes of data. The file is truncated or its header is wrong."
        )
