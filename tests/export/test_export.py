"""ONNX: onnxruntime gives what torch gives, at other sizes, intensities and intrinsics than those traced."""

from __future__ import annotations

import copy
import itertools
import math
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import onnxruntime
import pytest
import torch
from numpy.typing import NDArray
from torch import Tensor

from torchweather.atmosphere.weather import Fog, Mixture, Rain, Snow
from torchweather.core.errors import TorchweatherError
from torchweather.core.random import ABSENT
from torchweather.export import draw_feed, fuse, to_onnx
from torchweather.sensors import Camera
from torchweather.transforms import BayerFog, BayerRain, BayerSnow, BayerWeather

pytest.importorskip("onnxscript")

TRACED = (32, 40)
SIZES = [(24, 56), (70, 38)]
FOCAL_PX = 120.0
LIGHT = (0.5, 0.6, 0.7)
# float32 rounding of sums of some hundred terms; measured 1e-7.
TOLERANCE = 1e-5
Float = NDArray[np.float32]


def camera(height: int, width: int, **more: Any) -> Camera:
    return Camera.from_intrinsics(FOCAL_PX, FOCAL_PX, (width - 1) / 2, (height - 1) / 2, width, height, **more)


# One octave of depth is one shell of listed particles: small graphs, which export in seconds.
def rain(size: tuple[int, int], rate: Any = 25.0) -> BayerWeather:
    return BayerRain(Rain(rate), camera(*size), airlight=LIGHT, near_m=1.0, far_m=4.0)


def fog(size: tuple[int, int], mor_m: Any = 50.0) -> BayerWeather:
    return BayerFog(Fog(mor_m), camera(*size, bayer_pattern="GBRG"))


def snow(size: tuple[int, int], rate: Any = 2.0) -> BayerWeather:
    tilted = camera(*size, roll_rad=0.2, pitch_rad=0.1, k1=-0.1, p1=1e-3)
    return BayerSnow(Snow(rate, wind_m_per_s=(0.0, 1.0, 0.0)), tilted, near_m=2.0, far_m=4.0)


def mixture(size: tuple[int, int], rate: Any = 10.0, mor_m: Any = 30.0) -> BayerWeather:
    patchy = {"patch_log_std": 0.3, "patch_length_m": 10.0}
    both = Mixture(Rain(rate, **patchy), Fog(mor_m, **patchy))
    return BayerWeather(both, camera(*size), airlight=LIGHT, near_m=2.0, far_m=4.0)


@dataclass(frozen=True)
class Case:
    make: Callable[..., BayerWeather]
    intensities: dict[str, float]
    """Graph input and a value other than the constructor's."""


CASES = {
    "rain": Case(rain, {"rate_mm_per_h": 7.0}),
    "fog": Case(fog, {"mor_m": 120.0}),
    "snow": Case(snow, {"rate_mm_per_h": 0.7}),
    "mixture": Case(mixture, {"rate_mm_per_h": 40.0, "mor_m": 15.0}),
}
LONG = ("snow", "mixture")
every_case = pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[pytest.mark.long] if name in LONG else []) for name in CASES]
)


def at_size(transform: BayerWeather, size: tuple[int, int], **intrinsics: float) -> BayerWeather:
    """The transform for another frame, its stages as they are: the margins of the draw belong to the traced camera."""
    other = copy.copy(transform)
    middle = {"cx": (size[1] - 1) / 2, "cy": (size[0] - 1) / 2}
    other.camera = replace(transform.camera, height=size[0], width=size[1], **{**middle, **intrinsics})
    return other


