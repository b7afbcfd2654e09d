"""Radial speeds of a Doppler (FMCW) LiDAR: particles against a list of every particle, geometry in closed form."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from tests.reference.agreement import ks_critical, ks_distance
from tests.reference.every_lidar_particle import Link, Medium, chosen, every_particle
from tests.reference.every_particle import population
from torchweather.atmosphere.weather import Fog, Mixture, Rain, Snow, Weather
from torchweather.lidar import static_speed_m_per_s
from torchweather.pipeline.point_kind import PointKind
from torchweather.sensors import Lidar
from torchweather.stages import Detection, RadialSpeed
from torchweather.transforms import LidarWeather

N_BEAMS = 40_000
UP = Lidar(
    wavelength_nm=905.0,
    exit_diameter_mm=10.0,
    divergence_mrad=2.0,
    range_at_10_percent_m=50.0,
    speed_column=4,
).with_hahner_overlap()


def empty_beams(sensor: Lidar, weather: Weather, direction: tuple[float, float, float], seed: int = 5) -> Any:
    """State after detection of beams without object in one direction."""
    transform = LidarWeather(weather, sensor)
    points = torch.zeros(N_BEAMS, 5)
    along = torch.tensor(direction).expand(N_BEAMS, 3)
    _, state = transform._begin(points, along, torch.full((N_BEAMS,), sensor.max_range_m))
    noise = transform.chain.draw(state, seed=seed)
    for name, stage in transform.chain.stages.items():
        own = {key.removeprefix(f"{name}."): value for key, value in noise.items() if key.startswith(f"{name}.")}
        state = stage(state, own)
        if isinstance(stage, Detection):
            return state, transform
    raise AssertionError


@pytest.mark.parametrize(
    ("kind", "rate", "mode"), [("rain", 25.0, "strongest"), ("rain", 50.0, "last"), ("snow", 1.0, "first")]
)
def test_fall_speeds_of_reported_particles_are_those_of_the_listed_ones(kind: str, rate: float, mode: str) -> None:
    sensor = replace(UP, return_mode=mode)
    weather = Rain(rate) if kind == "rain" else Snow(rate, flake_reflectivity=0.9)
    state, transform = empty_beams(sensor, weather, (0.0, 0.0, 1.0))
    found = state.returns.kind[0, :, 0] == int(PointKind.PARTICLE)
    falls = -state.returns.echo_speed_m_per_s[0, :, 0][found]
    air = Medium(population(kind, rate), extinction_per_m=float(transform.extinction_per_m))  # type: ignore[arg-type]
    link = Link(
        exit_diameter_m=0.01,
        divergence_rad=2e-3,
        range_at_10_percent_m=50.0,
        near_start_m=sensor.near_start_m,
        near_full_m=sensor.near_full_m,
        echo_separation_m=sensor.echo_separation,
        pulse_length_m=sensor.pulse_length_m,
    )
    nothing = np.full(N_BEAMS, np.inf)
    listed = every_particle(nothing, link, air, rng=np.random.default_rng(2))
    wanted = chosen(listed, nothing, nothing, link, mode)  # type: ignore[arg-type]
    diameter_mm = wanted.diameter_mm[np.isfinite(wanted.diameter_mm)]
    speeds = air.sizes.fall_speeds_m_per_s(diameter_mm)
    assert min(len(speeds), len(falls)) > 500
    assert ks_distance(falls.numpy(), speeds) < ks_critical(len(falls), len(speeds))


def test_wind_fall_and_the_vehicle_along_the_beam() -> None:
    """Snow falls at nearly one speed: its mean in three directions gives wind, fall and vehicle by closed form."""
    wind, ego = (2.0, -3.0, 0.5), 15.0
    weather = Snow(2.0, flake_reflectivity=0.9, wind_m_per_s=wind)
    transform = LidarWeather(weather, UP, ego_speed_m_per_s=ego)
    fall = None
    for direction in ((0.0, 0.0, 1.0), (0.6, 0.0, 0.8), (0.6, -0.8, 0.0)):
        points = torch.cat([1e3 * torch.tensor(direction), torch.tensor([0.1, 7.0])]).expand(N_BEAMS, 5)
        points = torch.cat([points[:, :3] * 0.0, points[:, 3:]], 1)
        result = transform.run(points, seed=3, directions=torch.tensor(direction).expand(N_BEAMS, 3))
        assert isinstance(result.points, Tensor)
        own = result.points[result.kind == int(PointKind.PARTICLE)][:, 4]
        x, y, z = direction
        air = wind[0] * x + wind[1] * y + wind[2] * z - ego * x
        if fall is None:
            fall = float(air - own.mean())
            assert 0.5 < fall < 2.0  # of flakes
        # Turbulence of 0.5 m/s, and the flakes' own speeds, which differ by less than that.
        assert abs(float(own.mean()) - (air - fall * z)) < 4.0 * 0.7 * math.sqrt(2.0 / len(own))
        assert 0.45 < float(own.std()) < 0.7


def test_fog_drifts_with_the_wind_of_the_rain() -> None:
    state, _ = empty_beams(UP, Mixture(Rain(0.1, wind_m_per_s=(4.0, 0.0, 0.0)), Fog(30.0)), (0.8, 0.0, 0.6))
    found = state.returns.kind[0, :, 0] == int(PointKind.PARTICLE)
    assert bool(found.float().mean() > 0.9)
    assert float(state.returns.echo_speed_m_per_s[0, :, 0][found].median()) == pytest.approx(3.2, abs=1e-5)


def test_a_turned_sensor_measures_in_the_frame_of_the_vehicle() -> None:
    """A sensor that looks to the left of the vehicle sees the wind from there, and nothing of the vehicle's speed."""
    left = replace(UP, rotation=((0.0, -1.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, 1.0)))
    weather = Snow(2.0, flake_reflectivity=0.9, wind_m_per_s=(0.0, 5.0, 0.0))
    transform = LidarWeather(weather, left, ego_speed_m_per_s=30.0)
    points = torch.zeros(N_BEAMS, 5)
    result = transform.run(points, seed=3, directions=torch.tensor([0.0, 1.0, 0.0]).expand(N_BEAMS, 3))
    own = result.points[result.kind == int(PointKind.PARTICLE)][:, 4]  # type: ignore[index]
    assert float(own.mean()) == pytest.approx(5.0, abs=4.0 * 0.5 / math.sqrt(len(own)))


