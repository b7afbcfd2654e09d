"""Tables of named columns in CSV and Parquet files."""

from __future__ import annotations

import csv
import numbers
import os
import re
from collections.abc import Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

from torchweather.core.arguments import check_arguments
from torchweather.core.atomic import atomic_write
from torchweather.core.errors import InputTypeError, InputValueError, TorchweatherError, nearest_name
from torchweather.core.extras import install_hint

__all__ = ["TABLE_SUFFIXES", "read_table", "text_cell", "write_table"]

TABLE_SUFFIXES = (".csv", ".parquet")

Columns = dict[str, list[Any]]

_FORMULA = tuple("=+-@\t\r")

# Whole numbers without leading zeros: "007" is a name, not seven.
_WHOLE = re.compile(r"[+-]?(0|[1-9]\d*)", re.ASCII)
_NUMBER = re.compile(r"[+-]?((0|[1-9]\d*)(\.\d*)?|\.\d+)([eE][+-]?\d+)?|[+-]?inf(inity)?|nan", re.ASCII | re.IGNORECASE)


def read_table(path: str | os.PathLike[str]) -> Columns:
    """Columns of a table by their names.

    Args:
        path: ``.csv`` (a line of names, commas, UTF-8) or ``.parquet`` (needs the extra ``tables``).

    Returns:
        One list a column, in the order of the file, all of one length. CSV: a column is of ``int`` where all its cells
        are whole numbers, of ``float`` where all are numbers (``inf`` and ``nan`` are), else of ``str``; an empty cell
        is None. Parquet: the values as they were stored.

    Note:
        ``007`` is text: names of frames keep their zeros.

    Example:
        >>> import tempfile
        >>> file = Path(tempfile.mkdtemp()) / "scores.csv"
        >>> write_table(file, {"metric": ["psnr", "ssim"], "seed": [1, 2], "score": [float("inf"), 0.5]})
        >>> read_table(file)
        {'metric': ['psnr', 'ssim'], 'seed': [1, 2], 'score': [inf, 0.5]}
    """
    check_arguments("read_table(path: path)", path)
    source = Path(path)
    return _read_parquet(source) if _suffix(source) == ".parquet" else _read_csv(source)


def write_table(path: str | os.PathLike[str], columns: Mapping[str, Sequence[Any]]) -> None:
    """A table written whole or not at all.

    Args:
        path: ``.csv`` or ``.parquet`` (needs the extra ``tables``).
        columns: by name, all of one length; each holds numbers or text, and None where a cell is empty. Numbers of a
            CSV are the shortest text that reads back as the same ``float``.

    Note:
        A spreadsheet takes text that begins with ``= + - @`` for a formula: a CSV holds it behind an apostrophe, which
        ``read_table`` takes away. CSV has no types: text that looks like numbers throughout a column is read back as
        numbers, an empty text as None.
    """
    check_arguments("write_table(path: path, columns: Mapping)", path, columns)
    target = Path(path)
    suffix = _suffix(target)
    plain = {name: _plain(name, column) for name, column in columns.items()}
    _check_columns(plain, str(target))
    for text in (cell for column in ([*plain], *plain.values()) for cell in column if isinstance(cell, str)):
        _check_writable(text, target)
    if suffix == ".parquet":
        pyarrow, parquet = _pyarrow()
        with atomic_write(target) as unfinished:
            parquet.write_table(pyarrow.table(plain), unfinished)
        return
    with atomic_write(target) as unfinished, unfinished.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow([text_cell(name) for name in plain])
        writer.writerows([text_cell(cell) for cell in row] for row in zip(*plain.values(), strict=True))


def _check_writable(text: str, target: Path) -> None:
    """Refuse text that is no Unicode, such as half a character of a damaged name."""
    try:
        text.encode("utf-8")
    except UnicodeEncodeError as error:
        raise InputValueError(f"{target}: expected text that is Unicode; got {text!r:.100}.") from error


def text_cell(cell: Any) -> Any:
    """A cell that no spreadsheet takes for a formula; numbers stay as they are.

    Example:
        >>> text_cell("=cmd()"), text_cell("'=a"), text_cell("a=b"), text_cell(-1.5)
        ("'=cmd()", "''=a", 'a=b', -1.5)
    """
    return f"'{cell}" if isinstance(cell, str) and _begins_formula(cell) else cell


def _without_mark(cell: str) -> str:
    """The text that `text_cell` was given."""
    return cell[1:] if cell.startswith("'") and _begins_formula(cell) else cell


def _begins_formula(text: str) -> bool:
    return text.lstrip("'")[:1] in _FORMULA


def _suffix(path: Path) -> str:
    suffix = path.suffix.lower()
    if suffix not in TABLE_SUFFIXES:
        hint = nearest_name(suffix, TABLE_SUFFIXES)
        raise TorchweatherError(f"{path}: expected a table as {' or '.join(TABLE_SUFFIXES)}; got {suffix!r}.{hint}")
    return suffix


