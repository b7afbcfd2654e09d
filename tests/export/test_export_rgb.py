"""ONNX of weather on RGB images: onnxruntime gives what torch gives, at other sizes, even and odd, than the traced."""

from __future__ import annotations

import copy
import json
import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import onnxruntime
import pytest
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from torchweather.atmosphere.weather import Fog, Mixture, Rain, Snow
from torchweather.camera.depth import EXACT, SceneDepth
from torchweather.core.errors import TorchweatherWarning
from torchweather.export import ImageToDetector, MosaicToImage, draw_feed, fuse, to_onnx
from torchweather.sensors import Camera, Lidar
from torchweather.transforms import AsBayer, BayerFog, BayerRain, BayerSnow, BayerWeather, LidarFog

pytest.importorskip("onnxscript")

Float = NDArray[np.float32]
Image = AsBayer | BayerWeather

TRACED = (32, 40)
SIZES = [(23, 57), (70, 38)]
# float32 rounds sums of linear light by 1e-7 (test_export.py), which sRGB's slope at black, 12.92, makes 1.3e-6;
# measured 1.1e-6.
TOLERANCE = 5e-6
FAR = 2000.0  # a visibility, m, at which the sky shows through a layer of fog


def camera(height: int, width: int, **more: Any) -> Camera:
    return Camera.from_intrinsics(120.0, 120.0, (width - 1) / 2, (height - 1) / 2, width, height, **more)


UP = {"pitch_rad": 0.3}  # the sky of the frame leaves a layer of 200 m after some 700 m


# One octave of depth is one shell of listed particles: small graphs, which export in seconds.
def fog(mor_m: float = 50.0, **more: Any) -> AsBayer:
    return AsBayer(BayerFog(Fog(mor_m), camera(*TRACED, **UP), **more))


def noisy_fog(mor_m: float = 50.0) -> AsBayer:
    noise = {"effect": "camera.sensor_noise", "electrons_per_unit": 1e4, "read_electrons": 4.0}  # a number a sample
    return fog(mor_m, effects=[noise])


def endless_fog(mor_m: float = 50.0) -> AsBayer:
    return fog(mor_m, layer_top_m=math.inf, airlight="sky")


def rain(rate: float = 25.0) -> AsBayer:
    return AsBayer(BayerRain(Rain(rate), camera(*TRACED), near_m=1.0, far_m=4.0, drop_radiance="upper"))


def snow(rate: float = 2.0) -> AsBayer:
    tilted = camera(*TRACED, roll_rad=0.2, pitch_rad=0.1, k1=-0.1, p1=1e-3)
    return AsBayer(BayerSnow(Snow(rate, wind_m_per_s=(0.0, 1.0, 0.0)), tilted, near_m=2.0, far_m=4.0))


def mixture(rate: float = 10.0, mor_m: float = 30.0) -> AsBayer:
    patchy = {"patch_log_std": 0.3, "patch_length_m": 10.0}
    both = Mixture(Rain(rate, **patchy), Fog(mor_m, **patchy))
    return AsBayer(BayerWeather(both, camera(*TRACED), near_m=2.0, far_m=4.0))


def fog_of_mosaic(mor_m: float = 50.0) -> BayerWeather:
    return fog(mor_m).transform


def endless_fog_of_mosaic(mor_m: float = 50.0) -> BayerWeather:
    return BayerFog(Fog(mor_m), camera(*TRACED, **UP), layer_top_m=math.inf, airlight="grey")


@dataclass(frozen=True)
class Case:
    make: Callable[..., Image]
    intensities: dict[str, float]
    """Graph input and a value other than the constructor's."""
    options: dict[str, Any] = field(default_factory=dict)

    @property
    def masks(self) -> bool:
        return bool(self.options.get("masks"))


CASES = {
    "fog": Case(fog, {"mor_m": FAR}),
    "noisy fog with masks": Case(noisy_fog, {"mor_m": FAR}, {"masks": True}),
    "endless fog": Case(endless_fog, {"mor_m": FAR}),
    "rain with masks": Case(rain, {"rate_mm_per_h": 7.0}, {"masks": True}),
    "snow": Case(snow, {"rate_mm_per_h": 0.7}),
    "mixture": Case(mixture, {"rate_mm_per_h": 40.0, "mor_m": 15.0}),
    "fog of a mosaic": Case(fog_of_mosaic, {"mor_m": FAR}, {"masks": True}),
    "endless fog of a mosaic": Case(endless_fog_of_mosaic, {"mor_m": FAR}),
}
LONG = ("endless fog", "endless fog of a mosaic", "snow", "mixture")


