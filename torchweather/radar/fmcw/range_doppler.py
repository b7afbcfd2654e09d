"""Range-Doppler-angle maps: the windowed transforms over samples, chirps and virtual channels."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from torchweather.core.arguments import check_arguments
from torchweather.core.errors import InputTypeError, InputValueError
from torchweather.physics import SPEED_OF_LIGHT_M_PER_S
from torchweather.radar.fmcw.windows import noise_bandwidth, window
from torchweather.radar.sensor import Radar

__all__ = [
    "check_cube",
    "map_noise_dbm",
    "range_doppler",
    "range_m_of_bin",
    "speed_m_per_s_of_bin",
    "transmitter_rotation",
    "weights_of",
]


def check_cube(cube: Tensor, radar: Radar, owner: object) -> None:
    """Raise unless the cube is complex and ``(..., V, N_c, N_s)`` of the radar."""
    wanted = (radar.virtual_channels, radar.chirps, radar.samples)
    name = owner if isinstance(owner, str) else type(owner).__name__
    if not isinstance(cube, Tensor) or not cube.is_complex():
        got = cube.dtype if isinstance(cube, Tensor) else type(cube).__name__
        raise InputTypeError(f"{name}: cube must be a complex tensor (..., V, chirps, samples); got {got}.")
    if tuple(cube.shape[-3:]) != wanted:
        raise InputValueError(
            f"{name}: cube must be (..., {wanted[0]} virtual channels, {wanted[1]} chirps, {wanted[2]} samples), "
            f"those of the radar; got {tuple(cube.shape)}."
        )


def weights_of(radar: Radar, window_name: str) -> Tensor:
    """``(N_c, N_s)`` weights of both transforms, complex128; their turn a chirp puts speed 0 at bin ``N_c // 2``."""
    turn = torch.arange(radar.chirps, dtype=torch.float64) * (radar.chirps // 2) / radar.chirps
    chirps = window(window_name, radar.chirps) * torch.exp(2j * math.pi * turn)
    return chirps[:, None] * window(window_name, radar.samples)


def range_doppler(cube: Tensor, radar: Radar, window_name: str = "hann") -> Tensor:
    """Windowed range-Doppler map of each virtual channel.

    Args:
        cube: ``(..., V, N_c, N_s)`` complex samples, square root of milliwatts.
        radar: the sensor.
        window_name: one of ``WINDOWS``, for both transforms.

    Returns:
        ``(..., V, N_c, N_s)`` complex: Doppler bin (speed 0 at ``N_c // 2``, receding above), range bin. A scatterer in
        the middle of a bin shows its received power, ``10 log10 |.|^2`` in dBm.

    Note:
        The transmitters' turns are not taken out here: see ``transmitter_rotation``.

    References:
        PHYSICS.md 6.4.

    Example:
        >>> radar = Radar.preset("awr1843-like")
        >>> range_doppler(torch.zeros(12, 128, 256, dtype=torch.complex64), radar).shape
        torch.Size([12, 128, 256])
    """
    check_arguments("range_doppler(cube: Tensor, radar: Radar, window_name: str)", cube, radar, window_name)
    check_cube(cube, radar, "range_doppler")
    weights = weights_of(radar, window_name).to(cube.device, cube.dtype)
    found: Tensor = torch.fft.fft2(cube * weights)
    return found


def map_noise_dbm(radar: Radar, window_name: str = "hann") -> float:
    """Thermal noise in one bin of one channel's map, dBm.

    Example:
        >>> round(map_noise_dbm(Radar.preset("awr1843-like")), 1)
        -131.6
    """
    check_arguments("map_noise_dbm(radar: Radar, window_name: str)", radar, window_name)
    bandwidth = noise_bandwidth(window_name, radar.samples) * noise_bandwidth(window_name, radar.chirps)
    return radar.noise_power_dbm + 10.0 * math.log10(bandwidth)


def speed_m_per_s_of_bin(doppler_bin: Tensor, radar: Radar) -> Tensor:
    """Radial speed of a Doppler bin, whole or between two; the bins are a circle, from ``-max_speed_m_per_s`` up."""
    turns = torch.remainder(doppler_bin - radar.chirps // 2 + 0.5 * radar.chirps, radar.chirps) - 0.5 * radar.chirps
    return turns * radar.speed_resolution_m_per_s / carrier_share(radar)


def carrier_share(radar: Radar) -> float:
    """Frequency in the middle of the sampled sweep over the carrier's, by which a range bin's phase turns faster."""
    return 1.0 + 0.5e-3 * radar.bandwidth_mhz / radar.frequency_ghz * (1.0 - 1.0 / radar.samples)


def range_m_of_bin(range_bin: Tensor, speed_m_per_s: Tensor, radar: Radar) -> Tensor:
    """Range at the begin of the frame of what shows in a range bin.

    The beat holds the Doppler shift too, and in the middle of the frame the target has gone on for half of it.
    """
    shift = speed_m_per_s * SPEED_OF_LIGHT_M_PER_S / (radar.wavelength_m * radar.slope_hz_per_s)
    middle_s = 0.5 * (radar.chirps * radar.transmitters - 1) * radar.chirp_period_s
    return range_bin * radar.range_resolution_m - shift - speed_m_per_s * middle_s


def transmitter_rotation(speed_m_per_s: Tensor, radar: Radar) -> Tensor:
    """``(..., V)`` complex64 factors that take out the way a target went until each transmitter's turn.

    Transmitter k sends k T_c after the first, by when the echo has turned by ``4 pi v k T_c / lambda``.

    Args:
        speed_m_per_s: ``(...)`` of the target. Of one faster than ``max_speed_m_per_s`` the map shows another speed,
            and with that its angle comes out wrong.
    """
    channel = torch.arange(radar.virtual_channels, device=speed_m_per_s.device)
    turn_s = (channel // radar.receivers) * radar.chirp_period_s
    phase = (-4.0 * math.pi / radar.wavelength_m * carrier_share(radar)) * speed_m_per_s[..., None].double() * turn_s
    return torch.polar(torch.ones_like(phase), phase).to(torch.complex64)
