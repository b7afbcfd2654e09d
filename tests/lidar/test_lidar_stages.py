"""Single LiDAR stages on states made by hand: energies, detection, merging, points."""

from __future__ import annotations

import math
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from typing import Any

import pytest
import torch
from torch import Tensor

from tests.fake_trace import as_exported
from torchweather.atmosphere.weather import Fog, Rain, Snow
from torchweather.lidar.intensity import are_integers
from torchweather.lidar.returns.beam_particles import BeamParticles
from torchweather.lidar.returns.strongest import ReturnTable, strongest_before
from torchweather.lidar.stages import DB
from torchweather.sensors import RETURN_MODES, Lidar
from torchweather.stages import Detection, Extinction, LidarState, ParticleReturns, PointKind, ToEnergy, ToPoints

OBJECT, PARTICLE, LOST = (int(kind) for kind in (PointKind.OBJECT, PointKind.PARTICLE, PointKind.LOST))
SENSOR = Lidar(wavelength_nm=905.0, range_at_10_percent_m=50.0, echo_separation_m=1.5)
X_THR = 0.1 / math.pi / 50.0**2
UNITS = ("reflectivity", "reflectivity_percent", "uint8_linear", "uint8_calibrated", "photons", "none")


def state_of(points: Tensor, sensor: Lidar = SENSOR) -> LidarState:
    """Beams with their objects, before any stage; one cloud."""
    points = points.reshape(1, -1, points.shape[-1])
    range_m = points[..., :3].norm(dim=-1)
    nothing = torch.zeros_like(range_m)[..., None]
    return LidarState.of(
        points_in=points,
        empty_direction=None,
        clear_range_m=range_m,
        clear_signal=nothing[..., 0],
        range_m=range_m[..., None],
        signal=nothing,
        kind=nothing.to(torch.int8),
        reach_m=range_m,
        threshold=torch.tensor(sensor.threshold_per_m2_sr),
        integral=are_integers(points[..., 3], sensor.intensity_unit),
    )


def beam(*echoes: tuple[float, float, int], sensor: Lidar = SENSOR) -> LidarState:
    """One beam with echoes (range in m, signal in thresholds, kind); the first is the object, range 0 for none."""
    object_m = echoes[0][0]
    state = state_of(torch.tensor([[object_m, 0.0, 0.0, 0.2]]), sensor)
    range_m, signal, kind = (torch.tensor([[values]]) for values in zip(*echoes, strict=True))
    threshold = sensor.threshold_per_m2_sr
    return state.changed(
        range_m=range_m,
        signal=signal * threshold,
        kind=kind.to(torch.int8),
        clear_signal=signal[..., 0] * threshold,
        threshold=torch.tensor(threshold),
    )


def reported(state: LidarState, mode: str, sensor: Lidar = SENSOR) -> list[tuple[float, int]]:
    """(range, kind) of what the receiver reports."""
    found = Detection(replace(sensor, return_mode=mode))(state, {})
    return [
        (round(float(r), 3), int(k)) for r, k in zip(found.returns.range_m[0, 0], found.returns.kind[0, 0], strict=True)
    ]


# ---- energies ---------------------------------------------------------------------------------------------------


def energies(intensity: float, range_m: float, unit: str, margin: float = 0.0) -> float:
    """Signal of an object over the threshold."""
    sensor = replace(SENSOR, intensity_unit=unit)
    state = state_of(torch.tensor([[range_m, 0.0, 0.0, intensity]], dtype=torch.float64), sensor)
    after = ToEnergy(sensor)(state, {"margin": torch.full((1, 1), 1.0 - math.exp(-margin))})
    return float(after.returns.signal) / X_THR


