"""What RadarMapWeather promises: identity, formats, batches, seeds, one weather with other sensors, bad input."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
import torch

import torchweather as tw
from tests.contract.table import ANGLES, RANGES, SPEEDS, TENSOR4, TURN, power_map, same_bits
from tests.contract.table import map_weather as built
from torchweather import Fog, Lidar, Mixture, Radar, Rain, Snow
from torchweather.radar.map_transform import RadarMapWeather
from torchweather.radar.power_map import MapAxes, PowerScale, RadarPowerMap

CALM = Mixture(Rain(0.0), Snow(0.0), Fog(math.inf))
AXES = {
    "turn": TURN,
    "range-azimuth": MapAxes(("range", "azimuth"), RANGES, ANGLES),
    "range-doppler": MapAxes(("range", "doppler"), RANGES, None, None, SPEEDS),
    "range-azimuth-doppler": MapAxes(("range", "azimuth", "doppler"), RANGES, ANGLES, None, SPEEDS),
    "doppler-range-elevation-azimuth": TENSOR4,
    "range": MapAxes(("range",), RANGES),
}
SCALES = ("linear", "amplitude", "complex", "db", "db_steps")


@pytest.mark.parametrize("kind", SCALES)
@pytest.mark.parametrize("name", AXES)
def test_without_weather_the_bits_come_back(name: str, kind: str) -> None:
    values = power_map(axes=AXES[name], kind=kind)
    transform = built(CALM, AXES[name], kind, radome_film_db=2.0)
    assert same_bits(transform(values, transform.draw(values, seed=1)), values)


@pytest.mark.parametrize("kind", SCALES)
@pytest.mark.parametrize("name", AXES)
def test_rain_keeps_the_format_and_changes_the_map(name: str, kind: str) -> None:
    values = power_map(axes=AXES[name], kind=kind)
    transform = built(Rain(30.0), AXES[name], kind)
    out = transform(values, transform.draw(values, seed=1))
    assert (out.dtype, out.shape) == (values.dtype, values.shape)
    assert float((out != values).float().mean()) > 0.5
    assert torch.isfinite(torch.view_as_real(out) if out.is_complex() else out).all()


@pytest.mark.parametrize("dtype", [torch.float64, torch.float16, torch.int16])
def test_other_dtypes_come_back(dtype: torch.dtype) -> None:
    values = (100.0 * power_map(axes=TURN, kind="linear")).to(dtype)
    for weather in (CALM, Rain(30.0)):
        transform = built(weather)
        out = transform(values, transform.draw(values, seed=1))
        assert out.dtype == dtype
        assert torch.equal(out, values) == (weather is CALM)


def test_each_sample_may_have_its_own_rate_and_its_own_floor() -> None:
    values = power_map(2, axes=TURN, kind="linear") * torch.tensor([1.0, 100.0])[:, None, None]
    transform = built(Rain(torch.tensor([0.0, 50.0])), noise_floor_db=None)
    result = transform.run(values, transform.draw(values, seed=3))
    assert torch.equal(result.values[0], values[0])
    assert not torch.equal(result.values[1], values[1])
    assert float(result.noise_floor_db[1] - result.noise_floor_db[0]) == pytest.approx(20.0, abs=2.0)


def test_gradients_reach_the_rate_also_where_there_is_none() -> None:
    values = power_map(axes=TURN, kind="linear")
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
        "radar": power_map(axes=TURN, kind="db_steps"),
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
    one = {"radar": power_map(axes=TENSOR4, kind="linear")}
    batch = {"radar": torch.stack([one["radar"]] * 2)}
    alone, both = compose(one, seed=3)["radar"], compose(batch, seed=3)["radar"]
    assert alone.shape == TENSOR4.shape
    assert torch.equal(both[0], alone)
    assert not torch.equal(both[1], alone)
    with pytest.raises(ValueError, match=r"'radar' must have shape .*, or one dimension more"):
        compose({"radar": one["radar"][0]})


def test_a_recorded_map_goes_through_whole() -> None:
    recorded = RadarPowerMap(power_map(axes=TURN, kind="db_steps"), TURN, PowerScale.steps(0.5), notes=("a note",))
    wet = built(Rain(30.0), kind="db_steps").of_map(recorded, seed=1)
    assert wet.notes == ("a note",)
    assert not torch.equal(wet.values, recorded.values)
    with pytest.raises(ValueError, match=r"other axes or another scale.*axes=power_map.axes"):
        built(Rain(30.0)).of_map(recorded)


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
        RadarMapWeather(Rain(1.0), Radar.preset("awr1843-like"), **given)
