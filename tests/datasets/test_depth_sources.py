"""Depth named on the command line: maps, clouds with a calibration, networks, and how sure each is."""

from __future__ import annotations

import argparse
import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import pytest
import torch
from onnx import TensorProto, helper
from torch import Tensor

from tests.recordings import recording
from torchweather.camera.depth import (
    CompletedDepth,
    CompletedDepthMap,
    ConstantDepth,
    DepthMap,
    FlatGround,
    ScenePrior,
    scene_of,
)
from torchweather.camera.depth.network import DepthNetwork
from torchweather.cli import main
from torchweather.cli.frames import add_depth_arguments
from torchweather.cli.frames import depth_source as from_arguments
from torchweather.core.errors import TorchweatherError
from torchweather.datasets import read_kitti_calibration
from torchweather.datasets.depth_clouds import calibration_file, cloud_file, frame_camera_name
from torchweather.datasets.depth_sources import depth_source
from torchweather.io import read_image, read_points, write_image
from torchweather.sensors import Camera

HEIGHT, WIDTH = 96, 128
CAMERA = Camera.from_intrinsics(fx=100.0, fy=100.0, cx=63.5, cy=30.0, width=WIDTH, height=HEIGHT, height_m=1.5)
FRAME = Path("0001.png")
# LiDAR: x forward, y left, z up, at the camera's place; KITTI's way of writing it.
KITTI = """P2: 100 0 63.5 0 0 100 30 0 0 0 1 0
R0_rect: 1 0 0 0 1 0 0 0 1
Tr_velo_to_cam: 0 -1 0 0 0 0 -1 0 1 0 0 0
"""


def known_share(depth_m: Tensor, share: float, *, unknown: float = math.nan) -> Tensor:
    """A map that knows a share of its pixels below the horizon."""
    known = torch.rand(depth_m.shape, generator=torch.Generator().manual_seed(1)) < share
    known[..., :31, :] = False
    return torch.where(known, depth_m, unknown)


def ground(camera: Camera = CAMERA) -> Tensor:
    return FlatGround()(camera, HEIGHT, WIDTH, dtype=torch.float64).clamp(max=60.0)


