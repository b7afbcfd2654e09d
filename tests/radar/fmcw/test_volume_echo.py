"""Echo of rain and snow in the samples against integrals over all the drops in front of the radar."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
import torch
from torch import Tensor

from tests.reference import every_sample
from torchweather.atmosphere.weather import Rain, Snow, Weather
from torchweather.physics import reflectivity_weighted_fall_speed
from torchweather.radar import FmcwRadar, Scatterers, VolumeEcho, range_doppler
from torchweather.sensors import Radar

FRAMES = 48
# One channel, 19.2 m in 128 bins; unambiguous to 19.5 m/s
SINGLE = Radar(samples=128, chirps=32, azimuth_beamwidth_deg=30.0, elevation_beamwidth_deg=20.0)
ARRAY = replace(
    SINGLE,
    samples=32,
    tx_half_wavelengths=((0.0, 0.0), (4.0, 1.0), (8.0, 0.0)),
    rx_half_wavelengths=((0.0, 0.0), (1.0, 0.0), (2.0, 1.0)),
)
RAIN = Rain(rate_mm_per_h=25.0)
GAMMA_DB_PER_KM = 1.13197 * 25.0**0.71768  # P.838-3 at 77 GHz, H; PHYSICS.md 6.5
TURBULENCE = 0.5  # m/s, the default


def nothing_there(frames: int) -> Scatterers:
    return Scatterers(torch.ones(frames, 1, 3), torch.zeros(frames, 1), torch.zeros(frames, 1, dtype=torch.complex64))


def echoes(radar: Radar, weather: Weather, frames: int = FRAMES, **options: float) -> Tensor:
    """Samples of the weather alone, ``(frames, V, N_c, N_s)``."""
    chain = FmcwRadar(radar, weather, noise=False, **options)  # type: ignore[arg-type]
    return chain.cube(nothing_there(frames), chain.draw(nothing_there(frames), seed=5))


def spectra(values: Tensor) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    """Mean and its standard error over independent frames, ``(2, ...)``."""
    found = values.double()
    return torch.stack([found.mean(0), found.std(0) / math.sqrt(len(found))]).numpy()


@lru_cache
def rain_in_ranges() -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    """Mean power and its standard error in each range bin, after Hann's window."""
    taper = torch.hann_window(SINGLE.samples, periodic=True)
    bins = torch.fft.fft(echoes(SINGLE, RAIN) * taper / taper.sum(), dim=-1)
    return spectra(bins.abs().square().mean((1, 2)))


def moments(radar: Radar) -> tuple[float, float, float]:
    """Reflectivity, fall speed and its standard deviation."""
    eta, fall, std = reflectivity_weighted_fall_speed(RAIN.distribution(25.0), radar.frequency_ghz)
    return float(eta), float(fall), float(std)


def test_each_range_bin_has_the_power_of_its_drops() -> None:
    mean, error = rain_in_ranges()
    taper = torch.hann_window(SINGLE.samples, periodic=True).numpy()
    off = []
    for cell in range(12, 124, 3):  # neighbours of a window share power: every third
        wanted = every_sample.cell_power_mw(SINGLE, moments(SINGLE)[0], cell, 1.0, 19.1, GAMMA_DB_PER_KM, taper)
        assert error[cell] < 0.15 * wanted
        off.append((mean[cell] / wanted - 1.0) / (error[cell] / wanted))
    # 38 normal deviates: one beyond 4.2 in 1,000 draws, their mean beyond 3.3 / sqrt(38)
    assert np.abs(off).max() < 4.2
    assert abs(np.mean(off)) < 3.3 / math.sqrt(len(off))


