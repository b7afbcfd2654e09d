"""Clouds by compiled loops: the numbers of torch, on any number of threads, and torch where they do not reach."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from typing import Any

import pytest
import torch
from torch import Tensor

import torchweather as tw
from torchweather.core import compiled as switch
from torchweather.lidar import compiled
from torchweather.lidar.cloud_frame import holds_return, points_in_cloud_frame

# ln and exp by polynomials, and torch's own rounding in single precision.
OF_INTENSITY = 1e-5  # relative
OF_RANGE_M = 2e-5  # and 1e-6 of the range
BEAMS = 1500
UNITS = ("reflectivity", "reflectivity_percent", "uint8_linear", "uint8_calibrated", "photons", "none")
WEATHERS = {
    "rain": tw.Rain(80.0),
    "snow": tw.Snow(3.0),
    "fog": tw.Fog(mor_m=60.0),
    "all": tw.Mixture(tw.Fog(mor_m=200.0), tw.Rain(30.0), tw.Snow(1.0)),
    "clear": tw.Rain(0.0),
}
MODES = ("strongest", "first", "last", "dual")


@pytest.fixture(autouse=True)
def _compiled(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(switch.SWITCH, "1")


@pytest.fixture
def threads() -> Iterator[Callable[[int], None]]:
    before = torch.get_num_threads()
    yield torch.set_num_threads
    torch.set_num_threads(before)


def sensor_of(**more: Any) -> tw.Lidar:
    given = {"range_resolution_m": 0.0, "range_noise_m": 0.02, "intensity_unit": "reflectivity", **more}
    return tw.Lidar(905.0, divergence_mrad=3.0, near_start_m=0.5, near_full_m=6.0, **given)


def cloud_of(unit: str = "reflectivity", beams: int = BEAMS, whole: bool = False) -> tuple[Tensor, Tensor]:
    """Objects from 0.6 to 90 m, a third of the beams without one, and the beams' directions."""
    random = torch.Generator().manual_seed(4)
    along = torch.nn.functional.normalize(torch.randn(beams, 3, generator=random), dim=-1)
    range_m = 0.6 * 150.0 ** torch.rand(beams, 1, generator=random)
    range_m[::3] = 0.0
    white = {"reflectivity": 1.0, "uint8_linear": 255.0, "photons": 400.0}.get(unit, 100.0)
    intensity = white * torch.rand(beams, 1, generator=random) ** 2
    intensity[5::7] *= 2.0 if unit == "uint8_calibrated" else 1.0
    intensity = torch.where(range_m > 0, intensity.round() if whole else intensity, 0.0)
    return torch.cat([along * range_m, intensity, torch.arange(beams)[:, None].float()], 1), along


def both(monkeypatch: pytest.MonkeyPatch, call: Callable[[], Any]) -> tuple[Any, Any]:
    fast = call()
    with monkeypatch.context() as without:
        without.setenv(switch.SWITCH, "0")
        return fast, call()


def check_alike(fast: Tensor, slow: Tensor, kinds: tuple[Tensor, Tensor], step: float = 0.0) -> None:
    """The same echoes but for one in a thousand that rounding decides, at the same places, as bright."""
    same = kinds[0] == kinds[1]
    assert float((~same).double().mean()) <= 1e-3
    fast, slow = fast[same], slow[same]
    range_m = slow[:, :3].norm(dim=-1)
    apart_m = (fast[:, :3] - slow[:, :3]).norm(dim=-1)
    of_another = apart_m > OF_RANGE_M + 1e-6 * range_m  # a stronger one of two equal echoes, by rounding
    assert float(of_another.double().mean()) <= 1e-3
    brighter = (fast[:, 3] - slow[:, 3]).abs()
    allowed = OF_INTENSITY * slow[:, 3].abs() + 1e-9
    dark = brighter > allowed
    assert float((dark & ~of_another & (brighter > step * 1.001)).double().sum()) == 0
    assert float(dark.double().mean()) <= 2e-3  # steps that rounding decides
    assert torch.equal(fast[:, 4:], slow[:, 4:])


