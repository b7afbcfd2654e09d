"""Density by direction, sizes and shared particles against slow calculations of their own."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from tests.lidar.effects.effect_scene import begin, directions, rain, states
from torchweather.atmosphere.weather import Fog, Rain, Snow
from torchweather.lidar.beam import Beam
from torchweather.lidar.effects.structure import beam_overlap
from torchweather.lidar.returns.beam_particles import BeamParticles
from torchweather.sensors import Lidar
from torchweather.stages import EFFECTS, LidarState, PointKind, with_effects
from torchweather.transforms import LidarFog, LidarSnow, LidarWeather

PARTICLE = int(PointKind.PARTICLE)
AZIMUTH, ELEVATION = torch.atan2(directions()[:, 1], directions()[:, 0]), torch.asin(directions()[:, 2])


def wrapped(angle: float) -> float:
    return (angle + math.pi) % (2.0 * math.pi) - math.pi


def slow_lobe(angle: float, middle: float, width: float, steepness: float = 1.0) -> float:
    """By angles, where the code uses chords: 1 in the middle, half of it at half the width."""
    return 0.5 ** (abs(math.sin(0.5 * wrapped(angle - middle)) / math.sin(0.25 * width)) ** (2.0 * steepness))


def density_of(name: str, **values: Any) -> Tensor:
    found = EFFECTS[name](**values)(begin(rain()), {}).air.beam_density
    assert found is not None
    return found


# ---- density by direction ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(("amplitude", "middle", "width"), [(3.0, 3.0, 0.6), (-1.0, -3.1, 1.2), (2.0, 0.4, 6.2)])
def test_wake_and_lee_have_their_amplitude_direction_and_width(amplitude: float, middle: float, width: float) -> None:
    found = density_of("lidar.particle_density_azimuth", amplitude=amplitude, azimuth_rad=middle, width_rad=width)
    wanted = [1.0 + amplitude * slow_lobe(float(angle), middle, width) for angle in AZIMUTH]
    torch.testing.assert_close(found, torch.tensor(wanted).expand(3, -1), rtol=1e-4, atol=1e-5)


def test_a_lobe_is_half_as_high_at_half_its_width() -> None:
    for side in (-0.5, 0.5):
        assert slow_lobe(1.0 + 0.8 * side, 1.0, 0.8) == pytest.approx(0.5)


def test_wind_is_a_first_harmonic_with_mean_1() -> None:
    found = density_of("lidar.particle_density_azimuth", wind_amplitude=0.6, wind_azimuth_rad=1.0)
    torch.testing.assert_close(found[0], 1.0 + 0.6 * torch.cos(AZIMUTH - 1.0), rtol=1e-5, atol=1e-5)
    assert float(found.mean()) == pytest.approx(1.0, abs=1e-5)  # 64 azimuths all around


@pytest.mark.parametrize("steepness", [1.0, 3.0, 8.0])
def test_a_layer_has_its_elevation_width_and_edges(steepness: float) -> None:
    place = {"elevation_rad": -0.1, "width_rad": 0.25, "steepness": steepness}
    found = density_of("lidar.particle_density_elevation", amplitude=4.0, **place)
    wanted = [1.0 + 4.0 * slow_lobe(float(angle), -0.1, 0.25, steepness) for angle in ELEVATION]
    torch.testing.assert_close(found, torch.tensor(wanted).expand(3, -1), rtol=1e-4, atol=1e-5)


def test_beams_of_unknown_direction_and_straight_up_keep_their_density() -> None:
    points = torch.tensor([[0.0, 0.0, 0.0, 0.0], [0.0, 0.0, 9.0, 0.5], [0.0, 9.0, 0.0, 0.5]])
    state = rain().state_of(points[None], None)
    azimuth = EFFECTS["lidar.particle_density_azimuth"](amplitude=2.0, azimuth_rad=0.5 * math.pi)(state, {})
    assert azimuth.air.beam_density is not None
    assert azimuth.air.beam_density.tolist() == [[1.0, 1.0, pytest.approx(3.0)]]
    elevation = EFFECTS["lidar.particle_density_elevation"](amplitude=2.0, elevation_rad=0.5 * math.pi)(state, {})
    assert elevation.air.beam_density is not None
    assert elevation.air.beam_density[0, :2].tolist() == [1.0, pytest.approx(3.0)]


def sky(count: int, sensor: Lidar, weather: Rain | Snow | Fog, **more: Any) -> tuple[LidarWeather, LidarState]:
    """Beams into the sky, all alike but for the draw."""
    kinds: dict[str, type[LidarWeather]] = {"rain": LidarWeather, "snow": LidarSnow, "fog": LidarFog}
    transform = kinds[weather.kind](weather, sensor, **more)
    along = torch.tensor([[0.0, 1.0, 0.0]]).expand(count, 3)
    return transform, transform.state_of(torch.zeros(1, count, 4), along)


# A pulse so short that every flake returns alone: numbers are proportional to the density.
SNOW_SENSOR = Lidar(wavelength_nm=905.0, range_at_10_percent_m=60.0, pulse_width_ns=1e-9)


def share_and_ranges(weather: Snow, effects: list[Any], seed: int) -> tuple[float, Tensor]:
    transform, state = sky(20_000, SNOW_SENSOR, weather, effects=effects)
    found = transform.chain(state, transform.chain.draw(state, seed=seed))
    seen = found.returns.kind[0, :, 0] == PARTICLE
    return float(seen.float().mean()), found.returns.range_m[0, :, 0][seen]


def test_three_times_the_density_is_three_times_the_number_by_poisson() -> None:
    """P(a flake is seen) = 1 - exp(-d Lambda), Lambda by quadrature over the beam and no table of solutions."""
    weather = Snow(rate_mm_per_h=0.1, flake_reflectivity=0.9)
    effect = {"effect": "lidar.particle_density_azimuth", "amplitude": 2.0, "azimuth_rad": 0.5 * math.pi}
    part, beam = BeamParticles(weather, SNOW_SENSOR, q_back=None, published=False), Beam(SNOW_SENSOR)
    clear, reach = torch.zeros(1), torch.full((1, 1), SNOW_SENSOR.max_range_m)
    mean = float(part.expected_above(beam, beam.threshold.reshape(1, 1), clear, reach))
    plain, _ = share_and_ranges(weather, [], 1)
    dense, _ = share_and_ranges(weather, [effect], 2)
    # Three deviations of a share of 20,000, and 1 % for the extinction, which Lambda leaves out.
    for found, number in ((plain, mean), (dense, 3.0 * mean)):
        wanted = -math.expm1(-number)
        assert found == pytest.approx(wanted, abs=3.0 * math.sqrt(wanted * (1 - wanted) / 20_000) + 0.01 * wanted)
    assert dense > 1.5 * plain


def test_the_strongest_of_three_times_as_many_is_that_of_three_times_the_density_in_the_air() -> None:
    """Against another way to the same: ``density_scale``, which is in the table itself. Without extinction."""
    weather = Snow(rate_mm_per_h=0.5)
    transform, state = sky(20_000, SNOW_SENSOR, weather, q_eff=0.0)
    noise = transform.chain.draw(state, seed=3)
    by_air = states(transform.chain, state.changed(density_scale=torch.tensor([3.0])), noise)
    by_beam = states(transform.chain, state.changed(beam_density=torch.full((1, 20_000), 3.0)), noise)
    first, second = (found["particle_returns"] for found in (by_air, by_beam))
    seen = first.returns.signal[..., 1] > first.receiver.threshold
    assert int(seen.sum()) > 1000
    # Both are read from tables, on grids of arrivals and ranges that do not lie on one another.
    close = (second.returns.range_m[..., 1] / first.returns.range_m[..., 1] - 1.0).abs()[seen]
    assert float(close.quantile(0.99)) < 0.01
    torch.testing.assert_close(by_beam["extinction"].air.path_density, torch.full((1, 20_000), 3.0))


def test_objects_dim_by_the_density_of_their_beam() -> None:
    transform = rain()
    state = begin(transform)
    chain = with_effects(transform.chain, [EFFECTS["lidar.particle_density_azimuth"](amplitude=2.0, azimuth_rad=3.0)])
    found = states(chain, state, chain.draw(state, seed=3))
    density, extinction = found["particle_density_azimuth"].air.beam_density, found["extinction"]
    assert density is not None
    wanted = torch.exp(-2.0 * transform.extinction_per_m * density * state.scene.clear_range_m)
    got = extinction.returns.signal[..., 0] / found["to_energy"].returns.signal[..., 0].clamp_min(1e-30)
    seen = state.scene.clear_range_m > 0
    torch.testing.assert_close(got[seen], wanted[seen], rtol=1e-5, atol=0.0)


def test_a_lee_without_any_particle_returns_none() -> None:
    effect = {"effect": "lidar.particle_density_azimuth", "amplitude": -1.0, "azimuth_rad": 0.5 * math.pi}
    assert share_and_ranges(Snow(rate_mm_per_h=5.0), [effect], 1)[0] == 0.0


def test_fog_of_twice_the_density_reads_twice_as_much() -> None:
    transform, state = sky(500, SNOW_SENSOR, Fog(mor_m=80.0))
    noise = transform.chain.draw(state, seed=1)
    plain = states(transform.chain, state, noise)["particle_returns"].returns.signal[..., 1]
    denser = state.changed(beam_density=torch.full((1, 500), 2.0))
    dense = states(transform.chain, denser, noise)["particle_returns"].returns.signal[..., 1]
    torch.testing.assert_close(dense, 2.0 * plain, rtol=1e-6, atol=0.0)


# ---- sizes -------------------------------------------------------------------------------------------------------


def slow_tail(part: BeamParticles, factors: list[float], above_mm: float) -> float:
    """N_> of a reshaped distribution: a sum over fine cells of the diameter."""
    tails = part._tails(1)[0].double().numpy()
    edges = np.geomspace(1e3 * part.smallest_m, 1e3 * part.largest_m, len(tails))
    total = tails[-1]
    for low, high, number in zip(edges[:-1], edges[1:], tails[:-1] - tails[1:], strict=True):
        if low >= above_mm * (1.0 - 1e-9):
            factor = np.interp(math.log(math.sqrt(low * high)), np.log([1.0, 2.0, 4.0, 8.0]), factors)
            total += number * factor
    return float(total)


def test_the_number_of_each_size_is_multiplied_by_its_factor() -> None:
    part = BeamParticles(Snow(rate_mm_per_h=1.0), SNOW_SENSOR, q_back=None, published=False)
    factors = [3.0, 0.5, 2.0, 0.1]
    found = part._of_sizes(part._tails(1), torch.tensor([factors]))[0]
    edges = np.geomspace(1e3 * part.smallest_m, 1e3 * part.largest_m, found.shape[0])
    for node in (0, 100, 250, 400, 500):
        wanted = slow_tail(part, factors, float(edges[node]))
        assert float(found[node]) == pytest.approx(wanted, rel=1e-3)  # sums in single precision


def test_factors_of_1_keep_the_bits_of_the_tail() -> None:
    part = BeamParticles(Snow(rate_mm_per_h=1.0), SNOW_SENSOR, q_back=None, published=False)
    tails = part._tails(1)
    assert torch.equal(part._of_sizes(tails, torch.ones(1, 4)), tails)


def test_expected_numbers_are_linear_in_the_factors() -> None:
    """What a fit by non-negative least squares needs."""
    part, beam = BeamParticles(Snow(rate_mm_per_h=1.0), SNOW_SENSOR, q_back=None, published=False), Beam(SNOW_SENSOR)
    factors = torch.tensor([0.5, 2.0, 3.0, 0.2])
    unit = [part.between(beam, torch.zeros(1), sizes=row[None]).double().sum(1) for row in torch.eye(4)]
    whole = part.between(beam, torch.zeros(1), sizes=factors[None]).double().sum(1)
    # Each unit has the largest diameter's own tail, which no knot moves: small beside the rest.
    mixed = torch.stack([f * one for f, one in zip(factors.double(), unit, strict=True)]).sum(0)
    torch.testing.assert_close(mixed, whole, rtol=5e-3, atol=1e-9)


def test_all_sizes_twice_as_many_are_twice_the_density() -> None:
    part, beam = BeamParticles(Snow(rate_mm_per_h=1.0), SNOW_SENSOR, q_back=None, published=False), Beam(SNOW_SENSOR)
    twice = part.between(beam, torch.zeros(1), sizes=torch.full((1, 4), 2.0))
    torch.testing.assert_close(twice, part.between(beam, torch.zeros(1), torch.tensor([2.0])), rtol=1e-3, atol=1e-7)


# ---- shared particles --------------------------------------------------------------------------------------------


def test_the_overlap_of_two_disks_is_that_of_points_thrown_into_one() -> None:
    points = np.random.default_rng(1).uniform(-1.0, 1.0, (400_000, 2))
    inside = points[(points**2).sum(1) <= 1.0]
    for apart in (0.2, 0.9, 1.7, 2.3):
        both = ((inside - [apart, 0.0]) ** 2).sum(1) <= 1.0
        wanted = both.mean()
        # Four deviations of a share of 314,000.
        tolerance = 4.0 * math.sqrt(max(wanted * (1 - wanted), 1e-6) / len(inside))
        assert float(beam_overlap(torch.tensor(apart), torch.tensor(2.0))) == pytest.approx(wanted, abs=tolerance)


def ring(count: int, step_rad: float) -> Tensor:
    azimuth = step_rad * torch.arange(count, dtype=torch.float64)
    return torch.stack([azimuth.cos(), azimuth.sin(), torch.zeros_like(azimuth)], -1).float()


RING_STEP = 2.0 * math.pi / 1800
CLOSE = Lidar(wavelength_nm=905.0, exit_diameter_mm=10.0, divergence_mrad=3.0, range_at_10_percent_m=60.0)


def ring_returns(share: float, seed: int, rate: float = 0.5) -> tuple[Tensor, Tensor]:
    """Range and signal of the first particle of each beam, ``(B, N)``, before and after sharing."""
    transform = LidarSnow(
        Snow(rate_mm_per_h=rate), CLOSE, effects=[{"effect": "lidar.shared_particles", "share": share}]
    )
    state = transform.state_of(torch.zeros(12, 1800, 4), ring(1800, RING_STEP))
    found = states(transform.chain, state, transform.chain.draw(state, seed=seed))["shared_particles"]
    return found.returns.range_m[..., 1], found.returns.signal[..., 1] / found.receiver.threshold


def test_a_flake_is_in_two_beams_as_often_as_they_overlap_at_its_range() -> None:
    range_m, signal = ring_returns(1.0, 1)
    both = (signal[:, 1:] > 1.0) & (range_m[:, 1:] == range_m[:, :-1])
    seen = signal[:, :-1] > 1.0
    overlap = beam_overlap(RING_STEP * range_m[:, :-1], 1e-2 + 3e-3 * range_m[:, :-1])
    chances = overlap[seen]
    wanted = float(chances.sum())
    # The range of the beam's own flake, which was replaced, counts by half: a tenth, beside the counts.
    found = int((both & seen).sum())
    assert wanted > 300
    assert found == pytest.approx(wanted, rel=0.1 + 3.0 / math.sqrt(wanted))


def test_sharing_keeps_the_number_of_returns_and_their_ranges() -> None:
    plain, shared = (ring_returns(share, 7) for share in (0.0, 1.0))
    numbers = [int((signal > 1.0).sum()) for _, signal in (plain, shared)]
    # Shared returns come in pairs: the variance of their number is up to twice that of the others.
    assert numbers[1] == pytest.approx(numbers[0], abs=4.0 * math.sqrt(1.5 * numbers[0]))
    quantiles = [np.quantile(r[s > 1.0].numpy(), [0.1, 0.5, 0.9]) for r, s in (plain, shared)]
    np.testing.assert_allclose(quantiles[1], quantiles[0], rtol=0.08)


def test_without_overlap_nothing_is_shared() -> None:
    transform = LidarSnow(Snow(rate_mm_per_h=1.0), replace(CLOSE, exit_diameter_mm=0.1, divergence_mrad=1.0))
    state = transform.state_of(torch.zeros(2, 900, 4), ring(900, 2.0 * math.pi / 900))
    noise = {"neighbour": torch.zeros(2, 900)}
    found = states(transform.chain, state, transform.chain.draw(state, seed=1))["particle_returns"]
    # Beams of 0.1 mm + 1 mrad, 7 mrad apart: side by side up to 17 mm only.
    after = EFFECTS["lidar.shared_particles"](share=1.0)(found, noise)
    assert torch.equal(after.returns.range_m, found.returns.range_m)


def test_a_flake_behind_the_neighbours_object_is_not_shared() -> None:
    transform = LidarSnow(Snow(rate_mm_per_h=3.0), CLOSE)
    points = torch.cat([torch.where(torch.arange(1800)[:, None] % 3 == 0, 5.0, 30.0) * ring(1800, RING_STEP)], -1)
    cloud = torch.cat([points, torch.full((1800, 1), 0.5)], -1).expand(4, -1, -1)
    state = transform.state_of(cloud, None)
    found = states(transform.chain, state, transform.chain.draw(state, seed=1))["particle_returns"]
    after = EFFECTS["lidar.shared_particles"](share=1.0)(found, {"neighbour": torch.zeros(4, 1800)})
    assert not torch.equal(after.returns.range_m, found.returns.range_m)
    assert (after.returns.range_m[..., 1:] <= state.air.reach_m[..., None] + 1e-6).all()
    assert torch.equal(after.returns.range_m[..., 0], found.returns.range_m[..., 0])
    # Nor is one lost that only one of the two beams reaches: those beside a near object, in the row before.
    beyond = (found.returns.range_m[..., 1:] > 5.0) & (torch.arange(1800) % 3 == 1)[:, None]
    assert int(beyond.sum()) > 100
    assert torch.equal(after.returns.range_m[..., 1:][beyond], found.returns.range_m[..., 1:][beyond])
