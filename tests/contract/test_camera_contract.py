"""What every camera transform promises, over all of them: formats, batches, replay, identity, bad input."""

from __future__ import annotations

import copy
import io
import math
import pickle
from collections.abc import Callable
from typing import Any

import pytest
import torch
from torch import Tensor

from torchweather.atmosphere.weather import Fog, Mixture, Rain, Snow, Weather
from torchweather.core.errors import TorchweatherWarning
from torchweather.sensors import BAYER_PATTERNS, Camera
from torchweather.transforms import BayerFog, BayerRain, BayerSnow, BayerWeather

H, W = 24, 32
CAMERA = Camera.from_intrinsics(300.0, 300.0, 15.5, 11.5, W, H)
TILTED = Camera.from_intrinsics(300.0, 290.0, 15.0, 11.0, W, H, roll_rad=0.2, pitch_rad=0.1, k1=-0.1, p1=1e-3)
LIGHT = (0.5, 0.6, 0.7)
Maker = Callable[..., BayerWeather]


def rain(knob: Any = 30.0, camera: Camera = CAMERA, **more: Any) -> BayerWeather:
    return BayerRain(Rain(knob), camera, **{"depth": 25.0, "airlight": LIGHT, "far_m": 40.0, **more})


def snow(knob: Any = 2.0, camera: Camera = CAMERA, **more: Any) -> BayerWeather:
    return BayerSnow(Snow(knob), camera, **{"depth": 25.0, "airlight": LIGHT, "far_m": 40.0, **more})


def fog(knob: Any = 60.0, camera: Camera = CAMERA, **more: Any) -> BayerWeather:
    return BayerFog(Fog(knob), camera, **{"depth": 25.0, "airlight": LIGHT, **more})


def mixture(knob: Any = 60.0, camera: Camera = CAMERA, **more: Any) -> BayerWeather:
    weather = Mixture(Snow(1.0), Fog(knob, patch_log_std=0.5), Rain(10.0, patch_log_std=0.3, patch_length_m=30.0))
    return BayerWeather(weather, camera, **{"depth": 25.0, "airlight": LIGHT, "far_m": 40.0, **more})


ALL: list[Maker] = [rain, snow, fog, mixture]
every_transform = pytest.mark.parametrize("make", ALL, ids=["rain", "snow", "fog", "mixture"])
IDENTITIES: dict[str, Weather] = {
    "rain": Rain(0.0),
    "snow": Snow(0.0),
    "fog": Fog(math.inf),
    "mixture": Mixture(Rain(0.0), Snow(0.0), Fog(math.inf)),
}


def frame(*batch: int, dtype: torch.dtype = torch.float32, seed: int = 0) -> Tensor:
    values = torch.rand((*batch, 1, H, W), generator=torch.Generator().manual_seed(seed), dtype=torch.float64) * 0.6
    if dtype == torch.uint8:
        return (values * 255).to(dtype)
    if dtype == torch.uint16:
        return (values * 4095).to(torch.int32).to(dtype)
    return values.to(dtype)


def same(one: Tensor, other: Tensor) -> bool:
    """Bit for bit; uint16 knows no ``torch.equal`` on every build."""
    return one.dtype == other.dtype and torch.equal(one.to(torch.float64), other.to(torch.float64))


DTYPES = [torch.uint8, torch.uint16, torch.float16, torch.float32]


@every_transform
@pytest.mark.parametrize("dtype", DTYPES, ids=str)
@pytest.mark.parametrize("batch", [(), (2,), (2, 3)], ids=str)
def test_the_output_has_the_format_of_the_input(make: Maker, dtype: torch.dtype, batch: tuple[int, ...]) -> None:
    transform, given = make(), frame(*batch, dtype=dtype)
    got = transform(given)
    assert got.dtype == dtype
    assert got.shape == given.shape
    assert not same(got, given)


