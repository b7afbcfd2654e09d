"""An FMCW radar's samples, one scatterer at a time, straight from the equations; and what they must show.

The slow, readable oracle of the FMCW chain, in float64. It shares no line with ``torchweather``: it reads the plain
fields of a ``Radar`` and nothing else, so the two can only agree by being right. Parts:

- ``every_sample`` is the beat signal of some scatterers;
- ``strongest_echo`` finds range, speed and angles of the strongest one by trying them, without any FFT;
- ``noise_power_mw`` is the thermal noise;
- ``shell_covariance_mw``, ``cell_power_mw`` and ``shell_speed`` are the mean echo of particles that fill the air.

Radar frame: x forward, y left, z up; speeds positive when receding; powers in mW, signals in sqrt(mW).

References: PHYSICS.md 6.2 (radar equation), 6.4 (samples), 6.5 (reflectivity to power), 6.8 (noise).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from itertools import pairwise, product
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = [
    "ChirpRadar",
    "cell_power_mw",
    "every_sample",
    "line_of_sight",
    "noise_power_mw",
    "one_way_gain",
    "receive_power_mw",
    "shell_covariance_mw",
    "shell_speed",
    "strongest_echo",
    "tone",
]

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

C = 299_792_458.0  # m/s, exact
K_BOLTZMANN = 1.380649e-23  # J/K, exact
T0 = 290.0  # K, PHYSICS.md 6.8
PATTERN_FLOOR = 1e-3  # one-way gain of an element never falls further below its peak (stated with the sensor)
NODES = 64  # Gauss-Legendre nodes of each smooth piece


class ChirpRadar(Protocol):
    """The fields of a radar that the equations need."""

    frequency_ghz: float
    transmit_power_dbm: float
    antenna_gain_dbi: float
    azimuth_beamwidth_deg: float
    elevation_beamwidth_deg: float
    loss_db: float
    noise_figure_db: float
    bandwidth_mhz: float
    samples: int
    sample_rate_mhz: float
    chirp_period_us: float
    chirps: int
    tx_half_wavelengths: tuple[tuple[float, float], ...]
    rx_half_wavelengths: tuple[tuple[float, float], ...]


def every_sample(
    radar: ChirpRadar,
    position_m: ArrayLike,
    speed_m_per_s: ArrayLike,
    rcs_m2: ArrayLike,
    phase_rad: ArrayLike,
    attenuation_db: ArrayLike = 0.0,
) -> Complex:
    """Beat signal ``s[q, m, n]`` of PHYSICS.md 6.4; one-way element patterns count twice, attenuation is two-way."""
    position = np.asarray(position_m, dtype=np.float64).reshape(-1, 3)
    count = len(position)
    speed, rcs, phase, loss = (
        np.broadcast_to(np.asarray(value, dtype=np.float64), (count,))
        for value in (speed_m_per_s, rcs_m2, phase_rad, attenuation_db)
    )
    wavelength, slope, chirp_period = _carrier(radar)
    half = wavelength / 2.0
    senders, listeners = len(radar.tx_half_wavelengths), len(radar.rx_half_wavelengths)
    n = np.arange(radar.samples)
    out = np.zeros((senders * listeners, radar.chirps, radar.samples), dtype=np.complex128)
    for i in range(count):
        distance, azimuth, elevation = _spherical(position[i])
        u = position[i] / distance
        power = receive_power_mw(radar, rcs[i], distance, azimuth, elevation) * 10.0 ** (-loss[i] / 10.0)
        for k, tx in enumerate(radar.tx_half_wavelengths):
            for r, rx in enumerate(radar.rx_half_wavelengths):
                shorter = half * (u[1] * (tx[0] + rx[0]) + u[2] * (tx[1] + rx[1]))
                for m in range(radar.chirps):
                    t = (m * senders + k) * chirp_period
                    away = distance + speed[i] * t
                    beat_hz = 2.0 * slope * away / C + 2.0 * speed[i] / wavelength
                    constant = 4.0 * math.pi / wavelength * away - 2.0 * math.pi / wavelength * shorter + phase[i]
                    angle = 2.0 * math.pi * beat_hz * n / (1e6 * radar.sample_rate_mhz) + constant
                    out[k * listeners + r, m] += math.sqrt(power) * np.exp(1j * angle)
    return out


def receive_power_mw(
    radar: ChirpRadar, rcs_m2: float, range_m: float, azimuth_rad: float, elevation_rad: float
) -> float:
    """Radar equation of PHYSICS.md 6.2, without the path's attenuation."""
    wavelength = _carrier(radar)[0]
    gain = 10.0 ** (radar.antenna_gain_dbi / 10.0) * float(one_way_gain(radar, azimuth_rad, elevation_rad))
    sent = 10.0 ** (radar.transmit_power_dbm / 10.0)
    spread = (4.0 * math.pi) ** 3 * range_m**4
    return sent * gain**2 * wavelength**2 * rcs_m2 / spread / 10.0 ** (radar.loss_db / 10.0)


