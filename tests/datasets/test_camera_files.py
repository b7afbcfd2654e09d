"""Cameras from calibration files of KITTI, nuScenes, OpenCV, ROS and COLMAP; others are refused by name."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import torch

from torchweather.core.errors import TorchweatherError
from torchweather.datasets import read_kitti_calibration, read_kitti_points, read_kitti_rectified_from_lidar
from torchweather.datasets.camera_files import read_camera, read_camera_fields
from torchweather.image import project_points
from torchweather.sensors import Camera

P2 = "721.5377 0 609.5593 44.85728 0 721.5377 172.854 0.2163791 0 0 1 0.002745884"
K2 = (721.5377, 721.5377, 609.5593, 172.854)
R0 = "0.9999239 0.00983776 -0.007445048 -0.009869795 0.9999421 -0.004278459 0.007402527 0.004351614 0.9999631"
TR = (
    "7.533745e-03 -9.999714e-01 -6.166020e-04 -4.069766e-03 1.480249e-02 7.280733e-04 -9.998902e-01 -7.631618e-02 "
    "9.998621e-01 7.523790e-03 1.480755e-02 -2.717806e-01"
)
OPENCV = """%YAML:1.0
---
calibration_time: "Mon Jan  1 00:00:00 2024"
image_width: 1280
image_height: 720
camera_matrix: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 1.1586e+03, 0., 6.692e+02, 0., 1155.4, 390.8, 0., 0., 1. ]
distortion_coefficients: !!opencv-matrix
   rows: 5
   cols: 1
   dt: d
   data: [ -2.517e-01, 2.04e-02, -4e-4, 0., -6.3e-02 ]
avg_reprojection_error: 1.0
"""
ROS_FILE = """image_width: 640
image_height: 480
camera_name: front
camera_matrix:
  rows: 3
  cols: 3
  data: [500.0, 0.0, 320.5, 0.0, 501.0, 240.5, 0.0, 0.0, 1.0]
distortion_model: plumb_bob
distortion_coefficients:
  rows: 1
  cols: 5
  data: [-0.3, 0.1, 0.001, -0.002, 0.0]
projection_matrix:
  rows: 3
  cols: 4
  data: [400.0, 0.0, 320.0, 0.0, 0.0, 400.0, 240.0, 0.0, 0.0, 0.0, 1.0, 0.0]
