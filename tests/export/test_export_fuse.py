"""Weather and detector in one graph: joined, described, refused. With noise: test_export.py, test_export_lidar.py."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import onnxruntime
import pytest
import torch
from torch import Tensor, nn

from torchweather import __version__
from torchweather.atmosphere.weather import Fog
from torchweather.core.errors import TorchweatherError
from torchweather.export import MosaicToImage, fuse
from torchweather.image import develop
from torchweather.sensors import Camera
from torchweather.transforms import BayerFog

pytest.importorskip("onnxscript")
import onnx
from onnx import TensorProto, helper, numpy_helper

TRACED = (32, 40)
OTHER = (24, 56)
LIGHT = (0.5, 0.6, 0.7)
# float32 rounding: 1e-7 of the weather times the gain of the detectors, about 10.
TOLERANCE = 1e-5
WEIGHTS = torch.randn(4, 3, 3, 3, generator=torch.Generator().manual_seed(1))


def camera(height: int, width: int) -> Camera:
    return Camera.from_intrinsics(120.0, 120.0, (width - 1) / 2, (height - 1) / 2, width, height)


def session(path: Path) -> onnxruntime.InferenceSession:
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads, options.log_severity_level = 1, 3
    return onnxruntime.InferenceSession(path, options, providers=["CPUExecutionProvider"])


def scene(size: tuple[int, int]) -> tuple[Tensor, Tensor]:
    generator = torch.Generator().manual_seed(size[0])
    bayer = 0.1 + 0.6 * torch.rand(1, 1, *size, generator=generator)
    depth = 1.0 + 5.0 * torch.rand(1, 1, *size, generator=generator)
    depth[..., : size[0] // 4, :] = math.inf
    return bayer, depth


def camera_feed(of: Camera, bayer: Tensor, depth: Tensor, **intensities: float) -> dict[str, Any]:
    intrinsics = dict(zip(("fx", "fy", "cx", "cy"), of.intrinsics, strict=True))
    return {
        "bayer": bayer.numpy(),
        "depth": depth.numpy(),
        **{name: np.array(value, np.float32) for name, value in intrinsics.items()},
        **{name: np.array([value], np.float32) for name, value in intensities.items()},
    }


def foreign_detector(opset: int = 13, size: tuple[int | str, int | str] = ("rows", "columns")) -> onnx.ModelProto:
    """NHWC, 8 bit, with a branch that reads a weight of the outer graph, and names that the weather's graph has too."""
    image = helper.make_tensor_value_info("bayer", TensorProto.UINT8, [1, *size, 3])
    gate = helper.make_tensor_value_info("mor_m", TensorProto.FLOAT, [1])
    logits = helper.make_tensor_value_info("signal", TensorProto.FLOAT, [1, 4, "h", "w"])
    branch_out = helper.make_tensor_value_info("chosen", TensorProto.FLOAT, None)
    then = helper.make_graph([helper.make_node("Mul", ["edges", "gain"], ["chosen"])], "then", [], [branch_out])
    other = helper.make_graph([helper.make_node("Identity", ["edges"], ["chosen"])], "else", [], [branch_out])
    nodes = [
        helper.make_node("Cast", ["bayer"], ["float"], to=TensorProto.FLOAT),
        helper.make_node("Transpose", ["float"], ["planes"], perm=[0, 3, 1, 2]),
        helper.make_node("Conv", ["planes", "depth"], ["edges"], pads=[1, 1, 1, 1]),
        helper.make_node("ReduceMean", ["planes"], ["brightness"], axes=[1, 2, 3], keepdims=0),  # an input from 18 on
        helper.make_node("Greater", ["mor_m", "zero"], ["positive"]),
        helper.make_node("Squeeze", ["positive"], ["branch"]),
        helper.make_node("If", ["branch"], ["signal"], then_branch=then, else_branch=other),
    ]
    weights = [
        numpy_helper.from_array(WEIGHTS.numpy() / 255, "depth"),
        numpy_helper.from_array(np.array(3.0, np.float32), "gain"),
        numpy_helper.from_array(np.array(0.0, np.float32), "zero"),
    ]
    brightness = helper.make_tensor_value_info("brightness", TensorProto.FLOAT, [1])
    graph = helper.make_graph(nodes, "foreign", [image, gate], [logits, brightness], weights)
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", opset)], ir_version=8)
    model.metadata_props.add(key="author", value="somebody")
    onnx.checker.check_model(model)
    return model