@pytest.mark.parametrize(
    ("unit", "value"),
    [
        ("reflectivity", 0.1),
        ("reflectivity_percent", 10.0),
        ("uint8_linear", 25.5),
        ("uint8_calibrated", 10.0),
        ("photons", 10.0),
        ("none", 77.0),
    ],
)
def test_a_ten_percent_target_at_its_range_stands_at_the_threshold(unit: str, value: float) -> None:
    assert energies(value, 50.0, unit) == pytest.approx(1.0, rel=1e-6)
    # Twice as bright (a column without meaning is never brighter), and four times as bright at half the range.
    assert energies(2 * value, 50.0, unit) == pytest.approx(1.0 if unit == "none" else 2.0, rel=1e-6)
    assert energies(value, 25.0, unit) == pytest.approx(1.0 if unit == "photons" else 4.0, rel=1e-6)


def test_the_near_range_response_dims_a_reflectivity_and_is_in_a_photon_count_already() -> None:
    """Half-way up the ramp from 2 to 10 m, at 6 m, half the light arrives."""
    assert energies(0.1, 6.0, "reflectivity") == pytest.approx(0.5 * (50.0 / 6.0) ** 2, rel=1e-6)
    assert energies(25.0, 6.0, "photons") == pytest.approx(2.5, rel=1e-6)


@pytest.mark.parametrize("unit", UNITS[:-1])
def test_what_was_detected_stands_on_the_threshold_times_its_margin(unit: str) -> None:
    """3.7 times the mean of 1 dB: 10^0.37."""
    assert energies(0.0, 80.0, unit, margin=0.0) == pytest.approx(1.0, rel=1e-6)
    assert energies(0.0, 80.0, unit, margin=3.7) == pytest.approx(10.0**0.37, rel=1e-6)


def test_a_beam_without_return_has_no_signal_and_is_lost() -> None:
    state = ToEnergy(SENSOR)(state_of(torch.tensor([[0.0, 0.0, 0.0, 0.7]])), {"margin": torch.full((1, 1), 0.5)})
    assert float(state.returns.signal) == 0.0
    assert int(state.returns.kind) == LOST


# ---- extinction -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("weather", [Rain(25.0), Snow(1.0), Fog(100.0)], ids=["rain", "snow", "fog"])
def test_an_object_at_half_the_attenuation_length_keeps_one_e_th(weather: Any) -> None:
    """T(1 / (2 alpha)) = exp(-2 alpha / (2 alpha)) = 1/e: there and back."""
    stage = Extinction([weather], SENSOR)
    alpha = float(stage.extinction_per_m(1))
    state = state_of(torch.tensor([[0.5 / alpha, 0.0, 0.0, 1.0]], dtype=torch.float64))
    after = stage(state.changed(signal=torch.ones_like(state.returns.signal)), {})
    assert float(after.returns.signal) == pytest.approx(math.exp(-1.0), rel=1e-6)


@pytest.mark.parametrize(("mor_m", "alpha_per_m"), [(50.0, 2.9957 / 50), (200.0, 2.9957 / 200)])
def test_koschmieder_ties_extinction_to_visibility(mor_m: float, alpha_per_m: float) -> None:
    """ln 20 / MOR; q_eff of 2 is the whole extinction, 1 half of it."""
    for q_eff in (1.0, 2.0):
        stage = Extinction([Fog(mor_m)], SENSOR, q_eff=q_eff, fog_extinction="koschmieder")
        assert float(stage.extinction_per_m(1)) == pytest.approx(alpha_per_m * q_eff / 2, rel=1e-4)


def test_fog_at_905_nm_is_two_percent_thicker_than_at_550_nm() -> None:
    """PHYSICS.md 5.8: alpha_905 = 1.02, alpha_1550 = 1.05 x alpha_550, of the gamma fog."""
    for wavelength_nm, ratio in ((905.0, 1.02), (1550.0, 1.05)):
        stage = Extinction([Fog.advection(100.0)], replace(SENSOR, wavelength_nm=wavelength_nm))
        assert float(stage.extinction_per_m(1)) / (math.log(20.0) / 100.0) == pytest.approx(ratio, abs=0.005)


