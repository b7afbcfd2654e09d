"""What every LiDAR transform promises, over all of them: formats, batches, replay, identity, bad input."""

from __future__ import annotations

import copy
import io
import itertools
import math
import pickle
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor
from torch.utils.data import DataLoader, Dataset

from torchweather.atmosphere.weather import Fog, Mixture, Rain, Snow, Weather
from torchweather.sensors import RETURN_MODES, Lidar
from torchweather.stages import Chain, PointKind
from torchweather.transforms import LidarFog, LidarRain, LidarResult, LidarSnow, LidarWeather

# Overlap from 1 to 3 m: rain returns too, fog not in every beam, and every kind of output occurs in a small cloud.
SENSOR = Lidar(
    wavelength_nm=905.0,
    near_start_m=1.0,
    near_full_m=3.0,
    range_noise_m=0.02,
    range_resolution_m=0.002,
    intensity_unit="uint8_linear",
)
N = 400
Maker = Callable[..., LidarWeather]


def rain(knob: Any = 60.0, sensor: Lidar = SENSOR, **more: Any) -> LidarWeather:
    return LidarRain(Rain(knob), sensor, **more)


def snow(knob: Any = 3.0, sensor: Lidar = SENSOR, **more: Any) -> LidarWeather:
    return LidarSnow(Snow(knob), sensor, **more)


def fog(knob: Any = 1500.0, sensor: Lidar = SENSOR, **more: Any) -> LidarWeather:
    return LidarFog(Fog(knob), sensor, **more)


def mixture(knob: Any = 5000.0, sensor: Lidar = SENSOR, **more: Any) -> LidarWeather:
    return LidarWeather(Mixture(Snow(1.0), Fog(knob), Rain(10.0)), sensor, **more)


ALL: list[Maker] = [rain, snow, fog, mixture]
every_transform = pytest.mark.parametrize("make", ALL, ids=["rain", "snow", "fog", "mixture"])
# Single returns take one path with the strongest, another with the other modes; dual has both and a second cloud.
both_paths = pytest.mark.parametrize("mode", ["strongest", "dual"])
every_mode = pytest.mark.parametrize("mode", RETURN_MODES)
IDENTITIES: dict[str, Weather] = {
    "rain": Rain(0.0),
    "snow": Snow(0.0),
    "fog": Fog(math.inf),
    "mixture": Mixture(Rain(0.0), Snow(0.0), Fog(math.inf)),
}
UNITS = ("reflectivity", "reflectivity_percent", "uint8_linear", "uint8_calibrated", "photons", "none")
DTYPES = [torch.float16, torch.bfloat16, torch.float32, torch.float64]
EMPTY = slice(0, 40)


def cloud(
    *batch: int, columns: int = 5, dtype: torch.dtype = torch.float32, seed: int = 0, scale: float = 255
) -> Tensor:
    """Objects at 0.5 to 100 m, every fifth of intensity 0, and 40 rows without return, one of them not dark."""
    generator = torch.Generator().manual_seed(seed)
    points = torch.randn((*batch, N, columns), generator=generator)
    span = torch.rand((*batch, N, 1), generator=generator)
    points[..., :3] *= 0.5 * 200.0**span / points[..., :3].norm(dim=-1, keepdim=True)
    points[..., EMPTY, :3] = 0.0
    intensity = torch.rand((*batch, N), generator=generator).square() * scale
    intensity[..., ::5] = 0.0
    intensity[..., EMPTY] = 0.0
    intensity[..., 3] = 0.5 * scale
    points[..., 3] = intensity if scale <= 1 else intensity.floor()
    return points.to(dtype)


def rays(*batch: int, seed: int = 5) -> Tensor:
    return torch.nn.functional.normalize(
        torch.randn((*batch, N, 3), generator=torch.Generator().manual_seed(seed)), dim=-1
    )


def same_bits(one: Tensor, other: Tensor) -> bool:
    """Bit for bit: 0 and -0 differ, a NaN equals itself."""
    as_integer = {2: torch.int16, 4: torch.int32, 8: torch.int64}[one.element_size()]
    return one.dtype == other.dtype and torch.equal(
        one.contiguous().view(as_integer), other.contiguous().view(as_integer)
    )


def parts(result: LidarResult) -> dict[str, Tensor]:
    """The tensors of a result."""
    return {name: value for name, value in vars(result).items() if isinstance(value, Tensor)}