@every_transform
@pytest.mark.parametrize("dtype", DTYPES, ids=str)
def test_every_dtype_sees_the_same_weather(make: Maker, dtype: torch.dtype) -> None:
    transform, exact = make(), frame()
    noise = transform.draw(exact, seed=1)
    wanted = transform(exact, noise=noise)
    got = transform(frame(dtype=dtype), noise=noise).to(torch.float64)
    scale = {torch.uint8: 255.0, torch.uint16: 4095.0}.get(dtype, 1.0)
    # Truncating the input and rounding the output cost a step and a half; half has 11 bits.
    step = {torch.uint8: 1 / 255, torch.uint16: 1 / 4095, torch.float16: 2**-11}.get(dtype, 1e-6)
    assert float((got / scale - wanted).abs().max()) < 2 * step


@every_transform
def test_run_gives_the_frame_and_what_the_weather_did(make: Maker) -> None:
    transform, given = make(), frame(2, 3)
    noise = transform.draw(given, seed=1)
    result = transform.run(given, noise=noise)
    assert torch.equal(result.bayer, transform(given, noise=noise))
    assert result.transmission.shape == result.particle_mask.shape == given.shape
    assert result.airlight.shape == (2, 3, 3)
    assert torch.allclose(result.airlight, torch.tensor(LIGHT).expand(2, 3, 3))
    for share in (result.transmission, result.particle_mask):
        assert float(share.min()) >= 0.0
        assert float(share.max()) <= 1.0
    assert bool((result.particle_mask > 0).any()) == (make is not fog)
    assert bool((result.transmission < 1).any()) == (make in (fog, mixture))


