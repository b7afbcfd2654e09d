"""Archives of arrays: what was written comes back as it was."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from torchweather.io.arrays import read_archive, write_archive


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
