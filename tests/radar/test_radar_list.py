"""Lists of detections in weather: columns, lost rows, rows of the weather's own, and rows without detection."""

from __future__ import annotations

import copy
import itertools
import math
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
import torch
from torch import Tensor

from tests.contract.table import CLUTTER, HALVES, detections, same_bits, same_result, tensors_of
from tests.contract.table import CLUTTER_ROWS as K
from tests.contract.table import NO_DETECTION as EMPTY
from tests.contract.table import RADAR as SENSOR
from tests.contract.table import ROWS as N
from torchweather.atmosphere.weather import Fog, Mixture, Rain, Snow
from torchweather.stages import Chain, PointKind
from torchweather.transforms import RadarAttenuation

OBJECT, PARTICLE, LOST = (int(kind) for kind in (PointKind.OBJECT, PointKind.PARTICLE, PointKind.LOST))
Maker = Callable[..., RadarAttenuation]


def rain(intensity: Any = 60.0, **more: Any) -> RadarAttenuation:
    return RadarAttenuation(Rain(intensity), SENSOR, **more)


def snow(intensity: Any = 5.0, **more: Any) -> RadarAttenuation:
    return RadarAttenuation(Snow(intensity, melt_fraction=0.5), SENSOR, **more)


def fog(intensity: Any = 12.0, **more: Any) -> RadarAttenuation:
    return RadarAttenuation(Fog(intensity), SENSOR, **more)


def mixture(intensity: Any = 30.0, **more: Any) -> RadarAttenuation:
    weather = Mixture(Snow(2.0, melt_fraction=0.3, patch_log_std=0.4), Fog(intensity), Rain(40.0))
    return RadarAttenuation(weather, SENSOR, **{**CLUTTER, **more})


def rain_seen(intensity: Any = 60.0, **more: Any) -> RadarAttenuation:
    return rain(intensity, **{**CLUTTER, **more})


two_ways = pytest.mark.parametrize("make", [rain, mixture], ids=["rain", "mixture seen"])


def rows_of(transform: RadarAttenuation) -> int:
    """Rows that leave for N that come."""
    return N + K * sum(name.endswith("_clutter") for name in transform.chain.stages)


@two_ways
def test_every_kind_of_row_occurs_in_a_small_list(make: Maker) -> None:
    transform, given = make(), detections(2)
    result: Any = transform.run(given)
    assert result.kind.dtype == torch.int8
    assert bool((result.floored_points == 60).all())
    objects = result.kind[..., :N]
    assert bool((objects == LOST)[..., 20:].any())
    assert bool((objects == OBJECT).any())
    assert bool((result.kind[..., N:] == PARTICLE).any()) == (rows_of(transform) > N)
    with pytest.raises(TypeError, match="floating point"):
        transform.on_numpy(given.int().numpy())


@two_ways
def test_columns_and_dtype_are_those_of_the_input_and_further_columns_keep_their_bits(make: Maker) -> None:
    transform = make()
    noise = transform.draw(detections(2), seed=1)
    for dtype, columns in itertools.product(HALVES, (6, 7, 9)):
        given = detections(2, columns=columns, dtype=dtype)
        result: Any = transform.run(given, noise)
        assert result.points.dtype == result.snr_db.dtype == result.attenuation_db.dtype == dtype
        assert result.points.shape == (2, rows_of(transform), columns)
        assert bool(torch.isfinite(result.points).all())
        for column in (3, *range(5, columns)):  # speed, cross section and what follows
            assert same_bits(result.points[:, :N, column], given[..., column])
        assert bool((result.points[:, N:, 6:] == 0).all())


@two_ways
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


@two_ways
def test_one_row_and_none_and_empty_batches(make: Maker) -> None:
    transform = make()
    more = rows_of(transform) - N
    for shape in ((0, 6), (1, 6), (3, 0, 7), (0, 10, 6), (2, 0, 10, 6), (0, 0, 6), (2, 1, 8)):
        given = torch.ones(shape)
        result: Any = transform.run(given)
        assert result.points.shape == (*shape[:-2], shape[-2] + more, shape[-1])
        assert all(value.shape[: len(shape) - 2] == shape[:-2] for value in tensors_of(result).values())
        assert torch.equal(result.points[..., : shape[-2], :3], given[..., :3])


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


