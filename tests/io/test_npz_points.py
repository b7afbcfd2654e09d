"""NPZ: tables and columns as numpy writes them, and archives that lie or hide pickles."""

from __future__ import annotations

import io
import zipfile
from pathlib import Path

import numpy as np
import pytest
import torch

from torchweather.core.errors import TorchweatherError
from torchweather.io.points import read_points, write_points


@pytest.mark.parametrize("save", [np.savez, np.savez_compressed])
def test_a_table_of_numpy_is_read_with_and_without_names(tmp_path: Path, save: object) -> None:
    assert callable(save)
    table = np.arange(30, dtype=np.float32).reshape(2, 3, 5)
    save(tmp_path / "a.npz", anything=table)
    found = read_points(tmp_path / "a.npz")
    assert found.columns == ("x", "y", "z", "intensity", "ring")
    assert found.grid == (2, 3)
    assert torch.equal(found.points, torch.from_numpy(table.reshape(6, 5)))
    save(tmp_path / "a.npz", points=table, columns=np.array(["i", "x", "y", "z", "t"]), pose=np.eye(4))
    found = read_points(tmp_path / "a.npz")
    assert found.columns == ("x", "y", "z", "i", "t")
    assert found.points[0].tolist() == [1, 2, 3, 0, 4]


def test_columns_of_their_own_dtypes_come_back_in_them(tmp_path: Path) -> None:
    numbers = np.arange(6).reshape(2, 3)
    arrays = {name: numbers.astype(np.float32) for name in ("x", "y", "z")}
    arrays |= {"reflectivity": numbers.astype(np.uint8), "t": (numbers + 4e9).astype(np.uint32)}
    np.savez(tmp_path / "a.npz", **arrays, labels=np.arange(4))
    write_points(tmp_path / "b.npz", read_points(tmp_path / "a.npz"))
    with np.load(tmp_path / "b.npz") as again:
        assert set(again.files) == set(arrays)
        for name, array in arrays.items():
            assert again[name].dtype == array.dtype
            assert np.array_equal(again[name], array)


def archive(path: Path, **members: bytes) -> Path:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as file:
        for name, content in members.items():
            file.writestr(f"{name}.npy", content)
    return path


def header(shape: tuple[int, ...], dtype: str = "<f4") -> bytes:
    stream = io.BytesIO()
    np.lib.format.write_array_header_1_0(stream, {"shape": shape, "fortran_order": False, "descr": dtype})
    return stream.getvalue()


def test_an_array_that_promises_a_hundred_gigabytes_is_refused_at_once(tmp_path: Path) -> None:
    source = archive(tmp_path / "a.npz", points=header((10**10, 4)) + bytes(100))
    with pytest.raises(TorchweatherError, match=r"a\.npz: array points .* needs 160000000000 bytes"):
        read_points(source)
    with pytest.raises(TorchweatherError, match="cannot"):
        read_points(archive(tmp_path / "a.npz", points=header((2**40, 2**40)) + bytes(100)))


@pytest.mark.parametrize(
    ("members", "message"),
    [
        ({}, "got nothing"),
        ({"points": b"garbage"}, "cannot be read"),
        ({"points": header((2, 4)) + bytes(8)}, "cannot"),
        ({"points": header((8,)) + bytes(32)}, r"got points float32 \(8,\)"),
        ({"x": header(()) + bytes(4), "y": header(()) + bytes(4), "z": header(()) + bytes(4)}, r"\(N,\) or \(H, W\)"),
    ],
)
def test_a_broken_archive_is_refused(tmp_path: Path, members: dict[str, bytes], message: str) -> None:
    with pytest.raises(TorchweatherError, match=rf"a\.npz: .*{message}"):
        read_points(archive(tmp_path / "a.npz", **members))


def test_pickled_objects_are_never_loaded(tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", points=np.array([{"x": 1}], dtype=object))
    with pytest.raises(TorchweatherError, match="pickled objects, which are never loaded"):
        read_points(tmp_path / "a.npz")


def test_names_that_do_not_fit_the_table_are_refused(tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", points=np.ones((2, 4)), columns=np.array(["x", "y", "z"]))
    with pytest.raises(TorchweatherError, match="expected 4 names"):
        read_points(tmp_path / "a.npz")
