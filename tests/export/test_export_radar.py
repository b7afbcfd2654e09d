"""ONNX of the radar: onnxruntime gives what torch gives, for other lists, intensities and cubes than those traced."""

from __future__ import annotations

import math
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import onnxruntime
import pytest
import torch
from numpy.typing import NDArray
from torch import Tensor

from torchweather.atmosphere.weather import Fog, Mixture, Rain, Snow, Weather
from torchweather.export import draw_feed, to_onnx
from torchweather.export.radar_graph import traceable_radar
from torchweather.radar import RangeDopplerMap, range_doppler
from torchweather.sensors import Radar
from torchweather.stages import PointKind
from torchweather.transforms import RadarAttenuation

pytest.importorskip("onnxscript")

TRACED = 50
# Batch and points, neither as traced.
SIZES = [(1, 2000), (3, 301)]
# Decibels: powers near -120 dB have float32 steps of 8e-6 and two sums round them; two steps measured.
TOLERANCE_DB = 5e-5
# Clutter, of each column's largest value: it lies where an integral over 255 cells reaches a drawn value, and float32
# sums in another order round by some 1e-6; 6e-7 measured.
CLUTTER = 1e-5
Array = NDArray[Any]
WET = partial(Snow, melt_fraction=0.8)
PATCHY: dict[str, Any] = {"patch_log_std": 0.5, "patch_length_m": 20.0}


def radar(**more: Any) -> Radar:
    return Radar.preset("awr1843-like", **more)


def rain() -> RadarAttenuation:
    return RadarAttenuation(Rain(5.0), radar(), radome_loss_db=0.5, radome_film_db=1.0)


def fog() -> RadarAttenuation:
    return RadarAttenuation(Fog(mor_m=50.0), radar(frequency_ghz=150.0), lost="nan")


def snow() -> RadarAttenuation:
    return RadarAttenuation(WET(2.0), radar(noise_figure_db=0.0, chirps=512), clutter=True, clutter_points=64)


def mixture() -> RadarAttenuation:
    weather = Mixture(Rain(1.0, **PATCHY), Snow(1.0), Fog(mor_m=100.0))
    return RadarAttenuation(weather, radar(), radome_film_db=2.0, lost="nan")


@dataclass(frozen=True)
class Case:
    make: Callable[[], RadarAttenuation]
    weather: Callable[..., Weather]
    """Of the values of its intensities."""
    intensities: dict[str, tuple[float, ...]]
    """Graph input, and a value for each sample, none as in the constructor."""
    columns: int = 6
    clutter: int = 0


CASES = {
    "rain": Case(rain, Rain, {"rate_mm_per_h": (25.0, 150.0, 2.0)}),
    "fog": Case(fog, lambda mor: Fog(mor_m=mor), {"mor_m": (20.0, 12.0, 200.0)}, columns=8),
    "snow": Case(snow, WET, {"rate_mm_per_h": (4.0, 1.0, 10.0)}, clutter=64),
    "mixture": Case(
        mixture,
        lambda mor, wet, dry: Mixture(Rain(wet, **PATCHY), Snow(dry), Fog(mor_m=mor)),
        {
            "mor_m": (300.0, 60.0, 30.0),
            "rain_rate_mm_per_h": (50.0, 9.0, 0.3),
            "snow_rate_mm_per_h": (1.0, 0.5, 2.0),
        },
    ),
}
every_case = pytest.mark.parametrize("name", list(CASES))


def detections(sensor: Radar, batch: int, points: int, columns: int = 6) -> Tensor:
    """Targets at 1 to 60 m ahead, some just above the threshold, some below it; a seventh of the rows is empty."""
    generator = torch.Generator().manual_seed(points)
    place = torch.rand(batch, points, 3, generator=generator) * torch.tensor([60.0, 10.0, 2.0]) + 1.0
    rest = torch.randn(batch, points, columns - 3, generator=generator)
    rest[..., 1] = sensor.floor_db + sensor.detection_snr_db + 5.0 + 6.0 * rest[..., 1]
    place[:, ::7] = 0.0
    return torch.cat([place, rest], -1)


