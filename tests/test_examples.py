"""Every example runs as its docstring says, on small sizes, and writes what it announces."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import torch
from torch import Tensor

import torchweather as tw
from tests.running_examples import EXAMPLES, run_example
from torchweather.io import FALLING_SNOW, PointLabels, read_image, write_labels
from torchweather.lidar.scan import scan_directions
from torchweather.scenes import lidar_view
from torchweather.scenes import test_track as track

ROOT = Path(__file__).parents[1]
pytestmark = pytest.mark.usefixtures("few_dots")

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
    "fog_banks.py": (["--width", "120", "--columns", "64", "--out", "banks.png"], ["banks.png"]),
    "first_lidar_rain.py": (["--columns", "64", "--out", "cloud.png"], ["cloud.png"]),
    "first_radar_rain.py": (["--out", "radar.png"], ["radar.png"]),
    "radar_map_in_rain.py": (["--out", "map.png"], ["map.png"]),
    "metrics_against_detector.py": (
        ["--quick", "--out", "found"],
        [f"found/{name}" for name in ("index.html", "correlation.json", "scores.csv", "performance.csv")],
    ),
    "robustness_of_a_detector.py": (
        ["--quick", "--metrics", "psnr", "--out", "o"],
        [f"o/{name}" for name in ("detector.onnx", "detector.yaml", "found/index.html", "found/robustness.json")],
    ),
    "augment_a_kitti_folder.py": (
        ["--width", "160", "--columns", "90", "--frames", "2", "--workers", "0", "--out", "rainy"],
        [
            "rainy/torchweather-manifest.sqlite",
            "rainy/training/image_2/000001.png",
            "rainy/training/velodyne/000000.bin",
        ],
    ),
    "carla_in_weather.py": (["--width", "160", "--frames", "2", "--out", "carla.png"], ["carla.png"]),
    "train_in_weather.py": (
        [
            *("--quick", "--width", "64", "--steps", "2", "--train", "2", "--test", "1"),
            *("--cloud-train", "1", "--cloud-test", "1", "--out", "trained"),
        ],
        [f"trained/train_in_weather.{ending}" for ending in ("json", "png")],
    ),
    "rehearse_study.py": (
        ["--columns", "64", "--width", "48", "--frames", "1", "--out", "o"],
        ["o/page/index.html", "o/REHEARSE3D_PUBLIC/sequences/003/arena/000000.jpeg"],
    ),
    "radar_point_counts.py": (["--seeds", "1", "--weather", "rain 50 mm/h", "--out", "counts.json"], ["counts.json"]),
}
# Those that hold the model against recordings: run below on made recordings with a known answer, and on the real ones
# where TORCHWEATHER_REAL_DATA has them.
MEASURED: dict[str, list[str]] = {
    "lidar_snow_against_wads.py": ["wads.md", "wads.json", "wads.png", "wads_side.png", "wads_angles.png"],
    "lidar_fog_against_radiate.py": ["radiate.json", "radiate.png", "radiate_side.png", "radiate_angles.png"],
}
# Tested in a file of their own.
ELSEWHERE = {
    "against_recordings.py": "test_against_recordings.py",
    "fog_on_a_highway.py": "test_highway_example.py",
    "gap_d34_suspicions.py": "gap/study/test_hidden_study.py",
    "gap_wads_snow.py": "test_gap_wads_example.py",
    "gap_wet_antenna.py": "test_wet_antenna_example.py",
    "links_against_p838.py": "test_links_example.py",
    "real_detector.py": "test_real_detector_example.py",
}


def run(name: str, arguments: list[str], folder: Path) -> str:
    done = run_example(name, arguments, folder)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_every_example_is_run_here() -> None:
    assert {*RUNS, *MEASURED, *ELSEWHERE} == {path.name for path in EXAMPLES.glob("*.py")}
    for example, test in ELSEWHERE.items():
        assert example in (Path(__file__).parent / test).read_text(encoding="utf-8")


# Train detectors for ten seconds; what they call is tested in tests/evaluation and tests/report.
COSTLY = ("metrics_against_detector.py", "robustness_of_a_detector.py")
BANK = "realtime_mask_bank.py"  # has a test of two runs


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[pytest.mark.long] if name in COSTLY else []) for name in RUNS if name != BANK]
)
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
    arguments, files = RUNS[BANK]
    first = run(BANK, arguments, tmp_path)
    assert all((tmp_path / file).stat().st_size > 0 for file in files)
    assert not list(tmp_path.rglob(".*"))  # nothing half written
    again = run(BANK, arguments, tmp_path)
    assert "bank rendered" in first
    assert "bank read" in again
    line = next(line for line in again.splitlines() if line.startswith("mask mean"))
    words = line.replace(",", "").split()
    bank, full = float(words[2]), float(words[6])
    # Few draws on a small frame, and particles shared out between four depths only.
    assert bank == pytest.approx(full, rel=0.15)


def test_an_example_runs_from_the_command_line(tmp_path: Path) -> None:
    command = [sys.executable, "-W", "error", str(EXAMPLES / "first_rain.py"), *RUNS["first_rain.py"][0]]
    subprocess.run(command, cwd=tmp_path, env={**os.environ, "PYTHONPATH": str(ROOT)}, check=True, timeout=300)
    assert (tmp_path / "rain.png").stat().st_size > 0


def test_an_image_without_its_cloud_is_refused(tmp_path: Path) -> None:
    done = run_example("kitti_in_weather.py", ["--image", "x.png"], tmp_path)
    assert done.returncode == 2
    assert "--image, --points and --calibration go together" in done.stderr


def made_wads(folder: Path, rate_mm_per_h: float, seed: int = 99) -> None:
    """A frame in WADS' format: snow of a known rate over a plane, with a wall in a quarter of the turn."""
    sensor = tw.Lidar.preset("pandar64-wads")
    along = scan_directions(sensor)
    slope, azimuth = along[:, 2], torch.atan2(along[:, 1], along[:, 0])
    range_m = torch.where(slope < -0.08, 2.0 / -slope, torch.where(azimuth.abs() < torch.pi / 4, 12.0, 0.0))
    # White, so that nothing weak stands on the threshold and is lost.
    cloud = torch.cat([along * range_m[:, None], torch.where(range_m > 0, 255.0, 0.0)[:, None]], 1)
    snow = tw.LidarSnow(tw.Snow(rate_mm_per_h=rate_mm_per_h), sensor)
    result = snow.run(cloud, snow.draw(cloud, seed=seed), directions=along)
    parts: list[Any] = [result.points, result.kind, result.second, result.second_kind]
    strongest, kind, second, second_kind = (part for part in parts)
    there, twice = kind != tw.PointKind.LOST, second_kind != tw.PointKind.LOST
    last = torch.where(twice[:, None], second, strongest)[there]
    last_kind = torch.where(twice, second_kind, kind)[there]
    for name in ("velodyne", "labels"):
        (folder / name).mkdir(parents=True, exist_ok=True)
    torch.cat([last, strongest[there]]).numpy().astype("<f4").tofile(folder / "velodyne" / f"{seed:06d}.bin")
    kinds = torch.cat([last_kind, kind[there]])
    classes = torch.where(kinds == tw.PointKind.PARTICLE, FALLING_SNOW, 40)
    write_labels(folder / "labels" / f"{seed:06d}.label", PointLabels(classes, torch.zeros_like(classes)))


