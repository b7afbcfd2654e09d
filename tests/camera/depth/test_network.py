"""Depth networks in ONNX files: graphs of one layer whose answer is known, on pictures that carry the depth."""

from __future__ import annotations

import dataclasses
import pickle
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import pytest
import torch
from onnx import TensorProto, helper
from torch import Tensor

from tests.recordings import recording
from torchweather.camera.depth import CompletedDepth, CompletedDepthMap, FlatGround, scene_of
from torchweather.camera.depth.horizon import find_horizon
from torchweather.camera.depth.network import IMAGENET_MEAN, IMAGENET_STD, DepthNetwork
from torchweather.camera.depth.network_graph import NetworkGraph
from torchweather.core.errors import TorchweatherError
from torchweather.datasets import read_kitti_calibration, read_kitti_points
from torchweather.io import read_image
from torchweather.sensors import Camera

HEIGHT, WIDTH = 96, 128
CAMERA = Camera.from_intrinsics(
    fx=100.0, fy=100.0, cx=63.5, cy=36.0, width=WIDTH, height=HEIGHT, height_m=1.6, pitch_rad=-0.02
)
NO_SKY = torch.zeros(1, HEIGHT, WIDTH)
# The networks below give the picture's red; without normalisation that is what the picture holds.
PLAIN: dict[str, Any] = {
    "mean": (0.0, 0.0, 0.0), "std": (1.0, 1.0, 1.0), "sky": NO_SKY, "near_mask": None, "horizon": "camera",
    "multiple_px": 1, "threads": 1,
}  # fmt: skip


def written(
    path: Path,
    shape: list[Any],
    *,
    axis: int = 1,
    out: list[Any] | None = None,
    gain: float = 1.0,
    offset: float = 0.0,
    dtype: int = TensorProto.FLOAT,
    more_outputs: int = 0,
    more_inputs: int = 0,
) -> str:
    """A network that gives ``gain red + offset``; the channels lie on ``axis``."""
    kind = helper.tensor_dtype_to_np_dtype(dtype)
    constants = [
        helper.make_tensor(name, TensorProto.INT64, [1], [value])
        for name, value in (("first", 0), ("end", 1), ("axis", axis))
    ] + [
        helper.make_tensor("gain", dtype, [1], np.asarray([gain], kind)),
        helper.make_tensor("offset", dtype, [1], np.asarray([offset], kind)),
    ]
    nodes = [
        helper.make_node("Slice", ["image", "first", "end", "axis"], ["red"]),
        helper.make_node("Mul", ["red", "gain"], ["times"]),
        helper.make_node("Add", ["times", "offset"], ["depth"]),
    ]
    out = out or ([1, 1, None, None] if axis == 1 else [1, None, None, 1])
    outputs = [helper.make_tensor_value_info("depth", dtype, out)]
    for number in range(more_outputs):
        nodes.append(helper.make_node("Neg", ["depth"], [f"other{number}"]))
        outputs.append(helper.make_tensor_value_info(f"other{number}", dtype, out))
    inputs = [helper.make_tensor_value_info("image", dtype, shape)]
    inputs += [helper.make_tensor_value_info(f"more{number}", dtype, [1]) for number in range(more_inputs)]
    graph = helper.make_graph(nodes, "red", inputs, outputs, constants)
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=9)
    onnx.checker.check_model(model)
    onnx.save(model, path)
    return str(path)


def ground_and_wall() -> Tensor:
    """Inverse depth ``(H, W)``, 1/m, of flat ground that ends at a wall at 40 m."""
    ground = FlatGround()(CAMERA, HEIGHT, WIDTH, dtype=torch.float64)[0]
    return 1.0 / ground.clamp(max=40.0)


def picture(red: Tensor) -> Tensor:
    """A picture whose red is given, 0..1."""
    assert red.min() >= 0
    assert red.max() <= 1
    return torch.stack([red, torch.full_like(red, 0.5), torch.full_like(red, 0.2)]).float()


@pytest.fixture
def red(tmp_path: Path) -> str:
    return written(tmp_path / "red.onnx", [1, 3, "height", "width"])


def relative_error(depth_m: Tensor, inverse: Tensor) -> Tensor:
    return (depth_m[0].double() * inverse - 1.0).abs()