@every_transform
@every_mode
@pytest.mark.parametrize("batch", [(), (1,), (3,), (2, 2)], ids=str)
def test_the_output_has_the_format_of_the_input(make: Maker, mode: str, batch: tuple[int, ...]) -> None:
    transform, given = make(sensor=replace(SENSOR, return_mode=mode)), cloud(*batch)
    result: Any = transform.run(given, transform.draw(given, seed=1))
    assert isinstance(result.points, Tensor)
    assert result.points.dtype == given.dtype
    assert result.points.shape == given.shape
    assert torch.equal(transform(given, transform.draw(given, seed=1)), result.points)
    assert not torch.equal(result.points, given)
    row_shape = (*batch, N)
    for name in ("kind", "source", "transmission"):
        assert getattr(result, name).shape == row_shape, name
    assert result.empty_beams.shape == result.floored_points.shape == batch
    seconds = (result.second, result.second_source, result.second_kind)
    if mode == "dual":
        assert [value.shape for value in seconds if isinstance(value, Tensor)] == [given.shape, row_shape, row_shape]
    else:
        assert seconds == (None, None, None)


@every_transform
@pytest.mark.parametrize("directed", [False, True])
def test_columns_and_dtype_are_those_of_the_input_and_further_columns_keep_their_bits(
    make: Maker, directed: bool
) -> None:
    transform = make(sensor=replace(SENSOR, return_mode="dual"))
    noise = transform.draw(cloud(2), seed=1)
    for dtype, columns in itertools.product(DTYPES, (4, 5, 7)):
        given = cloud(2, columns=columns, dtype=dtype)
        result: Any = transform.run(given, noise, directions=rays() if directed else None)
        for points in (result.points, result.second):
            assert points.dtype == dtype
            assert points.shape == given.shape
            assert bool(torch.isfinite(points).all())
            assert same_bits(points[..., 4:], given[..., 4:])
        assert result.transmission.dtype == dtype
        assert bool((result.kind[:, EMPTY] == PointKind.PARTICLE).any()) == directed


@every_transform
@pytest.mark.parametrize("dtype", DTYPES, ids=str)
def test_every_dtype_sees_the_same_weather(make: Maker, dtype: torch.dtype) -> None:
    """A half-precision cloud is what it says; the weather on it is that on the same numbers in float32."""
    transform, given = make(), cloud(dtype=dtype)
    noise = transform.draw(given, seed=1)
    wanted = transform(given.float(), noise)
    got = transform(given, noise)
    apart = (got.float() - wanted.to(dtype).float()).abs()
    # A float64 cloud is computed in float64: where a beam lies on the border of two cells of a table, which of them it
    # takes depends on the processor's rounding, and a particle stands some millimetres elsewhere.
    elsewhere = (apart > 1e-4 + 1e-4 * wanted.float().abs()).any(-1)
    assert int(elsewhere.sum()) <= (2 if dtype == torch.float64 else 0)
    assert bool((apart < 5e-3).all())


@every_transform
@both_paths
@pytest.mark.parametrize("lost", ["zero", "nan", "drop"])
@pytest.mark.parametrize("directed", [False, True])
def test_lost_points_are_zero_nan_or_left_out_and_nothing_else_changes(
    make: Maker, mode: str, lost: str, directed: bool
) -> None:
    sensor, given = replace(SENSOR, return_mode=mode), cloud(2)
    directions = rays(2) if directed else None
    reference = make(sensor=sensor)
    noise = reference.draw(given, seed=1)
    plain: Any = reference.run(given, noise, directions=directions)
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
@every_mode
def test_a_batch_equals_its_elements_bit_for_bit(make: Maker, mode: str) -> None:
    transform, given = make(sensor=replace(SENSOR, return_mode=mode)), cloud(2, 3)
    seeds = torch.tensor([[11, 5, 7], [2**62, 0, 13]])
    together = parts(transform.run(given, transform.draw(given, seed=seeds), directions=rays(2, 3)))
    for i in range(2):
        for j in range(3):
            noise = transform.draw(given[i, j], seed=int(seeds[i, j]))
            alone = parts(transform.run(given[i, j], noise, directions=rays(2, 3)[i, j]))
            assert alone.keys() == together.keys()
            for name, value in alone.items():
                assert torch.equal(together[name][i, j], value), name


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


