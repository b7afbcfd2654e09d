"""Files of a data set that would meet in one output."""

from __future__ import annotations

from pathlib import Path

import pytest

from torchweather.datasets.augment.layouts import find_frames


def test_two_files_are_never_written_to_one(tmp_path: Path) -> None:
    for name in ("000.bin", "000.ply"):
        (tmp_path / name).write_bytes(b"")
    keys = {"lidar": "points"}
    assert len(find_frames(tmp_path, keys, recipe="x").frames) == 2
    with pytest.raises(ValueError, match=r"two files would both be written to 000\.pcd"):
        find_frames(tmp_path, keys, recipe="x", formats={"lidar": ".pcd"})