def cloud_of_ground() -> Tensor:
    """Points of the ground and of a wall at 40 m in the LiDAR's axes, ``(N, 4)``."""
    known = torch.rand(HEIGHT, WIDTH, generator=torch.Generator().manual_seed(3)) < 0.2
    known[:10] = False
    depth_m = ground().clamp(max=40.0)[0]
    x, y, z = (depth_m * CAMERA.ray_directions(HEIGHT, WIDTH, dtype=torch.float64))[:, known]
    return torch.stack([z, -x, -y, torch.full_like(z, 0.5)], -1).float()


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Frames 0001 with a cloud in velodyne/ and its calibration in calib/."""
    for name in ("velodyne", "calib"):
        (tmp_path / name).mkdir()
    cloud_of_ground().numpy().tofile(tmp_path / "velodyne" / "0001.bin")
    (tmp_path / "calib" / "0001.txt").write_text(KITTI)
    return tmp_path


def network(path: Path) -> Path:
    """An ONNX file that gives the picture's red, normalised as ImageNet's."""
    ints = [helper.make_tensor(n, TensorProto.INT64, [1], [v]) for n, v in (("a", 0), ("b", 1), ("axis", 1))]
    node = helper.make_node("Slice", ["image", "a", "b", "axis"], ["map"])
    given = helper.make_tensor_value_info("image", TensorProto.FLOAT, [1, 3, None, None])
    found = helper.make_tensor_value_info("map", TensorProto.FLOAT, [1, 1, None, None])
    graph = helper.make_graph([node], "red", [given], [found], ints)
    onnx.save(helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=9), path)
    return path


def arguments(*words: object) -> argparse.Namespace:
    parser = argparse.ArgumentParser()
    add_depth_arguments(parser)
    return parser.parse_args([str(word) for word in words])


def named(*words: object, default: str = "auto") -> Any:
    args = arguments(*words)
    return from_arguments(args.depth or default, args.depth_encoding, FRAME, args=args)


def test_sources_without_a_file() -> None:
    assert depth_source("ground", None, FRAME) == FlatGround()
    assert depth_source("25", None, FRAME) == ConstantDepth(25.0)
    assert isinstance(depth_source("auto", None, FRAME), ScenePrior)
    for text, message in [("-3", "0 m or more"), ("none.png", "no such file exists")]:
        with pytest.raises(ValueError, match=message):
            depth_source(text, None, FRAME)
    with pytest.raises(ValueError, match=r"--depth-encoding belongs to a depth map in a file.*--depth auto"):
        depth_source("auto", "kitti", FRAME)


def test_a_map_without_unknown_pixels_is_exact(tmp_path: Path) -> None:
    depth_m = ground()
    depth_m[:, :20] = math.inf
    np.save(tmp_path / "d.npy", depth_m.numpy())
    source = depth_source(str(tmp_path / "d.npy"), None, FRAME)
    assert isinstance(source, DepthMap)
    assert source.confidence == "exact"
    assert torch.equal(source(CAMERA, HEIGHT, WIDTH), depth_m.float())


@pytest.mark.parametrize(("share", "word"), [(0.05, "completed"), (0.85, "completed"), (0.97, "measured")])
def test_unknown_pixels_are_completed_and_counted(tmp_path: Path, share: float, word: str) -> None:
    np.save(tmp_path / "d.npy", known_share(ground(), share).numpy())
    source = depth_source(str(tmp_path / "d.npy"), None, FRAME)
    assert isinstance(source, CompletedDepthMap)
    scene = source.scene(CAMERA, HEIGHT, WIDTH)
    assert scene.confidence == word
    assert torch.isfinite(scene.depth_m[:, 31:]).all()
    torch.testing.assert_close(scene.depth_m[:, 60:], ground()[:, 60:].float(), rtol=0.05, atol=0.0)
    (counted,) = (note for note in scene.notes if "below the horizon" in note)
    assert float(counted.split("%")[0]) == pytest.approx(100 * share, abs=1.5)


@pytest.mark.parametrize("unknown", [math.nan, -math.inf, 0.0])
def test_a_map_without_any_value_is_refused(tmp_path: Path, unknown: float) -> None:
    np.save(tmp_path / "d.npy", np.full((4, 6), unknown))
    with pytest.raises(TorchweatherError, match=r"no pixel of the map has a depth.*--depth-model"):
        depth_source(str(tmp_path / "d.npy"), None, FRAME)
    write_image(tmp_path / "d.png", torch.zeros(1, 4, 6, dtype=torch.uint16))
    for encoding, more in [("kitti", {}), ("disparity_kitti", {"baseline_m": 0.5})]:
        with pytest.raises(TorchweatherError, match="no pixel of the map has a depth"):
            depth_source(str(tmp_path / "d.png"), encoding, FRAME, **more)


def test_a_flat_frame_at_10_m_that_few_pixels_know_gets_the_fog_of_10_m(tmp_path: Path) -> None:
    """KITTI's sparse depth: the ground lies at 10 m, 4.5 % of its pixels have a value, and 0 is none."""
    frame = torch.full((3, HEIGHT, WIDTH), 80, dtype=torch.uint8)
    frame[:, :30] = 220
    code = known_share(torch.full((1, HEIGHT, WIDTH), 2560.0), 0.045, unknown=0.0)
    (tmp_path / "depth").mkdir()
    write_image(tmp_path / "0001.png", frame)
    write_image(tmp_path / "depth" / "0001.png", code.to(torch.uint16))
    for depth in (tmp_path / "depth", tmp_path / "depth" / "0001.png"):
        words = ["--depth", str(depth), "--depth-encoding", "kitti", "--weather", "fog:mor=100", "--quiet"]
        # Through a long lens the way to a pixel is as long as its depth.
        light = ["--airlight", "0.7", "0.7", "0.7", "--fx", "1000"]
        assert main(["apply", str(tmp_path / "0001.png"), *words, *light, "--out", str(tmp_path / "out")]) == 0
        # Below the soft border of the sky.
        after = read_image(tmp_path / "out" / "0001.png")[0][0, 34:].double() / 255
        linear = ((after + 0.055) / 1.055) ** 2.4
        clear = ((80 / 255 + 0.055) / 1.055) ** 2.4
        transmission = (linear - 0.7) / (clear - 0.7)
        # 0.05 ** (10 / 100) = 0.741; a level of 255 is 0.006 of transmission.
        assert float(transmission.mean()) == pytest.approx(0.741, abs=0.006)