# ---- CSV -----------------------------------------------------------------------------------------------------------


def _read_csv(source: Path) -> Columns:
    try:
        with source.open(encoding="utf-8-sig", newline="") as file:
            reader = csv.reader(file, strict=True)
            rows = [(reader.line_num, row) for row in reader if row]
    except FileNotFoundError as error:
        raise TorchweatherError(f"{source}: no such file.") from error
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise TorchweatherError(
            f"{source}: expected text in UTF-8 with commas between cells; it cannot be read ({error})."
        ) from error
    if not rows:
        raise TorchweatherError(f"{source}: expected a line of column names and lines of values; the file is empty.")
    names = [_without_mark(name.strip()) for name in rows[0][1]]
    _check_names(names, str(source))
    for line, row in rows[1:]:
        if len(row) != len(names):
            raise TorchweatherError(
                f"{source}: line {line}: expected {len(names)} cells ({', '.join(names)}); got {len(row)}."
            )
    cells = zip(*(row for _, row in rows[1:]), strict=True) if len(rows) > 1 else ((),) * len(names)
    return {name: _typed([cell.strip() for cell in column]) for name, column in zip(names, cells, strict=True)}


def _typed(cells: list[str]) -> list[Any]:
    """Cells as numbers where all that are filled are numbers, else as text; None where empty."""
    filled = [cell for cell in cells if cell]
    kind: type = str
    if filled and all(_WHOLE.fullmatch(cell) for cell in filled):
        kind = int
    elif filled and all(_NUMBER.fullmatch(cell) for cell in filled):
        kind = float
    if kind is str:
        return [_without_mark(cell) if cell else None for cell in cells]
    return [kind(cell) if cell else None for cell in cells]


# ---- Parquet -------------------------------------------------------------------------------------------------------


def _pyarrow() -> tuple[Any, Any]:
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError as error:
        raise TorchweatherError(f"Parquet files need pyarrow, or use a .csv file. {install_hint('tables')}") from error
    return pyarrow, pyarrow.parquet


def _read_parquet(source: Path) -> Columns:
    pyarrow, parquet = _pyarrow()
    try:
        with source.open("rb") as file:
            table = parquet.ParquetFile(file).read()
    except FileNotFoundError as error:
        raise TorchweatherError(f"{source}: no such file.") from error
    except (OSError, pyarrow.ArrowException) as error:
        raise TorchweatherError(f"{source}: expected a Parquet file; it cannot be read ({error}).") from error
    _check_names(table.column_names, str(source))
    return {name: table.column(name).to_pylist() for name in table.column_names}


# ---- columns -------------------------------------------------------------------------------------------------------


def _plain(name: str, column: Sequence[Any]) -> list[Any]:
    """Values as Python's own numbers and text; numbers and text do not share a column."""
    if isinstance(column, str) or not hasattr(column, "__iter__"):
        raise InputTypeError(f"write_table: column {name} must be a sequence of values; got {column!r:.100}.")
    values = [_plain_value(name, value) for value in column]
    if len({isinstance(value, str) for value in values if value is not None}) > 1:
        raise InputValueError(f"write_table: column {name} must hold numbers or text, not both.")
    if any(isinstance(value, float) for value in values):
        return [float(value) if isinstance(value, int) else value for value in values]
    return values


def _plain_value(name: str, value: Any) -> Any:
    if value is None or isinstance(value, str):
        return value
    if not isinstance(value, bool):
        if isinstance(value, numbers.Integral):
            return int(value)
        if isinstance(value, numbers.Real):
            return float(value)
    raise InputValueError(
        f"write_table: column {name} must hold numbers, text or None; got {value!r} ({type(value).__name__})."
    )


def _check_columns(columns: Mapping[str, Sequence[Any]], where: str) -> None:
    _check_names(list(columns), where)
    for (first, one), (second, other) in pairwise(columns.items()):
        if len(one) != len(other):
            raise InputValueError(
                f"write_table: columns must be of one length; {first} has {len(one)} values, {second} {len(other)}."
            )


def _check_names(names: Sequence[str], where: str) -> None:
    """Every column has a name of its own."""
    if not names or not all(names):
        raise TorchweatherError(
            f"{where}: every column needs a name; got {', '.join(map(repr, names)) or 'no columns'}."
        )
    twice = sorted({name for name in names if list(names).count(name) > 1})
    if twice:
        raise TorchweatherError(f"{where}: every column needs a name of its own; {', '.join(twice)} stands twice.")
    if len(names) == 1 and any(mark in names[0] for mark in ";\t"):
        raise TorchweatherError(f"{where}: expected commas between cells; got one column {names[0]!r}.")
