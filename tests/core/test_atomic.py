"""Files that are whole or not there, and on the disk."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from torchweather.core.atomic import atomic_folder, atomic_write, durable


def test_the_file_is_synced_under_its_temporary_name_and_the_folder_after(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    steps: list[str] = []
    monkeypatch.setattr(os, "fsync", lambda handle: steps.append(f"sync, named: {(tmp_path / 'a.txt').exists()}"))
    with atomic_write(tmp_path / "a.txt") as unfinished:
        unfinished.write_text("1")
    assert steps == ["sync, named: False", "sync, named: True"]
    with durable(False), atomic_write(tmp_path / "b.txt") as unfinished:
        unfinished.write_text("2")
    assert len(steps) == 2
    with atomic_folder(tmp_path / "out") as staging:
        (staging / "c.txt").write_text("3")
    assert len(steps) == 4


def test_a_failure_of_the_disk_is_no_success(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def failing(handle: int) -> None:
        raise OSError(5, "Input/output error")

    monkeypatch.setattr(os, "fsync", failing)
    (tmp_path / "a.txt").write_text("before")
    with pytest.raises(OSError, match="Input/output"), atomic_write(tmp_path / "a.txt") as unfinished:
        unfinished.write_text("after")
    assert [(path.name, path.read_text()) for path in tmp_path.iterdir()] == [("a.txt", "before")]