def test_distances_along_the_ray_become_depth_along_the_axis(tmp_path: Path) -> None:
    depth_m = ground()
    distance_m = depth_m * CAMERA.ray_directions(HEIGHT, WIDTH, dtype=torch.float64).norm(dim=0)
    for unknown, word in [(False, "exact"), (True, "measured")]:
        if unknown:
            distance_m[:, 60, 60] = math.nan
        np.save(tmp_path / "d.npy", distance_m.numpy())
        scene = named("--depth", tmp_path / "d.npy", "--depth-along", "ray").scene(CAMERA, HEIGHT, WIDTH)
        assert scene.confidence == word
        torch.testing.assert_close(scene.depth_m[:, 40:], depth_m[:, 40:].float(), rtol=1e-3, atol=0.0)
    along_axis = named("--depth", tmp_path / "d.npy")(CAMERA, HEIGHT, WIDTH)
    assert float(along_axis[0, -1, 0]) > 1.1 * float(depth_m[0, -1, 0])


def test_a_disparity_takes_the_cameras_focal_length_and_the_given_baseline(tmp_path: Path) -> None:
    depth_m = ground()
    disparity_px = 100.0 * 0.5 / depth_m
    np.save(tmp_path / "d.npy", disparity_px.numpy())
    source = named("--depth", tmp_path / "d.npy", "--depth-encoding", "disparity", "--baseline-m", 0.5)
    scene = source.scene(CAMERA, HEIGHT, WIDTH)
    assert scene.confidence == source.confidence == "measured"
    torch.testing.assert_close(scene.depth_m, depth_m.float())
    write_image(tmp_path / "d.png", known_share(256 * disparity_px, 0.5, unknown=0.0).round().to(torch.uint16))
    coded = named("--depth", tmp_path / "d.png", "--depth-encoding", "disparity_kitti", "--baseline-m", 0.5)
    scene = coded.scene(CAMERA, HEIGHT, WIDTH)
    assert scene.confidence == coded.confidence == "completed"
    torch.testing.assert_close(scene.depth_m[:, 60:], depth_m[:, 60:].float(), rtol=0.02, atol=0.0)
    with pytest.raises(ValueError, match="the map must have the image's size, 4 x 6; got 96 x 128"):
        coded(CAMERA, 4, 6)
    for words, message in [
        (("--depth-encoding", "disparity"), "--baseline-m METRES"),
        (("--depth-encoding", "disparity", "--baseline-m", "0.5", "--depth-along", "ray"), "leave --depth-along ray"),
        (("--baseline-m", "0.5"), "--baseline-m belongs to --depth-encoding disparity"),
    ]:
        with pytest.raises(ValueError, match=message):
            named("--depth", tmp_path / "d.npy", *words)
    # A disparity of 1/256 pixel read as pixels puts the street at centimetres.
    wrong = named("--depth", tmp_path / "d.png", "--depth-encoding", "disparity", "--baseline-m", 0.5)
    with pytest.raises(TorchweatherError, match=r"nearer than 0.2 m.*unit of the disparity"):
        wrong(CAMERA, HEIGHT, WIDTH)


def test_a_cloud_with_its_calibration_is_completed(folder: Path) -> None:
    truth = ground().clamp(max=40.0).float()
    cloud, calibration = folder / "velodyne" / "0001.bin", folder / "calib" / "0001.txt"
    for depth, calib in [(cloud, calibration), (folder / "velodyne", folder / "calib"), (cloud, folder / "calib")]:
        source = named("--depth", depth, "--calib", calib)
        assert isinstance(source, CompletedDepth)
        scene = source.scene(CAMERA, HEIGHT, WIDTH)
        assert scene.confidence == "completed"
        torch.testing.assert_close(scene.depth_m[:, 45:], truth[:, 45:], rtol=0.05, atol=0.0)
    np.savez(folder / "velodyne" / "0002.npz", points=cloud_of_ground().numpy())
    as_npz = depth_source(str(folder / "velodyne"), None, Path("0002.png"), calibration=calibration)
    assert isinstance(as_npz, CompletedDepth)
    calibration.write_text(KITTI.splitlines()[0].removeprefix("P2: "))
    assert "recording day" in named("--depth", cloud, "--calib", calibration).assumption


