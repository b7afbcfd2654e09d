"""Damage that the fuzzer met (tests/fuzz): each kind is refused in words or warned of by every reader."""

from __future__ import annotations

import gzip
import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from PIL import Image

from tests.datasets.augment.data_sets import nuscenes
from torchweather import datasets, io
from torchweather.atmosphere.weather import parse_weather
from torchweather.core.errors import InputTypeError, InputValueError, TorchweatherError, TorchweatherWarning
from torchweather.datasets.augment.layouts import find_frames
from torchweather.datasets.speeds import read_speeds, read_timestamps
from torchweather.io.exif import focal_from_exif
from torchweather.io.video import VideoReader, write_video

P2 = "P2: 700 0 600 45 0 700 180 0.2 0 0 1 0.003\n"
TR = "R0_rect: 1 0 0 0 1 0 0 0 1\nTr_velo_to_cam: 0 -1 0 0.1 0 0 -1 -0.3 1 0 0 -0.4\n"


@pytest.mark.parametrize("number", ["nan", "inf", "1e400"])
def test_calibrations_are_finite(tmp_path: Path, number: str) -> None:
    kitti = tmp_path / "calib.txt"
    kitti.write_text((P2 + TR).replace("0.3 1", f"0.3 1 0 0 {number}").replace("0 0 -0.4", ""))
    with pytest.raises(TorchweatherError, match=r"calib\.txt: "):
        datasets.read_kitti_calibration(kitti)
    matrix = [[float(number), 0, 8], [0, 20, 6], [0, 0, 1]]
    pose = torch.eye(4).tolist()
    (tmp_path / "a.json").write_text(json.dumps({"CAM_FRONT": {"cam2img": matrix, "lidar2cam": pose}}))
    with pytest.raises(TorchweatherError, match=r"a\.json: .*camera_matrix must be a finite number"):
        datasets.read_nuscenes_calibration(tmp_path / "a.json")
    for wrong in (torch.full((3, 3), float("nan")), torch.eye(4), torch.eye(3, dtype=torch.int64), [[1.0]]):
        with pytest.raises((InputValueError, InputTypeError), match="CameraLidarCalibration: camera_matrix must be"):
            datasets.CameraLidarCalibration(wrong, torch.eye(4))  # type: ignore[arg-type]


@pytest.mark.parametrize("place", [3, 4, 12, 15])
def test_labels_are_finite_in_every_number(tmp_path: Path, place: int) -> None:
    words = ["Car", "0", "0", "-1.57", "10", "10", "20", "20", "1.6", "1.8", "4", "0", "1", "20", "-1.57", "0.7"]
    words[place] = "1e400"
    (tmp_path / "a.txt").write_text(" ".join(words))
    with pytest.raises(TorchweatherError, match=r"line 1: .*infinity"):
        datasets.read_kitti_boxes(tmp_path / "a.txt", torch.eye(4))


