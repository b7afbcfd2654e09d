"""Point clouds as comma-separated text, with or without a line of names (RADIATE has none)."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from torchweather.core.atomic import atomic_write
from torchweather.core.errors import TorchweatherError
from torchweather.io.number_text import column_text, parse_columns
from torchweather.io.stored_points import PointField, PointLayout, StoredPoints

__all__ = ["CSV_COLUMNS", "read_csv_points", "write_csv_points"]

# RADIATE's columns; a file without names is taken to have these.
CSV_COLUMNS = ("x", "y", "z", "intensity", "ring")
_LINE_ENDS = {"lf": "\n", "crlf": "\r\n"}
_MOST_COLUMNS = 1000  # each is looked at by itself


def read_csv_points(path: str | os.PathLike[str]) -> StoredPoints:
    """The columns of a table of numbers.

    Without a line of names the columns are `CSV_COLUMNS`, then ``column_5`` and so on. A text has no dtype: a column
    is float32 where its decimals can be told from float32 numbers (six digits always can), else float64.

    Raises:
        TorchweatherError: empty without a line of names, not numbers, or rows of different length.
    """
    source = Path(path)
    try:
        with source.open(encoding="utf-8", newline="") as file:
            text = file.read()
    except (OSError, UnicodeDecodeError) as error:
        raise TorchweatherError(f"{source}: cannot be read ({error}).") from error
    encoding = "crlf" if "\r\n" in text else "lf"
    lines = text.removeprefix("\ufeff").split("\n")
    first = [word.strip() for word in lines[0].split(",")]
    if len(first) > _MOST_COLUMNS:
        raise TorchweatherError(
            f"{source}: expected a point a line, {_MOST_COLUMNS} columns at most; got {len(first):,} columns. Is it "
            "a table of something else?"
        )
    named = not all(_is_number(word) for word in first) and any(first)
    if not named and not text.strip():
        raise TorchweatherError(
            f"{source}: expected rows of numbers x, y, z, intensity; the file is empty. An empty cloud needs a line of "
            "names."
        )
    names = [word.strip("\"'") for word in first] if named else list(_default_names(len(first)))
    if not all(names):
        raise TorchweatherError(f"{source}: expected a name for each column; got {lines[0].strip()!r}.")
    header = lines[0].rstrip("\r").encode("utf-8") if named else b""
    columns = parse_columns(
        lines[1:] if named else lines,
        [np.dtype(np.float64)] * len(names),
        None,
        source=source,
        first_line=2 if named else 1,
        delimiter=",",
    )
    kept = [_narrow(column) for column in columns]
    fields = tuple(PointField(name, column.dtype.str) for name, column in zip(names, kept, strict=True))
    return StoredPoints(PointLayout("csv", fields, encoding, header), tuple(kept))


def write_csv_points(path: str | os.PathLike[str], stored: StoredPoints) -> None:
    """Write the fields as a table: with names, unless they are the first of `CSV_COLUMNS` and the file had none.

    Raises:
        TorchweatherError: an empty cloud without a line of names, which could not be told from a broken file.
    """
    names = tuple(one.name for one in stored.layout.fields)
    header = ",".join(names)
    before = stored.layout.header.decode("utf-8")
    if before and [word.strip().strip("\"'") for word in before.split(",")] == list(names):
        header = before
    bare = not before and bool(stored.layout.encoding) and names == _default_names(len(names))
    if bare and not stored.rows:
        raise TorchweatherError(f"{path}: a csv without a line of names cannot hold an empty cloud.")
    if any("," in name or "\n" in name or _is_number(name) for name in names):
        raise TorchweatherError(f"{path}: csv cannot hold columns named {', '.join(names)}.")
    end = _LINE_ENDS[stored.layout.encoding or "lf"]
    columns = [column_text(np.asarray(array)) for array in stored.arrays]
    with atomic_write(path) as unfinished, unfinished.open("w", encoding="utf-8", newline="") as file:
        if not bare:
            file.write(header + end)
        file.write("".join(",".join(row) + end for row in zip(*columns, strict=True)))


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True


def _default_names(count: int) -> tuple[str, ...]:
    return tuple(CSV_COLUMNS[k] if k < len(CSV_COLUMNS) else f"column_{k}" for k in range(count))


def _narrow(column: npt.NDArray[np.float64]) -> npt.NDArray[Any]:
    """Float32 where the file's decimals can be told from it, else as it is."""
    with np.errstate(over="ignore"):
        narrow = column.astype(np.float32)
    rest = np.flatnonzero((narrow != column) & ~np.isnan(column))
    # A column that needs float64 mostly shows it in its first numbers.
    for some in (rest[:1000], rest[1000:]):
        if not bool(_tells(narrow[some], column[some]).all()):
            return column
    return narrow


def _tells(narrow: npt.NDArray[np.float32], numbers: npt.NDArray[np.float64]) -> npt.NDArray[np.bool_]:
    """Where a number has at most nine digits, and its float32 rounded to as many digits is the number.

    Any decimal of six digits passes, and any float32 written in its shortest form: nine digits tell all of them apart.
    """
    magnitude, near = np.abs(numbers), np.abs(narrow.astype(np.float64))
    inside = (magnitude > 1e-37) & (magnitude < 1e38)
    exponent = np.floor(np.log10(np.where(inside, magnitude, 1.0)))
    told = np.zeros(numbers.shape, np.bool_)
    for digits in (6, 7, 8, 9):
        scale = 10.0 ** (digits - 1 - exponent)
        scaled = np.where(inside, magnitude, 1.0) * scale
        whole = np.rint(scaled)
        # The product of a billion at most is rounded by 4e-7; another digit stands at 0.1.
        told |= (np.abs(scaled - whole) < 1e-4) & (np.rint(np.where(inside, near, 1.0) * scale) == whole)
    odd = np.flatnonzero(~inside)  # at the ends of float32's range, where it has fewer digits: compare the text
    texts = np.array([float(text) for text in column_text(narrow[odd])], np.float64)
    told[odd] = texts == numbers[odd]
    return told
