"""Directions from the phases of the virtual channels, against naive sums over them."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from torch import Tensor

from tests.reference import every_sample
from torchweather.radar import Scatterers, angle_grid, beat_signal, range_doppler, range_doppler_angle
from torchweather.radar.fmcw.angles import spectrum_peaks, steering
from torchweather.sensors import Radar

PRESETS = ["awr1843-like", "imaging-77ghz"]


def elements(radar: Radar) -> np.ndarray[tuple[int, int], np.dtype[np.float64]]:
    """Positions in half wavelengths, from the fields alone."""
    pairs = [(tx[0] + rx[0], tx[1] + rx[1]) for tx in radar.tx_half_wavelengths for rx in radar.rx_half_wavelengths]
    return np.array(pairs)


def channels_of(radar: Radar, *directions: tuple[float, float, complex]) -> Tensor:
    """``(1, V)`` signals of plane waves from direction cosines (left, up), each with its amplitude."""
    total = sum(
        amplitude * np.exp(-1j * math.pi * (elements(radar) @ np.array([left, up])))
        for left, up, amplitude in directions
    )
    return torch.from_numpy(np.asarray(total)).to(torch.complex64)[None]


@pytest.mark.parametrize("preset", PRESETS)
def test_steering_adds_up_a_wave_from_its_direction(preset: str) -> None:
    radar = Radar.preset(preset)
    for left, up in ((0.0, 0.0), (0.37, -0.21), (-0.8, 0.1)):
        wave = channels_of(radar, (left, up, 2.0))
        weights = steering(torch.tensor([left, up], dtype=torch.float64), radar)
        assert complex((wave[0] * weights).sum()) == pytest.approx(2.0, abs=1e-5)


@pytest.mark.parametrize("preset", PRESETS)
def test_a_single_wave_is_found_between_grid_points(preset: str) -> None:
    """Within 2 % of a beam and 0.1 dB: the parabola through three points of a grid of a quarter of a beam."""
    radar = Radar.preset(preset)
    beams = 2.0 / (1.0 + np.ptp(elements(radar), axis=0))
    rng = np.random.default_rng(0)
    worst = np.zeros(3)
    for _ in range(50):
        left, up = rng.uniform(-0.7, 0.7), rng.uniform(-0.3, 0.3)
        cosines, power = spectrum_peaks(channels_of(radar, (left, up, 1.0)), radar, 4, 10.0)
        best = int(power[0].argmax())
        off = np.abs(cosines[0, best].numpy() - np.array([left, up])) / beams
        worst = np.maximum(worst, [*off, abs(10.0 * math.log10(float(power[0, best])))])
    assert worst[0] < 0.02
    assert worst[1] < (0.02 if preset == "imaging-77ghz" else 0.05)
    assert worst[2] < 0.1


def test_two_waves_two_beams_apart_are_two() -> None:
    radar = Radar.preset("imaging-77ghz")
    beam = 2.0 / 32
    wave = channels_of(radar, (-beam, 0.0, 1.0), (beam, 0.0, 1.0j))
    cosines, power = spectrum_peaks(wave, radar, 4, 10.0)
    assert int((power[0] > 0).sum()) == 2
    assert cosines[0, :2, 0].sort().values.tolist() == pytest.approx([-beam, beam], abs=0.2 * beam)


def test_sidelobes_below_the_dynamic_range_are_left_out() -> None:
    """The first sidelobe of a full row is 13 dB down."""
    radar = Radar.preset("imaging-77ghz")
    wave = channels_of(radar, (0.1, 0.0, 1.0))
    counted = {dynamic: int((spectrum_peaks(wave, radar, 8, dynamic)[1] > 0).sum()) for dynamic in (12.0, 16.0)}
    assert counted[12.0] == 1
    assert counted[16.0] > 1


@pytest.mark.parametrize("preset", PRESETS)
def test_the_map_over_directions_is_the_naive_sum(preset: str) -> None:
    """Each cell: map of the channels, the turns of the transmitters taken out for the bin's speed, phases added up."""
    radar = Radar.preset(preset, chirps=4, samples=4)
    rng = np.random.default_rng(1)
    shape = (radar.virtual_channels, 4, 4)
    cube = torch.from_numpy(rng.normal(size=shape) + 1j * rng.normal(size=shape))
    found = range_doppler_angle(cube, radar, "rectangular")
    left, up = angle_grid(radar)
    assert found.shape == (len(left), len(up), 4, 4)
    channels = range_doppler(cube, radar, "rectangular").numpy()
    order = np.repeat(np.arange(len(radar.tx_half_wavelengths)), len(radar.rx_half_wavelengths))
    for _ in range(20):
        i, j = int(rng.integers(len(left))), int(rng.integers(len(up)))
        doppler, column = int(rng.integers(4)), int(rng.integers(4))
        speed = (doppler - 2) * radar.speed_resolution_m_per_s
        late = 4.0 * math.pi / radar.wavelength_m * speed * order * radar.chirp_period_s
        phase = math.pi * (elements(radar) @ np.array([float(left[i]), float(up[j])])) - late
        wanted = np.mean(channels[:, doppler, column] * np.exp(1j * phase))
        assert complex(found[i, j, doppler, column]) == pytest.approx(wanted, abs=1e-6)


