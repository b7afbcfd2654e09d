"""Angles: the power that arrives from each direction, from the phases of the virtual channels.

A target in direction u shows the phase ``-pi (u_y y + u_z z)`` at the virtual element (y, z), in half wavelengths. The
spectrum over a grid of (u_y, u_z) is one product with the conjugate phases, for elements wherever they stand.
"""

from __future__ import annotations

import math
from functools import lru_cache

import torch
from torch import Tensor
from torch.nn.functional import max_pool2d

from torchweather.core.arguments import check_arguments
from torchweather.radar.fmcw.range_doppler import range_doppler, speed_m_per_s_of_bin, transmitter_rotation
from torchweather.radar.sensor import Radar

__all__ = ["angle_grid", "range_doppler_angle", "spectrum_peaks", "steering"]

OVERSAMPLING = 4  # grid points across a beam: the parabola through three of them is then within 1 % of a beam
SMALLEST_POWER = 1e-30  # keeps logarithms finite


@lru_cache(maxsize=32)
def angle_grid(radar: Radar) -> tuple[Tensor, Tensor]:
    """Direction cosines ``(G_y,)`` to the left and ``(G_z,)`` up of the angle spectrum; one 0 where the array is flat.

    Example:
        >>> [len(axis) for axis in angle_grid(Radar.preset("awr1843-like"))]
        [33, 17]
    """
    check_arguments("angle_grid(radar: Radar)", radar)
    left, up = (_axis(radar.virtual_half_wavelengths[:, axis]) for axis in (0, 1))
    return left, up


def _axis(positions: Tensor) -> Tensor:
    """-1 to 1 in steps of a beam over ``OVERSAMPLING``; a beam of n elements half a wavelength apart is 2 / n wide."""
    extent = float(positions.max() - positions.min())
    if extent == 0.0:
        return torch.zeros(1, dtype=torch.float64)
    half = math.ceil(0.5 * OVERSAMPLING * max(extent + 1.0, 4.0))
    return torch.linspace(-1.0, 1.0, 2 * half + 1, dtype=torch.float64)


@lru_cache(maxsize=32)
def _grid_steering(radar: Radar) -> Tensor:
    left, up = angle_grid(radar)
    direction = torch.stack(torch.meshgrid(left, up, indexing="ij"), -1).reshape(-1, 2)
    return steering(direction, radar)


def steering(direction_cosines: Tensor, radar: Radar) -> Tensor:
    """``(..., V)`` complex64 weights, of sum 1 in amount, that add the channels up for a direction.

    Args:
        direction_cosines: ``(..., 2)`` components of the unit vector to the target, to the left and up.
    """
    elements = radar.virtual_half_wavelengths.to(direction_cosines.device)
    phase = math.pi * (direction_cosines.double() @ elements.T)
    return (torch.polar(torch.ones_like(phase), phase) / radar.virtual_channels).to(torch.complex64)


def range_doppler_angle(cube: Tensor, radar: Radar, window_name: str = "hann") -> Tensor:
    """Range-Doppler-angle map of a frame.

    Args:
        cube: ``(..., V, N_c, N_s)`` complex samples, square root of milliwatts.
        radar: the sensor.
        window_name: of the range and Doppler transforms; the channels are not weighted.

    Returns:
        ``(..., G_y, G_z, N_c, N_s)`` complex over the direction cosines of ``angle_grid``; a target shows its received
        power. The transmitters' turns are compensated for the speed of each Doppler bin.

    Example:
        >>> radar = Radar.preset("awr1843-like", samples=16, chirps=4)
        >>> range_doppler_angle(torch.zeros(12, 4, 16, dtype=torch.complex64), radar).shape
        torch.Size([33, 17, 4, 16])
    """
    check_arguments("range_doppler_angle(cube: Tensor, radar: Radar, window_name: str)", cube, radar, window_name)
    channels = range_doppler(cube, radar, window_name)
    speed = speed_m_per_s_of_bin(torch.arange(radar.chirps, device=cube.device), radar)
    channels = channels * transmitter_rotation(speed, radar).T[..., None]
    left, up = angle_grid(radar)
    weights = _grid_steering(radar).to(cube.device, channels.dtype)
    found = weights @ channels.flatten(-2)
    return found.reshape(*cube.shape[:-3], len(left), len(up), *cube.shape[-2:])


def spectrum_peaks(channels: Tensor, radar: Radar, most: int, dynamic_db: float) -> tuple[Tensor, Tensor]:
    """Directions from which the strongest signals of each cell arrive.

    Args:
        channels: ``(D, V)`` complex, cells of the map with the transmitters' turns taken out.
        radar: the sensor.
        most: peaks of one cell at most.
        dynamic_db: peaks that much below the strongest of the cell are left out: sidelobes.

    Returns:
        Direction cosines ``(D, most, 2)`` to the left and up, and power ``(D, most)``; power 0 is no peak.
    """
    left, up = (axis.to(channels.device) for axis in angle_grid(radar))
    weights = _grid_steering(radar).to(channels.device, channels.dtype)
    power = (channels @ weights.T).abs().square().reshape(-1, 1, len(left), len(up))
    visible = left[:, None] ** 2 + up**2 <= 1.0
    # Ties go to the lower of two neighbours: both would be one target.
    tilted = power * torch.linspace(1.0, 1.0 - 1e-6, power.shape[1:].numel(), device=power.device).reshape(
        power.shape[1:]
    )
    highest = max_pool2d(tilted, 3, stride=1, padding=1)
    strongest = power.flatten(1).max(1).values[:, None, None]
    kept = (tilted >= highest)[:, 0] & visible & (power[:, 0] > strongest * 10.0 ** (-dynamic_db / 10.0))
    candidates = torch.where(kept, power[:, 0], 0.0).flatten(1)
    value, place = candidates.topk(min(most, candidates.shape[1]), dim=1)
    row, column = place // len(up), place % len(up)
    log_power = power[:, 0].clamp_min(SMALLEST_POWER).log()
    shift_left, gain_left = _parabola(log_power, row, column, 0)
    shift_up, gain_up = _parabola(log_power, row, column, 1)
    cosines = [left[row] + shift_left * _step(left), up[column] + shift_up * _step(up)]
    refined = torch.stack([c.to(power.dtype).clamp(-1.0, 1.0) for c in cosines], -1)
    return refined, value * (gain_left + gain_up).exp()


def _step(axis: Tensor) -> float:
    return float(axis[1] - axis[0]) if len(axis) > 1 else 0.0


def _parabola(log_power: Tensor, row: Tensor, column: Tensor, axis: int) -> tuple[Tensor, Tensor]:
    """Place of the peak between grid points, -0.5 to 0.5, and how much higher it is there (ln)."""
    last = log_power.shape[1 + axis] - 1
    cells = torch.arange(len(log_power), device=log_power.device)[:, None]
    place = row if axis == 0 else column
    inside = (place > 0) & (place < last)

    def value(step: int) -> Tensor:
        moved = (place + step).clamp(0, last)
        return log_power[cells, moved, column] if axis == 0 else log_power[cells, row, moved]

    before, peak, after = value(-1), value(0), value(1)
    curvature = before - 2.0 * peak + after
    shift = 0.5 * (before - after) / torch.where(curvature < 0, curvature, -1.0)
    shift = torch.where(inside & (curvature < 0), shift.clamp(-0.5, 0.5), 0.0)
    return shift, -0.25 * (before - after) * shift