class Graph:
    """An exported transform in onnxruntime."""

    def __init__(self, name: str, folder: Path) -> None:
        case = CASES[name]
        self.path, self.case = folder / f"{name}.onnx", case
        self.transform = case.make()
        self.state_before = {key: value.clone() for key, value in self.transform.state_dict().items()}
        self.inputs = to_onnx(self.transform, self.path, points=TRACED, columns=case.columns)
        self.session = opened(self.path)

    def __call__(self, points: Tensor, intensities: dict[str, Array], noise: dict[str, Array]) -> dict[str, Array]:
        return run(self.session, {"points": points.numpy(), **intensities, **noise})

    def intensities(self, batch: int) -> dict[str, Array]:
        return {key: np.array(values[:batch], np.float32) for key, values in self.case.intensities.items()}

    def at_intensities(self, batch: int) -> RadarAttenuation:
        """The transform with those values: built anew, so that every stage which the intensity reaches has it."""
        transform = self.case.make()
        values = [torch.from_numpy(value) for value in self.intensities(batch).values()]
        options: dict[str, Any] = {"lost": transform.lost}
        for stage in transform.chain.stages.values():
            if hasattr(stage, "film_db"):
                options |= {"radome_loss_db": float(stage.loss_db), "radome_film_db": float(stage.film_db)}  # type: ignore[arg-type]
            if hasattr(stage, "capacity"):
                options |= {"clutter": True, "clutter_points": stage.capacity}
        return RadarAttenuation(self.case.weather(*values), transform.sensor, **options)


def opened(path: Path) -> onnxruntime.InferenceSession:
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1
    options.log_severity_level = 3
    return onnxruntime.InferenceSession(path, options, providers=["CPUExecutionProvider"])


def run(session: onnxruntime.InferenceSession, given: dict[str, Array]) -> dict[str, Array]:
    outputs = [output.name for output in session.get_outputs()]
    return dict(zip(outputs, session.run(None, given), strict=True))


@pytest.fixture(scope="module")
def graphs(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Graph]:
    folder = tmp_path_factory.mktemp("graphs")
    made: dict[str, Graph] = {}

    def graph(name: str) -> Graph:
        if name not in made:
            made[name] = Graph(name, folder)
        return made[name]

    return graph


def assert_close(got: Array, wanted: Array, tolerance: float) -> None:
    """Equal NaN and infinities; the rest within the tolerance."""
    assert got.shape == wanted.shape
    plain = np.isfinite(wanted)
    assert np.array_equal(got[~plain], wanted[~plain], equal_nan=True)
    assert np.abs(got[plain] - wanted[plain]).max(initial=0.0) <= tolerance


@every_case
@pytest.mark.parametrize("size", SIZES, ids=lambda size: f"{size[0]}x{size[1]}")
def test_onnxruntime_gives_what_torch_gives_for_other_lists_and_intensities(
    graphs: Callable[[str], Graph], name: str, size: tuple[int, int]
) -> None:
    graph = graphs(name)
    batch, count = size
    points = detections(graph.transform.sensor, *size, graph.case.columns)
    noise = draw_feed(graph.session, points=count, seed=range(5, 5 + batch))
    got = graph(points, graph.intensities(batch), noise)
    torch_noise = {key: torch.from_numpy(array) for key, array in noise.items()}
    wanted = graph.at_intensities(batch).run(points, torch_noise)
    assert isinstance(wanted.points, Tensor)
    assert isinstance(wanted.kind, Tensor)
    assert isinstance(wanted.snr_db, Tensor)
    assert isinstance(wanted.attenuation_db, Tensor)
    had = (points[..., :3] != 0).any(-1)
    kind = wanted.kind.numpy()
    for there in ((kind[:, :count] == PointKind.OBJECT), had.numpy() & (kind[:, :count] == PointKind.LOST)):
        assert there.sum() > 10  # there is something to compare
    assert np.array_equal(got["kind"], kind)
    assert got["kind"].dtype == np.int8
    assert_close(got["attenuation_db"], wanted.attenuation_db.numpy(), TOLERANCE_DB)
    listed, own = slice(0, count), slice(count, None)
    assert_close(got["snr_db"][:, listed], wanted.snr_db[:, listed].numpy(), TOLERANCE_DB)
    table, wanted_table = got["detections"], wanted.points.numpy()
    assert_close(table[:, listed, 4], wanted_table[:, listed, 4], TOLERANCE_DB)
    others = [column for column in range(graph.case.columns) if column != 4]
    assert np.array_equal(table[:, listed][..., others], wanted_table[:, listed][..., others], equal_nan=True)
    assert table.shape[1] == count + graph.case.clutter
    if graph.case.clutter:
        assert int((kind[:, own] == PointKind.PARTICLE).sum()) > 10
        scale = np.abs(wanted_table[:, own]).max((0, 1))
        assert_close(table[:, own] / scale, wanted_table[:, own] / scale, CLUTTER)
        assert_close(got["snr_db"][:, own], wanted.snr_db[:, own].numpy(), CLUTTER * scale[4])


