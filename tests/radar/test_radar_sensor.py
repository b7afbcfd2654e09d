"""Radar: chirps, virtual array, pattern and link budget against the reference; impossible ones are refused."""

from __future__ import annotations

import math
from dataclasses import fields
from typing import Any

import numpy as np
import pytest
import torch

from tests.reference import every_sample
from torchweather.sensors import Radar

PRESETS = ["awr1843-like", "imaging-77ghz"]


@pytest.mark.parametrize("preset", PRESETS)
def test_presets_keep_their_chirps_within_their_periods(preset: str) -> None:
    radar = Radar.preset(preset)
    assert radar.active_time_s <= radar.chirp_period_s
    assert radar.repetition_period_s == pytest.approx(len(radar.tx_half_wavelengths) * 1e-6 * radar.chirp_period_us)
    assert radar.frame_time_s == pytest.approx(radar.chirps * radar.repetition_period_s)
    assert radar.max_range_m == pytest.approx(
        1e6 * radar.sample_rate_mhz * 299_792_458.0 / (2.0 * radar.slope_hz_per_s), rel=1e-12
    )
    assert radar.max_speed_m_per_s == pytest.approx(0.5 * radar.chirps * radar.speed_resolution_m_per_s, rel=1e-12)
    assert radar.floor_db == pytest.approx(
        10.0 * math.log10(every_sample.noise_power_mw(radar) / (radar.samples * radar.chirps * radar.virtual_channels)),
        abs=1e-9,
    )


@pytest.mark.parametrize("preset", PRESETS)
def test_virtual_elements_are_the_sums_of_their_pairs(preset: str) -> None:
    radar = Radar.preset(preset)
    found = radar.virtual_half_wavelengths
    assert found.shape == (radar.virtual_channels, 2)
    for k, tx in enumerate(radar.tx_half_wavelengths):
        for r, rx in enumerate(radar.rx_half_wavelengths):
            assert found[k * radar.receivers + r].tolist() == [tx[0] + rx[0], tx[1] + rx[1]]


def test_the_pattern_is_that_of_the_reference() -> None:
    radar = Radar.preset("awr1843-like")
    rng = np.random.default_rng(0)
    azimuth, elevation = rng.uniform(-1.5, 1.5, 200), rng.uniform(-1.5, 1.5, 200)
    found = radar.gain_dbi(torch.from_numpy(azimuth), torch.from_numpy(elevation)).numpy() - radar.antenna_gain_dbi
    wanted = 10.0 * np.log10(every_sample.one_way_gain(radar, azimuth, elevation))
    np.testing.assert_allclose(found, wanted, rtol=0.0, atol=1e-9)
    half = torch.tensor(math.radians(radar.azimuth_beamwidth_deg / 2.0), dtype=torch.float64)
    assert float(radar.gain_dbi(half, half * 0.0)) == pytest.approx(10.5 - 3.0103, abs=1e-4)


def test_a_noise_floor_given_is_the_floor() -> None:
    assert Radar(noise_floor_db=-7.0).floor_db == -7.0


def test_dictionaries_hold_all_of_a_radar() -> None:
    radar = Radar.preset("imaging-77ghz")
    again = Radar.from_dict(radar.to_dict())
    assert all(getattr(again, field.name) == getattr(radar, field.name) for field in fields(radar))
    assert again == radar


def test_active_time_longer_than_the_period_is_refused_with_both_times() -> None:
    with pytest.raises(ValueError, match=r"512 samples at 12\.5 MHz take 40\.96 us, longer than .* period of 40 us"):
        Radar(chirp_period_us=40.0)
    Radar(chirp_period_us=40.96)  # just fits


@pytest.mark.parametrize(
    ("bad", "message"),
    [
        ({"samples": 1}, r"samples must be 2 or more; got 1\. One sample a chirp has no range"),
        ({"chirps": 0}, r"chirps must be 1 or more; got 0"),
        ({"frequency_ghz": 77e9}, r"frequency_ghz must lie in 1\.\.1000 GHz; got 77000000000"),
        ({"frequency_ghz": 0.5}, r"frequency_ghz must lie in 1\.\.1000 GHz; got 0\.5"),
        ({"bandwidth_mhz": 0.0}, r"bandwidth_mhz must be above 0 MHz; got 0"),
        ({"sample_rate_mhz": -1.0}, r"sample_rate_mhz must be above 0 MHz; got -1"),
        ({"chirp_period_us": math.nan}, r"chirp_period_us must be .*got nan"),
        ({"noise_figure_db": -3.0}, r"noise_figure_db must lie in 0\.\.100 dB; got -3"),
        ({"loss_db": math.inf}, r"loss_db must lie in 0\.\.100 dB; got inf"),
        ({"azimuth_beamwidth_deg": 0.0}, r"azimuth_beamwidth_deg must lie in 0\.01\.\.360 degrees; got 0"),
        ({"polarisation": "x"}, r"polarisation must be one of h, v; got 'x'"),
        ({"noise_floor_db": math.nan}, r"noise_floor_db must lie in .*got nan"),
        ({"tx_half_wavelengths": ()}, r"tx_half_wavelengths must be pairs \(left, up\).*got \(\)"),
        (
            {"rx_half_wavelengths": ((0.0, 1.0, 2.0),)},
            r"rx_half_wavelengths must be pairs.*got \(\(0\.0, 1\.0, 2\.0\),\)",
        ),
        ({"rx_half_wavelengths": ((0.0, math.inf),)}, r"rx_half_wavelengths must be pairs.*inf"),
        ({"rx_half_wavelengths": ((0.0, 0.0), (0.0, 0.0))}, r"rx_half_wavelengths must hold each position once"),
    ],
)
def test_impossible_radars_are_refused_with_their_numbers(bad: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Radar(**bad)


def test_the_range_doppler_map_has_a_cell_for_each_sample_and_chirp() -> None:
    radar = Radar(samples=256, chirps=64)
    assert radar.range_doppler_cells == 256 * 64