def check_case(weather: str, mode: str, unit: str, monkeypatch: pytest.MonkeyPatch, *, whole: bool = False) -> Any:
    points, along = cloud_of(unit, whole=whole)
    transform = tw.LidarWeather(
        WEATHERS[weather], sensor_of(return_mode=mode, intensity_unit=unit), beam_ends="max_range"
    )
    noise = transform.draw(points, seed=3)
    fast, slow = both(monkeypatch, lambda: transform.run(points, noise, directions=along))
    check_alike(fast.points, slow.points, (fast.kind, slow.kind), 1.0 if whole else 0.0)
    if mode == "dual":
        check_alike(fast.second, slow.second, (fast.second_kind, slow.second_kind), 1.0 if whole else 0.0)
    assert torch.equal(fast.transmission, slow.transmission)
    assert torch.equal(transform(points, noise, directions=along), fast.points)
    return fast, slow


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("weather", WEATHERS)
def test_compiled_clouds_are_those_of_torch(weather: str, mode: str, monkeypatch: pytest.MonkeyPatch) -> None:
    fast, slow = check_case(weather, mode, "reflectivity", monkeypatch)
    points = cloud_of()[0]
    if weather == "clear":
        assert torch.equal(fast.points, points)
        return
    assert int((fast.kind == tw.PointKind.PARTICLE).sum()) > 20
    assert not torch.equal(fast.points, slow.points)  # two paths indeed
    if mode == "dual":
        assert int((fast.second_kind == tw.PointKind.OBJECT).sum()) >= 10