@pytest.mark.parametrize(("azimuth_rad", "elevation_rad"), [(0.4, 0.0), (-0.5, 0.1), (0.0, -0.15)])
def test_left_is_left_and_up_is_up(azimuth_rad: float, elevation_rad: float) -> None:
    radar = Radar.preset("awr1843-like", chirps=2, samples=8)
    target = Scatterers.from_spherical(torch.tensor([0.6]).double(), azimuth_rad, elevation_rad, 0.0)
    power = range_doppler_angle(beat_signal(target, radar), radar, "rectangular").abs().square().amax((2, 3))
    left, up = angle_grid(radar)
    row, column = divmod(int(power.argmax()), len(up))
    direction = every_sample.line_of_sight(azimuth_rad, elevation_rad)
    assert float(left[row]) == pytest.approx(direction[1], abs=float(left[1] - left[0]))
    assert float(up[column]) == pytest.approx(direction[2], abs=float(up[1] - up[0]))
    wanted = every_sample.receive_power_mw(radar, 1.0, 0.6, azimuth_rad, elevation_rad)
    assert float(power.max()) > 0.5 * wanted  # between bins and grid points


def test_an_array_that_is_flat_sees_no_elevation() -> None:
    radar = Radar(rx_half_wavelengths=tuple((float(k), 0.0) for k in range(8)))
    left, up = angle_grid(radar)
    assert up.tolist() == [0.0]
    assert left.diff().max() <= 0.25 * 2.0 / 8 + 1e-12
    cosines, _ = spectrum_peaks(channels_of(radar, (0.3, 0.0, 1.0)), radar, 1, 10.0)
    assert cosines[0, 0].tolist() == pytest.approx([0.3, 0.0], abs=0.02 * 2.0 / 8)


def test_slopes_of_the_angle_are_one() -> None:
    radar = Radar.preset("imaging-77ghz")
    left = torch.tensor(0.123, dtype=torch.float64, requires_grad=True)
    phase = -math.pi * torch.from_numpy(elements(radar)[:, 0]) * left
    wave = torch.polar(torch.ones_like(phase), phase)[None].to(torch.complex64)
    cosines, power = spectrum_peaks(wave, radar, 1, 10.0)
    slope = torch.autograd.grad(cosines[0, 0, 0], left)[0]
    assert float(slope) == pytest.approx(1.0, abs=0.1)  # of the parabola between its points
    assert power[0, 0].item() == pytest.approx(1.0, abs=0.02)