@every_case
def test_the_inputs_are_named_in_order(graphs: Callable[[str], Graph], name: str) -> None:
    graph = graphs(name)
    noise = list(graph.transform.draw(torch.zeros(TRACED, graph.case.columns), seed=0))
    assert graph.inputs == ["points", *graph.case.intensities, *noise]
    assert [node.name for node in graph.session.get_inputs()] == graph.inputs
    assert [node.name for node in graph.session.get_outputs()] == ["detections", "kind", "snr_db", "attenuation_db"]


@every_case
def test_draw_feed_gives_the_numbers_of_draw_bit_for_bit(graphs: Callable[[str], Graph], name: str) -> None:
    graph = graphs(name)
    batch, count = SIZES[1]
    drawn = graph.transform.draw(torch.zeros(batch, count, 6), seed=77)
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
    drawn = graph.transform.draw(torch.zeros(57, 6), seed=3)
    with np.load(tmp_path / "feed.npz") as feed:
        assert set(feed.files) == set(drawn)
        assert all(np.array_equal(feed[key][0], drawn[key].numpy()) for key in drawn)


@pytest.mark.parametrize("name", ["fog", "snow"])
def test_no_weather_gives_the_input_back_bit_for_bit(graphs: Callable[[str], Graph], name: str) -> None:
    graph = graphs(name)
    points = detections(graph.transform.sensor, 2, 500, graph.case.columns)
    intensities = {key: np.full(2, math.inf if key == "mor_m" else 0.0, np.float32) for key in graph.case.intensities}
    got = graph(points, intensities, draw_feed(graph.session, points=500, seed=[1, 2]))
    assert got["detections"][:, :500].tobytes() == points.numpy().tobytes()
    empty = (points[..., :3] == 0).all(-1).numpy()
    assert np.array_equal(got["kind"][:, :500], np.where(empty, PointKind.LOST, PointKind.OBJECT))
    assert (got["kind"][:, 500:] == PointKind.LOST).all()  # no clutter without weather
    assert (got["attenuation_db"] == 0).all()


def test_a_dry_cover_keeps_only_the_loss_that_no_rain_explains(graphs: Callable[[str], Graph]) -> None:
    """The film follows the path's own rain: no rate, no film."""
    graph = graphs("rain")
    points = detections(graph.transform.sensor, 1, 500)
    noise = draw_feed(graph.session, points=500, seed=1)
    there = (points[..., :3] != 0).any(-1).numpy()
    dry = graph(points, {"rate_mm_per_h": np.zeros(1, np.float32)}, noise)["attenuation_db"][there]
    assert np.allclose(dry, 0.5, atol=1e-6)
    near = points.clone()
    near[..., :3] *= 1e-3 / near[..., :3].norm(dim=-1, keepdim=True).clamp_min(1e-30)  # a path of 1 mm
    wet = graph(near, {"rate_mm_per_h": np.full(1, 8.0, np.float32)}, noise)["attenuation_db"][there]
    assert np.allclose(wet, 0.5 + 1.0 * 8.0 ** (1 / 3), atol=1e-4)


@every_case
def test_the_transform_is_left_as_it_was(graphs: Callable[[str], Graph], name: str) -> None:
    graph, fresh = graphs(name), CASES[name].make()
    state = graph.transform.state_dict()
    assert all(torch.equal(state[key], value) for key, value in graph.state_before.items())
    assert graph.transform.weather == fresh.weather
    assert not list(graph.path.parent.glob(".*"))  # nothing half written


def test_an_intensity_for_each_sample_is_no_part_of_the_graph() -> None:
    """Three rates given in the constructor fit three samples; the graph's intensity fits any number of them."""
    traceable = traceable_radar(RadarAttenuation(Rain(torch.tensor([1.0, 2.0, 3.0])), radar()), 10, 6)
    found, kind, snr_db, attenuation_db = traceable.module(*traceable.arguments)
    assert found.shape == (2, 10, 6)
    assert kind.shape == snr_db.shape == attenuation_db.shape == (2, 10)


def test_what_changes_the_number_of_detections_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r'to_onnx: RadarAttenuation\(lost="drop"\).*as many detections as are left'):
        to_onnx(RadarAttenuation(Rain(5.0), radar(), lost="drop"), tmp_path / "rain.onnx")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("size", [{"points": 1}, {"columns": 5}])
def test_a_traced_list_that_is_none_is_refused(size: dict[str, Any], tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="to_onnx: points must be 2 or more and columns 6 or more"):
        to_onnx(RadarAttenuation(Rain(5.0), radar()), tmp_path / "rain.onnx", **size)


