"""ONNX export of LiDAR transforms: the graph gives what torch gives, for other clouds and intensities."""

from __future__ import annotations

import math
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import onnxruntime
import pytest
import torch
from numpy.typing import NDArray
from torch import Tensor

from torchweather.atmosphere.weather import Fog, Mixture, Rain, Snow
from torchweather.export import draw_feed, fuse, to_onnx
from torchweather.export.lidar_graph import traceable_lidar
from torchweather.sensors import Lidar
from torchweather.stages import PointKind
from torchweather.transforms import LidarFog, LidarRain, LidarSnow, LidarWeather

pytest.importorskip("onnxscript")

TRACED = 100
# Batch and points, neither as traced.
SIZES = [(1, 3000), (3, 501)]
# float32 rounding through the tables: 3e-6 measured. Relative to range, and to the intensity's own size. The farthest
# particles of a signal are placed by sqrt(1 - share), which magnifies a rounding of 6e-8 to 6e-8 / (2 sqrt(1 - share))
# of the 512 nodes: 3 times the tolerance where 1 - share is 1e-5. So one in a thousand may be off ten times as far.
TOLERANCE = 1e-5
FEW, FARTHER = 1e-3, 10.0
Array = NDArray[Any]


def lidar(**more: Any) -> Lidar:
    """A sensor that sees many particles, without steps in range or intensity, which would make rounding visible."""
    sensor = Lidar(wavelength_nm=905.0, range_at_10_percent_m=80.0, range_noise_m=0.02, margin_db=1.0)
    return replace(sensor.with_hahner_overlap(), **more)


# Weak rain in the modes that list several particles of a beam: two are listed then, and the export takes seconds.
def rain() -> LidarWeather:
    return LidarRain(Rain(1.0), lidar(return_mode="first"))


def fog() -> LidarWeather:
    return LidarFog(Fog(mor_m=50.0), lidar(return_mode="dual"), lost="nan")


def snow() -> LidarWeather:
    sensor = lidar(return_mode="strongest", near_start_m=3.0, near_full_m=8.0, near_power=1.5)
    return LidarSnow(Snow(1.0), replace(sensor, directions=torch.eye(3)), beam_ends="max_range")


def mixture() -> LidarWeather:
    banks = Fog(mor_m=100.0, patch_log_std=0.5, patch_length_m=20.0)
    return LidarWeather(Mixture(Rain(1.0), banks), lidar(return_mode="last"), beam_ends="max_range")


@dataclass(frozen=True)
class Case:
    make: Callable[[], LidarWeather]
    intensities: dict[str, tuple[float, ...]]
    """Graph input, and a value for each sample, none as in the constructor."""
    columns: int = 4
    options: dict[str, Any] = field(default_factory=dict)
    directions: bool = False
    """Whether these options make directions an input."""


CASES = {
    "rain": Case(rain, {"rate_mm_per_h": (0.6, 1.0, 0.1)}),
    "fog": Case(fog, {"mor_m": (120.0, 20.0, 900.0)}, columns=5),
    "snow": Case(snow, {"rate_mm_per_h": (0.7, 0.05, 1.0)}, directions=True),
    "mixture": Case(
        mixture,
        {"mor_m": (300.0, 60.0, 30.0), "rate_mm_per_h": (1.0, 0.5, 0.2)},
        options={"directions": True},
        directions=True,
    ),
}
LONG = ("snow", "mixture")
every_case = pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[pytest.mark.long] if name in LONG else []) for name in CASES]
)


def cloud_and_directions(batch: int, points: int, columns: int = 4) -> tuple[Tensor, Tensor]:
    """Objects at 1 to 60 m all around, dark to bright, a seventh of the beams without return."""
    generator = torch.Generator().manual_seed(points)
    along = torch.nn.functional.normalize(torch.randn(points, 3, generator=generator), dim=-1)
    range_m = 1.0 + 59.0 * torch.rand(batch, points, 1, generator=generator)
    range_m[:, ::7] = 0.0
    rest = torch.rand(batch, points, columns - 3, generator=generator)
    return torch.cat([along * range_m, rest], -1), along


