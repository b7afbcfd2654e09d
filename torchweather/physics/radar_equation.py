"""Radar equation and thermal noise: the power of a target's echo and what it has to be heard against."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from torchweather.core.arguments import check_arguments, check_broadcast
from torchweather.core.errors import check_between, check_finite, check_positive
from torchweather.physics.float64 import Quantity, to_float64

__all__ = ["SPEED_OF_LIGHT_M_PER_S", "radar_constant_db", "received_power_dbm", "target_rcs_dbsm", "thermal_noise_dbm"]

SPEED_OF_LIGHT_M_PER_S = 299_792_458.0  # exact, SI
BOLTZMANN_J_PER_K = 1.380649e-23  # exact, SI
NOISE_TEMPERATURE_K = 290.0  # T0 of the noise figure (IEEE), PHYSICS.md 6.8
MILLIWATT_W = 1e-3


def radar_constant_db(
    frequency_ghz: float, transmit_power_dbm: Quantity, antenna_gain_dbi: Quantity, loss_db: float = 0.0
) -> Tensor:
    """``P_t G_t G_r lambda^2 / ((4 pi)^3 L)`` in dB: the echo in dBm of 1 m^2 at 1 m.

    Args:
        frequency_ghz: carrier.
        transmit_power_dbm: of one transmitter.
        antenna_gain_dbi: of transmit and receive antenna together, dB.
        loss_db: of the radar itself, both ways together.

    Example:
        >>> round(float(radar_constant_db(77.0, 12.0, 26.0)), 2)
        -43.17
    """
    check_arguments(
        "radar_constant_db(frequency_ghz: float, transmit_power_dbm: Quantity, antenna_gain_dbi: Quantity, "
        "loss_db: float)",
        frequency_ghz,
        transmit_power_dbm,
        antenna_gain_dbi,
        loss_db,
    )
    check_broadcast("radar_constant_db", transmit_power_dbm=transmit_power_dbm, antenna_gain_dbi=antenna_gain_dbi)
    check_between("frequency_ghz", frequency_ghz, 1e-6, 1e6, unit="GHz", owner="radar_constant_db")
    _check_shapes("radar_constant_db", transmit_power_dbm=transmit_power_dbm, antenna_gain_dbi=antenna_gain_dbi)
    power, gain, loss = to_float64(transmit_power_dbm, antenna_gain_dbi, loss_db)
    wavelength_m = SPEED_OF_LIGHT_M_PER_S / (1e9 * float(frequency_ghz))
    return power + gain - loss + 20.0 * math.log10(wavelength_m) - 30.0 * math.log10(4.0 * math.pi)


def received_power_dbm(
    rcs_dbsm: Quantity,
    range_m: Quantity,
    *,
    frequency_ghz: float = 77.0,
    transmit_power_dbm: Quantity,
    antenna_gain_dbi: Quantity,
    loss_db: float = 0.0,
    attenuation_db: Quantity = 0.0,
) -> Tensor:
    """Power of a target's echo at the receiver, dBm: ``P_t G_t G_r lambda^2 sigma / ((4 pi)^3 R^4 L)``.

    Args:
        rcs_dbsm: radar cross section, dB over 1 m^2, any shape.
        range_m: distance, above 0 m; broadcasts against the cross section.
        frequency_ghz: carrier.
        transmit_power_dbm: of one transmitter.
        antenna_gain_dbi: of transmit and receive antenna together, dB.
        loss_db: of the radar itself, both ways together.
        attenuation_db: of the path, both ways together: twice gamma R.

    References:
        PHYSICS.md 6.2.

    Example:
        >>> round(float(received_power_dbm(0.0, 50.0, transmit_power_dbm=12.0, antenna_gain_dbi=26.0)), 2)
        -111.13
    """
    check_arguments(
        "received_power_dbm(rcs_dbsm: Quantity, range_m: Quantity, frequency_ghz: float, "
        "transmit_power_dbm: Quantity, antenna_gain_dbi: Quantity, loss_db: float, attenuation_db: Quantity)",
        rcs_dbsm,
        range_m,
        frequency_ghz,
        transmit_power_dbm,
        antenna_gain_dbi,
        loss_db,
        attenuation_db,
    )
    check_broadcast(
        "received_power_dbm",
        rcs_dbsm=rcs_dbsm,
        range_m=range_m,
        transmit_power_dbm=transmit_power_dbm,
        antenna_gain_dbi=antenna_gain_dbi,
        attenuation_db=attenuation_db,
    )
    _check_shapes(
        "received_power_dbm",
        rcs_dbsm=rcs_dbsm,
        range_m=range_m,
        transmit_power_dbm=transmit_power_dbm,
        antenna_gain_dbi=antenna_gain_dbi,
        attenuation_db=attenuation_db,
    )
    check_positive("range_m", range_m, unit="m", owner="received_power_dbm")
    check_finite("rcs_dbsm", rcs_dbsm, unit="dBsm", owner="received_power_dbm")
    rcs, distance, attenuation = to_float64(rcs_dbsm, range_m, attenuation_db)
    constant = radar_constant_db(frequency_ghz, transmit_power_dbm, antenna_gain_dbi, loss_db)
    return constant + rcs - 40.0 * torch.log10(distance) - attenuation


def target_rcs_dbsm(
    power_dbm: Quantity,
    range_m: Quantity,
    *,
    frequency_ghz: float = 77.0,
    transmit_power_dbm: Quantity,
    antenna_gain_dbi: Quantity,
    loss_db: float = 0.0,
    attenuation_db: Quantity = 0.0,
) -> Tensor:
    """Cross section of a target from the power of its echo, dBsm: ``received_power_dbm`` solved for it.

    Args:
        power_dbm: of the echo, any shape.
        range_m, frequency_ghz, transmit_power_dbm, antenna_gain_dbi, loss_db, attenuation_db: as there.

    References:
        PHYSICS.md 6.2.

    Example:
        >>> round(float(target_rcs_dbsm(-111.128, 50.0, transmit_power_dbm=12.0, antenna_gain_dbi=26.0)), 2)
        0.0
    """
    check_arguments(
        "target_rcs_dbsm(power_dbm: Quantity, range_m: Quantity, frequency_ghz: float, "
        "transmit_power_dbm: Quantity, antenna_gain_dbi: Quantity, loss_db: float, attenuation_db: Quantity)",
        power_dbm,
        range_m,
        frequency_ghz,
        transmit_power_dbm,
        antenna_gain_dbi,
        loss_db,
        attenuation_db,
    )
    check_broadcast(
        "target_rcs_dbsm",
        power_dbm=power_dbm,
        range_m=range_m,
        transmit_power_dbm=transmit_power_dbm,
        antenna_gain_dbi=antenna_gain_dbi,
        attenuation_db=attenuation_db,
    )
    _check_shapes(
        "target_rcs_dbsm",
        power_dbm=power_dbm,
        range_m=range_m,
        transmit_power_dbm=transmit_power_dbm,
        antenna_gain_dbi=antenna_gain_dbi,
        attenuation_db=attenuation_db,
    )
    check_positive("range_m", range_m, unit="m", owner="target_rcs_dbsm")
    check_finite("power_dbm", power_dbm, unit="dBm", owner="target_rcs_dbsm")
    power, distance, attenuation = to_float64(power_dbm, range_m, attenuation_db)
    constant = radar_constant_db(frequency_ghz, transmit_power_dbm, antenna_gain_dbi, loss_db)
    return power - constant + 40.0 * torch.log10(distance) + attenuation


def thermal_noise_dbm(bandwidth_hz: Quantity, noise_figure_db: Quantity = 0.0) -> Tensor:
    """Thermal noise of a receiver, dBm: ``k T0 B F``.

    Args:
        bandwidth_hz: of the receiver behind the mixer (the sample rate of complex samples), not of the chirp.
        noise_figure_db: F, 0 dB or more.

    Returns:
        Power of the complex noise; I and Q hold half of it each.

    References:
        PHYSICS.md 6.8.

    Example:
        >>> round(float(thermal_noise_dbm(12.5e6, 14.0)), 2)
        -89.01
    """
    check_arguments(
        "thermal_noise_dbm(bandwidth_hz: Quantity, noise_figure_db: Quantity)",
        bandwidth_hz,
        noise_figure_db,
    )
    check_broadcast("thermal_noise_dbm", bandwidth_hz=bandwidth_hz, noise_figure_db=noise_figure_db)
    check_positive("bandwidth_hz", bandwidth_hz, unit="Hz", owner="thermal_noise_dbm")
    check_between("noise_figure_db", noise_figure_db, 0.0, 100.0, unit="dB", owner="thermal_noise_dbm")
    _check_shapes("thermal_noise_dbm", bandwidth_hz=bandwidth_hz, noise_figure_db=noise_figure_db)
    bandwidth, figure = to_float64(bandwidth_hz, noise_figure_db)
    return 10.0 * torch.log10(BOLTZMANN_J_PER_K * NOISE_TEMPERATURE_K / MILLIWATT_W * bandwidth) + figure


def _check_shapes(owner: str, **values: Quantity) -> None:
    """Refuse what does not broadcast, nested lists included."""
    names = list(values)
    check_broadcast(owner, **dict(zip(names, to_float64(*values.values()), strict=True)))
