"""Range-Doppler maps against naive sums, and what a bin's number means."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch

from tests.reference import every_sample
from torchweather.radar import WINDOWS, FmcwRadar, Scatterers, beat_signal, map_noise_dbm, range_doppler
from torchweather.radar.fmcw.range_doppler import (
    range_m_of_bin,
    speed_m_per_s_of_bin,
    transmitter_rotation,
)
from torchweather.radar.fmcw.windows import tone_place_and_loss, window
from torchweather.sensors import Radar

RADAR = Radar(
    samples=20, chirps=12, tx_half_wavelengths=((0.0, 0.0), (2.0, 0.0)), rx_half_wavelengths=((0.0, 0.0), (1.0, 0.0))
)
# Loss of a tone between two bins, dB, and equivalent noise bandwidth, bins: Harris 1978, table 1; the loss of Hamming's
# window, printed there as 1.78, from Heinzel, Ruediger and Schilling 2002.
TEXTBOOK = {"rectangular": (3.92, 1.00), "hann": (1.42, 1.50), "hamming": (1.75, 1.36), "blackman": (1.10, 1.73)}


def tapers(name: str, length: int) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    """The windows as textbooks print them, periodic."""
    x = 2.0 * math.pi * np.arange(length) / length
    return {
        "rectangular": np.ones(length),
        "hann": np.sin(x / 2.0) ** 2,
        "hamming": 0.54 - 0.46 * np.cos(x),
        "blackman": 0.42 - 0.5 * np.cos(x) + 0.08 * np.cos(2.0 * x),
    }[name]


@pytest.mark.parametrize("name", WINDOWS)
def test_the_map_is_the_double_sum(name: str) -> None:
    rng = np.random.default_rng(0)
    cube = rng.normal(size=(4, 12, 20)) + 1j * rng.normal(size=(4, 12, 20))
    slow, fast = tapers(name, 12), tapers(name, 20)
    wanted = np.zeros_like(cube)
    for doppler in range(12):
        for column in range(20):
            across = slow * np.exp(-2j * math.pi * (doppler - 6) * np.arange(12) / 12) / slow.sum()
            along = fast * np.exp(-2j * math.pi * column * np.arange(20) / 20) / fast.sum()
            wanted[:, doppler, column] = np.einsum("qmn,m,n->q", cube, across, along)
    found = range_doppler(torch.from_numpy(cube), RADAR, name)
    np.testing.assert_allclose(found.numpy(), wanted, rtol=0.0, atol=1e-12)


@pytest.mark.parametrize("chirps", [12, 13])
@pytest.mark.parametrize("name", WINDOWS)
def test_a_target_in_the_middle_of_a_bin_shows_its_power_there(name: str, chirps: int) -> None:
    radar = Radar(samples=32, chirps=chirps)
    range_m = 9 * radar.range_resolution_m
    still = Scatterers.from_rcs(torch.tensor([[range_m, 0.0, 0.0]], dtype=torch.float64), 3.0)
    power = range_doppler(beat_signal(still, radar), radar, name)[0].abs().square()
    wanted = every_sample.receive_power_mw(radar, 10.0**0.3, range_m, 0.0, 0.0)
    assert int(power.argmax()) == (chirps // 2) * 32 + 9
    assert float(power.max()) == pytest.approx(wanted, rel=1e-5)


@pytest.mark.parametrize("speed_m_per_s", [-4.0, 5.0])
def test_receding_targets_are_in_the_upper_half(speed_m_per_s: float) -> None:
    radar = Radar(samples=32, chirps=32)
    moving = Scatterers.from_rcs(torch.tensor([[1.5, 0.0, 0.0]], dtype=torch.float64), 0.0, speed_m_per_s)
    power = range_doppler(beat_signal(moving, radar), radar)[0].abs().square()
    row, column = divmod(int(power.argmax()), 32)
    speed = float(speed_m_per_s_of_bin(torch.tensor(row), radar))
    assert speed == pytest.approx(speed_m_per_s, abs=0.55 * radar.speed_resolution_m_per_s)
    range_m = float(range_m_of_bin(torch.tensor(column), torch.tensor(speed_m_per_s), radar))
    assert range_m == pytest.approx(1.5, abs=0.55 * radar.range_resolution_m)


def test_the_doppler_shift_of_the_beat_is_taken_out_of_the_range() -> None:
    """A short chirp, so that the shift is worth more than a range bin: 2 v / lambda over 2 S / c."""
    radar = Radar(samples=64, sample_rate_mhz=2.0, chirp_period_us=32.0, chirps=64)
    shift_m = 25.0 * 299_792_458.0 / (radar.wavelength_m * radar.slope_hz_per_s)
    assert shift_m > 0.3 * radar.range_resolution_m
    moving = Scatterers.from_rcs(torch.tensor([[6.0, 0.0, 0.0]], dtype=torch.float64), 0.0, 25.0)
    points = FmcwRadar(radar, noise=False)(moving)
    point = points[points[:, 4].argmax()]
    assert float(point[:3].norm()) == pytest.approx(6.0, abs=0.1 * radar.range_resolution_m)


@pytest.mark.parametrize("name", WINDOWS)
def test_noise_in_a_bin_is_that_of_the_samples_less_the_transforms(name: str) -> None:
    radar = Radar(samples=64, chirps=64)
    power_dbm = 10.0 * math.log10(every_sample.noise_power_mw(radar))
    wanted = power_dbm - 10.0 * math.log10(64 * 64) + 2.0 * 10.0 * math.log10(TEXTBOOK[name][1])
    assert map_noise_dbm(radar, name) == pytest.approx(wanted, abs=0.05)  # the table's two decimals
    scene = Scatterers.from_rcs(torch.tensor([[1.0, 0.0, 0.0]]), -torch.inf)
    frames = Scatterers(*(value.expand(16, *value.shape) for value in vars(scene).values()))
    chain = FmcwRadar(radar, window_name=name)
    found = range_doppler(chain.cube(frames, chain.draw(frames, seed=0)), radar, name).abs().square().mean((1, 2, 3))
    # Frames are independent; 65,536 bins, of which a window leaves a third: 0.03 dB
    mean, error = float(found.mean()), float(found.std()) / 4.0
    assert error < 0.01 * mean
    assert mean == pytest.approx(10.0 ** (0.1 * map_noise_dbm(radar, name)), abs=4.5 * error)


@pytest.mark.parametrize("name", WINDOWS)
def test_windows_are_those_of_the_textbook(name: str) -> None:
    weights = window(name, 64)
    np.testing.assert_allclose(weights.numpy(), tapers(name, 64) / tapers(name, 64).sum(), rtol=0.0, atol=1e-15)
    between = abs((weights.numpy() * np.exp(2j * math.pi * 0.5 * np.arange(64) / 64)).sum())
    assert -20.0 * math.log10(between) == pytest.approx(TEXTBOOK[name][0], abs=0.02)


@pytest.mark.parametrize("name", WINDOWS)
@pytest.mark.parametrize("length", [8, 33, 128])
def test_a_tone_between_bins_is_placed_and_weighed(name: str, length: int) -> None:
    weights, n = tapers(name, length), np.arange(length)
    for place in (-0.49, -0.2, 0.0, 0.13, 0.4):
        power = [
            abs((weights * np.exp(2j * math.pi * (place - step) * n / length)).sum() / weights.sum()) ** 2
            for step in (-1, 0, 1)
        ]
        found, share = tone_place_and_loss(torch.tensor(power[0]), torch.tensor(power[2]), name, length)
        assert float(found) == pytest.approx(place, abs=1e-4)
        assert float(share) == pytest.approx(power[1], rel=1e-4)


def test_transmitters_turn_with_the_targets_speed() -> None:
    """Phase of transmitter 1 over transmitter 0: ``4 pi v T_c / lambda``, which the factors take out."""
    speed = torch.tensor([3.0, -7.0], dtype=torch.float64)
    found = transmitter_rotation(speed, RADAR)
    assert found.shape == (2, 4)
    phase = -4.0 * math.pi / RADAR.wavelength_m * speed.numpy() * RADAR.chirp_period_s
    np.testing.assert_allclose(found.numpy()[:, :2], 1.0, atol=1e-7)
    for receiver in (2, 3):
        turned = np.angle(found.numpy()[:, receiver])
        # The wavelength of the carrier or that of the middle of the sweep: B / 2f apart
        np.testing.assert_allclose(turned, phase, rtol=0.51e-3 * RADAR.bandwidth_mhz / RADAR.frequency_ghz)


def test_cubes_that_are_not_the_radars_are_refused() -> None:
    with pytest.raises(ValueError, match=r"4 virtual channels, 12 chirps, 20 samples\).*got \(4, 20, 12\)"):
        range_doppler(torch.zeros(4, 20, 12, dtype=torch.complex64), RADAR)
    with pytest.raises(TypeError, match=r"complex tensor.*got torch\.float64"):
        range_doppler(torch.zeros(4, 12, 20).double(), RADAR)
    with pytest.raises(ValueError, match=r"window must be one of .*got 'kaiser'"):
        range_doppler(torch.zeros(4, 12, 20, dtype=torch.complex64), RADAR, "kaiser")
