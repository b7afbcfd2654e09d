"""Findings of a later run: changed outputs, results without a source, damaged manifests, links, odd names, signals."""

from __future__ import annotations

import json
import os
import random
import shutil
import signal
import sqlite3
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest

from tests.datasets.augment.data_sets import FOG, MANIFEST, cloud, folder, kitti, recipe
from torchweather.cli import main
from torchweather.core.errors import TorchweatherError
from torchweather.datasets.augment import Manifest, Summary, augment
from torchweather.io import write_points


def clouds(root: Path, number: int = 4) -> Path:
    root.mkdir(parents=True)
    for one in range(number):
        write_points(root / f"{one}.bin", cloud(one))
    return root


def run(source: Path, target: Path, **options: Any) -> Summary:
    return augment(source, target, recipe(source.parent, FOG), workers=0, durable=False, **options)


def command(source: Path, target: Path, *more: str) -> int:
    argv = ["augment", str(source), str(target), "--recipe", recipe(source.parent, FOG), "--workers", "0", *more]
    return main([*argv, "--no-fsync"])


def flipped(file: Path) -> None:
    """Other bytes of the same size."""
    content = bytearray(file.read_bytes())
    content[-1] ^= 1
    file.write_bytes(content)


# ---- outputs -------------------------------------------------------------------------------------------------------


def test_an_output_of_other_bytes_is_done_again(tmp_path: Path) -> None:
    source, target = clouds(tmp_path / "in"), tmp_path / "out"
    run(source, target)
    wanted = {path.name: path.read_bytes() for path in target.glob("*.bin")}
    flipped(target / "1.bin")
    assert run(source, target).done == 1
    assert {path.name: path.read_bytes() for path in target.glob("*.bin")} == wanted
    # A time that differs alone is no change.
    os.utime(target / "2.bin", (1, 1))
    assert run(source, target).to_do == 0


def test_verify_finds_other_bytes_of_the_same_size_and_time(tmp_path: Path) -> None:
    source, target = clouds(tmp_path / "in"), tmp_path / "out"
    run(source, target)
    for file in (target / "1.bin", source / "2.bin"):
        stamp = file.stat()
        flipped(file)
        os.utime(file, ns=(stamp.st_atime_ns, stamp.st_mtime_ns))
    assert run(source, target, dry_run=True).to_do == 0
    assert run(source, target, verify=True, dry_run=True).to_do == 2
    assert run(source, target, verify=True).done == 2
    assert run(source, target, verify=True).to_do == 0


def test_results_without_a_source_are_reported_and_pruned(tmp_path: Path, capsys: Any) -> None:
    source, target = clouds(tmp_path / "in"), tmp_path / "out"
    run(source, target)
    (source / "3.bin").unlink()
    summary = run(source, target)
    assert (summary.gone, summary.pruned) == (["3.bin"], False)
    assert (target / "3.bin").exists()
    assert command(source, target) == 0
    assert "results without a source: 1 files (SRC has them no more; --prune deletes them): 3.bin." in (
        capsys.readouterr().err
    )
    assert run(source, target, prune=True, dry_run=True).gone == ["3.bin"]
    assert (target / "3.bin").exists()
    assert run(source, target, prune=True).gone == ["3.bin"]
    assert not (target / "3.bin").exists()
    assert run(source, target).gone == []
    assert sorted(path.name for path in target.glob("*.bin")) == ["0.bin", "1.bin", "2.bin"]


# ---- what is left out ----------------------------------------------------------------------------------------------


def test_hidden_files_and_sensors_data_in_clear_air_are_named(tmp_path: Path, capsys: Any) -> None:
    source, target = folder(tmp_path / "in", 1), tmp_path / "out"
    (source / "day/._0.png").write_bytes(b"Mac OS X")
    (source / ".Trash-0").mkdir()
    (source / ".Trash-0/old.bin").write_bytes(b"broken")
    os.mkfifo(source / "pipe.bin")
    assert command(source, target) == 0
    err = capsys.readouterr().err
    assert "left out, hidden or no regular files: 3: .Trash-0, pipe.bin, day/._0.png." in err
    assert "carried along in clear air, though sensors' data: 1 files: day/images/ (1)." in err
    assert not list(target.rglob("*old.bin"))


