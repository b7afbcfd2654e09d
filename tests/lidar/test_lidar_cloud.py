"""Clouds in weather: columns, second returns, lost points, directions, and what is no cloud."""

from __future__ import annotations

import copy
import itertools
import math
from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor
from torch.utils.data import DataLoader, Dataset

from tests.contract.table import EMPTY, HALVES, cloud, rays, same_bits, tensors_of
from tests.contract.table import LIDAR as SENSOR
from tests.contract.table import POINTS as N
from torchweather.atmosphere.weather import Fog, Mixture, Rain, Snow
from torchweather.sensors import RETURN_MODES, Lidar
from torchweather.stages import Chain, PointKind
from torchweather.transforms import LidarFog, LidarRain, LidarSnow, LidarWeather

Maker = Callable[..., LidarWeather]


def rain(intensity: Any = 60.0, sensor: Lidar = SENSOR, **more: Any) -> LidarWeather:
    return LidarRain(Rain(intensity), sensor, **more)


def snow(intensity: Any = 3.0, sensor: Lidar = SENSOR, **more: Any) -> LidarWeather:
    return LidarSnow(Snow(intensity), sensor, **more)


def fog(intensity: Any = 1500.0, sensor: Lidar = SENSOR, **more: Any) -> LidarWeather:
    return LidarFog(Fog(intensity), sensor, **more)


def mixture(intensity: Any = 5000.0, sensor: Lidar = SENSOR, **more: Any) -> LidarWeather:
    return LidarWeather(Mixture(Snow(1.0), Fog(intensity), Rain(10.0)), sensor, **more)


every_transform = pytest.mark.parametrize("make", [rain, snow, fog, mixture], ids=["rain", "snow", "fog", "mixture"])
two_ways = pytest.mark.parametrize("make", [snow, mixture], ids=["snow", "mixture"])
# Single returns take one path with the strongest, another with the other modes; dual has both and a second cloud.
both_paths = pytest.mark.parametrize("mode", ["strongest", "dual"])
UNITS = ("reflectivity", "reflectivity_percent", "uint8_linear", "uint8_calibrated", "photons", "none")


@both_paths
def test_the_second_return_has_a_cloud_of_its_own(mode: str) -> None:
    given = cloud(2, 2)
    result: Any = mixture(sensor=replace(SENSOR, return_mode=mode)).run(given)
    for name in ("kind", "source", "transmission"):
        assert getattr(result, name).shape == (2, 2, N), name
    assert result.empty_beams.shape == result.floored_points.shape == (2, 2)
    seconds = (result.second, result.second_source, result.second_kind)
    if mode == "dual":
        assert [value.shape for value in seconds] == [given.shape, (2, 2, N), (2, 2, N)]
    else:
        assert seconds == (None, None, None)


@two_ways
@pytest.mark.parametrize("directed", [False, True])
def test_columns_and_dtype_are_those_of_the_input_and_further_columns_keep_their_bits(
    make: Maker, directed: bool
) -> None:
    transform = make(sensor=replace(SENSOR, return_mode="dual"))
    noise = transform.draw(cloud(2), seed=1)
    for dtype, columns in itertools.product(HALVES, (4, 5, 7)):
        given = cloud(2, columns=columns, dtype=dtype)
        result: Any = transform.run(given, noise, directions=rays() if directed else None)
        for points in (result.points, result.second):
            assert points.dtype == dtype
            assert points.shape == given.shape
            assert bool(torch.isfinite(points).all())
            assert same_bits(points[..., 4:], given[..., 4:])
        assert result.transmission.dtype == dtype
        assert bool((result.kind[:, EMPTY] == PointKind.PARTICLE).any()) == directed


@lru_cache(maxsize=16)
def with_zeros(make: Maker, mode: str, directed: bool) -> tuple[dict[str, Tensor], Any]:
    """Noise, and the result with it of the transform that leaves lost points as zeros."""
    reference, given = make(sensor=replace(SENSOR, return_mode=mode)), cloud(2)
    noise = reference.draw(given, seed=1)
    return noise, reference.run(given, noise, directions=rays(2) if directed else None)