def one_way_gain(radar: ChirpRadar, azimuth_rad: ArrayLike, elevation_rad: ArrayLike) -> Array:
    """Gain of one element over its peak: 1/2 at half of each full width at half power."""
    across = np.degrees(np.asarray(azimuth_rad)) / (radar.azimuth_beamwidth_deg / 2.0)
    up = np.degrees(np.asarray(elevation_rad)) / (radar.elevation_beamwidth_deg / 2.0)
    return np.maximum(0.5 ** (across**2 + up**2), PATTERN_FLOOR)


def noise_power_mw(radar: ChirpRadar) -> float:
    """Thermal noise of one complex sample, half of it in I and half in Q: ``k T0 fs F``."""
    return 1e3 * K_BOLTZMANN * T0 * 1e6 * radar.sample_rate_mhz * 10.0 ** (radar.noise_figure_db / 10.0)


def tone(signal: ArrayLike, cycles_per_sample: float) -> complex:
    """The transform of one row of samples at any frequency, over its length: a unit tone there gives 1."""
    row = np.asarray(signal, dtype=np.complex128)
    return complex(np.mean(row * np.exp(-2j * math.pi * cycles_per_sample * np.arange(row.size))))


def line_of_sight(azimuth_rad: float, elevation_rad: float) -> Array:
    """Unit vector from the radar."""
    flat = math.cos(elevation_rad)
    return np.array([flat * math.cos(azimuth_rad), flat * math.sin(azimuth_rad), math.sin(elevation_rad)])


def strongest_echo(
    radar: ChirpRadar, cube: ArrayLike, start: tuple[float, float, float, float], rounds: int = 8
) -> tuple[float, float, float, float, float]:
    """Range, speed, azimuth, elevation and power (mW) whose samples resemble the cube most, near a start.

    Range and speed together, then both angles together, are tried on a grid of one resolution cell either side, which
    shrinks by two each round.
    The power is that of the projection on a unit echo, the least-squares fit.
    """
    signal = np.asarray(cube, dtype=np.complex128)
    wavelength = _carrier(radar)[0]
    frame = radar.chirps * len(radar.tx_half_wavelengths) * radar.chirp_period_us * 1e-6
    tx, rx = np.array(radar.tx_half_wavelengths), np.array(radar.rx_half_wavelengths)
    array = (tx[:, None] + rx[None]).reshape(-1, 2)
    reach = [C / (2e6 * radar.bandwidth_mhz), wavelength / (2.0 * frame)]
    reach += [1.0 / (1.0 + float(np.ptp(array[:, axis]))) for axis in (0, 1)]
    best = list(start)
    for _ in range(rounds):
        for first in (0, 2):
            grid = product(*(best[axis] + reach[axis] * _TRIES for axis in (first, first + 1)))
            tried = [[*best[:first], *pair, *best[first + 2 :]] for pair in grid]
            best = max(tried, key=lambda guess: abs(_likeness(radar, signal, guess)))
        reach = [value / 2.0 for value in reach]
    return best[0], best[1], best[2], best[3], abs(_likeness(radar, signal, best)) ** 2