def cases(*left_out: str) -> pytest.MarkDecorator:
    names = [name for name in CASES if name not in left_out]
    return pytest.mark.parametrize(
        "name", [pytest.param(name, marks=[pytest.mark.long] if name in LONG else []) for name in names]
    )


every_case = cases()
every_case_without_noise_of_pixels = cases("noisy fog with masks")


def at_size(transform: Image, size: tuple[int, int], **intrinsics: float) -> Image:
    """The transform for another image, its stages as they are: the margins of the draw belong to the traced camera."""
    if isinstance(transform, AsBayer):
        other = at_size(transform.transform, size, **intrinsics)
        assert isinstance(other, BayerWeather)
        return AsBayer(other)
    moved = copy.copy(transform)
    middle = {"cx": (size[1] - 1) / 2, "cy": (size[0] - 1) / 2}
    moved.camera = replace(transform.camera, height=size[0], width=size[1], **(middle | intrinsics))
    moved.forget_rays()
    return moved


def scene(size: tuple[int, int], planes: int = 3, *, sky: bool = True) -> tuple[Tensor, SceneDepth]:
    """An image under a sky that brightens to the horizon, depths before and behind particles, and soft shares."""
    generator = torch.Generator().manual_seed(size[0])
    image = 0.02 + 0.6 * torch.rand(1, planes, *size, generator=generator)
    depth = 1.0 + 5.0 * torch.rand(1, 1, *size, generator=generator)
    shares = torch.zeros(2, 1, 1, *size)
    if sky:
        rows = size[0] // 3
        rising = torch.linspace(0.72, 0.86, rows)[:, None]
        image[..., :rows, :] = rising + 0.01 * torch.rand(1, planes, rows, size[1], generator=generator)
        depth[..., :rows, :] = math.inf
        shares[0, ..., : rows - 1, :], shares[0, ..., rows - 1, :] = 1.0, 0.7
    shares[1, ..., -4:, :], shares[1, ..., -5, :] = 1.0, 0.4
    return image, SceneDepth(depth, EXACT, sky=shares[0], near_mask=shares[1])


def opened(path: Path) -> onnxruntime.InferenceSession:
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads, options.log_severity_level = 1, 3
    return onnxruntime.InferenceSession(path, options, providers=["CPUExecutionProvider"])


def feed_of(of: Camera, image: Tensor, found: SceneDepth, *, masks: bool, **intensities: float) -> dict[str, Any]:
    feed = {"rgb" if image.shape[1] == 3 else "bayer": image.numpy(), "depth": found.depth_m.numpy()}
    if masks:
        assert found.sky is not None
        assert found.near_mask is not None
        feed |= {"sky": found.sky.numpy(), "near_mask": found.near_mask.numpy()}
    intrinsics = dict(zip(("fx", "fy", "cx", "cy"), of.intrinsics, strict=True))
    feed |= {name: np.array(value, np.float32) for name, value in intrinsics.items()}
    return feed | {name: np.array([value], np.float32) for name, value in intensities.items()}


class Graph:
    """An exported transform in onnxruntime."""

    def __init__(self, name: str, folder: Path) -> None:
        self.case = CASES[name]
        self.path = folder / f"{name}.onnx"
        self.transform = self.case.make()
        self.planes = 3 if isinstance(self.transform, AsBayer) else 1
        self.inputs = to_onnx(self.transform, self.path, height=TRACED[0], width=TRACED[1], **self.case.options)
        self.session = opened(self.path)

    def sizes(self) -> list[tuple[int, int]]:
        return SIZES if self.planes == 3 else [(24, 56), (70, 38)]

    def run(
        self, image: Tensor, found: SceneDepth, intensities: dict[str, float] | None = None, **intrinsics: float
    ) -> Float:
        """By onnxruntime, from a seed."""
        size = size_of(image)
        noise = draw_feed(self.session, height=size[0], width=size[1], seed=5)
        of = camera_of(at_size(self.transform, size, **intrinsics))
        feed = feed_of(of, image, found, masks=self.case.masks, **(intensities or self.case.intensities))
        (given,) = self.session.run(None, feed | noise)
        return np.asarray(given)

    def by_torch(self, image: Tensor, found: SceneDepth, **intrinsics: float) -> Float:
        """By torch, from the same seed."""
        there = at_size(self.case.make(*self.case.intensities.values()), size_of(image), **intrinsics)
        noise = there.draw(image, seed=5)
        return there(image, found if self.case.masks else found.depth_m, noise).numpy()