@pytest.mark.parametrize("whole", [False, True], ids=["fractions", "integers"])
@pytest.mark.parametrize("unit", UNITS)
def test_intensities_of_every_unit_are_those_of_torch(unit: str, whole: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    check_case("snow", "first", unit, monkeypatch, whole=whole)


@pytest.mark.parametrize(
    "more", [{"near_power": 2.5}, {"range_noise_m": 0.0}, {"range_resolution_m": 0.004}, {"zero_intensity": 0.02}]
)
def test_sensors_of_every_kind_are_those_of_torch(more: dict[str, Any], monkeypatch: pytest.MonkeyPatch) -> None:
    points, along = cloud_of()
    points[4::11, 3] = 0.0
    transform = tw.LidarSnow(tw.Snow(2.0), sensor_of(return_mode="dual", **more), beam_ends="max_range")
    noise = transform.draw(points, seed=1)
    fast, slow = both(monkeypatch, lambda: transform.run(points, noise, directions=along))
    check_alike(fast.points, slow.points, (fast.kind, slow.kind))
    check_alike(fast.second, slow.second, (fast.second_kind, slow.second_kind))


def test_threads_and_the_other_samples_leave_every_bit(threads: Callable[[int], None]) -> None:
    points, along = cloud_of(beams=40_000)
    rates = torch.tensor([0.5, 0.0, 2.0])
    batch = points.expand(3, *points.shape).clone()
    sensor = sensor_of(return_mode="dual")
    transform = tw.LidarSnow(tw.Snow(rates), sensor, beam_ends="max_range")
    noise = transform.draw(batch, seed=8)
    threads(1)
    one = transform.run(batch, noise, directions=along)
    threads(3)
    again = transform.run(batch, noise, directions=along)
    assert torch.equal(again.points, one.points)
    assert torch.equal(again.second, one.second)
    alone = tw.LidarSnow(tw.Snow(2.0), sensor, beam_ends="max_range")
    assert torch.equal(alone(points, {k: v[2] for k, v in noise.items()}, directions=along), one.points[2])
    assert torch.equal(one.points[1], points)  # no snow, no change


DEAF = {"effect": "lidar.threshold_shift", "shift_db": 2.0}
BANKS = tw.Fog(mor_m=80.0, patch_log_std=0.5)


@pytest.mark.parametrize(
    ("weather", "more", "options", "path"),
    [
        (tw.Rain(20.0), {}, {"variant": "d3_4"}, "torch (variant d3_4)"),
        (BANKS, {}, {}, "torch (air)"),
        (tw.Snow(1.0), {"speed_column": 4}, {}, "torch (radial_speed), echoes by numba"),
        (tw.Rain(20.0), {}, {"effects": [DEAF]}, "torch (threshold_shift), echoes by numba"),
    ],
)
def test_torch_weathers_what_the_compiled_path_does_not_cover(
    weather: Any, more: dict[str, Any], options: dict[str, Any], path: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    points, along = cloud_of()
    transform = tw.LidarWeather(weather, sensor_of(**more), beam_ends="max_range", **options)
    noise = transform.draw(points, seed=1)
    assert compiled.rendered_by(transform.chain) == path
    assert f"weathered by {path}" in repr(transform)
    fast, slow = both(monkeypatch, lambda: transform.run(points, noise, directions=along))
    if "numba" in path:
        check_alike(fast.points, slow.points, (fast.kind, slow.kind))
    else:
        assert torch.equal(fast.points, slow.points)


# What effects do to the air and to the beam: density of each beam, sizes, response, divergence, brightness, threshold.
OF_AIR: dict[str, dict[str, float]] = {
    "lidar.particle_density_azimuth": {"amplitude": 2.0, "wind_amplitude": 0.5},
    "lidar.particle_sizes": {"factor_1mm": 0.6, "factor_4mm": 1.5},
    "lidar.near_response": {"full_m": 8.0, "power": 1.0},
    "lidar.beam_divergence": {"extra_mrad": 1.0},
    "lidar.particle_backscatter": {"gain_db": 3.0},
    "lidar.extinction_scale": {"factor": 1.3},
}


@pytest.mark.parametrize("weather", ["rain", "snow", "fog", "all"])
@pytest.mark.parametrize("effect", OF_AIR)
def test_echoes_in_the_air_of_effects_are_those_of_torch(
    effect: str, weather: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    points, along = cloud_of()
    own = {"effect": effect, **OF_AIR[effect]}
    transform = tw.LidarWeather(WEATHERS[weather], sensor_of(return_mode="first"), beam_ends="max_range", effects=[own])
    noise = transform.draw(points, seed=3)
    fast, slow = both(monkeypatch, lambda: transform.run(points, noise, directions=along))
    check_alike(fast.points, slow.points, (fast.kind, slow.kind))
    assert not torch.equal(fast.points, slow.points)  # two paths indeed


def test_gradients_and_double_precision_are_those_of_torch(monkeypatch: pytest.MonkeyPatch) -> None:
    points, along = cloud_of()
    plain = tw.LidarRain(tw.Rain(20.0), sensor_of(), beam_ends="max_range")
    noise = plain.draw(points, seed=1)
    fast, slow = both(monkeypatch, lambda: plain(points.double(), noise, directions=along.double()))
    assert torch.equal(fast, slow)

    def slope() -> Tensor:
        rate = torch.tensor(10.0, requires_grad=True)
        cloud = tw.LidarRain(tw.Rain(rate), sensor_of(), beam_ends="max_range")(points, noise, directions=along)
        return torch.autograd.grad(cloud[:, 3].sum(), rate)[0]

    fast, slow = both(monkeypatch, slope)
    assert torch.equal(fast, slow)
    assert float(slow) != 0.0


def test_the_switch_and_what_is_installed_choose_the_path(monkeypatch: pytest.MonkeyPatch) -> None:
    transform = tw.LidarRain(tw.Rain(20.0), sensor_of())
    assert "weathered by numba" in repr(transform)
    monkeypatch.setitem(sys.modules, "numba", None)  # importing it fails
    monkeypatch.delitem(sys.modules, "torchweather.lidar.compiled_beams", raising=False)
    monkeypatch.delattr("torchweather.lidar.compiled_beams", raising=False)
    monkeypatch.setenv(switch.SWITCH, "0")
    assert "weathered by torch (TORCHWEATHER_COMPILED=0)" in repr(transform)
    points = cloud_of()[0]
    assert not torch.equal(transform(points, seed=1), points)
    monkeypatch.setenv(switch.SWITCH, "1")
    with pytest.raises(ImportError):
        transform(points, seed=1)


@pytest.mark.parametrize("more", [0, 3], ids=["given", "completed"])
def test_rows_are_raised_to_the_bits_of_torch(more: int, monkeypatch: pytest.MonkeyPatch) -> None:
    given = torch.stack([cloud_of()[0], cloud_of()[0].flip(0)])
    height_m = torch.where(holds_return(given), 0.0362, 0.0)
    local = given.clone()
    local[..., 2] -= height_m
    local, height_m = (torch.nn.functional.pad(one, (0, 0) * (one.ndim == 3) + (0, more)) for one in (local, height_m))
    values = local.clone()
    values[:, 1::2, :3] *= 0.7
    values[:, 4::5, :3] = 0.0
    fast, slow = both(monkeypatch, lambda: points_in_cloud_frame(values, local, given, sensor_of(), height_m))
    assert torch.equal(fast, slow)


@pytest.mark.parametrize("shape", [(0, 4), (2, 0, 4)])
@pytest.mark.parametrize("weather", [tw.Rain(5.0), tw.Mixture(tw.Fog(50.0), tw.WetWindow(rain_mm_per_h=5.0))])
def test_a_cloud_without_points_stays_one(weather: Any, shape: tuple[int, ...]) -> None:
    points = torch.zeros(shape)
    lidar = tw.Lidar.preset("ouster-os1-128")  # whose beams start above the origin: rows are raised
    assert tw.LidarWeather(weather, lidar)(points, seed=1).shape == shape


RANGES = {
    "rain": (tw.Rain(tw.LogUniform(1.0, 50.0)), tw.Rain(7.0)),
    "snow": (tw.Snow(tw.LogUniform(0.2, 3.0), temperature_c=-5.0), tw.Snow(0.7, temperature_c=-5.0)),
    "fog": (tw.Fog(mor_m=tw.LogUniform(30.0, 500.0)), tw.Fog(mor_m=90.0)),
    "both": (
        tw.Mixture(tw.Rain(tw.Uniform(1.0, 9.0)), tw.Fog(mor_m=200.0)),
        tw.Mixture(tw.Rain(3.0), tw.Fog(mor_m=70.0)),
    ),
    "batch": (tw.Rain(tw.LogUniform(1.0, 50.0)), tw.Rain(torch.tensor([7.0, 2.0]))),
}


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("name", RANGES)
def test_a_transform_at_another_intensity_is_the_one_built_for_it(name: str, mode: str) -> None:
    drawn, weather = RANGES[name]
    sensor = sensor_of(return_mode=mode)
    own = tw.LidarWeather(drawn, sensor)
    before = {key: value.clone() for key, value in own.state_dict().items()}
    found, built = own._built_from(weather, {}, own.own_sensor()), tw.LidarWeather(weather, sensor)
    assert found.chain.stages["to_energy"] is own.chain.stages["to_energy"]  # the short way
    assert found.weather == weather or name == "batch"
    assert found.chain.to_dict() == built.chain.to_dict()
    assert found.state_dict().keys() == built.state_dict().keys()
    assert all(torch.equal(value, built.state_dict()[key]) for key, value in found.state_dict().items())
    assert repr(found) == repr(built)  # with the number of echoes
    assert not found.as_built.changed(found.chain)
    assert not own.as_built.changed(own.chain)
    assert all(torch.equal(value, before[key]) for key, value in own.state_dict().items())


@pytest.mark.parametrize(
    "weather", [tw.Snow(1.0, temperature_c=-9.0), tw.Rain(1.0), tw.Mixture(tw.Snow(1.0), tw.Fog())]
)
def test_another_weather_is_built_anew(weather: Any) -> None:
    own = tw.LidarWeather(tw.Snow(tw.LogUniform(0.2, 3.0)), sensor_of())
    found, built = own._built_from(weather, {}, own.own_sensor()), tw.LidarWeather(weather, sensor_of())
    assert found.chain.stages["to_energy"] is not own.chain.stages["to_energy"]
    assert found.chain.to_dict() == built.chain.to_dict()
