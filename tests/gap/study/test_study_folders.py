"""Studies out of folders as data sets have them: what comes over, what is lost, what is refused."""

from __future__ import annotations

import math
import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from tests.recordings import recording
from torchweather.atmosphere.weather import Fog, Rain
from torchweather.core.errors import TorchweatherError, TorchweatherWarning
from torchweather.gap.study.folders import study_from_folders, study_from_kitti
from torchweather.gap.study.scan_grid import scan_frame
from torchweather.gap.study.study import Study
from torchweather.io import PointCloud, write_image, write_points
from torchweather.sensors import Camera, Lidar, scan_directions

LIDAR = Lidar(905.0, elevations_deg=(-10.0, 0.0, 10.0), columns=90, azimuth_offsets_deg=(0.0, 1.0, -1.0))
CAMERA = Camera.from_intrinsics(20.0, 20.0, 3.0, 2.0, 7, 5, bit_depth=12, black_level=100.0, bayer_pattern="GRBG")
NAMES = ("x", "y", "z", "intensity")


def cloud(seed: int, *, share: float = 1.0) -> tuple[Tensor, Tensor, Tensor]:
    """Points of the sensor in a random order, and the ranges and intensities of its grid."""
    stream = torch.Generator().manual_seed(seed)
    beams = scan_directions(LIDAR, dtype=torch.float64)
    range_m = 10.0 + 10.0 * torch.rand(len(beams), generator=stream, dtype=torch.float64)
    range_m = range_m * (torch.rand(len(beams), generator=stream) < share)
    intensity = torch.rand(len(beams), generator=stream, dtype=torch.float64) * (range_m > 0)
    points = torch.cat([range_m[:, None] * beams, intensity[:, None]], -1)
    order = torch.randperm(len(beams), generator=stream)
    kept = order[range_m[order] > 0]
    return points[kept].float(), range_m.reshape(3, 90), intensity.reshape(3, 90)


# ---- points on the scan ----------------------------------------------------------------------------------------------


def test_a_cloud_of_the_scan_pattern_comes_back_on_its_grid_without_loss() -> None:
    points, range_m, intensity = cloud(0, share=0.7)
    frame, lost = scan_frame(PointCloud(points, NAMES), LIDAR, "cloud")
    assert lost == 0
    # float32 coordinates: 20 m to 2^-24 of it, three times over.
    assert np.allclose(frame["range_m"], range_m, atol=4e-6)
    assert np.allclose(frame["intensity"], intensity, atol=1e-7)


@pytest.mark.parametrize("share_of_step", [-0.49, -0.2, 0.2, 0.49])
def test_a_turn_that_begins_within_half_a_step_keeps_its_columns(share_of_step: float) -> None:
    points, range_m, _ = cloud(1)
    angle = math.radians(share_of_step * 4.0)
    turn = torch.tensor([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])
    turned = torch.cat([points[:, :2] @ turn.T, points[:, 2:]], -1)
    frame, lost = scan_frame(PointCloud(turned, NAMES), LIDAR, "cloud")
    assert lost == 0
    assert np.allclose(frame["range_m"], range_m, atol=1e-5)


def test_of_points_in_a_cell_the_one_at_its_centre_stays_and_of_one_beam_the_stronger() -> None:
    off = math.radians(1.5)  # of a step of 4 degrees
    points = torch.tensor(
        [[8.0 * math.cos(off), 8.0 * math.sin(off), 0.0, 0.9], [9.0, 0.0, 0.0, 0.2], [12.0, 0.0, 0.0, 0.3]]
    )
    lidar = replace(LIDAR, azimuth_offsets_deg=None)
    frame, lost = scan_frame(PointCloud(points, NAMES), lidar, "cloud")
    assert lost == 2
    assert frame["range_m"][1, 0] == 12.0
    assert np.count_nonzero(frame["range_m"]) == 1