# ---- range-Doppler map ---------------------------------------------------------------------------------------------

# float32 products over up to 256 and 128 terms: roundings of 6e-8 add up to a few 1e-7 of the largest sample, which
# the weights, of sum 1, do not enlarge; 4e-7 measured.
MAP_ROUNDING = 1e-6
LENGTHS = [(256, 128), (200, 48), (31, 9)]


def noisy_cube(sensor: Radar, batch: int) -> Tensor:
    """Noise of amplitude 1 and a tone ten times as strong at range bin 5 and two Doppler bins above speed 0."""
    generator = torch.Generator().manual_seed(batch)
    shape = (batch, sensor.virtual_channels, sensor.chirps, sensor.samples)
    cube = torch.randn(shape, dtype=torch.complex64, generator=generator)
    n, m = torch.arange(sensor.samples, dtype=torch.float64), torch.arange(sensor.chirps, dtype=torch.float64)
    turns = 5 * n / sensor.samples + 2 * m[:, None] / sensor.chirps
    return cube + 10.0 * torch.exp(2j * math.pi * turns).to(cube.dtype)


def assert_power_of_map(power_dbm: Array, real: Array, imaginary: Array) -> None:
    power = (np.square(real.astype(np.float64)) + np.square(imaginary.astype(np.float64))).mean(-3)
    # float32 steps of decibels near -60 are 4e-6; a sum of 24 squares rounds by 1e-6 dB or so
    assert np.abs(power_dbm - 10.0 * np.log10(power)).max() <= 2e-5


@pytest.mark.parametrize("window_name", ["hann", "rectangular"])
@pytest.mark.parametrize(("samples", "chirps"), LENGTHS)
def test_the_map_of_two_real_parts_is_that_of_the_complex_transform(
    samples: int, chirps: int, window_name: str
) -> None:
    sensor = radar(samples=samples, chirps=chirps)
    cube = noisy_cube(sensor, 2)
    real, imaginary, power_dbm = RangeDopplerMap(sensor, window_name)(cube.real, cube.imag)
    wanted = range_doppler(cube.to(torch.complex128), sensor, window_name)
    assert (torch.complex(real.double(), imaginary.double()) - wanted).abs().max() <= MAP_ROUNDING * cube.abs().max()
    assert_power_of_map(power_dbm.numpy(), real.numpy(), imaginary.numpy())
    row, column = divmod(int(power_dbm[0].argmax()), samples)
    assert (row, column) == (chirps // 2 + 2, 5)
    # 10 log10 of the tone's 100 mW; noise adds about 1 / (12 * 31 * 9) of its own power, some 0.1 dB at the least
    assert abs(float(power_dbm[0, row, column]) - 20.0) < 0.2


@pytest.mark.parametrize(("samples", "chirps"), LENGTHS[:2])
@pytest.mark.parametrize("window_name", ["hann", "rectangular"])
def test_onnxruntime_gives_the_map_of_the_complex_transform(
    samples: int, chirps: int, window_name: str, tmp_path: Path
) -> None:
    sensor = radar(samples=samples, chirps=chirps)
    path = tmp_path / "map.onnx"
    assert to_onnx(RangeDopplerMap(sensor, window_name), path) == ["real", "imaginary"]
    session = opened(path)
    for batch in (1, 3):  # traced with 2
        cube = noisy_cube(sensor, batch)
        got = run(session, {"real": cube.real.numpy(), "imaginary": cube.imag.numpy()})
        assert list(got) == ["map_real", "map_imaginary", "power_dbm"]
        wanted = range_doppler(cube, sensor, window_name).numpy()
        error = np.abs(got["map_real"] + 1j * got["map_imaginary"] - wanted).max()
        assert error <= MAP_ROUNDING * float(cube.abs().max())
        assert_power_of_map(got["power_dbm"], got["map_real"], got["map_imaginary"])
    assert draw_feed(path, seed=0, points=1) == {}


def test_samples_of_another_radar_are_refused() -> None:
    cube = torch.zeros(12, 128, 256)
    with pytest.raises(ValueError, match=r"real must be \(..., 12 virtual channels, 64 chirps, 256 samples\)"):
        RangeDopplerMap(radar(chirps=64))(cube, cube)
    with pytest.raises(TypeError, match=r"real must be torch.float32, as the map; got torch.complex64"):
        RangeDopplerMap(radar())(cube.to(torch.complex64), cube)
    with pytest.raises(ValueError, match="window_name"):
        RangeDopplerMap(radar(), "hanning")
