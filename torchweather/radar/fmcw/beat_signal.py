r"""Beat signal: what the receivers of an FMCW radar sample of a set of scatterers.

Up-chirp, dechirped, complex. Scatterer i, sample n, chirp m of transmitter k, virtual element q:

    s[q, m, n] = sum_i A_i exp(j 2 pi [ f_i(t) n / fs + 2 (R_i + v_i t) / lambda - u_i . p_q / lambda ])
    f_i(t) = 2 S (R_i + v_i t) / c + 2 v_i / lambda,   t = (m N_tx + k) T_c,   A_i = sqrt(P_i) exp(j phi_i)

Without the term that holds t and n together, the sum over scatterers is a matrix product of slow-time and array phases
by fast-time phases. With it a target that moves changes its range cell within the frame. The frame is cut into blocks
of chirps; at the middle of each block the term belongs to the fast-time phases, and what is left of it inside the block
is expanded to first order, which costs a second product. As time counts from the begin of the block, slow-time and
array phases are those of every block. The blocks are as many as keep the neglected second order below ``SECOND_ORDER``;
where a single chirp of all transmitters is too long for that, higher orders are taken along.

References:
    PHYSICS.md 6.2, 6.4.
"""

from __future__ import annotations

import math
import warnings

import torch
from torch import Tensor

from torchweather.core.arguments import check_arguments, check_broadcast
from torchweather.core.errors import InputValueError, TorchweatherWarning, check_at_least, check_positive
from torchweather.physics import SPEED_OF_LIGHT_M_PER_S
from torchweather.radar.fmcw.scatterers import Scatterers
from torchweather.radar.sensor import Radar

__all__ = ["beat_signal"]

SECOND_ORDER = 2e-3  # of an amplitude, what is neglected at the corners of a block; a tenth of it or less on average
SCATTERERS_AT_ONCE = 256  # arrays that stay in the cache


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
    check_arguments(
        "beat_signal(scatterers: Scatterers, radar: Radar, attenuation_db: real | None)",
        scatterers,
        radar,
        attenuation_db,
    )
    _check(scatterers, radar)
    lead, count = scatterers.speed_m_per_s.shape[:-1], scatterers.speed_m_per_s.shape[-1]
    amplitude = _amplitude(scatterers, radar, attenuation_db).reshape(-1, count)
    distance = scatterers.range_m.double().reshape(-1, count)
    direction = scatterers.direction.double().reshape(-1, count, 3)
    speed = scatterers.speed_m_per_s.double().reshape(-1, count)
    chirps, order = _block(speed, radar)
    blocks = math.ceil(radar.chirps / chirps)  # the last may reach beyond the frame
    found = amplitude.new_zeros(len(speed), blocks, chirps * radar.virtual_channels, radar.samples)
    for first in range(0, count, SCATTERERS_AT_ONCE):
        part = slice(first, first + SCATTERERS_AT_ONCE)
        _add(found, amplitude[:, part], distance[:, part], speed[:, part], direction[:, part], radar, order)
    cube = found.reshape(len(speed), -1, radar.virtual_channels, radar.samples)[:, : radar.chirps].transpose(1, 2)
    return cube.reshape(*lead, *cube.shape[1:])


def _add(
    found: Tensor, amplitude: Tensor, distance_m: Tensor, speed: Tensor, direction: Tensor, radar: Radar, order: int
) -> None:
    """Add the scatterers ``(B, M)`` to the samples ``(B, blocks, chirps V, N_s)``; in place."""
    batch, count = speed.shape
    device, dtype = speed.device, amplitude.dtype
    per_metre = 2.0 * radar.slope_hz_per_s / SPEED_OF_LIGHT_M_PER_S / (1e6 * radar.sample_rate_mhz)
    migration = per_metre * speed  # turns a second and sample
    blocks, number = found.shape[1], found.shape[2] // radar.receivers  # chirps of all transmitters in a block
    middle_s, middle_n = 0.5 * (number - 1) * radar.chirp_period_s, 0.5 * (radar.samples - 1)

    # Within a block: slow time and array, (B, chirps V, M)
    elements = radar.virtual_half_wavelengths.to(device)
    array = _rotation(-0.5 * (elements @ direction[..., 1:].transpose(1, 2)))
    array = array.reshape(batch, 1, radar.transmitters, radar.receivers, count)

    def over_array(chirp: Tensor) -> Tensor:
        return (chirp.reshape(batch, -1, radar.transmitters, 1, count) * array).reshape(batch, -1, count)

    step = (2.0 / radar.wavelength_m * speed + migration * middle_n) * radar.chirp_period_s
    turns = step[:, None] * _count(number, device)[:, None] - (migration * (middle_s * middle_n))[:, None]
    chirp = _rotation(turns) * amplitude[:, None]
    slow = [over_array(chirp)]
    # What is left of the term with t and n, order by order
    left = 2.0 * math.pi * migration[:, None] * (_count(number, device) * radar.chirp_period_s - middle_s)[:, None]
    for power in range(1, order + 1):
        chirp = chirp * torch.complex(torch.zeros_like(left), left / power).to(dtype)
        slow.append(over_array(chirp))
    from_middle_n = (_count(radar.samples, device) - middle_n).to(dtype)

    # Fast time, (B, M, N_s), from block to block
    block_s = number * radar.chirp_period_s
    beat = per_metre * distance_m + 2.0 / radar.wavelength_m * speed / (1e6 * radar.sample_rate_mhz)
    fast = _ramp(2.0 / radar.wavelength_m * distance_m, beat + migration * middle_s, radar.samples)
    onward = _ramp(2.0 / radar.wavelength_m * speed * block_s, migration * block_s, radar.samples)
    for block in range(blocks):
        if block:
            fast = fast * onward
        found[:, block].baddbmm_(slow[0], fast)
        weighted = fast
        for further in slow[1:]:
            weighted = weighted * from_middle_n
            found[:, block].baddbmm_(further, weighted)