class Graph:
    """An exported transform in onnxruntime."""

    def __init__(self, name: str, folder: Path) -> None:
        self.path = folder / f"{name}.onnx"
        self.transform = CASES[name].make(TRACED)
        self.state_before = {key: value.clone() for key, value in self.transform.state_dict().items()}
        self.inputs = to_onnx(self.transform, self.path, height=TRACED[0], width=TRACED[1])
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = 1
        options.log_severity_level = 3
        self.session = onnxruntime.InferenceSession(self.path, options, providers=["CPUExecutionProvider"])

    def __call__(
        self, of: Camera, bayer: Tensor, depth: Tensor, intensities: dict[str, float], feed: dict[str, Float]
    ) -> Float:
        fx, fy, cx, cy = (np.float32(value) for value in of.intrinsics)
        given = {
            "bayer": bayer.numpy(),
            "depth": depth.numpy(),
            "fx": fx,
            "fy": fy,
            "cx": cx,
            "cy": cy,
            **{key: np.array([value], np.float32) for key, value in intensities.items()},
            **feed,
        }
        (signal,) = self.session.run(None, {key: np.asarray(value) for key, value in given.items()})
        return np.asarray(signal)


@pytest.fixture(scope="module")
def graphs(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Graph]:
    folder = tmp_path_factory.mktemp("graphs")
    made: dict[str, Graph] = {}

    def graph(name: str) -> Graph:
        if name not in made:
            made[name] = Graph(name, folder)
        return made[name]

    return graph


