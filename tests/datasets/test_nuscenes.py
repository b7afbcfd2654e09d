"""nuScenes files: columns, calibration, and a real frame."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch

from torchweather.core.errors import TorchweatherError
from torchweather.datasets import read_nuscenes_calibration, read_nuscenes_points
from torchweather.image import project_points
from torchweather.io import read_image

CAMERA_MATRIX = [[1266.0, 0.0, 816.0], [0.0, 1266.0, 491.0], [0.0, 0.0, 1.0]]
CAMERA_FROM_LIDAR = [[1.0, 0, 0, 0.01], [0, 0, -1, -0.33], [0, 1, 0, -0.43], [0, 0, 0, 1]]  # x right, y forward


def test_sweep_has_five_columns(tmp_path: Path) -> None:
    cloud = np.arange(10, dtype=np.float32).reshape(2, 5)
    cloud.tofile(tmp_path / "x.pcd.bin")
    assert torch.equal(read_nuscenes_points(tmp_path / "x.pcd.bin"), torch.from_numpy(cloud))
    (tmp_path / "x.pcd.bin").write_bytes(bytes(16))
    with pytest.raises(TorchweatherError, match="20 bytes each; got 16 bytes"):
        read_nuscenes_points(tmp_path / "x.pcd.bin")


def test_calibration_projects_a_point_ahead_below_the_principal_point(tmp_path: Path) -> None:
    (tmp_path / "c.json").write_text(
        json.dumps({"CAM_FRONT": {"cam2img": CAMERA_MATRIX, "lidar2cam": CAMERA_FROM_LIDAR}})
    )
    found = read_nuscenes_calibration(tmp_path / "c.json")
    x, y, depth, seen = project_points(
        torch.tensor([[0.0, 20.43, -1.33]]).double(), found.T_camera_from_lidar, found.camera(1600, 900)
    )
    assert (x.item(), y.item(), depth.item()) == pytest.approx((816 + 1266 * 0.01 / 20, 491 + 1266 * 1 / 20, 20.0))
    assert seen.all()


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("{", "expected JSON"),
        ("[]", "cameras none"),
        ('{"CAM_BACK": {"cam2img": 1}}', r"got cameras CAM_BACK"),
        ('{"CAM_FRONT": {"cam2img": [[1, 0], [0, 1]], "lidar2cam": [[1]]}}', "3 x 3"),
        ('{"CAM_FRONT": {"cam2img": [[1, 0], [0, 1]]}}', "KeyError: 'lidar2cam'"),
        ('{"CAM_FRONT": {"cam2img": "a", "lidar2cam": "b"}}', "expected numbers"),
    ],
)
def test_broken_calibration_is_named(tmp_path: Path, content: str, message: str) -> None:
    (tmp_path / "c.json").write_text(content)
    with pytest.raises(TorchweatherError, match=message):
        read_nuscenes_calibration(tmp_path / "c.json")
    with pytest.raises(TorchweatherError, match="no such file"):
        read_nuscenes_calibration(tmp_path / "none.json")


@pytest.mark.real_data
def test_real_sweep_falls_into_the_front_camera(real_data: Callable[[str], Path]) -> None:
    folder = "kitti_nuscenes_demo/nuscenes/"
    points = read_nuscenes_points(real_data(folder + "*.pcd.bin"))
    image, _ = read_image(real_data(folder + "*CAM_FRONT*.jpg"))
    calibration = read_nuscenes_calibration(real_data(folder + "*calib.json"))
    assert points.shape == (34688, 5)
    assert image.shape == (3, 900, 1600)
    seen = project_points(points.double(), calibration.T_camera_from_lidar, calibration.camera(1600, 900))[3]
    # 64 of 360 degrees, most beams below the horizon: a twelfth of the sweep or so.
    assert 0.05 < seen.double().mean() < 0.18