def test_snow_of_a_known_rate_is_found_again_in_a_made_recording(tmp_path: Path) -> None:
    made_wads(tmp_path / "made", 1.0)
    run("lidar_snow_against_wads.py", ["--data", "made", "--out", "out", "--rates", "0.5", "1", "2"], tmp_path)
    assert all((tmp_path / "out" / name).stat().st_size > 0 for name in MEASURED["lidar_snow_against_wads.py"])
    report = json.loads((tmp_path / "out" / "wads.json").read_text(encoding="utf-8"))
    recorded = report["recorded"]
    same = {
        run["rate_mm_per_h"]: run
        for run in report["simulated"]
        if run["sensor"] == "pandar64-wads" and run["reported"] == "strongest and last"
    }
    for name in ("beams without object that return snow", "beams with snow", "points that are snow"):
        # Some 50,000 empty beams and 0.055 of them with snow, each drawn anew: 3 sigma of a difference are 8 %.
        assert recorded[name] == pytest.approx(same[1.0][name], rel=0.08)
        # Half and twice the rate differ by far more.
        assert same[0.5][name] < 0.7 * recorded[name] < 1.3 * recorded[name] < same[2.0][name]
    assert recorded["range of snow, 5/50/95 %, m"] == pytest.approx(
        same[1.0]["range of snow, 5/50/95 %, m"], rel=0.02
    )  # 15,000 flakes