def test_the_ring_of_the_file_counts_and_one_that_the_sensor_lacks_is_lost() -> None:
    points = torch.tensor([[10.0, 0.0, 0.0, 0.5, 0.0], [0.0, 10.0, 0.0, 0.5, 7.0]])
    frame, lost = scan_frame(PointCloud(points, (*NAMES, "ring")), LIDAR, "cloud")
    assert lost == 1
    assert frame["range_m"][0].max() == 10.0  # by its elevation it would be ring 1


def test_no_returns_are_not_counted_as_lost() -> None:
    points = torch.tensor([[0.0, 0.0, 0.0, 0.0], [0.5, 0.0, 0.0, 0.5], [10.0, 0.0, 0.0, 0.5]])
    frame, lost = scan_frame(PointCloud(points, NAMES), replace(LIDAR, min_range_m=1.0), "cloud")
    assert lost == 0
    assert np.count_nonzero(frame["range_m"]) == 1


def test_a_sensor_without_a_pattern_is_refused_for_unorganised_clouds() -> None:
    with pytest.raises(TorchweatherError, match=r"cloud: an unorganised cloud needs the sensor's scan pattern"):
        scan_frame(PointCloud(torch.ones(1, 4), NAMES), Lidar(905.0), "cloud")


# ---- a clear folder and measured ones --------------------------------------------------------------------------------


def write_clouds(folder: Path, seeds: range, suffix: str = ".bin", share: float = 1.0) -> None:
    folder.mkdir(parents=True)
    for seed in seeds:
        write_points(folder / f"{seed:06d}{suffix}", cloud(seed, share=share)[0])


@pytest.mark.parametrize("suffix", [".bin", ".pcd", ".ply", ".csv", ".npz"])
def test_a_pair_of_folders_of_clouds_is_a_study(tmp_path: Path, suffix: str) -> None:
    write_clouds(tmp_path / "clear", range(3), suffix)
    write_clouds(tmp_path / "rain_25", range(3, 5), suffix)
    found = study_from_folders(tmp_path / "clear", {tmp_path / "rain_25": "rain:rate=25"}, LIDAR, rel_sd=0.1)
    assert found.beams["direction"].shape == (3, 90, 3)
    assert len(found.scenes["s0"].clear) == 3
    (one,) = found.conditions
    assert (one.id, one.weather, one.rel_sd, len(one.frames)) == ("rain_25", Rain(25.0), 0.1, 2)
    assert np.allclose(one.frames[1]["range_m"], cloud(4)[1], atol=4e-6)
    # Written and read, it is the same study.
    found.write(tmp_path / "study")
    assert Study.read(tmp_path / "study").sha256 == found.sha256


def test_lost_points_are_told(tmp_path: Path) -> None:
    write_clouds(tmp_path / "clear", range(2))
    write_clouds(tmp_path / "fog", range(2, 3))
    coarse = replace(LIDAR, columns=45)
    with pytest.warns(TorchweatherWarning, match=r"405 of 810 points \(50.0 %\) share a beam of .* 3 x 45"):
        study_from_folders(tmp_path / "clear", {tmp_path / "fog": Fog(50.0)}, coarse)


def organised(folder: Path, seeds: range, share: float) -> None:
    folder.mkdir()
    beams = scan_directions(LIDAR, dtype=torch.float64)
    for seed in seeds:
        _, range_m, intensity = cloud(seed, share=share)
        rows = torch.cat([range_m.reshape(-1, 1) * beams, intensity.reshape(-1, 1)], -1)
        write_points(folder / f"{seed}.pcd", PointCloud(rows, NAMES, grid=(3, 90)))