@every_transform
@pytest.mark.parametrize("kind", ["strided", "expanded", "transposed"])
def test_the_layout_in_memory_does_not_matter(make: Maker, kind: str) -> None:
    transform, given = make(), cloud(2)
    if kind == "strided":
        given = given.repeat_interleave(2, 1)[:, ::2]
    elif kind == "expanded":
        given = given[:1].expand(2, N, 5)
    else:
        given = given.transpose(1, 2).contiguous().transpose(1, 2)
    noise = transform.draw(given, seed=1)
    assert torch.equal(transform(given, noise), transform(given.clone(memory_format=torch.contiguous_format), noise))


@every_transform
@both_paths
def test_a_draw_can_be_replayed_and_sliced(make: Maker, mode: str) -> None:
    transform, given = make(sensor=replace(SENSOR, return_mode=mode)), cloud(3)
    noise = transform.draw(given, generator=torch.Generator().manual_seed(3))
    first = transform(given, noise)
    assert torch.equal(first, transform(given, noise))
    part = {key: value[1:] for key, value in noise.items()}
    assert torch.equal(first[1:], transform(given[1:], part))
    assert all(value.shape[0] == 3 and value.device.type == "cpu" for value in noise.values())


@every_transform
def test_every_call_and_every_sample_has_its_own_draw(make: Maker) -> None:
    transform, given = make(), cloud().expand(2, N, 5)
    first, second = transform(given), transform(given)
    assert not torch.equal(first, second)
    assert not torch.equal(first[0], first[1])


@every_transform
def test_the_generator_decides_and_the_global_one_is_left_alone(make: Maker) -> None:
    transform, given = make(), cloud(2, 3)
    before = torch.get_rng_state()
    taken, counted = torch.Generator().manual_seed(5), torch.Generator().manual_seed(5)
    noise = transform.draw(given, generator=taken)
    transform(given, noise)
    transform.run(given, noise)
    transform.expected(given)
    transform.draw(given, seed=3)
    transform.on_numpy(given[0, 0].numpy(), seed=3)
    assert torch.equal(torch.get_rng_state(), before)
    torch.randint(0, 2**63 - 1, (6,), generator=counted)
    assert torch.equal(taken.get_state(), counted.get_state())


@every_transform
def test_the_global_seed_decides_an_everyday_call(make: Maker) -> None:
    transform, given = make(), cloud(2)
    torch.manual_seed(9)
    first = transform(given)
    torch.manual_seed(9)
    assert torch.equal(transform(given), first)


@every_transform
@both_paths
def test_drawing_looks_at_shapes_only(make: Maker, mode: str) -> None:
    sensor = replace(SENSOR, return_mode=mode)
    one = make(sensor=sensor).draw(cloud(2), seed=4)
    other = make(sensor=sensor).draw(torch.zeros(2, N, 4, dtype=torch.float64), seed=torch.tensor([4, 5]))
    assert one.keys() == other.keys()
    assert all(torch.equal(one[key], other[key]) for key in one)


@every_transform
@pytest.mark.parametrize("lost", ["zero", "nan", "drop"])
def test_inputs_are_never_changed(make: Maker, lost: str) -> None:
    transform, directions = make(sensor=replace(SENSOR, return_mode="dual"), lost=lost), 3.0 * rays(2)
    for dtype in (torch.float16, torch.float32, torch.float64):
        given = cloud(2, dtype=dtype)
        noise = transform.draw(given, seed=1)
        copies = given.clone(), directions.clone(), {key: value.clone() for key, value in noise.items()}
        for value in (transform(given, noise, directions=directions), transform.run(given, noise).points):
            for points in value:
                points.fill_(7.0)  # nor does what comes out share memory with what went in
        assert same_bits(given, copies[0])
        assert torch.equal(directions, copies[1])
        assert all(torch.equal(noise[key], copies[2][key]) for key in noise)


@every_transform
@both_paths
def test_pickle_deepcopy_and_state_dict_give_the_same_bits(make: Maker, mode: str) -> None:
    sensor = replace(SENSOR, return_mode=mode)
    transform, given = make(sensor=sensor), cloud(2)
    noise = transform.draw(given, seed=1)
    wanted = transform(given, noise)
    buffer = io.BytesIO()
    torch.save(transform.state_dict(), buffer)
    buffer.seek(0)
    restored = make(sensor=sensor)
    restored.load_state_dict(torch.load(buffer, weights_only=True))
    for again in (pickle.loads(pickle.dumps(transform)), copy.deepcopy(transform), restored):
        assert torch.equal(again(given, noise), wanted)
        assert all(torch.equal(value, noise[key]) for key, value in again.draw(given, seed=1).items())


