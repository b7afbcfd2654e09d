"""What RadarAttenuation promises in every weather: formats, batches, replay, identity, bad input."""

from __future__ import annotations

import copy
import io
import itertools
import math
import pickle
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from torchweather.atmosphere.weather import Fog, Mixture, Rain, Snow, Weather
from torchweather.sensors import Radar
from torchweather.stages import Chain, PointKind
from torchweather.transforms import RadarAttenuation, RadarResult

# A floor in the middle of the powers below: of a small list some are lost, some stand on it, and rain is seen itself.
SENSOR = replace(Radar.preset("imaging-77ghz"), noise_floor_db=-130.0)
THRESHOLD_DB = -118.0
N, K = 300, 24
OBJECT, PARTICLE, LOST = (int(kind) for kind in (PointKind.OBJECT, PointKind.PARTICLE, PointKind.LOST))
EMPTY = slice(0, 20)
FLOORED = slice(20, 80)
Maker = Callable[..., RadarAttenuation]
CLUTTER: dict[str, Any] = {"clutter": True, "clutter_points": K, "radome_film_db": 0.8}


def rain(knob: Any = 60.0, **more: Any) -> RadarAttenuation:
    return RadarAttenuation(Rain(knob), SENSOR, **more)


def snow(knob: Any = 5.0, **more: Any) -> RadarAttenuation:
    return RadarAttenuation(Snow(knob, melt_fraction=0.5), SENSOR, **more)


def fog(knob: Any = 12.0, **more: Any) -> RadarAttenuation:
    return RadarAttenuation(Fog(knob), SENSOR, **more)


def mixture(knob: Any = 30.0, **more: Any) -> RadarAttenuation:
    weather = Mixture(Snow(2.0, melt_fraction=0.3, patch_log_std=0.4), Fog(knob), Rain(40.0))
    return RadarAttenuation(weather, SENSOR, **{**CLUTTER, **more})


def rain_seen(knob: Any = 60.0, **more: Any) -> RadarAttenuation:
    return rain(knob, **{**CLUTTER, **more})


MAKERS: dict[str, Maker] = {"rain": rain, "snow": snow, "fog": fog, "rain seen": rain_seen, "mixture seen": mixture}
every_transform = pytest.mark.parametrize("make", MAKERS.values(), ids=MAKERS.keys())
IDENTITIES: dict[str, Weather] = {
    "rain": Rain(0.0),
    "snow": Snow(0.0),
    "wet snow": Snow(0.0, melt_fraction=0.5),
    "fog": Fog(math.inf),
    "mixture": Mixture(Rain(0.0), Snow(0.0), Fog(math.inf)),
}
DTYPES = [torch.float16, torch.bfloat16, torch.float32, torch.float64]


def detections(*batch: int, columns: int = 7, dtype: torch.dtype = torch.float32, seed: int = 0) -> Tensor:
    """Targets at 2 to 150 m; 20 rows without detection, one of them not blank; 60 below the threshold."""
    random = torch.Generator().manual_seed(seed)
    points = torch.randn((*batch, N, columns), generator=random)
    span = torch.rand((*batch, N, 1), generator=random)
    points[..., :3] *= 2.0 * 75.0**span / points[..., :3].norm(dim=-1, keepdim=True)
    points[..., 4] = THRESHOLD_DB + 0.25 + 20.0 * torch.rand((*batch, N), generator=random).square()
    points[..., FLOORED, 4] = -125.0
    points[..., 5] *= 10.0
    points[..., EMPTY, :] = 0.0
    points[..., 3, 3:6] = torch.tensor([1.5, -50.0, 3.0])
    return points.to(dtype)


def rows_of(transform: RadarAttenuation) -> int:
    """Rows that leave for N that come."""
    return N + K * sum(name.endswith("_clutter") for name in transform.chain.stages)


def same_bits(one: Tensor, other: Tensor) -> bool:
    """Bit for bit: 0 and -0 differ, a NaN equals itself."""
    as_integer = {2: torch.int16, 4: torch.int32, 8: torch.int64}[one.element_size()]
    return one.dtype == other.dtype and torch.equal(
        one.contiguous().view(as_integer), other.contiguous().view(as_integer)
    )