@every_transform
@both_paths
@pytest.mark.parametrize("lost", ["zero", "nan", "drop"])
@pytest.mark.parametrize("directed", [False, True])
def test_lost_points_are_zero_nan_or_left_out_and_nothing_else_changes(
    make: Maker, mode: str, lost: str, directed: bool
) -> None:
    sensor, given = replace(SENSOR, return_mode=mode), cloud(2)
    directions = rays(2) if directed else None
    noise, plain = with_zeros(make, mode, directed)
    result: Any = make(sensor=sensor, lost=lost).run(given, noise, directions=directions)
    clouds = [(plain.points, plain.kind, result.points, result.source)]
    if mode == "dual":
        clouds.append((plain.second, plain.second_kind, result.second, result.second_source))
    rows = torch.arange(N)
    for points, kind, got, source in clouds:
        gone = kind == PointKind.LOST
        assert bool(gone.any())
        was_there = (given[..., :3] != 0).any(-1)
        assert bool((points[gone][:, :3] == 0).all())
        assert bool((points[gone & was_there][:, 3] == 0).all())
        assert torch.equal(points[gone & ~was_there], given[gone & ~was_there])
        assert source is not None
        for b in range(2):
            if lost == "drop":
                assert torch.equal(got[b], points[b][~gone[b]])
                assert torch.equal(source[b], rows[~gone[b]])
                continue
            assert torch.equal(got[b][~gone[b]], points[b][~gone[b]])
            if lost == "nan":
                row_is_nan = torch.isnan(got[b][:, :4]).all(-1)
                assert torch.equal(row_is_nan, gone[b] & was_there[b])
                assert bool(torch.isfinite(got[b][:, 4:]).all())


def test_without_a_batch_dropped_points_leave_one_tensor_and_with_one_a_list() -> None:
    transform = fog(40.0, lost="drop")
    alone, batch = transform(cloud()), transform(cloud(3))
    assert isinstance(alone, Tensor)
    assert alone.shape[0] < N
    assert isinstance(batch, list)
    assert len(batch) == 3


@every_transform
def test_a_point_does_not_depend_on_its_neighbours(make: Maker) -> None:
    """Any part of the beams with their part of the draw is that part of the cloud: no border effects of blocks."""
    transform, given = make(sensor=replace(SENSOR, return_mode="dual")), cloud()
    noise = transform.draw(given, seed=1)
    whole: Any = transform.run(given, noise)
    assert isinstance(whole.points, Tensor)
    assert isinstance(whole.second, Tensor)
    for part in (slice(1, 2), slice(37, 300), slice(0, N, 7)):
        # Whether the intensities are integers is asked of the cloud; here they all are.
        result: Any = transform.run(given[part], {key: value[..., part] for key, value in noise.items()})
        assert torch.equal(result.points, whole.points[part])
        assert torch.equal(result.second, whole.second[part])


@pytest.mark.parametrize("fog_options", [{"fog_backscatter": "hahner"}, {"fog_extinction": "koschmieder"}])
def test_a_saved_chain_keeps_its_options(fog_options: dict[str, Any], tmp_path: Path) -> None:
    transform, given = mixture(q_eff=1.3, q_back=0.4, **fog_options), cloud()
    transform.chain.save(tmp_path / "weather.chain")
    loaded = Chain.load(tmp_path / "weather.chain")
    assert loaded.to_dict() == transform.chain.to_dict()
    again = copy.deepcopy(transform)
    again.chain = loaded
    noise = transform.draw(given, seed=1)
    assert torch.equal(again(given, noise), transform(given, noise))


@both_paths
def test_threads_do_not_change_a_bit(mode: str) -> None:
    given = cloud(84).reshape(84 * N, 5)  # so many that torch splits them
    transform = rain(sensor=replace(SENSOR, return_mode=mode))
    noise = transform.draw(given, seed=1)
    threads = torch.get_num_threads()
    results = []
    try:
        for number in (1, 2):
            torch.set_num_threads(number)
            results.append(transform(given, noise))
            assert all(torch.equal(value, noise[key]) for key, value in transform.draw(given, seed=1).items())
    finally:
        torch.set_num_threads(threads)
    assert torch.equal(results[0], results[1])


class Clouds(Dataset[Tensor]):
    """The same cloud again and again, in the weather."""

    def __init__(self, transform: LidarWeather) -> None:
        self.transform = transform

    def __len__(self) -> int:
        return 4

    def __getitem__(self, index: int) -> Tensor:
        out: Tensor = self.transform(cloud())
        return out


