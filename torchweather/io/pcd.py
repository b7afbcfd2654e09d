"""PCD, the point files of the Point Cloud Library: ascii, binary and binary_compressed."""

from __future__ import annotations

import math
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from torchweather.core.atomic import atomic_write
from torchweather.core.errors import TorchweatherError, check_one_of
from torchweather.io.lzf import LZF_MAX_RATIO, lzf_compress, lzf_decompress
from torchweather.io.number_text import column_text, parse_columns
from torchweather.io.stored_points import (
    PointField,
    PointLayout,
    StoredPoints,
    check_rows_fit,
    row_dtype,
    spread,
    text_columns,
    unpacked,
)

__all__ = ["PCD_ENCODINGS", "read_pcd", "write_pcd"]

PCD_ENCODINGS = ("ascii", "binary", "binary_compressed")
_KIND = {"F": "f", "I": "i", "U": "u"}
_SIZES = {"F": (4, 8), "I": (1, 2, 4, 8), "U": (1, 2, 4, 8)}
# A header is a dozen short lines; what is longer is no PCD file.
_MAX_HEADER_BYTES = 1 << 20
# Descriptors have some hundred numbers for a point; what is longer is a broken header.
_MAX_ROW_BYTES = 1 << 20
_VIEWPOINT = "0 0 0 1 0 0 0"


@dataclass(frozen=True)
class _Header:
    fields: tuple[PointField, ...]
    width: int
    height: int
    points: int
    data: str


def read_pcd(path: str | os.PathLike[str]) -> StoredPoints:
    """The fields of a PCD file.

    Fields may have any name, type and count; fields named ``_`` are padding, fields of count 0 take no bytes.
    ``HEIGHT`` above 1 makes an organised cloud. The viewpoint is in the layout, not applied.

    Raises:
        TorchweatherError: not a PCD file, or one that holds other than its header says.

    References:
        The PCD file format, pointclouds.org/documentation/tutorials/pcd_file_format.html.
    """
    source = Path(path)
    try:
        with source.open("rb") as file:
            raw = _raw_header(file, source)
            header = _parsed(raw, source)
            available = os.fstat(file.fileno()).st_size - len(raw)
            trailer = b""
            if header.data == "ascii":
                arrays = _ascii(file.read(), header, raw, source)
            elif header.data == "binary":
                check_rows_fit(source, header.points, row_dtype(header.fields).itemsize, available)
                _check_surplus(source, available, header)
                rows = np.fromfile(file, row_dtype(header.fields), header.points)
                arrays = unpacked(rows, header.fields)
                trailer = file.read()
            else:
                arrays = _compressed(file.read(), header, source)
    except OSError as error:
        raise TorchweatherError(f"{source}: cannot be read ({error}).") from error
    layout = PointLayout("pcd", header.fields, header.data, raw, trailer, viewpoint=_viewpoint(raw, source))
    grid = (header.height, header.width) if header.height > 1 else None
    return StoredPoints(layout, arrays, grid)


def write_pcd(path: str | os.PathLike[str], stored: StoredPoints) -> None:
    """Write the fields as PCD 0.7 in the encoding of their layout; little endian.

    Raises:
        ValueError: the encoding is none of `PCD_ENCODINGS`.
        TorchweatherError: a field that PCD has no type for, or more than 4 GiB to be compressed.
    """
    check_one_of("encoding", stored.layout.encoding, PCD_ENCODINGS, owner="write_pcd")
    height, width = stored.grid or (1, stored.rows)
    header = _Header(stored.layout.fields, width, height, stored.rows, stored.layout.encoding)
    raw = _header_bytes(header, stored.layout, path)
    with atomic_write(path) as unfinished, unfinished.open("wb") as file:
        file.write(raw)
        if header.data == "ascii":
            columns = [column_text(column) for column in text_columns(stored)]
            file.write("".join(" ".join(row) + "\n" for row in zip(*columns, strict=True)).encode("ascii"))
        elif header.data == "binary":
            stored.packed().tofile(file)
            file.write(stored.layout.trailer)
        else:
            plain = b"".join(
                np.ascontiguousarray(array, one.dtype).tobytes()
                if array is not None
                else bytes(stored.rows * one.count * np.dtype(one.dtype).itemsize)
                for one, array in zip(header.fields, stored.arrays, strict=True)
            )
            packed = lzf_compress(plain)
            if max(len(plain), len(packed)) >= 2**32:
                raise TorchweatherError(
                    f"{path}: binary_compressed holds less than 4 GiB; got {len(plain)} bytes. Write encoding='binary'."
                )
            file.write(np.array([len(packed), len(plain)], "<u4").tobytes())
            file.write(packed)