@pytest.mark.parametrize("output", ["inverse_depth", "disparity"])
@pytest.mark.parametrize(("gain", "shift"), [(1.7, 0.05), (0.4, 0.3)])
def test_relative_inverse_depth_gets_scale_and_shift_from_the_ground(
    red: str, output: str, gain: float, shift: float
) -> None:
    inverse = ground_and_wall()
    source = DepthNetwork(red, output=output, scale="ground", **PLAIN)
    scene = source.scene(CAMERA, HEIGHT, WIDTH, image=picture(gain * inverse + shift))
    assert float(relative_error(scene.depth_m, inverse).max()) < 0.01
    assert scene.confidence == source.confidence == "guessed"
    assert "flat ground 1.6 m below the camera; 100% of the pixels" in scene.notes[0]


def test_cars_and_houses_on_the_ground_do_not_move_its_scale(red: str) -> None:
    inverse = ground_and_wall()
    inverse[50:80, 8:50] = 1.0 / 5.0  # two cars and a wall cover 3 of 5 pixels of the ground
    inverse[45:92, 85:] = 1.0 / 4.0
    inverse[80:, :20] = 1.0 / 2.5
    noise = 1.0 + 0.02 * torch.randn(HEIGHT, WIDTH, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    source = DepthNetwork(red, output="inverse_depth", scale="ground", **PLAIN)
    depth_m = source(CAMERA, HEIGHT, WIDTH, image=picture((inverse * noise + 0.1).clamp(0, 1)))
    assert float(relative_error(depth_m, inverse).median()) < 0.03


@pytest.mark.parametrize("name", ["near_mask", "sky"])
def test_what_is_masked_is_not_taken_for_the_ground(red: str, name: str) -> None:
    inverse = ground_and_wall()
    given = inverse.clone()
    given[55:] *= 2.0  # most of the lower rows are a plane twice as near
    mask = torch.zeros(1, HEIGHT, WIDTH)
    mask[:, 55:] = 1.0
    seen = (slice(0, 55),)
    for options, right in [({**PLAIN, name: mask}, True), (PLAIN, False)]:
        source = DepthNetwork(red, output="depth", scale="ground", **options)
        found = source(CAMERA, HEIGHT, WIDTH, image=picture(0.02 / given))
        assert (float(relative_error(found, inverse)[seen].median()) < 0.02) == right


def test_relative_depth_gets_a_scale_and_no_shift(red: str) -> None:
    inverse = ground_and_wall()
    source = DepthNetwork(red, output="depth", scale="ground", **PLAIN)
    depth_m = source(CAMERA, HEIGHT, WIDTH, image=picture(0.02 / inverse))
    assert float(relative_error(depth_m, inverse)[40:].max()) < 0.01


def test_sparse_points_scale_by_least_absolute_deviations(red: str) -> None:
    inverse = ground_and_wall()
    generator = torch.Generator().manual_seed(2)
    known = torch.rand(HEIGHT, WIDTH, generator=generator) < 0.04
    known[:40] = False
    wrong = known & (torch.rand(HEIGHT, WIDTH, generator=generator) < 0.2)
    # Nearer than the surface: a far outlier between near points would be taken for hidden, and left out.
    sparse = torch.where(wrong, 0.5 / inverse, torch.where(known, 1.0 / inverse, torch.nan))
    source = DepthNetwork(red, output="inverse_depth", scale=CompletedDepthMap(sparse), **PLAIN)
    # A camera at another height: the ground's scale would be wrong by a third.
    low = dataclasses.replace(CAMERA, height_m=1.2)
    scene = source.scene(low, HEIGHT, WIDTH, image=picture(inverse + 0.2))
    assert float(relative_error(scene.depth_m, inverse).median()) < 0.01
    assert scene.confidence == source.confidence == "completed"
    assert "measured points" in scene.notes[0]
    few = CompletedDepthMap(torch.where(torch.arange(HEIGHT * WIDTH).view(HEIGHT, WIDTH) % 999 == 998, 5.0, torch.nan))
    with pytest.raises(ValueError, match="needs 50 measured points in the picture; got 12"):
        DepthNetwork(red, output="inverse_depth", scale=few, **PLAIN)(
            CAMERA, HEIGHT, WIDTH, image=picture(inverse + 0.2)
        )


def test_metric_outputs_are_taken_as_they_are(tmp_path: Path) -> None:
    inverse = ground_and_wall()
    image = picture(inverse)
    metres = DepthNetwork(written(tmp_path / "i.onnx", [1, 3, None, None]), output="inverse_depth", **PLAIN)
    assert float(relative_error(metres(CAMERA, HEIGHT, WIDTH, image=image), inverse).max()) < 1e-3
    # Disparity in pixels: fx 100 px times 0.5 m.
    pixels = written(tmp_path / "d.onnx", [1, 3, None, None], gain=50.0)
    disparity = DepthNetwork(pixels, output="disparity", baseline_m=0.5, **PLAIN)
    assert float(relative_error(disparity(CAMERA, HEIGHT, WIDTH, image=image), inverse).max()) < 1e-3
    depth = written(tmp_path / "z.onnx", [1, 3, None, None], gain=100.0)
    scene = DepthNetwork(depth, **PLAIN).scene(CAMERA, HEIGHT, WIDTH, image=picture(0.01 / inverse))
    assert float(relative_error(scene.depth_m, inverse)[40:].max()) < 1e-3
    assert scene.confidence == "guessed"
    assert "taken for metres; flat ground 1.6 m below the camera would multiply its depth by 1.00" in scene.notes[0]


def test_disparity_of_a_graph_of_half_the_size_counts_its_own_pixels(tmp_path: Path) -> None:
    inverse = ground_and_wall()
    path = written(tmp_path / "d.onnx", [1, 3, HEIGHT // 2, WIDTH // 2], gain=25.0)
    source = DepthNetwork(path, output="disparity", baseline_m=0.5, **PLAIN)
    found = source(CAMERA, HEIGHT, WIDTH, image=picture(inverse))
    assert float(relative_error(found, inverse)[50:90, 4:-4].max()) < 0.02


def test_sky_own_vehicle_and_farthest_depth(tmp_path: Path) -> None:
    path = written(tmp_path / "red.onnx", [1, 3, None, None], gain=-0.4, offset=0.3)  # below 0 on the right
    sky, near = torch.zeros(1, HEIGHT, WIDTH), torch.zeros(1, HEIGHT, WIDTH)
    sky[:, :30], sky[:, 30] = 1.0, 0.5
    near[:, 90:] = 1.0
    red = torch.linspace(0, 1, WIDTH).expand(HEIGHT, WIDTH)
    source = DepthNetwork(path, output="inverse_depth", farthest_m=150.0, **{**PLAIN, "sky": sky, "near_mask": near})
    scene = source.scene(CAMERA, HEIGHT, WIDTH, image=picture(red))
    assert torch.equal(torch.isinf(scene.depth_m), sky == 1)
    assert torch.equal(scene.sky, sky)
    assert torch.equal(scene.near_mask, near)
    assert (scene.depth_m[:, 30:90, 100:] == 150.0).all()
    assert (scene.depth_m[:, 90:] <= 1.0).all()
    # A function finds the sky as well.
    by_function = DepthNetwork(path, output="inverse_depth", **{**PLAIN, "sky": lambda rgb: (rgb[:1] > 2).float()})
    assert torch.isfinite(by_function(CAMERA, HEIGHT, WIDTH, image=picture(red))).all()


def test_sky_is_found_in_the_picture_and_kept_out_of_the_scale(red: str) -> None:
    inverse = ground_and_wall()
    image = picture(0.4 * inverse + 0.25)
    image[:, :30] = torch.tensor([0.55, 0.7, 0.95])[:, None, None]
    image[:, 30:36] *= 0.5
    given = {**PLAIN, "sky": None}
    scene = DepthNetwork(red, output="inverse_depth", scale="ground", **given).scene(CAMERA, HEIGHT, WIDTH, image=image)
    assert torch.isinf(scene.depth_m[0, :26]).all()
    assert float(relative_error(scene.depth_m, inverse)[40:].max()) < 0.01


def test_channels_last_fixed_sizes_and_half_precision(tmp_path: Path) -> None:
    inverse = ground_and_wall()
    image = picture(inverse)
    last = written(tmp_path / "last.onnx", [1, None, None, 3], axis=3)
    source = DepthNetwork(last, output="inverse_depth", **PLAIN)
    assert float(relative_error(source(CAMERA, HEIGHT, WIDTH, image=image), inverse).max()) < 1e-3
    half = written(tmp_path / "half.onnx", [1, 3, None, None], dtype=TensorProto.FLOAT16)
    source = DepthNetwork(half, output="inverse_depth", **PLAIN)
    assert float(relative_error(source(CAMERA, HEIGHT, WIDTH, image=image), inverse).max()) < 2e-3
    fixed = written(tmp_path / "fixed.onnx", ["batch", 3, 48, 80], out=["batch", 1, 48, 80])
    source = DepthNetwork(fixed, output="inverse_depth", **PLAIN)
    found = source(CAMERA, HEIGHT, WIDTH, image=image)
    assert found.shape == (1, HEIGHT, WIDTH)
    assert float(relative_error(found, inverse)[50:90, 4:-4].max()) < 0.02


@pytest.mark.parametrize(
    ("multiple", "shorter", "size"),
    [(14, None, (98, 126)), (32, None, (96, 128)), (14, 56, (56, 70)), (1, 48, (48, 64))],
)
def test_open_sizes_are_rounded_and_the_picture_is_normalised(
    red: str, monkeypatch: pytest.MonkeyPatch, multiple: int, shorter: int | None, size: tuple[int, int]
) -> None:
    seen: list[Any] = []

    def run(self: NetworkGraph, given: Any) -> Any:
        seen.append(given)
        return np.full(given.shape[1:], 0.1, np.float32)

    monkeypatch.setattr(NetworkGraph, "run", run)
    source = DepthNetwork(
        red, output="inverse_depth", multiple_px=multiple, shorter_side_px=shorter, sky=NO_SKY, horizon="camera"
    )
    image = (torch.tensor([10, 20, 30], dtype=torch.uint8)[:, None, None]).expand(3, HEIGHT, WIDTH)
    source(CAMERA, HEIGHT, WIDTH, image=image)
    assert seen[0].shape == (3, *size)
    expected = (np.array([10, 20, 30]) / 255 - IMAGENET_MEAN) / IMAGENET_STD
    np.testing.assert_allclose(seen[0][:, 5, 5], expected, rtol=1e-5)


def test_batches_pickles_and_dtypes(red: str) -> None:
    inverse = ground_and_wall()
    source = pickle.loads(pickle.dumps(DepthNetwork(red, output="inverse_depth", **PLAIN)))
    pictures = torch.stack([picture(inverse), picture(2 * inverse)])
    scene = scene_of(source, CAMERA, HEIGHT, WIDTH, image=pictures)
    assert scene.depth_m.shape == (2, 1, HEIGHT, WIDTH)
    torch.testing.assert_close(scene.depth_m[0, :, 50:], 2 * scene.depth_m[1, :, 50:])
    assert source(CAMERA, HEIGHT, WIDTH, image=pictures[0], dtype=torch.float64).dtype == torch.float64


def test_graphs_that_are_no_depth_network_are_refused_before_any_picture(tmp_path: Path) -> None:
    (tmp_path / "text.onnx").write_text("no graph")
    cases = [
        ("none.onnx", {}, "none.onnx: no such file; expected a depth network"),
        ("text.onnx", {}, "expected an ONNX graph; it cannot be read"),
        (written(tmp_path / "two.onnx", [1, 3, 8, 8], more_inputs=1), {}, "graph with one input.*more0 float"),
        (written(tmp_path / "grey.onnx", [1, 1, 8, 8]), {}, r"3 channels.*image float \(1, 1, 8, 8\)"),
        (written(tmp_path / "batch.onnx", [4, 3, 8, 8], out=[4, 1, 8, 8]), {}, "batch of 1 or of open size"),
        (written(tmp_path / "outs.onnx", [1, 3, 8, 8], more_outputs=1), {}, r"depth, other0.*name one by output_name"),
        (written(tmp_path / "ok.onnx", [1, 3, 8, 8]), {"output_name": "sky"}, "must be one of the graph's; got 'sky'"),
        (written(tmp_path / "nhwc.onnx", [1, 8, 8, 3], axis=3), {"layout": "NCHW"}, r"3 channels \(NCHW\)"),
        (written(tmp_path / "ok2.onnx", [1, 3, 8, 8]), {"providers": ("GreatExecutionProvider",)}, "GreatExecution"),
    ]
    for name, options, message in cases:
        with pytest.raises(TorchweatherError, match=message):
            DepthNetwork(tmp_path / name, **options)
    chosen = DepthNetwork(tmp_path / "outs.onnx", output_name="other0", output="inverse_depth", **PLAIN)
    assert chosen._graph().output_name == "other0"


def test_a_class_score_is_no_map(tmp_path: Path) -> None:
    nodes = [helper.make_node("Softmax", ["image"], ["classes"], axis=1)]
    ports = [helper.make_tensor_value_info(name, TensorProto.FLOAT, [1, 3, 8, 8]) for name in ("image", "classes")]
    graph = helper.make_graph(nodes, "classes", ports[:1], ports[1:])
    onnx.save(helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=9), tmp_path / "c.onnx")
    with pytest.raises(TorchweatherError, match=r"float map .* as output; .*classes float \(1, 3, 8, 8\)"):
        DepthNetwork(tmp_path / "c.onnx")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"output": "inverse"}, "output must be one of depth, inverse_depth, disparity.*'inverse_depth'"),
        ({"scale": "lidar"}, "scale must be 'metric' or 'ground', or the points as CompletedDepth"),
        ({"output": "disparity"}, "needs baseline_m"),
        ({"baseline_m": 0.5}, "baseline_m belongs to output='disparity'"),
        ({"std": (0.0, 1.0, 1.0)}, "std must be above 0"),
        ({"mean": (0.5,)}, "mean must be three numbers"),
        ({"multiple_px": 0}, "multiple_px must be above 0 px"),
    ],
)
def test_options_are_checked(red: str, options: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        DepthNetwork(red, **options)


def test_wrong_outputs_are_refused_with_the_remedy(tmp_path: Path, red: str) -> None:
    inverse = ground_and_wall()
    # Depth taken for inverse depth falls towards the camera.
    source = DepthNetwork(red, output="inverse_depth", scale="ground", **PLAIN)
    with pytest.raises(ValueError, match=r"does not rise towards the camera on the ground.*--depth-model-output"):
        source(CAMERA, HEIGHT, WIDTH, image=picture(0.02 / inverse))
    # A relative output taken for metres.
    with pytest.raises(ValueError, match=r"taken for metres gives the ground a median depth of .*scale='ground'"):
        DepthNetwork(red, **PLAIN)(CAMERA, HEIGHT, WIDTH, image=picture(0.1 * inverse))
    # Inverse depth taken for metric depth.
    with pytest.raises(ValueError, match=r"makes the ground nearer towards the horizon.*scale='ground'"):
        DepthNetwork(written(tmp_path / "ten.onnx", [1, 3, None, None], gain=10.0), **PLAIN)(
            CAMERA, HEIGHT, WIDTH, image=picture(inverse + 0.2)
        )
    up = dataclasses.replace(CAMERA, pitch_rad=1.0)
    with pytest.raises(ValueError, match="no ground nearer than 30 m is in view"):
        source(up, HEIGHT, WIDTH, image=picture(inverse))
    with pytest.raises(ValueError, match=r"one colour picture \(3, 96, 128\) as image; got \(1, 96, 128\).*Demosaic"):
        source(CAMERA, HEIGHT, WIDTH, image=torch.zeros(1, HEIGHT, WIDTH))
    not_finite = written(tmp_path / "nan.onnx", [1, 3, None, None], offset=float("nan"))
    with pytest.raises(TorchweatherError, match="must be finite; got 12288 other values"):
        DepthNetwork(not_finite, **PLAIN)(CAMERA, HEIGHT, WIDTH, image=picture(inverse))


@pytest.mark.real_data
@pytest.mark.parametrize("number", ["000001", "000004", "000020"])
def test_the_road_of_kitti_gives_lidar_depth_back_its_scale_and_shift(tmp_path: Path, number: str) -> None:
    """An exact network: the completed LiDAR as inverse depth, scaled, shifted and written into the picture's red."""
    folder = recording("kitti_13")
    rgb, _ = read_image(folder / "image_2" / f"{number}.png")
    height, width = rgb.shape[-2:]
    calibration = read_kitti_calibration(folder / "calib" / f"{number}.txt")
    camera = calibration.camera(width, height, height_m=1.65)
    points = read_kitti_points(folder / "velodyne" / f"{number}.bin")
    lidar = CompletedDepth(points, calibration.T_camera_from_lidar)
    truth = lidar.scene(camera, height, width, image=rgb)
    inverse = 1.0 / truth.depth_m[0].double()  # 0 in the sky
    # The horizon is that of the picture itself.
    level = dataclasses.replace(camera, pitch_rad=find_horizon(rgb, camera).pitch_rad)
    path = written(tmp_path / "red.onnx", [1, 3, None, None])
    options = {**PLAIN, "sky": truth.sky}
    by_ground = DepthNetwork(path, output="inverse_depth", scale="ground", **options)
    by_points = DepthNetwork(path, output="inverse_depth", scale=lidar, **options)
    image = picture((1.5 * inverse + 0.1).clamp(max=1.0))
    seen = torch.isfinite(truth.depth_m[0]) & (inverse < 0.6) & (truth.depth_m[0] < 60)
    # Of all thirteen frames: 2.5 % off on average, 9 % on the worst, which rises.
    for source, most in ((by_ground, 0.08), (by_points, 1e-3)):
        found = source(level, height, width, image=image)
        assert float(relative_error(found, inverse)[seen].median()) < most