def test_a_second_camera_of_kitti_beside_a_rainy_one_is_named(tmp_path: Path) -> None:
    source = kitti(tmp_path / "in", 1)
    for name in ("image_3", "image_0"):
        shutil.copytree(source / "training/image_2", source / f"training/{name}")
    summary = augment(source, tmp_path / "out", recipe(tmp_path), workers=0, durable=False)
    assert summary.clear == {"training/image_0": 1, "training/image_3": 1}
    assert [note.split(":")[0] for note in summary.notes] == ["training/image_0", "training/image_3"]
    assert "does not show one storm" in summary.notes[0]


# ---- links and names -----------------------------------------------------------------------------------------------


def test_links_are_followed_on_request(tmp_path: Path) -> None:
    elsewhere = clouds(tmp_path / "disk/drive")
    source = clouds(tmp_path / "in", 1)
    (source / "drive").symlink_to(elsewhere)
    with pytest.raises(TorchweatherError, match="--follow-links"):
        run(source, tmp_path / "out")
    assert run(source, tmp_path / "out", follow_links=True).done == 5
    assert (tmp_path / "out/drive/3.bin").is_file()
    assert not (tmp_path / "out/drive").is_symlink()
    assert run(source, tmp_path / "out", follow_links=True).to_do == 0
    (source / "round").symlink_to(source)
    with pytest.raises(TorchweatherError, match="has no end"):
        run(source, tmp_path / "out", follow_links=True)


def test_one_odd_name_does_not_stop_a_data_set(tmp_path: Path, capsys: Any) -> None:
    source, target = clouds(tmp_path / "in"), tmp_path / "out"
    odd = [os.fsdecode(b"\xff\xfe.bin"), '"quoted.bin', "a\x1b[2J.bin", "back\\slash.bin"]
    for name in odd:
        write_points(source / "new.bin", cloud(7))
        os.rename(source / "new.bin", source / name)
    (source / "bad\x1b[2J.bin").write_bytes(b"no cloud")
    assert command(source, target) == 1
    printed = capsys.readouterr()
    assert "\x1b" not in printed.out + printed.err
    summary = run(source, target)
    # A backslash is a separator elsewhere; such a name is refused, alone.
    assert sorted(summary.broken) == sorted(["back\\slash.bin", "bad\x1b[2J.bin"])
    assert summary.skipped == 4 + 3
    with Manifest(target) as manifest:
        assert set(odd) <= {row.frame for row in manifest.rows()}


# ---- damaged manifests ---------------------------------------------------------------------------------------------


def damaged(path: Path, chance: random.Random) -> None:
    """Bytes changed, or a part cut off."""
    content = bytearray(path.read_bytes())
    if chance.random() < 0.3:
        del content[chance.randrange(len(content)) :]
    for _ in range(chance.choice((1, 20, 400)) if content else 0):
        content[chance.randrange(len(content))] = chance.randrange(256)
    path.write_bytes(content)


def test_a_damaged_manifest_is_an_error_of_ours_and_restart_begins_again(tmp_path: Path, capsys: Any) -> None:
    source, target = clouds(tmp_path / "in"), tmp_path / "out"
    run(source, target)
    whole = (target / MANIFEST).read_bytes()
    codes = []
    for number in range(30):
        damaged(target / MANIFEST, random.Random(number))
        codes.append(command(source, target, "--quiet", "--dry-run"))
        capsys.readouterr()
        (target / MANIFEST).write_bytes(whole)
    assert set(codes) == {0, 2}
    (target / MANIFEST).write_bytes(b"no database" * 100)
    assert command(source, target, "--quiet") == 2
    assert "--restart" in capsys.readouterr().err
    assert command(source, target, "--quiet", "--restart") == 0
    assert command(source, target, "--quiet", "--dry-run") == 0
    assert "4 done before, 0 to do" in capsys.readouterr().out


