"""Arrays in ``.npy`` and ``.npz`` files, without ever running what a file contains."""

from __future__ import annotations

import os
import sys
import tokenize
import warnings
import zipfile
import zlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import IO, Any

import numpy as np
import numpy.typing as npt

from torchweather.core.atomic import atomic_write
from torchweather.core.errors import InputValueError, TorchweatherError, nearest_name
from torchweather.core.inflation import check_inflated, few_names

__all__ = ["BROKEN_ARCHIVE", "read_archive", "read_array", "read_named_array", "write_archive"]

# What numpy and zipfile raise for files that are none of theirs; RuntimeError is an encrypted archive.
BROKEN_ARCHIVE = (
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
    except BROKEN_ARCHIVE as error:
        raise TorchweatherError(
            f"{source}: expected one array as numpy.save or numpy.savez writes it; it cannot be read ({error}). "
            "The file may be truncated or hold pickled objects, which are never loaded."
        ) from error
    hint = nearest_name(keys[0], [name for name in members if len(name) < 100]) if keys else ""
    raise TorchweatherError(
        f"{source}: expected an array named {' or '.join(keys)}, or a single array; got {few_names(members)}.{hint}"
    )


def read_archive(
    source: str | os.PathLike[str], content: IO[bytes] | None = None
) -> tuple[dict[str, npt.NDArray[Any]], bool]:
    """All arrays of a ``.npz`` archive by name, and whether any is compressed.

    Args:
        source: the file.
        content: what is read in its place; ``source`` is then its name in errors.
    """
    try:
        with zipfile.ZipFile(source if content is None else content) as archive, warnings.catch_warnings():
            warnings.simplefilter("ignore")  # numpy's, about headers that it repairs or refuses right after
            members = _members(archive, source)
            check_inflated(
                source, sum(member.file_size for member in members), sum(member.compress_size for member in members)
            )
            arrays = {member.filename[:-4]: _member(archive, member, source) for member in members}
            return arrays, any(member.compress_type != zipfile.ZIP_STORED for member in members)
    except BROKEN_ARCHIVE as error:
        raise TorchweatherError(
            f"{source}: expected arrays as numpy.savez writes them; it cannot be read ({type(error).__name__}: "
            f"{error}). The file may be truncated or hold pickled objects, which are never loaded."
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


def _members(archive: zipfile.ZipFile, source: object) -> list[zipfile.ZipInfo]:
    members = [member for member in archive.infolist() if member.filename.endswith(".npy")]
    if len(members) > _MOST_MEMBERS:
        raise TorchweatherError(
            f"{source}: expected at most {_MOST_MEMBERS} arrays; got {len(members):,}. Write what belongs to one frame."
        )
    return members


def _member(archive: zipfile.ZipFile, member: zipfile.ZipInfo, source: object) -> npt.NDArray[Any]:
    with archive.open(member) as file:
        available = min(member.file_size, member.compress_size * _MAX_RATIO)
        check_inflated(source, available, member.compress_size)
        return _array(file, available, source, f" {few_names([member.filename[:-4]])}")


def _array(file: IO[bytes], available_bytes: int, source: object, name: str) -> npt.NDArray[Any]:
    """An array, after a look at whether the file can hold as many numbers as it says."""
    major, _ = np.lib.format.read_magic(file)
    _check_header(file, major, available_bytes)
    read_header = np.lib.format.read_array_header_1_0 if major == 1 else np.lib.format.read_array_header_2_0
    shape, _, dtype = read_header(file)
    promised = int(np.prod(np.array(shape, dtype=object), initial=1)) * dtype.itemsize
    if promised > available_bytes:
        raise TorchweatherError(
            f"{source}: array{name} {shape} needs {promised} bytes; the file cannot hold them in "
            f"{available_bytes}. It is truncated or its header is wrong."
        )
    file.seek(0)
    array = np.asarray(np.lib.format.read_array(file, allow_pickle=False))
    if dtype.kind == "U" and array.size:
        # numpy hands any 32 bits over as a character, and Python fails where such a text is used.
        codes = np.ascontiguousarray(array).reshape(-1).view(np.dtype(np.uint32).newbyteorder(dtype.byteorder))
        if int(codes.max()) > sys.maxunicode:
            raise TorchweatherError(f"{source}: array{name} holds text that is no Unicode. The file is damaged.")
    return array


def _check_header(file: IO[bytes], major: int, available_bytes: int) -> None:
    """Refuse a header longer than its file, before memory is taken for it."""
    if major not in (1, 2, 3):
        raise InputValueError(f"version {major} of numpy's format")
    start = file.tell()
    length = int.from_bytes(file.read(2 if major == 1 else 4), "little")
    if length > available_bytes:
        raise InputValueError(f"a header of {length} bytes in a file of {available_bytes}")
    file.seek(start)