@every_transform
@both_paths
def test_a_saved_chain_gives_the_same_bits(make: Maker, mode: str, tmp_path: Path) -> None:
    transform, given = make(sensor=replace(SENSOR, return_mode=mode, directions=rays())), cloud(2)
    noise = transform.draw(given, seed=1)
    wanted: Any = transform.run(given, noise)
    transform.chain.save(tmp_path / "weather.chain")
    again = copy.deepcopy(transform)
    again.chain = Chain.load(tmp_path / "weather.chain")
    assert all(torch.equal(value, noise[key]) for key, value in again.draw(given, seed=1).items())
    got: Any = again.run(given, noise)
    assert all(torch.equal(value, parts(wanted)[name]) for name, value in parts(got).items())


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


@every_transform
def test_parameters_are_buffers_so_that_no_optimiser_moves_the_weather(make: Maker) -> None:
    assert not list(make().parameters())


@every_transform
def test_one_module_in_double_precision_leaves_the_others_alone(make: Maker) -> None:
    before, given = make(), cloud()
    noise = before.draw(given, seed=1)
    wanted = before(given, noise)
    double = make().double()
    got = double(given.double(), noise)
    assert got.dtype == torch.float64
    # The same beams; a beam on the border of a decision could differ, here none does.
    assert torch.allclose(got.float(), wanted, rtol=1e-4, atol=1e-3)
    assert torch.equal(before(given, noise), wanted)
    assert torch.equal(make()(given, noise), wanted)


@both_paths
def test_threads_do_not_change_a_bit(mode: str) -> None:
    given = cloud(100).reshape(100 * N, 5)  # so many that torch splits them
    transform = mixture(sensor=replace(SENSOR, return_mode=mode))
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


# ---- weathers together ------------------------------------------------------------------------------------------


@both_paths
@pytest.mark.parametrize("weather", [Rain(60.0), Snow(3.0), Fog(1500.0)], ids=["rain", "snow", "fog"])
def test_a_mixture_of_one_is_that_one_bitwise(weather: Weather, mode: str) -> None:
    sensor, given = replace(SENSOR, return_mode=mode), cloud(2)
    alone = LidarWeather(weather, sensor)
    named = {"rain": LidarRain, "snow": LidarSnow, "fog": LidarFog}[weather.kind]
    noise = alone.draw(given, seed=1)
    wanted = parts(alone.run(given, noise))
    for other in (LidarWeather(Mixture(weather), sensor), named(weather, sensor)):
        assert all(torch.equal(value, noise[key]) for key, value in other.draw(given, seed=1).items())
        assert all(torch.equal(value, wanted[name]) for name, value in parts(other.run(given, noise)).items())


@both_paths
def test_the_order_of_a_mixture_does_not_matter(mode: str) -> None:
    sensor, given, weathers = replace(SENSOR, return_mode=mode), cloud(2), [Rain(30.0), Snow(2.0), Fog(300.0)]
    first, other = (LidarWeather(Mixture(*order), sensor) for order in (weathers, weathers[::-1]))
    noise = first.draw(given, seed=1)
    assert torch.equal(first(given, noise), other(given, other.draw(given, seed=1)))


@both_paths
def test_snow_added_to_rain_leaves_the_draw_of_rain_as_it_was(mode: str) -> None:
    sensor, given = replace(SENSOR, return_mode=mode), cloud(2)
    alone = rain(sensor=sensor).draw(given, seed=1)
    both = LidarWeather(Mixture(Rain(60.0), Snow(1.0), Fog(100.0)), sensor).draw(given, seed=1)
    assert alone.keys() < both.keys()
    assert all(torch.equal(value, both[key]) for key, value in alone.items())


@both_paths
@pytest.mark.parametrize("still", [Snow(0.0), Fog(math.inf)], ids=["no snow", "no fog"])
def test_a_weather_that_does_not_happen_changes_nothing_in_a_mixture(still: Weather, mode: str) -> None:
    sensor, given = replace(SENSOR, return_mode=mode), cloud(2)
    alone, both = rain(sensor=sensor), LidarWeather(Mixture(Rain(60.0), still), sensor)
    noise = both.draw(given, seed=1)
    assert torch.equal(both(given, noise), alone(given, {key: noise[key] for key in alone.draw(given, seed=1)}))