def test_organised_clouds_keep_their_grid_and_tell_their_directions(tmp_path: Path) -> None:
    organised(tmp_path / "clear", range(4), 0.8)
    organised(tmp_path / "fog", range(4, 6), 0.5)
    bare = Lidar(905.0)  # no pattern is needed
    found = study_from_folders(tmp_path / "clear", {tmp_path / "fog": Fog(50.0)}, bare)
    assert np.allclose(found.conditions[0].frames[0]["range_m"], cloud(4, share=0.5)[1], atol=1e-6)
    truth = scan_directions(LIDAR, dtype=torch.float64).reshape(3, 90, 3).numpy()
    seen = np.any([cloud(k, share=0.8 if k < 4 else 0.5)[1].numpy() > 0 for k in range(6)], axis=0)
    assert np.allclose(found.beams["direction"][seen], truth[seen], atol=1e-7)
    given = study_from_folders(tmp_path / "clear", {tmp_path / "fog": Fog(50.0)}, bare, directions=truth)
    assert np.array_equal(given.beams["direction"], truth)


def test_a_cell_without_any_return_points_along_its_row_and_column(tmp_path: Path) -> None:
    lidar = replace(LIDAR, azimuth_offsets_deg=None)
    beams = scan_directions(lidar, dtype=torch.float64)
    for folder in ("clear", "fog"):
        (tmp_path / folder).mkdir()
        for k in range(2):
            range_m = torch.full((270, 1), 9.0 + k, dtype=torch.float64)
            range_m[100] = 0.0
            rows = torch.cat([range_m * beams, range_m / 20], -1)
            write_points(tmp_path / folder / f"{k}.pcd", PointCloud(rows, NAMES, grid=(3, 90)))
    found = study_from_folders(tmp_path / "clear", {tmp_path / "fog": "fog:mor=50"}, Lidar(905.0))
    assert np.allclose(found.beams["direction"].reshape(-1, 3)[100], beams[100], atol=1e-6)


def test_a_row_without_any_return_needs_directions(tmp_path: Path) -> None:
    (tmp_path / "clear").mkdir()
    rows = torch.zeros(8, 4)
    rows[:4, 0] = 5.0
    write_points(tmp_path / "clear" / "0.pcd", PointCloud(rows, NAMES, grid=(2, 4)))
    with pytest.raises(TorchweatherError, match=r"row 1 of the organised clouds has no return.*Give directions"):
        study_from_folders(tmp_path / "clear", {tmp_path / "clear": "fog:mor=50"}, Lidar(905.0))


def raw_frames(folder: Path, values: list[int]) -> None:
    folder.mkdir()
    for value in values:
        write_image(folder / f"{value}.png", torch.full((1, 5, 7), value, dtype=torch.uint16))


def test_raw_frames_become_linear_and_lose_an_odd_row_and_column(tmp_path: Path) -> None:
    raw_frames(tmp_path / "clear", [100, 2098])
    raw_frames(tmp_path / "fog", [50, 4095])
    depth = np.arange(1.0, 36.0).reshape(5, 7)
    found = study_from_folders(tmp_path / "clear", {tmp_path / "fog": "fog:mor=50"}, CAMERA, depth=depth)
    assert isinstance(found.sensor, Camera)
    assert (found.sensor.height, found.sensor.width, found.sensor.cx) == (4, 6, CAMERA.cx)
    assert np.array_equal(found.scenes["s0"].geometry["depth_m"], depth[:4, :6])
    levels = [float(frame["bayer"][0, 0]) for frame in (*found.scenes["s0"].clear, *found.conditions[0].frames)]
    # Sorted by name: 100, 2098; 4095, 50. Black is 100, white 4095; below black is cut.
    assert levels == pytest.approx([0.0, 1998 / 3995, 1.0, 0.0], abs=1e-7)


def test_colour_images_are_decoded_and_sampled_by_the_filter_array(tmp_path: Path) -> None:
    for folder in ("clear", "fog"):
        (tmp_path / folder).mkdir()
        for k in range(2):
            colour = torch.tensor([255, 188, 0], dtype=torch.uint8)[:, None, None].expand(3, 5, 7)
            write_image(tmp_path / folder / f"{k}.png", colour)
        (tmp_path / folder / "._0.png").write_bytes(b"Mac OS X")  # no frame
    found = study_from_folders(tmp_path / "clear", {tmp_path / "fog": "fog:mor=50"}, CAMERA, depth=20.0)
    cell = found.conditions[0].frames[0]["bayer"][:2, :2]
    # GRBG; sRGB 188 is 0.503 of the light.
    assert cell == pytest.approx(np.array([[0.503, 1.0], [0.0, 0.503]]), abs=1e-3)


