"""The fast draw of a beam's returns against the reference that lists every particle, in every return mode.

Both see the same beams: objects of several reflectivities from 1.5 to 90 m and beams that meet nothing. Each comparison
has a false-alarm level of 1e-3; the seeds are fixed, so a test that passes goes on passing.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import pytest
import torch
from torch import Tensor

from tests.reference.agreement import joint_test, ks_critical, ks_distance, share_z, z_critical
from tests.reference.every_lidar_particle import (
    LOST,
    OBJECT,
    PARTICLE,
    Link,
    Medium,
    chosen,
    every_particle,
    lambda_by_quadrature,
    object_signal,
    summed_in_pulses,
)
from tests.reference.every_particle import population
from torchweather.atmosphere.weather import Fog, Rain, Snow, Weather
from torchweather.lidar.returns.strongest import ReturnTable, strongest_before
from torchweather.sensors import RETURN_MODES, Lidar
from torchweather.stages import Detection, LidarState
from torchweather.transforms import LidarWeather

N_BEAMS = 60_000
NO_MARGIN_DB = 1e-6  # objects on the floor stand at the threshold itself, as in the reference

HDL = Lidar(
    wavelength_nm=905.0,
    exit_diameter_mm=10.0,
    divergence_mrad=2.0,
    range_at_10_percent_m=50.0,
    margin_db=NO_MARGIN_DB,
    echo_separation_m=1.5,
)
OS1 = Lidar(
    wavelength_nm=865.0,
    exit_diameter_mm=9.5,
    divergence_mrad=np.pi,
    range_at_10_percent_m=40.0,
    margin_db=NO_MARGIN_DB,
    echo_separation_m=1.5,
)
# Raindrops are seen within 3 m, where the default near-range response is nearly 0: rain needs the early overlap.
RAIN_SENSORS = {"os1": OS1.with_hahner_overlap(), "hdl": HDL.with_hahner_overlap()}
SNOW_SENSORS = {"os1": OS1, "hdl": HDL}
WEATHERS = [("rain", rate) for rate in (5.0, 25.0, 50.0)] + [("snow", rate) for rate in (0.25, 1.0, 3.0)]


@dataclass(frozen=True)
class Scene:
    """Beams that both sides see."""

    points: Tensor
    directions: Tensor
    range_m: np.ndarray
    reflectivity: np.ndarray


def scene(n: int = N_BEAMS) -> Scene:
    rng = np.random.default_rng(3)
    range_m = np.exp(rng.uniform(np.log(1.5), np.log(90.0), n))
    range_m[rng.random(n) < 0.2] = np.inf
    reflectivity = rng.choice([0.02, 0.1, 0.5], n)
    directions = rng.normal(size=(n, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    seen = np.isfinite(range_m)
    points = np.zeros((n, 4))
    points[seen, :3] = directions[seen] * range_m[seen, None]
    points[:, 3] = np.where(seen, reflectivity, 0.0)
    return Scene(torch.from_numpy(points), torch.from_numpy(directions).float(), range_m, reflectivity)


def weather(kind: str, rate: float) -> Weather:
    return Rain(rate) if kind == "rain" else Snow(rate, flake_reflectivity=0.9)


def link(sensor: Lidar) -> Link:
    return Link(
        exit_diameter_m=sensor.exit_diameter_mm * 1e-3,
        divergence_rad=sensor.divergence_mrad * 1e-3,
        range_at_10_percent_m=sensor.range_at_10_percent_m,
        near_start_m=sensor.near_start_m,
        near_full_m=sensor.near_full_m,
        near_power=sensor.near_power,
        max_range_m=sensor.max_range_m,
        echo_separation_m=sensor.echo_separation,
        pulse_length_m=sensor.pulse_length_m,
    )


def medium(transform: LidarWeather, kind: str, rate: float) -> Medium:
    return Medium(population(kind, rate), extinction_per_m=float(transform.extinction_per_m))  # type: ignore[arg-type]


def reported(transform: LidarWeather, beams: Scene, seed: int) -> LidarState:
    """State after detection."""
    to_max_range_m = torch.full(beams.points.shape[:-1], transform.sensor.max_range_m)
    _, state = transform._begin(beams.points, beams.directions, to_max_range_m)
    noise = transform.chain.draw(state, seed=seed)
    for name, stage in transform.chain.stages.items():
        own = {key.removeprefix(f"{name}."): value for key, value in noise.items() if key.startswith(f"{name}.")}
        state = stage(state, own)
        if isinstance(stage, Detection):
            return state
    raise AssertionError


def columns(state: LidarState, echo: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    return tuple(
        values[0, :, echo].double().numpy()
        for values in (state.returns.kind, state.returns.range_m, state.returns.signal)
    )  # type: ignore[return-value]


@pytest.mark.parametrize("mode", RETURN_MODES)
@pytest.mark.parametrize("sensor", ["os1", "hdl"])
@pytest.mark.parametrize(("kind", "rate"), WEATHERS)
def test_reported_echoes_have_the_law_of_a_beam_with_every_particle_listed(
    kind: str, rate: float, sensor: str, mode: str
) -> None:
    from dataclasses import replace

    lidar = replace((RAIN_SENSORS if kind == "rain" else SNOW_SENSORS)[sensor], return_mode=mode)
    transform = LidarWeather(weather(kind, rate), lidar)
    beams = scene()
    there, air = link(lidar), medium(transform, kind, rate)
    # Of beams of a dual-return sensor with objects the fast path draws K particles: more come in one beam of 10,000.
    rng = np.random.default_rng(int(100 * rate) + len(mode))
    listed = every_particle(beams.range_m, there, air, rng=rng)
    finite = np.where(np.isfinite(beams.range_m), beams.range_m, 1.0)
    strength = object_signal(finite, beams.reflectivity, there, air)
    wanted = chosen(listed, beams.range_m, strength, there, mode)  # type: ignore[arg-type]
    found_kind, found_range, found_signal = columns(reported(transform, beams, seed=11), 0)

    for value in (OBJECT, PARTICLE, LOST):
        hits = int((found_kind == value).sum()), int((wanted.kind == value).sum())
        assert abs(share_z(hits[0], N_BEAMS, hits[1], N_BEAMS)) < z_critical(), value
    mine, theirs = found_kind == PARTICLE, wanted.kind == PARTICLE
    if min(mine.sum(), theirs.sum()) < 50:
        pytest.fail(f"only {theirs.sum()} beams with a particle: the comparison says nothing")
    critical = ks_critical(int(mine.sum()), int(theirs.sum()))
    assert ks_distance(found_range[mine], wanted.range_m[theirs]) < critical
    assert ks_distance(np.log(found_signal[mine]), np.log(wanted.signal[theirs])) < critical
    # Range and signal together, and against the object behind: the marginals could be right by chance.
    behind = np.where(np.isfinite(beams.range_m), beams.range_m, 200.0)
    joint = joint_test(
        np.stack([found_range[mine], np.log(found_signal[mine]), behind[mine]], 1),
        np.stack([wanted.range_m[theirs], np.log(wanted.signal[theirs]), behind[theirs]], 1),
        n_bins=6,
    )
    assert joint.p_value > 1e-3


@pytest.mark.parametrize("sensor", ["os1", "hdl"])
@pytest.mark.parametrize(("kind", "rate"), WEATHERS)
def test_both_echoes_of_a_dual_return_sensor_have_the_joint_law_of_the_reference(
    kind: str, rate: float, sensor: str
) -> None:
    from dataclasses import replace

    lidar = replace((RAIN_SENSORS if kind == "rain" else SNOW_SENSORS)[sensor], return_mode="dual")
    transform = LidarWeather(weather(kind, rate), lidar)
    beams = scene()
    there, air = link(lidar), medium(transform, kind, rate)
    listed = every_particle(beams.range_m, there, air, rng=np.random.default_rng(5))
    finite = np.where(np.isfinite(beams.range_m), beams.range_m, 1.0)
    wanted = chosen(listed, beams.range_m, object_signal(finite, beams.reflectivity, there, air), there, "dual")
    assert wanted.second is not None
    state = reported(transform, beams, seed=12)
    first, second = columns(state, 0), columns(state, 1)
    for a in (OBJECT, PARTICLE, LOST):
        for b in (OBJECT, PARTICLE, LOST):
            mine = int(((first[0] == a) & (second[0] == b)).sum())
            theirs = int(((wanted.kind == a) & (wanted.second.kind == b)).sum())
            assert abs(share_z(mine, N_BEAMS, theirs, N_BEAMS)) < z_critical(), (a, b)
    mine_two = (first[0] == PARTICLE) & (second[0] == PARTICLE)
    theirs_two = (wanted.kind == PARTICLE) & (wanted.second.kind == PARTICLE)
    if min(mine_two.sum(), theirs_two.sum()) < 200:
        return  # light rain: two drops in one beam are rare, and their share was compared above
    joint = joint_test(
        np.stack([first[1], second[1], np.log(first[2].clip(1e-9)), np.log(second[2].clip(1e-9))], 1)[mine_two],
        np.stack(
            [
                wanted.range_m,
                wanted.second.range_m,
                np.log(wanted.signal.clip(1e-9)),
                np.log(wanted.second.signal.clip(1e-9)),
            ],
            1,
        )[theirs_two],
        n_bins=4,
    )
    assert joint.p_value > 1e-3


@pytest.mark.parametrize("sensor", ["os1", "hdl"])
@pytest.mark.parametrize(("kind", "rate"), WEATHERS)
def test_expected_numbers_are_those_of_the_direct_integral(kind: str, rate: float, sensor: str) -> None:
    lidar = (RAIN_SENSORS if kind == "rain" else SNOW_SENSORS)[sensor]
    transform = LidarWeather(weather(kind, rate), lidar)
    returns = transform.chain.stages["particle_returns"]
    part = returns.kinds[kind]
    there, air = link(lidar), medium(transform, kind, rate)
    threshold = lidar.threshold_per_m2_sr
    for range_m in (2.7, 4.0, 10.0, 60.0):
        for share in (0.3, 1.0, 3.0):
            found = part.expected_above(
                returns.beam,
                torch.tensor([[share * threshold]]),
                transform.extinction_per_m,
                torch.tensor([[range_m]]),
            )
            wanted = lambda_by_quadrature(share * threshold, range_m, there, air)
            # 1 % of the number: half of it is the table over the rate, half the nodes of range and signal; what stays
            # below 1e-4 a beam is not seen in a scan.
            assert float(found) == pytest.approx(wanted, rel=0.01, abs=1e-4)


@pytest.mark.parametrize(
    "case",
    [Rain(25.0), Snow(1.0), Fog(mor_m=50.0), Fog(mor_m=300.0)],
    ids=["rain", "snow", "dense-fog", "light-fog"],
)
@pytest.mark.parametrize("early", [False, True], ids=["default-near-range", "early-overlap"])
def test_tabulated_solutions_are_those_of_the_bisection(case: Weather, early: bool) -> None:
    lidar = HDL.with_hahner_overlap() if early else HDL
    transform = LidarWeather(case, lidar)
    returns = transform.chain.stages["particle_returns"]
    part = returns.kinds[case.kind]
    between = part.between(returns.beam, transform.extinction_per_m)
    generator = torch.Generator().manual_seed(2)
    n = 40_000
    arrivals = torch.empty(1, n).exponential_(generator=generator)
    place = torch.rand(1, n, generator=generator)
    reach = part.grid.position(torch.exp(torch.rand(1, n, generator=generator) * 3.6 + 1.0))  # 2.7 to 100 m
    exact = strongest_before(between, arrivals, place, reach)
    read = ReturnTable.of(between).strongest_before(arrivals, place, reach)
    threshold = lidar.threshold_per_m2_sr
    seen = [(part.signal_at(signal, returns.beam) > threshold) & there for signal, _, there in (exact, read)]
    # The same numbers go in, so the two differ by their own errors and not by chance.
    assert abs(float(seen[0].float().mean() - seen[1].float().mean())) < 5e-4
    if seen[0].sum() < 100:
        return
    assert ks_distance(exact[0][seen[0]], read[0][seen[1]]) < 3e-3
    assert ks_distance(part.grid.range_m(exact[1])[seen[0]], part.grid.range_m(read[1])[seen[1]]) < 3e-3


@pytest.mark.parametrize(
    ("sensor", "falling", "without"),
    [
        ("velodyne-hdl-64e", Snow(0.3), 0.09),
        ("velodyne-hdl-64e", Snow(1.0), 0.05),
        ("ouster-os1-128", Snow(1.0), 0.10),
        ("ouster-os1-128", Snow(1.0, flake_reflectivity=0.9), 0.08),
    ],
    ids=["hdl-0.3", "hdl-1", "os1-1", "os1-1-bright"],
)
def test_echoes_of_one_pulse_add(sensor: str, falling: Snow, without: float) -> None:
    """PHYSICS.md 10.4: particles of one pulse added one by one, as the receiver does, against the mean of the others.

    The strongest alone is below by the third argument: what the mean is there to bring back.
    """
    lidar, beams = Lidar.preset(sensor), 60_000
    transform = LidarWeather(falling, lidar)
    alone = replace(link(lidar), pulse_length_m=0.0)
    air = Medium(
        population("snow", falling.rate_mm_per_h),
        flake_reflectivity=falling.reflectivity_at(lidar.wavelength_nm),
        extinction_per_m=float(transform.extinction_per_m),
    )
    listed = every_particle(
        np.full(beams, np.inf), alone, air, rng=np.random.default_rng(2), energy_floor=0.02 * alone.threshold
    )
    above = summed_in_pulses(listed, lidar.pulse_length_m) > alone.threshold
    share = len(np.unique(listed.beam[above])) / beams
    returns = transform.chain.stages["particle_returns"]
    everywhere = torch.tensor([[lidar.max_range_m]])
    number = returns.kinds["snow"].expected_above(
        returns.beam, torch.tensor([[lidar.threshold_per_m2_sr]]), transform.extinction_per_m, everywhere
    )
    error = math.sqrt(share * (1 - share) / beams) / share
    assert float(1 - torch.exp(-number)) / share == pytest.approx(1.0, abs=0.02 + 3 * error)
    strongest = len(np.unique(listed.beam[listed.signal > alone.threshold])) / beams
    assert 1 - strongest / share == pytest.approx(without, abs=0.02 + 3 * error)


def test_as_many_particles_are_drawn_as_one_beam_in_ten_thousand_exceeds() -> None:
    from scipy.stats import poisson

    for rate in (0.5, 2.0):
        lidar = Lidar.from_dict({**HDL.to_dict(), "return_mode": "last"})
        transform = LidarWeather(weather("snow", rate), lidar)
        clear = medium(transform, "snow", rate)
        mean = lambda_by_quadrature(
            lidar.threshold_per_m2_sr, lidar.max_range_m, link(lidar), Medium(clear.sizes, extinction_per_m=0.0)
        )
        echoes = transform.chain.stages["particle_returns"].kinds["snow"].echoes
        assert poisson.sf(echoes, mean) < 1e-4 <= poisson.sf(echoes - 1, mean)
        assert f"snow_echoes={echoes}" in repr(transform)


def test_mean_over_whole_table_of_default_response_is_the_committed_one() -> None:
    import json
    from pathlib import Path

    table = json.loads((Path(__file__).parents[2] / "reference" / "lidar_table.json").read_text())
    checked = 0
    for row in table["rows"]:
        values = table["sensors"][row["sensor"]]
        lidar = Lidar(
            wavelength_nm=values["wavelength_nm"],
            exit_diameter_mm=values["exit_diameter_m"] * 1e3,
            divergence_mrad=values["divergence_rad"] * 1e3,
            **{
                key: values[key]
                for key in ("range_at_10_percent_m", "near_start_m", "near_full_m", "near_power", "max_range_m")
            },
        )
        falling = (Rain if row["weather"] == "rain" else Snow)(row["rate_mm_per_h"])
        transform = LidarWeather(falling, lidar)
        returns = transform.chain.stages["particle_returns"]
        found = returns.kinds[row["weather"]].expected_above(
            returns.beam,
            torch.tensor([[lidar.threshold_per_m2_sr]]),
            transform.extinction_per_m,
            torch.tensor([[lidar.max_range_m]]),
        )
        wanted = row["P"]["over threshold, no object"]
        assert float(1 - torch.exp(-found)) == pytest.approx(wanted, rel=0.01, abs=2e-6)
        checked += 1
    assert checked > 10
