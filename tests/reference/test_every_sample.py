"""The slow FMCW reference against closed forms that need no radar code at all."""

from __future__ import annotations

import math

import numpy as np
import pytest

from tests.reference import every_sample
from torchweather.sensors import Radar

ARRAY = Radar(
    samples=32,
    chirps=8,
    tx_half_wavelengths=((0.0, 0.0), (3.0, 2.0)),
    rx_half_wavelengths=((0.0, 0.0), (1.0, 0.0), (2.0, 0.0)),
)


def test_a_target_is_a_tone_at_its_beat_frequency() -> None:
    radar = Radar(samples=64, chirps=2)
    range_m = 7.3 * 299_792_458.0 / 2e9  # 7.3 cells of c / 2B
    row = every_sample.every_sample(radar, [range_m, 0.0, 0.0], 0.0, 1.0, 0.0)[0, 0]
    power = every_sample.receive_power_mw(radar, 1.0, range_m, 0.0, 0.0)
    assert abs(every_sample.tone(row, 7.3 / 64)) ** 2 == pytest.approx(power, rel=1e-12)
    assert abs(every_sample.tone(row, 8.3 / 64)) ** 2 < 1e-20 * power


def test_half_the_beamwidth_costs_3_db_each_way() -> None:
    away = math.radians(0.5 * ARRAY.azimuth_beamwidth_deg)
    there = every_sample.receive_power_mw(ARRAY, 1.0, 10.0, 0.0, 0.0)
    assert every_sample.receive_power_mw(ARRAY, 1.0, 10.0, away, 0.0) == pytest.approx(there / 4.0, rel=1e-12)


def test_the_search_finds_an_echo_where_it_was_put() -> None:
    place, power = (20.13, 3.1, 0.31, -0.12), every_sample.receive_power_mw(ARRAY, 2.0, 20.13, 0.31, -0.12)
    cube = every_sample.every_sample(ARRAY, place[0] * every_sample.line_of_sight(*place[2:]), place[1], 2.0, 0.7)
    *found, strength = every_sample.strongest_echo(ARRAY, cube, (20.2, 2.0, 0.25, -0.05), rounds=12)
    np.testing.assert_allclose(found, place, atol=1e-3)
    assert strength == pytest.approx(power, rel=1e-4)


def test_the_echo_of_a_thin_shell_is_that_of_eta_times_the_volume() -> None:
    """PHYSICS.md 6.5: ``V = pi / (8 ln 2) theta phi R^2 dR``, theta and phi one-way widths; for narrow beams."""
    radar = Radar(azimuth_beamwidth_deg=5.0, elevation_beamwidth_deg=5.0)
    volume_m3 = math.pi / (8.0 * math.log(2.0)) * math.radians(5.0) ** 2 * 20.0**2 * 0.2
    wanted = every_sample.receive_power_mw(radar, 1.16e-3 * volume_m3, 20.0, 0.0, 0.0)
    shell = every_sample.shell_covariance_mw(radar, 1.16e-3, 19.9, 20.1)[0, 0].real
    assert 10.0 * math.log10(1.16e-3 * volume_m3) == pytest.approx(-34.0, abs=0.5)  # PHYSICS.md: about -34 dBsm
    assert shell == pytest.approx(wanted, rel=2e-3)  # cos(el) takes theta^2 / (32 ln 2) = 3e-4; the floor adds


def test_the_cells_of_a_shell_hold_its_power_together() -> None:
    """Parseval: the bins' powers sum to that of the samples."""
    radar = Radar(samples=32)
    cells = sum(every_sample.cell_power_mw(radar, 1e-3, k, 1.9, 3.1, 15.0) for k in range(32))
    assert cells == pytest.approx(every_sample.shell_covariance_mw(radar, 1e-3, 1.9, 3.1, 15.0)[0, 0].real, rel=1e-9)


def test_a_narrow_beam_sees_the_wind_along_it() -> None:
    radar = Radar(azimuth_beamwidth_deg=2.0, elevation_beamwidth_deg=2.0)
    mean, std = every_sample.shell_speed(radar, (-7.0, 0.0, 0.0), (0.5, 0.0, 0.0))
    # 2e-2: of the directions at the pattern's floor, 1e-6 of the peak over a half space of 2 pi sr
    assert mean == pytest.approx(-7.0, rel=2e-2)
    assert std == pytest.approx(0.5, rel=0.5)