# ---- KITTI -----------------------------------------------------------------------------------------------------------


def kitti(root: Path, table: str, frames: int = 8) -> Path:
    write_clouds(root / "velodyne", range(frames))
    (root / "weather.csv").write_text(table)
    return root


TABLE = """frame,weather,value,scene,rel_sd,time_s
000000,clear,,a,,
000001,clear,,a,,
000002,clear,,b,,
000003,clear,,b,,
000004,rain,25,a,0.1,0.0
000005,rain,25,a,0.1,0.1
000006,fog,50,b,,
000007,rain,5,a,0.1,
"""


def test_kitti_s_folder_and_a_table_are_a_study(tmp_path: Path) -> None:
    found = study_from_kitti(kitti(tmp_path, TABLE), LIDAR)
    assert {name: len(one.clear) for name, one in found.scenes.items()} == {"a": 2, "b": 2}
    rows = [(one.id, one.scene, one.weather, one.rel_sd, len(one.frames), one.split) for one in found.conditions]
    assert rows == [
        ("a-rain-25", "a", Rain(25.0), 0.1, 2, "holdout"),
        ("b-fog-50", "b", Fog(50.0), 0.0, 1, "fit"),
        ("a-rain-5", "a", Rain(5.0), 0.1, 1, "fit"),
    ]
    assert found.conditions[0].time_s is not None
    assert found.conditions[0].time_s.tolist() == [0.0, 0.1]
    assert np.allclose(found.conditions[1].frames[0]["range_m"], cloud(6)[1], atol=4e-6)


def test_frames_named_by_number_are_found_and_the_scene_may_be_left_out(tmp_path: Path) -> None:
    root = kitti(tmp_path, "frame,weather,value\n0,clear,\n1,clear,\n2,snow,1.5\n", frames=3)
    assert [one.id for one in study_from_kitti(root, LIDAR).conditions] == ["s0-snow-1.5"]


def test_kitti_s_images_are_a_camera_study(tmp_path: Path) -> None:
    raw_frames(tmp_path / "image_2", [200, 300, 400])
    (tmp_path / "w.csv").write_text("frame,weather,value\n200,clear,\n300,clear,\n400,fog,50\n")
    found = study_from_kitti(tmp_path, CAMERA, table=tmp_path / "w.csv", depth={"s0": 20.0})
    assert found.kind == "camera"
    assert found.conditions[0].frames[0]["bayer"].shape == (4, 6)


BAD_TABLES = [
    ("frame,weather\n0,clear\n", r"weather.csv: the column 'value' is missing"),
    ("frame,weather,value,sceen\n0,clear,,a\n", r"unknown column 'sceen'.*Did you mean 'scene'"),
    ("frame,weather,value\n9,clear,\n", r"weather.csv: row 2: frame 9 has no file"),
    ("frame,weather,value\n0,clear,\n1,rian,5\n", r"row 3: weather must be one of.*Did you mean 'rain'"),
    ("frame,weather,value\n0,clear,\n1,rain,\n", r"row 3: value must be a number, rate_mm_per_h; got None"),
    ("frame,weather,value\n0,clear,\n1,fog,-5\n", r"row 3: Fog: mor_m must be above 0 m"),
    ("frame,weather,value,scene\n0,clear,,a\n1,rain,5,b\n", r"the scene b has no clear frame"),
    (
        "frame,weather,value,rel_sd\n0,clear,,\n1,rain,5,0.1\n2,rain,5,0.2\n",
        r"row 4: rel_sd and split must be those of the other frames of s0-rain-5",
    ),
    ("frame,weather,value,split\n0,clear,,\n1,rain,5,test\n", r"split must be fit or holdout"),
]


