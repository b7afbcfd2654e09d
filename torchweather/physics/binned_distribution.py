"""A measured size distribution: the bins of a disdrometer or of a particle counter."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np
import torch
from torch import Tensor

from torchweather.core.arguments import check_arguments
from torchweather.core.errors import InputValueError, check_at_least, check_positive
from torchweather.physics.float64 import Quantity, to_float64
from torchweather.physics.size_distribution import Per, SizeDistribution

__all__ = ["Binned"]


@dataclass(frozen=True, eq=False, init=False)
class Binned(SizeDistribution):
    """A density that is constant inside each measured bin and 0 outside the bins.

    Args:
        edges_mm: bin edges, mm of diameter (or of radius, see ``per_size``), ``(K + 1,)``, rising.
        density_per_m3_mm: density in each bin, m^-3 mm^-1, ``(..., K)``.
        per_size: ``"radius"`` where edges are radii and the density is per mm of radius; both are converted.
        particle: see ``SizeDistribution``.

    References:
        PHYSICS.md 0, 2.

    Example:
        >>> spectrum = Binned([0.2, 0.4, 0.8], [1000.0, 250.0])
        >>> float(spectrum.total_per_m3)
        300.0
    """

    edges_mm: Tensor
    density_per_m3_mm: Tensor

    def __init__(
        self,
        edges_mm: Tensor | list[float],
        density_per_m3_mm: Tensor | list[float],
        *,
        per_size: Per = "diameter",
        particle: str = "drop",
    ) -> None:
        check_arguments(
            "Binned(edges_mm: Nested, density_per_m3_mm: Nested, particle: str)",
            edges_mm,
            density_per_m3_mm,
            particle,
        )
        check_arguments("Binned(per_size: str, particle: str)", per_size, particle)
        edges = torch.as_tensor(edges_mm, dtype=torch.float64)
        density = torch.as_tensor(density_per_m3_mm, device=edges.device).to(torch.float64)
        if edges.ndim != 1 or density.ndim < 1 or edges.numel() != density.shape[-1] + 1 or edges.numel() < 2:
            raise InputValueError(
                f"Binned: edges_mm must have shape (K + 1,) for a density of shape (..., K); got "
                f"{tuple(edges.shape)} and {tuple(density.shape)}."
            )
        if not bool((edges.diff() > 0).all()):
            raise InputValueError("Binned: edges_mm must rise from bin to bin; sort them and join bins of width 0.")
        check_at_least("edges_mm", edges, 0.0, unit="mm", owner=self)
        check_at_least("density_per_m3_mm", density, 0.0, unit="m^-3 mm^-1", owner=self)
        if per_size == "radius":  # n(r) dr = N(D) dD with D = 2 r
            edges, density = 2.0 * edges, 0.5 * density
        fields = {
            "edges_mm": edges,
            "density_per_m3_mm": density,
            "diameter_min_mm": float(edges[0]),
            "diameter_max_mm": float(edges[-1]),
            "particle": particle,
        }
        for name, value in fields.items():
            object.__setattr__(self, name, value)
        self.__post_init__()

    @classmethod
    def from_counts(
        cls,
        counts: Tensor | list[float],
        edges_mm: Tensor | list[float],
        *,
        area_m2: float,
        duration_s: float,
        fall_speed_m_per_s: Tensor | list[float],
        particle: str = "drop",
    ) -> Binned:
        """Distribution that sent ``counts`` particles through a disdrometer's beam.

        ``N_k = counts_k / (area duration speed_k width_k)``: in the time of the measurement every particle within
        ``speed duration`` above the area passes it.

        Args:
            counts: particles per bin, ``(..., K)``.
            edges_mm: bin edges, mm of diameter, ``(K + 1,)``.
            area_m2: horizontal measuring area, m^2 (a typical laser disdrometer has 0.0054 m^2).
            duration_s: measuring time, s.
            fall_speed_m_per_s: speed of each bin's particles, m/s, ``(..., K)``, measured or from a law.
            particle: see ``SizeDistribution``.

        Example:
            >>> spectrum = Binned.from_counts([54.0], [1.0, 2.0], area_m2=0.0054, duration_s=60.0,
            ...                               fall_speed_m_per_s=[5.0])
            >>> round(float(spectrum.total_per_m3), 2)
            33.33
        """
        check_positive("area_m2", area_m2, unit="m^2", owner=cls)
        check_positive("duration_s", duration_s, unit="s", owner=cls)
        edges, number, speed = (
            torch.as_tensor(value, dtype=torch.float64) for value in (edges_mm, counts, fall_speed_m_per_s)
        )
        check_positive("fall_speed_m_per_s", speed, unit="m/s", owner=cls, advice="Leave out bins without a speed.")
        density = number / (area_m2 * duration_s * speed * edges.diff())
        return cls(edges, density, particle=particle)

    def _parameters(self) -> tuple[Tensor, ...]:
        return (self.density_per_m3_mm,)

    @property
    def batch_shape(self) -> torch.Size:
        """Shape of the density without its bins."""
        return self.density_per_m3_mm.shape[:-1]

    def within(self, diameter_min_mm: float, diameter_max_mm: float) -> Self:
        """The same spectrum cut to a narrower domain, mm; a bin may be cut in two."""
        low, high = max(diameter_min_mm, self.diameter_min_mm), min(diameter_max_mm, self.diameter_max_mm)
        inner = self.edges_mm[(self.edges_mm > low) & (self.edges_mm < high)]
        edges = torch.cat([inner.new_tensor([low]), inner, inner.new_tensor([high])])
        density = self.number_density_per_m3_mm(0.5 * (edges[1:] + edges[:-1]))
        return type(self)(edges, density, particle=self.particle)

    def scaled(self, factor: Quantity) -> Self:
        """The same spectrum with ``factor`` times as many particles, ``factor`` of the batch shape."""
        density, share = to_float64(self.density_per_m3_mm, factor)
        return type(self)(self.edges_mm, density * share.unsqueeze(-1), particle=self.particle)

    def number_density_per_m3_mm(self, diameter_mm: Quantity) -> Tensor:
        """Density of the bin that holds each diameter, m^-3 mm^-1, ``(..., K)``; 0 outside the bins."""
        _, diameter = to_float64(self.edges_mm, diameter_mm)
        inside = (diameter >= self.diameter_min_mm) & (diameter <= self.diameter_max_mm)
        cell = torch.bucketize(diameter, self.edges_mm, right=True) - 1
        density = _at_bins(self.density_per_m3_mm, cell.clamp(0, self.edges_mm.numel() - 2))
        return torch.where(inside, density, torch.zeros_like(density))

    def moment(self, order: float, low_mm: Quantity | None = None, high_mm: Quantity | None = None) -> Tensor:
        """Integral of ``D^order N(D) dD`` over the bins, or over the part from ``low_mm`` to ``high_mm``; exact."""
        low = self.diameter_min_mm if low_mm is None else low_mm
        high = self.diameter_max_mm if high_mm is None else high_mm
        low, high = to_float64(self.edges_mm, low, high)[1:]
        low = low.clamp(self.diameter_min_mm, self.diameter_max_mm)
        high = torch.maximum(high.clamp(self.diameter_min_mm, self.diameter_max_mm), low)
        power = order + 1.0
        lower = torch.maximum(self.edges_mm[:-1], low.unsqueeze(-1))  # (..., bins)
        upper = torch.minimum(self.edges_mm[1:], high.unsqueeze(-1))
        share = torch.where(upper > lower, (upper**power - lower**power) / power, torch.zeros_like(upper))
        density = self.density_per_m3_mm
        if share.ndim > 1 and density.ndim > 1:
            density = density.unsqueeze(-2)  # (..., 1, bins) against (..., K, bins)
        return (density * share).sum(-1)

    def inverse_tail(self, number_per_m3: Quantity) -> Tensor:
        """Diameter that ``number_per_m3`` particles exceed, mm; exact, linear inside a bin."""
        _, wanted = to_float64(self.edges_mm, number_per_m3)
        in_bin = self.density_per_m3_mm * self.edges_mm.diff()  # (..., bins)
        tail = torch.cat([in_bin.flip(-1).cumsum(-1).flip(-1), torch.zeros_like(in_bin[..., :1])], dim=-1)
        if tail.ndim > 1:
            tail = tail.unsqueeze(-2) if wanted.ndim else tail
        wanted = torch.minimum(wanted.clamp_min(0.0).unsqueeze(-1), tail[..., :1])
        # The last edge whose tail still reaches the wanted number opens the bin.
        cell = ((tail >= wanted).sum(-1) - 1).clamp(0, in_bin.shape[-1] - 1)
        above = tail.expand(*cell.shape, tail.shape[-1]).gather(-1, (cell + 1).unsqueeze(-1)).squeeze(-1)
        density = _at_bins(self.density_per_m3_mm, cell) if cell.ndim else self.density_per_m3_mm[..., cell]
        step = (wanted.squeeze(-1) - above) / density.clamp_min(1e-300)
        diameter = torch.maximum(self.edges_mm[cell + 1] - step, self.edges_mm[cell])
        return diameter

    def summed(self, diameter_mm: Tensor, weight_mm: Tensor) -> Tensor:
        """Integral of ``f N`` bin by bin: the nodes' running sum is read at the edges, where the density jumps."""
        running = weight_mm.cumsum(0) - 0.5 * weight_mm  # up to each node, which stands in the middle of its weight
        running = torch.cat([running.new_zeros(1), running[1:-1], weight_mm.sum().unsqueeze(0)])
        above = torch.searchsorted(diameter_mm, self.edges_mm).clamp(1, diameter_mm.numel() - 1)
        # Cross-sections rise as D^2, their running sum as D^3.
        left, right, edge = diameter_mm[above - 1] ** 3, diameter_mm[above] ** 3, self.edges_mm**3
        share = ((edge - left) / (right - left)).clamp(0.0, 1.0)
        at_edges = running[above - 1] + share * (running[above] - running[above - 1])
        return self.density_per_m3_mm @ at_edges.diff()

    def quadrature(self) -> tuple[Tensor, Tensor]:
        """Diameters and widths, mm, ``(K,)``: Gauss-Legendre inside every bin."""
        point, weight = (torch.from_numpy(v).to(self.device) for v in np.polynomial.legendre.leggauss(8))
        half, middle = 0.5 * self.edges_mm.diff(), 0.5 * (self.edges_mm[1:] + self.edges_mm[:-1])
        diameter = middle.unsqueeze(-1) + half.unsqueeze(-1) * point
        return diameter.flatten(), (half.unsqueeze(-1) * weight).flatten()

    def _density(self, diameter_mm: Tensor, *parameters: Tensor) -> Tensor:
        return self.number_density_per_m3_mm(diameter_mm)

    def _partial_moment(self, order: float, low_mm: Tensor, high_mm: Tensor, *parameters: Tensor) -> Tensor:
        return self.moment(order, low_mm, high_mm)

    def _span_mm(self) -> tuple[float, float]:
        return max(self.diameter_min_mm, 1e-4 * self.diameter_max_mm), self.diameter_max_mm


def _at_bins(density: Tensor, cell: Tensor) -> Tensor:
    """Values ``(..., bins)`` at bin numbers ``()``, ``(K,)`` or ``(..., K)``."""
    if density.ndim == 1:
        return density[cell]
    if cell.ndim <= 1:
        return density[..., cell]
    lead = np.broadcast_shapes(density.shape[:-1], cell.shape[:-1])
    return density.expand(*lead, density.shape[-1]).gather(-1, cell.expand(*lead, cell.shape[-1]))