def parts(result: RadarResult) -> dict[str, Tensor]:
    """The tensors of a result."""
    return {name: value for name, value in vars(result).items() if isinstance(value, Tensor)}


def equal_parts(one: RadarResult, other: RadarResult) -> bool:
    first, second = parts(one), parts(other)
    return first.keys() == second.keys() and all(torch.equal(value, second[name]) for name, value in first.items())


# ---- format -----------------------------------------------------------------------------------------------------


@every_transform
@pytest.mark.parametrize("batch", [(), (1,), (3,), (2, 1, 2)], ids=str)
def test_the_output_has_the_format_of_the_input(make: Maker, batch: tuple[int, ...]) -> None:
    transform, given = make(), detections(*batch)
    noise = transform.draw(given, seed=1)
    result: Any = transform.run(given, noise)
    assert result.points.dtype == given.dtype
    assert result.points.shape == (*batch, rows_of(transform), 7)
    assert torch.equal(transform(given, noise), result.points)
    for name in ("kind", "source", "snr_db", "attenuation_db"):
        assert getattr(result, name).shape == (*batch, rows_of(transform)), name
    assert result.kind.dtype == torch.int8
    assert result.floored_points.shape == batch
    assert bool((result.floored_points == 60).all())
    # Every kind of row occurs in a small list.
    objects = result.kind[..., :N]
    assert bool((objects == LOST)[..., 20:].any())
    assert bool((objects == OBJECT).any())
    assert bool((result.kind[..., N:] == PARTICLE).any()) == (rows_of(transform) > N)


@every_transform
def test_columns_and_dtype_are_those_of_the_input_and_further_columns_keep_their_bits(make: Maker) -> None:
    transform = make()
    noise = transform.draw(detections(2), seed=1)
    for dtype, columns in itertools.product(DTYPES, (6, 7, 9)):
        given = detections(2, columns=columns, dtype=dtype)
        result: Any = transform.run(given, noise)
        assert result.points.dtype == result.snr_db.dtype == result.attenuation_db.dtype == dtype
        assert result.points.shape == (2, rows_of(transform), columns)
        assert bool(torch.isfinite(result.points).all())
        for column in (3, *range(5, columns)):  # speed, cross section and what follows
            assert same_bits(result.points[:, :N, column], given[..., column])
        assert bool((result.points[:, N:, 6:] == 0).all())


@every_transform
@pytest.mark.parametrize("dtype", DTYPES, ids=str)
def test_every_dtype_sees_the_same_weather(make: Maker, dtype: torch.dtype) -> None:
    """A half-precision list is what it says; the weather on it is that on the same numbers in float32."""
    transform, given = make(), detections(dtype=dtype)
    noise = transform.draw(given, seed=1)
    wanted: Any = transform.run(given.float(), noise)
    got: Any = transform.run(given, noise)
    assert torch.equal(got.kind, wanted.kind)
    assert torch.allclose(got.points.float(), wanted.points.to(dtype).float(), rtol=1e-4, atol=1e-4)


@every_transform
@pytest.mark.parametrize("lost", ["zero", "nan", "drop"])
def test_lost_points_are_zero_nan_or_left_out_and_nothing_else_changes(make: Maker, lost: str) -> None:
    given = detections(2)
    reference = make()
    noise = reference.draw(given, seed=1)
    plain: Any = reference.run(given, noise)
    result: Any = make(lost=lost).run(given, noise)
    gone = plain.kind == LOST
    assert bool((plain.points[gone][:, :3] == 0).all())
    assert same_bits(plain.points[:, EMPTY], given[:, EMPTY])
    was_empty = torch.zeros_like(gone)
    was_empty[:, EMPTY] = True
    for b in range(2):
        if lost == "drop":
            for name in ("points", "kind", "source", "snr_db", "attenuation_db"):
                assert torch.equal(getattr(result, name)[b], getattr(plain, name)[b][~gone[b]]), name
            continue
        assert torch.equal(result.points[b][~gone[b]], plain.points[b][~gone[b]])
        assert same_bits(result.points[:, EMPTY], given[:, EMPTY])
        assert torch.equal(result.kind, plain.kind)
        if lost == "nan":
            assert torch.equal(result.points[b][:, :6].isnan().all(-1), gone[b] & ~was_empty[b])
            assert bool(torch.isfinite(result.points[b][:, 6:]).all())