def scene(size: tuple[int, int]) -> tuple[Tensor, Tensor]:
    """A frame, and a depth that puts particles before and behind the scene, with sky in the upper rows."""
    generator = torch.Generator().manual_seed(size[0])
    bayer = 0.1 + 0.6 * torch.rand(1, 1, *size, generator=generator)
    depth = 1.0 + 5.0 * torch.rand(1, 1, *size, generator=generator)
    depth[..., : size[0] // 4, :] = math.inf
    return bayer, depth


@every_case
@pytest.mark.parametrize("size", SIZES, ids=lambda size: f"{size[0]}x{size[1]}")
def test_onnxruntime_gives_what_torch_gives_at_other_sizes_and_intensities(
    graphs: Callable[[str], Graph], name: str, size: tuple[int, int]
) -> None:
    case, graph = CASES[name], graphs(name)
    bayer, depth = scene(size)
    transform = at_size(case.make(TRACED, *case.intensities.values()), size)
    wanted = transform(bayer, depth, transform.draw(bayer, seed=5))
    feed = draw_feed(graph.session, height=size[0], width=size[1], seed=5)
    got = graph(transform.camera, bayer, depth, case.intensities, feed)
    assert got.shape == (1, 1, *size)
    assert float((wanted - bayer).abs().max()) > 100 * TOLERANCE  # there is something to compare
    assert np.abs(got - wanted.numpy()).max() < TOLERANCE


@every_case
def test_the_intrinsics_are_inputs_of_the_graph(graphs: Callable[[str], Graph], name: str) -> None:
    case, graph, size = CASES[name], graphs(name), SIZES[0]
    bayer, depth = scene(size)
    built = case.make(TRACED, *case.intensities.values())
    other = at_size(built, size, fx=100.0, fy=90.0, cx=20.0, cy=15.5)
    noise = other.draw(bayer, seed=9)
    wanted = other(bayer, depth, noise)
    feed = {key: value.numpy() for key, value in noise.items()}
    got = graph(other.camera, bayer, depth, case.intensities, feed)
    assert np.abs(got - wanted.numpy()).max() < TOLERANCE
    as_traced = graph(at_size(built, size).camera, bayer, depth, case.intensities, feed)
    assert np.abs(as_traced - got).max() > 10 * TOLERANCE


@every_case
def test_the_inputs_are_named_in_order(graphs: Callable[[str], Graph], name: str) -> None:
    graph = graphs(name)
    noise = list(CASES[name].make(TRACED).draw(torch.zeros(1, *TRACED), seed=0))
    assert graph.inputs[:6] == ["bayer", "depth", "fx", "fy", "cx", "cy"]
    assert sorted(graph.inputs[6:]) == sorted([*CASES[name].intensities, *noise])
    # Of BayerFog with the frame's own sky the graph needs all of them; an input that nothing reads may be left out.
    assert {node.name for node in graph.session.get_inputs()} <= set(graph.inputs)


@every_case
def test_draw_feed_gives_the_numbers_of_draw_bit_for_bit(graphs: Callable[[str], Graph], name: str) -> None:
    graph, size = graphs(name), SIZES[1]
    noise = at_size(CASES[name].make(TRACED), size).draw(torch.zeros(1, 1, *size), seed=77)
    for model in (graph.session, graph.path, graph.path.read_bytes()):
        feed = draw_feed(model, height=size[0], width=size[1], seed=77)
        assert set(feed) == set(noise)
        for key, value in noise.items():
            assert feed[key].dtype == np.float32
            assert np.array_equal(feed[key], value.numpy())


def test_shells_of_a_graph_hold_unused_slots(graphs: Callable[[str], Graph]) -> None:
    graph, size = graphs("rain"), SIZES[0]
    bayer, depth = scene(size)
    whole = draw_feed(graph.session, height=size[0], width=size[1], seed=5)
    shells = [name for name in whole if "shell" in name]
    unused = np.full((1, 3, 4), ABSENT, np.float32)
    longer = {name: np.concatenate([value, unused], 1) if name in shells else value for name, value in whole.items()}
    assert len(shells) > 1
    given = (graph.transform.camera, bayer, depth, {"rate_mm_per_h": 25.0})
    assert np.array_equal(graph(*given, longer), graph(*given, whole))


def test_a_feed_at_the_rate_is_the_first_part_of_the_whole_feed_and_gives_the_same(
    graphs: Callable[[str], Graph],
) -> None:
    graph, size = graphs("rain"), SIZES[1]
    bayer, depth = scene(size)
    whole = draw_feed(graph.session, height=size[0], width=size[1], seed=5)
    points = [key for key in whole if "_shell_" in key]
    slots = [sum(len(whole[key][0]) for key in points)]
    for rate in (30.0, 0.3, 0.0):
        feed = draw_feed(graph.session, height=size[0], width=size[1], seed=5, rates={"rate_mm_per_h": rate})
        assert all(np.array_equal(feed[key], whole[key][:, : feed[key].shape[1]]) for key in points)
        slots.append(sum(len(feed[key][0]) for key in points))
        drawn = at_size(rain(TRACED, rate), size).draw(bayer, seed=5, at_rate=True)
        more = [feed[key].shape[1] - drawn[key].shape[1] for key in points]
        assert min(more) >= 0
        assert max(more) <= 8  # a straight line over the table's rates
        place = (graph.transform.camera, bayer, depth, {"rate_mm_per_h": rate})
        assert np.array_equal(graph(*place, feed), graph(*place, whole))
    assert slots == sorted(slots, reverse=True)
    assert slots[2] < 0.5 * slots[0]


@pytest.mark.parametrize("rates", [{"rate": 1.0}, {"mor_m": 1.0}, {"rate_mm_per_h": -1.0}, {"rate_mm_per_h": "1"}])
def test_a_feed_at_a_rate_that_the_graph_does_not_have_is_refused(
    graphs: Callable[[str], Graph], rates: dict[str, Any]
) -> None:
    with pytest.raises(TorchweatherError, match="rate_mm_per_h"):
        draw_feed(graphs("rain").session, height=8, width=8, seed=5, rates=rates)


class Detector(torch.nn.Module):
    """Sums over 4 x 4 pixels; its weights have the name of an input of the weather."""

    def __init__(self) -> None:
        super().__init__()
        self.register_buffer("depth", torch.ones(1, 1, 4, 4))
        self.depth: Tensor

    def forward(self, mosaic: Tensor) -> Tensor:
        return torch.nn.functional.conv2d(mosaic, self.depth, stride=2)


@pytest.fixture(scope="module")
def fused(graphs: Callable[[str], Graph], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The rain and a detector in one graph; the rain has been exported before."""
    import onnx

    from torchweather.export import graph

    path = tmp_path_factory.mktemp("fused") / "fused.onnx"
    exported = onnx.load(graphs("rain").path)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(graph, "_traced", lambda _: exported)
        inputs = fuse(graphs("rain").transform, Detector(), path, outputs=["sums"], height=TRACED[0], width=TRACED[1])
    assert set(inputs) == set(graphs("rain").inputs)
    return path


@pytest.mark.parametrize("size", SIZES, ids=lambda size: f"{size[0]}x{size[1]}")
def test_with_a_detector_in_the_graph_it_gives_what_torch_gives_at_other_sizes_and_rates(
    graphs: Callable[[str], Graph], fused: Path, size: tuple[int, int]
) -> None:
    bayer, depth = scene(size)
    transform = at_size(rain(TRACED, 7.0), size)
    wanted = Detector()(transform(bayer, depth, transform.draw(bayer, seed=5)))
    graph = copy.copy(graphs("rain"))
    graph.session = onnxruntime.InferenceSession(fused, providers=["CPUExecutionProvider"])
    feed = draw_feed(fused, height=size[0], width=size[1], seed=5)
    got = graph(transform.camera, bayer, depth, {"rate_mm_per_h": 7.0}, feed)
    assert np.abs(got - wanted.numpy()).max() < 16 * TOLERANCE  # a sum of 16 pixels
    lighter = graph(transform.camera, bayer, depth, {"rate_mm_per_h": 0.5}, feed)
    assert np.abs(lighter - got).max() > 160 * TOLERANCE  # the rate matters


def test_the_rate_is_swept_by_onnxruntime_alone(fused: Path) -> None:
    code = f"""
import sys
import numpy as np, onnxruntime
from torchweather.export import draw_feed
run = onnxruntime.InferenceSession({str(fused)!r}, providers=["CPUExecutionProvider"])
noise = draw_feed(run, height=24, width=56, seed=3)
feed = dict(bayer=np.full((1, 1, 24, 56), 0.1, np.float32), depth=np.full((1, 1, 24, 56), 10, np.float32))
feed |= {{name: np.array(value, np.float32) for name, value in dict(fx=120, fy=120, cx=27.5, cy=11.5).items()}}
means = [run.run(["sums"], feed | noise | dict(rate_mm_per_h=np.array([rate], np.float32)))[0].mean(dtype=float)
         for rate in (0, 5, 50, 200)]
assert all(low < high for low, high in zip(means, means[1:])), means
assert "torch" not in sys.modules
"""
    subprocess.run([sys.executable, "-c", code], check=True, cwd=Path(__file__).parents[2], timeout=60)


def test_draw_feed_and_the_graph_run_where_torch_is_not_loaded(graphs: Callable[[str], Graph], tmp_path: Path) -> None:
    graph = graphs("rain")
    code = f"""
import sys
import numpy as np
from torchweather.export import draw_feed
np.savez({str(tmp_path / "feed.npz")!r}, **draw_feed({str(graph.path)!r}, height=24, width=56, seed=3))
assert "torch" not in sys.modules
"""
    root = Path(__file__).parents[2]
    subprocess.run([sys.executable, "-c", code], check=True, cwd=root, timeout=60)
    noise = at_size(rain(TRACED), SIZES[0]).draw(torch.zeros(1, 1, *SIZES[0]), seed=3)
    with np.load(tmp_path / "feed.npz") as feed:
        assert set(feed.files) == set(noise)
        assert all(np.array_equal(feed[key], noise[key].numpy()) for key in noise)


@every_case
def test_the_graph_knows_no_weather_at_zero_rate_and_infinite_visibility(
    graphs: Callable[[str], Graph], name: str
) -> None:
    graph, size = graphs(name), SIZES[0]
    bayer, depth = scene(size)
    intensities = {key: math.inf if key == "mor_m" else 0.0 for key in CASES[name].intensities}
    feed = draw_feed(graph.session, height=size[0], width=size[1], seed=1)
    assert np.array_equal(graph(camera(*size), bayer, depth, intensities, feed), bayer.numpy())


def test_more_rain_never_lowers_the_mask_in_the_graph(graphs: Callable[[str], Graph]) -> None:
    """On a black frame under a white sky the signal is the share of the sky in the drops, which rises with the mask."""
    graph, size = graphs("rain"), SIZES[0]
    depth = torch.full((1, 1, *size), 10.0)
    feed = draw_feed(graph.session, height=size[0], width=size[1], seed=1)
    means = [
        float(graph(camera(*size), torch.zeros(1, 1, *size), depth, {"rate_mm_per_h": rate}, feed).mean(dtype=float))
        for rate in (0.0, 1.0, 5.0, 20.0, 50.0, 100.0)
    ]
    assert all(low < high for low, high in itertools.pairwise(means))


@pytest.mark.parametrize("size", [(31, 40), (32, 41), (2, 40), (0, 0)])
def test_a_traced_size_that_is_no_mosaic_is_refused(size: tuple[int, int], tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=rf"to_onnx: height and width must be even, 4 or more; got {size[0]} x"):
        to_onnx(fog((24, 32)), tmp_path / "fog.onnx", height=size[0], width=size[1])
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("size", [(31, 40), (32, 0)])
def test_a_feed_for_a_size_that_is_no_mosaic_is_refused(graphs: Callable[[str], Graph], size: tuple[int, int]) -> None:
    with pytest.raises(ValueError, match=r"draw_feed: height and width must be even"):
        draw_feed(graphs("fog").path, height=size[0], width=size[1], seed=0)


@pytest.mark.parametrize("library", ["onnx", "onnxscript"])
def test_a_missing_library_is_reported_with_the_extra_to_install(
    library: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setitem(sys.modules, library, None)
    with pytest.raises(ImportError, match=r"torchweather\[export\]"):
        to_onnx(fog((24, 32)), tmp_path / "fog.onnx")


def test_what_is_no_transform_is_refused(tmp_path: Path) -> None:
    with pytest.raises(TypeError, match=r"to_onnx: transform must be a Bayer transform.*got Linear"):
        to_onnx(torch.nn.Linear(1, 1), tmp_path / "x.onnx")  # type: ignore[arg-type]


def test_a_folder_that_is_not_there_is_reported_before_the_work(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match="missing"):
        to_onnx(fog((24, 32)), tmp_path / "missing" / "fog.onnx")


def test_a_graph_from_elsewhere_is_refused(tmp_path: Path) -> None:
    import onnx
    from onnx import TensorProto, helper

    value = helper.make_tensor_value_info("x", TensorProto.FLOAT, [1])
    same = helper.make_tensor_value_info("y", TensorProto.FLOAT, [1])
    opsets = [helper.make_opsetid("", 20)]
    graph = helper.make_graph([helper.make_node("Identity", ["x"], ["y"])], "plain", [value], [same])
    plain = helper.make_model(graph, opset_imports=opsets, ir_version=9)
    onnx.save(plain, tmp_path / "plain.onnx")
    with pytest.raises(TorchweatherError, match=r"written by torchweather\.export\.to_onnx"):
        draw_feed(tmp_path / "plain.onnx", height=24, width=32, seed=0)
    (tmp_path / "broken.onnx").write_bytes(b"not a graph")
    with pytest.raises(TorchweatherError, match=r"broken.onnx: expected an ONNX graph"):
        draw_feed(tmp_path / "broken.onnx", height=24, width=32, seed=0)


@every_case
def test_the_transform_is_left_as_it_was(graphs: Callable[[str], Graph], name: str) -> None:
    graph = graphs(name)
    assert graph.transform.training
    assert graph.transform.chain.training
    state = graph.transform.state_dict()
    assert all(torch.equal(state[key], value) for key, value in graph.state_before.items())
    assert not list(graph.path.parent.glob(".*"))  # nothing half written