@every_transform
@pytest.mark.parametrize("camera", [CAMERA, TILTED], ids=["straight", "tilted lens"])
def test_a_batch_equals_its_elements_bit_for_bit(make: Maker, camera: Camera) -> None:
    transform, given = make(camera=camera), frame(2, 3)
    together = transform(given, noise=transform.draw(given, seed=10))
    for row in range(6):
        element = given[row // 3, row % 3]
        noise = transform.draw(element, seed=10 + row)
        assert torch.equal(together[row // 3, row % 3], transform(element, noise=noise))


@every_transform
def test_a_draw_can_be_replayed_and_sliced(make: Maker) -> None:
    transform, given = make(), frame(3)
    noise = transform.draw(given, generator=torch.Generator().manual_seed(3))
    first = transform(given, noise=noise)
    assert torch.equal(first, transform(given, noise=noise))
    part = {key: value[1:] for key, value in noise.items()}
    assert torch.equal(first[1:], transform(given[1:], noise=part))
    assert all(value.shape[0] == 3 and value.device.type == "cpu" for value in noise.values())


@pytest.mark.parametrize("make", [rain, snow, mixture])
def test_every_call_and_every_sample_has_its_own_draw(make: Maker) -> None:
    transform, given = make(), frame().expand(2, 1, H, W)
    first, second = transform(given), transform(given)
    assert not torch.equal(first, second)
    assert not torch.equal(first[0], first[1])


@every_transform
def test_the_generator_decides_and_the_global_one_is_left_alone(make: Maker) -> None:
    transform, given = make(), frame(2, 3)
    before = torch.get_rng_state()
    taken, counted = torch.Generator().manual_seed(5), torch.Generator().manual_seed(5)
    noise = transform.draw(given, generator=taken)
    transform(given, noise=noise)
    transform.run(given, noise=noise)
    assert torch.equal(torch.get_rng_state(), before)
    torch.randint(0, 2**63 - 1, (6,), generator=counted)
    assert torch.equal(taken.get_state(), counted.get_state())


@every_transform
def test_the_global_seed_decides_an_everyday_call(make: Maker) -> None:
    transform, given = make(), frame(2)
    torch.manual_seed(9)
    first = transform(given)
    torch.manual_seed(9)
    assert torch.equal(transform(given), first)


@every_transform
def test_drawing_looks_at_shapes_only(make: Maker) -> None:
    one, other = make().draw(frame(2), seed=4), make().draw(torch.zeros(2, 1, H, W, dtype=torch.uint8), seed=4)
    assert all(torch.equal(one[key], other[key]) for key in one)
    dark = make().draw(frame(2), torch.full((1, H, W), 3.0), seed=torch.tensor([4, 5]))
    assert all(torch.equal(one[key], dark[key]) for key in one)


@every_transform
@pytest.mark.parametrize("dtype", [torch.float32, torch.uint16], ids=str)
def test_inputs_are_never_changed(make: Maker, dtype: torch.dtype) -> None:
    transform, given, depth = make(), frame(2, dtype=dtype), torch.full((1, H, W), 20.0)
    depth[:, :4] = math.inf
    noise = transform.draw(given, seed=1)
    copies = given.clone(), depth.clone(), {key: value.clone() for key, value in noise.items()}
    transform(given, depth, noise)
    transform.run(given, depth, noise)
    assert same(given, copies[0])
    assert torch.equal(depth, copies[1])
    assert all(torch.equal(noise[key], copies[2][key]) for key in noise)


@every_transform
def test_pickle_deepcopy_and_state_dict_give_the_same_bits(make: Maker) -> None:
    transform, given = make(), frame(2)
    noise = transform.draw(given, seed=1)
    wanted = transform(given, noise=noise)
    buffer = io.BytesIO()
    torch.save(transform.state_dict(), buffer)
    buffer.seek(0)
    restored = make()
    restored.load_state_dict(torch.load(buffer, weights_only=True))
    for again in (pickle.loads(pickle.dumps(transform)), copy.deepcopy(transform), restored):
        assert torch.equal(again(given, noise=noise), wanted)
        assert all(torch.equal(value, noise[key]) for key, value in again.draw(given, seed=1).items())


@every_transform
def test_parameters_are_buffers_so_that_no_optimiser_moves_the_weather(make: Maker) -> None:
    assert not list(make().parameters())


@every_transform
def test_zero_size_batches_come_back_empty(make: Maker) -> None:
    transform = make()
    for batch in ((0,), (2, 0)):
        given = frame(*batch)
        assert transform(given).shape == given.shape
        result = transform.run(given, torch.full(given.shape, 20.0))
        assert result.particle_mask.shape == result.transmission.shape == given.shape
        assert result.airlight.shape == (*batch, 3)


@every_transform
def test_the_smallest_mosaic_is_one_cell(make: Maker) -> None:
    cell = Camera.from_intrinsics(300.0, 300.0, 0.5, 0.5, 2, 2)
    transform = make(camera=cell)
    given = torch.full((1, 2, 2), 0.2)
    assert transform(given).shape == (1, 2, 2)
    with pytest.warns(TorchweatherWarning, match="no sky"):
        make(camera=cell, airlight=None)(given)


@every_transform
@pytest.mark.parametrize("pattern", BAYER_PATTERNS)
def test_every_pattern_is_taken(make: Maker, pattern: str) -> None:
    camera = Camera.from_intrinsics(300.0, 300.0, 15.5, 11.5, W, H, bayer_pattern=pattern)
    assert make(camera=camera)(frame()).shape == (1, H, W)


@every_transform
def test_unknown_keywords_are_refused(make: Maker) -> None:
    with pytest.raises(TypeError, match="unexpected keyword"):
        make(intensity=3.0)
    transform = make()
    with pytest.raises(TypeError, match="unexpected keyword"):
        transform(frame(), intensity=3.0)
    with pytest.raises(TypeError, match="unexpected keyword"):
        transform.draw(frame(), sead=3)


@pytest.mark.parametrize("weather", IDENTITIES.values(), ids=IDENTITIES.keys())
@pytest.mark.parametrize("dtype", DTYPES, ids=str)
@pytest.mark.parametrize("depth_m", [7.0, math.inf])
@pytest.mark.parametrize("companding", [False, True])
def test_no_weather_gives_the_input_back_bit_for_bit(
    weather: Weather, dtype: torch.dtype, depth_m: float, companding: bool
) -> None:
    knots = ((0.0, 0.0), (0.25, 0.5), (1.0, 1.0)) if companding else None
    camera = Camera.from_intrinsics(
        300.0, 300.0, 15.5, 11.5, W, H, black_level=64.0, white_level=4000.0, response_knots=knots
    )
    given = frame(2, dtype=dtype)
    transform = BayerWeather(weather, camera, depth=depth_m, airlight=0.7)
    assert same(transform(given), given)
    result = transform.run(given)
    assert same(result.bayer, given)
    assert bool((result.particle_mask == 0).all())
    assert bool((result.transmission == 1).all())


def test_samples_without_weather_stay_as_they_are_beside_rainy_ones() -> None:
    given = frame(2)
    got = rain(torch.tensor([0.0, 30.0]))(given)
    assert torch.equal(got[0], given[0])
    assert not torch.equal(got[1], given[1])
    got = fog(torch.tensor([math.inf, 30.0]), depth=math.inf)(given)
    assert torch.equal(got[0], given[0])


@pytest.mark.parametrize("weather", [Rain(30.0), Snow(2.0), Fog(60.0)], ids=["rain", "snow", "fog"])
def test_a_mixture_of_one_is_that_one_bitwise(weather: Weather) -> None:
    given = frame(2)
    alone = BayerWeather(weather, CAMERA, depth=25.0, airlight=LIGHT)
    mixed = BayerWeather(Mixture(weather), CAMERA, depth=25.0, airlight=LIGHT)
    named = {"rain": BayerRain, "snow": BayerSnow, "fog": BayerFog}[weather.kind](
        weather, CAMERA, depth=25.0, airlight=LIGHT
    )
    noise = alone.draw(given, seed=1)
    wanted = alone(given, noise=noise)
    for same_weather in (mixed, named):
        assert torch.equal(same_weather(given, noise=noise), wanted)
        assert all(torch.equal(value, noise[key]) for key, value in same_weather.draw(given, seed=1).items())


def test_the_order_of_a_mixture_does_not_matter() -> None:
    given, parts = frame(2), [Rain(30.0), Snow(2.0), Fog(60.0)]
    first = BayerWeather(Mixture(*parts), CAMERA, depth=25.0, airlight=LIGHT)
    other = BayerWeather(Mixture(*reversed(parts)), CAMERA, depth=25.0, airlight=LIGHT)
    noise = first.draw(given, seed=1)
    assert torch.equal(first(given, noise=noise), other(given, noise=other.draw(given, seed=1)))


@pytest.mark.parametrize(
    ("make", "knobs"), [(rain, (1.0, 7.0, 60.0)), (snow, (0.1, 1.0, 5.0)), (fog, (20.0, 90.0, 900.0))]
)
def test_a_knob_for_each_sample_equals_separate_calls(make: Maker, knobs: tuple[float, ...]) -> None:
    given = frame(3)
    together_transform = make(torch.tensor(knobs))
    together = together_transform(given, noise=together_transform.draw(given, seed=1))
    for row, knob in enumerate(knobs):
        alone = make(knob)
        noise = alone.draw(given[row], seed=1 + row)
        assert torch.equal(together[row], alone(given[row], noise=noise))


@pytest.mark.parametrize(
    ("make", "knob", "sign"), [(rain, 20.0, 1), (snow, 1.0, 1), (fog, 50.0, -1), (mixture, 50.0, -1)]
)
def test_gradient_with_respect_to_the_knob(make: Maker, knob: float, sign: int) -> None:
    """Over a dark scene under a bright sky more weather is brighter."""
    value = torch.full((2,), knob, requires_grad=True)
    transform, given = make(value), 0.1 * frame(2)
    transform(given, noise=transform.draw(given, seed=1)).mean().backward()
    assert value.grad is not None
    assert bool(torch.isfinite(value.grad).all())
    assert bool((value.grad * sign > 0).all())


def test_gradient_with_respect_to_the_image() -> None:
    given = frame(1).requires_grad_()
    transform = mixture()
    result = transform.run(given, noise=transform.draw(given, seed=1))
    result.bayer.sum().backward()
    assert given.grad is not None
    assert bool(torch.isfinite(given.grad).all())
    assert bool((given.grad > 0).all())


@pytest.mark.gpu
@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a CUDA device")
@every_transform
def test_the_device_follows_the_input(make: Maker) -> None:
    transform, given = make(), frame(2)
    noise = transform.draw(given, seed=1)
    wanted = transform(given, noise=noise)
    got = copy.deepcopy(transform).to("cuda")(given.to("cuda"), noise=noise)
    assert got.device.type == "cuda"
    # Atomic additions in another order and other exp and log.
    assert torch.allclose(got.cpu(), wanted, atol=2e-5)