"""
ROS_MESSAGE = """height: 480
width: 640
distortion_model: "plumb_bob"
D: [-0.3, 0.1, 0.001, -0.002, 0.0]
K: [500.0, 0.0, 320.5, 0.0, 501.0, 240.5, 0.0, 0.0, 1.0]
"""


def written(folder: Path, name: str, content: Any) -> Path:
    path = folder / name
    path.write_text(content if isinstance(content, str) else json.dumps(content))
    return path


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("000008.txt", f"P0: {P2}\nP1: {P2}\nP2: {P2}\nP3: {P2}\nR0_rect: {R0}\nTr_velo_to_cam: {TR}\n\n"),
        ("calib.txt", f"P0: {P2}\nP1: {P2}\nP2: {P2}\nP3: {P2}\nTr: {TR}"),
        ("0001.txt", f"P0: {P2}\nP2: {P2}\nR_rect {R0}\nTr_velo_cam {TR}\nTr_imu_velo {TR}"),
        ("bare.txt", P2),
    ],
)
def test_kitti_kits_without_size(tmp_path: Path, name: str, text: str) -> None:
    path = written(tmp_path, name, text)
    camera = read_camera(path, width=1242, height=375)
    assert (camera.width, camera.height, camera.intrinsics, camera.distorted) == (1242, 375, K2, False)
    with pytest.raises(TorchweatherError, match=r"holds no image size\. Give width and height"):
        read_camera(path)


def raw_kit(folder: Path) -> Path:
    numbers = TR.split()
    rotation, shift = " ".join(n for i, n in enumerate(numbers) if i % 4 < 3), " ".join(numbers[3::4])
    velodyne = f"calib_time: 15-Mar-2012 11:37:16\nR: {rotation}\nT: {shift}\ndelta_f: 0 0\n"
    written(folder, "calib_velo_to_cam.txt", velodyne)
    right = P2.replace("721.5377", "700.0")
    lines = (
        *("calib_time: 09-Jan-2012 13:57:47", "corner_dist: 9.950000e-02", f"R_rect_00: {R0}"),
        *("S_rect_02: 1.242000e+03 3.750000e+02", f"P_rect_02: {P2}", f"R_rect_02: {TR}"),
        *("S_rect_03: 1.242000e+03 3.750000e+02", f"P_rect_03: {right}"),
    )
    return written(folder, "calib_cam_to_cam.txt", "\n".join(lines))


def test_kittis_raw_kit_holds_the_size_and_the_velodyne_beside_it(tmp_path: Path) -> None:
    path = raw_kit(tmp_path)
    camera = read_camera(path)
    assert (camera.width, camera.height, camera.intrinsics) == (1242, 375, K2)
    assert read_camera(path, name="P3").fx == read_camera(path, name="image_03").fx == 700.0
    assert read_camera(path, width=621, height=188).fx == pytest.approx(721.5377 / 2)
    plain = written(tmp_path, "object.txt", f"P2: {P2}\nR0_rect: {R0}\nTr_velo_to_cam: {TR}")
    raw = read_kitti_calibration(path)
    assert raw.assumption == ""
    assert torch.equal(raw.T_camera_from_lidar, read_kitti_calibration(plain).T_camera_from_lidar)
    written(tmp_path, "calib_velo_to_cam.txt", "R: 1 2 3\nT: 1 2 3")
    with pytest.raises(TorchweatherError, match="9 numbers in R and 3 in T; got 3 and 3"):
        read_camera(path)


def test_odometrys_tr_goes_to_the_rectified_camera(tmp_path: Path) -> None:
    """R0_rect on top of it would tip the cloud by 12 px."""
    path = written(tmp_path, "calib.txt", f"P2: {P2}\nTr: {TR}")
    numbers = torch.tensor([float(word) for word in TR.split()], dtype=torch.float64).view(3, 4)
    assert torch.equal(read_kitti_rectified_from_lidar(path)[:3], numbers)
    assert read_kitti_calibration(path).assumption == ""
    with pytest.raises(TorchweatherError, match="12 in Tr; got 9 and 3"):
        read_kitti_calibration(written(tmp_path, "b.txt", f"P2: {P2}\nTr: 1 2 3"))


def test_frames_of_another_size_than_a_calibration_without_one_are_refused(tmp_path: Path) -> None:
    path = written(tmp_path, "c.txt", f"P2: {P2}")
    for width, height in ((621, 188), (2484, 750), (1242, 900)):
        with pytest.raises(TorchweatherError, match=r"not near the middle.*frames of another size"):
            read_camera(path, width=width, height=height)


POSE = [[0.0, -math.sin(0.1), math.cos(0.1), 1.7], [-1.0, 0.0, 0.0, 0.0], [0.0, -math.cos(0.1), -math.sin(0.1), 1.5]]
MATRIX = [[1266.4, 0.0, 816.3], [0.0, 1266.4, 491.5], [0.0, 0.0, 1.0]]


def test_mmdetections_nuscenes_frame(tmp_path: Path) -> None:
    other = [[800.0, 0.0, 800.0], [0.0, 800.0, 450.0], [0.0, 0.0, 1.0]]
    content = {
        "CAM_FRONT": {"cam2img": MATRIX, "cam2ego": [*POSE, [0, 0, 0, 1]]},
        "CAM_BACK": {"cam2img": other},
        "timestamp": 1.5,
    }
    path = written(tmp_path, "calib.json", content)
    camera = read_camera(path)
    assert (camera.width, camera.height, camera.intrinsics) == (1600, 900, (1266.4, 1266.4, 816.3, 491.5))
    # A camera that looks 0.1 rad down: the pose is Camera.camera_from_vehicle the other way round.
    assert (camera.height_m, camera.pitch_rad) == pytest.approx((1.5, -0.1))
    rows = torch.tensor(camera.camera_from_vehicle(), dtype=torch.float64)
    assert torch.allclose(rows.T, torch.tensor(POSE, dtype=torch.float64)[:, :3], atol=1e-12)
    assert read_camera(path, name="CAM_BACK").fx == 800.0
    assert "height_m" not in read_camera_fields(path, name="CAM_BACK")
    half = read_camera(path, width=800, height=450)
    assert (half.width, half.fx, half.height_m) == (800, 633.2, 1.5)
    with pytest.raises(TorchweatherError, match=r"'CAM_FRNT'; found CAM_FRONT, CAM_BACK\. Did you mean 'CAM_FRONT'"):
        read_camera(path, name="CAM_FRNT")
    with pytest.raises(TorchweatherError, match="1600 x 900 px, the frame has 1242 x 375, another aspect ratio"):
        read_camera(path, width=1242, height=375)


def test_nuscenes_table_with_quaternions(tmp_path: Path) -> None:
    """Axes swapped (w, x, y, z = 1/2, -1/2, 1/2, -1/2: the camera looks along the vehicle's x), then rolled."""
    half = math.sqrt(0.5)

    def times(a: tuple[float, ...], b: tuple[float, ...]) -> list[float]:
        (w, x, y, z), (p, q, r, s) = a, b
        return [
            w * p - x * q - y * r - z * s,
            w * q + x * p + y * s - z * r,
            w * r - x * s + y * p + z * q,
            w * s + x * r - y * q + z * p,
        ]

    level = [0.5, -0.5, 0.5, -0.5]
    rolled = times(tuple(level), (math.cos(0.05), 0.0, 0.0, math.sin(0.05)))  # 0.1 rad about the camera's z
    front = {"token": "a", "sensor_token": "s", "translation": [1.7, 0, 1.5], "rotation": level}
    lidar = {"token": "b", "sensor_token": "l", "translation": [0, 0, 1.8], "rotation": [half, 0, 0, -half]}
    records = [{**front, "camera_intrinsic": MATRIX}, {**lidar, "camera_intrinsic": []}]
    camera = read_camera(written(tmp_path, "calibrated_sensor.json", records))
    assert (camera.height_m, camera.pitch_rad, camera.roll_rad) == pytest.approx((1.5, 0.0, 0.0), abs=1e-12)
    records.append(records[0] | {"token": "c", "sensor_token": "t", "rotation": rolled})
    path = written(tmp_path, "calibrated_sensor.json", records)
    with pytest.raises(TorchweatherError, match=r"found 2 of 2 records with camera_intrinsic.*by its token"):
        read_camera(path)
    # Clockwise from behind: the camera's right, x, sinks; z into the scene turns x towards y, which is down.
    assert read_camera(path, name="c").roll_rad == pytest.approx(0.1)
    written(tmp_path, "sensor.json", [{"token": "s", "channel": "CAM_FRONT"}, {"token": "t", "channel": "CAM_BACK"}])
    assert read_camera(path, name="CAM_FRONT").roll_rad == pytest.approx(0.0, abs=1e-12)
    one = written(tmp_path, "one.json", records[0] | {"rotation": [0, 0, 0, 0]})
    with pytest.raises(TorchweatherError, match="expected rotation"):
        read_camera(one)


def test_opencv_yaml_with_its_own_header_and_tags(tmp_path: Path) -> None:
    camera = read_camera(written(tmp_path, "c.yml", OPENCV))
    assert (camera.width, camera.height, camera.intrinsics) == (1280, 720, (1158.6, 1155.4, 669.2, 390.8))
    # 4e-4 without a point is text in YAML 1.1.
    assert (camera.k1, camera.k2, camera.p1, camera.p2, camera.k3) == (-0.2517, 0.0204, -0.0004, 0.0, -0.063)
    assert read_camera(tmp_path / "c.yml", width=640, height=360).fx == 579.3


@pytest.mark.parametrize("text", [ROS_FILE, ROS_MESSAGE, ROS_MESSAGE.replace("K:", "k:").replace("D:", "d:")])
def test_ros_files_and_messages_of_raw_frames(tmp_path: Path, text: str) -> None:
    camera = read_camera(written(tmp_path, "front.yaml", text))
    assert (camera.width, camera.height, camera.intrinsics) == (640, 480, (500.0, 501.0, 320.5, 240.5))
    assert (camera.k1, camera.k2, camera.p1, camera.p2, camera.k3) == (-0.3, 0.1, 0.001, -0.002, 0.0)


@pytest.mark.parametrize(
    ("model", "parameters", "fields"),
    [
        ("SIMPLE_PINHOLE", "500 320 240", {}),
        ("PINHOLE", "500 501 320 240", {"fy": 501.0}),
        ("SIMPLE_RADIAL", "500 320 240 -0.1", {"k1": -0.1}),
        ("RADIAL", "500 320 240 -0.1 0.02", {"k1": -0.1, "k2": 0.02}),
        ("OPENCV", "500 500 320 240 -0.1 0.02 0.003 -0.004", {"k1": -0.1, "k2": 0.02, "p1": 0.003, "p2": -0.004}),
    ],
)  # fmt: skip
def test_colmaps_models_in_pixels_whose_centres_are_whole(
    tmp_path: Path, model: str, parameters: str, fields: dict[str, float]
) -> None:
    """COLMAP's first pixel has its centre at 0.5, so the middle of 640 px is 320 there and 319.5 here."""
    head = "# Camera list with one line of data per camera:\n#   CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]\n"
    path = written(tmp_path, "cameras.txt", f"{head}1 {model} 640 480 {parameters}\n")
    assert read_camera(path) == Camera(**{"width": 640, "height": 480, "fx": 500.0, "fy": 500.0, **fields})  # type: ignore[arg-type]


def test_one_of_colmaps_cameras_by_number_or_size(tmp_path: Path) -> None:
    text = "1 PINHOLE 640 480 500 500 320 240\n2 PINHOLE 320 240 260 260 160 120\n3 FULL_OPENCV 64 48 1 2 3 4\n"
    path = written(tmp_path, "cameras.txt", text)
    assert read_camera(path, name="2").fx == 260.0
    assert read_camera(path, width=640, height=480).fx == 500.0
    with pytest.raises(TorchweatherError, match=r"expected one camera; found 1, 2, 3\. Name one by its number"):
        read_camera(path)
    with pytest.raises(TorchweatherError, match=r"model FULL_OPENCV; supported are SIMPLE_PINHOLE, PINHOLE"):
        read_camera(path, name="3")


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("x.txt", "", "found an empty file; supported are KITTI"),
        ("x.txt", "hello world", "found text that begins with 'hello world'; supported are"),
        ("x.xml", "<?xml version='1.0'?>", "found XML"),
        ("x.json", "{", "expected JSON"),
        ("x.json", '{"a": 1}', "found JSON with the keys a"),
        ("x.json", "[]", "found a list"),
        ("x.json", '{"c": {"cam2img": [[1, 2], [3]]}}', "3 x 3, in c"),
        ("x.json", '{"c": {"cam2img": {"a": 1}}}', "3 x 3, in c"),
        ("x.json", '{"c": {"cam2img": [[1, 5, 2], [0, 1, 2], [0, 0, 1]]}}', "without skew"),
        ("x.yaml", "a: [1, 2]", "found YAML with a;"),
        ("x.yaml", "- 1", "found YAML with list"),
        ("x.yaml", "a: [", "expected YAML"),
        ("x.yaml", "K: !!python/object/apply:os.getcwd []", "expected YAML"),
        ("x.yaml", OPENCV.replace("rows: 3", "rows: 4"), "expected 12 numbers in the camera matrix; got 9"),
        ("x.yaml", OPENCV.replace("1155.4", ".nan"), "finite numbers in the camera matrix"),
        ("x.yaml", OPENCV.replace("1155.4", "true"), "finite numbers in the camera matrix; got True"),
        ("x.yaml", OPENCV.replace("1155.4", "-1155.4"), "fy must be above 0 px"),
        ("x.yaml", OPENCV.replace("1280", "0"), "width must be 1 px or more"),
        ("x.yaml", ROS_MESSAGE.replace("plumb_bob", "equidistant"), "distortion is equidistant"),
        ("x.yaml", ROS_MESSAGE.replace("0.0]\nK", "0.0, 0.2, 0.1, 0.0]\nK"), "a Camera has k1, k2, p1, p2, k3"),
        ("x.yaml", ROS_MESSAGE + "fisheye_model: 1", "distortion is fisheye"),
        ("x.txt", "1 PINHOLE 640 480 500 500 320", "expected width, height, fx, fy, cx, cy; got 640 480 500 500 320"),
        ("x.txt", "1 PINHOLE inf 480 500 500 320 240", "expected an image size in pixels; got inf x 480"),
        ("x.txt", "1 PINHOLE 640 480 500 500 nan 240", "cx must lie in"),
        ("x.txt", f"S_rect_02: 1242 1e999\nP_rect_02: {P2}", "S_rect_02 holds NaN or infinity"),
        ("x.txt", "1 OPENCV_FISHEYE 640 480 500 500 320 240 0 0 0 0", "COLMAP's model OPENCV_FISHEYE"),
        ("x.txt", "P0: 1 2 3", r"expected P2 of a KITTI calibration \(12 or 16 numbers\); found P0 \(3 numbers\)"),
    ],
)  # fmt: skip
def test_other_files_are_refused_by_what_they_are(tmp_path: Path, name: str, text: str, message: str) -> None:
    with pytest.raises(TorchweatherError, match=message) as raised:
        read_camera(written(tmp_path, name, text), width=640, height=480)
    assert name in str(raised.value)