def test_the_whole_echo_has_the_power_of_all_drops() -> None:
    """Within four standard errors, which are 2 % of it: a factor of 1.4 in the beam's area (6.5) would be seen."""
    power, error = spectra(echoes(SINGLE, RAIN).abs().square().mean((1, 2, 3)))
    near_m = 7 * SINGLE.range_resolution_m - 0.5 * SINGLE.range_resolution_m  # the first bin beyond 1 m
    far_m = (SINGLE.samples - 0.5) * SINGLE.range_resolution_m
    wanted = every_sample.shell_covariance_mw(SINGLE, moments(SINGLE)[0], near_m, far_m, GAMMA_DB_PER_KM)[0, 0].real
    assert error < 0.04 * wanted
    assert power == pytest.approx(wanted, abs=4.0 * error)


def test_the_echo_falls_with_the_square_of_the_range_and_the_way_there_and_back() -> None:
    """Slope of dB over dB, after the two-way attenuation: -20 dB a decade; of a single target -40."""
    mean, error = rain_in_ranges()
    cells = np.arange(12, 124, 3)
    range_m = cells * SINGLE.range_resolution_m
    level = 10.0 * np.log10(mean[cells]) + 2.0 * GAMMA_DB_PER_KM * range_m * 1e-3
    weight = mean[cells] / error[cells]
    (slope, _), covariance = np.polyfit(np.log10(range_m), level, 1, w=weight, cov=True)
    assert slope == pytest.approx(-20.0, abs=4.0 * math.sqrt(covariance[0, 0]))
    assert math.sqrt(covariance[0, 0]) < 1.0


def test_attenuation_counts_twice() -> None:
    """Fog has no echo of its own at radar wavelengths; heavier rain in the same echo has more loss on the way."""
    radar = replace(SINGLE, samples=64, bandwidth_mhz=50.0)  # 192 m
    volume = FmcwRadar(radar, RAIN, noise=False)
    ours = spectra(torch.fft.fft(volume.cube(nothing_there(16), volume.draw(nothing_there(16), seed=1))).abs() ** 2)
    dry = FmcwRadar(radar, RAIN, noise=False, rain_model="d3_4")
    other = spectra(torch.fft.fft(dry.cube(nothing_there(16), dry.draw(nothing_there(16), seed=1))).abs() ** 2)
    sander = 1.07 * 25.0**0.69  # PHYSICS.md 6.5
    ratio_db = 10.0 * np.log10(ours[0].mean((0, 1)) / other[0].mean((0, 1)))
    range_m = np.arange(64) * radar.range_resolution_m
    np.testing.assert_allclose(ratio_db[4:], -2.0 * (GAMMA_DB_PER_KM - sander) * 1e-3 * range_m[4:], atol=2e-3)


def test_the_cover_takes_its_loss() -> None:
    """3 dB, both ways together as stated: half of the power is left."""
    clear, wet = echoes(SINGLE, RAIN, 1), echoes(SINGLE, RAIN, 1, radome_loss_db=3.0)
    ratio = wet.abs().square().sum() / clear.abs().square().sum()
    assert float(10.0 * ratio.log10()) == pytest.approx(-3.0, abs=1e-3)


@pytest.mark.parametrize(
    ("wind", "ego_speed_m_per_s"), [((-7.0, 0.0, 0.0), 0.0), ((0.0, 6.0, 0.0), 0.0), ((0.0, 0.0, 0.0), 9.0)]
)
def test_the_doppler_spectrum_is_that_of_wind_and_fall(
    wind: tuple[float, float, float], ego_speed_m_per_s: float
) -> None:
    """Along the wind, across it, and from a moving vehicle; drops that fall widen it where the beam looks up.

    64 chirps: half a bin is less than the turbulence, below which the spectrum gets no narrower.
    """
    radar = replace(SINGLE, samples=32, chirps=64, elevation_beamwidth_deg=50.0)
    rain = replace(RAIN, wind_m_per_s=wind)
    volume = VolumeEcho(rain, radar, ego_speed_m_per_s=ego_speed_m_per_s)
    _, fall, fall_std = moments(radar)
    power = volume.covariance(torch.tensor([fall]), torch.tensor([fall_std]))[0, :, 0, 0].real.double()
    speed = torch.fft.fftfreq(radar.chirps).double() * 2.0 * radar.max_speed_m_per_s
    velocity = np.array(wind) - np.array([ego_speed_m_per_s, 0.0, fall])
    mean, std = every_sample.shell_speed(radar, velocity, (TURBULENCE, TURBULENCE, math.hypot(TURBULENCE, fall_std)))
    share = power / power.sum()
    found = float(share @ speed)
    assert found == pytest.approx(mean, abs=0.02)
    # 1 %: the pattern beyond 12 dB below its peak is left out
    assert float((share @ (speed - found).square()).sqrt()) == pytest.approx(std, rel=0.01)


