"""``torchweather apply`` and ``augment`` on point files that do not say what they are: columns, unit, place."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from tests.datasets.augment.data_sets import FOG, recipe
from torchweather.atmosphere.weather import Fog
from torchweather.core.errors import TorchweatherWarning
from torchweather.datasets.augment import Manifest
from torchweather.io import PointCloud, read_points, write_points
from torchweather.sensors import Lidar
from torchweather.transforms import LidarFog

HDL = ("--sensor", "lidar:velodyne-hdl-64e", "--intensity-unit", "uint8_linear")
COLUMNS = "x,y,z,intensity,ring"


AS_TYPED = True  # seeds and records as users have them


def five_columns(path: Path) -> np.ndarray:
    rng = np.random.default_rng(1)
    angle, range_m, ring = rng.uniform(0, 6.28, 320), rng.uniform(4, 60, 320), np.arange(320) % 32
    xyz = range_m * np.cos(angle), range_m * np.sin(angle), range_m * np.tan(np.radians(ring - 25.0))
    table = np.stack([*xyz, rng.integers(1, 100, 320), ring], axis=1).astype("<f4")
    table.tofile(path)
    return table


def test_apply_refuses_rows_of_another_layout_and_takes_them_as_stated(run: Any, tmp_path: Path) -> None:
    table = five_columns(tmp_path / "a.bin")
    asked = ("apply", tmp_path / "a.bin", *HDL, "--weather", "fog:mor=1e6", "-o", tmp_path / "out")
    code, _, said = run(*asked)
    assert code == 2
    assert f"--bin-columns {COLUMNS}" in said
    assert not (tmp_path / "out").exists()
    assert run(*asked, "--bin-columns", COLUMNS)[0] == 0
    out = np.fromfile(tmp_path / "out" / "a.bin", "<f4").reshape(-1, 5)
    assert np.array_equal(out[:, 4], table[:, 4])
    assert run(*asked, "--bin-dtype", "float64")[0] == 2
    code, _, said = run(
        "apply", "a.png", "--sensor", "camera", "--weather", "fog:mor=9", "-o", "o", "--bin-columns", "x"
    )
    assert code == 2
    assert "--bin-columns is for a lidar" in said


def test_augment_reports_rows_of_another_layout_and_takes_them_as_stated(run: Any, tmp_path: Path) -> None:
    (tmp_path / "src").mkdir()
    five_columns(tmp_path / "src" / "a.bin")
    asked = ("augment", tmp_path / "src", tmp_path / "out", "--recipe", recipe(tmp_path, FOG), "--workers", "0")
    code, _, said = run(*asked)
    assert code == 1
    assert f"--bin-columns {COLUMNS}" in said
    code, _, said = run(*asked, "--bin-columns", COLUMNS)
    assert code == 2
    assert "was begun with --bin-columns" in said
    assert run(*asked, "--bin-columns", COLUMNS, "--restart")[0] == 0
    assert len(np.fromfile(tmp_path / "out" / "a.bin", "<f4")) == 320 * 5
    assert run(*asked, "--bin-columns", COLUMNS)[0] == 0
    with Manifest(tmp_path / "out") as manifest:
        assert manifest.settings()["bin_columns"] == COLUMNS


def test_the_intensity_of_the_sensors_unit_is_weathered(run: Any, tmp_path: Path) -> None:
    """A dark target, reflectivity 20 of 255, at 20 m in fog of 30 m is lost; its photon count, 220, says otherwise."""
    rows = torch.tensor([[20.0, 0, 0, 220, 0, 20, 0]]).repeat(60, 1)
    rows[:, 6] = torch.arange(60)
    write_points(tmp_path / "a.pcd", rows, columns=("x", "y", "z", "intensity", "t", "reflectivity", "ring"))
    asked = ("apply", tmp_path / "a.pcd", "--weather", "fog:mor=30", "-o", tmp_path / "out", "--json")
    _, out, _ = run(*asked, "--sensor", "lidar:ouster-os1-128")
    assert json.loads(out)["files"][0]["objects"] == 0
    _, out, _ = run(*asked, "--sensor", "lidar:ouster-os1-128", "--intensity", "intensity", "--force")
    assert json.loads(out)["files"][0]["objects"] == 60


def moved(path: Path) -> None:
    points = torch.tensor([[110.0, 200, 1.75, 50], [130, 200, 1.75, 50], [100, 180, 1.75, 50]])
    write_points(path, PointCloud(points, ("x", "y", "z", "intensity")))
    path.write_bytes(path.read_bytes().replace(b"VIEWPOINT 0 0 0", b"VIEWPOINT 100 200 1.75"))


def test_weather_gathers_about_the_viewpoint_and_the_file_keeps_its_frame(run: Any, tmp_path: Path) -> None:
    moved(tmp_path / "a.pcd")
    asked = ("apply", tmp_path / "a.pcd", *HDL, "-o", tmp_path / "out", "--lost", "zero")
    assert run(*asked, "--weather", "fog:mor=1e9")[0] == 0
    assert (tmp_path / "out" / "a.pcd").read_bytes() == (tmp_path / "a.pcd").read_bytes()
    assert run(*asked, "--weather", "fog:mor=20", "--seed", "3", "--labels", "npz")[0] == 0
    out = read_points(tmp_path / "out" / "a.pcd", viewpoint="ignore").points
    assert (out[:, :2] - torch.tensor([100.0, 200.0])).norm(dim=1).max() <= 30.0
    ranges = read_points(tmp_path / "out" / "a.pcd").points[:, :3].norm(dim=1)
    assert ranges.min() < 9.0  # fog before the targets
    # The same with the place given by hand.
    placed = ("--sensor-origin", "100", "200", "1.75")
    assert (
        run(*asked[:-4], "-o", tmp_path / "by_hand", *asked[-2:], *placed, "--weather", "fog:mor=20", "--seed", "3")[0]
        == 0
    )
    by_hand = read_points(tmp_path / "by_hand" / "a.pcd", viewpoint="ignore").points
    torch.testing.assert_close(by_hand, out, rtol=0, atol=2e-3)


def test_a_cloud_of_a_map_is_noticed(run: Any, tmp_path: Path) -> None:
    moved(tmp_path / "a.pcd")
    asked = (
        "apply",
        tmp_path / "a.pcd",
        *HDL,
        "--viewpoint",
        "ignore",
        "--weather",
        "fog:mor=50",
        "-o",
        tmp_path / "out",
    )
    code, _, said = run(*asked)
    assert code == 2
    assert "3 of 3 returns lie farther than 1.5 times the sensor's reach, 120 m" in said
    assert "--sensor-origin" in said
    code, _, said = run(*asked, "--force")
    assert code == 0
    assert "The cloud is in another frame" in said


def test_a_cloud_aside_of_its_origin_is_warned_of() -> None:
    rng = torch.Generator().manual_seed(0)
    sweep = torch.randn(2000, 4, generator=rng) * torch.tensor([12.0, 12.0, 1.0, 0.0]) + torch.tensor([0, 0, 0, 0.5])
    fog = LidarFog(Fog(mor_m=100.0), Lidar(905.0))
    fog(sweep, seed=1)
    for vehicle in (torch.tensor([90.0, 20.0, 0, 0]), torch.tensor([0.0, -85.0, 3.0, 0])):
        with pytest.warns(TorchweatherWarning, match="2000 returns lie aside"):
            fog(sweep + vehicle, seed=1)


@pytest.mark.parametrize("height_m", [1.7, 2.2])
def test_a_small_cloud_of_a_vehicle_whose_ground_is_at_the_origin_is_warned_of(height_m: float) -> None:
    """Half the returns are road, a tenth are walls; the sensor stands above the rear axle's ground."""
    rng = torch.Generator().manual_seed(0)
    angle, range_m = 6.28 * torch.rand(2000, generator=rng), 5 + 30 * torch.rand(2000, generator=rng)
    z = torch.where(torch.arange(2000) % 2 == 0, -height_m, 4 * torch.rand(2000, generator=rng) - height_m)
    own = torch.stack([range_m * angle.cos(), range_m * angle.sin(), z, torch.full_like(z, 0.4)], dim=1)
    fog = Fog(mor_m=200.0)
    LidarFog(fog, Lidar(905.0 + height_m))(own, seed=1)  # in the sensor's frame nothing is said
    own[:, 2] += height_m
    with pytest.warns(TorchweatherWarning, match="they look like the ground"):
        LidarFog(fog, Lidar(903.0 + height_m))(own, seed=1)
    LidarFog(fog, Lidar(902.0 + height_m, origin_m=(0.0, 0.0, height_m)))(own, seed=1)
    own[:, 2] = 0.0  # a scanner of one plane
    LidarFog(fog, Lidar(901.0 + height_m))(own, seed=1)


def test_metrics_take_the_columns_as_stated(run: Any, tmp_path: Path) -> None:
    five_columns(tmp_path / "a.bin")
    asked = ("metrics", tmp_path / "a.bin", tmp_path / "a.bin", "--metrics", "rmse", "--json")
    code, _, said = run(*asked)
    assert code == 2
    assert f"--bin-columns {COLUMNS}" in said
    code, out, _ = run(*asked, "--bin-columns", COLUMNS)
    assert code == 0
    assert "0.0" in out
