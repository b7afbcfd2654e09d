"""Guessed depth, horizon and own bonnet on real frames, compared with LiDAR.

Skipped, visibly, where ``TORCHWEATHER_REAL_DATA`` is unset. The limits are the figures of a plain minimum of ground,
walls and 60 m. The six KITTI frames are those that no parameter was chosen on.
"""

from __future__ import annotations

import statistics
from pathlib import Path

import pytest
import torch
from torch import Tensor

from tests.recordings import recording
from torchweather.camera.depth import DepthFromPoints
from torchweather.camera.depth.horizon import find_horizon
from torchweather.camera.depth.near_mask import find_near_mask
from torchweather.camera.depth.scene_prior import ScenePrior
from torchweather.datasets import read_kitti_calibration, read_kitti_points
from torchweather.io import read_image
from torchweather.sensors import Camera

pytestmark = pytest.mark.real_data

OTHERS = ("000001", "000004", "000006", "000019", "000021", "000076")
# Rows of the horizon at the principal point's column: planes through the road's LiDAR returns within 22 m
# (benchmarks/scene_prior.py).
HORIZON_ROWS = {"000001": 173.8, "000004": 175.0, "000006": 167.9, "000019": 181.9, "000021": 167.8, "000076": 168.2}


@pytest.fixture(scope="module")
def root() -> Path:
    return recording("kitti_13").parent


def frame(root: Path, name: str) -> tuple[Tensor, Camera, Tensor]:
    """Picture, camera, and depth at the pixels with a LiDAR return (``inf`` elsewhere)."""
    folder = root / "kitti_13"
    rgb = read_image(folder / "image_2" / f"{name}.png")[0]
    known = read_kitti_calibration(folder / "calib" / f"{name}.txt")
    height, width = rgb.shape[-2:]
    camera = known.camera(width, height, height_m=1.65)
    cloud = read_kitti_points(folder / "velodyne" / f"{name}.bin")
    return rgb, camera, DepthFromPoints(cloud, known.T_camera_from_lidar, fill="none")(camera, height, width)


@pytest.mark.long  # beside made streets in test_scene_prior.py
def test_guessed_depth_and_horizon_beat_a_plain_minimum_on_frames_not_used_for_choosing(root: Path) -> None:
    median, within_quarter, within_two, off_px = [], [], [], []
    for name in OTHERS:
        rgb, camera, returns = frame(root, name)
        scene = ScenePrior().scene(camera, *rgb.shape[-2:], image=rgb)
        there = torch.isfinite(returns) & (returns > 1.5)
        guessed, true = scene.depth_m[there].clamp(max=1e4), returns[there]
        ratio = torch.maximum(guessed / true, true / guessed)
        median.append(float(((guessed - true).abs() / true).median()))
        within_quarter.append(float((ratio < 1.25).double().mean()))
        within_two.append(float((ratio < 2.0).double().mean()))
        off_px.append(abs(find_horizon(rgb, camera).row - HORIZON_ROWS[name]))
        assert scene.near_mask is not None
        assert not scene.near_mask.any()
    assert statistics.mean(median) < 0.157
    assert statistics.mean(within_quarter) > 0.64
    assert statistics.mean(within_two) > 0.88
    assert statistics.mean(off_px) < 4.3


def test_the_bonnet_is_found_in_every_frame_that_shows_one_and_in_no_other(root: Path) -> None:
    folder = root / "dashcam_highway"
    shows_one = sorted({*folder.glob("*.jpg")} - {*folder.glob("p1_*.jpg")})
    if not shows_one:
        pytest.skip("TORCHWEATHER_REAL_DATA holds no dashcam_highway")
    others = [*folder.glob("p1_*.jpg"), *(root / "kitti_13/image_2").glob("*.png")]
    others += (root / "kitti_nuscenes_demo/nuscenes").glob("*.jpg")
    missed = [path.name for path in shows_one if not find_near_mask(read_image(path)[0]).any()]
    false_alarms = [path.name for path in others if find_near_mask(read_image(path)[0]).any()]
    assert (missed, false_alarms) == ([], [])


def test_the_bonnet_of_one_camera_keeps_its_place(root: Path) -> None:
    folder = root / "dashcam_highway"
    paths = sorted(folder.glob("straight_lines*.jpg")) + sorted(folder.glob("test?.jpg"))
    if not paths:
        pytest.skip("TORCHWEATHER_REAL_DATA holds no dashcam_highway")
    pictures = torch.stack([read_image(path)[0] for path in paths])
    together = find_near_mask(pictures)
    # 6.3 % of the picture, drawn by eye; a single picture may take a shadow or miss a wing.
    assert float(together.mean()) == pytest.approx(0.063, abs=0.003)
    for picture in pictures:
        assert float((find_near_mask(picture) - together).abs().mean()) < 0.01


def test_a_vanishing_point_beside_the_picture_is_found(root: Path) -> None:
    paths = sorted((root / "roadcam_fog/frames/20200216").glob("*.jpg"))[::8]
    if not paths:
        pytest.skip("TORCHWEATHER_REAL_DATA holds no roadcam_fog")
    camera = Camera.from_intrinsics(2104.0, 2104.0, 735.0, 492.0, 1471, 985, height_m=2.2)
    for path in paths:
        horizon = find_horizon(read_image(path)[0], camera)
        # By lane marks and lane widths: column 1619, row 424; 0.3 degrees are 11 px.
        assert (horizon.column, horizon.row) == pytest.approx((1619.0, 424.0), abs=11.0)
