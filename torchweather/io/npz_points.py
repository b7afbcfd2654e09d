"""Point clouds in ``.npz`` archives: one table with column names, or one array per column; never pickled objects."""

from __future__ import annotations

import os
import tokenize
import warnings
import zipfile
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from torchweather.errors import TorchweatherError, check_one_of
from torchweather.io.atomic import atomic_write
from torchweather.io.stored_points import PointField, PointLayout, StoredPoints

__all__ = ["NPZ_ENCODINGS", "read_npz_points", "write_npz_points"]

# "table": an array `points` (N, C) or (H, W, C), names in `columns`; "columns": an array for each column.
NPZ_ENCODINGS = ("table", "table_compressed", "columns", "columns_compressed")
# What numpy and zipfile raise for files that are none of theirs; RuntimeError is an encrypted archive.
_BROKEN = (
    OSError,
    ValueError,
    EOFError,
    KeyError,
    RuntimeError,
    SyntaxError,
    OverflowError,
    tokenize.TokenError,
    zipfile.BadZipFile,
    zlib.error,
)
# Deflate makes at most 1032 bytes out of one (zlib's technical notes).
_MAX_RATIO = 1032
_USUAL = ("x", "y", "z", "intensity", "ring")


def read_npz_points(path: str | os.PathLike[str]) -> StoredPoints:
    """The columns of an archive.

    Either an array ``points`` (or the only array there is) of shape ``(N, C)`` or ``(H, W, C)``, with the names of the
    columns as strings in ``columns``; without names, four columns are x, y, z, intensity and the fifth is ring. Or
    arrays ``x``, ``y``, ``z`` and more of one shape, ``(N,)`` or ``(H, W)``. Arrays of other shapes are left out.

    Raises:
        TorchweatherError: no archive, truncated, pickled, or without such arrays.
    """
    source = Path(path)
    arrays, compressed = _loaded(source)
    suffix = "_compressed" if compressed else ""
    numeric = {name: array for name, array in arrays.items() if array.dtype.kind in "fiu"}
    lower = {name.lower(): name for name in numeric}
    if all(axis in lower for axis in "xyz"):
        shape = numeric[lower["x"]].shape
        mine = {name: array for name, array in numeric.items() if array.shape == shape}
        grid = _grid(shape, source)
        fields = tuple(PointField(name, array.dtype.str) for name, array in mine.items())
        layout = PointLayout("npz", fields, "columns" + suffix)
        return StoredPoints(layout, tuple(array.reshape(-1) for array in mine.values()), grid)
    if "points" in numeric or len(numeric) == 1:
        table = numeric.get("points", next(iter(numeric.values())))
        if table.ndim in (2, 3) and table.shape[-1]:
            names = _names(arrays.get("columns"), table.shape[-1], source)
            fields = tuple(PointField(name, table.dtype.str) for name in names)
            rows = table.reshape(-1, table.shape[-1])
            layout = PointLayout("npz", fields, "table" + suffix)
            columns = tuple(rows[:, k] for k in range(rows.shape[1]))
            return StoredPoints(layout, columns, _grid(table.shape[:-1], source))
    shapes = ", ".join(f"{name} {array.dtype} {array.shape}" for name, array in arrays.items()) or "nothing"
    raise TorchweatherError(
        f"{source}: wanted numbers as points (N, C) or (H, W, C), or as x, y, z, intensity (N,) each; got {shapes}."
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
    with (
        atomic_write(path) as unfinished,
        zipfile.ZipFile(
            unfinished, "w", zipfile.ZIP_DEFLATED if encoding.endswith("compressed") else zipfile.ZIP_STORED
        ) as archive,
    ):
        # As numpy.savez does, but any column name is allowed (savez takes them as keywords, "file" is its own).
        for name, array in contents.items():
            member = zipfile.ZipInfo(f"{name}.npy")  # dated 1980: the same points give the same bytes
            member.compress_type = archive.compression
            with archive.open(member, "w", force_zip64=True) as file:
                np.lib.format.write_array(file, np.ascontiguousarray(array), allow_pickle=False)


def _loaded(source: Path) -> tuple[dict[str, npt.NDArray[Any]], bool]:
    try:
        with zipfile.ZipFile(source) as archive, warnings.catch_warnings():
            warnings.simplefilter("ignore")  # numpy's, about headers that it repairs or refuses right after
            members = [member for member in archive.infolist() if member.filename.endswith(".npy")]
            arrays = {member.filename[:-4]: _member(archive, member, source) for member in members}
            return arrays, any(member.compress_type != zipfile.ZIP_STORED for member in members)
    except _BROKEN as error:
        raise TorchweatherError(
            f"{source}: wanted arrays as numpy.savez writes them; it cannot be read ({type(error).__name__}: {error}). "
            "The file may be truncated or hold pickled objects, which are never loaded."
        ) from error


def _member(archive: zipfile.ZipFile, member: zipfile.ZipInfo, source: Path) -> npt.NDArray[Any]:
    """An array, after a look at whether the archive can hold as many numbers as it says."""
    with archive.open(member) as file:
        major, _ = np.lib.format.read_magic(file)
        read_header = np.lib.format.read_array_header_1_0 if major == 1 else np.lib.format.read_array_header_2_0
        shape, _, dtype = read_header(file)
        promised = int(np.prod(np.array(shape, dtype=object), initial=1)) * dtype.itemsize
        if promised > min(member.file_size, member.compress_size * _MAX_RATIO):
            raise TorchweatherError(
                f"{source}: array {member.filename[:-4]} {shape} wants {promised} bytes; its {member.compress_size} "
                "bytes in the archive cannot hold them."
            )
    with archive.open(member) as file:
        return np.asarray(np.lib.format.read_array(file, allow_pickle=False))


def _names(columns: npt.NDArray[Any] | None, count: int, source: Path) -> tuple[str, ...]:
    if columns is None:
        return tuple(_USUAL[k] if k < len(_USUAL) else f"column_{k}" for k in range(count))
    names = tuple(str(name) for name in columns.reshape(-1).tolist())
    if columns.dtype.kind != "U" or len(names) != count:
        raise TorchweatherError(f"{source}: wanted {count} names in columns, one for each; got {names}.")
    return names


def _grid(shape: tuple[int, ...], source: Path) -> tuple[int, int] | None:
    if len(shape) > 2 or not shape:
        raise TorchweatherError(f"{source}: wanted points as (N,) or (H, W); got {shape}.")
    return (shape[0], shape[1]) if len(shape) == 2 else None
