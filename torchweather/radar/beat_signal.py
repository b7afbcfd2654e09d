r"""Beat signal: what the receivers of an FMCW radar sample of a set of scatterers.

Up-chirp, dechirped, complex. Scatterer i, sample n, chirp m of transmitter k, virtual element q:

    s[q, m, n] = sum_i A_i exp(j 2 pi [ f_i(t) n / fs + 2 (R_i + v_i t) / lambda - u_i . p_q / lambda ])
    f_i(t) = 2 S (R_i + v_i t) / c + 2 v_i / lambda,   t = (m N_tx + k) T_c,   A_i = sqrt(P_i) exp(j phi_i)

The sum over scatterers is a matrix product of slow-time and array phases by fast-time phases, except for the term that
holds t and n together: a target that moves changes its range cell within the frame. The frame is cut into blocks of
chirps; at the middle of each block the term belongs to the fast-time phases, and what is left of it inside the block is
expanded to first order, which costs a second product. The blocks are as many as keep the neglected second order below
``SECOND_ORDER``.

References:
    PHYSICS.md 6.2, 6.4.
"""

from __future__ import annotations

import math
import warnings

import torch
from torch import Tensor

from torchweather.errors import TorchweatherWarning, check_at_least, check_positive
from torchweather.physics import SPEED_OF_LIGHT_M_PER_S
from torchweather.radar.scatterers import Scatterers
from torchweather.sensors import Radar

__all__ = ["beat_signal", "chirp_times_s"]

SECOND_ORDER = 2e-3  # of an amplitude, at the corners of a block; the mean over the frame is a tenth of it or less
SCATTERERS_AT_ONCE = 256  # arrays that stay in the cache


def chirp_times_s(radar: Radar, device: torch.device | None = None) -> Tensor:
    """``(N_c, N_tx)`` begin of each chirp of each transmitter, float64."""
    number = torch.arange(radar.chirps * radar.transmitters, dtype=torch.float64, device=device)
    return (number * radar.chirp_period_s).reshape(radar.chirps, radar.transmitters)


def beat_signal(scatterers: Scatterers, radar: Radar, *, attenuation_db: Tensor | None = None) -> Tensor:
    """Noise-free samples of one frame.

    Args:
        scatterers: ``(..., M)``, one or more; positions and speeds at the beginning of the frame.
        radar: the sensor.
        attenuation_db: ``(..., M)`` what the weather takes on the way to each and back.

    Returns:
        ``(..., V, N_c, N_s)`` complex64, square root of milliwatts: virtual channel ``k N_rx + r``, chirp, sample.

    Warns:
        TorchweatherWarning: scatterers beyond the unambiguous range or speed, which appear at another one.

    Note:
        Far field: plane waves over the array. Accurate to ``SECOND_ORDER`` of each scatterer's amplitude (of no error
        without motion). Differentiable in positions, speeds, fields and attenuation.

    References:
        PHYSICS.md 6.4.

    Example:
        >>> radar = Radar.preset("awr1843-like")
        >>> corner = Scatterers.from_spherical(torch.tensor([20.0]), 0.0, 0.0, rcs_dbsm=10.0)
        >>> beat_signal(corner, radar).shape
        torch.Size([12, 128, 256])
    """
    _check(scatterers, radar)
    lead, count = scatterers.speed_m_per_s.shape[:-1], scatterers.speed_m_per_s.shape[-1]
    amplitude = _amplitude(scatterers, radar, attenuation_db).reshape(-1, count)
    distance = scatterers.range_m.double().reshape(-1, count)
    direction = scatterers.direction.double().reshape(-1, count, 3)
    speed = scatterers.speed_m_per_s.double().reshape(-1, count)
    blocks = _blocks(speed, radar)
    found: Tensor | None = None
    for first in range(0, count, SCATTERERS_AT_ONCE):
        part = slice(first, first + SCATTERERS_AT_ONCE)
        own = _of_scatterers(amplitude[:, part], distance[:, part], speed[:, part], direction[:, part], radar, blocks)
        found = own if found is None else found + own
    assert found is not None
    cube = found.reshape(-1, radar.chirps, radar.virtual_channels, radar.samples).transpose(1, 2)
    return cube.reshape(*lead, *cube.shape[1:])


