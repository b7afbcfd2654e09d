"""KITTI's other kits as folders: odometry with SemanticKITTI, tracking, raw; the right calibration for each."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import torch

from tests.datasets.augment.data_sets import BOTH, BOXES, CALIBRATION, FOG, cloud, image, recipe
from torchweather.camera.depth import CompletedDepth
from torchweather.core.errors import TorchweatherError
from torchweather.datasets import read_kitti_boxes
from torchweather.datasets.augment import Manifest, augment
from torchweather.datasets.augment.layouts import find_frames
from torchweather.io import PointLabels, read_labels, write_image, write_labels, write_points

P2, R0, TR = (line.partition(":")[2].strip() for line in CALIBRATION.splitlines())
# Of other numbers than KITTI's first day, so that no stand-in can pass: the Velodyne is 3 m above the camera.
SHIFTED = "0 -1 0 0 0 0 -1 3 1 0 0 -0.5"
ROTATION, SHIFT = "0 -1 0 0 0 -1 1 0 0", "0 3 -0.5"
KEYS = {"camera": "image", "lidar": "points"}


def frame(root: Path, camera: str, lidar: str, number: int = 0) -> None:
    for path in (camera, lidar):
        (root / path).parent.mkdir(parents=True, exist_ok=True)
    write_image(root / camera, image(number))
    write_points(root / lidar, cloud(number))


def text(root: Path, path: str, content: str) -> None:
    (root / path).parent.mkdir(parents=True, exist_ok=True)
    (root / path).write_text(content)


def odometry(root: Path) -> tuple[Path, str]:
    frame(root, "dataset/sequences/00/image_2/000000.png", "dataset/sequences/00/velodyne/000000.bin")
    text(root, "dataset/sequences/00/calib.txt", "".join(f"P{k}: {P2}\n" for k in range(4)) + f"Tr: {SHIFTED}\n")
    text(root, "dataset/sequences/00/times.txt", "0.0\n")
    (root / "dataset/sequences/00/labels").mkdir()
    classes = torch.full((300,), 40)
    write_labels(root / "dataset/sequences/00/labels/000000.label", PointLabels(classes, torch.zeros_like(classes)))
    return root, "dataset/sequences/00/000000"


def tracking(root: Path) -> tuple[Path, str]:
    frame(root, "training/image_02/0000/000000.png", "training/velodyne/0000/000000.bin")
    frame(root, "training/image_02/0000/000001.png", "training/velodyne/0000/000001.bin", 1)
    frame(root, "training/image_02/0001/000001.png", "training/velodyne/0001/000001.bin", 2)
    one = f"P0: {P2}\nP1: {P2}\nP2: {P2}\nP3: {P2}\nR_rect {R0}\nTr_velo_cam {SHIFTED}\nTr_imu_velo {SHIFTED}\n"
    text(root, "training/calib/0000.txt", one)
    text(root, "training/calib/0001.txt", one.replace("-1 3 1", "-1 9 1"))
    car = "Car 0 0 -1.57 10 10 20 20 1.60 1.80 4.00 0.00 4.00 19.50 -1.57"
    lines = [f"0 3 {car}", f"0 -1 {BOXES.splitlines()[2]}", f"1 3 {car.replace('19.50', '59.50')}"]
    text(root, "training/label_02/0000.txt", "\n".join(lines) + "\n")
    return root, "training/0000/000000"


def raw(root: Path) -> tuple[Path, str]:
    drive = "2011_09_28/2011_09_28_drive_0001_sync"
    frame(root, f"{drive}/image_02/data/0000000000.png", f"{drive}/velodyne_points/data/0000000000.bin")
    text(root, f"{drive}/image_02/timestamps.txt", "2011-09-28 12:02:07.8\n")
    cameras = f"calib_time: 09-Jan-2012 14:00:15\ncorner_dist: 9.95e-02\nR_rect_00: {R0}\nP_rect_02: {P2}\n"
    text(root, "2011_09_28/calib_cam_to_cam.txt", cameras + f"R_rect_02: {R0}\n")
    text(root, "2011_09_28/calib_velo_to_cam.txt", f"calib_time: 25-May-2012 16:47:16\nR: {ROTATION}\nT: {SHIFT}\n")
    return root, f"{drive}/0000000000"


@pytest.mark.parametrize("kit", [odometry, tracking, raw])
def test_a_kit_is_done_with_its_own_calibration(tmp_path: Path, kit: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    used: list[torch.Tensor] = []

    class Seen(CompletedDepth):
        def __init__(self, points: torch.Tensor, transform: torch.Tensor) -> None:
            used.append(transform)
            super().__init__(points, transform)

    monkeypatch.setattr("torchweather.datasets.augment.camera_file.CompletedDepth", Seen)
    root, name = kit(tmp_path / "clear")
    data = find_frames(root, KEYS, recipe="x")
    assert data.layout == "kitti"
    first = next(one for one in data.frames if one.name == name)
    assert {file.kind for file in first.files} == {"camera", "lidar"}
    assert first.calibration is not None
    summary = augment(root, tmp_path / "out", recipe(tmp_path, BOTH), workers=0)
    assert not summary.broken
    assert summary.frames == (3 if kit is tracking else 1)
    # A point 10 m ahead of the Velodyne, 3 m below the camera's height.
    seen = used[0] @ torch.tensor([10.0, 0, 0, 1], dtype=torch.float64)
    assert seen[:3].tolist() == pytest.approx([0.0, 3.0, 9.5], abs=1e-6)
    if kit is tracking:  # the other sequence has its own
        assert [round(float(one[1, 3])) for one in used] == [3, 3, 9]
    with Manifest(tmp_path / "out") as manifest:
        row = next(row for row in manifest.rows() if row.frame == name)
    assert set(first.reads) == set(row.inputs)
    if kit is raw:
        assert {"2011_09_28/calib_cam_to_cam.txt", "2011_09_28/calib_velo_to_cam.txt"} <= set(row.inputs)
    if kit is odometry:
        assert len(read_labels(tmp_path / "out/dataset/sequences/00/labels/000000.label", 300).classes) == 300
        assert (tmp_path / "out/dataset/sequences/00/times.txt").read_text() == "0.0\n"


def test_boxes_of_a_tracking_sequence_are_counted_frame_by_frame(tmp_path: Path) -> None:
    root, _ = tracking(tmp_path / "clear")
    augment(root, tmp_path / "out", recipe(tmp_path, FOG), workers=0)
    with Manifest(tmp_path / "out") as manifest:
        boxes = {row.frame: row.boxes for row in manifest.rows() if row.kind == "weather"}
    (car,) = boxes["training/0000/000000"] or []
    assert car["points_before"] >= 50  # 20 m ahead of the Velodyne, where 50 points lie on it
    (car,) = boxes["training/0000/000001"] or []
    assert car["points_before"] < 5
    assert boxes["training/0001/000001"] is None  # no labels of that sequence
    assert (tmp_path / "out/training/label_02/0000.txt").read_text() == (
        root / "training/label_02/0000.txt"
    ).read_text()


def test_tracking_labels_need_the_frame_and_keep_the_track(tmp_path: Path) -> None:
    root, _ = tracking(tmp_path / "clear")
    path, eye = root / "training/label_02/0000.txt", torch.eye(4, dtype=torch.float64)
    found = read_kitti_boxes(path, eye, frame=1)
    assert found.names == ("Car",)
    assert found.records[0]["track_id"] == 3
    assert found.centre_m[0, 2].item() == pytest.approx(59.5)
    assert read_kitti_boxes(path, eye, frame=0).unplaced[0]["name"] == "DontCare"
    assert len(read_kitti_boxes(path, eye, frame=7)) == 0
    with pytest.raises(TorchweatherError, match=r"labels of the tracking kit.*frame=0"):
        read_kitti_boxes(path, eye)
    text(tmp_path, "object.txt", BOXES)
    with pytest.raises(TorchweatherError, match="Leave frame out"):
        read_kitti_boxes(tmp_path / "object.txt", eye, frame=0)


def test_a_kit_without_its_calibration_is_refused_by_name(tmp_path: Path) -> None:
    root, name = odometry(tmp_path / "clear")
    calibration = root / "dataset/sequences/00/calib.txt"
    calibration.write_text(f"P0: {P2}\nP2: {P2}\n")
    summary = augment(root, tmp_path / "out", recipe(tmp_path, BOTH), workers=0)
    assert "no R0_rect and no Tr_velo_to_cam" in summary.broken[name]
    calibration.unlink()
    summary = augment(root, tmp_path / "other", recipe(tmp_path, BOTH), workers=0)
    assert "calib.txt of the sequence (odometry)" in summary.broken[name]
    root, name = raw(tmp_path / "raw")
    (root / "2011_09_28/calib_velo_to_cam.txt").unlink()
    summary = augment(root, tmp_path / "third", recipe(tmp_path, BOTH), workers=0)
    assert "calib_velo_to_cam.txt beside" in summary.broken[name]