def test_drops_that_fall_past_a_level_radar_show_no_mean_speed() -> None:
    cube = echoes(replace(SINGLE, samples=32, elevation_beamwidth_deg=50.0), RAIN)
    power = range_doppler(cube, replace(SINGLE, samples=32), "rectangular").abs().square().sum((1, 3))
    speed = (torch.arange(32) - 16) * SINGLE.speed_resolution_m_per_s
    mean, error = spectra((power * speed).sum(1) / power.sum(1))
    assert abs(mean) < 4.0 * error
    assert error < 0.1


def test_samples_have_the_spectrum_of_the_covariance() -> None:
    """What is drawn and transformed follows what is stated; bins of a spectrum are independent."""
    rain = replace(RAIN, wind_m_per_s=(-7.0, 0.0, 0.0))
    cube = echoes(replace(SINGLE, samples=32), rain)
    power = range_doppler(cube, replace(SINGLE, samples=32), "rectangular").abs().square().sum((1, 3))
    speed = (torch.arange(32) - 16) * SINGLE.speed_resolution_m_per_s
    mean, error = spectra((power * speed).sum(1) / power.sum(1))
    velocity = np.array([-7.0, 0.0, -moments(SINGLE)[1]])
    wanted = every_sample.shell_speed(SINGLE, velocity)[0]
    assert error < 0.1
    assert mean == pytest.approx(wanted, abs=4.0 * error)


def test_channels_are_correlated_as_the_drops_directions_and_speeds_have_it() -> None:
    """Sum over the Doppler bins: the covariance of all channels at one chirp, transmitters' turns included."""
    rain = replace(RAIN, wind_m_per_s=(-5.0, 2.0, 0.0))
    _, fall, fall_std = moments(ARRAY)
    found = VolumeEcho(rain, ARRAY).covariance(torch.tensor([fall]), torch.tensor([fall_std])).sum(1)[0].numpy()
    wanted = every_sample.shell_covariance_mw(
        ARRAY,
        1.0,
        10.0,
        10.1,
        velocity_m_per_s=np.array([-5.0, 2.0, -fall]),
        spread_m_per_s=(TURBULENCE, TURBULENCE, math.hypot(TURBULENCE, fall_std)),
    )
    # 3e-3: the pattern beyond 12 dB below its peak, 9e-4 of each angle, and midpoints for the integral
    np.testing.assert_allclose(found / found[0, 0].real, wanted / wanted[0, 0].real, rtol=0.0, atol=3e-3)
    assert np.abs(wanted[0, 1:]).min() < 0.5 * wanted[0, 0].real < np.abs(wanted[0, 1:]).max()