class Graph:
    """An exported transform in onnxruntime."""

    def __init__(self, name: str, folder: Path) -> None:
        case = CASES[name]
        self.path, self.case = folder / f"{name}.onnx", case
        self.transform = case.make()
        self.state_before = {key: value.clone() for key, value in self.transform.state_dict().items()}
        self.inputs = to_onnx(self.transform, self.path, points=TRACED, columns=case.columns, **case.options)
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = 1
        options.log_severity_level = 3
        self.session = onnxruntime.InferenceSession(self.path, options, providers=["CPUExecutionProvider"])

    def __call__(
        self, points: Tensor, along: Tensor | None, intensities: dict[str, Array], noise: dict[str, Array]
    ) -> dict[str, Array]:
        given = {"points": points.numpy(), **intensities, **noise}
        if along is not None:
            given["directions"] = along.numpy()
        outputs = [output.name for output in self.session.get_outputs()]
        return dict(zip(outputs, self.session.run(None, given), strict=True))

    def intensities(self, batch: int) -> dict[str, Array]:
        return {key: np.array(values[:batch], np.float32) for key, values in self.case.intensities.items()}

    def at_intensities(self, batch: int) -> LidarWeather:
        """The transform with those values, its number of particles as exported."""
        transform = self.case.make()
        transform.sensor = replace(transform.sensor, directions=None)
        transform.weather = Mixture(*(replace(part, **{part.intensity_name: 1.0}) for part in transform.weather.parts))  # type: ignore[type-var]
        for module in transform.modules():
            for key, values in self.intensities(batch).items():
                if key in dict(module.named_buffers(recurse=False)):
                    module.register_buffer(key, torch.from_numpy(values))
        return transform


@pytest.fixture(scope="module")
def graphs(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Graph]:
    folder = tmp_path_factory.mktemp("graphs")
    made: dict[str, Graph] = {}

    def graph(name: str) -> Graph:
        if name not in made:
            made[name] = Graph(name, folder)
        return made[name]

    return graph


def assert_same_cloud(got: Array, wanted: Array) -> None:
    assert np.array_equal(np.isnan(got), np.isnan(wanted))
    got, wanted = np.nan_to_num(got), np.nan_to_num(wanted)
    range_m = np.linalg.norm(wanted[..., :3], axis=-1)
    off = np.linalg.norm(got[..., :3] - wanted[..., :3], axis=-1)
    # As a particle's intensity goes with the square of its range, twice the tolerance.
    dim = np.abs(got[..., 3] - wanted[..., 3])
    for error, allowed in ((off, TOLERANCE * range_m), (dim, 2 * TOLERANCE * wanted[..., 3])):
        assert (error > allowed).mean() <= FEW
        assert (error <= FARTHER * allowed).all()
    assert np.array_equal(got[..., 4:], wanted[..., 4:])


@every_case
@pytest.mark.parametrize("size", SIZES, ids=lambda size: f"{size[0]}x{size[1]}")
def test_onnxruntime_gives_what_torch_gives_for_other_clouds_and_intensities(
    graphs: Callable[[str], Graph], name: str, size: tuple[int, int]
) -> None:
    graph = graphs(name)
    points, along = cloud_and_directions(*size, graph.case.columns)
    directions = along if graph.case.directions else None
    batch, count = size
    noise = draw_feed(graph.session, points=count, seed=range(5, 5 + batch))
    got = graph(points, directions, graph.intensities(batch), noise)
    torch_noise = {key: torch.from_numpy(array) for key, array in noise.items()}
    wanted = graph.at_intensities(batch).run(points, torch_noise, directions=directions)
    assert isinstance(wanted.points, Tensor)
    assert isinstance(wanted.kind, Tensor)
    for kind in (PointKind.OBJECT, PointKind.PARTICLE):  # there is something to compare
        assert int((wanted.kind == kind).sum()) > 10
    assert np.array_equal(got["kind"], wanted.kind.numpy())
    assert got["kind"].dtype == np.int8
    assert_same_cloud(got["cloud"], wanted.points.numpy())
    if name == "fog":
        assert isinstance(wanted.second, Tensor)
        assert isinstance(wanted.second_kind, Tensor)
        assert int((wanted.second_kind != PointKind.LOST).sum()) > 10
        assert np.array_equal(got["second_kind"], wanted.second_kind.numpy())
        assert_same_cloud(got["second"], wanted.second.numpy())
    else:
        assert set(got) == {"cloud", "kind"}


