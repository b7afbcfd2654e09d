"""The general size distributions: exponential, gamma, modified gamma, log-normal.

References:
    PHYSICS.md 2.1 and 2.2; ROADVIEW D3.4 chapter 3 with its errors of sign, unit and per-radius density corrected.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import ClassVar, Self

import torch
from torch import Tensor

from torchweather.core.arguments import check_arguments
from torchweather.core.errors import check_at_least, check_one_of, check_positive
from torchweather.physics.float64 import Quantity, to_float64
from torchweather.physics.incomplete_gamma import incomplete_gamma_between
from torchweather.physics.size_distribution import Per, SizeDistribution

__all__ = ["Exponential", "Gamma", "LogNormal", "ModifiedGamma", "SizeDistribution"]

MM_PER_UM = 1e-3
PER_M3_IN_PER_CM3 = 1e6


@dataclass(frozen=True, eq=False)
class Exponential(SizeDistribution):
    """``N(D) = N0 exp(-Lambda D)``; the mean diameter of the untruncated distribution is ``1 / Lambda``.

    Args:
        intercept_per_m3_mm: N0, m^-3 mm^-1, ``(...,)``, 0 or more.
        slope_per_mm: Lambda, 1/mm of *diameter*, ``(...,)``, above 0.
        per_size: ``"radius"`` where N0 counts particles per mm of radius (twice the N0 per diameter).

    References:
        PHYSICS.md 2.1.

    Example:
        >>> rain = Exponential(8000.0, 4.1, diameter_min_mm=0.1, diameter_max_mm=8.0)
        >>> round(float(rain.total_per_m3))
        1295
    """

    intercept_per_m3_mm: Quantity
    slope_per_mm: Quantity
    per_size: Per = "diameter"

    def __post_init__(self) -> None:
        check_arguments(
            "Exponential(intercept_per_m3_mm: Quantity, slope_per_mm: Quantity)",
            self.intercept_per_m3_mm,
            self.slope_per_mm,
        )
        super().__post_init__()
        check_at_least("intercept_per_m3_mm", self.intercept_per_m3_mm, 0.0, unit="m^-3 mm^-1", owner=self)
        check_positive("slope_per_mm", self.slope_per_mm, unit="1/mm", owner=self)
        check_one_of("per_size", self.per_size, ("diameter", "radius"), owner=self)

    def _parameters(self) -> tuple[Tensor, ...]:
        intercept, slope = to_float64(self.intercept_per_m3_mm, self.slope_per_mm)
        return _per_diameter(intercept, self.per_size), slope

    def _density(self, diameter_mm: Tensor, *parameters: Tensor) -> Tensor:
        intercept, slope = parameters
        return intercept * torch.exp(-slope * diameter_mm)

    def _partial_moment(self, order: float, low_mm: Tensor, high_mm: Tensor, *parameters: Tensor) -> Tensor:
        intercept, slope = parameters
        if order == 0:  # no special function: also the path of the sampler
            # exp(-L a) (1 - exp(-L (b - a))), not a difference of two nearly equal exponentials
            return intercept / slope * torch.exp(-slope * low_mm) * -torch.expm1(-slope * (high_mm - low_mm))
        shape = torch.full_like(slope, order + 1.0)
        share = incomplete_gamma_between(shape, slope * low_mm, slope * high_mm)
        return intercept * math.gamma(order + 1.0) * slope ** (-(order + 1.0)) * share

    def _inverse_tail(self, number_per_m3: Tensor, *parameters: Tensor) -> Tensor:
        intercept, slope = parameters
        # One particle fewer than the total is read from the near end, where the far end would lose its digits.
        total = self._partial_moment(0.0, *self._ends(slope), intercept, slope)
        spacing = torch.exp(-slope * self.diameter_min_mm)
        below = (total - number_per_m3) * slope / (intercept.clamp_min(1e-300) * spacing)
        return self.diameter_min_mm - torch.log1p(-below.clamp_max(1.0 - 1e-16)) / slope

    def _ends(self, like: Tensor) -> tuple[Tensor, Tensor]:
        low = torch.full_like(like, self.diameter_min_mm)
        return low, torch.full_like(like, min(self.diameter_max_mm, 1e12))

    def _span_mm(self) -> tuple[float, float]:
        _, slope = self._parameters()
        self._check_any(slope)
        high = 70.0 / float(slope.detach().min())  # e^-70 70^6 is 1e-19 of the sixth moment
        return 1e-5 / float(slope.detach().max()), high

    def scaled(self, factor: Quantity) -> Self:
        """The same shape with ``factor`` times as many particles."""
        check_arguments("Exponential.scaled(factor: Quantity)", factor)
        return replace(self, intercept_per_m3_mm=_times(self.intercept_per_m3_mm, factor))


@dataclass(frozen=True, eq=False)
class Gamma(SizeDistribution):
    """``N(D) = N0 D^mu exp(-Lambda D)``.

    Args:
        intercept_per_m3_mm: N0, m^-3 mm^-(1+mu), ``(...,)``: values of different mu are not comparable.
        shape: mu, ``(...,)``, above -1 (otherwise the total diverges); no gradient through it in moments.
        slope_per_mm: Lambda, 1/mm of diameter, ``(...,)``, above 0.

    References:
        PHYSICS.md 2.1.

    Example:
        >>> snow = Gamma(2.33e4, 1.23, 2.25, particle="flake")
        >>> round(float(snow.total_per_m3), 1)
        4278.5
    """

    intercept_per_m3_mm: Quantity
    shape: Quantity
    slope_per_mm: Quantity

    def __post_init__(self) -> None:
        check_arguments(
            "Gamma(intercept_per_m3_mm: Quantity, shape: Quantity, slope_per_mm: Quantity)",
            self.intercept_per_m3_mm,
            self.shape,
            self.slope_per_mm,
        )
        super().__post_init__()
        check_at_least("intercept_per_m3_mm", self.intercept_per_m3_mm, 0.0, unit="m^-3 mm^-(1+mu)", owner=self)
        check_positive("slope_per_mm", self.slope_per_mm, unit="1/mm", owner=self)
        check_positive(
            "shape + 1", to_float64(self.shape)[0] + 1.0, owner=self, advice="With mu = -1 or less the total diverges."
        )

    def _parameters(self) -> tuple[Tensor, ...]:
        return to_float64(self.intercept_per_m3_mm, self.shape, self.slope_per_mm)

    def _density(self, diameter_mm: Tensor, *parameters: Tensor) -> Tensor:
        intercept, mu, slope = parameters
        return intercept * torch.exp(mu * torch.log(diameter_mm) - slope * diameter_mm)

    def _partial_moment(self, order: float, low_mm: Tensor, high_mm: Tensor, *parameters: Tensor) -> Tensor:
        intercept, mu, slope = parameters
        shape = mu + (order + 1.0)
        share = incomplete_gamma_between(shape, slope * low_mm, slope * high_mm)
        return intercept * torch.exp(torch.lgamma(shape) - shape * torch.log(slope)) * share

    def _span_mm(self) -> tuple[float, float]:
        _, mu, slope = self._parameters()
        self._check_any(slope, mu)
        high = float(((70.0 + 4.0 * mu.clamp_min(0.0)) / slope).detach().max())
        return 1e-5 / float(slope.detach().max()), high

    def scaled(self, factor: Quantity) -> Self:
        """The same shape with ``factor`` times as many particles."""
        return replace(self, intercept_per_m3_mm=_times(self.intercept_per_m3_mm, factor))


@dataclass(frozen=True, eq=False)
class ModifiedGamma(SizeDistribution):
    """Deirmendjian's form ``n(r) ~ r^alpha exp(-b r^gamma)`` with ``b = alpha / (gamma r_c^gamma)``.

    The density of the source is per unit *radius*; ``number_density_per_m3_mm`` converts, ``N(D) = n(D/2) / 2``.

    Args:
        number_per_cm3: total concentration over all sizes, cm^-3, ``(...,)``.
        alpha: exponent of the radius, ``(...,)``, above 0; no gradient through it in moments.
        gamma: exponent inside the exponential, ``(...,)``, above 0; no gradient.
        mode_radius_um: r_c, the *radius* at which n(r) peaks, um, ``(...,)``.

    References:
        PHYSICS.md 2.2; Deirmendjian 1969; Rasshofer et al. 2011.

    Example:
        >>> fog = ModifiedGamma(20.0, 3.0, 1.0, 10.0)
        >>> round(float(fog.liquid_water_g_per_m3()), 3)
        0.372
    """

    number_per_cm3: Quantity
    alpha: Quantity
    gamma: Quantity
    mode_radius_um: Quantity

    per: ClassVar[str] = "radius"

    def __post_init__(self) -> None:
        check_arguments(
            "ModifiedGamma(number_per_cm3: Quantity, alpha: Quantity, gamma: Quantity, mode_radius_um: Quantity)",
            self.number_per_cm3,
            self.alpha,
            self.gamma,
            self.mode_radius_um,
        )
        super().__post_init__()
        check_at_least("number_per_cm3", self.number_per_cm3, 0.0, unit="cm^-3", owner=self)
        for name in ("alpha", "gamma", "mode_radius_um"):
            check_positive(name, getattr(self, name), owner=self)

    def _parameters(self) -> tuple[Tensor, ...]:
        number, alpha, gamma, mode = to_float64(self.number_per_cm3, self.alpha, self.gamma, self.mode_radius_um)
        return number * PER_M3_IN_PER_CM3, alpha, gamma, alpha / (gamma * mode**gamma)

    def _density(self, diameter_mm: Tensor, *parameters: Tensor) -> Tensor:
        number, alpha, gamma, b = parameters
        radius_um = 0.5 * diameter_mm / MM_PER_UM
        peak = (alpha + 1.0) / gamma
        log_norm = torch.log(gamma) + peak * torch.log(b) - torch.lgamma(peak)
        per_um_radius = number * torch.exp(log_norm + alpha * torch.log(radius_um) - b * radius_um**gamma)
        return 0.5 * per_um_radius / MM_PER_UM  # per radius to per diameter, per um to per mm

    def _partial_moment(self, order: float, low_mm: Tensor, high_mm: Tensor, *parameters: Tensor) -> Tensor:
        number, alpha, gamma, b = parameters
        low, high = (b * (0.5 * d / MM_PER_UM) ** gamma for d in (low_mm, high_mm))
        shape, peak = (alpha + 1.0 + order) / gamma, (alpha + 1.0) / gamma
        log_ratio = torch.lgamma(shape) - torch.lgamma(peak) - order / gamma * torch.log(b)
        share: Tensor = incomplete_gamma_between(shape, low, high)
        scale: float = (2.0 * MM_PER_UM) ** order
        return number * scale * torch.exp(log_ratio) * share

    def _span_mm(self) -> tuple[float, float]:
        _, alpha, gamma, b = (parameter.detach() for parameter in self._parameters())
        self._check_any(alpha, gamma, b)
        radius_um = ((70.0 + 4.0 * (alpha + 1.0) / gamma) / b) ** (1.0 / gamma)
        high = 2.0 * MM_PER_UM * float(radius_um.max())
        return 1e-6 * 2.0 * MM_PER_UM * float(radius_um.min()), high

    def scaled(self, factor: Quantity) -> Self:
        """The same shape with ``factor`` times as many particles."""
        return replace(self, number_per_cm3=_times(self.number_per_cm3, factor))


@dataclass(frozen=True, eq=False)
class LogNormal(SizeDistribution):
    """``n(r) = N / (r sigma sqrt(2 pi)) exp(-(ln r - ln r_med)^2 / (2 sigma^2))``, per unit *radius*.

    Args:
        number_per_cm3: N over all sizes, cm^-3, ``(...,)``.
        median_radius_um: r_med, um, ``(...,)``.
        sigma: standard deviation of ln r (the ln of the geometric standard deviation), ``(...,)``.

    References:
        PHYSICS.md 2.1 and 2.3 (D3.4 calls it "Normal").

    Example:
        >>> fog = LogNormal(3189.711, math.exp(0.118386081), 0.656240841)
        >>> round(1e3 * float(fog.effective_diameter_mm) / 2, 2)  # effective radius, um
        3.3
    """

    number_per_cm3: Quantity
    median_radius_um: Quantity
    sigma: Quantity

    per: ClassVar[str] = "radius"

    def __post_init__(self) -> None:
        check_arguments(
            "LogNormal(number_per_cm3: Quantity, median_radius_um: Quantity, sigma: Quantity)",
            self.number_per_cm3,
            self.median_radius_um,
            self.sigma,
        )
        super().__post_init__()
        check_at_least("number_per_cm3", self.number_per_cm3, 0.0, unit="cm^-3", owner=self)
        check_positive("median_radius_um", self.median_radius_um, unit="um", owner=self)
        check_positive("sigma", self.sigma, owner=self)

    def _parameters(self) -> tuple[Tensor, ...]:
        number, median, sigma = to_float64(self.number_per_cm3, self.median_radius_um, self.sigma)
        return number * PER_M3_IN_PER_CM3, torch.log(2.0 * MM_PER_UM * median), sigma

    def _density(self, diameter_mm: Tensor, *parameters: Tensor) -> Tensor:
        # ln D and ln r differ by a constant, so the same sigma holds per diameter and the factor 1/2 is in 1/D.
        number, log_median_mm, sigma = parameters
        z = (torch.log(diameter_mm) - log_median_mm) / sigma
        return number / (diameter_mm * sigma * math.sqrt(2.0 * math.pi)) * torch.exp(-0.5 * z**2)

    def _partial_moment(self, order: float, low_mm: Tensor, high_mm: Tensor, *parameters: Tensor) -> Tensor:
        number, log_median_mm, sigma = parameters
        # ln D^k n(D) is the same bell moved by k sigma^2. A bound at 0 stands for ln D = -700.
        low, high = (
            (torch.log(d.clamp_min(1e-300)) - log_median_mm) / sigma - order * sigma for d in (low_mm, high_mm)
        )
        share = torch.where(low > 0, _bell_below(-low) - _bell_below(-high), _bell_below(high) - _bell_below(low))
        return number * torch.exp(order * log_median_mm + 0.5 * (order * sigma) ** 2) * share

    def _inverse_tail(self, number_per_m3: Tensor, *parameters: Tensor) -> Tensor:
        number, log_median_mm, sigma = parameters
        high = (math.log(min(self.diameter_max_mm, 1e12)) - log_median_mm) / sigma
        above = number_per_m3 / number.clamp_min(1e-300) + _bell_below(-high)
        z = -torch.special.ndtri(above.clamp(1e-300, 1.0))
        return torch.exp(log_median_mm + sigma * z.clamp(-38.0, 38.0))

    def _span_mm(self) -> tuple[float, float]:
        _, log_median_mm, sigma = (parameter.detach() for parameter in self._parameters())
        self._check_any(log_median_mm, sigma)
        high = float((log_median_mm + 8.0 * sigma + 6.0 * sigma**2).max())
        return math.exp(float((log_median_mm - 8.0 * sigma).min())), math.exp(high)

    def scaled(self, factor: Quantity) -> Self:
        """The same shape with ``factor`` times as many particles."""
        return replace(self, number_per_cm3=_times(self.number_per_cm3, factor))


def _bell_below(z: Tensor) -> Tensor:
    """Share of a standard normal below z; erfc keeps the digits of a far lower tail."""
    share: Tensor = 0.5 * torch.special.erfc(-z / math.sqrt(2.0))
    return share


def _per_diameter(intercept: Tensor, per_size: Per) -> Tensor:
    return 0.5 * intercept if per_size == "radius" else intercept


def _times(value: Quantity, factor: Quantity) -> Tensor:
    number, share = to_float64(value, factor)
    return number * share
