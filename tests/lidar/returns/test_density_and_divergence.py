"""Density, divergence and threshold in the state against sums over particles and integrals of their own."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from numpy.typing import NDArray
from scipy.special import gammaincc
from scipy.stats import norm

from torchweather.atmosphere.weather import Fog, Rain, Snow
from torchweather.lidar.beam import Beam
from torchweather.lidar.returns.beam_particles import BeamParticles
from torchweather.sensors import Lidar
from torchweather.stages import Detection, Extinction, LidarState, ParticleReturns, PointKind, ToEnergy
from torchweather.transforms import LidarFog, LidarRain, LidarSnow, LidarWeather

SENSOR = Lidar(wavelength_nm=905.0, range_at_10_percent_m=60.0, divergence_mrad=2.0).with_hahner_overlap()
# A pulse so short that every particle returns alone: the integral below knows no others.
ALONE = replace(SENSOR, pulse_width_ns=1e-9)
BEAMS = 40_000
Floats = NDArray[np.float64]


def empty_beams(transform: LidarWeather, count: int = BEAMS, batch: int = 1) -> LidarState:
    """Beams into the sky."""
    sky = torch.zeros(count, 3) + torch.tensor([1.0, 0.0, 0.0])
    return transform.state_of(torch.zeros(batch, count, 4), sky)


def drawn(transform: LidarWeather, state: LidarState, seed: int = 1) -> tuple[Floats, Floats]:
    """Range and signal of the strongest particle of each beam, through extinction and particle returns."""
    noise = transform.chain.draw(state, seed=seed)
    for name, stage in transform.chain.stages.items():
        own = {key.removeprefix(f"{name}."): v for key, v in noise.items() if key.startswith(f"{name}.")}
        state = stage(state, own)
        if isinstance(stage, ParticleReturns):
            break
    return state.returns.range_m[..., 1].double().numpy(), state.returns.signal[..., 1].double().numpy()


def own_number_above(signal: float, reach_m: float, weather: Rain, q_back: float, **wider: float) -> float:
    """Lambda(e, R) by a sum of its own: int A(r) N_>(D_e(r)) dr, without extinction.

    Args:
        wider: ``extra_rad`` of divergence, ``density`` over that of the weather.
    """
    start = SENSOR.near_start_m
    edges = np.concatenate([np.linspace(start, 1.0, 400), np.linspace(1.0, reach_m, 20_001)[1:]])
    middle, width = 0.5 * (edges[1:] + edges[:-1]), np.diff(edges)
    diameter_m = 1e-3 * SENSOR.exit_diameter_mm + (1e-3 * SENSOR.divergence_mrad + wider["extra_rad"]) * middle
    near = np.clip((middle - start) / (SENSOR.near_full_m - start), 0.0, 1.0)
    full = q_back / (4.0 * math.pi) * near / middle**2
    ratio = signal / np.maximum(full, 1e-300)
    least_mm = 1e3 * diameter_m * np.sqrt(ratio)
    counts = weather.distribution(torch.tensor([weather.rate_mm_per_h]))
    size = np.linspace(0.05, 8.0, 8000)
    outline = weather.physical_diameter_mm(torch.from_numpy(size)).numpy()
    low, high = counts.diameter_min_mm, min(counts.diameter_max_mm, counts.span_mm()[1])
    inside = torch.from_numpy(np.clip(size, max(low, 1e-2), high))
    whole = counts.tail_per_m3(inside).double().numpy().reshape(-1)
    end = counts.tail_per_m3(torch.tensor([high], dtype=torch.float64)).double().numpy().reshape(-1)
    tail = np.interp(least_mm, outline, np.maximum(whole - end, 0.0), right=0.0)
    area = 0.25 * math.pi * diameter_m**2
    return float(wider["density"] * (area * tail * width * (ratio < 1.0)).sum())


@pytest.mark.parametrize(("density", "extra_mrad"), [(1.0, 0.0), (2.5, 0.0), (0.4, 0.0), (1.0, 3.0), (2.0, 1.5)])
def test_the_expected_number_of_drops_is_that_of_an_own_integral(density: float, extra_mrad: float) -> None:
    weather = Rain(25.0)
    part = BeamParticles(weather, ALONE, q_back=None, published=False)
    beam, clear = Beam(ALONE).widened(torch.tensor([1e-3 * extra_mrad])), torch.zeros(1)
    between = part.between(beam, clear, torch.tensor([density]))
    for times, reach_m in ((1.0, 30.0), (3.0, 30.0), (1.0, 2.0)):
        signal = times * ALONE.threshold_per_m2_sr
        row = (math.log(signal) - part.log_low) / part.log_step
        above = between.flip(1).cumsum(1).flip(1)[0, :, :]
        place = float(part.grid.position(torch.tensor(reach_m)))
        column = int(place)
        at = above[:, column] + (place - column) * (above[:, column + 1] - above[:, column])
        low, high = math.log(float(at[int(row)])), math.log(float(at[int(row) + 1]))
        found = math.exp(low + (row - int(row)) * (high - low))
        wanted = own_number_above(
            signal, reach_m, weather, float(part.q_back), extra_rad=1e-3 * extra_mrad, density=density
        )
        # Tables of 512 diameters and 65 signals, linear and as a power law between nodes; a missing factor of 2, or a
        # radius for a diameter, is far outside.
        assert found == pytest.approx(wanted, rel=0.02)


def test_a_beam_widened_by_nothing_is_the_same_and_by_a_batch_gives_a_batch() -> None:
    beam, range_m = Beam(ALONE), torch.linspace(1.0, 40.0, 12).reshape(4, 3)
    assert torch.equal(beam.widened(torch.zeros(1)).area_m2(range_m)[0], beam.area_m2(range_m))
    wide = beam.widened(torch.tensor([0.0, 2e-3])).diameter_m(range_m)
    torch.testing.assert_close(wide[1] - wide[0], 2e-3 * range_m, rtol=1e-4, atol=1e-7)
    assert float(beam.divergence_rad) == pytest.approx(2e-3)  # the beam itself stays


@pytest.mark.parametrize("density", [0.5, 2.0])
def test_the_share_of_beams_with_a_visible_drop_follows_the_density(density: float) -> None:
    """P = 1 - exp(-density Lambda): 40,000 beams, four standard deviations."""
    transform = LidarRain(Rain(25.0), ALONE, q_eff=0.0)
    state = empty_beams(transform)
    part = transform.chain.stages["particle_returns"].kinds["rain"]
    wanted = own_number_above(
        ALONE.threshold_per_m2_sr, ALONE.max_range_m, Rain(25.0), float(part.q_back), extra_rad=0.0, density=density
    )
    share = 1.0 - math.exp(-wanted)
    _, signal = drawn(transform, state.changed(density_scale=torch.tensor([density])))
    found = (signal >= ALONE.threshold_per_m2_sr).mean()
    assert found == pytest.approx(share, abs=4.0 * math.sqrt(share * (1.0 - share) / BEAMS) + 0.02 * wanted)
    assert abs(found - (1.0 - math.exp(-wanted / density))) > 0.02  # not that of the density 1


def test_twice_the_density_is_twice_the_snow_and_its_extinction() -> None:
    """A number of flakes proportional to the density at any rate: two states of one table."""
    transform = LidarSnow(Snow(0.5), ALONE)
    part = transform.chain.stages["particle_returns"].kinds["snow"]
    beam, clear = Beam(ALONE), torch.zeros(2)
    both = part.between(beam, clear, torch.tensor([1.0, 2.0]))
    torch.testing.assert_close(both[1], 2.0 * both[0], rtol=1e-5, atol=1e-7)
    state = empty_beams(transform, 10, 2).changed(density_scale=torch.tensor([1.0, 2.0]))
    extinction = transform.chain.stages["extinction"](state, {}).air.extinction_per_m
    assert float(extinction[1] / extinction[0]) == pytest.approx(2.0)


@pytest.mark.parametrize("density", [0.5, 1.0, 2.0])
def test_readings_of_fog_are_those_of_an_own_integral(density: float) -> None:
    """-ln P(no reading above n) = -ln F of the waveform's maximum + the rate of crossings integrated along the way.

    F = Q(n + 1/2, mu); the rank z of F; the noise's slope is that of white noise filtered with sin^2 over two pulse
    lengths, here from the filter itself.
    """
    transform = LidarFog(Fog(mor_m=100.0), SENSOR)
    part = transform.chain.stages["particle_returns"].kinds["fog"]
    beam, clear = Beam(SENSOR), torch.zeros(1)
    above = part.between(beam, clear, torch.tensor([density])).flip(1).cumsum(1).flip(1)[0, :, -1]
    middle = np.linspace(SENSOR.near_start_m, SENSOR.max_range_m, 60_001)
    step = middle[1] - middle[0]
    signal = part.signal(beam, clear, torch.from_numpy(middle).float())[0].double().numpy()
    mean = density * signal * SENSOR.photons_at_threshold / SENSOR.threshold_per_m2_sr
    taps = np.sin(np.linspace(0.0, np.pi, 4001)) ** 2
    slope_per_m = math.sqrt(np.square(np.gradient(taps, 2.0 * SENSOR.pulse_length_m / 4000)).sum() / (taps @ taps))
    steep = np.abs(np.gradient(2.0 * np.sqrt(np.maximum(mean, 1e-12)), step)) / slope_per_m
    chance = norm.pdf(steep) - steep * norm.sf(steep)
    compared = 0
    for row in range(1, 120):
        reading = (part.root_low + part.root_step * row) ** 2
        never = gammaincc(reading + 0.5, mean)
        if never.min() < 1e-100:
            continue
        rank = norm.ppf(np.minimum(never, 1.0 - 1e-16))
        crossed = slope_per_m * float((norm.pdf(rank) / norm.cdf(rank) * chance).sum() * step)
        wanted = crossed - math.log(float(never.min()))
        if 1e-3 < wanted < 1e2:
            compared += 1
            # 257 nodes of range, Gauss's rule of three points between them; 2048 nodes of the mean.
            assert float(above[row]) == pytest.approx(wanted, rel=2e-2)
    assert compared >= 5


def test_the_threshold_of_each_sample_decides() -> None:
    state = LidarState.of(
        points_in=torch.ones(3, 1, 4),
        empty_direction=None,
        clear_range_m=torch.full((3, 1), 20.0),
        clear_signal=torch.full((3, 1), 3.0),
        range_m=torch.full((3, 1, 1), 20.0),
        signal=torch.full((3, 1, 1), 1.5),
        kind=torch.zeros(3, 1, 1, dtype=torch.int8),
        reach_m=torch.full((3, 1), 20.0),
        threshold=torch.tensor(1.0),
        integral=torch.zeros(3, 1, dtype=torch.bool),
        threshold_scale=torch.tensor([1.0, 1.4, 1.6]),
    )
    kind = Detection(SENSOR)(state, {}).returns.kind.flatten().tolist()
    assert kind == [PointKind.OBJECT, PointKind.OBJECT, PointKind.LOST]
    assert state.detected_from.flatten().tolist() == pytest.approx([1.0, 1.4, 1.6])
    assert float(state.changed(threshold_scale=None).detected_from) == 1.0


def test_a_near_object_without_any_signal_is_not_reported() -> None:
    """Nearer than the receiver's response an object of the input is always reported, unless it was taken away."""
    near = torch.tensor([[0.5]])
    for signal, kind in ((1e-9, PointKind.OBJECT), (0.0, PointKind.LOST)):
        state = LidarState.of(
            points_in=torch.tensor([[[0.5, 0.0, 0.0, 0.3]]]),
            empty_direction=None,
            clear_range_m=near,
            clear_signal=near,
            range_m=near[..., None],
            signal=torch.full((1, 1, 1), signal),
            kind=torch.zeros(1, 1, 1, dtype=torch.int8),
            reach_m=near,
            threshold=torch.tensor(1.0),
            integral=torch.zeros(1, 1, dtype=torch.bool),
        )
        assert int(Detection(SENSOR)(state, {}).returns.kind) == kind


def test_the_last_table_is_not_kept_for_another_density_or_divergence() -> None:
    transform = LidarRain(Rain(25.0), SENSOR, q_eff=0.0)  # else the extinction tells densities apart
    state = empty_beams(transform, 4000)
    plain = drawn(transform, state)[1]
    dense = drawn(transform, state.changed(density_scale=torch.tensor([3.0])))[1]
    wide = drawn(transform, state.changed(extra_divergence_rad=torch.tensor([4e-3])))[1]
    assert (dense > plain).mean() > 0.3
    assert not np.array_equal(wide, plain)
    assert np.array_equal(drawn(transform, state)[1], plain)


def test_the_energy_stage_tells_later_ones_the_sensor() -> None:
    transform = LidarRain(Rain(25.0), SENSOR)
    state = empty_beams(transform, 4)
    assert state.receiver.sensor is None
    energy = transform.chain.stages["to_energy"]
    assert isinstance(energy, ToEnergy)
    assert energy(state, {"margin": torch.zeros(1, 4)}).receiver.sensor == SENSOR
    assert isinstance(transform.chain.stages["extinction"], Extinction)