def test_missing_binary_and_huge_files_are_refused(tmp_path: Path) -> None:
    with pytest.raises(TorchweatherError, match="no such file"):
        read_camera(tmp_path / "none.txt")
    (tmp_path / "cameras.bin").write_bytes(bytes(range(256)))
    with pytest.raises(TorchweatherError, match="found binary data"):
        read_camera(tmp_path / "cameras.bin")
    with pytest.raises(TorchweatherError, match="characters"):
        read_camera(written(tmp_path, "x.yaml", "a: 1\n" * 300_000))


@pytest.mark.real_data
def test_kitti_preset_is_the_calibration_of_the_data_set(real_data: Callable[[str], Path]) -> None:
    """Nine of the thirteen files; and the ground under the LiDAR is as far below as the preset says."""
    preset = Camera.preset("kitti")
    files = sorted(real_data("kitti_13/calib").iterdir())
    found = [read_camera(file, width=1242, height=375) for file in files]
    assert sum(camera.intrinsics == pytest.approx(preset.intrinsics, rel=1e-9) for camera in found) == 9
    assert all(camera.fx == pytest.approx(preset.fx, rel=0.021) for camera in found)
    heights = [ground_below(file, real_data(f"kitti_13/velodyne/{file.stem}.bin")) for file in files]
    assert torch.tensor(heights).median().item() == pytest.approx(preset.height_m, abs=0.03)  # 9 cm lie between frames