def test_rain_at_28_m_lets_through_what_the_link_table_says() -> None:
    """T^2 at 28 m, q_eff 2 .916/.856/.786, q_eff 1 .957/.925/.887 at 10/25/50 mm/h (PHYSICS.md 5.3)."""
    for q_eff, wanted in ((2.0, (0.916, 0.856, 0.786)), (1.0, (0.957, 0.925, 0.887))):
        for rate, transmission in zip((10.0, 25.0, 50.0), wanted, strict=True):
            alpha = float(Extinction([Rain(rate)], SENSOR, q_eff=q_eff).extinction_per_m(1))
            # The table is of drops from 0.1 mm, the default from 0: 1 % of the extinction.
            assert math.exp(-2 * alpha * 28.0) == pytest.approx(transmission, abs=3e-3)


def test_snow_extinction_at_q_eff_2() -> None:
    """1.41e-3 ... 1.19e-2 /m at 0.25 to 5 mm/h (PHYSICS.md 5.9)."""
    table = {0.25: 1.41e-3, 0.5: 2.46e-3, 1.0: 4.28e-3, 2.0: 7.15e-3, 5.0: 1.19e-2}
    for rate, alpha in table.items():
        assert float(Extinction([Snow(rate)], SENSOR, q_eff=2.0).extinction_per_m(1)) == pytest.approx(alpha, rel=0.01)


def test_extinctions_add() -> None:
    parts = [Rain(10.0), Snow(1.0), Fog(200.0)]
    together = float(Extinction(parts, SENSOR).extinction_per_m(1))
    assert together == pytest.approx(sum(float(Extinction([part], SENSOR).extinction_per_m(1)) for part in parts))


# ---- detection --------------------------------------------------------------------------------------------------


def test_the_strongest_above_threshold_is_reported() -> None:
    assert reported(beam((40.0, 3.0, OBJECT), (5.0, 2.0, PARTICLE)), "strongest") == [(40.0, OBJECT)]
    assert reported(beam((40.0, 2.0, OBJECT), (5.0, 3.0, PARTICLE)), "strongest") == [(5.0, PARTICLE)]
    assert reported(beam((40.0, 0.99, OBJECT), (5.0, 0.98, PARTICLE)), "strongest") == [(0.0, LOST)]
    assert reported(beam((40.0, 1.0, OBJECT), (5.0, 0.5, PARTICLE)), "strongest") == [(40.0, OBJECT)]


@pytest.mark.parametrize(
    ("mode", "wanted"),
    [
        ("strongest", [(9.0, PARTICLE)]),
        ("first", [(4.0, PARTICLE)]),
        ("last", [(40.0, OBJECT)]),
        ("dual", [(9.0, PARTICLE), (40.0, OBJECT)]),
    ],
)
def test_each_mode_picks_its_own_echo(mode: str, wanted: list[tuple[float, int]]) -> None:
    echoes = beam((40.0, 1.5, OBJECT), (9.0, 3.0, PARTICLE), (4.0, 1.2, PARTICLE), (3.0, 0.9, PARTICLE))
    assert reported(echoes, mode) == wanted


def test_a_dual_return_is_given_once_where_both_are_the_same_echo() -> None:
    assert reported(beam((40.0, 3.0, OBJECT), (5.0, 2.0, PARTICLE)), "dual") == [(40.0, OBJECT), (0.0, LOST)]
    assert reported(beam((0.0, 0.0, LOST), (5.0, 0.5, PARTICLE)), "dual") == [(0.0, LOST), (0.0, LOST)]


@pytest.mark.parametrize("mode", RETURN_MODES)
def test_an_echo_close_to_a_stronger_one_is_part_of_it(mode: str) -> None:
    """1.4 m apart is less than 1.5 m: one echo, at the stronger one's range; 1.6 m are two."""
    swallowed = reported(beam((10.0, 2.0, OBJECT), (8.6, 3.0, PARTICLE)), mode)
    assert swallowed[0] == (8.6, PARTICLE)
    assert swallowed[1:] == ([(0.0, LOST)] if mode == "dual" else [])
    part_of_object = reported(beam((10.0, 3.0, OBJECT), (8.6, 2.0, PARTICLE)), mode)
    assert part_of_object[0] == (10.0, OBJECT)
    apart = reported(beam((10.0, 2.0, OBJECT), (8.4, 3.0, PARTICLE)), mode)
    wanted = {"last": [(10.0, OBJECT)], "dual": [(8.4, PARTICLE), (10.0, OBJECT)]}
    assert apart == wanted.get(mode, [(8.4, PARTICLE)])


