"""``--sensor-origin`` and ``--sensor-pose``: clouds in the vehicle's frame on the command line."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from tests.lidar.sweep.test_sensor_origin import WAYMO_M
from tests.lidar.sweep.test_sensor_origin import cloud as sweep_at
from torchweather.atmosphere.weather import parse_weather
from torchweather.io import read_points, write_points
from torchweather.sensors import Lidar
from torchweather.transforms import LidarWeather

STORM = "snow:rate=2"
HDL = ("--sensor", "lidar:velodyne-hdl-64e", "--intensity-unit", "reflectivity", "--quiet")
PLACE = ("--sensor-origin", *map(str, WAYMO_M))
POSE = np.array([[0.0, -1.0, 0.0, 1.43], [1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, 2.18], [0.0, 0.0, 0.0, 1.0]])


def written(folder: Path, points: Tensor) -> Path:
    write_points(folder / "top.bin", points)
    return folder / "top.bin"


def expected(points: Tensor, sensor: Lidar) -> Tensor:
    transform = LidarWeather(parse_weather(STORM), sensor)
    result = transform.run(points, transform.draw(points, seed=0)).points
    assert isinstance(result, Tensor)
    return result


def points_of(path: Path) -> Tensor:
    return read_points(path, intensity="auto").points


def test_apply_puts_the_weather_about_the_sensor(run: Any, tmp_path: Path) -> None:
    path = written(tmp_path, sweep_at(WAYMO_M)[:, :4])
    code, _, err = run("apply", path, "-o", tmp_path / "out", "--weather", STORM, *HDL, *PLACE)
    assert code == 0, err
    sensor = Lidar.preset("velodyne-hdl-64e", intensity_unit="reflectivity", origin_m=WAYMO_M)
    assert torch.equal(points_of(tmp_path / "out" / "top.bin"), expected(points_of(path), sensor))


def test_apply_takes_a_pose_from_a_file(run: Any, tmp_path: Path) -> None:
    path = written(tmp_path, sweep_at(WAYMO_M)[:, :4])
    np.save(tmp_path / "pose.npy", POSE)
    given = ("--sensor-pose", tmp_path / "pose.npy")
    code, _, err = run("apply", path, "-o", tmp_path / "out", "--weather", STORM, *HDL, *given)
    assert code == 0, err
    sensor = Lidar.preset("velodyne-hdl-64e", intensity_unit="reflectivity").with_pose(torch.from_numpy(POSE))
    assert torch.equal(points_of(tmp_path / "out" / "top.bin"), expected(points_of(path), sensor))


def test_view_shows_the_cloud_from_the_sensor(run: Any, tmp_path: Path) -> None:
    """Counts by range do not depend on the frame of the cloud."""
    rows = []
    for name, shift_m, place in (("own", (0.0, 0.0, 0.0), ()), ("vehicle", WAYMO_M, PLACE)):
        folder = tmp_path / name
        folder.mkdir()
        path = written(folder, sweep_at(shift_m)[:, :4])
        page = folder / "page.html"
        code, out, err = run("view", path, "-o", page, "--weather", "fog:mor=100", *HDL, *place, "--json")
        assert code == 0, err
        rows.append({key: json.loads(out)[key] for key in ("points", "objects", "particles", "lost")})
    # Rounding of the moved cloud may tip a beam on the threshold.
    for key, value in rows[0].items():
        assert rows[1][key] == pytest.approx(value, abs=5), key


@pytest.mark.long  # beside clouds in frames of their own in tests/lidar/sweep/test_sensor_origin.py
def test_scores_of_a_sweep_do_not_depend_on_the_frame(run: Any, tmp_path: Path) -> None:
    tables = []
    for name, shift_m, place in (("own", (0.0, 0.0, 0.0), ()), ("vehicle", WAYMO_M, PLACE)):
        folder = tmp_path / name
        folder.mkdir()
        path = written(folder, sweep_at(shift_m)[::4, :4])
        weather = ("--weather", "fog:mor=200,50", "--seeds", 1)
        code, _, err = run("sweep", path, "-o", folder / "s", *weather, *HDL, *place)
        assert code == 0, err
        rows = csv.DictReader((folder / "s" / "scores.csv").read_text().splitlines())
        tables.append({(row["severity"], row["metric"]): float(row["score"]) for row in rows})
    assert tables[1] == pytest.approx(tables[0], rel=1e-3)


def test_both_ways_at_once_are_refused(run: Any, tmp_path: Path) -> None:
    path = written(tmp_path, sweep_at(WAYMO_M)[:, :4])
    np.save(tmp_path / "pose.npy", POSE)
    code, _, err = run(
        "apply", path, "-o", tmp_path / "out", "--weather", STORM, *HDL, *PLACE, "--sensor-pose", tmp_path / "pose.npy"
    )
    assert code == 2
    assert "give one of them" in err


def test_a_file_without_a_pose_is_named(run: Any, tmp_path: Path) -> None:
    path = written(tmp_path, sweep_at(WAYMO_M)[:, :4])
    (tmp_path / "pose.txt").write_text("1 2 3")
    code, _, err = run(
        "apply", path, "-o", tmp_path / "out", "--weather", STORM, *HDL, "--sensor-pose", tmp_path / "pose.txt"
    )
    assert code == 2
    assert "pose.txt: expected T_cloud_from_sensor" in err


def test_the_place_of_a_lidar_is_none_of_a_camera(run: Any, tmp_path: Path) -> None:
    code, _, err = run(
        "sweep", "-o", tmp_path / "s", "--sensor", "camera", "--weather", "fog:mor=100", "--sensor-origin", 1, 2, 3
    )
    assert code == 2
    assert "--sensor-origin" in err


def test_apply_tells_of_a_cloud_in_the_vehicles_frame(run: Any, tmp_path: Path) -> None:
    path = written(tmp_path, sweep_at(WAYMO_M)[:, :4])
    sensor = ("--sensor", "lidar:velodyne-hdl-64e", "--intensity-unit", "reflectivity", "--max-range-m", "118.5")
    code, _, err = run("apply", path, "-o", tmp_path / "out", "--weather", STORM, *sensor)
    assert code == 0
    assert "torchweather: warning: LidarWeather: The cones of 32 rings (file order) meet in (1.43" in err
    assert "--sensor-origin 1.43" in err
