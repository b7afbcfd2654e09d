"""Interface of all particle size distributions: density per diameter, moments, tails, sampling, quadrature."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import ClassVar, Literal, Self

import numpy as np
import torch
from torch import Tensor

from torchweather.core.arguments import check_arguments, check_broadcast
from torchweather.core.errors import InputValueError, check_at_least, check_between, check_one_of
from torchweather.physics.float64 import Quantity, to_float64
from torchweather.physics.snow_geometry import (
    ICE_DENSITY_G_PER_CM3,
    SNOW_DENSITY_AT_1MM_G_PER_CM3,
    SNOW_DENSITY_EXPONENT,
    SOLID_ICE_BELOW_MM,
)

__all__ = ["Particle", "Per", "SizeDistribution"]

Particle = Literal["drop", "melted-flake", "flake"]
Per = Literal["diameter", "radius"]

# Stands for an infinite diameter: far beyond any particle, yet finite, so that gradients stay finite too.
_FARTHEST_MM = 1e12
_TABLE_NODES = 1025  # of the inverse of the count, over ln D


@dataclass(frozen=True, eq=False, kw_only=True)
class SizeDistribution(ABC):
    """Number of particles per volume and diameter, with the domain outside which it is 0.

    Parameters may be tensors of any batch shape ``(...,)``. A function of diameters gives the parameters one
    trailing axis: parameters ``(B,)`` and diameters ``(K,)`` or ``(B, K)`` give ``(B, K)``. Parameters that are
    numbers leave the shape of the diameters alone. Results are float64 on the device of the parameters.

    Args:
        diameter_min_mm: smallest diameter, mm.
        diameter_max_mm: largest diameter, mm; may be ``inf``.
        particle: what the diameter is the diameter of. ``"drop"``: a water sphere. ``"melted-flake"``: the water
            sphere a snowflake melts to (Gunn-Marshall, Sekhon-Srivastava). ``"flake"``: the snowflake itself, of
            bulk density ``snow_bulk_density_g_per_cm3`` (Brandes).

    References:
        PHYSICS.md 0, 2.1.
    """

    diameter_min_mm: float = 0.0
    diameter_max_mm: float = math.inf
    particle: Particle = "drop"

    per: ClassVar[str] = "diameter"
    """Size to which the stated number parameter refers; ``number_density_per_m3_mm`` is always per diameter."""

    def __post_init__(self) -> None:
        check_arguments(
            f"{type(self).__name__}(diameter_min_mm: float, diameter_max_mm: float)",
            self.diameter_min_mm,
            self.diameter_max_mm,
        )
        object.__setattr__(self, "diameter_min_mm", float(self.diameter_min_mm))
        object.__setattr__(self, "diameter_max_mm", float(self.diameter_max_mm))
        check_at_least("diameter_min_mm", self.diameter_min_mm, 0.0, unit="mm", owner=self)
        if not self.diameter_max_mm > self.diameter_min_mm:
            raise InputValueError(
                f"{type(self).__name__}: diameter_max_mm must be above diameter_min_mm = {self.diameter_min_mm:g} mm; "
                f"got {self.diameter_max_mm!r}."
            )
        check_one_of("particle", self.particle, ("drop", "melted-flake", "flake"), owner=self)

    @abstractmethod
    def _parameters(self) -> tuple[Tensor, ...]:
        """The parameters as float64 tensors, in the order the ``_aligned`` methods take them."""

    @abstractmethod
    def _density(self, diameter_mm: Tensor, *parameters: Tensor) -> Tensor:
        """Density per m^3 and mm of diameter, the domain ignored; arguments broadcast."""

    @abstractmethod
    def _partial_moment(self, order: float, low_mm: Tensor, high_mm: Tensor, *parameters: Tensor) -> Tensor:
        """Integral of D^order N(D) from ``low_mm`` to ``high_mm``, the domain ignored; arguments broadcast."""

    @abstractmethod
    def _span_mm(self) -> tuple[float, float]:
        """Diameters that hold all but 1e-12 of the moments 2 to 6, the domain ignored, over the whole batch."""

    def _check_any(self, *parameters: Tensor) -> None:
        """Refuse to give a span of no distribution at all."""
        if not all(one.numel() for one in parameters):
            raise InputValueError(f"{type(self).__name__}: expected one distribution or more; got none.")

    @abstractmethod
    def scaled(self, factor: Quantity) -> Self:
        """The same shape with ``factor`` times as many particles; ``factor`` broadcasts against the parameters.

        Args:
            factor: dimensionless, ``(...,)``, 0 or more.
        """

    @property
    def device(self) -> torch.device:
        """Device of the parameters (the CPU for numbers)."""
        return self._parameters()[0].device

    @property
    def batch_shape(self) -> torch.Size:
        """Shape of the parameters: ``()`` for numbers."""
        return torch.Size(np.broadcast_shapes(*(parameter.shape for parameter in self._parameters())))

    def within(self, diameter_min_mm: float, diameter_max_mm: float) -> Self:
        """The same density on another domain, mm; nothing is renormalised."""
        check_arguments(
            "Exponential.within(diameter_min_mm: float, diameter_max_mm: float)",
            diameter_min_mm,
            diameter_max_mm,
        )
        return replace(self, diameter_min_mm=diameter_min_mm, diameter_max_mm=diameter_max_mm)

    def _aligned(self, *diameters_mm: Quantity) -> tuple[list[Tensor], list[Tensor]]:
        """Diameters and parameters in float64 on one device, parameters with a trailing axis where one is needed."""
        parameters = list(self._parameters())
        diameters = list(to_float64(parameters[0], *diameters_mm)[1:])
        if any(diameter.ndim for diameter in diameters):
            parameters = [p.unsqueeze(-1) if p.ndim else p for p in parameters]
        return diameters, parameters

    def number_density_per_m3_mm(self, diameter_mm: Quantity) -> Tensor:
        """Number of particles per cubic metre and per mm of *diameter*; 0 outside the domain.

        Args:
            diameter_mm: diameters, mm, ``(K,)`` or ``(..., K)``.

        Returns:
            ``(..., K)``, m^-3 mm^-1.
        """
        check_arguments("Gamma.number_density_per_m3_mm(diameter_mm: Quantity)", diameter_mm)
        (diameter,), parameters = self._aligned(diameter_mm)
        inside = (diameter >= self.diameter_min_mm) & (diameter <= self.diameter_max_mm)
        # The density is evaluated inside the domain only: a power of 0 outside it would spoil gradients.
        safe = diameter.clamp(max(self.diameter_min_mm, 1e-12), min(self.diameter_max_mm, _FARTHEST_MM))
        density = self._density(safe, *parameters)
        return torch.where(inside, density, torch.zeros_like(density))

    def moment(self, order: float, low_mm: Quantity | None = None, high_mm: Quantity | None = None) -> Tensor:
        """Integral of ``D^order N(D) dD`` over the domain, or over the part of it from ``low_mm`` to ``high_mm``.

        Args:
            order: power of the diameter, 0 or more.
            low_mm: lower end, mm, ``(K,)`` or ``(..., K)``; None is the domain's.
            high_mm: upper end, mm; None is the domain's.

        Returns:
            mm^order m^-3; of the batch shape, or ``(..., K)`` where an end is given. An empty interval gives 0.
        """
        check_arguments(
            "LogNormal.moment(order: float, low_mm: Quantity | None, high_mm: Quantity | None)",
            order,
            low_mm,
            high_mm,
        )
        check_between("order", order, 0.0, 100.0, owner=self)
        check_broadcast(type(self).__name__, low_mm=low_mm, high_mm=high_mm)
        (low, high), parameters = self._aligned(
            self.diameter_min_mm if low_mm is None else low_mm, self.diameter_max_mm if high_mm is None else high_mm
        )
        top = min(self.diameter_max_mm, _FARTHEST_MM)
        low = low.clamp(self.diameter_min_mm, top)
        high = torch.maximum(high.clamp(self.diameter_min_mm, top), low)
        return self._partial_moment(order, low, high, *parameters)

    @property
    def total_per_m3(self) -> Tensor:
        """Number of particles per cubic metre, all sizes of the domain."""
        return self.moment(0.0)

    @property
    def effective_diameter_mm(self) -> Tensor:
        """Third over second moment, mm: the diameter of the mean volume per cross-section."""
        return self.moment(3.0) / self.moment(2.0)

    def tail_per_m3(self, diameter_mm: Quantity) -> Tensor:
        """Number of particles per cubic metre larger than ``diameter_mm``, ``(..., K)``."""
        return self.moment(0.0, low_mm=diameter_mm)

    def inverse_tail(self, number_per_m3: Quantity) -> Tensor:
        """Diameter that ``number_per_m3`` particles exceed, mm; the inverse of ``tail_per_m3``.

        Args:
            number_per_m3: ``(K,)`` or ``(..., K)``, m^-3; above the total gives the smallest diameter of the domain.

        Returns:
            ``(..., K)``, mm, inside the domain.
        """
        (number,), parameters = self._aligned(number_per_m3)
        total = self.total_per_m3
        total = total.unsqueeze(-1) if number.ndim and total.ndim else total
        number = torch.minimum(number.clamp_min(0.0), total)
        diameter = self._inverse_tail(number, *parameters)
        return diameter.clamp(self.diameter_min_mm, self.diameter_max_mm)

    def sample_diameter_mm(self, u: Quantity) -> Tensor:
        """Diameters that standard uniforms select: the inverse of the cumulative count on the domain.

        Args:
            u: uniform in [0, 1), ``(K,)`` or ``(..., K)``; 0 gives the smallest diameter.

        Returns:
            ``(..., K)``, mm.
        """
        check_arguments("Gamma.sample_diameter_mm(u: Quantity)", u)
        (uniform,), _ = self._aligned(u)
        total = self.total_per_m3
        total = total.unsqueeze(-1) if uniform.ndim and total.ndim else total
        return self.inverse_tail((1.0 - uniform) * total)

    def _inverse_tail(self, number_per_m3: Tensor, *parameters: Tensor) -> Tensor:
        """Table over ln D, cubic between the nodes with the slope the density gives: 1e-6 of the diameter."""
        low, high = self.span_mm()
        steps = torch.arange(_TABLE_NODES, dtype=torch.float64, device=number_per_m3.device) / (_TABLE_NODES - 1)
        log_d = math.log(low) + steps * math.log(high / low)
        nodes = log_d.exp()
        with torch.no_grad():
            tail = self.tail_per_m3(nodes)  # (..., nodes), falling
            slope = -self.number_density_per_m3_mm(nodes) * nodes  # d tail / d ln D
            total = self.total_per_m3.unsqueeze(-1) if tail.ndim > 1 else self.total_per_m3
        shape = np.broadcast_shapes(tail.shape[:-1] + number_per_m3.shape[-1:], number_per_m3.shape)
        number = number_per_m3.expand(shape)
        if tail.ndim > 1:
            number = number.contiguous()
        cell = (torch.searchsorted(-tail, -number) - 1).clamp(0, _TABLE_NODES - 2)

        def at(table: Tensor, index: Tensor) -> Tensor:
            return table[index] if table.ndim == 1 else table.expand(*index.shape[:-1], -1).gather(-1, index)

        high_tail, low_tail = at(tail, cell), at(tail, cell + 1)
        width = (high_tail - low_tail).clamp_min(1e-300)
        t = ((high_tail - number) / width).clamp(0.0, 1.0)
        step = math.log(high / low) / (_TABLE_NODES - 1)
        # Slopes of ln D over t, limited to three times the secant, which keeps the cubic rising.
        left = (-width / at(slope, cell).clamp_max(-1e-300)).clamp_max(3.0 * step)
        right = (-width / at(slope, cell + 1).clamp_max(-1e-300)).clamp_max(3.0 * step)
        cubic = t * t * (3.0 - 2.0 * t) * step + t * (1.0 - t) * ((1.0 - t) * left - t * right)
        diameter = torch.exp(log_d[cell] + cubic)
        # Below the first node the count is a power of the diameter.
        first = (total - tail[..., :1]) if tail.ndim > 1 else total - tail[0]
        power = (-slope[..., :1] if tail.ndim > 1 else -slope[0]) / first.clamp_min(1e-300)
        share = ((total - number) / first.clamp_min(1e-300)).clamp(1e-300, 1.0)
        below = low * torch.exp(torch.log(share) / power.clamp_min(1e-3))
        return torch.where((total - number < first) & (first > 0), below, diameter)

    def liquid_water_g_per_m3(self) -> Tensor:
        """Mass of water (or of ice, melted) per cubic metre of air, g/m^3, of the batch shape.

        ``pi/6 rho int D^3 N dD``; for ``particle="flake"`` with the bulk density of snow.
        """
        cubic_mm_to_g = 1e-3  # water, 1 g/cm^3
        if self.particle != "flake":
            return math.pi / 6.0 * cubic_mm_to_g * self.moment(3.0)
        # In two pieces because the bulk density is capped at that of ice below 0.17 mm.
        loose = SNOW_DENSITY_AT_1MM_G_PER_CM3 * self.moment(3.0 + SNOW_DENSITY_EXPONENT, low_mm=SOLID_ICE_BELOW_MM)
        solid = ICE_DENSITY_G_PER_CM3 * self.moment(3.0, high_mm=SOLID_ICE_BELOW_MM)
        return math.pi / 6.0 * cubic_mm_to_g * (loose + solid)

    def summed(self, diameter_mm: Tensor, weight_mm: Tensor) -> Tensor:
        """``sum N(D) weight``: the integral of ``f N`` for nodes rising in D with ``weight = f width``.

        Args:
            diameter_mm: nodes, ``(K,)``, rising.
            weight_mm: weights, ``(K,)``.

        Returns:
            Of the batch shape.
        """
        return self.number_density_per_m3_mm(diameter_mm) @ weight_mm

    def span_mm(self) -> tuple[float, float]:
        """Finite diameters, mm, outside which nothing of the domain contributes to the moments 2 to 6."""
        low, high = self._span_mm()
        low, high = max(low, self.diameter_min_mm), min(high, self.diameter_max_mm)
        if not high > low:  # the whole domain lies in one far tail: integrate it all
            low = max(self.diameter_min_mm, 1e-12)
            high = self.diameter_max_mm if math.isfinite(self.diameter_max_mm) else 1e3 * low
        return low, high

    def quadrature(self) -> tuple[Tensor, Tensor]:
        """Diameters and widths, mm, ``(K,)``: ``int f N dD = (f(D) N(D) width).sum(-1)``.

        Gauss-Legendre in panels of ln D; 1e-10 of the moments 2 to 6 for a smooth ``f``.
        """
        low, high = self.span_mm()
        diameter, width = _log_gauss_legendre(low, high)
        return diameter.to(self.device), width.to(self.device)


@lru_cache(maxsize=64)
def _log_gauss_legendre(low: float, high: float, panels: int = 48, order: int = 10) -> tuple[Tensor, Tensor]:
    point, weight = np.polynomial.legendre.leggauss(order)
    edges = np.linspace(math.log(low), math.log(high), panels + 1)
    half = 0.5 * np.diff(edges)[:, None]
    middle = 0.5 * (edges[1:] + edges[:-1])[:, None]
    diameter = np.exp(middle + half * point).ravel()
    return torch.from_numpy(diameter), torch.from_numpy((half * weight).ravel() * diameter)