def test_times_are_finite_and_have_no_zone(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("time_s,speed_m_per_s\n1e400,1\n1e400,2\n")
    with pytest.raises(TorchweatherError, match="times must be finite"):
        read_speeds(tmp_path / "a.csv")
    (tmp_path / "b.csv").write_text(",\n10\n")
    assert read_speeds(tmp_path / "b.csv").speed_m_per_s.tolist() == [10.0]
    (tmp_path / "t.txt").write_text("2011-09-26 13:02:25.9Z\n2011-09-26 13:02:26.9\n")
    with pytest.raises(TorchweatherError, match=r"expected dates .*13:02:25.9Z"):
        read_timestamps(tmp_path / "t.txt")


def test_json_that_is_nested_too_deep_is_refused(tmp_path: Path) -> None:
    (tmp_path / "a.json").write_text("[" * 100_000)
    with pytest.raises(TorchweatherError, match="nested too deep"):
        datasets.read_nuscenes_calibration(tmp_path / "a.json")
    matrix = [[20, 0, 8], [0, 20, 6], [0, 0, 1]]
    (tmp_path / "b.json").write_text(json.dumps([{"camera_intrinsic": matrix, "token": "a"}]))
    (tmp_path / "sensor.json").write_text("[" * 100_000)
    with pytest.raises(TorchweatherError, match=r"sensor\.json: .*nested too deep"):
        datasets.read_camera(tmp_path / "b.json", width=1600, height=900)


@pytest.mark.parametrize(
    ("table", "key", "value"),
    [
        ("calibrated_sensor", "token", "other"),
        ("calibrated_sensor", "rotation", [float("inf"), 0, 0, 0]),
        ("calibrated_sensor", "rotation", [0, 0, 0, 0]),
        ("calibrated_sensor", "camera_intrinsic", [[1, 2], [3]]),
        ("calibrated_sensor", "camera_intrinsic", "x"),
        ("ego_pose", "rotation", [1e308, 1e308, 0, 0]),
        ("ego_pose", "translation", [1e300, 0, 0]),
        ("ego_pose", "translation", [None, 0, 0]),
    ],
)
def test_damaged_tables_of_nuscenes_are_named(tmp_path: Path, table: str, key: str, value: Any) -> None:
    path = nuscenes(tmp_path) / f"v1.0-mini/{table}.json"
    rows = json.loads(path.read_text())
    rows[0][key] = value
    path.write_text(json.dumps(rows))
    with pytest.raises(TorchweatherError, match=r"v1\.0-mini"):
        find_frames(tmp_path, {"camera": "image", "lidar": "points"}, recipe="a", layout="nuscenes")


def counted(**more: Any) -> io.DropSpectrum:
    given: dict[str, Any] = {
        "counts": torch.ones(2, 2, 3),
        "edges_mm": torch.tensor([0.5, 1.0, 2.0]),
        "speed_m_per_s": torch.tensor([1.0, 3.0, 5.0]),
        "area_mm2": torch.full((2,), 5000.0),
        "time_s": torch.tensor([0.0, 60.0]),
        "duration_s": 60.0,
    }
    return io.spectrum_from_counts(**{**given, **more}, instrument="a")


def dropped(**more: Any) -> io.DropSpectrum:
    given: dict[str, Any] = {
        "diameter_mm": torch.tensor([1.0, 1.5]),
        "speed_m_per_s": torch.tensor([4.0, 5.4]),
        "area_mm2": torch.full((2,), 5000.0),
        "time_s": torch.tensor([0.0, 70.0]),
        "edges_mm": torch.tensor([0.5, 1.2, 2.0]),
        "duration_s": 60.0,
    }
    return io.spectrum_from_drops(**{**given, **more}, instrument="a")


@pytest.mark.parametrize(
    ("make", "more"),
    [
        (counted, {"counts": torch.full((2, 2, 3), float("inf"))}),
        (counted, {"counts": torch.full((2, 2, 3), -1.0)}),
        (counted, {"counts": torch.full((2, 2, 3), 1e308, dtype=torch.float64)}),
        (counted, {"counts": torch.ones(2, 3)}),
        (counted, {"counts": [[1.0]]}),
        (counted, {"edges_mm": torch.tensor([1.0, 1.0, 2.0])}),
        (counted, {"speed_m_per_s": torch.zeros(3)}),
        (counted, {"duration_s": 0.0}),
        (counted, {"fall_speed_tolerance": float("nan")}),
        (dropped, {"time_s": torch.tensor([0.0, 1e15])}),  # netCDF-3 with another unit
        (dropped, {"time_s": torch.tensor([0.0, float("nan")])}),
        (dropped, {"area_mm2": torch.zeros(2)}),
        (dropped, {"diameter_mm": torch.tensor(1.0)}),
        (dropped, {"speed_m_per_s": torch.ones(3)}),
    ],
)
def test_drops_are_finite_and_of_one_shape(make: Callable[..., io.DropSpectrum], more: dict[str, Any]) -> None:
    assert bool(make().density_per_m3_mm.isfinite().all())
    with pytest.raises((InputValueError, InputTypeError), match=r"spectrum_from_(counts|drops): "):
        make(**more)


def test_a_visibility_that_overflows_is_no_clear_air() -> None:
    assert parse_weather("fog:mor=inf").to_dict()["mor_m"] == float("inf")
    with pytest.raises(InputValueError, match=r"at most 1\.8e308"):
        parse_weather("fog:mor=1e400")


@pytest.mark.parametrize("suffix", [".csv", ".npz", ".pcd", ".ply"])
def test_positions_beyond_float32_are_refused(tmp_path: Path, suffix: str) -> None:
    points = torch.ones(3, 4, dtype=torch.float64)
    points[1, 2] = 1e200
    io.write_points(tmp_path / f"a{suffix}", points)
    with pytest.raises(TorchweatherError, match=r"got z = 1e\+200 in point 1"):
        io.read_points(tmp_path / f"a{suffix}")
    rows = torch.ones(3, 6, dtype=torch.float64)
    rows[2, 1] = -1e200
    if suffix in (".csv", ".npz", ".pcd"):
        io.write_radar(tmp_path / f"b{suffix}", rows)
        with pytest.raises(TorchweatherError, match=r"y_m = -1e\+200 in row 2"):
            io.read_radar(tmp_path / f"b{suffix}")


def test_depths_that_float32_cannot_hold(tmp_path: Path) -> None:
    np.save(tmp_path / "small.npy", np.array([[1e-300, 5.0]]))
    assert io.read_depth(tmp_path / "small.npy").isnan().tolist() == [[[True, False]]]
    np.save(tmp_path / "large.npy", np.array([[1e300, 5.0]]))
    with pytest.raises(TorchweatherError, match="above 3e38"):
        io.read_depth(tmp_path / "large.npy")


def test_damaged_tags_of_a_picture_are_warned_of_by_its_name(tmp_path: Path) -> None:
    picture = Image.fromarray(np.zeros((4, 6), np.uint8))
    tags = picture.getexif()
    tags[0x0112], tags[0x0131] = 6, "a camera"
    picture.save(tmp_path / "a.jpg", exif=tags.tobytes()[:24])
    with pytest.warns(TorchweatherWarning, match=r"a\.jpg: damaged: Corrupt EXIF data"):
        io.read_image(tmp_path / "a.jpg")


def test_a_focal_length_next_to_zero_is_no_view() -> None:
    found = focal_from_exif({0x920A: 1e-300, 0xA20E: 1e-300, 0xA210: 3}, 12, 10)
    assert found is not None
    assert found.focal_px is None


def test_a_video_with_text_that_is_no_unicode_is_read(tmp_path: Path) -> None:
    with write_video(tmp_path / "a.mp4", 16, 16, 10, comment="somewhere") as video:
        video.add(torch.zeros(3, 16, 16, dtype=torch.uint8))
    content = (tmp_path / "a.mp4").read_bytes()
    assert b"somewhere" in content
    (tmp_path / "a.mp4").write_bytes(content.replace(b"somewhere", b"\xf0\x00\xff\xfe\xf0\xf0\xf0\xf0\xf0"))
    assert len(list(VideoReader(tmp_path / "a.mp4"))) == 1


@pytest.mark.parametrize(
    "read", [io.read_image, io.read_points, io.read_table, io.read_depth, datasets.read_camera, io.read_disdrometer]
)
def test_named_pipes_are_refused_at_once(tmp_path: Path, read: Callable[[Path], Any]) -> None:
    for suffix in (".bin", ".csv", ".npz", ".yaml"):
        path = tmp_path / f"{read.__name__}{suffix}"
        os.mkfifo(path)
        with pytest.raises(TorchweatherError):
            read(path)


def test_a_packed_line_without_an_end_is_refused(tmp_path: Path) -> None:
    (tmp_path / "a.dat.gz").write_bytes(gzip.compress(bytes(4 << 20)))
    with pytest.raises(TorchweatherError, match="a line of more than"):
        io.read_disdrometer(tmp_path / "a.dat.gz")


def test_a_cloud_of_thousands_of_columns_is_refused(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text(",".join(f"c{k}" for k in range(200_000)) + "\n")
    with pytest.raises(TorchweatherError, match="got 200,000 columns"):
        io.read_points(tmp_path / "a.csv")
