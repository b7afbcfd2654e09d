"""What RadarMapWeather promises: identity, formats, batches, seeds, one weather with other sensors, bad input."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

import torchweather as tw
from torchweather import Fog, Lidar, Mixture, Radar, Rain, Snow
from torchweather.radar.map_transform import RadarMapWeather
from torchweather.radar.power_map import MapAxes, PowerScale, RadarPowerMap
from torchweather.stages import Chain

SENSOR = Radar.preset("awr1843-like")
CALM = Mixture(Rain(0.0), Snow(0.0), Fog(math.inf))
SPEEDS = tuple(-2.0 + 0.5 * k for k in range(8))
ANGLES = tuple(math.radians(a) for a in range(-40, 41, 20))
RANGES = tuple(0.5 + 1.0 * k for k in range(30))
UP = (-0.1, 0.0, 0.1)
TURN = MapAxes.of_turn(bins=30, bin_m=1.0, azimuths=40)
TENSOR4 = MapAxes(("doppler", "range", "elevation", "azimuth"), RANGES, ANGLES, UP, SPEEDS)
AXES = {
    "turn": TURN,
    "range-azimuth": MapAxes(("range", "azimuth"), RANGES, ANGLES),
    "range-doppler": MapAxes(("range", "doppler"), RANGES, None, None, SPEEDS),
    "range-azimuth-doppler": MapAxes(("range", "azimuth", "doppler"), RANGES, ANGLES, None, SPEEDS),
    "doppler-range-elevation-azimuth": TENSOR4,
    "range": MapAxes(("range",), RANGES),
}
SCALES = ("linear", "amplitude", "complex", "db", "db_steps")


def values_of(axes: MapAxes, kind: str, batch: tuple[int, ...] = (), seed: int = 0) -> Tensor:
    generator = torch.Generator().manual_seed(seed)
    normal = torch.randn(*batch, *axes.shape, 2, generator=generator)
    field = torch.view_as_complex(normal)
    if kind == "complex":
        return field
    power = field.abs().square()
    if kind == "db_steps":
        return torch.randint(0, 256, (*batch, *axes.shape), generator=generator, dtype=torch.uint8)
    return {"linear": power, "amplitude": power.sqrt(), "db": 10.0 * power.log10()}[kind]


def scale_of(kind: str) -> PowerScale:
    return PowerScale.steps(0.5) if kind == "db_steps" else PowerScale(kind)


def built(weather: Any, axes: MapAxes = TURN, kind: str = "linear", **more: Any) -> RadarMapWeather:
    options = {"noise_floor_db": 10.0 if kind == "db_steps" else 3.0, **more}
    return RadarMapWeather(weather, SENSOR, axes=axes, scale=scale_of(kind), **options)


def same_bits(one: Tensor, other: Tensor) -> bool:
    first, second = (torch.view_as_real(v) if v.is_complex() else v for v in (one, other))
    return one.dtype == other.dtype and first.contiguous().numpy().tobytes() == second.contiguous().numpy().tobytes()


@pytest.mark.parametrize("kind", SCALES)
@pytest.mark.parametrize("name", AXES)
def test_without_weather_the_bits_come_back(name: str, kind: str) -> None:
    values = values_of(AXES[name], kind)
    transform = built(CALM, AXES[name], kind, radome_film_db=2.0)
    assert same_bits(transform(values, transform.draw(values, seed=1)), values)


@pytest.mark.parametrize("kind", SCALES)
@pytest.mark.parametrize("name", AXES)
def test_rain_keeps_the_format_and_changes_the_map(name: str, kind: str) -> None:
    values = values_of(AXES[name], kind)
    transform = built(Rain(30.0), AXES[name], kind)
    out = transform(values, transform.draw(values, seed=1))
    assert (out.dtype, out.shape) == (values.dtype, values.shape)
    assert float((out != values).float().mean()) > 0.5
    assert torch.isfinite(torch.view_as_real(out) if out.is_complex() else out).all()


@pytest.mark.parametrize("dtype", [torch.float64, torch.float16, torch.int16])
def test_other_dtypes_come_back(dtype: torch.dtype) -> None:
    values = (100.0 * values_of(TURN, "linear")).to(dtype)
    for weather in (CALM, Rain(30.0)):
        transform = built(weather)
        out = transform(values, transform.draw(values, seed=1))
        assert out.dtype == dtype
        assert torch.equal(out, values) == (weather is CALM)


@pytest.mark.parametrize("kind", SCALES)
def test_a_batch_is_its_samples_one_by_one(kind: str) -> None:
    values = values_of(TENSOR4, kind, (2, 3))
    transform = built(Mixture(Rain(30.0), Snow(2.0, melt_fraction=0.3)), TENSOR4, kind)
    seeds = torch.arange(6).reshape(2, 3) + 40
    together = transform(values, transform.draw(values, seed=seeds))
    for place in np.ndindex(2, 3):
        alone = values[place]
        assert same_bits(transform(alone, transform.draw(alone, seed=int(seeds[place]))), together[place])


def test_each_sample_may_have_its_own_rate_and_its_own_floor() -> None:
    values = values_of(TURN, "linear", (2,)) * torch.tensor([1.0, 100.0])[:, None, None]
    transform = built(Rain(torch.tensor([0.0, 50.0])), noise_floor_db=None)
    result = transform.run(values, transform.draw(values, seed=3))
    assert torch.equal(result.values[0], values[0])
    assert not torch.equal(result.values[1], values[1])
    assert float(result.noise_floor_db[1] - result.noise_floor_db[0]) == pytest.approx(20.0, abs=2.0)


def test_the_same_seed_gives_the_same_map_and_another_another() -> None:
    values, transform = values_of(TURN, "linear"), built(Rain(30.0))
    one, again, other = (transform(values, transform.draw(values, seed=s)) for s in (5, 5, 6))
    assert torch.equal(one, again)
    assert not torch.equal(one, other)


def test_gradients_reach_the_rate_also_where_there_is_none() -> None:
    values = values_of(TURN, "linear")
    values[0] = 0.0
    for rate in (0.0, 20.0):
        intensity = torch.tensor(rate, requires_grad=True)
        transform = built(Rain(intensity))
        transform(values, transform.draw(values, seed=1)).sum().backward()
        assert intensity.grad is not None
        assert torch.isfinite(intensity.grad)


def test_banks_of_rain_are_denser_in_some_directions() -> None:
    weather = Rain(30.0, patch_log_std=0.7, patch_length_m=20.0)
    values = torch.zeros(TURN.shape)
    result = built(weather).run(values, built(weather).draw(values, seed=1))
    even = built(Rain(30.0)).run(values)
    far = result.attenuation_db[:, -1]
    assert float(far.std() / far.mean()) > 0.05
    assert float((even.attenuation_db[..., -1]).std()) == pytest.approx(0.0, abs=1e-6)
    spread = (result.clutter_db - even.clutter_db)[:, 5:]
    assert float(spread.std()) > 1.0


def test_a_saved_chain_gives_the_same_map(tmp_path: Any) -> None:
    values, transform = values_of(TURN, "linear"), built(Mixture(Rain(30.0), Fog(50.0)), radome_loss_db=1.0)
    again = Chain.from_dict(transform.chain.to_dict())
    assert again.to_dict() == transform.chain.to_dict()
    noise = transform.draw(values, seed=1)
    out = transform(values, noise)
    transform.chain = again
    assert torch.equal(transform(values, noise), out)


def test_one_weather_with_camera_and_lidar_of_the_same_drive() -> None:
    sensor = Lidar.preset("velodyne-hdl-64e")
    camera = tw.Camera.preset("lucid-triton", width=64, height=48)
    compose = tw.Compose(
        {
            "image": tw.AsBayer(tw.BayerRain(Rain(1.0), camera, airlight=0.6)),
            "points": tw.LidarRain(Rain(1.0), sensor),
            "radar": built(Rain(1.0), kind="db_steps"),
        },
        weather=[Rain(rate_mm_per_h=(20.0, 50.0)), None],
        history="weather",
    )
    sample = {
        "image": torch.rand(3, 48, 64),
        "points": torch.tensor([[20.0, 1.0, 0.0, 120.0], [40.0, -3.0, 0.5, 30.0]]),
        "radar": values_of(TURN, "db_steps"),
        "depth": torch.full((1, 48, 64), 30.0),
    }
    rainy, clear = 0, 0
    for seed in range(12):
        out, results = compose.run(sample, seed=seed)
        assert set(out) == {*sample, "weather"}
        if out["weather"]["weather"] is None:
            clear += 1
            assert all(out[key] is sample[key] or torch.equal(out[key], sample[key]) for key in sample)
            continue
        rainy += 1
        rate = out["weather"]["weather"]["rate_mm_per_h"]
        alone = built(Rain(rate), kind="db_steps").run(sample["radar"])
        assert torch.equal(results["radar"].attenuation_db, alone.attenuation_db)
        assert not torch.equal(out["radar"], sample["radar"])
    assert rainy
    assert clear
    batch = {key: torch.stack([value, value]) for key, value in sample.items()}
    both = compose(batch, seed=1)
    assert both["radar"].shape == (2, *TURN.shape)
    assert torch.equal(both["radar"][0], compose(sample, seed=1)["radar"])
    numbers = compose({**sample, "radar": sample["radar"].numpy()}, seed=1)["radar"]
    assert isinstance(numbers, np.ndarray)


def test_a_map_of_more_dimensions_in_a_compose_is_one_sample() -> None:
    compose = tw.Compose({"radar": built(Rain(30.0), TENSOR4)})
    one = {"radar": values_of(TENSOR4, "linear")}
    batch = {"radar": torch.stack([one["radar"]] * 2)}
    alone, both = compose(one, seed=3)["radar"], compose(batch, seed=3)["radar"]
    assert alone.shape == TENSOR4.shape
    assert torch.equal(both[0], alone)
    assert not torch.equal(both[1], alone)
    with pytest.raises(ValueError, match="'radar' must have shape of 4 sizes, or one dimension more"):
        compose({"radar": one["radar"][0]})


def test_a_recorded_map_goes_through_whole() -> None:
    power_map = RadarPowerMap(values_of(TURN, "db_steps"), TURN, PowerScale.steps(0.5), notes=("a note",))
    wet = built(Rain(30.0), kind="db_steps").of_map(power_map, seed=1)
    assert wet.notes == ("a note",)
    assert not torch.equal(wet.values, power_map.values)
    with pytest.raises(ValueError, match=r"other axes or another scale.*axes=power_map.axes"):
        built(Rain(30.0)).of_map(power_map)


@pytest.mark.parametrize(
    ("values", "kind", "said"),
    [
        (np.zeros(TURN.shape), "linear", "must be a tensor; got ndarray"),
        (torch.zeros(30, 40), "linear", r"shape \(..., azimuth 40, range 30\); got \(30, 40\)"),
        (torch.full(TURN.shape, -1.0), "linear", "0 or more; got -1. A map in dB has kind='db'"),
        (torch.full(TURN.shape, math.nan), "db", "NaN or infinity in 1200 cells"),
        (torch.zeros(TURN.shape), "db_steps", "bytes .uint8.; got torch.float32"),
        (torch.zeros(TURN.shape, dtype=torch.complex64), "linear", "does not fit numbers of torch.complex64"),
    ],
)
def test_bad_maps_are_refused(values: Any, kind: str, said: str) -> None:
    with pytest.raises((ValueError, TypeError), match=said):
        built(Rain(1.0), kind=kind)(values)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"looks": 2.5}, "looks must be a whole number"),
        ({"looks": 0}, "looks"),
        ({"oversampling": 0.5}, "oversampling"),
        ({"noise_floor_db": [1.0, 2.0]}, "one for each of 30 range bins; got 2"),
        ({"effects": [{"effect": "radar.multipath"}]}, "radar.wet_radome, radar.path_loss_scale, radar.noise_floor"),
        ({"axes": None}, "axes must be MapAxes"),
        ({"scale": "db"}, "scale must be PowerScale"),
    ],
)
def test_bad_options_are_refused(options: dict[str, Any], said: str) -> None:
    given: dict[str, Any] = {"axes": TURN, "scale": PowerScale("linear"), **options}
    with pytest.raises((ValueError, TypeError), match=said):
        RadarMapWeather(Rain(1.0), SENSOR, **given)