@pytest.mark.slow
def test_workers_of_a_data_loader_draw_differently_and_repeatably() -> None:
    def epoch(seed: int) -> list[Tensor]:
        loader = DataLoader(
            Clouds(snow()),
            batch_size=None,
            num_workers=2,
            multiprocessing_context="fork",
            generator=torch.Generator().manual_seed(seed),
        )
        return list(loader)

    first, again, other = epoch(1), epoch(1), epoch(2)
    assert all(torch.equal(a, b) for a, b in zip(first, again, strict=True))
    every = first + other
    assert not any(torch.equal(every[i], every[j]) for i in range(8) for j in range(i))


def test_a_new_rate_costs_no_set_up() -> None:
    """The weather intensity is a buffer: the weather of a module is changed in place, and its tables follow."""
    transform, given = mixture(), cloud()
    noise = transform.draw(given, seed=1)
    before = transform(given, noise)
    moved = torch.func.functional_call(
        transform,
        {
            "chain._stages.extinction.parts.rain.rate_mm_per_h": torch.tensor(70.0),
            "chain._stages.particle_returns.parts.rain.rate_mm_per_h": torch.tensor(70.0),
        },
        (given, noise),
    )
    fresh = LidarWeather(Mixture(Rain(70.0), Snow(1.0), Fog(5000.0)), SENSOR)
    assert torch.equal(moved, fresh(given, noise))
    assert not torch.equal(moved, before)
    assert torch.equal(transform(given, noise), before)


@pytest.mark.parametrize("mode", RETURN_MODES)
@pytest.mark.parametrize("unit", UNITS)
def test_no_weather_changes_no_bit_in_any_unit_and_mode(mode: str, unit: str) -> None:
    weather = Mixture(Rain(0.0), Snow(0.0), Fog(math.inf))
    sensor = replace(SENSOR, return_mode=mode, intensity_unit=unit)
    transform = LidarWeather(weather, sensor)
    for dtype in HALVES:
        given = cloud(2, dtype=dtype, scale=1.0 if unit in ("reflectivity", "none") else 255.0)
        given[..., 50, :4] = torch.tensor([4.0, -0.0, 0.0, -0.0])
        given[..., 4] *= -0.0
        for directions in (None, rays()):
            result: Any = transform.run(given, directions=directions)
            assert isinstance(result.points, Tensor)
            assert same_bits(result.points, given)
            assert isinstance(result.kind, Tensor)
            assert torch.equal(result.kind == PointKind.LOST, (given[..., :3] == 0).all(-1))
            assert not bool((result.kind == PointKind.PARTICLE).any())
            assert bool((result.transmission == 1).all())
            assert result.empty_beams.tolist() == [40, 40]
            if mode == "dual":
                assert bool((result.second_source == -1).all())