@pytest.fixture(scope="module")
def fog_graph(quick: None, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("fused") / "fog.onnx"
    inputs = fuse(
        small_fog(),
        foreign_detector().SerializeToString(),
        path,
        between=MosaicToImage("RGGB", layout="NHWC", dtype="uint8", scale=255.0, colour="BGR"),
        connect={"bayer": "signal"},
        height=TRACED[0],
        width=TRACED[1],
    )
    assert "detector.mor_m" in inputs
    return path


def test_an_onnx_detector_of_an_older_opset_with_branches_and_equal_names_is_joined(fog_graph: Path) -> None:
    bayer, depth = scene(OTHER)
    there = BayerFog(Fog(mor_m=20.0), camera(*OTHER), airlight=LIGHT)
    picture = (develop(there(bayer, depth).clamp(0, 1), "RGGB").flip(-3) * 255).round()
    edges = nn.functional.conv2d(picture, WEIGHTS / 255, padding=1)
    run = session(fog_graph)
    feed = camera_feed(there.camera, bayer, depth, mor_m=20.0)
    for gate, factor in ((1.0, 3.0), (-1.0, 1.0)):
        got, brightness = run.run(["signal", "brightness"], feed | {"detector.mor_m": np.array([gate], np.float32)})
        # A picture of 8 bit: where torch and onnxruntime round apart, one step of 1/255 through the weights.
        off = np.abs(got - factor * edges.numpy())
        assert np.quantile(off, 0.99) < factor * TOLERANCE
        assert brightness[0] == pytest.approx(float(picture.mean()), abs=1e-2)
        assert off.max() < factor * float(WEIGHTS.abs().max()) / 255 * 1.01
    assert run.get_modelmeta().custom_metadata_map["author"] == "somebody"


class Edges(nn.Module):
    """A detector in torch: edges of the picture, and the strongest; its weights have the name of an input."""

    def __init__(self) -> None:
        super().__init__()
        self.register_buffer("depth", WEIGHTS)
        self.depth: Tensor

    def forward(self, image: Tensor) -> dict[str, Tensor]:
        found = nn.functional.conv2d(image, self.depth, padding=1, stride=2).relu()
        return {"map": found, "best": found.flatten(1).amax(1)}


@pytest.mark.usefixtures("quick")
def test_a_torch_detector_is_exported_with_what_is_between(tmp_path: Path) -> None:
    detector = Edges().train()
    path = tmp_path / "torch.onnx"
    inputs = fuse(small_fog(), detector, path, between=MosaicToImage("RGGB"), keep=["signal"])
    assert inputs == ["bayer", "depth", "fx", "fy", "cx", "cy", "mor_m"]
    assert detector.training
    bayer, depth = scene(OTHER)
    there = BayerFog(Fog(mor_m=20.0), camera(*OTHER), airlight=LIGHT)
    signal = there(bayer, depth)
    wanted = Edges()(develop(signal.clamp(0, 1), "RGGB"))
    run = session(path)
    assert [each.name for each in run.get_outputs()] == ["map", "best", "signal"]
    got = run.run(None, camera_feed(there.camera, bayer, depth, mor_m=20.0))
    for one, other in zip(got, [wanted["map"], wanted["best"], signal], strict=True):
        assert np.abs(one - other.numpy()).max() < TOLERANCE


def test_the_properties_say_version_equations_and_units(fog_graph: Path) -> None:
    said = session(fog_graph).get_modelmeta().custom_metadata_map
    assert said["torchweather_version"] == __version__
    transform = json.loads(said["torchweather_transform"])
    assert (transform["class"], transform["weather"]["mor_m"]) == ("BayerFog", 50.0)
    assert said["torchweather_equations"] == "docs/PHYSICS.md, sections 4, 2.3, 3"
    units = json.loads(said["torchweather_units"])
    assert units["mor_m"].startswith("m,")
    assert units["depth"].startswith("m ")
    assert "Philox" in said["torchweather_seeds"]


def small_fog() -> BayerFog:
    return BayerFog(Fog(mor_m=50.0), camera(*TRACED), airlight=LIGHT)


def value(name: str, kind: int, shape: list[int | str]) -> onnx.ValueInfoProto:
    return helper.make_tensor_value_info(name, kind, shape)


def same(*inputs: onnx.ValueInfoProto, opset: int = 20) -> onnx.ModelProto:
    """A detector that gives its first input back."""
    out = onnx.ValueInfoProto()
    out.CopyFrom(inputs[0])
    out.name = "out"
    graph = helper.make_graph([helper.make_node("Identity", [inputs[0].name], ["out"])], "same", [*inputs], [out])
    return helper.make_model(graph, opset_imports=[helper.make_opsetid("", opset)], ir_version=9)


@pytest.fixture(scope="module")
def quick() -> Iterator[None]:
    """One export of the fog for all: it takes seconds."""
    from torchweather.export import fusing

    export = fusing.traced_model
    made = export(small_fog(), height=32, width=40, points=10, columns=None, directions=None)

    def cached(transform: object, **sizes: Any) -> Any:
        return made if isinstance(transform, BayerFog) else export(transform, **sizes)  # type: ignore[arg-type]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(fusing, "traced_model", cached)
        yield


@pytest.mark.usefixtures("quick")
@pytest.mark.parametrize("opset", [15, 22])
def test_a_detector_of_a_fixed_size_and_another_opset_takes_data_of_its_size(opset: int, tmp_path: Path) -> None:
    detector = same(value("image", TensorProto.FLOAT, [1, 1, *OTHER]), opset=opset)
    fuse(small_fog(), detector, tmp_path / "fixed.onnx")
    bayer, depth = scene(OTHER)
    there = BayerFog(Fog(mor_m=20.0), camera(*OTHER), airlight=LIGHT)
    (got,) = session(tmp_path / "fixed.onnx").run(None, camera_feed(there.camera, bayer, depth, mor_m=20.0))
    assert np.abs(got - there(bayer, depth).numpy()).max() < TOLERANCE


MISFITS: dict[str, tuple[Callable[[], onnx.ModelProto], dict[str, Any], str]] = {
    "rank": (
        lambda: same(value("image", TensorProto.FLOAT, [1, "h", "w"])),
        {},
        r"signal float32 \(1, 1, .*\) does not fit image float32 \(1, h, w\): the weather gives.*between=",
    ),
    "colours": (
        lambda: same(value("image", TensorProto.FLOAT, [1, 3, "h", "w"])),
        {},
        r"does not fit image float32 \(1, 3, h, w\)",
    ),
    "type": (
        lambda: same(value("image", TensorProto.UINT8, [1, 1, "h", "w"])),
        {},
        r"does not fit image uint8 \(1, 1, h, w\)",
    ),
    "two inputs": (
        lambda: same(value("a", TensorProto.FLOAT, [1, 1, "h", "w"]), value("b", TensorProto.FLOAT, [1])),
        {},
        r"takes a float32 \(1, 1, h, w\), b float32 \(1\).*give connect=",
    ),
    "no such input": (
        lambda: same(value("image", TensorProto.FLOAT, [1, 1, "h", "w"])),
        {"connect": {"imgae": "signal"}},
        r"there is no 'imgae'.*takes image",
    ),
    "no such output": (
        lambda: same(value("image", TensorProto.FLOAT, [1, 1, "h", "w"])),
        {"connect": {"image": "cloud"}},
        r"there is no 'cloud': the weather gives signal",
    ),
    "keep": (
        lambda: same(value("image", TensorProto.FLOAT, [1, 1, "h", "w"])),
        {"keep": ["kind"]},
        r"keep must name outputs of the weather, signal.*got 'kind'",
    ),
}


@pytest.mark.usefixtures("quick")
@pytest.mark.parametrize("what", list(MISFITS))
def test_a_detector_that_does_not_fit_is_refused_with_both_sides(what: str, tmp_path: Path) -> None:
    make, options, message = MISFITS[what]
    with pytest.raises(ValueError, match=message):
        fuse(small_fog(), make(), tmp_path / "x.onnx", **options)
    assert not list(tmp_path.iterdir())


@pytest.mark.usefixtures("quick")
def test_a_disk_that_is_full_leaves_nothing_half_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "x.onnx").write_bytes(b"older")

    def full(self: Path, data: bytes) -> int:
        with self.open("wb") as file:
            file.write(data[:10])
        raise OSError(28, "No space left on device", str(self))

    monkeypatch.setattr(Path, "write_bytes", full)
    with pytest.raises(OSError, match="No space left"):
        fuse(small_fog(), same(value("image", TensorProto.FLOAT, [1, 1, "h", "w"])), tmp_path / "x.onnx")
    assert [path.name for path in tmp_path.iterdir()] == ["x.onnx"]
    assert (tmp_path / "x.onnx").read_bytes() == b"older"