def size_of(image: Tensor) -> tuple[int, int]:
    return int(image.shape[-2]), int(image.shape[-1])


def camera_of(transform: Image) -> Camera:
    return transform.transform.camera if isinstance(transform, AsBayer) else transform.camera


@pytest.fixture(scope="module")
def graphs(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Graph]:
    folder = tmp_path_factory.mktemp("graphs")
    made: dict[str, Graph] = {}

    def graph(name: str) -> Graph:
        if name not in made:
            made[name] = Graph(name, folder)
        return made[name]

    return graph


@every_case
@pytest.mark.parametrize("number", [0, 1])
def test_onnxruntime_gives_what_torch_gives_at_other_sizes_and_intensities(
    graphs: Callable[[str], Graph], name: str, number: int
) -> None:
    graph = graphs(name)
    size = graph.sizes()[number]
    image, found = scene(size, graph.planes)
    wanted, got = graph.by_torch(image, found), graph.run(image, found)
    assert got.shape == (1, graph.planes, *size)
    assert np.abs(wanted - image.numpy()).max() > 100 * TOLERANCE  # there is something to compare
    assert np.abs(got - wanted).max() < TOLERANCE


def test_the_intrinsics_are_inputs_of_the_graph(graphs: Callable[[str], Graph]) -> None:
    graph, (image, found) = graphs("fog"), scene(SIZES[0])
    other = {"fx": 60.0, "fy": 50.0, "cx": 20.0, "cy": 15.5}
    got = graph.run(image, found, **other)
    assert np.abs(got - graph.by_torch(image, found, **other)).max() < TOLERANCE
    assert np.abs(got - graph.run(image, found)).max() > 100 * TOLERANCE


# ---- fog's top and its light ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("planes", [3, 1])
def test_the_scene_tells_a_layer_of_fog_from_endless_fog(planes: int) -> None:
    """The parity above is one of the layer's top: without it, torch itself gives another picture."""
    image, found = scene((24, 56), planes)
    both = [at_size(fog(FAR, layer_top_m=top_m), (24, 56)) for top_m in (200.0, math.inf)]
    finite, endless = (each if planes == 3 else each.transform for each in both if isinstance(each, AsBayer))
    assert (finite(image, found) - endless(image, found))[..., :7, :].abs().max() > 100 * TOLERANCE


def test_the_scene_tells_the_sky_at_the_horizon_from_the_mean_of_all_sky() -> None:
    """The parity above is one of the airlight's weights: it is no end of its range, and not the mean."""
    image, found = scene((70, 38))
    light = at_size(fog(FAR), (70, 38)).run(image, found).airlight[0, 1]  # type: ignore[union-attr]
    assert 0.5 < light < 0.7
    mean = (((image[..., :22, :] + 0.055) / 1.055) ** 2.4).mean()
    assert abs(light - mean) > 0.01


@pytest.mark.parametrize("name", ["fog", "fog of a mosaic"])
def test_where_no_sky_shows_the_same_light_stands_in(graphs: Callable[[str], Graph], name: str) -> None:
    graph = graphs(name)
    image, found = scene(graph.sizes()[0], graph.planes, sky=False)
    with pytest.warns(TorchweatherWarning, match="no sky in the frame"):
        wanted = graph.by_torch(image, found)
    assert np.abs(graph.run(image, found) - wanted).max() < TOLERANCE


def test_a_sky_between_the_pixels_that_are_looked_at_first_gives_its_light(graphs: Callable[[str], Graph]) -> None:
    graph, (image, found) = graphs("fog"), scene(SIZES[0], sky=False)
    found.depth_m[..., 1:3, 3:9] = math.inf  # the first look takes every fourth row and every sixteenth column
    image[..., 1:3, 3:9] = 0.3  # 0.073 of linear light: dusk, whose grey is kept
    wanted = graph.by_torch(image, found)
    assert np.abs(graph.run(image, found) - wanted).max() < TOLERANCE