def shell_covariance_mw(
    radar: ChirpRadar,
    eta_m2_per_m3: float,
    near_m: float,
    far_m: float,
    attenuation_db_per_km: float = 0.0,
    velocity_m_per_s: ArrayLike = (0.0, 0.0, 0.0),
    spread_m_per_s: ArrayLike = (0.0, 0.0, 0.0),
) -> Complex:
    """``E[s_q conj(s_p)]`` of the particles between two ranges over the half space ahead, ``(V, V)``.

    ``int eta P(R, az, el) exp(-j pi u.(h_q - h_p)) 10^(-2 gamma R / 10) R^2 cos(el) dR daz del``; ``h`` in half
    wavelengths. The diagonal is the mean power of a channel. Elements of two transmitters sample ``tau`` apart, by when
    particles of normally distributed radial speed have turned by ``E[exp(j 4 pi v tau / lambda)]``.
    """
    flux = eta_m2_per_m3 * _radial_integral(near_m, far_m, attenuation_db_per_km) * receive_power_mw(radar, 1, 1, 0, 0)
    azimuth, elevation, weight = _directions(radar)
    tx, rx = np.array(radar.tx_half_wavelengths), np.array(radar.rx_half_wavelengths)
    array = (tx[:, None] + rx[None]).reshape(-1, 2)
    left, up = np.cos(elevation) * np.sin(azimuth), np.sin(elevation)
    mean, std = _radial_speed(azimuth, elevation, velocity_m_per_s, spread_m_per_s)
    wavelength, _, chirp_period = _carrier(radar)
    out = np.zeros((len(array), len(array)), dtype=np.complex128)
    for q, p in product(range(len(array)), repeat=2):
        tau = (q // len(rx) - p // len(rx)) * chirp_period
        apart = array[q] - array[p]
        phase = 4.0 * math.pi / wavelength * mean * tau - math.pi * (apart[0] * left + apart[1] * up)
        kept = np.exp(-0.5 * (4.0 * math.pi / wavelength * std * tau) ** 2)
        out[q, p] = flux * np.sum(weight * kept * np.exp(1j * phase))
    return out


def cell_power_mw(
    radar: ChirpRadar,
    eta_m2_per_m3: float,
    bin_index: int,
    near_m: float,
    far_m: float,
    attenuation_db_per_km: float = 0.0,
    taper: ArrayLike | None = None,
) -> float:
    """Mean power of one channel in one bin of the range transform, particles between two ranges at rest.

    The transform divides by the sum of the taper (ones: no window), so a target in a bin's middle keeps its power.
    """
    weights = np.ones(radar.samples) if taper is None else np.asarray(taper, dtype=np.float64)
    n = np.arange(radar.samples)

    def kept(range_m: Array) -> Array:
        beat = 2e6 * radar.bandwidth_mhz * range_m / C - bin_index  # bins
        transform = np.exp(2j * math.pi * np.outer(beat, n) / radar.samples) @ weights / weights.sum()
        return np.abs(transform) ** 2

    flux = eta_m2_per_m3 * _radial_integral(near_m, far_m, attenuation_db_per_km, kept, C / (2e6 * radar.bandwidth_mhz))
    return flux * receive_power_mw(radar, 1, 1, 0, 0) * float(_directions(radar)[2].sum())


def shell_speed(
    radar: ChirpRadar,
    velocity_m_per_s: ArrayLike,
    spread_m_per_s: ArrayLike = (0.0, 0.0, 0.0),
) -> tuple[float, float]:
    """Power-weighted mean and standard deviation of the radial speed of particles that move alike.

    ``spread`` is the standard deviation of their velocity along x, y and z, independent of where they are.
    """
    azimuth, elevation, weight = _directions(radar)
    radial, inner = _radial_speed(azimuth, elevation, velocity_m_per_s, spread_m_per_s)
    share = weight / weight.sum()
    mean = float(share @ radial)
    return mean, math.sqrt(float(share @ ((radial - mean) ** 2 + inner**2)))


_TRIES = np.linspace(-1.0, 1.0, 9)


def _likeness(radar: ChirpRadar, signal: Complex, guess: list[float]) -> complex:
    """Projection of the samples on a unit echo of this range, speed and direction."""
    range_m, speed, azimuth, elevation = guess
    wavelength, slope, chirp_period = _carrier(radar)
    u = line_of_sight(azimuth, elevation)
    tx, rx = np.array(radar.tx_half_wavelengths), np.array(radar.rx_half_wavelengths)
    shorter = math.pi * ((tx @ u[1:])[:, None] + (rx @ u[1:])[None])  # (senders, listeners)
    m, k, n = np.arange(radar.chirps), np.arange(len(tx)), np.arange(radar.samples)
    t = (m[None] * len(tx) + k[:, None]) * chirp_period  # (senders, chirps)
    away = range_m + speed * t
    beat = (2.0 * slope * away / C + 2.0 * speed / wavelength) / (1e6 * radar.sample_rate_mhz)
    echo = np.exp(2j * math.pi * (beat[..., None] * n + 2.0 * away[..., None] / wavelength))  # (senders, chirps, n)
    given = signal.reshape(len(tx), len(rx), radar.chirps, radar.samples)
    chirp_sum = np.einsum("krmn,kmn->kr", given, echo.conj())
    return complex((chirp_sum * np.exp(1j * shorter)).sum() / signal.size)


def _carrier(radar: ChirpRadar) -> tuple[float, float, float]:
    """Wavelength in m, slope of the chirp in Hz/s, time from chirp to chirp in s."""
    active_s = radar.samples / (1e6 * radar.sample_rate_mhz)
    return C / (1e9 * radar.frequency_ghz), 1e6 * radar.bandwidth_mhz / active_s, 1e-6 * radar.chirp_period_us


def _spherical(position_m: Array) -> tuple[float, float, float]:
    """Range, azimuth, elevation."""
    x, y, z = (float(value) for value in position_m)
    distance = math.sqrt(x * x + y * y + z * z)
    return distance, math.atan2(y, x), math.asin(z / distance)


def _radial_integral(
    near_m: float,
    far_m: float,
    attenuation_db_per_km: float,
    kept: Callable[[Array], Array] | None = None,
    piece_m: float | None = None,
) -> float:
    """``int R^-4 R^2 10^(-2 gamma R / 10) kept(R) dR``, by pieces no longer than given or than a tenth of the range."""
    edges = [near_m]
    while edges[-1] < far_m:
        edges.append(min(edges[-1] + min(0.1 * edges[-1], piece_m or math.inf), far_m))
    node, weight = np.polynomial.legendre.leggauss(NODES if kept is None else 16)
    total = 0.0
    for low, high in pairwise(edges):
        r = 0.5 * (low + high) + 0.5 * (high - low) * node
        value = r**-2 * 10.0 ** (-2.0 * attenuation_db_per_km * r * 1e-3 / 10.0)
        total += float(0.5 * (high - low) * weight @ (value if kept is None else value * kept(r)))
    return total


def _radial_speed(
    azimuth: Array, elevation: Array, velocity_m_per_s: ArrayLike, spread_m_per_s: ArrayLike
) -> tuple[Array, Array]:
    """Mean and standard deviation of the radial speed in each direction."""
    flat = np.cos(elevation)
    u = np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)], -1)
    mean: Array = u @ np.asarray(velocity_m_per_s, dtype=np.float64)
    return mean, np.sqrt(u**2 @ np.asarray(spread_m_per_s, dtype=np.float64) ** 2)


def _directions(radar: ChirpRadar) -> tuple[Array, Array, Array]:
    """Azimuth, elevation of nodes over the half space ahead; weight: both ways' pattern times cos(el) daz del."""
    node, width = np.polynomial.legendre.leggauss(4 * NODES)
    angle, piece = 0.5 * math.pi * node, 0.5 * math.pi * width
    azimuth, elevation = (each.ravel() for each in np.meshgrid(angle, angle, indexing="ij"))
    area = np.outer(piece, piece).ravel() * np.cos(elevation)
    return azimuth, elevation, one_way_gain(radar, azimuth, elevation) ** 2 * area