def _raw_header(file: Any, source: Path) -> bytes:
    lines = []
    size = 0
    while size < _MAX_HEADER_BYTES:
        line = file.readline(_MAX_HEADER_BYTES)
        lines.append(line)
        size += len(line)
        if line.split()[:1] == [b"DATA"]:
            return b"".join(lines)
        if not line:
            break
    raise TorchweatherError(f"{source}: expected a PCD header that ends in a line DATA; there is none.")


def _parsed(raw: bytes, source: Path) -> _Header:
    entries: dict[str, list[str]] = {}
    for line in raw.decode("utf-8", "surrogateescape").split("\n"):
        words = line.split("#", 1)[0].split()
        if words:
            entries[words[0].upper()] = words[1:]
    names = entries.get("FIELDS") or entries.get("COLUMNS") or []
    try:
        sizes = [int(word) for word in entries["SIZE"]]
        types = [word.upper() for word in entries["TYPE"]]
        counts = [int(word) for word in entries.get("COUNT", ["1"] * len(names))]
        height = int(entries.get("HEIGHT", ["1"])[0])
        width = int((entries["WIDTH"] if "WIDTH" in entries else entries["POINTS"])[0])
        points = int(entries["POINTS"][0]) if "POINTS" in entries else width * height
        data = entries["DATA"][0].lower()
    except (KeyError, IndexError, ValueError) as error:
        raise TorchweatherError(
            f"{source}: expected a PCD header with FIELDS, SIZE, TYPE, WIDTH, HEIGHT, POINTS and DATA; "
            f"{type(error).__name__}: {error}."
        ) from error
    if not names or not len(names) == len(sizes) == len(types) == len(counts):
        raise TorchweatherError(
            f"{source}: expected as many SIZE, TYPE and COUNT as FIELDS; got {len(names)} fields, {len(sizes)} sizes, "
            f"{len(types)} types and {len(counts)} counts."
        )
    fields = []
    for name, size, letter, count in zip(names, sizes, types, counts, strict=True):
        if size not in _SIZES.get(letter, ()) or count < 0:
            raise TorchweatherError(
                f"{source}: field {name!r}: expected TYPE F with SIZE 4 or 8, or I or U with 1, 2, 4 or 8; COUNT 0 or "
                f"more; got TYPE {letter}, SIZE {size}, COUNT {count}."
            )
        fields.append(PointField(name, f"<{_KIND[letter]}{size}" if size > 1 else f"|{_KIND[letter]}1", count))
    row_bytes = sum(size * count for size, count in zip(sizes, counts, strict=True))
    if row_bytes > _MAX_ROW_BYTES:
        raise TorchweatherError(
            f"{source}: expected at most {_MAX_ROW_BYTES} bytes for a point; got {row_bytes} from SIZE and COUNT."
        )
    if min(width, height, points) < 0 or width * height != points:
        raise TorchweatherError(
            f"{source}: expected POINTS = WIDTH x HEIGHT, none negative; got POINTS {points}, WIDTH {width}, "
            f"HEIGHT {height}."
        )
    if data not in PCD_ENCODINGS:
        raise TorchweatherError(f"{source}: expected DATA {', '.join(PCD_ENCODINGS)}; got {data!r}.")
    return _Header(tuple(fields), width, height, points, data)


def _check_surplus(source: Path, available: int, header: _Header) -> None:
    """A few bytes behind the last point are padding of a writer; another point is a wrong header."""
    size = row_dtype(header.fields).itemsize
    if available - header.points * size >= size:
        raise TorchweatherError(
            f"{source}: expected {header.points} points of {size} bytes, those of its header; got {available} bytes of "
            "data. The header is wrong."
        )


def _ascii(body: bytes, header: _Header, raw: bytes, source: Path) -> tuple[Any, ...]:
    columns = sum(one.count for one in header.fields)
    # A digit and a separator for each number; the last separator may be missing.
    check_rows_fit(source, header.points, 2 * columns, len(body) + 1)
    dtypes = [np.dtype(one.dtype) for one in header.fields for _ in range(one.count)]
    found = parse_columns(
        body.decode("latin-1").split("\n"),
        dtypes,
        header.points,
        source=source,
        first_line=raw.count(b"\n") + 1,
    )
    return spread(found, header.fields)