def test_what_is_no_detector_is_refused_before_the_export(tmp_path: Path) -> None:
    (tmp_path / "broken.onnx").write_bytes(b"not a graph")
    for wrong in (tmp_path / "broken.onnx", b"not a graph"):
        with pytest.raises(TorchweatherError, match="expected an ONNX graph"):
            fuse(small_fog(), wrong, tmp_path / "x.onnx")
    with pytest.raises(TorchweatherError, match=r"none\.onnx: no such file"):
        fuse(small_fog(), tmp_path / "none.onnx", tmp_path / "x.onnx")
    with pytest.raises(TypeError, match="fuse: transform must be"):
        fuse(nn.Linear(1, 1), b"", tmp_path / "x.onnx")  # type: ignore[arg-type]
    with pytest.raises(FileNotFoundError, match="missing"):
        fuse(small_fog(), b"", tmp_path / "missing" / "x.onnx")


def test_a_picture_is_normalised_as_the_detector_wants_it() -> None:
    bayer = torch.rand(1, 1, 6, 8, generator=torch.Generator().manual_seed(0))
    rgb = develop(bayer, "GRBG")
    mean, std = (1.0, 2.0, 3.0), (4.0, 5.0, 6.0)
    got = MosaicToImage("GRBG", colour="BGR", scale=255.0, mean=mean, std=std)(bayer)
    assert torch.allclose(got[0, 0], (255 * rgb[0, 2] - 1.0) / 4.0, atol=1e-5)
    assert torch.allclose(got[0, 2], (255 * rgb[0, 0] - 3.0) / 6.0, atol=1e-5)
    for wrong in ({"layout": "NHCW"}, {"colour": "RBG"}, {"dtype": "int8"}, {"std": 0.0}, {"mean": (1.0, 2.0)}):
        with pytest.raises(ValueError, match="MosaicToImage"):
            MosaicToImage("RGGB", **wrong)  # type: ignore[arg-type]