def ground_below(calibration: Path, cloud: Path) -> float:
    """Height of the camera over the lane ahead, metres: a plane, refitted to the points within 5 cm of it."""
    points = read_kitti_points(cloud).double()
    ones = torch.ones(len(points), 1, dtype=torch.float64)
    seen = torch.cat([points[:, :3], ones], dim=1) @ read_kitti_calibration(calibration).T_camera_from_lidar.T
    x, y, z = seen[:, 0], seen[:, 1], seen[:, 2]
    lane = seen[(z > 4) & (z < 20) & (x.abs() < 3) & (y > 1.4) & (y < 2.0), :3]
    for _ in range(10):
        design = torch.stack([torch.ones(len(lane), dtype=torch.float64), lane[:, 0], lane[:, 2]], dim=1)
        plane = torch.linalg.lstsq(design, lane[:, 1:2]).solution[:, 0]
        near = (lane[:, 1] - design @ plane).abs() < 0.05
        lane = lane[near] if bool(near.any()) else lane
    return float(plane[0])


@pytest.mark.real_data
def test_nuscenes_preset_is_the_calibration_of_a_keyframe(real_data: Callable[[str], Path]) -> None:
    found = read_camera(real_data("kitti_nuscenes_demo/nuscenes/*calib.json"))
    preset = Camera.preset("nuscenes-front")
    assert (found.width, found.height) == (preset.width, preset.height)
    assert found.intrinsics == pytest.approx(preset.intrinsics, rel=1e-12)
    assert found.height_m == pytest.approx(preset.height_m, abs=0.01)
    assert found.pitch_rad == pytest.approx(preset.pitch_rad, abs=1e-4)


@pytest.mark.real_data
def test_real_kitti_points_fall_into_the_picture(real_data: Callable[[str], Path]) -> None:
    file = real_data("kitti_nuscenes_demo/kitti/000008.txt")
    points = read_kitti_points(real_data("kitti_nuscenes_demo/kitti/000008.bin")).double()
    camera = read_camera(file, width=1242, height=375)
    seen = project_points(points, read_kitti_calibration(file).T_camera_from_lidar, camera)[3]
    assert seen.double().mean() > 0.98
