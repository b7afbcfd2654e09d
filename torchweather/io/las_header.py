"""The numbers of a LAS header that say how much a file holds, compared with its size before anything is read.

A wrong number of points makes a reader take any memory; a wrong number of LAZ chunks ends the process.
"""

from __future__ import annotations

import os
import struct
from pathlib import Path
from typing import BinaryIO

from torchweather.core.errors import TorchweatherError
from torchweather.core.inflation import check_inflated

__all__ = ["check_las_header"]

# Places in the public header block, LAS 1.4 R15, table 3: minor version; header size, offset of the points, number of
# records; format and length of a point, number of points as in LAS 1.2; start and number of extended records and number
# of points of LAS 1.4.
_VERSION, _SIZES, _POINT, _EXTENDED = 25, 94, 104, 235
_HEAD_BYTES = 375
_COMPRESSED = 0x80  # bit of the point format that LASzip sets
_RECORD_BYTES, _EXTENDED_RECORD_BYTES = 54, 60  # of the head of a variable length record


def check_las_header(source: Path) -> None:
    """Raise `TorchweatherError` where a header promises more than the file can hold; other damage is left to laspy."""
    try:
        with source.open("rb") as file:
            head, size = file.read(_HEAD_BYTES), os.fstat(file.fileno()).st_size
            if head[:4] != b"LASF" or len(head) < _SIZES + 17:
                return
            _check(source, file, head, size)
    except OSError as error:
        raise TorchweatherError(f"{source}: cannot be read ({error.strerror}).") from error


def _check(source: Path, file: BinaryIO, head: bytes, size: int) -> None:
    _, start, records = struct.unpack_from("<HII", head, _SIZES)
    form, length, points = struct.unpack_from("<BHI", head, _POINT)
    if records * _RECORD_BYTES > size:
        raise _damaged(source, f"{records} variable length records", size)
    if head[_VERSION] >= 4 and len(head) >= _EXTENDED + 20:
        _, extended, points = struct.unpack_from("<QIQ", head, _EXTENDED)
        if extended * _EXTENDED_RECORD_BYTES > size:
            raise _damaged(source, f"{extended} extended records", size)
    stored = max(0, size - start)
    if not form & _COMPRESSED:
        if points * length > stored:
            raise _damaged(source, f"{points} points of {length} bytes", size)
        return
    check_inflated(source, points * length, stored)
    if points:
        _check_chunks(source, file, start, size, length)


def _check_chunks(source: Path, file: BinaryIO, start: int, size: int, length: int) -> None:
    """Compare the number of chunks, each of which begins with a point as it is."""
    file.seek(start)
    table = _number(file, "<q")
    if table == -1:  # a writer that cannot go back puts the offset at the end
        file.seek(max(0, size - 8))
        table = _number(file, "<q")
    if table is None or not start <= table <= size - 8:
        raise _damaged(source, f"a table of chunks at byte {table}", size)
    file.seek(table + 4)
    chunks = _number(file, "<I")
    if chunks is None or chunks * max(1, length) > size:
        raise _damaged(source, f"{chunks} chunks", size)


def _number(file: BinaryIO, form: str) -> int | None:
    content = file.read(struct.calcsize(form))
    return struct.unpack(form, content)[0] if len(content) == struct.calcsize(form) else None


def _damaged(source: Path, promised: str, size: int) -> TorchweatherError:
    return TorchweatherError(
        f"{source}: cannot be read as LAS: its header promises {promised}; the file has {size} bytes. It is truncated "
        "or damaged."
    )
