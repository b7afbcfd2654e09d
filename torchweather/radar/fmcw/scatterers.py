"""Scatterers: what a radar looks at, as points that each return a complex field."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from torchweather.core.arguments import check_arguments
from torchweather.core.errors import InputTypeError, InputValueError, check_finite, check_positive

__all__ = ["Scatterers"]


@dataclass(frozen=True)
class Scatterers:
    """Points that return a radar's signal.

    Args:
        position_m: ``(..., M, 3)`` in the radar's frame (x forward, y left, z up) at the beginning of the frame.
        speed_m_per_s: ``(..., M)`` radial, positive receding.
        field_m: ``(..., M)`` complex; its square is the radar cross section in m^2, its phase that of the echo without
            the way there and back. 0 is no scatterer: pad with it.

    Note:
        Radar cross section of 1 m^2: a large conducting sphere of radius 0.564 m (``PHYSICS.md`` 6.1).

    Example:
        >>> corner = Scatterers.from_rcs(torch.tensor([[20.0, 0.0, 0.0]]), 10.0)
        >>> float(corner.rcs_dbsm)
        10.0
    """

    position_m: Tensor
    speed_m_per_s: Tensor
    field_m: Tensor

    def __post_init__(self) -> None:
        check_arguments(
            "Scatterers(position_m: Tensor, speed_m_per_s: Tensor, field_m: Tensor)",
            self.position_m,
            self.speed_m_per_s,
            self.field_m,
        )
        shape = self.position_m.shape
        if len(shape) < 2 or shape[-1] != 3:
            raise InputValueError(f"Scatterers: position_m must be (..., M, 3) in metres; got shape {tuple(shape)}.")
        if not self.position_m.is_floating_point():
            raise InputTypeError(f"Scatterers: position_m must be floating point; got {self.position_m.dtype}.")
        if not self.field_m.is_complex():
            raise InputTypeError(f"Scatterers: field_m must be complex, metres; got {self.field_m.dtype}.")
        for name in ("speed_m_per_s", "field_m"):
            value: Tensor = getattr(self, name)
            if value.shape != shape[:-1]:
                raise InputValueError(
                    f"Scatterers: {name} must be {tuple(shape[:-1])}, one a position; got shape {tuple(value.shape)}."
                )
        check_finite("position_m", self.position_m, unit="m", owner=self)
        check_finite("speed_m_per_s", self.speed_m_per_s, unit="m/s", owner=self)
        check_finite("field_m", torch.view_as_real(self.field_m), unit="m", owner=self)

    @classmethod
    def from_rcs(
        cls,
        position_m: Tensor,
        rcs_dbsm: Tensor | float,
        speed_m_per_s: Tensor | float = 0.0,
        phase_rad: Tensor | float = 0.0,
    ) -> Scatterers:
        """Scatterers of known radar cross section.

        Args:
            position_m: ``(..., M, 3)``.
            rcs_dbsm, speed_m_per_s, phase_rad: ``(..., M)`` or one value for all. -inf dBsm is no scatterer.
        """
        position_m = torch.as_tensor(position_m)
        shape = position_m.shape[:-1]

        def each(value: Tensor | float) -> Tensor:
            return torch.as_tensor(value).to(position_m).expand(shape)

        field = torch.polar(10.0 ** (each(rcs_dbsm) / 20.0), each(phase_rad).contiguous())
        return cls(position_m, each(speed_m_per_s), field)

    @classmethod
    def from_spherical(
        cls,
        range_m: Tensor,
        azimuth_rad: Tensor | float,
        elevation_rad: Tensor | float,
        rcs_dbsm: Tensor | float,
        speed_m_per_s: Tensor | float = 0.0,
        phase_rad: Tensor | float = 0.0,
    ) -> Scatterers:
        """Scatterers of known radar cross section at known ranges and angles.

        Args:
            range_m: ``(..., M)``, above 0.
            azimuth_rad, elevation_rad: ``(..., M)`` or one value for all.
            rcs_dbsm, speed_m_per_s, phase_rad: as in ``from_rcs``.

        Example:
            >>> Scatterers.from_spherical(torch.tensor([20.0]), 0.0, 0.0, 10.0).position_m
            tensor([[20., 0., 0.]])
        """
        check_positive("range_m", range_m, unit="m", owner=cls)
        azimuth = torch.as_tensor(azimuth_rad).to(range_m).expand(range_m.shape)
        elevation = torch.as_tensor(elevation_rad).to(range_m).expand(range_m.shape)
        flat = torch.cos(elevation)
        along = torch.stack([flat * torch.cos(azimuth), flat * torch.sin(azimuth), torch.sin(elevation)], -1)
        return cls.from_rcs(range_m[..., None] * along, rcs_dbsm, speed_m_per_s, phase_rad)

    @property
    def rcs_dbsm(self) -> Tensor:
        """``(..., M)`` radar cross section; -inf for none."""
        return 20.0 * torch.log10(self.field_m.abs())

    @property
    def range_m(self) -> Tensor:
        """``(..., M)`` distance from the radar."""
        found: Tensor = torch.linalg.vector_norm(self.position_m, dim=-1)
        return found

    @property
    def direction(self) -> Tensor:
        """``(..., M, 3)`` unit vector from the radar to each; zero at the radar itself."""
        range_m = self.range_m[..., None]
        return self.position_m / torch.where(range_m > 0, range_m, torch.ones_like(range_m))

    @property
    def azimuth_rad(self) -> Tensor:
        """``(..., M)`` from x to y."""
        return torch.atan2(self.position_m[..., 1], self.position_m[..., 0])

    @property
    def elevation_rad(self) -> Tensor:
        """``(..., M)`` up from the horizon."""
        return torch.asin(self.direction[..., 2].clamp(-1.0, 1.0))

    def joined(self, *others: Scatterers) -> Scatterers:
        """These and the others together, of the same batch shape."""
        both = (self, *others)
        return Scatterers(
            torch.cat([each.position_m for each in both], -2),
            torch.cat([each.speed_m_per_s for each in both], -1),
            torch.cat([each.field_m for each in both], -1),
        )

    def to(self, device: torch.device | str) -> Scatterers:
        """On another device."""
        return Scatterers(*(value.to(device) for value in (self.position_m, self.speed_m_per_s, self.field_m)))
