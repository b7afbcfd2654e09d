"""Archives of arrays: what was written comes back as it was."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from torchweather.core.errors import TorchweatherError
from torchweather.io.arrays import read_archive, read_array, write_archive


@pytest.mark.parametrize("compressed", [False, True])
def test_arrays_come_back_in_their_shape_and_dtype(tmp_path: Path, compressed: bool) -> None:
    table = np.arange(24, dtype=np.int16).reshape(2, 3, 4)
    arrays = {
        "one number": np.array(2.5),
        "file": table,
        "none": np.zeros((0, 3), np.float32),
        "turned": table.T,
        "every other": table[:, ::2, 1:3],
        "text": np.array("clear"),
    }
    write_archive(tmp_path / "a.npz", arrays, compressed=compressed)
    found, was_compressed = read_archive(tmp_path / "a.npz")
    assert was_compressed == compressed
    assert list(found) == list(arrays)
    for name, array in arrays.items():
        assert (found[name].shape, found[name].dtype) == (array.shape, array.dtype), name
        np.testing.assert_array_equal(found[name], array)
    with np.load(tmp_path / "a.npz", allow_pickle=False) as archive:
        assert archive["one number"].shape == ()


def test_archives_that_inflate_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    np.savez_compressed(tmp_path / "x.npz", points=np.zeros((9_000_000, 1)), more=np.zeros(9))
    for read in (read_archive, lambda path: read_array(path, ["points"])):
        with pytest.raises(TorchweatherError, match=r"inflate .* to 72 MB.*TORCHWEATHER_MAX_INFLATED_MB="):
            read(tmp_path / "x.npz")
    monkeypatch.setenv("TORCHWEATHER_MAX_INFLATED_MB", "100")
    assert read_array(tmp_path / "x.npz", ["points"]).shape == (9_000_000, 1)


def test_errors_about_many_or_long_names_are_short(tmp_path: Path) -> None:
    write_archive(tmp_path / "many.npz", {f"name{number}": np.zeros(1) for number in range(1100)})
    write_archive(tmp_path / "long.npz", {"x" * 60_000: np.zeros(1), "\x1b[31m": np.zeros(1)})
    write_archive(tmp_path / "some.npz", {f"name{number}": np.zeros(1) for number in range(500)})
    for name, words in (("many", "at most 1000 arrays; got 1,100"), ("long", r"x\.\.\."), ("some", "and 490 more")):
        with pytest.raises(TorchweatherError, match=words) as caught:
            read_array(tmp_path / f"{name}.npz", ["depth"])
        assert len(str(caught.value)) < 1000
        assert "\x1b" not in str(caught.value)


def test_a_header_of_megabytes_does_not_fill_the_error(tmp_path: Path) -> None:
    text = b"{" + b"'a': 1, " * 500_000
    (tmp_path / "x.npy").write_bytes(b"\x93NUMPY\x02\x00" + len(text).to_bytes(4, "little") + text)
    with pytest.raises(TorchweatherError) as caught:
        read_array(tmp_path / "x.npy", [])
    assert len(str(caught.value)) < 9000
