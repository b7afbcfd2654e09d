"""KITTI files: columns, calibration chain, and alignment on a real frame."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch

from torchweather.core.errors import TorchweatherError
from torchweather.datasets import read_kitti_calibration, read_kitti_points, read_kitti_rectified_from_lidar
from torchweather.image import project_points
from torchweather.io import read_image

P2 = "721.5377 0.0 609.5593 44.85728 0.0 721.5377 172.854 0.2163791 0.0 0.0 1.0 0.002745884"


def test_cloud_has_four_columns(tmp_path: Path) -> None:
    cloud = np.arange(12, dtype=np.float32).reshape(3, 4)
    cloud.tofile(tmp_path / "x.bin")
    assert torch.equal(read_kitti_points(tmp_path / "x.bin"), torch.from_numpy(cloud))


@pytest.mark.parametrize("size", [0, 17, 24])
def test_truncated_cloud_is_named(tmp_path: Path, size: int) -> None:
    (tmp_path / "x.bin").write_bytes(bytes(size))
    with pytest.raises(TorchweatherError, match=rf"x\.bin.*16 bytes each; got {size} bytes"):
        read_kitti_points(tmp_path / "x.bin")


def test_missing_and_nan_clouds_are_named(tmp_path: Path) -> None:
    with pytest.raises(TorchweatherError, match="cannot be read"):
        read_kitti_points(tmp_path / "none.bin")
    np.full((2, 4), np.nan, np.float32).tofile(tmp_path / "x.bin")
    with pytest.raises(TorchweatherError, match="finite"):
        read_kitti_points(tmp_path / "x.bin")


def test_full_calibration_chains_rectification_and_camera_offset(tmp_path: Path) -> None:
    text = f"P0: {P2}\nP2: {P2}\nR0_rect: 1 0 0 0 1 0 0 0 1\nTr_velo_to_cam: 0 -1 0 0 0 0 -1 -0.08 1 0 0 -0.27\n\n"
    (tmp_path / "c.txt").write_text(text)
    found = read_kitti_calibration(tmp_path / "c.txt")
    assert found.assumption == ""
    camera = found.camera(1242, 375)
    assert camera.intrinsics == (721.5377, 721.5377, 609.5593, 172.854)
    # K^-1 p: the left colour camera stands 6 cm beside the reference camera.
    point = found.T_camera_from_lidar @ torch.tensor([10.0, 1.0, -1.0, 1.0], dtype=torch.float64)
    projected = torch.tensor([float(v) for v in P2.split()], dtype=torch.float64).view(3, 4) @ torch.tensor(
        [-1.0, 0.92, 9.73, 1.0], dtype=torch.float64
    )
    x, y, depth, _ = project_points(
        torch.tensor([[10.0, 1.0, -1.0]], dtype=torch.float64), found.T_camera_from_lidar, camera
    )
    assert point[2].item() == pytest.approx(projected[2].item())
    assert (x.item(), y.item()) == pytest.approx((projected[:2] / projected[2]).tolist(), abs=1e-9)
    assert depth.item() == pytest.approx(projected[2].item())


def test_labels_are_placed_in_the_rectified_frame_of_camera_0(tmp_path: Path) -> None:
    """First to the camera (z ahead), then a rectification by a quarter turn about z; no way on to camera 2."""
    text = f"P2: {P2}\nR0_rect: 0 -1 0 1 0 0 0 0 1\nTr_velo_to_cam: 0 -1 0 0 0 0 -1 -0.08 1 0 0 -0.27\n"
    (tmp_path / "c.txt").write_text(text)
    point = torch.tensor([10.0, 1.0, -1.0, 1.0], dtype=torch.float64)
    # By hand: (-1, 1 - 0.08, 10 - 0.27) in the camera, x and y turned.
    placed = read_kitti_rectified_from_lidar(tmp_path / "c.txt") @ point
    assert placed.tolist() == pytest.approx([-0.92, -1.0, 9.73, 1.0])
    # P2's own offset: K^-1 p.
    seen = read_kitti_calibration(tmp_path / "c.txt").T_camera_from_lidar @ point
    assert (seen - placed)[2].item() == pytest.approx(0.002745884)
    (tmp_path / "d.txt").write_text("R0_rect: 1 0 0 0 1 0 0 0 1\nTr_velo_to_cam: 1 2 3")
    with pytest.raises(TorchweatherError, match="12 in Tr_velo_to_cam"):
        read_kitti_rectified_from_lidar(tmp_path / "d.txt")


def test_bare_projection_says_what_it_assumes(tmp_path: Path) -> None:
    (tmp_path / "c.txt").write_text(f"{P2} 0.0 0.0 0.0 1.0")
    found = read_kitti_calibration(tmp_path / "c.txt")
    assert "2011_09_26" in found.assumption
    rotation = found.T_camera_from_lidar[:3, :3]
    torch.testing.assert_close(rotation @ rotation.T, torch.eye(3, dtype=torch.float64), rtol=0, atol=1e-6)
    # Velodyne x forward, y left, z up: forward is the camera's z, left is -x, up is -y, within a degree.
    axes = torch.tensor([[0.0, -1, 0], [0, 0, -1], [1, 0, 0]], dtype=torch.float64)
    assert (rotation - axes).abs().max() < 0.02


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "no numbers"),
        ("P2: 1 2 3", r"P2 \(3 numbers\)"),
        ("hello world", "hello"),
        (f"P2: {P2}\nR0_rect: 1 0 0\nTr_velo_to_cam: 1 0 0", "9 numbers in R0_rect"),
        ("P2: 0 0 0 0 0 0 0 0 0 0 0 0", "invertible"),
    ],
)
def test_broken_calibration_is_named(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "c.txt").write_text(text)
    with pytest.raises(TorchweatherError, match=message):
        read_kitti_calibration(tmp_path / "c.txt")


RECT = "0.8 -0.6 0 0.6 0.8 0 0 0 1"  # far from the identity: used where it does not belong, it would show
VELO = "0 -1 0 0.1 0 0 -1 -0.2 1 0 0 -0.3"


@pytest.mark.parametrize(
    ("name", "text", "rectified"),
    [
        ("000001.txt", f"P2: {P2}\nR0_rect: {RECT}\nTr_velo_to_cam: {VELO}\nTr_imu_to_velo: {VELO}\n", True),
        ("0001.txt", f"P2: {P2}\nR_rect {RECT}\nTr_velo_cam {VELO}\nTr_imu_velo {VELO}\n", True),
        ("calib.txt", f"P0: {P2}\nP2: {P2}\nTr: {VELO}\n", False),
        ("calib_cam_to_cam.txt", f"calib_time: 09-Jan-2012 13:57:47\nP_rect_02: {P2}\nR_rect_00: {RECT}\n", True),
        ("calib_velo_to_cam.txt", "", True),
    ],
)
def test_every_kit_has_its_own_way_from_the_velodyne(tmp_path: Path, name: str, text: str, rectified: bool) -> None:
    if "cam" in name:
        content = f"calib_time: 09-Jan-2012 13:57:47\nP_rect_02: {P2}\nR_rect_00: {RECT}\n"
        (tmp_path / "calib_cam_to_cam.txt").write_text(content)
        velodyne = "calib_time: 15-Mar-2012 11:37:16\nR: 0 -1 0 0 0 -1 1 0 0\nT: 0.1 -0.2 -0.3\n"
        (tmp_path / "calib_velo_to_cam.txt").write_text(velodyne)
    else:
        (tmp_path / name).write_text(text)
    found = read_kitti_calibration(tmp_path / name)
    assert found.assumption == ""
    placed = read_kitti_rectified_from_lidar(tmp_path / name) @ torch.tensor([30.0, 5, 0, 1], dtype=torch.float64)
    # By hand: (-5 + 0.1, -0.2, 30 - 0.3) in the camera, turned by RECT where the kit has one.
    x, y, z = -4.9, -0.2, 29.7
    wanted = [0.8 * x - 0.6 * y, 0.6 * x + 0.8 * y, z] if rectified else [x, y, z]
    assert placed[:3].tolist() == pytest.approx(wanted)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (f"P2: {P2}\n", "no R0_rect and no Tr_velo_to_cam"),
        (f"P2: {P2}\nR0_rect: {RECT}\n", "no Tr_velo_to_cam. Another day's"),
        (f"P2: {P2}\nTr_velo_to_cam: {VELO}\n", "no R0_rect. Another day's"),
        (f"P2: {P2}\nR0_rect: {RECT}\nTr_velo_to_cam: {VELO}\nTr: {VELO}\n", "expected either Tr"),
        (f"P2: {P2}\nR0_rect: {RECT}\nTr: {VELO}\n", "expected either Tr"),
        (f"P2: {P2}\nTr: 1 1 0 0 0 0 -1 0 1 0 0 0\n", "expected a rotation in Tr"),
        (f"P2: {P2}\nTr: 0 1 0 0 0 0 -1 0 1 0 0 0\n", "right-handed"),
        (f"P2: {P2}\nTr: {VELO} 1\n", "12 in Tr"),
        (f"P2: {P2}\nP2: {P2}\nTr: {VELO}\n", r"P2 \(24 numbers\)"),
    ],
)
def test_no_transform_of_another_day_or_kit_is_taken(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "c.txt").write_text(text)
    with pytest.raises(TorchweatherError, match=message):
        read_kitti_calibration(tmp_path / "c.txt")


def test_the_raw_kit_needs_both_files(tmp_path: Path) -> None:
    (tmp_path / "calib_cam_to_cam.txt").write_text(f"P_rect_02: {P2}\nR_rect_00: {RECT}\n")
    with pytest.raises(TorchweatherError, match=r"keep calib_velo_to_cam\.txt beside"):
        read_kitti_calibration(tmp_path / "calib_cam_to_cam.txt")
    (tmp_path / "calib_velo_to_cam.txt").write_text("R: 1 2 3\n")
    with pytest.raises(TorchweatherError, match="9 numbers in R and 3 in T"):
        read_kitti_calibration(tmp_path / "calib_cam_to_cam.txt")


@pytest.mark.real_data
def test_real_cloud_was_cut_to_the_picture_that_it_projects_into(real_data: Callable[[str], Path]) -> None:
    """The demo cloud holds only what camera 2 sees: nearly all of it must fall inside, and fill the width."""
    points = read_kitti_points(real_data("kitti_nuscenes_demo/kitti/000008.bin"))
    image, _ = read_image(real_data("kitti_nuscenes_demo/kitti/000008.png"))
    assert image.shape == (3, 375, 1242)
    calibration = read_kitti_calibration(real_data("kitti_nuscenes_demo/kitti/000008.txt"))
    camera = calibration.camera(1242, 375)
    x, _, depth, seen = project_points(points.double(), calibration.T_camera_from_lidar, camera)
    assert seen.double().mean() > 0.98
    assert x[seen].min() < 5
    assert x[seen].max() > 1236
    assert 2 < depth[seen].min() < 10
