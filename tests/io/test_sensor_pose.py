"""Where a sensor stands in its clouds, from the files in which tools keep it."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import torch
import yaml

from torchweather.core.errors import TorchweatherError
from torchweather.io import read_sensor_pose

# A quarter turn to the left, 1.43 m ahead and 2.18 m up.
POSE = [[0.0, -1.0, 0.0, 1.43], [1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, 2.18], [0.0, 0.0, 0.0, 1.0]]
FLAT = [value for row in POSE for value in row]
QUARTER = [2**-0.5, 0.0, 0.0, 2**-0.5]  # w, x, y, z


def text(values: list[float]) -> str:
    return " ".join(map(repr, values))


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("pose.txt", text(FLAT)),
        ("pose.txt", text(FLAT[:12])),
        ("pose.txt", "\n".join(",".join(map(str, row)) for row in POSE)),
        ("Tr.txt", f"T_cloud_from_sensor: {text(FLAT[:12])}\n"),
        ("pose.json", json.dumps(POSE)),
        ("pose.json", json.dumps(FLAT)),
        ("pose.json", json.dumps({"T_cloud_from_sensor": POSE})),
        ("frame.json", json.dumps({"name": "TOP", "extrinsic": {"transform": FLAT}})),
        ("sensor.json", json.dumps({"token": "a", "translation": [1.43, 0.0, 2.18], "rotation": QUARTER})),
        ("pose.yaml", yaml.safe_dump({"T_vehicle_from_lidar": POSE})),
        ("pose.yml", yaml.safe_dump({"translation": [1.43, 0, 2.18], "rotation": [row[:3] for row in POSE[:3]]})),
    ],
)
def test_forms_of_one_pose(tmp_path: Path, name: str, content: str) -> None:
    path = tmp_path / name
    path.write_text(content)
    assert torch.allclose(read_sensor_pose(path), torch.tensor(POSE, dtype=torch.float64), atol=1e-12)


@pytest.mark.parametrize("rows", [3, 4])
def test_a_numpy_array(tmp_path: Path, rows: int) -> None:
    np.save(tmp_path / "pose.npy", np.asarray(POSE, np.float32)[:rows])
    assert torch.allclose(read_sensor_pose(tmp_path / "pose.npy"), torch.tensor(POSE, dtype=torch.float64), atol=1e-6)


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("pose.txt", "1 2 3", "12 or 16 numbers.*got 3 numbers"),
        ("pose.txt", "one two", "could not convert"),
        ("pose.txt", text([2 * value for value in FLAT[:12]]), "expected a rotation"),
        ("pose.txt", text(torch.tensor(POSE).T.flatten().tolist()), "Is the matrix transposed"),
        ("pose.txt", text([float("nan"), *FLAT[1:12]]), "finite numbers"),
        ("pose.json", "{", "expected JSON with T_cloud_from_sensor"),
        ("pose.json", "{}", "got nothing"),
        ("pose.json", '{"cam2img": 1}', "got cam2img"),
        ("pose.json", '{"translation": [1, 2], "rotation": [1, 0, 0, 0]}', "expected T_cloud_from_sensor"),
        ("pose.yaml", "- [1, 2]", "expected a pose"),
        ("pose.npy", "text", "expected one array"),
    ],
)
def test_what_is_no_pose_is_refused_with_its_path(tmp_path: Path, name: str, content: str, message: str) -> None:
    path = tmp_path / name
    path.write_text(content)
    with pytest.raises(TorchweatherError, match=f"{name}.*{message}"):
        read_sensor_pose(path)


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(TorchweatherError, match=r"none\.txt: no such file"):
        read_sensor_pose(tmp_path / "none.txt")