def test_a_cloud_needs_its_calibration_and_no_encoding(folder: Path) -> None:
    cloud, calib = folder / "velodyne", folder / "calib"
    with pytest.raises(ValueError, match=r"is a cloud of points: give the way .* --calib FILE or DIR"):
        named("--depth", cloud)
    with pytest.raises(ValueError, match=r"--depth-encoding belongs to a depth map .* cloud"):
        named("--depth", cloud, "--calib", calib, "--depth-encoding", "kitti")
    with pytest.raises(ValueError, match="--calib belongs to a LiDAR cloud"):
        named("--calib", calib)
    with pytest.raises(ValueError, match="does not exist"):
        named("--depth", cloud, "--calib", folder / "none")
    with pytest.raises(ValueError, match=r"no depth map for 0002.png.* or a cloud of that name"):
        depth_source(str(cloud), None, Path("0002.png"), calibration=calib)
    (calib / "0003.txt").write_text(KITTI)
    with pytest.raises(ValueError, match=r"no calibration for 0002.png; expected 0002 with .txt or .json"):
        calibration_file(calib, Path("0002.png"))
    with pytest.raises(TorchweatherError, match=r"camera 2 \(P2\); got the camera 'P3'"):
        depth_source(str(cloud), None, FRAME, calibration=calib, camera_name="P3")


def test_nuscenes_names_join_camera_and_lidar_of_one_moment(tmp_path: Path) -> None:
    log = "n015-2018-07-24-11-22-45+0800"
    frame = Path(f"{log}__CAM_BACK__1532402927612460.jpg")
    rows = torch.cat([cloud_of_ground(), torch.zeros(len(cloud_of_ground()), 1)], -1).numpy()
    near, far = (tmp_path / f"{log}__LIDAR_TOP__{stamp}.pcd.bin" for stamp in (1532402927647951, 1532402927747951))
    axes = [[0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]]
    matrix = [[100, 0, 63.5], [0, 100, 30], [0, 0, 1]]
    other = [[1, 0, 0, 9], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]
    content = {
        "CAM_FRONT": {"cam2img": matrix, "lidar2cam": other},
        "CAM_BACK": {"cam2img": matrix, "lidar2cam": axes},
    }
    (tmp_path / f"{log}_calib.json").write_text(json.dumps(content))
    (tmp_path / "other.json").write_text("{}")
    rows.tofile(far)
    assert cloud_file(tmp_path, frame) is None
    rows.tofile(near)
    assert cloud_file(tmp_path, frame) == near
    source = depth_source(str(tmp_path), None, frame, calibration=tmp_path)
    assert isinstance(source, CompletedDepth)
    assert source.T_camera_from_lidar.tolist() == axes
    assert [frame_camera_name(one) for one in (frame, FRAME, near)] == ["CAM_BACK", None, None]


def test_a_network_stands_for_the_depth_or_is_scaled_by_it(folder: Path) -> None:
    model = network(folder / "net.onnx")
    inverse = (1.0 / ground().clamp(max=40.0)).float()
    image = torch.cat([inverse + 0.2, torch.full((2, HEIGHT, WIDTH), 0.4)])
    more = ("--depth-model-output", "inverse_depth", "--depth-model-multiple-px", 1)
    for words, word in [
        (("--depth-model-scale", "ground"), "guessed"),
        (("--depth-model-scale", "lidar", "--depth", folder / "velodyne", "--calib", folder / "calib"), "completed"),
    ]:
        source = named("--depth-model", model, *more, *words)
        assert isinstance(source, DepthNetwork)
        scene = scene_of(source, CAMERA, HEIGHT, WIDTH, image=image)
        assert scene.confidence == word
        torch.testing.assert_close(scene.depth_m[:, 40:], 1.0 / inverse[:, 40:], rtol=0.02, atol=0.0)
    np.save(folder / "sparse.npy", known_share(ground(), 0.1).numpy())
    by_map = named("--depth-model", model, "--depth-model-scale", "lidar", "--depth", folder / "sparse.npy")
    assert by_map.confidence == "completed"


