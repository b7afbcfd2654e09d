"""Numbers to text and back: tables of decimal numbers in point files, without losing bits."""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from torchweather.core.errors import InputValueError, TorchweatherError

__all__ = ["column_text", "parse_columns"]


def column_text(column: npt.NDArray[Any]) -> list[str]:
    """The shortest decimal text of every number that reads back as the same bits.

    Args:
        column: ``(N,)``, integers or floating point.

    Example:
        >>> column_text(np.array([0.1, 3.0, -1e-7, np.nan], np.float32))
        ['0.1', '3', '-1e-07', 'nan']
    """
    if column.dtype.kind in "iu":
        return [str(number) for number in column.tolist()]
    # Six digits suffice for most numbers that came out of a text, nine for every float32, Python's repr for the rest.
    numbers = column.tolist()
    texts = _with_digits(numbers, 6)
    wrong = _misread(texts, column)
    for digits in (7, 8, 9) if column.dtype.itemsize <= 4 else ():
        some = column[wrong]
        longer = _with_digits(some.tolist(), digits)
        for index, text in zip(wrong.tolist(), longer, strict=True):
            texts[index] = text
        wrong = wrong[_misread(longer, some)]
    for index in wrong.tolist():
        texts[index] = repr(numbers[index]).removesuffix(".0")
    return texts


def _with_digits(numbers: list[float], digits: int) -> list[str]:
    return (f"%.{digits}g\n" * len(numbers) % tuple(numbers)).split("\n")[:-1]


def _misread(texts: list[str], column: npt.NDArray[Any]) -> npt.NDArray[np.int64]:
    """Places where a text reads back as another number."""
    with np.errstate(over="ignore"):
        again = np.fromiter(map(float, texts), np.float64, len(texts)).astype(column.dtype)
    return np.flatnonzero((again != column) & ~np.isnan(column))


def parse_columns(
    lines: Iterable[str],
    dtypes: Sequence[np.dtype[Any]],
    rows: int | None,
    *,
    source: Path,
    first_line: int,
    delimiter: str | None = None,
) -> list[npt.NDArray[Any]]:
    """Columns of a text table, each in its dtype.

    Args:
        lines: the rows; empty lines are skipped.
        dtypes: dtype of every column.
        rows: number of rows wanted; ``None`` takes all there are.
        source: the file, for messages.
        first_line: number of the first of ``lines`` within the file, from 1, for messages.
        delimiter: between numbers; ``None`` is white space.

    Raises:
        TorchweatherError: not numbers, another number of rows or columns, or a number that its dtype cannot hold.
    """
    wanted = [line for line in lines if line and not line.isspace()]
    if rows is not None and len(wanted) != rows:
        raise TorchweatherError(
            f"{source}: expected {rows} rows of numbers, the count in its header; got {len(wanted)}. The file is "
            "truncated or its header is wrong."
        )
    if not wanted:
        return [np.zeros(0, dtype) for dtype in dtypes]
    try:
        table = _loaded(wanted, np.dtype(np.float64), delimiter)
    except ValueError as error:
        raise TorchweatherError(
            f"{source}: expected rows of {len(dtypes)} numbers from line {first_line} on; {error} (rows counted from "
            "there)."
        ) from error
    if table.shape[1] != len(dtypes):
        raise TorchweatherError(
            f"{source}: expected rows of {len(dtypes)} numbers from line {first_line} on; got {table.shape[1]}."
        )
    columns = []
    for index, dtype in enumerate(dtypes):
        column = table[:, index]
        if dtype.kind in "iu":
            columns.append(_integers(wanted, index, column, dtype, delimiter, source))
        else:
            with np.errstate(over="ignore"):
                column = column.astype(dtype)
            columns.append(column)
    return columns


def _loaded(lines: list[str], dtype: np.dtype[Any], delimiter: str | None, only: int | None = None) -> Any:
    with warnings.catch_warnings():
        # numpy tolerates "1.0" for an integer and says so; here it is an error.
        warnings.simplefilter("error")
        try:
            return np.loadtxt(lines, dtype=dtype, comments=None, delimiter=delimiter, ndmin=2, usecols=only)
        except Warning as warning:
            raise InputValueError(str(warning)) from warning


def _integers(
    lines: list[str],
    index: int,
    column: npt.NDArray[np.float64],
    dtype: np.dtype[Any],
    delimiter: str | None,
    source: Path,
) -> npt.NDArray[Any]:
    limits = np.iinfo(dtype)
    try:
        if dtype.itemsize > 4:  # float64 holds 53 bits only
            return np.ascontiguousarray(_loaded(lines, dtype, delimiter, index)[:, 0])
        if bool(((column >= limits.min) & (column <= limits.max) & (column == np.rint(column))).all()):
            return column.astype(dtype)
        reason = "other numbers are there"
    except (ValueError, OverflowError) as error:
        reason = str(error)
    raise TorchweatherError(
        f"{source}: expected whole numbers {limits.min}..{limits.max} ({dtype.name}) in column {index + 1}; {reason}."
    )