def test_what_is_below_threshold_swallows_nothing() -> None:
    assert reported(beam((10.0, 1.2, OBJECT), (9.5, 0.99, PARTICLE)), "last") == [(10.0, OBJECT)]


@pytest.mark.parametrize("mode", RETURN_MODES)
def test_an_object_nearer_than_the_receiver_sees_always_passes(mode: str) -> None:
    """Nothing lies in front of it; it was in the input."""
    near = beam((1.9, 1e-6, OBJECT), (1.9, 50.0, PARTICLE))
    assert reported(near, mode)[0] == (1.9, OBJECT)
    assert reported(beam((2.1, 1e-6, OBJECT), (0.0, 0.0, PARTICLE)), mode)[0] == (0.0, LOST)


def test_a_beam_without_object_reports_what_is_in_it() -> None:
    assert reported(beam((0.0, 0.0, LOST), (5.0, 2.0, PARTICLE)), "strongest") == [(5.0, PARTICLE)]


# ---- particles --------------------------------------------------------------------------------------------------


def test_a_flake_that_fills_the_beam_returns_its_reflectivity() -> None:
    """rho / pi xi T2 / R^2, there and back; and 1 / K times D^2 Q / (16 A_b) for one that does not."""
    part = BeamParticles(Snow(1.0, flake_reflectivity=0.8), SENSOR, q_back=None, published=False)
    stage = ParticleReturns([Snow(1.0)], SENSOR)
    alpha = torch.tensor([0.01])
    full, diameter_m, area_m2 = part._seen(stage.beam, alpha)
    range_m = part.grid.quadrature_m
    ramp = ((range_m - 2.0) / 8.0).clamp(0.0, 1.0)
    wanted = 0.8 / math.pi * ramp * torch.exp(-0.02 * range_m) / range_m**2
    assert torch.allclose(full[0], wanted, rtol=1e-5)
    assert torch.allclose(diameter_m, 0.01 + 0.002 * range_m, rtol=1e-6)
    assert torch.allclose(area_m2, math.pi / 4 * (0.01 + 0.002 * range_m) ** 2, rtol=1e-6)


def test_expected_drops_in_the_cone() -> None:
    """OS1, 28 m, drops of 0.1-10 mm: 189/240/286 at 10/25/50 mm/h (PHYSICS.md 5.2); those that return anything."""
    sensor = Lidar(
        wavelength_nm=865.0,
        exit_diameter_mm=9.5,
        divergence_mrad=math.pi,
        range_at_10_percent_m=40.0,
        near_start_m=1e-3,
        near_full_m=2e-3,
    )
    for rate, wanted in ((10.0, 189.0), (25.0, 240.0), (50.0, 286.0)):
        part = BeamParticles(Rain(rate), sensor, q_back=None, published=False)
        stage = ParticleReturns([Rain(rate)], sensor)
        number = part._tails(1)  # m^-3 above the nodes of diameter
        steps = math.log(part.largest_m / part.smallest_m) / (number.shape[-1] - 1)
        node = round(math.log(1e-4 / part.smallest_m) / steps)
        volume = (
            math.pi * 28.0 * (0.0095**2 + 0.0095 * (0.0095 + 28 * math.pi * 1e-3) + (0.0095 + 0.028 * math.pi) ** 2)
        )
        # The nearest node is within 1 % of 0.1 mm.
        assert float(number[0, node]) * volume / 12 == pytest.approx(wanted, rel=0.02)
        assert float(stage.beam.diameter_m(torch.tensor(28.0))) == pytest.approx(0.0095 + 0.028 * math.pi, rel=1e-6)


