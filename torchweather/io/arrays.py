"""Arrays in ``.npy`` and ``.npz`` files, without ever running what a file contains."""

from __future__ import annotations

import os
import tokenize
import warnings
import zipfile
import zlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import IO, Any

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from torchweather.core.atomic import atomic_write
from torchweather.core.errors import TorchweatherError, nearest_name
from torchweather.core.inflation import check_inflated, few_names

__all__ = ["array_to_tensor", "read_archive", "read_array", "read_named_array", "write_archive"]

_READABLE = (np.uint8, np.uint16, np.int16, np.int32, np.float16, np.float32, np.float64)
# What numpy and zipfile raise for files that are none of theirs; RuntimeError is an encrypted archive.
_BROKEN = (
    OSError,
    ValueError,
    EOFError,
    KeyError,
    TypeError,  # of a header with a key b'shape', which numpy cannot sort for its own complaint
    RuntimeError,
    SyntaxError,
    OverflowError,
    tokenize.TokenError,
    zipfile.BadZipFile,
    zlib.error,
)
# Deflate makes at most 1032 bytes out of one (zlib's technical notes).
_MAX_RATIO = 1032
# Arrays of an archive; each has a header to be parsed.
_MOST_MEMBERS = 1000


def read_array(path: str | os.PathLike[str], keys: Sequence[str]) -> npt.NDArray[Any]:
    """The array of a ``.npy`` file, or of a ``.npz`` archive: the first of ``keys`` it has, else its only array."""
    return read_named_array(path, keys)[1]


def read_named_array(path: str | os.PathLike[str], keys: Sequence[str]) -> tuple[str, npt.NDArray[Any]]:
    """The array that `read_array` takes, with its name in the archive; '' of a ``.npy`` file."""
    source = Path(path)
    try:
        with source.open("rb") as file, warnings.catch_warnings():
            warnings.simplefilter("ignore")  # numpy's, about headers that it repairs or refuses right after
            archived = file.read(2) == b"PK"
            file.seek(0)
            if not archived:
                return "", _array(file, os.fstat(file.fileno()).st_size, source, "")
            with zipfile.ZipFile(file) as archive:
                members = {member.filename[:-4]: member for member in _members(archive, source)}
                wanted = [key for key in keys if key in members] or (list(members) if len(members) == 1 else [])
                if wanted:
                    return wanted[0], _member(archive, members[wanted[0]], source)
    except FileNotFoundError as error:
        raise TorchweatherError(f"{source}: no such file.") from error
    except _BROKEN as error:
        raise TorchweatherError(
            f"{source}: wanted one array as numpy.save or numpy.savez writes it; it cannot be read ({error}). "
            "The file may be truncated or hold pickled objects, which are never loaded."
        ) from error
    hint = nearest_name(keys[0], [name for name in members if len(name) < 100]) if keys else ""
    raise TorchweatherError(
        f"{source}: wanted an array named {' or '.join(keys)}, or a single array; got {few_names(members)}.{hint}"
    )


def read_archive(source: Path) -> tuple[dict[str, npt.NDArray[Any]], bool]:
    """All arrays of a ``.npz`` archive by name, and whether any is compressed."""
    try:
        with zipfile.ZipFile(source) as archive, warnings.catch_warnings():
            warnings.simplefilter("ignore")  # numpy's, about headers that it repairs or refuses right after
            members = _members(archive, source)
            check_inflated(
                source, sum(member.file_size for member in members), sum(member.compress_size for member in members)
            )
            arrays = {member.filename[:-4]: _member(archive, member, source) for member in members}
            return arrays, any(member.compress_type != zipfile.ZIP_STORED for member in members)
    except _BROKEN as error:
        raise TorchweatherError(
            f"{source}: wanted arrays as numpy.savez writes them; it cannot be read ({type(error).__name__}: {error}). "
            "The file may be truncated or hold pickled objects, which are never loaded."
        ) from error


def write_archive(
    path: str | os.PathLike[str], contents: Mapping[str, npt.NDArray[Any]], *, compressed: bool = False
) -> None:
    """Arrays as numpy.savez writes them, but with any name (savez takes them as keywords, "file" is its own)."""
    with (
        atomic_write(path) as unfinished,
        zipfile.ZipFile(unfinished, "w", zipfile.ZIP_DEFLATED if compressed else zipfile.ZIP_STORED) as archive,
    ):
        for name, array in contents.items():
            member = zipfile.ZipInfo(f"{name}.npy")  # dated 1980: the same arrays give the same bytes
            member.compress_type = archive.compression
            with archive.open(member, "w", force_zip64=True) as file:
                np.lib.format.write_array(file, np.asarray(array, order="C"), allow_pickle=False)


def array_to_tensor(array: npt.NDArray[Any], path: str | os.PathLike[str], wanted: str) -> Tensor:
    """A tensor with memory of its own, in native byte order; other than image dtypes are refused."""
    if array.dtype.newbyteorder("=") not in [np.dtype(t) for t in _READABLE]:
        raise TorchweatherError(f"{path}: wanted {wanted} as uint8, uint16, int16, int32 or float; got {array.dtype}.")
    return torch.from_numpy(np.array(array, dtype=array.dtype.newbyteorder("="), order="C", copy=True))


def _members(archive: zipfile.ZipFile, source: Path) -> list[zipfile.ZipInfo]:
    members = [member for member in archive.infolist() if member.filename.endswith(".npy")]
    if len(members) > _MOST_MEMBERS:
        raise TorchweatherError(
            f"{source}: wanted at most {_MOST_MEMBERS} arrays; got {len(members):,}. Write what belongs to one frame."
        )
    return members


def _member(archive: zipfile.ZipFile, member: zipfile.ZipInfo, source: Path) -> npt.NDArray[Any]:
    with archive.open(member) as file:
        available = min(member.file_size, member.compress_size * _MAX_RATIO)
        check_inflated(source, available, member.compress_size)
        return _array(file, available, source, f" {few_names([member.filename[:-4]])}")


def _array(file: IO[bytes], available_bytes: int, source: Path, name: str) -> npt.NDArray[Any]:
    """An array, after a look at whether the file can hold as many numbers as it says."""
    major, _ = np.lib.format.read_magic(file)
    read_header = np.lib.format.read_array_header_1_0 if major == 1 else np.lib.format.read_array_header_2_0
    shape, _, dtype = read_header(file)
    promised = int(np.prod(np.array(shape, dtype=object), initial=1)) * dtype.itemsize
    if promised > available_bytes:
        raise TorchweatherError(
            f"{source}: array{name} {shape} wants {promised} bytes; the file cannot hold the wanted numbers in "
            f"{available_bytes}. It is truncated or its header is wrong."
        )
    file.seek(0)
    return np.asarray(np.lib.format.read_array(file, allow_pickle=False))