@pytest.mark.parametrize(("table", "message"), BAD_TABLES, ids=[message for _, message in BAD_TABLES])
def test_a_wrong_table_is_refused_with_file_and_row(tmp_path: Path, table: str, message: str) -> None:
    with pytest.raises(TorchweatherError, match=f"(?s){message}"):
        study_from_kitti(kitti(tmp_path, table, frames=3), LIDAR)


# ---- wrong calls -----------------------------------------------------------------------------------------------------


def test_wrong_calls_are_refused(tmp_path: Path) -> None:
    write_clouds(tmp_path / "clear", range(2))
    fog: dict[Any, Any] = {tmp_path / "clear": "fog:mor=50"}
    (tmp_path / "empty").mkdir()
    raw_frames(tmp_path / "raw", [200, 300])
    raw: dict[Any, Any] = {tmp_path / "raw": "fog:mor=50"}
    cases: list[tuple[Any, str]] = [
        (lambda: study_from_folders(tmp_path / "none", fog, LIDAR), "none: no such folder. Wanted frames ending"),
        (lambda: study_from_folders(tmp_path / "empty", fog, LIDAR), "empty: no frames; expected files ending"),
        (lambda: study_from_folders(tmp_path / "clear", {}, LIDAR), "conditions must hold at least one"),
        (lambda: study_from_folders(tmp_path / "clear", fog, "radar"), "sensor must be a Lidar or a Camera; got Radar"),
        (lambda: study_from_folders(tmp_path / "clear", fog, LIDAR, depth=3.0), "depth belongs to a camera"),
        (
            lambda: study_from_folders(tmp_path / "clear", fog, LIDAR, directions=np.ones((3, 90, 3))),
            "directions belong to organised clouds",
        ),
        (lambda: study_from_folders(tmp_path / "raw", raw, CAMERA), "depth of scene s0 is missing"),
        (lambda: study_from_folders(tmp_path / "raw", raw, CAMERA, depth=np.ones((4, 7))), r"size \(H, W\) = \(5, 7\)"),
        (
            lambda: study_from_folders(tmp_path / "raw", raw, CAMERA, depth=3.0, directions=np.ones(3)),
            "directions belong to a LiDAR",
        ),
        (
            lambda: study_from_folders(tmp_path / "raw", raw, replace(CAMERA, width=9), depth=3.0).sha256,
            r"200.png: the image must have the camera's size, 5 x 9 px; got \(5, 7\)",
        ),
        (lambda: study_from_kitti(tmp_path, LIDAR), r"velodyne|weather.csv"),
    ]
    for call, message in cases:
        with pytest.raises(TorchweatherError, match=message):
            call()


def test_organised_and_other_clouds_do_not_mix(tmp_path: Path) -> None:
    organised(tmp_path / "clear", range(2), 1.0)
    write_clouds(tmp_path / "fog", range(2))
    with pytest.raises(TorchweatherError, match=r"000000.bin: all clouds must have one grid, \(3, 90\)"):
        study_from_folders(tmp_path / "clear", {tmp_path / "fog": "fog:mor=50"}, LIDAR)


# ---- recordings ------------------------------------------------------------------------------------------------------


@pytest.mark.real_data
@pytest.mark.parametrize(
    ("folder", "preset", "most_lost"),
    [
        ("radiate_fog/velo_lidar", "velodyne-hdl-32e", 0.05),  # a ring column, not compensated for motion
        ("wads_snow/velodyne", "pandar64-wads", 0.6),  # two returns per beam
    ],
)
def test_recorded_clouds_are_a_study(folder: str, preset: str, most_lost: float) -> None:
    path = recording(folder)
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        found = study_from_folders(path, {path: "fog:mor=50"}, f"lidar:{preset}")
    assert len(found.scenes["s0"].clear) >= 3
    share = float(str(told[-1].message).split("(")[1].split(" %")[0]) / 100
    assert share < most_lost
    frame = found.scenes["s0"].clear[0]
    assert frame["range_m"].shape == found.beams["direction"].shape[:2]
    assert np.count_nonzero(frame["range_m"]) > 10_000
