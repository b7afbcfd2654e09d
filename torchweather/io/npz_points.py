"""Point clouds in ``.npz`` archives: one table with column names, or one array per column; never pickled objects."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from torchweather.core.errors import TorchweatherError, check_one_of
from torchweather.io.arrays import read_archive, write_archive
from torchweather.io.stored_points import PointField, PointLayout, StoredPoints

__all__ = ["NPZ_ENCODINGS", "read_npz_points", "write_npz_points"]

# "table": an array `points` (N, C) or (H, W, C), names in `columns`; "columns": an array for each column.
NPZ_ENCODINGS = ("table", "table_compressed", "columns", "columns_compressed")
_POSITIONS = (("x", "y", "z"),)
_USUAL = ("x", "y", "z", "intensity", "ring")


def read_npz_points(
    path: str | os.PathLike[str],
    *,
    positions: Sequence[Sequence[str]] = _POSITIONS,
    usual: Sequence[str] = _USUAL,
) -> StoredPoints:
    """The columns of an archive.

    Either an array ``points`` (or the only array there is) of shape ``(N, C)`` or ``(H, W, C)``, with the names of the
    columns as strings in ``columns``. Or arrays ``x``, ``y``, ``z`` and more of one shape, ``(N,)`` or ``(H, W)``.
    Arrays of other shapes are left out.

    Args:
        path: ``.npz``.
        positions: groups of arrays, in lower case; an archive that holds one of the groups keeps columns.
        usual: names of a table's columns where it brings none; further ones are ``column_5`` and so on.

    Raises:
        TorchweatherError: no archive, truncated, pickled, or without such arrays.
    """
    source = Path(path)
    arrays, compressed = read_archive(source)
    suffix = "_compressed" if compressed else ""
    numeric = {name: array for name, array in arrays.items() if array.dtype.kind in "fiu"}
    lower = {name.lower(): name for name in numeric}
    found = [names for names in positions if all(name in lower for name in names)]
    if found:
        shape = numeric[lower[found[0][0]]].shape
        mine = {name: array for name, array in numeric.items() if array.shape == shape}
        grid = _grid(shape, source)
        fields = tuple(PointField(name, array.dtype.str) for name, array in mine.items())
        layout = PointLayout("npz", fields, "columns" + suffix)
        return StoredPoints(layout, tuple(array.reshape(-1) for array in mine.values()), grid)
    if "points" in numeric or len(numeric) == 1:
        table = numeric.get("points", next(iter(numeric.values())))
        if table.ndim in (2, 3) and table.shape[-1]:
            names = _names(arrays.get("columns"), table.shape[-1], usual, source)
            fields = tuple(PointField(name, table.dtype.str) for name in names)
            rows = table.reshape(-1, table.shape[-1])
            layout = PointLayout("npz", fields, "table" + suffix)
            columns = tuple(rows[:, k] for k in range(rows.shape[1]))
            return StoredPoints(layout, columns, _grid(table.shape[:-1], source))
    shapes = ", ".join(f"{name} {array.dtype} {array.shape}" for name, array in arrays.items()) or "nothing"
    raise TorchweatherError(
        f"{source}: expected numbers as points (N, C) or (H, W, C), or as x, y, z, intensity (N,) each; got {shapes}."
    )


def write_npz_points(path: str | os.PathLike[str], stored: StoredPoints) -> None:
    """Write the fields as one table with names, or as one array each, by the layout's encoding.

    Raises:
        ValueError: the encoding is none of `NPZ_ENCODINGS`.
        TorchweatherError: a column has a name that an archive cannot hold.
    """
    encoding = stored.layout.encoding
    check_one_of("encoding", encoding, NPZ_ENCODINGS, owner="write_npz_points")
    fields = stored.layout.fields
    shape = stored.grid or (stored.rows,)
    contents: dict[str, npt.NDArray[Any]] = {}
    if encoding.startswith("table"):
        dtype = np.result_type(*(np.dtype(one.dtype) for one in fields))
        table = np.stack([np.asarray(array, dtype) for array in stored.arrays if array is not None], axis=-1)
        contents["points"] = table.reshape(*shape, -1) if stored.rows else table.reshape(*shape, len(fields))
        contents["columns"] = np.array([one.name for one in fields])
    else:
        for one, array in zip(fields, stored.arrays, strict=True):
            if not one.name or "/" in one.name or one.name.startswith("."):
                raise TorchweatherError(f"{path}: an archive cannot hold a column named {one.name!r}.")
            contents[one.name] = np.asarray(array).reshape(*shape)
    write_archive(path, contents, compressed=encoding.endswith("compressed"))


def _names(columns: npt.NDArray[Any] | None, count: int, usual: Sequence[str], source: Path) -> tuple[str, ...]:
    if columns is None:
        return tuple(usual[k] if k < len(usual) else f"column_{k}" for k in range(count))
    names = tuple(str(name) for name in columns.reshape(-1).tolist())
    if columns.dtype.kind != "U" or len(names) != count:
        raise TorchweatherError(f"{source}: expected {count} names in columns, one for each; got {names}.")
    return names


def _grid(shape: tuple[int, ...], source: Path) -> tuple[int, int] | None:
    if len(shape) > 2 or not shape:
        raise TorchweatherError(f"{source}: expected points as (N,) or (H, W); got {shape}.")
    return (shape[0], shape[1]) if len(shape) == 2 else None