@both_paths
@pytest.mark.parametrize(
    ("make", "knobs"), [(rain, (0.0, 7.0, 60.0)), (snow, (0.1, 1.0, 5.0)), (fog, (40.0, math.inf, 900.0))]
)
def test_a_knob_for_each_sample_equals_separate_calls(make: Maker, knobs: tuple[float, ...], mode: str) -> None:
    given, sensor = cloud(3), replace(SENSOR, return_mode=mode)
    transform = make(torch.tensor(knobs), sensor)
    noise = transform.draw(given, seed=1)
    together = parts(transform.run(given, noise))
    for row, knob in enumerate(knobs):
        alone = make(knob, sensor)
        own = alone.draw(given[row], seed=1 + row)
        for key, value in own.items():  # the echoes that a lighter weather needs are the first of the heavier one's
            drawn = noise[key][row]
            assert torch.equal(value, drawn[: len(value)] if value.ndim == 2 else drawn)
        for name, value in parts(alone.run(given[row], own)).items():
            assert torch.equal(together[name][row], value), name


@pytest.mark.parametrize("shape", [(2, 2), (1,), ()], ids=str)
def test_knobs_of_batch_shape_of_one_element_and_of_none(shape: tuple[int, ...]) -> None:
    given, knob = cloud(2, 2), torch.full(shape, 30.0)
    transform = rain(knob)
    noise = transform.draw(given, seed=1)
    assert torch.equal(transform(given, noise), rain(30.0)(given, noise))
    assert transform.extinction_per_m.numel() == knob.numel()


def test_a_new_rate_costs_no_set_up() -> None:
    """The knob is a buffer: the weather of a module is changed in place, and its tables follow."""
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


# ---- identity ---------------------------------------------------------------------------------------------------


@every_mode
@pytest.mark.parametrize("weather", IDENTITIES.values(), ids=IDENTITIES.keys())
@pytest.mark.parametrize("unit", UNITS)
def test_no_weather_gives_the_input_back_bit_for_bit(weather: Weather, mode: str, unit: str) -> None:
    sensor = replace(SENSOR, return_mode=mode, intensity_unit=unit)
    transform = LidarWeather(weather, sensor)
    for dtype in DTYPES:
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


@pytest.mark.parametrize("make", [rain, snow, fog])
def test_samples_without_weather_stay_as_they_are_beside_rainy_ones(make: Maker) -> None:
    given, none = cloud(2), math.inf if make is fog else 0.0
    got = make(torch.tensor([none, 5.0]))(given)
    assert same_bits(got[0], given[0])
    assert not torch.equal(got[1], given[1])


@pytest.mark.parametrize("lost", ["zero", "nan"])
def test_no_weather_loses_nothing_however_losses_are_shown(lost: str) -> None:
    assert same_bits(snow(0.0, lost=lost)(cloud(2)), cloud(2))


# ---- bad input --------------------------------------------------------------------------------------------------


@every_transform
def test_unknown_keywords_are_refused(make: Maker) -> None:
    transform, given = make(), cloud()
    with pytest.raises(TypeError, match="unexpected keyword"):
        make(severity=3)
    with pytest.raises(TypeError, match="unexpected keyword"):
        transform(given, severity=3)
    with pytest.raises(TypeError, match="unexpected keyword"):
        transform.run(given, direction=rays())  # type: ignore[call-arg]
    with pytest.raises(TypeError, match="unexpected keyword"):
        transform.draw(given, sead=3)  # type: ignore[call-arg]


@every_transform
def test_noise_that_is_missing_or_of_another_cloud_is_refused(make: Maker) -> None:
    transform, given = make(), cloud(2)
    noise = transform.draw(given, seed=1)
    for key, value in noise.items():
        lacking = {name: other for name, other in noise.items() if name != key}
        with pytest.raises(ValueError, match=f"lacks {key}.*draw"):
            transform(given, lacking)
        for wrong in (value[..., :-1], value[:1], value.flatten(), value[..., None]):
            with pytest.raises(ValueError, match=f"noise '{key}' must hold .* Draw again"):
                transform(given, {**noise, key: wrong})
    with pytest.raises(ValueError, match="Draw again"):
        transform(given[:, : N - 1], noise)


@every_transform
def test_seed_and_generator_together_are_refused_and_seeds_of_another_shape(make: Maker) -> None:
    transform, given = make(), cloud(2)
    with pytest.raises(ValueError, match="either seed or generator"):
        transform.draw(given, generator=torch.Generator(), seed=1)
    with pytest.raises(ValueError, match="batch shape"):
        transform.draw(given, seed=torch.tensor([1, 2, 3]))
    with pytest.raises(TypeError, match="integer"):
        transform.draw(given, seed=1.5)  # type: ignore[arg-type]


