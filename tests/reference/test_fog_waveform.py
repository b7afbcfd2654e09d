"""The fog waveform against its limits, a brute-force sum, the oracle block and the figures of PHYSICS.md."""

from __future__ import annotations

import math

import numpy as np
import pytest

from tests.oracles import load
from tests.reference.every_lidar_particle import Link
from tests.reference.fog_waveform import (
    SoftTarget,
    hard_signal,
    last_detected_m,
    local_signal,
    object_wins_to_m,
    soft_return,
    soft_signal,
)

OS1 = Link(exit_diameter_m=0.0095, divergence_rad=math.radians(0.18), range_at_10_percent_m=40.0)
HAHNER = Link(0.0095, math.radians(0.18), 40.0, near_start_m=0.9, near_full_m=1.0)
# xi = 1 from 0.8 m on: a ramp of no width.
FLAT = Link(0.0095, math.radians(0.18), 40.0, near_start_m=0.8, near_full_m=0.8 + 1e-9)
ORACLE = load("lidar_fog_soft")
MOR_M = (10.0, 50.0, 100.0, 500.0)


def koschmieder(mor_m: float) -> SoftTarget:
    alpha = math.log(20.0) / mor_m
    return SoftTarget(alpha, alpha / 20.0)  # lidar ratio 20 sr, PHYSICS.md 5.8: 19-20 at 865 nm


@pytest.mark.parametrize("link", [OS1, HAHNER])
def test_waveform_is_the_sum_over_the_pulse(link: Link) -> None:
    fog = koschmieder(50.0)
    received = np.linspace(link.near_start_m + 0.05, 30.0, 60)
    t = (np.arange(40_000) + 0.5) / 40_000 * 2.0 * fog.pulse_width_s
    r = received[:, None] - 0.5 * 299_792_458.0 * t
    seen = r > link.near_start_m
    xi = np.clip((r - link.near_start_m) / (link.near_full_m - link.near_start_m), 0.0, 1.0)
    per_m = np.where(seen, xi * np.exp(-2.0 * fog.extinction_per_m * r) / np.where(seen, r, 1.0) ** 2, 0.0)
    pulse = np.sin(math.pi * t / (2.0 * fog.pulse_width_s)) ** 2
    summed = fog.backscatter_per_m_sr * (0.5 * 299_792_458.0) * (pulse * per_m).mean(axis=1) * t[-1]
    # Midpoint rule of 40 000 steps and t[-1] for 2 tau: 1e-4 covers both.
    np.testing.assert_allclose(soft_signal(received, fog, link), summed, rtol=1e-4)


def test_far_away_the_waveform_is_the_local_form() -> None:
    fog = SoftTarget(0.0, 1e-3)
    r = np.array([60.0, 120.0])
    # The pulse's variance, (c tau / 2)^2 (1/3 - 2/pi^2), times half the curvature of 1/r^2, is the first correction.
    correction = 1.0 + 3.0 * fog.pulse_length_m**2 * (1.0 / 3.0 - 2.0 / math.pi**2) / r**2
    ratio = soft_signal(r + fog.pulse_length_m, fog, OS1) / local_signal(r, fog, OS1)
    np.testing.assert_allclose(ratio, correction, rtol=1e-6)


def test_energy_of_the_waveform_is_that_of_the_fog_times_half_the_pulse_length() -> None:
    fog = koschmieder(50.0)
    r = np.linspace(OS1.near_start_m, 40.0, 40_001)
    received = np.linspace(OS1.near_start_m, 43.0, 40_001)  # the pulse's tail leaves the layer 3 m later
    energy = np.trapezoid(soft_signal(received, fog, OS1, object_range_m=40.0), received)
    local = np.trapezoid(local_signal(r, fog, OS1), r)
    assert energy == pytest.approx(local, rel=1e-6)