def test_without_a_batch_dropped_points_leave_one_tensor_and_with_one_a_list() -> None:
    transform = rain(lost="drop")
    alone, batch = transform(detections()), transform(detections(3))
    assert isinstance(alone, Tensor)
    assert alone.shape[0] < N
    assert isinstance(batch, list)
    assert len(batch) == 3


@every_transform
def test_one_row_and_none_and_empty_batches(make: Maker) -> None:
    transform = make()
    more = rows_of(transform) - N
    for shape in ((0, 6), (1, 6), (3, 0, 7), (0, 10, 6), (2, 0, 10, 6), (0, 0, 6), (2, 1, 8)):
        given = torch.ones(shape)
        result: Any = transform.run(given)
        assert result.points.shape == (*shape[:-2], shape[-2] + more, shape[-1])
        assert all(value.shape[: len(shape) - 2] == shape[:-2] for value in parts(result).values())
        assert torch.equal(result.points[..., : shape[-2], :3], given[..., :3])


# ---- batches and draws ------------------------------------------------------------------------------------------


@every_transform
def test_a_batch_equals_its_elements_bit_for_bit(make: Maker) -> None:
    transform, given = make(), detections(2, 3)
    seeds = torch.tensor([[11, 5, 7], [2**62, 0, 13]])
    together = parts(transform.run(given, transform.draw(given, seed=seeds)))
    for i, j in itertools.product(range(2), range(3)):
        alone = parts(transform.run(given[i, j], transform.draw(given[i, j], seed=int(seeds[i, j]))))
        assert alone.keys() == together.keys()
        for name, value in alone.items():
            assert torch.equal(together[name][i, j], value), name


def test_a_point_does_not_depend_on_its_neighbours() -> None:
    transform, given = rain(), detections()
    noise = transform.draw(given, seed=1)
    whole: Any = transform.run(given, noise)
    for part in (slice(1, 2), slice(37, 200), slice(0, N, 7)):
        with floor_warnings():  # a part may hold the rows below the threshold only
            result: Any = transform.run(given[part], {key: value[part] for key, value in noise.items()})
        assert torch.equal(result.points, whole.points[part])
        assert torch.equal(result.snr_db, whole.snr_db[part])