@pytest.mark.parametrize("weather", [Rain(25.0), Snow(3.0)], ids=["rain", "snow"])
def test_the_last_place_of_the_range_law_is_where_particles_of_the_signal_end(weather: Any) -> None:
    """A uniform close to 1 puts a particle at the end of its law, not at the end of the beam."""
    sensor = SENSOR.with_hahner_overlap()
    stage = ParticleReturns([weather], sensor)
    part: Any = stage.kinds[weather.kind]
    between = part.between(stage.beam, torch.zeros(1))
    arrivals = torch.logspace(-5, 0, 50)[None]
    place, reach = torch.full((1, 50), 1.0 - 2.0**-24), torch.full((1, 50), 250.0)
    _, by_bisection, _ = strongest_before(between, arrivals, torch.full((1, 50), 1.0 - 1e-4), reach)
    _, by_table, there = ReturnTable.of(between).strongest_before(arrivals, place, reach)
    ends = part.grid.range_m(torch.stack([by_bisection, by_table]))[:, there]
    # The last ten-thousandth of the law is a tail of a third of its range at most; a beam's end is 100 m.
    assert bool((ends[1] < 1.35 * ends[0] + 0.1).all())


# ---- points -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("unit", UNITS)
def test_a_particles_intensity_is_its_equivalent_reflectivity(unit: str) -> None:
    """pi X R^2 in the unit, at the range where it is; 50 thresholds at 5 m are 0.05, or 500 photons."""
    sensor = replace(SENSOR, intensity_unit=unit)
    state = beam((40.0, 1.1, OBJECT), (5.0, 50.0, PARTICLE), sensor=sensor)
    after = ToPoints(sensor)(Detection(sensor)(state, {}), {})
    reflectivity = math.pi * 50.0 * X_THR * 25.0
    assert reflectivity == pytest.approx(0.05)
    scale = {"reflectivity": 1.0, "reflectivity_percent": 100.0, "uint8_linear": 255.0, "uint8_calibrated": 100.0}
    wanted = {"photons": 500.0, "none": 1.0}.get(unit) or reflectivity * scale[unit]
    assert after.returns.points is not None
    assert after.returns.points[0, 0].tolist() == pytest.approx([5.0, 0.0, 0.0, wanted], rel=1e-5)


def test_a_particle_is_rounded_down_where_the_cloud_counts() -> None:
    sensor = replace(SENSOR, intensity_unit="uint8_linear")
    state = beam((40.0, 1.1, OBJECT), (5.0, 50.0, PARTICLE), sensor=sensor)
    state = state.changed(points_in=torch.tensor([[[40.0, 0.0, 0.0, 17.0]]]), integral=torch.tensor([[True]]))
    after = ToPoints(sensor)(Detection(sensor)(state, {}), {})
    assert after.returns.points is not None
    assert float(after.returns.points[0, 0, 3]) == math.floor(0.05 * 255)


@pytest.mark.parametrize("within", [nullcontext, as_exported])
def test_range_noise_and_resolution_are_a_particles_only(within: Callable[[], AbstractContextManager[None]]) -> None:
    sensor = replace(SENSOR, range_noise_m=0.1, range_resolution_m=0.25)
    stage = ToPoints(sensor)
    noise = {"range_noise": torch.full((1, 1, 1), 3.0)}
    with within():
        particle = stage(Detection(sensor)(beam((40.0, 1.1, OBJECT), (5.04, 50.0, PARTICLE)), {}), noise)
        stays = stage(Detection(sensor)(beam((40.1, 50.0, OBJECT), (5.04, 2.0, PARTICLE)), {}), noise)
    assert float(particle.returns.points[0, 0, 0]) == pytest.approx(5.25)  # 5.04 + 0.3 to the nearest quarter
    assert torch.equal(stays.returns.points, torch.tensor([[[40.1, 0.0, 0.0, 0.2]]]))


def test_a_decibel_is_a_tenth_of_a_decade_of_power() -> None:
    assert math.exp(10 * DB) == pytest.approx(10.0)
