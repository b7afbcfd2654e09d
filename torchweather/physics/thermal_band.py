"""Thermal radiation in a band: Planck's law between two wavelengths, and the temperature that a band shows."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from torchweather.core.arguments import check_arguments
from torchweather.core.errors import InputValueError, check_between
from torchweather.physics.float64 import Quantity, to_float64

__all__ = ["ThermalBand", "planck_w_per_m2_sr_um"]

# Radiation constants 2 h c^2 and h c / k_B of the exact SI values (CODATA 2018), for wavelengths in um.
FIRST_W_UM4_PER_M2_SR = 1.191042972e8
SECOND_UM_K = 14387.76877
KELVIN_AT_0_C = 273.15
COLDEST_C, HOTTEST_C = -120.0, 500.0
WAVELENGTHS = 7  # nodes of the band: Gauss-Legendre
STEP_K = 0.5  # of the table of temperatures


def planck_w_per_m2_sr_um(wavelength_um: Quantity, temperature_c: Quantity) -> Tensor:
    """Spectral radiance of a black body, W / (m^2 sr um), float64.

    Args:
        wavelength_um: um, above 0; broadcasts against the temperature.
        temperature_c: deg C, above absolute zero.

    References:
        Planck's law with the constants of CODATA 2018.

    Example:
        >>> round(float(planck_w_per_m2_sr_um(10.0, 26.85)), 2)
        9.92
    """
    check_arguments(
        "planck_w_per_m2_sr_um(wavelength_um: Quantity, temperature_c: Quantity)", wavelength_um, temperature_c
    )
    check_between("wavelength_um", wavelength_um, 0.1, 1e4, unit="um", owner="planck_w_per_m2_sr_um")
    check_between("temperature_c", temperature_c, -270.0, 1e4, unit="deg C", owner="planck_w_per_m2_sr_um")
    wavelength, temperature = to_float64(wavelength_um, temperature_c)
    exponent = SECOND_UM_K / (wavelength * (temperature + KELVIN_AT_0_C))
    return FIRST_W_UM4_PER_M2_SR / (wavelength**5 * torch.expm1(exponent))


class ThermalBand(nn.Module):
    """A detector's band: wavelengths, their weights, and the way from band radiance back to a temperature.

    Args:
        low_um, high_um: the band, 8 to 14 um, where water and ice are tabulated.

    Note:
        The band is flat: every wavelength counts alike in power. Temperatures from -120 to 500 deg C.

    Example:
        >>> band = ThermalBand(8.0, 14.0)
        >>> band.temperature_c(band.radiance(torch.tensor([-20.0, 15.0])).sum(-1)).round(decimals=2)
        tensor([-20.,  15.])
    """

    weight_um: Tensor
    log_radiance: Tensor

    def __init__(self, low_um: float = 8.0, high_um: float = 14.0) -> None:
        super().__init__()
        check_arguments("ThermalBand(low_um: float, high_um: float)", low_um, high_um)
        check_between("low_um", low_um, 8.0, 14.0, unit="um", owner=self)
        check_between("high_um", high_um, 8.0, 14.0, unit="um", owner=self)
        if not low_um < high_um:
            raise InputValueError(f"ThermalBand: low_um must be below high_um = {high_um:g} um; got {low_um:g}.")
        self.low_um, self.high_um = float(low_um), float(high_um)
        node, weight = _gauss_legendre(WAVELENGTHS)
        half = 0.5 * (self.high_um - self.low_um)
        self.wavelengths_um: tuple[float, ...] = tuple((self.low_um + half * (1 + node)).tolist())
        self.register_buffer("weight_um", (half * weight).float(), persistent=False)
        grid_c = torch.arange(COLDEST_C, HOTTEST_C + STEP_K, STEP_K, dtype=torch.float64)
        spectral = planck_w_per_m2_sr_um(torch.tensor(self.wavelengths_um, dtype=torch.float64), grid_c[:, None])
        self.register_buffer("log_radiance", (spectral @ (half * weight)).log().float(), persistent=False)

    def radiance(self, temperature_c: Tensor) -> Tensor:
        """Radiance of a black body in each part of the band, ``(..., K)``, W / (m^2 sr); their sum is the band's."""
        kelvin = temperature_c[..., None] + KELVIN_AT_0_C
        parts = []
        for number, wavelength in enumerate(self.wavelengths_um):
            scale = FIRST_W_UM4_PER_M2_SR / wavelength**5
            parts.append(self.weight_um[number] * scale / torch.expm1(SECOND_UM_K / (wavelength * kelvin[..., 0])))
        return torch.stack(parts, -1)

    def temperature_c(self, radiance: Tensor) -> Tensor:
        """Temperature of the black body that radiates as much in the band, deg C; within 1 mK.

        Args:
            radiance: ``(...)`` of the whole band, W / (m^2 sr).
        """
        wanted = radiance.log()
        above = torch.searchsorted(self.log_radiance, wanted.detach().contiguous()).clamp(1, len(self.log_radiance) - 1)
        low, high = self.log_radiance[above - 1], self.log_radiance[above]
        share = (wanted - low) / (high - low)
        return COLDEST_C + STEP_K * (above - 1 + share)


def _gauss_legendre(number: int) -> tuple[Tensor, Tensor]:
    """Nodes on [-1, 1] and weights of a quadrature, from the eigenvalues of Legendre's recurrence."""
    order = torch.arange(1, number, dtype=torch.float64)
    beside = order / torch.sqrt(4 * order.square() - 1)
    nodes, vectors = torch.linalg.eigh(torch.diag(beside, 1) + torch.diag(beside, -1))
    return nodes, 2 * vectors[0].square()