def _of_scatterers(
    amplitude: Tensor, distance_m: Tensor, speed: Tensor, direction: Tensor, radar: Radar, blocks: int
) -> Tensor:
    """``(B, N_c V, N_s)`` of the scatterers ``(B, M)``; phases in turns, float64 until they are wrapped."""
    batch, count = speed.shape
    t = chirp_times_s(radar, speed.device)
    n = torch.arange(radar.samples, dtype=torch.float64, device=speed.device)
    per_metre = 2.0 * radar.slope_hz_per_s / SPEED_OF_LIGHT_M_PER_S / (1e6 * radar.sample_rate_mhz)
    # Slow time and array, (B, N_c, V, M)
    travelled = distance_m[:, None, None] + speed[:, None, None] * t[..., None]
    slow = _rotation(2.0 / radar.wavelength_m * travelled) * amplitude[:, None, None]
    elements = radar.virtual_half_wavelengths.to(speed.device)
    array = _rotation(-0.5 * (elements @ direction[..., 1:].transpose(1, 2)))
    array = array.reshape(batch, 1, radar.transmitters, radar.receivers, count)
    rows = radar.virtual_channels

    def over_array(per_chirp: Tensor) -> Tensor:
        return (per_chirp[..., None, :] * array).reshape(batch, -1, count)

    # Fast time, (B, M, N_s)
    beat = per_metre * distance_m + 2.0 * speed / radar.wavelength_m / (1e6 * radar.sample_rate_mhz)
    if blocks == 0:
        return over_array(slow) @ _rotation(beat[..., None] * n)
    migration = per_metre * speed  # turns a second and sample
    chirps = math.ceil(radar.chirps / blocks)
    middle_n = 0.5 * (radar.samples - 1)
    from_middle_n = (n - middle_n).to(amplitude.real.dtype)
    first_middle = 0.5 * float(t[0, 0] + t[min(chirps, radar.chirps) - 1, -1])
    middles = torch.arange(blocks, device=t.device) * (chirps * radar.repetition_period_s) + first_middle
    from_middle_t = t - middles.repeat_interleave(chirps)[: radar.chirps, None]
    inside = migration[:, None, None] * from_middle_t[..., None]  # (B, N_c, N_tx, M)
    slow = slow * _rotation(middle_n * inside)
    constant = over_array(slow)
    linear = over_array(slow * torch.complex(torch.zeros((), device=t.device), 2.0 * math.pi * inside.float()))
    fast = _rotation((beat + migration * first_middle)[..., None] * n)
    step = _rotation((migration * (chirps * radar.repetition_period_s))[..., None] * n)
    found = []
    for first in range(0, radar.chirps * rows, chirps * rows):
        part = slice(first, first + chirps * rows)
        found.append(torch.baddbmm(constant[:, part] @ fast, linear[:, part], fast * from_middle_n))
        fast = fast * step
    return torch.cat(found, 1)


def _rotation(turns: Tensor) -> Tensor:
    """``exp(j 2 pi turns)``, complex64; whole turns are taken off in double precision."""
    wrapped = ((turns - turns.detach().round()) * (2.0 * math.pi)).float()
    return torch.polar(torch.ones_like(wrapped), wrapped)


def _amplitude(scatterers: Scatterers, radar: Radar, attenuation_db: Tensor | None) -> Tensor:
    """``(..., M)`` complex64, square root of milliwatts, at the begin of the frame."""
    gain = 2.0 * (radar.gain_dbi(scatterers.azimuth_rad, scatterers.elevation_rad) - radar.antenna_gain_dbi)
    if attenuation_db is not None:
        check_at_least("attenuation_db", attenuation_db, 0.0, unit="dB", owner="beat_signal")
        gain = gain - attenuation_db
    there = scatterers.field_m != 0
    range_m = torch.where(there, scatterers.range_m, torch.ones_like(scatterers.range_m))
    level = 10.0 ** ((radar.constant_db + gain) / 20.0) / range_m.square()
    return (scatterers.field_m * level).to(torch.complex64)


def _blocks(speed: Tensor, radar: Radar) -> int:
    """Blocks of chirps; 0 where nothing moves."""
    fastest = float(speed.detach().abs().max())
    if fastest == 0.0:
        return 0
    # Phase at the corner of the frame, counted from its middle: 2 pi (2 B v / c) (T / 2) / 2
    corner = math.pi * 1e6 * radar.bandwidth_mhz * fastest / SPEED_OF_LIGHT_M_PER_S * radar.frame_time_s
    return min(radar.chirps, max(1, math.ceil(corner / math.sqrt(2.0 * SECOND_ORDER))))


def _check(scatterers: Scatterers, radar: Radar) -> None:
    if not scatterers.field_m.numel():
        raise ValueError(
            f"beat_signal: wanted one scatterer or more; got shape {tuple(scatterers.field_m.shape)}. For noise alone "
            "give one with field 0."
        )
    there = (scatterers.field_m != 0).detach()
    if not bool(there.any()):
        return
    range_m, speed = scatterers.range_m.detach()[there], scatterers.speed_m_per_s.detach()[there]
    check_positive("range of a scatterer", range_m, unit="m", owner="beat_signal")
    # Over the frame, at either end of it
    farthest = torch.maximum(range_m, range_m + speed * radar.frame_time_s)
    _warn_aliased("range", farthest, radar.max_range_m, "m")
    _warn_aliased("speed", speed.abs(), radar.max_speed_m_per_s, "m/s")


def _warn_aliased(name: str, values: Tensor, limit: float, unit: str) -> None:
    beyond = int((values > limit).sum())
    if beyond:
        warnings.warn(
            f"beat_signal: {beyond} of {values.numel()} scatterers lie beyond the unambiguous {name} of {limit:.4g} "
            f"{unit} (largest {float(values.max()):.4g} {unit}); they appear at another {name}, as in any radar.",
            TorchweatherWarning,
            stacklevel=4,
        )