@contextmanager
def floor_warnings() -> Iterator[None]:
    """Lists whose powers contradict the floor, on purpose."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message=".*noise_floor_db")
        yield


@every_transform
@pytest.mark.parametrize("kind", ["strided", "expanded", "transposed"])
def test_the_layout_in_memory_does_not_matter(make: Maker, kind: str) -> None:
    transform, given = make(), detections(2)
    if kind == "strided":
        given = given.repeat_interleave(2, 1)[:, ::2]
    elif kind == "expanded":
        given = given[:1].expand(2, N, 7)
    else:
        given = given.transpose(1, 2).contiguous().transpose(1, 2)
    noise = transform.draw(given, seed=1)
    assert torch.equal(transform(given, noise), transform(given.clone(memory_format=torch.contiguous_format), noise))


@every_transform
def test_a_draw_can_be_replayed_and_sliced(make: Maker) -> None:
    transform, given = make(), detections(3)
    noise = transform.draw(given, generator=torch.Generator().manual_seed(3))
    first = transform(given, noise)
    assert torch.equal(first, transform(given, noise))
    part = {key: value[1:] for key, value in noise.items()}
    assert torch.equal(first[1:], transform(given[1:], part))
    assert all(value.shape[0] == 3 and value.device.type == "cpu" for value in noise.values())


@every_transform
def test_every_call_and_every_sample_has_its_own_draw(make: Maker) -> None:
    transform, given = make(), detections().expand(2, N, 7)
    first: Any = transform.run(given)
    second: Any = transform.run(given)
    assert not torch.equal(first.snr_db, second.snr_db)
    assert not torch.equal(first.snr_db[0], first.snr_db[1])


@every_transform
def test_the_generator_decides_and_the_global_one_is_left_alone(make: Maker) -> None:
    transform, given = make(), detections(2, 3)
    before = torch.get_rng_state()
    taken, counted = torch.Generator().manual_seed(5), torch.Generator().manual_seed(5)
    noise = transform.draw(given, generator=taken)
    transform(given, noise)
    transform.run(given, noise)
    transform.draw(given, seed=3)
    transform.on_numpy(given[0, 0].numpy(), seed=3)
    assert torch.equal(torch.get_rng_state(), before)
    torch.randint(0, 2**63 - 1, (6,), generator=counted)
    assert torch.equal(taken.get_state(), counted.get_state())
    torch.manual_seed(9)
    first = transform(given)
    torch.manual_seed(9)
    assert torch.equal(transform(given), first)


@every_transform
def test_drawing_looks_at_shapes_only(make: Maker) -> None:
    one = make().draw(detections(2), seed=4)
    other = make(9.0).draw(torch.zeros(2, N, 6, dtype=torch.float64), seed=4)
    assert one.keys() == other.keys()
    assert all(torch.equal(one[key], other[key]) for key in one)


@every_transform
def test_a_sample_of_a_batch_draws_from_its_own_seed(make: Maker) -> None:
    transform, given = make(), detections(3)
    counted = transform.draw(given, seed=7)
    named = transform.draw(given, seed=torch.tensor([7, 8, 9]))
    assert all(torch.equal(value, named[key]) for key, value in counted.items())


@every_transform
@pytest.mark.parametrize("lost", ["zero", "nan", "drop"])
def test_inputs_are_never_changed(make: Maker, lost: str) -> None:
    transform = make(lost=lost)
    for dtype in (torch.float16, torch.float32, torch.float64):
        given = detections(2, dtype=dtype)
        noise = transform.draw(given, seed=1)
        copies = given.clone(), {key: value.clone() for key, value in noise.items()}
        for value in (transform(given, noise), transform.run(given, noise).points):
            for points in value:
                points.fill_(7.0)  # nor does what comes out share memory with what went in
        assert same_bits(given, copies[0])
        assert all(torch.equal(noise[key], copies[1][key]) for key in noise)


# ---- copies and files -------------------------------------------------------------------------------------------


@every_transform
def test_pickle_deepcopy_and_state_dict_give_the_same_bits(make: Maker) -> None:
    transform, given = make(), detections(2)
    noise = transform.draw(given, seed=1)
    wanted = transform(given, noise)
    buffer = io.BytesIO()
    torch.save(transform.state_dict(), buffer)
    buffer.seek(0)
    restored = make()
    restored.load_state_dict(torch.load(buffer, weights_only=True))
    for again in (pickle.loads(pickle.dumps(transform)), copy.deepcopy(transform), restored):
        assert torch.equal(again(given, noise), wanted)
        assert all(torch.equal(value, noise[key]) for key, value in again.draw(given, seed=1).items())


@every_transform
def test_a_saved_chain_gives_the_same_bits(make: Maker, tmp_path: Path) -> None:
    transform, given = make(), detections(2)
    noise = transform.draw(given, seed=1)
    wanted = transform.run(given, noise)
    transform.chain.save(tmp_path / "weather.chain")
    again = copy.deepcopy(transform)
    again.chain = Chain.load(tmp_path / "weather.chain")
    assert again.chain.to_dict() == transform.chain.to_dict()
    assert all(torch.equal(value, noise[key]) for key, value in again.draw(given, seed=1).items())
    assert equal_parts(again.run(given, noise), wanted)


@pytest.mark.parametrize(
    "options",
    [
        {"rain_model": "dsd_mie", "fog_model": "d3_4"},
        {"variant": "d3_4"},
        {"radome_loss_db": 1.5, "radome_film_exponent": 0.5, "ego_speed_m_per_s": 12.0},
    ],
)
def test_a_saved_chain_keeps_its_options_and_its_knobs(options: dict[str, Any], tmp_path: Path) -> None:
    weather = Mixture(Rain(torch.tensor([5.0, 0.0])), Fog(torch.tensor([math.inf, 40.0])), Snow(1.0))
    transform, given = RadarAttenuation(weather, SENSOR, **{**CLUTTER, **options}), detections(2)
    transform.chain.save(tmp_path / "weather.chain")
    again = copy.deepcopy(transform)
    again.chain = Chain.load(tmp_path / "weather.chain")
    assert again.chain.to_dict() == transform.chain.to_dict()
    noise = transform.draw(given, seed=1)
    assert equal_parts(again.run(given, noise), transform.run(given, noise))


@every_transform
def test_parameters_are_buffers_so_that_no_optimiser_moves_the_weather(make: Maker) -> None:
    assert not list(make().parameters())


@every_transform
def test_one_module_in_double_precision_leaves_the_others_alone(make: Maker) -> None:
    before, given = make(), detections()
    noise = before.draw(given, seed=1)
    wanted = before(given, noise)
    got = make().double()(given.double(), noise)
    assert got.dtype == torch.float64
    assert torch.allclose(got.float(), wanted, rtol=1e-4, atol=1e-3)
    assert torch.equal(before(given, noise), wanted)
    assert torch.equal(make()(given, noise), wanted)


# ---- weathers together ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("clutter", [False, True])
@pytest.mark.parametrize("weather", [Rain(60.0), Snow(3.0), Fog(20.0)], ids=["rain", "snow", "fog"])
def test_a_mixture_of_one_is_that_one_bitwise(weather: Weather, clutter: bool) -> None:
    given, more = detections(2), CLUTTER if clutter else {}
    alone, mixed = (RadarAttenuation(w, SENSOR, **more) for w in (weather, Mixture(weather)))
    noise = alone.draw(given, seed=1)
    assert all(torch.equal(value, noise[key]) for key, value in mixed.draw(given, seed=1).items())
    assert equal_parts(mixed.run(given, noise), alone.run(given, noise))


def test_the_order_of_a_mixture_does_not_matter() -> None:
    given = detections(2)
    results = []
    for order in itertools.permutations([Rain(30.0), Snow(2.0), Fog(30.0)]):
        transform = RadarAttenuation(Mixture(*order), SENSOR, **CLUTTER)
        results.append(transform.run(given, transform.draw(given, seed=1)))
    assert all(equal_parts(result, results[0]) for result in results[1:])


def test_snow_added_to_rain_leaves_the_draw_of_rain_as_it_was() -> None:
    given = detections(2)
    alone, both = rain_seen().draw(given, seed=1), mixture().draw(given, seed=1)
    assert alone.keys() < both.keys()
    assert all(torch.equal(value, both[key]) for key, value in alone.items())


@pytest.mark.parametrize("still", [Snow(0.0), Fog(math.inf)], ids=["no snow", "no fog"])
def test_a_weather_that_does_not_happen_changes_nothing_in_a_mixture(still: Weather) -> None:
    given, alone = detections(2), rain()
    both = RadarAttenuation(Mixture(Rain(60.0), still), SENSOR)
    noise = alone.draw(given, seed=1)
    assert equal_parts(both.run(given, noise), alone.run(given, noise))


@pytest.mark.parametrize(
    ("make", "knobs"),
    [
        (rain_seen, (0.0, 7.0, 60.0)),
        (snow, (0.1, 1.0, 5.0)),
        (fog, (15.0, math.inf, 900.0)),
        (mixture, (9.0, 60.0, 1e4)),
    ],
)
def test_a_knob_for_each_sample_equals_separate_calls(make: Maker, knobs: tuple[float, ...]) -> None:
    given, transform = detections(3), make(torch.tensor(knobs))
    together = parts(transform.run(given, transform.draw(given, seed=1)))
    for row, knob in enumerate(knobs):
        alone = make(knob)
        for name, value in parts(alone.run(given[row], alone.draw(given[row], seed=1 + row))).items():
            assert torch.equal(together[name][row], value), name


@pytest.mark.parametrize("shape", [(2, 2), (1,), ()], ids=str)
def test_knobs_of_batch_shape_of_one_element_and_of_none(shape: tuple[int, ...]) -> None:
    given, knob = detections(2, 2), torch.full(shape, 30.0)
    transform = rain_seen(knob)
    noise = transform.draw(given, seed=1)
    assert equal_parts(transform.run(given, noise), rain_seen(30.0).run(given, noise))
    assert transform.attenuation_db_per_km.numel() == knob.numel()


def test_a_new_rate_costs_no_set_up() -> None:
    """The knob is a buffer: the weather of a module is changed in place, and its tables follow."""
    transform, given = rain_seen(), detections()
    noise = transform.draw(given, seed=1)
    before = transform(given, noise)
    knobs = [name for name, _ in transform.named_buffers() if name.endswith("rate_mm_per_h")]
    assert len(knobs) == 3  # of the path, the cover and the clutter
    moved = torch.func.functional_call(transform, {name: torch.tensor(20.0) for name in knobs}, (given, noise))
    assert torch.equal(moved, rain_seen(20.0)(given, noise))
    assert not torch.equal(moved, before)
    assert torch.equal(transform(given, noise), before)


@pytest.mark.parametrize(
    ("make", "knobs", "sign"),
    [(rain, (0.0, 30.0), -1.0), (rain_seen, (0.0, 30.0), -1.0), (snow, (0.0, 2.0), -1.0), (fog, (math.inf, 30.0), 1.0)],
)
def test_the_knob_has_a_gradient_that_is_finite_in_clear_air_too(
    make: Maker, knobs: tuple[float, float], sign: float
) -> None:
    """More rain lowers every power, more visibility raises it; where nothing falls the slope is 0."""
    knob = torch.tensor(knobs, requires_grad=True)
    transform, given = make(knob), detections(2)
    result: Any = transform.run(given, transform.draw(given, seed=1))
    (gradient,) = torch.autograd.grad(result.points[:, :N, 4].sum(), knob, retain_graph=True)
    assert bool(torch.isfinite(gradient).all())
    assert gradient[0] == 0.0
    assert sign * float(gradient[1]) > 0.0
    range_m = given[1, :, :3].double().norm(dim=-1)
    if make is not rain_seen:  # whose cover takes more, too
        slope = float(torch.autograd.grad(transform.attenuation_db_per_km.sum(), knob)[0][1])
        # Float32 sums of 300 terms.
        assert float(gradient[1]) == pytest.approx(-2e-3 * slope * float(range_m.sum()), rel=1e-4)


# ---- identity ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("batch", [(), (2,), (1, 2), (2, 1, 2)], ids=str)
@pytest.mark.parametrize("weather", IDENTITIES.values(), ids=IDENTITIES.keys())
def test_no_weather_gives_the_input_back_bit_for_bit(weather: Weather, batch: tuple[int, ...]) -> None:
    for dtype, lost in itertools.product(DTYPES, ("zero", "nan")):
        given = detections(*batch, dtype=dtype, columns=8)
        given[..., 90, :6] = torch.tensor([4.0, -0.0, 0.0, -0.0, -0.0, -0.0])
        given[..., 5, :] = -0.0
        given[..., 6] *= -0.0
        if dtype != torch.bfloat16:  # a NaN stays one there, with other bits: it goes through float32
            given[..., 91, 7] = math.nan
        transform = RadarAttenuation(weather, SENSOR, lost=lost, radome_film_db=2.0)
        result: Any = transform.run(given)
        assert same_bits(result.points, given)
        assert torch.equal(result.kind == LOST, (given[..., :3] == 0).all(-1))
        assert not bool((result.kind == PARTICLE).any())
        assert bool((result.attenuation_db == 0).all())
        assert not bool(torch.signbit(result.attenuation_db).any())


def test_no_weather_with_clutter_appends_empty_rows_only() -> None:
    given = detections(2)
    transform = RadarAttenuation(Mixture(Rain(0.0), Snow(0.0)), SENSOR, **CLUTTER)
    result: Any = transform.run(given)
    assert same_bits(result.points[:, :N], given)
    assert bool((result.points[:, N:] == 0).all())
    assert bool((result.kind[:, N:] == LOST).all())
    assert bool((result.source[:, N:] == -1).all())


@pytest.mark.parametrize("make", [rain, rain_seen, snow, fog])
def test_samples_without_weather_stay_as_they_are_beside_rainy_ones(make: Maker) -> None:
    given, none = detections(2), math.inf if make is fog else 0.0
    got = make(torch.tensor([none, 10.0]))(given)
    assert same_bits(got[0, :N], given[0])
    assert not torch.equal(got[1, :N], given[1])


def test_a_row_at_the_origin_is_no_detection_whatever_else_it_holds() -> None:
    given = torch.tensor([[-0.0, 0.0, -0.0, 5.0, -60.0, -0.0], [9.0, -0.0, 0.0, -0.0, -60.0, 1.0]])
    result: Any = rain(radome_loss_db=3.0).run(given)
    assert same_bits(result.points[0], given[0])
    assert result.kind.tolist() == [LOST, OBJECT]


# ---- bad input --------------------------------------------------------------------------------------------------


@every_transform
def test_unknown_keywords_are_refused(make: Maker) -> None:
    transform, given = make(), detections()
    with pytest.raises(TypeError, match="unexpected keyword"):
        make(severity=3)
    with pytest.raises(TypeError, match="unexpected keyword"):
        transform(given, severity=3)
    with pytest.raises(TypeError, match="unexpected keyword"):
        transform.run(given, directions=given)  # type: ignore[call-arg]


@every_transform
def test_noise_that_is_missing_or_of_another_list_is_refused(make: Maker) -> None:
    transform, given = make(), detections(2)
    noise = transform.draw(given, seed=1)
    for key, value in noise.items():
        lacking = {name: other for name, other in noise.items() if name != key}
        with pytest.raises(ValueError, match=f"RadarAttenuation: the noise lacks {key}.*draw"):
            transform(given, lacking)
        for wrong in (value[..., :-1], value[:1], value.flatten(), value[..., None]):
            with pytest.raises(ValueError, match=f"noise '{key}' must hold .* Draw again"):
                transform(given, {**noise, key: wrong})
    with pytest.raises(ValueError, match="Draw again"):
        transform(given[:, : N - 1], noise)


@every_transform
def test_seed_and_generator_together_are_refused_and_seeds_of_another_shape(make: Maker) -> None:
    transform, given = make(), detections(2)
    with pytest.raises(ValueError, match="either seed or generator"):
        transform.draw(given, generator=torch.Generator(), seed=1)
    with pytest.raises(ValueError, match="batch shape"):
        transform.draw(given, seed=torch.tensor([1, 2, 3]))
    with pytest.raises(TypeError, match="integer"):
        transform.draw(given, seed=1.5)  # type: ignore[arg-type]


@pytest.mark.parametrize("shape", [(3,), (2, 1), (0,)], ids=str)
def test_a_knob_of_another_shape_is_refused(shape: tuple[int, ...]) -> None:
    with pytest.raises(ValueError, match=r"rate_mm_per_h must be one value or one for each sample.*\(2,\)"):
        rain(torch.full(shape, 10.0))(detections(2))


# ---- numpy and CUDA ---------------------------------------------------------------------------------------------


@every_transform
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_numpy_in_numpy_out(make: Maker, dtype: Any) -> None:
    transform, given = make(), detections().numpy().astype(dtype)
    copied = given.copy()
    got = transform.on_numpy(given, seed=3)
    assert got.dtype == dtype
    assert np.array_equal(given, copied)
    tensor = torch.from_numpy(given)
    assert np.array_equal(got, transform(tensor, transform.draw(tensor, seed=3)).numpy())


def test_numpy_arrays_of_any_layout_and_read_only_ones_are_taken() -> None:
    transform, given = rain_seen(), detections().numpy()
    wanted = transform.on_numpy(given, seed=3)
    read_only = np.frombuffer(given.tobytes(), dtype=np.float32).reshape(-1, 7)
    assert np.array_equal(transform.on_numpy(read_only, seed=3), wanted)
    assert np.array_equal(transform.on_numpy(np.asfortranarray(given), seed=3), wanted)
    assert np.array_equal(transform.on_numpy(given[::-1][::-1], seed=3), wanted)
    with pytest.raises(TypeError, match="floating point"):
        transform.on_numpy(given.astype(np.int32))


@pytest.mark.gpu
@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a CUDA device")
@every_transform
def test_the_device_follows_the_input(make: Maker) -> None:
    transform, given = make(), detections(2)
    noise = transform.draw(given, seed=1)
    wanted: Any = transform.run(given, noise)
    got: Any = copy.deepcopy(transform).to("cuda").run(given.to("cuda"), noise)
    assert all(value.device.type == "cuda" for value in parts(got).values())
    # Another exp and log: a row at the edge of a decision may fall on the other side.
    same = got.kind.cpu() == wanted.kind
    assert float(same.float().mean()) > 0.99
    assert float((got.points.cpu() - wanted.points).abs()[same].max()) < 5e-3