@pytest.mark.parametrize(
    "options",
    [
        {"rain_model": "dsd_mie", "fog_model": "d3_4"},
        {"variant": "d3_4"},
        {"radome_loss_db": 1.5, "radome_film_exponent": 0.5, "ego_speed_m_per_s": 12.0},
    ],
)
def test_a_saved_chain_keeps_its_options_and_its_intensities(options: dict[str, Any], tmp_path: Path) -> None:
    weather = Mixture(Rain(torch.tensor([5.0, 0.0])), Fog(torch.tensor([math.inf, 40.0])), Snow(1.0))
    transform, given = RadarAttenuation(weather, SENSOR, **{**CLUTTER, **options}), detections(2)
    transform.chain.save(tmp_path / "weather.chain")
    again = copy.deepcopy(transform)
    again.chain = Chain.load(tmp_path / "weather.chain")
    assert again.chain.to_dict() == transform.chain.to_dict()
    noise = transform.draw(given, seed=1)
    assert same_result(again.run(given, noise), transform.run(given, noise))


def test_a_new_rate_costs_no_set_up() -> None:
    """The intensity is a buffer: the weather of a module is changed in place, and its tables follow."""
    transform, given = rain_seen(), detections()
    noise = transform.draw(given, seed=1)
    before = transform(given, noise)
    intensities = [name for name, _ in transform.named_buffers() if name.endswith("rate_mm_per_h")]
    assert len(intensities) == 3  # of the path, the cover and the clutter
    moved = torch.func.functional_call(transform, {name: torch.tensor(20.0) for name in intensities}, (given, noise))
    assert torch.equal(moved, rain_seen(20.0)(given, noise))
    assert not torch.equal(moved, before)
    assert torch.equal(transform(given, noise), before)


@pytest.mark.parametrize(
    ("make", "intensities", "sign"),
    [(rain, (0.0, 30.0), -1.0), (rain_seen, (0.0, 30.0), -1.0), (snow, (0.0, 2.0), -1.0), (fog, (math.inf, 30.0), 1.0)],
)
def test_the_intensity_has_a_gradient_that_is_finite_in_clear_air_too(
    make: Maker, intensities: tuple[float, float], sign: float
) -> None:
    """More rain lowers every power, more visibility raises it; where nothing falls the slope is 0."""
    intensity = torch.tensor(intensities, requires_grad=True)
    transform, given = make(intensity), detections(2)
    result: Any = transform.run(given, transform.draw(given, seed=1))
    (gradient,) = torch.autograd.grad(result.points[:, :N, 4].sum(), intensity, retain_graph=True)
    assert bool(torch.isfinite(gradient).all())
    assert gradient[0] == 0.0
    assert sign * float(gradient[1]) > 0.0
    range_m = given[1, :, :3].double().norm(dim=-1)
    if make is not rain_seen:  # whose cover takes more, too
        slope = float(torch.autograd.grad(transform.attenuation_db_per_km.sum(), intensity)[0][1])
        # Float32 sums of 300 terms.
        assert float(gradient[1]) == pytest.approx(-2e-3 * slope * float(range_m.sum()), rel=1e-4)


@pytest.mark.parametrize("batch", [(), (2,), (2, 1, 2)], ids=str)
def test_no_weather_changes_no_bit_of_zeros_with_a_sign_and_of_nan(batch: tuple[int, ...]) -> None:
    weather = Mixture(Rain(0.0), Snow(0.0, melt_fraction=0.5), Fog(math.inf))
    for dtype, lost in itertools.product(HALVES, ("zero", "nan")):
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


def test_a_row_at_the_origin_is_no_detection_whatever_else_it_holds() -> None:
    given = torch.tensor([[-0.0, 0.0, -0.0, 5.0, -60.0, -0.0], [9.0, -0.0, 0.0, -0.0, -60.0, 1.0]])
    result: Any = rain(radome_loss_db=3.0).run(given)
    assert same_bits(result.points[0], given[0])
    assert result.kind.tolist() == [LOST, OBJECT]
