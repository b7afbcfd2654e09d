"""Files of rows without a header: other layouts are refused by name, and read where they are stated."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from tests.recordings import recording
from torchweather.core.errors import InputValueError, TorchweatherError
from torchweather.io import read_points, write_points

ROWS = 240


def sweep(rows: int = ROWS) -> np.ndarray:
    """x, y, z, reflectivity, ring and time of a plain sweep."""
    rng = np.random.default_rng(3)
    angle, range_m, ring = rng.uniform(0, 6.28, rows), rng.uniform(4, 60, rows), np.arange(rows) % 32
    xyz = range_m * np.cos(angle), range_m * np.sin(angle), range_m * np.tan(np.radians(ring - 25.0))
    return np.stack([*xyz, rng.integers(0, 100, rows) / 100, ring, np.linspace(0, 0.1, rows)], axis=1)


def eight(table: np.ndarray) -> np.ndarray:
    return np.concatenate([table, np.ones((len(table), 1)), np.zeros((len(table), 1))], axis=1)


OTHERS = {
    "three": (lambda table: table[:, :3].astype("<f4"), "x,y,z"),
    "five": (lambda table: table[:, :5].astype("<f4"), "x,y,z,intensity,ring"),
    "five, all of them positive": (lambda table: np.abs(table[:, :5]).astype("<f4"), "x,y,z,intensity,ring"),
    "six": (lambda table: table.astype("<f4"), "x,y,z,intensity,ring,time"),
    "seven": (lambda table: eight(table)[:, :7].astype("<f4"), "x,y,z,intensity,ring,time,column_6"),
    "eight": (lambda table: eight(table).astype("<f4"), "x,y,z,intensity,ring,time,column_6,column_7"),
    "float64": (lambda table: table[:, :4].astype("<f8"), "x:float64,y:float64,z:float64,intensity:float64"),
    "float64 of float32": (
        lambda table: table[:, :4].astype("<f4").astype("<f8"),
        "x:float64,y:float64,z:float64,intensity:float64",
    ),
    "float64 of quarters": (
        lambda table: np.rint(4 * table[:, :5]).astype("<f8") / 4,
        "x:float64,y:float64,z:float64,intensity:float64,ring:float64",
    ),
}


@pytest.mark.parametrize("name", OTHERS)
def test_rows_of_another_layout_are_refused_by_name_and_read_as_stated(tmp_path: Path, name: str) -> None:
    make, statement = OTHERS[name]
    table = make(sweep())
    table.tofile(tmp_path / "a.bin")
    assert table.nbytes % 16 == 0
    with pytest.raises(TorchweatherError, match="4 float32 numbers") as refused:
        read_points(tmp_path / "a.bin")
    assert f"bin_columns='{statement}'" in str(refused.value)
    assert f"--bin-columns {statement}" in str(refused.value)
    intensity = "auto" if table.shape[1] > 3 else "none"
    found = read_points(tmp_path / "a.bin", bin_columns=statement, intensity=intensity)
    assert found.columns == tuple(word.partition(":")[0] for word in statement.split(","))
    assert np.array_equal(found.points.numpy(), table)
    write_points(tmp_path / "b.bin", found)
    assert (tmp_path / "b.bin").read_bytes() == table.tobytes()


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (np.full(480, 17, np.uint8), "above 1e"),
        ((np.arange(480) % 32).astype(np.uint8), "above 1e"),
        ((np.arange(480) % 20).astype("<i8"), "above 1e"),
        ((np.arange(480) % 260 + (3 << 16)).astype("<u4"), "above 1e"),
        (np.frombuffer(b"10.0 2.0 -1.5 0.25\n" * 64, np.uint8), "it is text"),
        (np.frombuffer(b"# .PCD v0.7\nVERS" * 8, np.uint8), r"PCD cloud \(format='pcd'\)"),
        (np.frombuffer(b"\x00\x05\x16\x07\x00\x02\x00\x00Mac OS X        " * 4, np.uint8), "AppleDouble"),
        (np.tile(np.array([5.0, 2.0, np.nan, 0.1], "<f4"), 32), "NaN or infinity beside numbers"),
        (np.full(64, np.nan, "<f4"), "no row holds finite"),
        (np.tile(np.array([5.0, 2.0, 1.0, -0.1], "<f4"), 32), "negative intensity"),
    ],
)
def test_content_that_is_no_cloud_is_refused_with_the_evidence(tmp_path: Path, content: np.ndarray, words: str) -> None:
    content.tofile(tmp_path / "a.bin")
    with pytest.raises(TorchweatherError, match=words):
        read_points(tmp_path / "a.bin")


def test_nuscenes_rows_are_checked_too(tmp_path: Path) -> None:
    sweep()[:, :4].astype("<f4").tofile(tmp_path / "a.pcd.bin")
    with pytest.raises(TorchweatherError, match=r"5 float32 numbers.*bin_columns='x,y,z,intensity'"):
        read_points(tmp_path / "a.pcd.bin")


def test_clouds_of_the_format_are_no_suspects(tmp_path: Path) -> None:
    rng = np.random.default_rng(5)
    plain = sweep()[:, :4].astype("<f4")
    clouds = (
        plain,
        plain[rng.permutation(ROWS)],
        plain[:1],
        np.tile(np.array([[20.0, 0, 0, 120], [8, 1, 0.5, 60]], "<f4"), (60, 1)),  # two points again and again
        np.tile(np.array([[20.0, 0, 0, 120], [8, 1, 0.5, 60], [0, 0, 0, 0]], "<f4"), (60, 1)),
        rng.uniform(0, 1, (64, 4)).astype("<f4"),
        np.zeros((48, 4), "<f4"),
        np.repeat(plain, 2, axis=0) * np.array([1, 1, 1, 0.5], "<f4"),  # two returns a beam
    )
    for cloud in clouds:
        cloud.tofile(tmp_path / "a.bin")
        assert np.array_equal(read_points(tmp_path / "a.bin").points.numpy(), cloud)


@pytest.mark.real_data
@pytest.mark.parametrize(
    ("pattern", "columns"),
    [
        ("kitti_nuscenes_demo/kitti/*.bin", 4),
        ("kitti_13/velodyne/000000.bin", 4),
        ("kitti_nuscenes_demo/nuscenes/*.pcd.bin", 5),
        ("wads_snow/velodyne/042250.bin", 4),
    ],
)
def test_real_sweeps_are_accepted_in_their_layout_alone(tmp_path: Path, pattern: str, columns: int) -> None:
    path = recording(pattern)
    table = read_points(path).points.numpy()
    assert table.shape[1] == columns
    table = table[: len(table) // 20 * 20]
    other = "a.bin" if columns == 5 else "a.pcd.bin"
    table.tofile(tmp_path / other)
    with pytest.raises(TorchweatherError, match=f"likely layout is {columns} columns of float32"):
        read_points(tmp_path / other)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("name", ["a.bin", "a.pcd.bin", "a.pcd", "a.ply"])
def test_beams_without_a_return_may_be_nan_or_infinite_and_come_back_so(
    tmp_path: Path, value: float, name: str
) -> None:
    table = torch.from_numpy(sweep()[:, : 5 if name.endswith(".pcd.bin") else 4].astype("<f4"))
    write_points(tmp_path / name, table)
    marked = (tmp_path / name).read_bytes().replace(table[7, :3].numpy().tobytes(), np.full(3, value, "<f4").tobytes())
    (tmp_path / name).write_bytes(marked)
    found = read_points(tmp_path / name)
    assert found.nan_rows == 1
    assert found.points[7, :3].tolist() == [0, 0, 0]
    assert found.points[7, 3] == table[7, 3]
    write_points(tmp_path / f"again_{name}", found)
    assert (tmp_path / f"again_{name}").read_bytes() == marked


def test_an_infinite_position_of_a_tensor_is_not_written(tmp_path: Path) -> None:
    cloud = torch.tensor([[torch.inf, 0.0, 0.0, 1.0]])
    for name in ("a.bin", "a.pcd", "a.ply"):
        with pytest.raises(TorchweatherError, match="finite"):
            write_points(tmp_path / name, cloud)


def test_columns_of_several_types_and_padding_are_stated(tmp_path: Path) -> None:
    row = np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("pad", "<u4"), ("reflectivity", "<u2"), ("ring", "u1")])
    table = np.zeros(3, row)
    table["x"], table["reflectivity"], table["ring"] = [1, 2, 3], [10, 20, 30], [0, 1, 2]
    table.tofile(tmp_path / "a.bin")
    found = read_points(tmp_path / "a.bin", bin_columns="x,y,z,_:uint32,reflectivity:uint16,ring:uint8")
    assert found.columns == ("x", "y", "z", "reflectivity", "ring")
    assert found.points.tolist() == [[1, 0, 0, 10, 0], [2, 0, 0, 20, 1], [3, 0, 0, 30, 2]]
    write_points(tmp_path / "b.bin", found)
    assert (tmp_path / "b.bin").read_bytes() == table.tobytes()
    (tmp_path / "c.bin").write_bytes(bytes(22))
    with pytest.raises(TorchweatherError, match=r"rows of 19 bytes, as stated.*got 22 bytes"):
        read_points(tmp_path / "c.bin", bin_columns="x,y,z,_:uint32,reflectivity:uint16,ring:uint8")


@pytest.mark.parametrize(
    ("columns", "dtype", "words"),
    [
        ("x,y,intensity", "float32", "expected x, y, z"),
        ("x,y,z,x", "float32", "each once"),
        ("x,y,z,intensity", "text", "number's type"),
        ("x,y,z,when:datetime64", "float32", "number types"),
        ("x,y,z,,i", "float32", "number types"),
    ],
)
def test_wrong_statements_are_refused(tmp_path: Path, columns: str, dtype: str, words: str) -> None:
    (tmp_path / "a.bin").write_bytes(bytes(48))
    with pytest.raises(InputValueError, match=words):
        read_points(tmp_path / "a.bin", bin_columns=columns, bin_dtype=dtype)