def test_no_weather_keeps_the_sign_of_a_zero_in_a_beam_without_return() -> None:
    given = torch.tensor([[-0.0, 0.0, -0.0, 5.0, -0.0], [9.0, -0.0, 0.0, -0.0, 1.0]])
    for directions in (None, torch.tensor([[1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])):
        assert same_bits(rain(0.0)(given, directions=directions), given)


@pytest.mark.parametrize("lost", ["zero", "nan"])
def test_no_weather_loses_nothing_however_losses_are_shown(lost: str) -> None:
    assert same_bits(snow(0.0, lost=lost)(cloud(2)), cloud(2))


@both_paths
def test_empty_clouds_and_batches_come_back_empty(mode: str) -> None:
    transform = mixture(sensor=replace(SENSOR, return_mode=mode))
    for shape in ((0, 4), (3, 0, 5), (0, 10, 4), (2, 0, 10, 4), (0, 0, 4)):
        given = torch.zeros(shape)
        assert transform(given).shape == shape
        result: Any = transform.run(given)
        assert all(value.shape[: len(shape) - 2] == shape[:-2] for value in tensors_of(result).values())
        assert [value.shape for value in transform.expected(given)] == [shape[:-1]] * 2


@every_transform
@both_paths
def test_one_point_and_beams_that_are_all_empty(make: Maker, mode: str) -> None:
    transform = make(sensor=replace(SENSOR, return_mode=mode))
    assert transform(torch.tensor([[20.0, 0.0, 0.0, 100.0]])).shape == (1, 4)
    nothing = torch.zeros(N, 4)
    result: Any = transform.run(nothing)
    assert torch.equal(result.points, nothing)
    assert bool((result.kind == PointKind.LOST).all())
    assert int(result.empty_beams) == N
    directed: Any = transform.run(nothing, directions=rays())
    assert bool((directed.kind == PointKind.PARTICLE).any())


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("column", [0, 2, 3, 4])
def test_values_that_are_not_finite_are_refused_with_their_column(bad: float, column: int) -> None:
    given, transform = cloud(2), rain()
    given[1, 7, column] = bad
    for call in (transform, transform.run, transform.expected, transform.draw):
        with pytest.raises(ValueError, match=rf"1 rows with NaN or infinity \(columns \[{column}\]\)"):
            call(given)


def test_infinities_of_both_signs_are_seen_too() -> None:
    given = cloud()
    given[1, 0], given[2, 0] = math.inf, -math.inf
    with pytest.raises(ValueError, match="2 rows"):
        rain()(given)


@pytest.mark.parametrize(
    ("bad", "error", "message"),
    [
        (torch.zeros(10, 3), ValueError, r"\(10, 3\).*append a column of ones.*none"),
        (torch.zeros(4), ValueError, r"\(4,\)"),
        (torch.zeros(10, 4, dtype=torch.int32), TypeError, r"floating point.*int32.*float\(\)"),
        (torch.zeros(10, 4, dtype=torch.bool), TypeError, "floating point"),
        (torch.zeros(10, 4, dtype=torch.complex64), TypeError, "floating point"),
        (np.zeros((10, 4), dtype=np.float32), TypeError, "on_numpy"),
        ([[1.0, 0.0, 0.0, 1.0]], TypeError, "tensor"),
        (torch.tensor([[1.0, 0.0, 0.0, -1.0]]), ValueError, "0 or more.*-1"),
    ],
    ids=["3 columns", "1 dimension", "int32", "bool", "complex", "numpy", "list", "negative intensity"],
)
def test_what_is_no_cloud_is_refused(bad: Any, error: type[Exception], message: str) -> None:
    transform = rain()
    for call in (transform, transform.run, transform.draw, transform.expected):
        with pytest.raises(error, match=f"(?s)^{type(transform).__name__}: .*{message}"):
            call(bad)


@pytest.mark.parametrize(
    ("directions", "message"),
    [
        (torch.ones(N - 1, 3), f"{N} points"),
        (torch.ones(N, 2), r"\(\.\.\., N, 3\)"),
        (torch.zeros(N, 3), "none of them zero"),
        (torch.full((N, 3), math.nan), "finite"),
        (torch.ones(N, 3, dtype=torch.int64), "floating point"),
        (torch.ones(3, N, 3), r"batch shape \(2,\)"),
        (torch.ones(3), r"\(\.\.\., N, 3\)"),
    ],
    ids=["rows", "columns", "zero", "nan", "integers", "batch", "one"],
)
def test_directions_that_do_not_fit_are_refused(directions: Tensor, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        rain()(cloud(2), directions=directions)


def test_directions_of_the_sensor_and_of_the_call_are_the_same_and_their_length_does_not_matter() -> None:
    given = cloud(2)
    from_sensor = snow(sensor=replace(SENSOR, directions=5.0 * rays()))
    noise = from_sensor.draw(given, seed=1)
    wanted: Any = from_sensor.run(given, noise)
    got: Any = snow().run(given, noise, directions=rays())
    assert torch.allclose(got.points, wanted.points, atol=1e-5)
    assert torch.equal(got.kind, wanted.kind)
    with pytest.raises(ValueError, match="complete_scan"):
        snow(complete_scan=True)(given, directions=rays())


@every_transform
def test_wrong_constructor_arguments_are_refused(make: Maker) -> None:
    for more, error in (
        ({"lost": "remove"}, ValueError),
        ({"variant": "d34"}, ValueError),
        ({"fog_extinction": "kruse"}, ValueError),
        ({"q_eff": -1.0}, ValueError),
        ({"sensor": "ouster"}, TypeError),
    ):
        with pytest.raises(error):
            make(**more)
    with pytest.raises(TypeError, match="weather must be"):
        LidarWeather(25.0, SENSOR)  # type: ignore[arg-type]
    with pytest.raises(TypeError, match=r"takes snow; got rain\. LidarWeather takes all"):
        LidarSnow(Rain(1.0), SENSOR)
