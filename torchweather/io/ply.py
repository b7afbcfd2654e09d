"""PLY, the Stanford polygon format: its vertices as points; ascii and binary of either byte order."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from torchweather.core.atomic import atomic_write
from torchweather.core.errors import InputValueError, TorchweatherError, check_one_of
from torchweather.io.number_text import column_text, parse_columns
from torchweather.io.stored_points import (
    PointField,
    PointLayout,
    StoredPoints,
    check_rows_fit,
    row_dtype,
    unpacked,
)

__all__ = ["PLY_ENCODINGS", "read_ply", "write_ply"]

PLY_ENCODINGS = ("ascii", "binary_little_endian", "binary_big_endian")
_TYPES = {
    "char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4", "float": "f4",
    "double": "f8", "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4",
    "float32": "f4", "float64": "f8",
}  # fmt: skip
_NAMES = {code: name for name, code in reversed(_TYPES.items())}
_MAX_HEADER_BYTES = 1 << 20


@dataclass(frozen=True)
class _Property:
    name: str
    dtype: str
    count_dtype: str = ""  # of a list's length; empty for a single number


@dataclass(frozen=True)
class _Element:
    name: str
    count: int
    properties: tuple[_Property, ...]

    @property
    def fields(self) -> tuple[PointField, ...]:
        """Properties that are single numbers."""
        return tuple(PointField(one.name, one.dtype) for one in self.properties if not one.count_dtype)

    @property
    def smallest_bytes(self) -> int:
        """Bytes of a row whose lists are empty."""
        return sum(np.dtype(one.count_dtype or one.dtype).itemsize for one in self.properties)

    @property
    def has_lists(self) -> bool:
        return any(one.count_dtype for one in self.properties)


@dataclass(frozen=True)
class _Header:
    encoding: str
    elements: tuple[_Element, ...]


def read_ply(path: str | os.PathLike[str]) -> StoredPoints:
    """The numbers of the element ``vertex``; lists in it and other elements are skipped and not kept.

    Raises:
        TorchweatherError: not a PLY file, one that holds less than its header says, or vertices without numbers.

    References:
        G. Turk, The PLY Polygon File Format, 1994.
    """
    source = Path(path)
    try:
        with source.open("rb") as file:
            raw = _raw_header(file, source)
            header = _parsed(raw, source)
            before, vertex = _vertex(header, source)
            if header.encoding == "ascii":
                arrays = _ascii(file.read(), before, vertex, raw, source)
            else:
                for element in before:
                    _skip(file, element, source)
                available = os.fstat(file.fileno()).st_size - file.tell()
                dtype = row_dtype(vertex.fields)
                check_rows_fit(source, vertex.count, vertex.smallest_bytes, available)
                if vertex.has_lists:
                    rows = np.frombuffer(_without_lists(file.read(), vertex, source), dtype)
                else:
                    rows = np.fromfile(file, dtype, vertex.count)
                arrays = unpacked(rows, vertex.fields)
    except OSError as error:
        raise TorchweatherError(f"{source}: cannot be read ({error}).") from error
    return StoredPoints(PointLayout("ply", vertex.fields, header.encoding, raw), arrays)


def write_ply(path: str | os.PathLike[str], stored: StoredPoints) -> None:
    """Write the fields as the properties of the element ``vertex``, the only one, in the layout's encoding.

    Raises:
        ValueError: the encoding is none of `PLY_ENCODINGS`.
        TorchweatherError: a field that PLY has no type for.
    """
    encoding = stored.layout.encoding
    check_one_of("encoding", encoding, PLY_ENCODINGS, owner="write_ply")
    order = ">" if encoding == "binary_big_endian" else "<"
    properties = []
    for one in stored.layout.fields:
        code = np.dtype(one.dtype).str[1:]
        if code not in _NAMES or one.count != 1 or any(mark.isspace() for mark in one.name):
            raise TorchweatherError(
                f"{path}: PLY has no property {one.name!r} of {one.count} x {np.dtype(one.dtype).name}."
            )
        properties.append(_Property(one.name, np.dtype(order + code).str))
    vertex = _Element("vertex", stored.rows, tuple(properties))
    raw = _header_bytes(_Header(encoding, (vertex,)), stored.layout.header, Path(path))
    with atomic_write(path) as unfinished, unfinished.open("wb") as file:
        file.write(raw)
        if encoding == "ascii":
            columns = [column_text(array) for array in stored.arrays if array is not None]
            file.write("".join(" ".join(row) + "\n" for row in zip(*columns, strict=True)).encode("ascii"))
        else:
            rows = np.zeros(stored.rows, row_dtype(vertex.fields))
            for number, array in enumerate(stored.arrays):
                rows[f"f{number}"] = array
            rows.tofile(file)


def _raw_header(file: Any, source: Path) -> bytes:
    lines = [file.readline(_MAX_HEADER_BYTES)]
    size = len(lines[0])
    if lines[0].strip() == b"ply":
        while size < _MAX_HEADER_BYTES and lines[-1]:
            lines.append(file.readline(_MAX_HEADER_BYTES))
            size += len(lines[-1])
            if lines[-1].strip() == b"end_header":
                return b"".join(lines)
    raise TorchweatherError(f"{source}: expected a PLY header, from a line ply to a line end_header; there is none.")


def _parsed(raw: bytes, source: Path) -> _Header:
    encoding = ""
    elements: list[_Element] = []
    for line in raw.decode("utf-8", "surrogateescape").split("\n"):
        words = line.split()
        try:
            match words:
                case ["format", name, _]:
                    encoding = name
                case ["element", name, count]:
                    elements.append(_Element(name, int(count), ()))
                case ["property", "list", count_type, item_type, name]:
                    if _TYPES[count_type][0] == "f":
                        raise InputValueError("the length of a list is a whole number")
                    more = _Property(name, _ordered(item_type, encoding), _ordered(count_type, encoding))
                    elements[-1] = _with(elements[-1], more)
                case ["property", item_type, name]:
                    elements[-1] = _with(elements[-1], _Property(name, _ordered(item_type, encoding)))
                case [] | ["ply"] | ["comment", *_] | ["obj_info", *_] | ["end_header"]:
                    pass
                case _:
                    raise InputValueError("no such line in PLY")
        except (KeyError, IndexError, ValueError) as error:
            raise TorchweatherError(
                f"{source}: expected lines format, element, property, comment in the PLY header; got {line.strip()!r} "
                f"({type(error).__name__}: {error})."
            ) from error
    if encoding not in PLY_ENCODINGS:
        raise TorchweatherError(f"{source}: expected format {', '.join(PLY_ENCODINGS)}; got {encoding!r}.")
    return _Header(encoding, tuple(elements))


def _with(element: _Element, more: _Property) -> _Element:
    return _Element(element.name, element.count, (*element.properties, more))


def _ordered(type_name: str, encoding: str) -> str:
    return np.dtype((">" if encoding == "binary_big_endian" else "<") + _TYPES[type_name]).str


def _vertex(header: _Header, source: Path) -> tuple[tuple[_Element, ...], _Element]:
    names = [element.name for element in header.elements]
    if "vertex" not in names:
        raise TorchweatherError(f"{source}: expected an element vertex; got {', '.join(names) or 'no element'}.")
    index = names.index("vertex")
    vertex = header.elements[index]
    if not vertex.fields:
        raise TorchweatherError(f"{source}: expected vertices with single numbers; got lists or no property.")
    if min(element.count for element in header.elements[: index + 1]) < 0:
        raise TorchweatherError(f"{source}: expected counts of 0 or more in the PLY header; got a negative one.")
    return header.elements[:index], vertex


def _skip(file: Any, element: _Element, source: Path) -> None:
    """Step over an element that stands before the vertices."""
    end = os.fstat(file.fileno()).st_size
    # Refused before a walk of hours; an element without properties takes no room and no time.
    smallest = element.smallest_bytes
    check_rows_fit(source, element.count, smallest, end - file.tell(), f"rows of {element.name}")
    if not element.has_lists:
        file.seek(element.count * smallest, os.SEEK_CUR)
    else:
        for _ in range(element.count):
            for one in element.properties:
                count = 1
                if one.count_dtype:
                    length = np.dtype(one.count_dtype)
                    stored = file.read(length.itemsize)
                    if len(stored) < length.itemsize:
                        break
                    count = max(int(np.frombuffer(stored, length)[0]), 0)
                    if file.tell() > end:
                        break
                file.seek(count * np.dtype(one.dtype).itemsize, os.SEEK_CUR)
    if file.tell() > end:
        raise TorchweatherError(
            f"{source}: expected {element.count} rows of {element.name}; the file ends within them."
        )


def _ascii(body: bytes, before: tuple[_Element, ...], vertex: _Element, raw: bytes, source: Path) -> tuple[Any, ...]:
    columns = len(vertex.properties)
    skipped = sum(element.count for element in before)
    check_rows_fit(source, vertex.count, 2 * columns, len(body) + 1)
    lines = [line for line in body.decode("latin-1").split("\n") if line and not line.isspace()]
    first_line = raw.count(b"\n") + 1 + skipped
    mine = lines[skipped : skipped + vertex.count]
    if vertex.has_lists:
        mine = [_numbers_of(line.split(), vertex, source, first_line + k) for k, line in enumerate(mine)]
    found = parse_columns(
        mine,
        [np.dtype(one.dtype) for one in vertex.fields],
        vertex.count,
        source=source,
        first_line=first_line,
    )
    return tuple(found)


def _numbers_of(words: list[str], vertex: _Element, source: Path, line: int) -> str:
    """A row of text without its lists."""
    kept: list[str] = []
    place = 0
    for one in vertex.properties:
        if not one.count_dtype:
            kept.append(words[place] if place < len(words) else "")
            place += 1
            continue
        length = words[place] if place < len(words) else ""
        if not length.isdecimal():
            raise TorchweatherError(
                f"{source}: line {line}: expected the length of the list {one.name!r}, 0 or more; got {length!r}."
            )
        place += 1 + int(length)
    if place != len(words):
        raise TorchweatherError(f"{source}: line {line}: expected {place} numbers in a vertex; got {len(words)}.")
    return " ".join(kept)


def _without_lists(body: bytes, vertex: _Element, source: Path) -> bytes:
    """Rows of single numbers, packed, from rows with lists between them."""
    even = _rows_of_one_length(body, vertex)
    if even is not None:
        return even
    kept: list[bytes] = []
    place = 0
    sizes = [
        (np.dtype(one.dtype).itemsize, np.dtype(one.count_dtype) if one.count_dtype else None)
        for one in vertex.properties
    ]
    for _ in range(vertex.count):
        for size, length_dtype in sizes:
            if length_dtype is None:
                kept.append(body[place : place + size])
                place += size
            elif place + length_dtype.itemsize <= len(body):
                length = int(np.frombuffer(body, length_dtype, 1, place)[0])
                if length < 0:
                    raise TorchweatherError(f"{source}: expected lists of 0 or more numbers in a vertex; got {length}.")
                place += length_dtype.itemsize + length * size
            else:
                place = len(body) + 1
        if place > len(body):
            raise TorchweatherError(
                f"{source}: expected {vertex.count} vertices, the count in its header; the file ends within them."
            )
    return b"".join(kept)


def _rows_of_one_length(body: bytes, vertex: _Element) -> bytes | None:
    """The same where the lists of all vertices are as long as those of the first, which is usual; else ``None``."""
    parts: list[tuple[str, Any] | tuple[str, Any, tuple[int]]] = []
    place = 0
    for number, one in enumerate(vertex.properties):
        dtype = np.dtype(one.dtype)
        if not one.count_dtype:
            parts.append((f"f{number}", dtype))
            place += dtype.itemsize
            continue
        length_dtype = np.dtype(one.count_dtype)
        if place + length_dtype.itemsize > len(body):
            return None
        length = int(np.frombuffer(body, length_dtype, 1, place)[0])
        place += length_dtype.itemsize + max(length, 0) * dtype.itemsize
        if length < 0 or place > len(body):
            return None
        parts += [(f"n{number}", length_dtype), (f"l{number}", dtype, (length,))]
    if vertex.count * place > len(body):
        return None
    rows = np.frombuffer(body, np.dtype(parts), vertex.count)
    lists = [number for number, one in enumerate(vertex.properties) if one.count_dtype]
    if any(bool((rows[f"n{number}"] != rows[f"l{number}"].shape[1]).any()) for number in lists):
        return None
    kept = np.zeros(vertex.count, row_dtype(vertex.fields))
    numbers = [number for number, one in enumerate(vertex.properties) if not one.count_dtype]
    for place, number in enumerate(numbers):
        kept[f"f{place}"] = rows[f"f{number}"]
    return kept.tobytes()


def _header_bytes(header: _Header, before: bytes, source: Path) -> bytes:
    """The header as the file had it, if it still says the truth, else a new one with its comments."""
    comments: list[bytes] = []
    if before:
        if _parsed(before, source) == header:
            return before
        comments = [line.rstrip() for line in before.split(b"\n") if line.startswith((b"comment", b"obj_info"))]
    (vertex,) = header.elements
    lines = ["ply", f"format {header.encoding} 1.0", *(line.decode("utf-8", "surrogateescape") for line in comments)]
    lines.append(f"element vertex {vertex.count}")
    lines += [f"property {_NAMES[np.dtype(one.dtype).str[1:]]} {one.name}" for one in vertex.properties]
    lines += ["end_header", ""]
    return "\n".join(lines).encode("utf-8", "surrogateescape")