@pytest.mark.parametrize(
    "change",
    [
        "update frames set outputs = '[1]'",
        "update frames set outputs = '{\"0.bin\": 5}'",
        "update frames set inputs = '" + "[" * 100_000 + "'",
        "update frames set notes = '7'",
        "update frames set weather = '[]'",
        "update frames set frame = x'ff00' where frame = '1.bin'",
        "update run set value = x'00ff'",
        "drop table run; create table run (key text)",
        "drop table frames; create table frames (frame text)",
    ],
)
def test_a_manifest_whose_rows_are_damaged_has_exit_code_2(tmp_path: Path, capsys: Any, change: str) -> None:
    source, target = clouds(tmp_path / "in", 2), tmp_path / "out"
    run(source, target)
    with sqlite3.connect(target / MANIFEST) as file:
        file.executescript(change)
    file.close()
    assert command(source, target, "--quiet") == 2
    assert MANIFEST in capsys.readouterr().err
    assert command(source, target, "--quiet", "--restart") == 0


def test_a_damaged_manifest_is_rebuilt_from_rows_whose_files_have_their_hashes(tmp_path: Path) -> None:
    source, target = clouds(tmp_path / "in"), tmp_path / "out"
    run(source, target)
    with sqlite3.connect(target / MANIFEST) as file:
        file.execute("update frames set notes = '{' where frame = '1.bin'")
    file.close()
    stamp = (target / "2.bin").stat()
    flipped(target / "2.bin")
    os.utime(target / "2.bin", ns=(stamp.st_atime_ns, stamp.st_mtime_ns))
    with pytest.raises(TorchweatherError, match="--rebuild"):
        run(source, target)
    summary = run(source, target, rebuild=True)
    assert (summary.skipped, summary.done) == (2, 2)
    assert run(source, target, verify=True).to_do == 0
    (target / MANIFEST).write_bytes(b"")
    with pytest.raises(TorchweatherError, match="settings of its run cannot be read"):
        run(source, target, rebuild=True)


# ---- ends ----------------------------------------------------------------------------------------------------------


@pytest.mark.skipif(os.name == "nt", reason="no signals of POSIX")
def test_sigterm_drains_as_ctrl_c_does(tmp_path: Path) -> None:
    source, target = clouds(tmp_path / "in", 3000), tmp_path / "out"
    argv = [sys.executable, "-m", "torchweather", "augment", str(source), str(target), "--workers", "0", "--quiet"]
    process = subprocess.Popen([*argv, "--recipe", recipe(tmp_path, FOG)], stderr=subprocess.PIPE, text=True)
    until = time.monotonic() + 120
    while len(list(target.glob("*.bin"))) < 2 and process.poll() is None and time.monotonic() < until:
        time.sleep(0.02)
    process.send_signal(signal.SIGTERM)
    _, err = process.communicate(timeout=60)
    assert process.returncode == 143
    assert "interrupted by SIGTERM" in err
    assert "the same command goes on from there" in err
    assert not list(target.rglob(".*"))
    with Manifest(target) as manifest:
        rows = list(manifest.rows())
        assert 0 < len(rows) < 3000
        assert all(manifest.outputs_stand(row, verify=True) for row in rows)
    assert len(list(target.glob("*.bin"))) in (len(rows), len(rows) + 1)


def test_files_reach_the_disk_before_their_names_unless_told_not_to(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    synced: list[str] = []
    real = os.fsync

    def noted(handle: int) -> None:
        synced.append("folder" if os.path.isdir(f"/proc/self/fd/{handle}") else "file")
        real(handle)

    monkeypatch.setattr(os, "fsync", noted)
    source = clouds(tmp_path / "in", 1)
    synced.clear()
    augment(source, tmp_path / "a", recipe(tmp_path, FOG), workers=0)
    assert synced == ["file", "folder"]
    augment(source, tmp_path / "b", recipe(tmp_path, FOG), workers=0, durable=False)
    assert len(synced) == 2
    settings = json.dumps(sorted(path.name for path in (tmp_path / "b").iterdir()))
    assert settings == json.dumps(["0.bin", MANIFEST])