def test_drawn_channels_have_the_stated_covariance() -> None:
    cube = echoes(ARRAY, replace(RAIN, wind_m_per_s=(-5.0, 2.0, 0.0)))
    _, fall, fall_std = moments(ARRAY)
    rows = cube.permute(0, 2, 3, 1).flatten(1, 2)  # (frames, samples, V)
    each = rows.transpose(1, 2) @ rows.conj() / rows.shape[1]  # (frames, V, V)
    power = each[:, 0, 0].real.mean()
    wanted = every_sample.shell_covariance_mw(
        ARRAY,
        1.0,
        10.0,
        10.1,
        velocity_m_per_s=np.array([-5.0, 2.0, -fall]),
        spread_m_per_s=(TURBULENCE, TURBULENCE, math.hypot(TURBULENCE, fall_std)),
    )
    mean = each.mean(0) / power
    error = float((each / power).abs().square().mean().sqrt()) / math.sqrt(FRAMES)
    difference = (mean - torch.from_numpy(wanted / wanted[0, 0].real)).abs()
    assert error < 0.15
    assert float(difference.max()) < 4.5 * error  # 81 pairs


def test_echoes_are_noise_of_no_preferred_phase() -> None:
    cube = echoes(SINGLE, RAIN)
    power = float(cube.abs().square().mean())
    frames = cube.reshape(FRAMES, -1)
    circular, error = spectra(torch.view_as_real((frames**2).mean(1)).norm(dim=1) / power)
    assert circular < 0.5  # of a real signal 1; what remains are few independent Doppler bins
    mean, error = spectra(frames.mean(1).real / math.sqrt(power))
    assert abs(mean) < 4.0 * error


def test_no_rain_is_exactly_nothing() -> None:
    radar = replace(SINGLE, samples=32)
    scene = Scatterers.from_rcs(torch.tensor([[3.0, 0.2, 0.1]]), 5.0, 1.0)
    for weather in (Rain(rate_mm_per_h=0.0), Snow(rate_mm_per_h=0.0)):
        falling, clear = FmcwRadar(radar, weather), FmcwRadar(radar)
        noise = falling.draw(scene, seed=2)
        kept = {name: value for name, value in noise.items() if name.startswith("thermal_noise")}
        assert torch.equal(falling.cube(scene, noise), clear.cube(scene, kept))
    assert not echoes(radar, Rain(rate_mm_per_h=0.0), 2).any()


def test_rates_of_a_batch_are_each_their_own() -> None:
    radar = replace(SINGLE, samples=32)
    rates = torch.tensor([0.0, 5.0, 50.0])
    together = echoes(radar, Rain(rate_mm_per_h=rates), 3)
    chain = FmcwRadar(radar, Rain(rate_mm_per_h=rates), noise=False)
    noise = chain.draw(nothing_there(3), seed=5)
    assert not together[0].any()
    for row in (1, 2):
        single = FmcwRadar(radar, Rain(rate_mm_per_h=float(rates[row])), noise=False)
        alone = single.cube(nothing_there(1), {name: value[row : row + 1] for name, value in noise.items()})
        torch.testing.assert_close(together[row : row + 1], alone, rtol=1e-4, atol=1e-5 * float(alone.abs().max()))


def test_clutter_can_be_left_out_and_attenuation_stays() -> None:
    radar = replace(SINGLE, samples=32)
    scene = Scatterers.from_rcs(torch.tensor([[4.0, 0.0, 0.0]]), 5.0)
    dry = FmcwRadar(radar, noise=False).cube(scene, {})
    wet = FmcwRadar(radar, RAIN, noise=False, clutter=False).cube(scene, {})
    lost = 20.0 * math.log10(float(dry.abs().max() / wet.abs().max()))
    assert lost == pytest.approx(2.0 * GAMMA_DB_PER_KM * 4e-3, rel=1e-3)


def test_what_does_not_fall_has_no_volume() -> None:
    with pytest.raises(TypeError, match=r"weather must be a Rain or a Snow; got Radar"):
        VolumeEcho(SINGLE, SINGLE)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match=r"near_m.*got -1"):
        VolumeEcho(RAIN, SINGLE, near_m=-1.0)
    with pytest.raises(ValueError, match=r"turbulence_m_per_s.*got -0\.5"):
        VolumeEcho(RAIN, SINGLE, turbulence_m_per_s=-0.5)
