"""Tables go out and come back; files that are none are refused by name."""

from __future__ import annotations

import math
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from torchweather.core.errors import TorchweatherError
from torchweather.io import TABLE_SUFFIXES, read_table, write_table

TABLE: dict[str, list[Any]] = {
    "subject": ["000123", "a, b", 'quoted "x"', "Nürburg\nring"],
    "value": [1, 2, 3, -40],
    "score": [0.1, math.inf, -math.inf, 1e-300],
    "performance": [0.5, None, 1.0, 1 / 3],
}


@pytest.mark.parametrize("suffix", TABLE_SUFFIXES)
def test_a_table_comes_back_as_it_was(suffix: str, tmp_path: Path) -> None:
    file = tmp_path / f"table{suffix}"
    write_table(file, TABLE)
    back = read_table(file)
    assert back == TABLE
    assert list(back) == list(TABLE)
    for name, column in back.items():
        assert [type(value) for value in column] == [type(value) for value in TABLE[name]]
    assert [path.name for path in tmp_path.iterdir()] == [file.name]


@pytest.mark.parametrize("suffix", TABLE_SUFFIXES)
def test_numpy_numbers_and_nan_are_written(suffix: str, tmp_path: Path) -> None:
    file = tmp_path / f"table{suffix}"
    write_table(file, {"rate": np.array([1.5, np.nan]), "seed": np.arange(2), "mixed": [1, 2.5]})
    back = read_table(file)
    assert back["rate"][0] == 1.5
    assert math.isnan(back["rate"][1])
    assert back["seed"] == [0, 1]
    assert back["mixed"] == [1.0, 2.5]


@pytest.mark.parametrize("suffix", TABLE_SUFFIXES)
def test_a_table_without_rows_keeps_its_columns(suffix: str, tmp_path: Path) -> None:
    file = tmp_path / f"table{suffix}"
    write_table(file, {"metric": [], "score": []})
    assert read_table(file) == {"metric": [], "score": []}


@pytest.mark.parametrize(
    ("cells", "values"),
    [
        (["1", "-2", "0"], [1, -2, 0]),
        (["1", "2.5", "-.5e3"], [1.0, 2.5, -500.0]),
        (["1", "inf"], [1.0, math.inf]),
        (["1", "", "-Infinity"], [1.0, None, -math.inf]),
        (["7", "007"], ["7", "007"]),
        (["1", "rain"], ["1", "rain"]),
        (["1_000", "2"], ["1_000", "2"]),
        (["0x10"], ["0x10"]),
        ([" 3 ", "4"], [3, 4]),
        (["١"], ["١"]),
        (["", ""], [None, None]),
    ],
)
def test_a_column_is_of_numbers_where_all_its_cells_are(cells: list[str], values: list[Any], tmp_path: Path) -> None:
    file = tmp_path / "table.csv"
    file.write_text("x,y\n" + "".join(f"{cell},z\n" for cell in cells), encoding="utf-8")
    found = read_table(file)["x"]
    assert found == values
    assert [type(value) for value in found] == [type(value) for value in values]


def test_spreadsheets_mark_and_line_ends_are_read(tmp_path: Path) -> None:
    file = tmp_path / "table.csv"
    file.write_bytes("\ufeffvalue,score\r\n1,2\r\n\r\n".encode())
    assert read_table(file) == {"value": [1], "score": [2]}


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"", "the file is empty"),
        (b"\n\n", "the file is empty"),
        (b"a,b\n1,2\n3\n", r"line 3: expected 2 cells \(a, b\); got 1"),
        (b"a,b\n1,2,3\n", "line 2: expected 2 cells"),
        (b"a,a\n1,2\n", "a stands twice"),
        (b"a,\n1,2\n", "every column needs a name"),
        (b"a;b\n1;2\n", "expected commas"),
        (b"a\tb\n1\t2\n", "expected commas"),
        ("a,b\n1,2\n".encode("utf-16"), "UTF-8"),
        (b'a,b\n"1,2\n', "cannot be read"),
    ],
)
def test_what_is_no_csv_table_is_refused(content: bytes, said: str, tmp_path: Path) -> None:
    file = tmp_path / "broken.csv"
    file.write_bytes(content)
    with pytest.raises(TorchweatherError, match=f"broken.csv: .*{said}"):
        read_table(file)


def test_what_is_no_parquet_file_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "whole.parquet"
    write_table(file, TABLE)
    whole = file.read_bytes()
    for content in (b"", b"PAR1", b"a,b\n1,2\n", whole[: len(whole) // 2], whole[8:]):
        broken = tmp_path / "broken.parquet"
        broken.write_bytes(content)
        with pytest.raises(TorchweatherError, match=r"broken\.parquet: expected a Parquet file"):
            read_table(broken)


def test_missing_files_and_other_suffixes_are_refused(tmp_path: Path) -> None:
    for suffix in TABLE_SUFFIXES:
        with pytest.raises(TorchweatherError, match="no such file"):
            read_table(tmp_path / f"none{suffix}")
    with pytest.raises(TorchweatherError, match=r"got '\.xlsx'"):
        read_table(tmp_path / "table.xlsx")
    with pytest.raises(TorchweatherError, match=r"Did you mean '\.parquet'"):
        write_table(tmp_path / "table.parqet", TABLE)


@pytest.mark.parametrize(
    ("columns", "said"),
    [
        ({"a": [1, 2], "b": [1]}, "a has 2 values, b 1"),
        ({"a": [1, "x"]}, "numbers or text, not both"),
        ({"a": [True]}, "must hold numbers, text or None"),
        ({"a": [[1]]}, "must hold numbers, text or None"),
        ({}, "no columns"),
    ],
)
def test_what_is_no_table_is_not_written(columns: dict[str, list[Any]], said: str, tmp_path: Path) -> None:
    with pytest.raises((ValueError, TorchweatherError), match=said):
        write_table(tmp_path / "table.csv", columns)
    assert not list(tmp_path.iterdir())


def test_without_pyarrow_the_extra_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    for use in (lambda: read_table(tmp_path / "a.parquet"), lambda: write_table(tmp_path / "a.parquet", TABLE)):
        with pytest.raises(TorchweatherError, match=r"torchweather\[tables\]"):
            use()
    write_table(tmp_path / "a.csv", TABLE)
    assert read_table(tmp_path / "a.csv") == TABLE


def test_a_name_is_no_formula_in_a_spreadsheet(tmp_path: Path) -> None:
    names = ["=HYPERLINK(1)", "+1+1", "-2+3", "@SUM(A1)", "'=a", "''-b", "'quoted'", "plain", "a=b"]
    columns = {"=frame": names, "score": [-1.5] * len(names)}
    write_table(tmp_path / "t.csv", columns)
    lines = (tmp_path / "t.csv").read_text().splitlines()
    assert not [cell for line in lines for cell in line.split(",")[:1] if cell.lstrip('"')[:1] in "=+-@"]
    assert lines[1].endswith(",-1.5")
    assert read_table(tmp_path / "t.csv") == columns