def cloud() -> Tensor:
    points = torch.randn(500, 4, generator=torch.Generator().manual_seed(1)) * 20.0
    points[:, 3] = 0.05
    points[::7, :3] = 0.0
    return torch.cat([points, static_speed_m_per_s(points, 12.0)[:, None], torch.rand(500, 1)], -1)


def test_objects_keep_their_speed_and_nothing_changes_without_weather() -> None:
    points = cloud()
    still = LidarWeather(Mixture(Rain(0.0), Fog(math.inf)), UP, ego_speed_m_per_s=12.0)
    assert torch.equal(still(points, seed=1), points)  # type: ignore[arg-type]
    result = LidarWeather(Mixture(Rain(50.0), Fog(60.0)), UP, ego_speed_m_per_s=12.0).run(points, seed=1)
    objects, particles = (result.kind == int(kind) for kind in (PointKind.OBJECT, PointKind.PARTICLE))
    assert isinstance(result.points, Tensor)
    assert bool(particles.any())
    assert torch.equal(result.points[objects][:, 4:], points[objects][:, 4:])
    assert torch.equal(result.points[particles][:, 5], points[particles][:, 5])


def test_the_weather_is_that_of_a_sensor_without_doppler() -> None:
    points = cloud()
    plain = LidarWeather(Rain(50.0), replace(UP, speed_column=None))
    doppler = LidarWeather(Rain(50.0), UP, ego_speed_m_per_s=12.0)
    noise = doppler.draw(points, seed=4)
    without = {key: value for key, value in noise.items() if not key.startswith("radial_speed")}
    assert torch.equal(plain(points, without)[:, :4], doppler(points, noise)[:, :4])  # type: ignore[index]


def test_second_returns_have_speeds_of_their_own() -> None:
    dual = replace(UP, return_mode="dual")
    points = cloud()[:1].expand(N_BEAMS, 6).clone()
    points[:, :3] = torch.tensor([0.0, 0.0, 40.0])
    points[:, 4] = 7.0
    result = LidarWeather(Rain(50.0), dual).run(points, seed=2)
    assert result.second is not None
    assert result.second_kind is not None
    for values, kind in ((result.points, result.kind), (result.second, result.second_kind)):
        assert isinstance(values, Tensor)
        own = kind == int(PointKind.PARTICLE)
        assert bool(own.any())
        assert bool((values[own][:, 4] < 3.0).all())
        assert bool((values[kind == int(PointKind.OBJECT)][:, 4] == 7.0).all())


def test_speeds_of_a_scene_at_rest() -> None:
    points = torch.tensor([[30.0, 0.0, 0.0, 1.0], [0.0, -5.0, 0.0, 1.0], [-3.0, 0.0, 4.0, 1.0], [0.0, 0.0, 0.0, 0.0]])
    assert static_speed_m_per_s(points, 10.0).tolist() == [-10.0, 0.0, 6.0, 0.0]


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (
            lambda: LidarWeather(Rain(1.0), UP)(torch.ones(3, 4)),
            r"Lidar\(speed_column=4\) needs 5 columns; got \(3, 4\)",
        ),
        (lambda: LidarWeather(Rain(1.0), Lidar(905.0), ego_speed_m_per_s=5.0), "for a LiDAR that measures speeds"),
        (lambda: replace(UP, ring_column=4), "speed_column and ring_column must be different columns; got 4"),
        (lambda: RadialSpeed(Lidar(905.0)), "the sensor needs the column of the speed"),
        (lambda: RadialSpeed(UP, ego_speed_m_per_s=300.0), "ego_speed_m_per_s must lie in -100..100 m/s"),
        (lambda: replace(UP, speed_column=2), "speed_column"),
    ],
)
def test_bad_input_is_refused(call: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        call()