class Detector(torch.nn.Module):
    """Two logits a point, and how many points are near."""

    def forward(self, cloud: Tensor) -> tuple[Tensor, Tensor]:
        weights = torch.linspace(-0.05, 0.05, 8).reshape(4, 2)
        return cloud[..., :4] @ weights, (cloud[..., :3].square().sum(-1) < 400.0).sum(-1)


def test_with_a_detector_in_the_graph_it_gives_what_torch_gives(
    graphs: Callable[[str], Graph], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    import onnx

    from torchweather.export import graph as export

    graph, path = graphs("rain"), tmp_path / "fused.onnx"
    exported = onnx.load(graph.path)
    monkeypatch.setattr(export, "_traced", lambda _: exported)  # the weather alone takes ten seconds
    columns, options = graph.case.columns, graph.case.options
    fuse(
        graph.transform,
        Detector(),
        path,
        outputs=["logits", "near"],
        keep=["kind"],
        points=TRACED,
        columns=columns,
        **options,
    )
    batch, count = SIZES[1]
    points, along = cloud_and_directions(batch, count, columns)
    given = {"directions": along.numpy()} if graph.case.directions else {}
    session = onnxruntime.InferenceSession(path, providers=["CPUExecutionProvider"])
    noise = draw_feed(session, points=count, seed=range(5, 5 + batch))
    names = ["logits", "near", "kind"]
    got = session.run(names, {"points": points.numpy(), **given, **graph.intensities(batch), **noise})
    torch_noise = {key: torch.from_numpy(array) for key, array in noise.items()}
    wanted = graph.at_intensities(batch).run(points, torch_noise, directions=along if given else None)
    assert isinstance(wanted.points, Tensor)
    assert isinstance(wanted.kind, Tensor)
    logits, near = Detector()(wanted.points)
    off = np.abs(got[0] - logits.numpy())
    scale = float(logits.abs().max())
    assert (off > TOLERANCE * scale).mean() <= FEW
    assert off.max() <= FARTHER * TOLERANCE * scale
    assert np.array_equal(got[1], near.numpy())
    assert np.array_equal(got[2], wanted.kind.numpy())
    assert int((wanted.kind == PointKind.PARTICLE).sum()) > 10


@every_case
def test_the_inputs_are_named_in_order(graphs: Callable[[str], Graph], name: str) -> None:
    graph = graphs(name)
    noise = list(graph.transform.draw(torch.zeros(TRACED, graph.case.columns), seed=0))
    along = ["directions"] if graph.case.directions else []
    assert graph.inputs == ["points", *along, *graph.case.intensities, *noise]
    assert [node.name for node in graph.session.get_inputs()] == graph.inputs


@every_case
def test_draw_feed_gives_the_numbers_of_draw_bit_for_bit(graphs: Callable[[str], Graph], name: str) -> None:
    graph = graphs(name)
    batch, count = SIZES[1]
    drawn = graph.transform.draw(torch.zeros(batch, count, 4), seed=77)
    for model in (graph.session, graph.path, graph.path.read_bytes()):
        feed = draw_feed(model, points=count, seed=[77, 78, 79])
        assert set(feed) == set(drawn)
        for key, value in drawn.items():
            assert feed[key].dtype == np.float32
            assert np.array_equal(feed[key], value.numpy())
    single = draw_feed(graph.session, points=count, seed=78)
    assert all(np.array_equal(single[key][0], value[1].numpy()) for key, value in drawn.items())


def test_draw_feed_runs_where_torch_is_not_loaded(graphs: Callable[[str], Graph], tmp_path: Path) -> None:
    graph = graphs("snow")
    code = f"""
import sys
import numpy as np
from torchweather.export import draw_feed
np.savez({str(tmp_path / "feed.npz")!r}, **draw_feed({str(graph.path)!r}, points=57, seed=3))
assert "torch" not in sys.modules
"""
    root = Path(__file__).parents[2]
    subprocess.run([sys.executable, "-c", code], check=True, cwd=root, timeout=60)
    drawn = graph.transform.draw(torch.zeros(57, 4), seed=3)
    with np.load(tmp_path / "feed.npz") as feed:
        assert set(feed.files) == set(drawn)
        assert all(np.array_equal(feed[key][0], drawn[key].numpy()) for key in drawn)


@every_case
def test_the_graph_knows_no_weather_at_zero_rate_and_infinite_visibility(
    graphs: Callable[[str], Graph], name: str
) -> None:
    graph = graphs(name)
    points, along = cloud_and_directions(1, 3000, graph.case.columns)
    intensities = {key: np.array([math.inf if key == "mor_m" else 0.0], np.float32) for key in graph.case.intensities}
    noise = draw_feed(graph.session, points=3000, seed=1)
    got = graph(points, along if graph.case.directions else None, intensities, noise)
    assert np.array_equal(got["cloud"], points.numpy())
    empty = (points[..., :3] == 0).all(-1).numpy()
    assert np.array_equal(got["kind"], np.where(empty, PointKind.LOST, PointKind.OBJECT))


def test_beams_without_return_meet_flakes_only_where_the_graph_knows_their_direction(
    graphs: Callable[[str], Graph],
) -> None:
    points, along = cloud_and_directions(1, 3000)
    empty = (points[..., :3] == 0).all(-1).numpy()
    graph = graphs("snow")
    got = graph(points, along, graph.intensities(1), draw_feed(graph.session, points=3000, seed=1))
    filled = empty & (got["kind"] == PointKind.PARTICLE)
    assert filled.sum() > 10
    place = got["cloud"][filled][:, :3]
    cosine = (place * along.numpy()[filled[0]]).sum(-1) / np.linalg.norm(place, axis=-1)
    assert (cosine > 1 - 1e-6).all()
    graph = graphs("rain")
    got = graph(points, None, graph.intensities(1), draw_feed(graph.session, points=3000, seed=1))
    assert (got["kind"][empty] == PointKind.LOST).all()
    assert (got["cloud"][empty][:, :3] == 0).all()


def test_directions_of_any_length_point_the_same_way(graphs: Callable[[str], Graph]) -> None:
    graph = graphs("snow")
    points, along = cloud_and_directions(1, 3000)
    noise = draw_feed(graph.session, points=3000, seed=1)
    unit, long = (graph(points, scale * along, graph.intensities(1), noise)["cloud"] for scale in (1.0, 3.0))
    assert_same_cloud(long, unit)


def test_thicker_fog_never_brightens_an_object_in_the_graph(graphs: Callable[[str], Graph]) -> None:
    graph = graphs("fog")
    points, _ = cloud_and_directions(1, 3000, 5)
    noise = draw_feed(graph.session, points=3000, seed=1)
    before = points[..., 3].numpy()
    for mor_m in (2000.0, 500.0, 100.0, 30.0):
        got = graph(points, None, {"mor_m": np.array([mor_m], np.float32)}, noise)
        objects = got["kind"] == PointKind.OBJECT
        now = np.where(objects, got["cloud"][..., 3], 0.0)
        assert (now[objects] <= before[objects]).all()
        before = np.where(objects, now, 1.0)


@every_case
def test_the_transform_is_left_as_it_was(graphs: Callable[[str], Graph], name: str) -> None:
    graph, fresh = graphs(name), CASES[name].make()
    state = graph.transform.state_dict()
    assert all(torch.equal(state[key], value) for key, value in graph.state_before.items())
    assert graph.transform.weather == fresh.weather
    assert graph.transform.sensor == fresh.sensor
    assert (graph.transform.sensor.directions is None) == (fresh.sensor.directions is None)
    assert not list(graph.path.parent.glob(".*"))  # nothing half written


def test_rates_of_a_mixture_are_named_by_their_kind() -> None:
    both = LidarWeather(Mixture(Rain(5.0), Snow(1.0), Fog(mor_m=100.0)), lidar())
    traceable = traceable_lidar(both, 10, 4, None)
    assert traceable.inputs[:4] == ["points", "mor_m", "rain_rate_mm_per_h", "snow_rate_mm_per_h"]


def test_an_intensity_for_each_sample_is_no_part_of_the_graph() -> None:
    """Two rates given in the constructor fit two samples; the graph's input fits any number of them."""
    many = LidarRain(Rain(torch.tensor([1.0, 2.0, 3.0])), lidar())
    traceable = traceable_lidar(many, 10, 4, None)
    cloud, kind = traceable.module(*traceable.arguments)
    assert cloud.shape == (2, 10, 4)
    assert kind.shape == (2, 10)


@pytest.mark.parametrize(
    ("options", "message"),
    [({"lost": "drop"}, r'lost="drop".*as many points as are left'), ({"complete_scan": True}, "directions=True")],
)
def test_what_changes_the_number_of_points_is_refused(options: dict[str, Any], message: str, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"to_onnx: LidarRain.*" + message):
        to_onnx(LidarRain(Rain(5.0), lidar(), **options), tmp_path / "rain.onnx")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("size", [{"points": 1}, {"columns": 3}])
def test_a_traced_cloud_that_is_none_is_refused(size: dict[str, Any], tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="to_onnx: points must be 2 or more and columns 4 or more"):
        to_onnx(LidarRain(Rain(5.0), lidar()), tmp_path / "rain.onnx", **size)


@pytest.mark.parametrize("size", [{}, {"height": 24}, {"height": 24, "width": 32, "points": 5}])
def test_a_feed_of_neither_frame_nor_cloud_is_refused(graphs: Callable[[str], Graph], size: dict[str, int]) -> None:
    with pytest.raises(ValueError, match="draw_feed: give height and width of a camera's frame, or the points"):
        draw_feed(graphs("rain").path, seed=0, **size)


def test_a_feed_for_a_frame_is_refused_by_a_lidar_graph(graphs: Callable[[str], Graph]) -> None:
    with pytest.raises(ValueError, match="is made from points; got height and width"):
        draw_feed(graphs("rain").path, height=24, width=32, seed=0)
    with pytest.raises(ValueError, match="points must be 0 or more; got -1"):
        draw_feed(graphs("rain").path, points=-1, seed=0)


def test_a_graph_is_told_where_beams_without_return_end(tmp_path: Path) -> None:
    sensor = lidar(return_mode="strongest", near_start_m=3.0, near_full_m=8.0, near_power=1.5)
    transform = LidarSnow(Snow(1.0), sensor)
    inputs = to_onnx(transform, tmp_path / "snow.onnx", points=TRACED, columns=4, directions=True)
    assert inputs[:3] == ["points", "directions", "reach_m"]
    points, along = cloud_and_directions(1, 900)
    reach_m = transform.state_of(points, along).air.reach_m
    session = onnxruntime.InferenceSession(tmp_path / "snow.onnx", providers=["CPUExecutionProvider"])
    noise = draw_feed(session, points=900, seed=range(3, 4))
    given = {"points": points.numpy(), "directions": along.numpy(), "reach_m": reach_m.numpy()}
    cloud, kind = session.run(["cloud", "kind"], {**given, "rate_mm_per_h": np.ones(1, np.float32), **noise})
    torch_noise = {key: torch.from_numpy(array) for key, array in noise.items()}
    wanted = transform.run(points, torch_noise, directions=along)
    assert isinstance(wanted.kind, Tensor)
    assert isinstance(wanted.points, Tensor)
    empty = points[0, :, :3].norm(dim=-1) == 0
    assert int((wanted.kind[0, empty] == PointKind.PARTICLE).sum()) > 5
    assert np.array_equal(kind, wanted.kind.numpy())
    assert_same_cloud(cloud, wanted.points.numpy())
    short = {**given, "reach_m": np.zeros_like(given["reach_m"])}
    _, none = session.run(["cloud", "kind"], {**short, "rate_mm_per_h": np.ones(1, np.float32), **noise})
    assert (none[0, empty.numpy()] == PointKind.LOST).all(), "nothing floats before an end at 0"
