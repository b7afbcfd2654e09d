"""``torchweather sweep``: embedded scenes and one's own files of every sensor, and what it refuses."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from torchweather.atmosphere.weather import parse_weather
from torchweather.image import FlatGround
from torchweather.io import read_points, read_table, write_image, write_points
from torchweather.metrics import Region, cloud_scores
from torchweather.sensors import Camera, Lidar
from torchweather.transforms import BayerWeather, LidarWeather

pytestmark = pytest.mark.usefixtures("undrawn")

RAIN = ("--weather", "rain:rate=5,50")


COMMAND = ("sweep",)


def cloud(seed: int, rows: int = 300) -> Tensor:
    random = torch.Generator().manual_seed(seed)
    way = torch.randn(rows, 3, generator=random) * torch.tensor([1.0, 1.0, 0.1])
    xyz = way / way.norm(dim=-1, keepdim=True) * (3 + 57 * torch.rand(rows, 1, generator=random))
    return torch.cat([xyz, torch.randint(1, 60, (rows, 1), generator=random).float()], -1)


def test_the_embedded_scene_as_a_camera_sees_it(run: Any, tmp_path: Path) -> None:
    out = tmp_path / "out"
    code, text, err = run(
        *("--sensor", "camera:lucid-triton", "--size", "64x48", "--seeds", 2, "--seed", 5, "--metrics", "psnr, gmsd"),
        *(*RAIN, "--weather", "fog:mor=400,30", "--out", out, "--json"),
    )
    assert (code, err) == (0, "")
    summary = json.loads(text)
    assert summary == json.loads((out / "summary.json").read_text(encoding="utf-8"))
    assert (summary["sensor"], summary["subjects"], summary["seeds"]) == ("camera:lucid-triton", ["test-track"], [5, 6])
    table = read_table(out / "scores.csv")
    assert len(table["score"]) == 2 * 2 * 2 * 2
    assert (table["metric"][:2], table["seed"][::2][:2]) == (["psnr", "gmsd"], [5, 6])
    assert (out / "index.html").is_file()


def test_the_embedded_scene_as_a_lidar_sees_it(run: Any, tmp_path: Path) -> None:
    code, text, err = run(
        *("scene:test-track", "scene:fog-tunnel", "--sensor", "lidar", "--columns", 32, "--seeds", 1),
        *(*RAIN, "--weather", "fog:mor=100,50", "--metrics", "mde", "--out", tmp_path, "--table", "parquet"),
    )
    assert code == 0
    assert "the sensor is lidar:ouster-os1-128" in err
    assert "test-track, rain, rate_mm_per_h 5, 50: 1 of 1 scores get worse at every step\n" in text
    table = read_table(tmp_path / "scores.parquet")
    # It does not rain in the tunnel.
    pairs = dict.fromkeys(zip(table["subject"], table["weather"], strict=True))
    assert list(pairs) == [("test-track", "rain"), ("test-track", "fog"), ("fog-tunnel", "fog")]


def test_the_embedded_scene_as_a_radar_sees_it(run: Any, tmp_path: Path) -> None:
    code, text, _ = run(
        *("--sensor", "radar:awr1843-like", *RAIN, "--seeds", 1, "--metrics", "mde,hd", "--out", tmp_path, "--json")
    )
    assert code == 0
    (series,) = json.loads(text)["series"]
    assert series["facts_clear"]["points"] > 10
    assert all(mean > 0 for mean in series["metrics"]["mde"]["mean"])


def test_a_folder_of_clouds_is_judged_together(run: Any, tmp_path: Path) -> None:
    folder, out = tmp_path / "clouds", tmp_path / "out"
    folder.mkdir()
    for number in range(2):
        write_points(folder / f"{number}.bin", cloud(number))
    code, text, err = run(
        *(folder, "--sensor", "lidar:velodyne-hdl-64e", "--weather", "snow:rate=1,5", "--seeds", 2, "--out", out),
        *("--region", "x=0:30", "--metrics", "mde", "--json"),
    )
    assert (code, err) == (0, "")
    (series,) = json.loads(text)["series"]
    assert (series["scene"], len(series["subjects"])) == ("clouds", 2)
    table = read_table(out / "scores.csv")
    assert len(table["score"]) == 2 * 2 * 2
    points = read_points(folder / "1.bin").points
    transform = LidarWeather(parse_weather("snow:rate=5"), Lidar.preset("velodyne-hdl-64e"))
    snowy = transform(points, transform.draw(points, seed=1))
    wanted = cloud_scores(snowy, points, names=["mde"], region=Region(x_m=(0.0, 30.0)))["mde"]
    assert table["subject"][-1] == str(folder / "1.bin")
    assert table["score"][-1] == pytest.approx(float(wanted))


def test_frames_of_one_s_own_with_their_depth(run: Any, tmp_path: Path) -> None:
    random = torch.Generator().manual_seed(2)
    raw = torch.randint(300, 3000, (1, 24, 32), generator=random).to(torch.int32).to(torch.uint16)
    write_image(tmp_path / "a.png", raw)
    np.save(tmp_path / "a.npy", np.full((24, 32), 40.0, dtype=np.float32))
    argv = (tmp_path / "a.png", "--sensor", "camera", "--bit-depth", 12, *RAIN, "--seeds", 1, "--metrics", "psnr")
    scores = []
    code, _, err = run(*argv, "--airlight", 0.7, 0.7, 0.7, "--out", tmp_path / "refused")
    assert code == 2
    assert "depth of" in err
    assert "is guessed" in err
    assert "--allow-guessed-depth" in err
    for depth in (("--allow-guessed-depth",), ("--depth", tmp_path / "a.npy")):
        out = tmp_path / f"out{len(depth)}"
        code, _, err = run(*argv, *depth, "--airlight", 0.7, 0.7, 0.7, "--out", out)
        assert code == 0
        assert "is scaled to them" in err
        assert ("guessed, not measured" in err) == (depth[0] == "--allow-guessed-depth")
        scores.append(read_table(out / "scores.csv")["score"])
    camera = Camera.preset("lucid-triton", bit_depth=12).resized(32, 24)
    transform = BayerWeather(parse_weather("rain:rate=50"), camera, airlight=(0.7, 0.7, 0.7))
    levels = []
    for metres in (FlatGround()(camera, 24, 32, image=raw).reshape(1, 24, 32), torch.full((1, 24, 32), 40.0)):
        after = transform(raw, metres, transform.draw(raw, seed=0))
        levels.append(float((after.double() - raw.double()).square().mean()))
    # PSNR orders the two depths as their mean squared error does.
    assert (scores[0][1] > scores[1][1]) == (levels[0] < levels[1])


def test_a_folder_of_detections(run: Any, tmp_path: Path) -> None:
    table = np.array([[20.0 + 3 * k, 0.5 * k, 0.0, 0.0, 15.0 - k, 0.0] for k in range(20)], dtype=np.float32)
    np.savez(tmp_path / "r.npz", points=table)
    code, text, _ = run(
        *(tmp_path / "r.npz", "--sensor", "radar", "--noise-floor-db", -10, *RAIN, "--metrics", "mde", "--seeds", 1),
        *("--out", tmp_path / "out", "--json"),
    )
    assert code == 0
    (series,) = json.loads(text)["series"]
    first, last = series["metrics"]["mde"]["mean"]
    assert first < last
    points = series["facts"]["points"]
    assert points[1] < points[0] <= series["facts_clear"]["points"] == 20.0


@pytest.mark.parametrize(
    ("argv", "message"),
    [
        (("--sensor", "sonar", *RAIN), "--sensor must be camera, lidar or radar"),
        (("--sensor", "camera", "--weather", "rain:rate=5"), "two or more values"),
        (("--sensor", "camera", "--size", "64x48", *RAIN, *RAIN), "each weather once"),
        (("--sensor", "camera", *RAIN, "--seeds", 0), "--seeds must be 1 or more"),
        (("--sensor", "camera", *RAIN, "--region", "x=0:5"), "--region is for a lidar"),
        (("--sensor", "lidar", *RAIN, "--size", "64x48"), "--size is for a camera"),
        (("--sensor", "camera", *RAIN, "--size", "64"), "--size must be WIDTHxHEIGHT"),
        (("--sensor", "camera", *RAIN, "--size", "63x48"), "even numbers"),
        (("--sensor", "camera", *RAIN, "--depth", "30"), "--depth belongs to frames"),
        (("--sensor", "camera", *RAIN, "--size", "64x48", "--metrics", "mde"), "metric"),
        (("--sensor", "camera", *RAIN, "--size", "64x48"), "161"),
        (("scene:moon", "--sensor", "camera", *RAIN), "scene"),
        (("scene:fog-tunnel", "--sensor", "camera", "--size", "64x48", *RAIN), "Indoors give fog"),
        (("nowhere.png", "--sensor", "camera", *RAIN), "nowhere.png: no such file"),
        (("nowhere.png", "--sensor", "camera", *RAIN, "--size", "64x48"), "--size belongs to embedded scenes"),
        (("--sensor", "lidar", *RAIN, "--region", "w=1:2"), "--region must be"),
    ],
)
def test_a_mistake_is_one_line_and_leaves_nothing(run: Any, tmp_path: Path, argv: Any, message: str) -> None:
    out = tmp_path / "out"
    code, text, err = run(*argv, "--out", out, "--quiet")
    assert (code, text) == (2, "")
    assert message in err
    assert err.count("\n") == 1
    assert not out.exists()


def test_help_does_not_load_torch() -> None:
    code = (
        "import sys\nfrom torchweather.cli import main\n"
        "try:\n    main(['sweep', '--help'])\nexcept SystemExit:\n    pass\nsys.exit('torch' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False, capture_output=True).returncode == 0