def test_options_of_a_network_are_checked(folder: Path) -> None:
    model = network(folder / "net.onnx")
    np.save(folder / "whole.npy", ground().numpy())
    for words, message in [
        (("--depth-model-scale", "ground"), "--depth-model-scale belongs to --depth-model ONNX"),
        (("--depth-model-multiple-px", "14"), "--depth-model-multiple-px belongs to"),
        (("--depth-model", model, "--depth", "30"), "both give the depth"),
        (("--depth-model", model, "--calib", folder), "--calib belongs to a LiDAR cloud"),
        (("--depth-model", model, "--depth-model-scale", "lidar"), "needs measured points: --depth CLOUD"),
        (
            ("--depth-model", model, "--depth-model-scale", "lidar", "--depth", folder / "whole.npy"),
            "a map along the axis with unknown pixels",
        ),
        (("--depth-model", model, "--depth-model-output", "disparity"), "needs baseline_m"),
    ]:
        with pytest.raises(ValueError, match=message):
            named(*words)
    with pytest.raises(TorchweatherError, match="expected a depth network as an ONNX graph"):
        named("--depth-model", folder / "none.onnx")


@pytest.mark.real_data
def test_clouds_of_kitti_and_nuscenes_are_found_by_name_and_meet_their_points() -> None:
    demo = recording("kitti_nuscenes_demo")
    kitti = demo / "kitti" / "000008.png"
    rgb, _ = read_image(kitti)
    height, width = rgb.shape[-2:]
    camera = read_kitti_calibration(kitti.with_suffix(".txt")).camera(width, height, height_m=1.65)
    source = depth_source(str(demo / "kitti"), None, kitti, calibration=demo / "kitti")
    scene = source.scene(camera, height, width, image=rgb)
    assert scene.confidence == "completed"
    # The road two rows above the lower edge, in the middle: 1.65 m below a level camera.
    row = height - 3
    expected = 1.65 * camera.fy / (row - camera.principal_point_px[1])
    assert float(scene.depth_m[0, row, width // 2 - 50 : width // 2 + 50].median()) == pytest.approx(expected, rel=0.1)
    (frame,) = (demo / "nuscenes").glob("*CAM_FRONT*.jpg")
    found = depth_source(str(demo / "nuscenes"), None, frame, calibration=demo / "nuscenes")
    assert isinstance(found, CompletedDepth)
    (cloud,) = (demo / "nuscenes").glob("*.pcd.bin")
    assert len(found.points_xyz) == len(read_points(cloud).points)


@pytest.mark.parametrize(
    ("files", "frame", "found"),
    [
        (("000001.txt", "000002.txt"), "image_2/000002.png", "000002.txt"),
        (("0000.txt", "0001.txt"), "image_02/0001/000000.png", "0001.txt"),
        (("calib.txt", "times.txt", "poses.txt"), "sequences/00/image_2/000000.png", "calib.txt"),
        (
            ("calib_cam_to_cam.txt", "calib_velo_to_cam.txt"),
            "drive/image_02/data/0000000000.png",
            "calib_cam_to_cam.txt",
        ),
        (("rig.txt",), "image_2/000002.png", "rig.txt"),
        (("000001.txt",), "image_2/000002.png", None),
    ],
)
def test_a_frame_takes_no_calibration_of_another(
    tmp_path: Path, files: tuple[str, ...], frame: str, found: str | None
) -> None:
    for name in files:
        (tmp_path / name).write_text("")
    if found is None:
        with pytest.raises(ValueError, match="no calibration for 000002"):
            calibration_file(tmp_path, Path(frame))
    else:
        assert calibration_file(tmp_path, Path(frame)) == tmp_path / found