def _compressed(body: bytes, header: _Header, source: Path) -> tuple[Any, ...]:
    wanted = header.points * row_dtype(header.fields).itemsize
    if len(body) < 8:
        if not header.points and not any(body):
            return unpacked(np.zeros(0, row_dtype(header.fields)), header.fields)
        raise TorchweatherError(f"{source}: expected the compressed and plain size, 8 bytes; got {len(body)} bytes.")
    packed_bytes, plain_bytes = (int(number) for number in np.frombuffer(body, "<u4", 2))
    if plain_bytes != wanted or packed_bytes > len(body) - 8 or plain_bytes > packed_bytes * LZF_MAX_RATIO:
        raise TorchweatherError(
            f"{source}: expected {header.points} points, {wanted} bytes, from the header; got {packed_bytes} "
            f"compressed bytes of which {len(body) - 8} are there, said to stand for {plain_bytes}. The file is "
            "truncated or its header is wrong."
        )
    try:
        plain = lzf_decompress(body[8 : 8 + packed_bytes], plain_bytes)
    except ValueError as error:
        raise TorchweatherError(f"{source}: the compressed points are broken: {error}.") from error
    arrays: list[Any] = []
    offset = 0
    for one in header.fields:
        numbers = header.points * one.count
        array = np.frombuffer(plain, one.dtype, numbers, offset)
        offset += array.nbytes
        arrays.append(None if one.is_padding else array if one.count == 1 else array.reshape(-1, one.count))
    return tuple(arrays)


def _viewpoint(raw: bytes, source: Path) -> tuple[float, ...] | None:
    """Place and quaternion of a sensor that is not in the origin of the points; ``None`` for one that is."""
    lines = [line.split(b"#", 1)[0].split() for line in raw.splitlines()]
    words = next((line[1:] for line in lines if line[:1] and line[0].upper() == b"VIEWPOINT"), [])
    if not words:
        return None
    try:
        numbers = tuple(float(word) for word in words)
    except ValueError:
        numbers = ()
    if len(numbers) != 7 or not all(math.isfinite(number) for number in numbers):
        raise TorchweatherError(
            f"{source}: expected VIEWPOINT x y z w x y z, a place in metres and a quaternion; got "
            f"{b' '.join(words[:12]).decode('latin-1')!r}. Of a sensor in the origin it is {_VIEWPOINT!r}."
        )
    *place, w, x, y, z = numbers
    if not any((w, x, y, z)):  # some writers leave the quaternion out
        w = 1.0
    return (*place, w, x, y, z) if any(place) or any((x, y, z)) else None


def _header_bytes(header: _Header, layout: PointLayout, path: str | os.PathLike[str]) -> bytes:
    """The header as the file had it, if it still says the truth, else a new one."""
    source, before = Path(path), layout.header
    viewpoint = " ".join(f"{number:.17g}" for number in layout.viewpoint or ()) or _VIEWPOINT
    comments = [b"# .PCD v0.7 - Point Cloud Data file format"]
    if before:
        if _parsed(before, source) == header:
            return before
        lines = before.splitlines()
        comments = [line for line in lines if line.lstrip().startswith(b"#")] or comments
        found = [line.split()[1:] for line in lines if line.split()[:1] == [b"VIEWPOINT"]]
        viewpoint = b" ".join(found[0]).decode("latin-1") if found else viewpoint
    dtypes = [np.dtype(one.dtype) for one in header.fields]
    letters = {"f": "F", "i": "I", "u": "U"}
    for one, dtype in zip(header.fields, dtypes, strict=True):
        if any(mark.isspace() for mark in one.name) or dtype.itemsize not in _SIZES[letters[dtype.kind]]:
            raise TorchweatherError(f"{source}: PCD has no field {one.name!r} of type {dtype.name}.")
    text = "\n".join(
        (
            "VERSION 0.7",
            "FIELDS " + " ".join(one.name for one in header.fields),
            "SIZE " + " ".join(str(dtype.itemsize) for dtype in dtypes),
            "TYPE " + " ".join(letters[dtype.kind] for dtype in dtypes),
            "COUNT " + " ".join(str(one.count) for one in header.fields),
            f"WIDTH {header.width}",
            f"HEIGHT {header.height}",
            f"VIEWPOINT {viewpoint}",
            f"POINTS {header.points}",
            f"DATA {header.data}",
            "",
        )
    )
    return b"\n".join(comments) + b"\n" + text.encode("utf-8", "surrogateescape")