# ---- what does not change ------------------------------------------------------------------------------------------


@every_case_without_noise_of_pixels
def test_at_zero_rate_and_infinite_visibility_the_image_comes_back_bit_for_bit(
    graphs: Callable[[str], Graph], name: str
) -> None:
    graph = graphs(name)
    image, found = scene(graph.sizes()[0], graph.planes)
    image[..., 2, :3] = torch.tensor([0.0, 1.0, 0.04045])
    intensities = {key: math.inf if key == "mor_m" else 0.0 for key in graph.case.intensities}
    assert graph.run(image, found, intensities).tobytes() == image.numpy().tobytes()


def test_the_own_vehicle_keeps_its_bits_in_rain(graphs: Callable[[str], Graph]) -> None:
    graph, (image, found) = graphs("rain with masks"), scene(SIZES[1])
    got = graph.run(image, found, {"rate_mm_per_h": 100.0})
    assert got[..., -4:, :].tobytes() == image[..., -4:, :].numpy().tobytes()
    assert np.abs(got - image.numpy())[..., :-5, :].mean() > 1e-3


@every_case
def test_the_transform_is_left_as_it_was(graphs: Callable[[str], Graph], name: str) -> None:
    graph, fresh = graphs(name), CASES[name].make().state_dict()
    assert graph.transform.training
    assert all(torch.equal(value, fresh[key]) for key, value in graph.transform.state_dict().items())
    assert not list(graph.path.parent.glob(".*"))  # nothing half written


# ---- inputs and what the graph says of them ------------------------------------------------------------------------


@every_case
def test_the_inputs_are_named_in_order(graphs: Callable[[str], Graph], name: str) -> None:
    graph = graphs(name)
    shares = ["sky", "near_mask"] if graph.case.masks else []
    data = ["rgb" if graph.planes == 3 else "bayer", "depth", *shares, "fx", "fy", "cx", "cy"]
    noise = list(graph.transform.draw(torch.zeros(graph.planes, *TRACED), seed=0))
    assert graph.inputs[: len(data)] == data
    assert sorted(graph.inputs[len(data) :]) == sorted([*graph.case.intensities, *noise])
    assert {node.name for node in graph.session.get_inputs()} <= set(graph.inputs)
    (output,) = graph.session.get_outputs()
    assert output.name == ("weathered" if graph.planes == 3 else "signal")


@every_case
def test_draw_feed_gives_the_numbers_of_draw_bit_for_bit(graphs: Callable[[str], Graph], name: str) -> None:
    graph = graphs(name)
    size = graph.sizes()[0]
    noise = at_size(graph.transform, size).draw(torch.zeros(1, graph.planes, *size), seed=77)
    feed = draw_feed(graph.session, height=size[0], width=size[1], seed=77)
    assert set(feed) == set(noise)
    assert all(np.array_equal(feed[key], value.numpy()) for key, value in noise.items())
    if name == "noisy fog with masks":
        assert feed["sensor_noise.electrons"].shape == (1, 3, *size)


def test_the_properties_say_image_units_and_weather(graphs: Callable[[str], Graph]) -> None:
    said = graphs("noisy fog with masks").session.get_modelmeta().custom_metadata_map
    units = json.loads(said["torchweather_units"])
    assert list(units) == graphs("noisy fog with masks").inputs
    assert units["rgb"].startswith("sRGB")
    assert "share" in units["sky"]
    assert "own vehicle" in units["near_mask"]
    transform = json.loads(said["torchweather_transform"])
    assert (transform["class"], transform["image"], transform["weather"]["mor_m"]) == ("BayerFog", "rgb", 50.0)
    mosaic = graphs("fog of a mosaic").session.get_modelmeta().custom_metadata_map
    assert json.loads(mosaic["torchweather_transform"])["image"] == "bayer"


def test_a_feed_for_a_size_that_is_none_is_refused(graphs: Callable[[str], Graph]) -> None:
    with pytest.raises(ValueError, match=r"draw_feed: height and width must be 1 px or more; got 0 x 40"):
        draw_feed(graphs("fog").path, height=0, width=40, seed=0)
    with pytest.raises(ValueError, match=r"draw_feed: height and width must be even"):
        draw_feed(graphs("fog of a mosaic").path, height=23, width=40, seed=0)