def test_a_thin_layer_in_front_of_an_object_peaks_where_it_is() -> None:
    narrow = Link(0.0095, 0.003, 40.0, near_start_m=9.99, near_full_m=9.99 + 1e-9)
    range_m, signal = soft_return(SoftTarget(0.0, 1e-3), narrow, object_range_m=10.01)
    assert range_m == pytest.approx(10.0, abs=1e-3)  # R_peak - c tau / 2
    assert signal == pytest.approx(1e-3 * 0.02 / 10.0**2, rel=1e-3)  # beta thickness / r^2, as of a hard target


def test_oracle_ranges_follow_from_the_local_form() -> None:
    # The block's c tau / 2 is 1.5 m sharp, the speed of light's 1.49896 m: 2e-4 of the range, inside its tolerance.
    for mor, row in ORACLE["rows"].items():
        fog = SoftTarget(row["alpha"], row["beta"])
        reached = last_detected_m(fog, FLAT, local=True)
        assert reached == pytest.approx(row["R_max_fog_return_m"], rel=ORACLE["tol"]), mor
        exact = SoftTarget(row["alpha"], row["beta"], pulse_width_s=2.0 * ORACLE["c_tau_over_2_m"] / 299_792_458.0)
        reached = last_detected_m(exact, FLAT, local=True)
        assert reached == pytest.approx(row["R_max_fog_return_m"], rel=1e-9), mor
        signal = hard_signal(row["R10_in_fog_m"], 0.1, fog, FLAT)
        assert float(signal) == pytest.approx(FLAT.threshold, rel=1e-9), mor


def test_full_waveform_is_seen_farther_than_the_local_form_by_up_to_three_percent() -> None:
    # The decay is convex, so its average over the pulse exceeds its middle.
    further = []
    for row in ORACLE["rows"].values():
        fog = SoftTarget(row["alpha"], row["beta"])
        further.append(last_detected_m(fog, FLAT, local=False) / last_detected_m(fog, FLAT, local=True) - 1.0)
    np.testing.assert_allclose(further, [0.0292, 0.0136, 0.0096, 0.0076], atol=2e-4)


def test_soft_return_of_the_default_near_range_has_the_printed_peaks() -> None:
    # PHYSICS.md 5.3: MOR 10, 50, 100 and 500 m, alpha = ln 20 / MOR, lidar ratio 20 sr; printed to two digits.
    peaks = [soft_return(koschmieder(mor), OS1) for mor in MOR_M]
    assert [round(r, 1) for r, _ in peaks] == [3.1, 3.7, 3.9, 4.1]
    assert [round(x / OS1.threshold, 1) for _, x in peaks] == [2.2, 2.2, 1.4, 0.3]


def test_a_ten_percent_target_wins_up_to_the_printed_ranges() -> None:
    default = [object_wins_to_m(0.1, koschmieder(mor), OS1) for mor in MOR_M]
    np.testing.assert_allclose(default, [4.0, 12.7, 19.3, 51.0], rtol=0.012)  # printed to two or three digits
    hahner = [object_wins_to_m(0.1, koschmieder(mor), HAHNER) for mor in MOR_M]
    np.testing.assert_allclose(hahner, [1.8, 3.8, 5.5, 13.0], rtol=0.03)
    assert soft_return(koschmieder(50.0), HAHNER)[0] == pytest.approx(1.4, abs=0.05)


def test_local_form_overestimates_the_peak_of_a_ramp_shorter_than_the_pulse() -> None:
    fog = koschmieder(50.0)
    r = np.linspace(0.9, 10.0, 9101)
    assert local_signal(r, fog, HAHNER).max() > 2.5 * soft_return(fog, HAHNER)[1]


def test_nothing_returns_from_before_the_near_range_or_behind_the_object() -> None:
    fog = koschmieder(50.0)
    assert soft_return(fog, OS1, object_range_m=1.5) == (0.0, 0.0)
    assert float(soft_signal(1.9, fog, OS1)) == 0.0
    assert float(soft_signal(9.0, fog, OS1, object_range_m=5.0)) == 0.0
    assert soft_return(fog, OS1, object_range_m=3.0)[1] < soft_return(fog, OS1)[1]
