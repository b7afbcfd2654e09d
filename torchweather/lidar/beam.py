"""Beam: geometry and near-range response of a LiDAR's beam, and the grid of ranges along it."""

from __future__ import annotations

import copy
import math

import numpy as np
import torch
from torch import Tensor, nn

from torchweather.lidar.sensor import Lidar
from torchweather.pipeline.tiling import is_exporting

__all__ = ["Beam", "RangeGrid"]

RANGE_NODES = 257  # cells by powers of two: the search in strongest.py halves them
GAUSS_NODES = 3  # of the quadrature in each cell of ranges


class Beam(nn.Module):
    """A cone of light, uniform inside and dark outside, and the receiver's response to what is near.

    Buffers, so that they can be fitted: ``exit_diameter_m`` d0, ``divergence_rad`` theta (full angle), ``near_start_m``
    R1, ``near_full_m`` R2, ``near_power``, ``threshold`` X_thr in 1/(m^2 sr). What the receiver takes of near particles
    beyond that is in ``extra_near_full_m`` and ``extra_near_power``, ``(B,)`` or ``None``.

    References:
        PHYSICS.md 5.2, 5.3.
    """

    exit_diameter_m: Tensor
    divergence_rad: Tensor
    near_start_m: Tensor
    near_full_m: Tensor
    near_power: Tensor
    threshold: Tensor
    extra_near_full_m: Tensor | None
    extra_near_power: Tensor | None

    def __init__(self, sensor: Lidar) -> None:
        super().__init__()
        for name, value in (
            ("exit_diameter_m", sensor.exit_diameter_mm * 1e-3),
            ("divergence_rad", sensor.divergence_mrad * 1e-3),
            ("near_start_m", sensor.near_start_m),
            ("near_full_m", sensor.near_full_m),
            ("near_power", sensor.near_power),
            ("threshold", sensor.threshold_per_m2_sr),
        ):
            self.register_buffer(name, torch.tensor(value, dtype=torch.float32))
        self.register_buffer("extra_near_full_m", None)
        self.register_buffer("extra_near_power", None)

    def widened(self, extra_rad: Tensor) -> Beam:
        """A beam like this one with a larger divergence, ``()`` or ``(B,)`` radians more, full angle.

        Its diameters and areas have the batch first: ``(B, ...)`` for ranges ``(cells, G)``.
        """
        found = self._copied()
        extra = extra_rad.to(self.divergence_rad)
        found.divergence_rad = self.divergence_rad + (extra.reshape(-1, 1, 1) if extra.ndim else extra)
        return found

    def fainter_near(self, full_m: Tensor, power: Tensor) -> Beam:
        """A beam like this one whose receiver takes ``min(1, R / full_m)^power`` of particles' light, ``(B,)``."""
        found = self._copied()
        found.extra_near_full_m, found.extra_near_power = full_m.to(self.near_full_m), power.to(self.near_full_m)
        return found

    def _copied(self) -> Beam:
        found = copy.copy(self)
        found._buffers = dict(self._buffers)
        return found

    def diameter_m(self, range_m: Tensor) -> Tensor:
        """``D_b = d0 + theta R``, metres."""
        return self.exit_diameter_m + self.divergence_rad * range_m

    def area_m2(self, range_m: Tensor) -> Tensor:
        """Cross-section ``pi D_b^2 / 4``, m^2."""
        return 0.25 * math.pi * self.diameter_m(range_m).square()

    def _ramp(self, range_m: Tensor) -> Tensor:
        """Place between the beginning of the near-range response, 0, and its end, 1; beyond both ends too."""
        return (range_m - self.near_start_m) / (self.near_full_m - self.near_start_m)

    def near_ramp(self, range_m: Tensor) -> Tensor:
        """The near-range response before its power, 0 to 1."""
        return self._ramp(range_m).clamp(0.0, 1.0)

    def near_response(self, range_m: Tensor) -> Tensor:
        """xi, 0 to 1: share of a near target's light that the receiver takes."""
        ramp = self._ramp(range_m)
        if not is_exporting() and not self.near_power.requires_grad and float(self.near_power) == 1.0:
            return ramp.clamp(0.0, 1.0)
        inside = ramp.clamp(1e-12, 1.0)  # a power of 0 would have no gradient
        return torch.where(ramp > 0, inside**self.near_power, torch.zeros_like(ramp))

    def particle_response(self, range_m: Tensor, *, of_each_sample: bool = False) -> Tensor:
        """Share of a near particle's light that the receiver takes, 0 to 1.

        Args:
            range_m: ``(...)``, the same for all samples, or ``(B, N)``.
            of_each_sample: whether the ranges have the batch first.

        Returns:
            Of the shape of the ranges; ``(B, ...)`` of ranges for all samples where samples differ.
        """
        response = self.near_response(range_m)
        if self.extra_near_power is None or self.extra_near_full_m is None:
            return response
        shape = (-1, *[1] * (range_m.ndim - of_each_sample))
        ramp = range_m / self.extra_near_full_m.reshape(shape)
        return response * ramp.clamp(1e-12, 1.0) ** self.extra_near_power.reshape(shape)


class RangeGrid(nn.Module):
    """Nodes along a beam, close together where the near-range response rises: ``r = r0 + c (exp(s p) - 1)``.

    Args:
        near_m, far_m: first and last node.
        scale_m: c; nodes are evenly spaced up to about there, and geometrically beyond.
        nodes: their number.
    """

    quadrature_m: Tensor
    quadrature_width_m: Tensor

    def __init__(self, near_m: float, far_m: float, scale_m: float, nodes: int = RANGE_NODES) -> None:
        super().__init__()
        self.near_m, self.far_m, self.scale_m, self.nodes = near_m, far_m, scale_m, nodes
        self.stretch = math.log1p((far_m - near_m) / scale_m)
        points, weights = np.polynomial.legendre.leggauss(GAUSS_NODES)
        cells = np.arange(nodes - 1)[:, None]
        place = (cells + 0.5 * (points + 1.0)) / (nodes - 1)  # (cells, GAUSS_NODES), uniform in p
        growth = scale_m * np.exp(self.stretch * place)
        width = growth * self.stretch * 0.5 * weights / (nodes - 1)
        self.register_buffer("quadrature_m", torch.from_numpy(near_m + growth - scale_m).float(), persistent=False)
        self.register_buffer("quadrature_width_m", torch.from_numpy(width).float(), persistent=False)

    @classmethod
    def of(cls, sensor: Lidar) -> RangeGrid:
        """The grid on which a sensor can see particles."""
        near_m = max(sensor.near_start_m, sensor.min_range_m)
        return cls(near_m, sensor.max_range_m, 0.25 * (sensor.near_full_m - sensor.near_start_m))

    def position(self, range_m: Tensor) -> Tensor:
        """Place of a range on the grid in nodes, 0 to ``nodes - 1``; ranges outside count as the ends."""
        stretched = torch.log1p((range_m - self.near_m).clamp_min(0.0) / self.scale_m)
        return (stretched * ((self.nodes - 1) / self.stretch)).clamp_max(self.nodes - 1)

    def range_m(self, position: Tensor) -> Tensor:
        """Range at a place, metres."""
        return self.near_m + self.scale_m * torch.expm1(position * (self.stretch / (self.nodes - 1)))

    def integrated(self, density_per_m: Tensor) -> Tensor:
        """Integral from the first node, ``(..., nodes)``, of a density at ``quadrature_m``, ``(..., cells, G)``."""
        cells = (density_per_m * self.quadrature_width_m).sum(-1)
        return torch.cat([torch.zeros_like(cells[..., :1]), cells.cumsum(-1)], -1)