def test_what_no_graph_does_is_refused_before_the_export(tmp_path: Path) -> None:
    through = AsBayer(BayerFog(Fog(50.0), camera(*TRACED)), through_mosaic=True)
    with pytest.raises(ValueError, match=r"AsBayer\.through_mosaic: .*Take its transform"):
        to_onnx(through, tmp_path / "x.onnx")
    with pytest.raises(ValueError, match=r"AsBayer\.through_mosaic: .*Take its transform"):
        fuse(through, Brightness(), tmp_path / "x.onnx")
    with pytest.raises(ValueError, match="to_onnx: height and width must be 4 or more; got 3 x 40"):
        to_onnx(fog(), tmp_path / "x.onnx", height=3, width=40)
    lidar = LidarFog(Fog(50.0), Lidar.preset("velodyne-hdl-64e", intensity_unit="reflectivity"))
    with pytest.raises(ValueError, match="masks=True adds shares of a camera's pixels; LidarFog has none"):
        to_onnx(lidar, tmp_path / "x.onnx", masks=True)
    assert not list(tmp_path.iterdir())


# ---- with a detector -----------------------------------------------------------------------------------------------


class Brightness(nn.Module):
    """A detector of NHWC pictures of 0..255, blue first: the mean of each colour, and the picture."""

    def forward(self, image: Tensor) -> tuple[Tensor, Tensor]:
        return image.to(torch.float32).mean((1, 2)), image


@pytest.mark.parametrize("dtype", ["float32", "uint8"])
def test_a_detector_of_images_is_joined(
    graphs: Callable[[str], Graph], dtype: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The weather's graph has been exported before."""
    import onnx

    from torchweather.export import graph as graph_module

    weather, (image, found) = graphs("fog"), scene(SIZES[0])
    exported = onnx.load(weather.path)
    monkeypatch.setattr(graph_module, "_traced", lambda _: exported)
    between = ImageToDetector(layout="NHWC", colour="BGR", scale=255.0, dtype=dtype)
    path = tmp_path / "fused.onnx"
    names = ["means", "picture"]
    size = {"height": TRACED[0], "width": TRACED[1]}
    inputs = fuse(weather.transform, Brightness(), path, between=between, outputs=names, keep=["weathered"], **size)
    assert set(inputs) == set(weather.inputs)
    run = opened(path)
    feed = feed_of(camera_of(at_size(weather.transform, SIZES[0])), image, found, masks=False, mor_m=FAR)
    means, picture, weathered = run.run(None, feed)
    wanted = torch.from_numpy(weather.by_torch(image, found))
    assert np.abs(weathered - wanted.numpy()).max() < TOLERANCE
    for got, one in zip((means, picture), Brightness()(between(wanted)), strict=True):
        assert got.dtype == one.numpy().dtype
        # Where torch and onnxruntime round apart, one step of 8 bit.
        assert np.abs(got.astype(float) - one.numpy()).max() <= (1.0 if dtype == "uint8" else 255 * TOLERANCE)
    off = picture.astype(float) - between(wanted).numpy()
    assert np.abs(off).mean() < 255 * TOLERANCE
    assert draw_feed(run, height=23, width=57, seed=1) == {}  # the joined graph says that odd sizes go


def test_an_image_has_the_form_of_a_developed_mosaic() -> None:
    rgb = torch.rand(1, 3, 5, 7, generator=torch.Generator().manual_seed(0))
    form: dict[str, Any] = {"colour": "BGR", "scale": 255.0, "mean": (1.0, 2.0, 3.0), "std": (4.0, 5.0, 6.0)}
    got = ImageToDetector(**form)(rgb)
    assert torch.equal(got, MosaicToImage("GRBG", **form).encoded(rgb))
    assert torch.allclose(got[0, 0], (255 * rgb[0, 2] - 1.0) / 4.0, atol=1e-5)
    assert torch.equal(ImageToDetector(layout="NHWC")(rgb)[0, 2, 3], rgb[0, :, 2, 3])
    for wrong in ({"layout": "NHCW"}, {"colour": "RBG"}, {"dtype": "int8"}, {"std": 0.0}, {"mean": (1.0, 2.0)}):
        with pytest.raises(ValueError, match="ImageToDetector"):
            ImageToDetector(**wrong)  # type: ignore[arg-type]
