"""Oracle blocks ``fmcw``, ``radar_equation`` and ``thermal_noise``: the numbers, and the samples that show them."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from tests.oracles import load
from tests.reference import every_sample
from torchweather.atmosphere.weather import Rain
from torchweather.physics import radar_constant_db, received_power_dbm, target_rcs_dbsm, thermal_noise_dbm
from torchweather.radar import FmcwRadar, Scatterers, beat_signal
from torchweather.sensors import Radar
from torchweather.stages import weather_attenuation_db_per_km

FMCW, EQUATION, NOISE = load("fmcw"), load("radar_equation"), load("thermal_noise")


def oracle_radar() -> Radar:
    params = FMCW["params"]
    return Radar(
        frequency_ghz=77.0,
        bandwidth_mhz=1e-6 * params["B_Hz"],
        samples=params["Ns"],
        sample_rate_mhz=1e-6 * params["fs_Hz"],
        chirp_period_us=1e6 * params["T_chirp_s"],
        chirps=params["Nc"],
        transmit_power_dbm=EQUATION["Pt_dBm"],
        antenna_gain_dbi=EQUATION["G_dBi"],
        noise_figure_db=14.0,
    )


@pytest.mark.parametrize(
    ("name", "wanted"),
    [
        ("active_time_s", FMCW["params"]["T_active_s"]),
        ("slope_hz_per_s", FMCW["slope"]),
        ("range_resolution_m", FMCW["range_resolution"]),
        ("max_range_m", FMCW["R_max_complex"]),
        ("speed_resolution_m_per_s", FMCW["v_res"]),
        ("max_speed_m_per_s", FMCW["v_max"]),
        ("noise_power_dbm", EQUATION["noise_dBm_12p5MHz_NF14"]),
    ],
)
def test_the_radars_numbers(name: str, wanted: float) -> None:
    assert getattr(oracle_radar(), name) == pytest.approx(wanted, rel=FMCW["tol"])


def test_the_radar_equation() -> None:
    link = {
        "frequency_ghz": 77.0,
        "transmit_power_dbm": EQUATION["Pt_dBm"],
        "antenna_gain_dbi": 2.0 * EQUATION["G_dBi"],
    }
    rcs_dbsm = 10.0 * np.log10(EQUATION["sigma_m2"])
    power = received_power_dbm(rcs_dbsm, EQUATION["R_m"], **link)
    assert float(power) == pytest.approx(EQUATION["Pr_dBm"], abs=EQUATION["tol"])
    assert float(target_rcs_dbsm(power, EQUATION["R_m"], **link)) == pytest.approx(rcs_dbsm, abs=1e-9)
    constant = radar_constant_db(77.0, EQUATION["Pt_dBm"], 2.0 * EQUATION["G_dBi"])
    assert oracle_radar().constant_db == pytest.approx(float(constant), abs=1e-12)


def test_losses_and_attenuation_take_their_decibels_off() -> None:
    link = {"transmit_power_dbm": 12.0, "antenna_gain_dbi": 26.0}
    power = received_power_dbm(0.0, 50.0, loss_db=2.0, attenuation_db=1.5, **link)
    assert float(power) == pytest.approx(EQUATION["Pr_dBm"] - 3.5, abs=1e-9)


def test_rain_on_the_way_there_and_back() -> None:
    two_way_db = 2.0 * float(weather_attenuation_db_per_km(Rain(25.0), oracle_radar())) * 1e-3 * EQUATION["R_m"]
    assert two_way_db == pytest.approx(EQUATION["two_way_rain25_dB"], rel=1e-6)


def test_thermal_noise() -> None:
    assert float(thermal_noise_dbm(1.0)) == pytest.approx(NOISE["kT0_dBm_per_Hz"], abs=1e-9)
    watts = 1e-3 * 10.0 ** (0.1 * float(thermal_noise_dbm(1e9)))
    assert watts == pytest.approx(NOISE["N_1GHz_290K_W"], rel=1e-7)  # the block's digits
    assert every_sample.noise_power_mw(oracle_radar()) == pytest.approx(
        10.0 ** (0.1 * EQUATION["noise_dBm_12p5MHz_NF14"]), rel=1e-9
    )


def highest(signal: np.ndarray[tuple[int], np.dtype[np.complex128]], near: float) -> float:
    """Frequency in cycles per sample where a row's transform is largest, by trying around a guess."""
    step = 0.5 / signal.size
    for _ in range(40):
        tried = near + step * np.linspace(-1.0, 1.0, 9)
        near = max(tried, key=lambda frequency: abs(every_sample.tone(signal, frequency)))
        step *= 0.5
    return float(near)


def test_the_samples_beat_as_the_range_says() -> None:
    """50 m, at rest: 8.14 MHz, measured in the samples."""
    radar = oracle_radar()
    target = Scatterers.from_rcs(torch.tensor([[50.0, 0.0, 0.0]], dtype=torch.float64), 0.0)
    row = beat_signal(target, radar)[0, 0].numpy().astype(np.complex128)
    rate_hz = 1e6 * radar.sample_rate_mhz
    wanted = FMCW["beat_Hz_R50_v0"]
    # 1e-6 cycles a sample: single precision phases (1e-7 rad) over 512 samples
    assert highest(row, wanted / rate_hz + 3e-4) == pytest.approx(wanted / rate_hz, abs=1e-6)
    assert float(np.mean(np.abs(row) ** 2)) == pytest.approx(10.0 ** (0.1 * EQUATION["Pr_dBm"]), rel=1e-5)


def test_approaching_targets_turn_backwards_from_chirp_to_chirp() -> None:
    """10 m/s towards the radar: 5.1 kHz in amount; the phase 4 pi R / lambda falls with the range."""
    radar = oracle_radar()
    target = Scatterers.from_rcs(torch.tensor([[50.0, 0.0, 0.0]], dtype=torch.float64), 0.0, -10.0)
    first_samples = beat_signal(target, radar)[0, :, 0].numpy().astype(np.complex128)
    wanted = -FMCW["doppler_Hz_v10_approaching"] * radar.chirp_period_s
    assert highest(first_samples, wanted + 1e-3) == pytest.approx(wanted, abs=2e-5)  # second order of the blocks


def test_one_square_metre_at_50_m_comes_out_at_111_dbm_below() -> None:
    radar = oracle_radar()
    chain = FmcwRadar(radar, noise=False)
    target = Scatterers.from_rcs(torch.tensor([[50.0, 0.0, 0.0]], dtype=torch.float64), 0.0)
    points = chain(target)
    point = points[points[:, 4].argmax()]
    assert float(point[:3].norm()) == pytest.approx(50.0, abs=0.02 * radar.range_resolution_m)
    assert float(point[4]) == pytest.approx(EQUATION["Pr_dBm"], abs=0.02)
    assert float(point[5]) == pytest.approx(0.0, abs=0.02)
