"""Text tables: names or none, line ends, digits kept, and rows that do not fit."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from torchweather.core.errors import TorchweatherError
from torchweather.io.number_text import column_text
from torchweather.io.points import read_points, write_points


def test_a_table_without_names_has_radiates_columns(tmp_path: Path) -> None:
    text = "-0.45903,-0.28572,-0.075989,0,17\n-0.4958,-0.30861,0,4,23\n"
    (tmp_path / "a.csv").write_text(text)
    found = read_points(tmp_path / "a.csv")
    assert found.columns == ("x", "y", "z", "intensity", "ring")
    assert found.points.dtype == torch.float32
    assert torch.equal(found.points[0], torch.tensor([-0.45903, -0.28572, -0.075989, 0, 17]))
    write_points(tmp_path / "b.csv", found)
    assert (tmp_path / "b.csv").read_text() == text


@pytest.mark.parametrize("end", ["\n", "\r\n"])
def test_names_and_line_ends_are_kept(tmp_path: Path, end: str) -> None:
    text = end.join(('stamp, "x",y,z,i', "1574859771.700975,1.5,2,3,0.25", "1574859771.801053,nan,nan,nan,0", ""))
    (tmp_path / "a.csv").write_text(text, newline="")
    found = read_points(tmp_path / "a.csv")
    assert found.columns == ("x", "y", "z", "i", "stamp")
    assert found.points.dtype == torch.float64
    assert found.column("stamp").tolist() == [1574859771.700975, 1574859771.801053]
    assert found.nan_rows == 1
    write_points(tmp_path / "b.csv", found)
    with (tmp_path / "b.csv").open(newline="") as file:
        assert file.read() == text


def test_any_float32_keeps_its_bits_through_text(tmp_path: Path) -> None:
    bits = np.random.default_rng(0).integers(0, 2**32, (1000, 4), dtype=np.uint32)
    points = torch.from_numpy(bits.view(np.float32)[np.isfinite(bits.view(np.float32)).all(axis=1)])
    write_points(tmp_path / "a.csv", points)
    found = read_points(tmp_path / "a.csv")
    assert found.points.dtype == torch.float32
    assert torch.equal(found.points.view(torch.int32), points.view(torch.int32))


def test_any_float64_keeps_its_bits_through_text(tmp_path: Path) -> None:
    numbers = np.random.default_rng(0).standard_normal((300, 4)) * 10.0 ** np.arange(-9, 3, 3)
    write_points(tmp_path / "a.csv", torch.from_numpy(numbers))
    assert torch.equal(read_points(tmp_path / "a.csv").points, torch.from_numpy(numbers))


def test_shortest_text() -> None:
    numbers = np.array([0, -0.0, 1e-10, 16777216, 0.1, 1 / 3, np.inf], np.float32)
    assert column_text(numbers) == ["0", "-0", "1e-10", "16777216", "0.1", "0.33333334", "inf"]
    assert column_text(np.array([2**64 - 1], np.uint64)) == ["18446744073709551615"]
    assert column_text(np.zeros(0)) == []


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("1,2,3,4\n1,2,3\n", "rows of 4 numbers"),
        ("x,y,z,i\n1,2,3,4,5\n", "rows of 4 numbers from line 2 on; got 5"),
        ("x,y,z,i\n1,2,three,4\n", "three"),
        ("1,2,3\n", "expected an intensity.*got x, y, z"),
        ("x,y,,i\n", "a name for each column"),
        ("1;2;3;4\n", "expected columns x, y, z"),
        (" \n", "empty"),
    ],
)
def test_broken_tables_are_refused(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "a.csv").write_text(text)
    with pytest.raises(TorchweatherError, match=rf"a\.csv: .*{message}"):
        read_points(tmp_path / "a.csv")


def test_what_is_no_text_is_refused(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(TorchweatherError, match=r"a\.csv: cannot be read"):
        read_points(tmp_path / "a.csv")
    with pytest.raises(TorchweatherError, match="csv cannot hold columns named"):
        write_points(tmp_path / "a.csv", torch.zeros(1, 4), columns=("x", "y", "z", "a,b"))