@every_transform
@both_paths
def test_empty_clouds_and_batches_come_back_empty(make: Maker, mode: str) -> None:
    transform = make(sensor=replace(SENSOR, return_mode=mode))
    for shape in ((0, 4), (3, 0, 5), (0, 10, 4), (2, 0, 10, 4), (0, 0, 4)):
        given = torch.zeros(shape)
        assert transform(given).shape == shape
        result: Any = transform.run(given)
        assert all(value.shape[: len(shape) - 2] == shape[:-2] for value in parts(result).values())
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


@every_transform
@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("column", [0, 2, 3, 4])
def test_values_that_are_not_finite_are_refused_with_their_column(make: Maker, bad: float, column: int) -> None:
    given = cloud(2)
    given[1, 7, column] = bad
    for call in (make(), make().run, make().expected, make().draw):
        with pytest.raises(ValueError, match=rf"1 rows with NaN or infinity \(columns \[{column}\]\)"):
            call(given)


def test_infinities_of_both_signs_are_seen_too() -> None:
    given = cloud()
    given[1, 0], given[2, 0] = math.inf, -math.inf
    with pytest.raises(ValueError, match="2 rows"):
        rain()(given)


@every_transform
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
def test_what_is_no_cloud_is_refused(make: Maker, bad: Any, error: type[Exception], message: str) -> None:
    transform = make()
    for call in (transform, transform.run, transform.draw, transform.expected):
        with pytest.raises(error, match=f"(?s)^{type(transform).__name__}: .*{message}"):
            call(bad)


@every_transform
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
def test_directions_that_do_not_fit_are_refused(make: Maker, directions: Tensor, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        make()(cloud(2), directions=directions)


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


@pytest.mark.parametrize("shape", [(3,), (2, 1), (0,)], ids=str)
def test_a_knob_of_another_shape_is_refused(shape: tuple[int, ...]) -> None:
    with pytest.raises(ValueError, match=r"rate_mm_per_h must be one value or one for each sample.*\(2,\)"):
        rain(torch.full(shape, 10.0))(cloud(2))


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


# ---- numpy ------------------------------------------------------------------------------------------------------


@every_transform
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_numpy_in_numpy_out(make: Maker, dtype: Any) -> None:
    transform, given = make(), cloud().numpy().astype(dtype)
    copied = given.copy()
    got = transform.on_numpy(given, seed=3, directions=rays().numpy())
    assert got.dtype == dtype
    assert np.array_equal(given, copied)
    tensor = torch.from_numpy(given)
    assert np.array_equal(got, transform(tensor, transform.draw(tensor, seed=3), directions=rays()).numpy())


def test_numpy_arrays_of_any_layout_and_read_only_ones_are_taken() -> None:
    """A simulator's callback reads its buffer in place: ``np.frombuffer`` gives what must not be written."""
    transform, given = rain(), cloud(columns=4).numpy()
    wanted = transform.on_numpy(given, seed=3)
    read_only = np.frombuffer(given.tobytes(), dtype=np.float32).reshape(-1, 4)
    assert np.array_equal(transform.on_numpy(read_only, seed=3), wanted)
    assert np.array_equal(transform.on_numpy(np.asfortranarray(given), seed=3), wanted)
    assert np.array_equal(transform.on_numpy(given[::-1][::-1], seed=3), wanted)


@pytest.mark.gpu
@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a CUDA device")
@every_transform
@every_mode
def test_the_device_follows_the_input(make: Maker, mode: str) -> None:
    transform, given = make(sensor=replace(SENSOR, return_mode=mode)), cloud(2)
    noise = transform.draw(given, seed=1)
    wanted: Any = transform.run(given, noise, directions=rays())
    got: Any = copy.deepcopy(transform).to("cuda").run(given.to("cuda"), noise, directions=rays().to("cuda"))
    assert all(value.device.type == "cuda" for value in parts(got).values())
    # Another exp and log: a beam at the edge of a decision may fall on the other side.
    same = got.kind.cpu() == wanted.kind
    assert float(same.float().mean()) > 0.999
    difference = (got.points.cpu() - wanted.points).abs()[same]
    assert float(difference[:, :3].max()) < 2e-3
    # Counts are rounded down: one step where the value sits on an integer.
    assert float(difference[:, 3].max()) <= 1.0