def made_radiate(folder: Path, mor_m: float) -> None:
    """A frame in RADIATE's format: the test track in fog of a known visibility."""
    sensor = tw.Lidar.preset("velodyne-hdl-32e")
    view = lidar_view(track(), sensor)
    fog = tw.LidarFog(tw.Fog(mor_m=mor_m), sensor)
    foggy = fog(view.points, fog.draw(view.points, seed=99), directions=view.directions)
    assert isinstance(foggy, Tensor)
    folder.mkdir()
    rows = foggy[(foggy[:, :3] != 0).any(1)].tolist()
    text = "".join(f"{x:.5f},{y:.5f},{z:.5f},{i:.0f},{ring:.0f}\n" for x, y, z, i, ring in rows)
    (folder / "000001.csv").write_text(text, encoding="utf-8")


def test_fog_of_a_known_visibility_is_found_again_in_a_made_recording(tmp_path: Path) -> None:
    # Thin fog: of denser fog the example takes some echoes for a surface, as neighbours have the range of the peak.
    made_radiate(tmp_path / "made", 350.0)
    run("lidar_fog_against_radiate.py", ["--data", "made", "--out", "out"], tmp_path)
    assert all((tmp_path / "out" / name).stat().st_size > 0 for name in MEASURED["lidar_fog_against_radiate.py"])
    report = json.loads((tmp_path / "out" / "radiate.json").read_text(encoding="utf-8"))
    # 390 echoes in either, known to 7 % together; their number goes as the visibility to the power of -5.8: 1.2 %, and
    # three times that. Beams that saw fog in the recording (2.6 %) are not empty there: half a percent more.
    assert report["mor_m_at_least"] == pytest.approx(350.0, rel=0.04)


@pytest.mark.long  # beside the made recordings above
@pytest.mark.real_data
@pytest.mark.parametrize("name", list(MEASURED))
def test_the_model_is_held_against_the_recordings(name: str, tmp_path: Path) -> None:
    root = os.environ.get("TORCHWEATHER_REAL_DATA")
    folder = {"lidar_snow_against_wads.py": "wads_snow", "lidar_fog_against_radiate.py": "radiate_fog/velo_lidar"}[name]
    if not root or not (Path(root) / folder).is_dir():
        pytest.skip(f"TORCHWEATHER_REAL_DATA holds no {folder}")
    run(name, ["--data", str(Path(root) / folder), "--out", "out"], tmp_path)
    assert all((tmp_path / "out" / file).stat().st_size > 0 for file in MEASURED[name])


@pytest.mark.parametrize("name", list(MEASURED))
def test_without_a_recording_the_example_says_what_it_needs(name: str, tmp_path: Path) -> None:
    done = run_example(name, [], tmp_path)
    assert done.returncode == 1
    assert "TORCHWEATHER_REAL_DATA" in done.stderr
