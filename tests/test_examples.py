"""Every example runs as its docstring says, on small sizes, and writes what it announces."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from torchweather.io import read_image

ROOT = Path(__file__).parents[1]
EXAMPLES = ROOT / "examples"

# What each example is called with, and the files that it must write.
RUNS: dict[str, tuple[list[str], list[str]]] = {
    "first_rain.py": (["--width", "160", "--out", "rain.png"], ["rain.png"]),
    "drive_in_snow.py": (["--width", "120", "--frames", "3", "--out", "snow.gif"], ["snow.gif"]),
    "kitti_in_weather.py": (
        ["--width", "160", "--out", "pictures"],
        [f"pictures/test-track_{name}.png" for name in ("clear", "rain", "fog", "snow")],
    ),
    "realtime_mask_bank.py": (
        ["--width", "120", "--entries", "2", "--depths", "4", "--frames", "4", "--bank", "b.npz", "--out", "bank.png"],
        ["b.npz", "bank.png"],
    ),
    "rain_from_disdrometer.py": (["--out", "drops.png"], ["drops.png"]),
}


def run(name: str, arguments: list[str], folder: Path) -> str:
    without_data = {key: value for key, value in os.environ.items() if key != "TORCHWEATHER_REAL_DATA"}
    environment = {**without_data, "PYTHONPATH": str(ROOT), "MPLBACKEND": "Agg"}
    done = subprocess.run(
        [sys.executable, "-W", "error", str(EXAMPLES / name), *arguments],
        cwd=folder,
        env=environment,
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_every_example_is_run_here() -> None:
    assert set(RUNS) == {path.name for path in EXAMPLES.glob("*.py")}


@pytest.mark.parametrize("name", list(RUNS))
def test_the_example_runs_and_writes_its_files(name: str, tmp_path: Path) -> None:
    arguments, files = RUNS[name]
    output = run(name, arguments, tmp_path)
    assert output.strip()
    assert all((tmp_path / file).stat().st_size > 0 for file in files)
    assert not list(tmp_path.rglob(".*"))  # nothing half written


def test_the_film_moves_and_can_be_single_pictures(tmp_path: Path) -> None:
    run("drive_in_snow.py", ["--width", "120", "--frames", "3", "--out", "film"], tmp_path)
    frames = [read_image(path)[0] for path in sorted((tmp_path / "film").glob("*.png"))]
    assert len(frames) == 3
    assert not (frames[0] == frames[1]).all()


def test_the_bank_is_read_again_and_agrees_with_the_full_render(tmp_path: Path) -> None:
    arguments = RUNS["realtime_mask_bank.py"][0]
    first = run("realtime_mask_bank.py", arguments, tmp_path)
    again = run("realtime_mask_bank.py", arguments, tmp_path)
    assert "bank rendered" in first
    assert "bank read" in again
    line = next(line for line in again.splitlines() if line.startswith("mask mean"))
    words = line.replace(",", "").split()
    bank, full = float(words[2]), float(words[6])
    # Few draws on a small frame, and particles shared out between four depths only.
    assert bank == pytest.approx(full, rel=0.15)


def test_an_image_without_its_cloud_is_refused(tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, str(EXAMPLES / "kitti_in_weather.py"), "--image", "x.png"],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert done.returncode == 2
    assert "--image, --points and --calibration go together" in done.stderr