def _count(number: int, device: torch.device) -> Tensor:
    return torch.arange(number, dtype=torch.float64, device=device)


def _rotation(turns: Tensor) -> Tensor:
    """``exp(j 2 pi turns)``, complex64; whole turns are taken off in double precision."""
    wrapped = ((turns - turns.detach().round()) * (2.0 * math.pi)).float()
    return torch.complex(wrapped.cos(), wrapped.sin())  # faster than torch.polar


def _ramp(first: Tensor, step: Tensor, number: int) -> Tensor:
    """``(..., number)`` rotations by ``first``, ``first + step``, ... turns: coarse times fine, to save cosines."""
    fine = math.ceil(math.sqrt(number))
    coarse = first[..., None] + step[..., None] * fine * _count(math.ceil(number / fine), step.device)
    both = _rotation(coarse)[..., None] * _rotation(step[..., None] * _count(fine, step.device))[..., None, :]
    return both.flatten(-2)[..., :number]


def _amplitude(scatterers: Scatterers, radar: Radar, attenuation_db: Tensor | None) -> Tensor:
    """``(..., M)`` complex64, square root of milliwatts, at the begin of the frame."""
    gain = 2.0 * (radar.gain_dbi(scatterers.azimuth_rad, scatterers.elevation_rad) - radar.antenna_gain_dbi)
    if attenuation_db is not None:
        check_at_least("attenuation_db", attenuation_db, 0.0, unit="dB", owner="beat_signal")
        check_broadcast("beat_signal", attenuation_db=attenuation_db, scatterers=gain)
        lost = gain - attenuation_db
        if lost.shape != gain.shape:
            raise InputValueError(
                f"beat_signal: attenuation_db must broadcast to the scatterers {tuple(gain.shape)}; got "
                f"{tuple(attenuation_db.shape)}."
            )
        gain = lost
    there = scatterers.field_m != 0
    range_m = torch.where(there, scatterers.range_m, torch.ones_like(scatterers.range_m))
    level = 10.0 ** ((radar.constant_db + gain) / 20.0) / range_m.square()
    return (scatterers.field_m * level).to(torch.complex64)


def _block(speed: Tensor, radar: Radar) -> tuple[int, int]:
    """Chirps of each transmitter in a block, and the order to which its middle is left."""
    fastest = float(speed.detach().abs().max())
    # Phase at the corner of the frame, counted from its middle: 2 pi (2 B v / c) (T / 2) / 2
    corner = math.pi * 1e6 * radar.bandwidth_mhz * fastest / SPEED_OF_LIGHT_M_PER_S * radar.frame_time_s
    blocks = max(1, math.ceil(corner / math.sqrt(2.0 * SECOND_ORDER)))
    chirps = max(1, radar.chirps // blocks)
    corner *= chirps / radar.chirps
    order = 1 if fastest or speed.requires_grad else 0
    while order and corner ** (order + 1) / math.factorial(order + 1) > SECOND_ORDER * (1.0 + 1e-9):
        order += 1
    return chirps, order


def _check(scatterers: Scatterers, radar: Radar) -> None:
    if not scatterers.field_m.numel():
        raise InputValueError(
            f"beat_signal: expected one scatterer or more; got shape {tuple(scatterers.field_m.shape)}. For noise "
            "alone give one with field 0."
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
