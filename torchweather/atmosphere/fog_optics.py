"""Extinction and backscatter of a fog at a laser's wavelength, as functions of its visibility."""

from __future__ import annotations

import copy
from functools import lru_cache

import torch
from torch import Tensor, nn

from torchweather.atmosphere.weather import REHEARSE, REHEARSE_MOR_M, Fog
from torchweather.physics import InterpolationTable, extinction_and_backscatter

__all__ = ["FogOptics", "mor_range_m"]

MOR_LOW_M, MOR_HIGH_M, MOR_NODES = 5.0, 20000.0, 96


def mor_range_m(fog: Fog) -> tuple[float, float]:
    """Visibilities over which coefficients of a fog are tabulated, m."""
    if fog.size_distribution == REHEARSE:
        return float(REHEARSE_MOR_M[0]), float(REHEARSE_MOR_M[-1])
    return MOR_LOW_M, MOR_HIGH_M


class FogOptics(nn.Module):
    """Mie extinction, 1/m, and backscatter, 1/(m sr), of a fog over its visibility; built once for a kind of fog.

    Args:
        fog: its size distribution, contrast and temperature count, its visibility does not.
        wavelength_nm: of the laser.
    """

    def __init__(self, fog: Fog, wavelength_nm: float) -> None:
        super().__init__()
        # A copy: .to(dtype) of one module must not reach the cached table of all others.
        self.table = copy.deepcopy(_table(fog.size_distribution, fog.contrast, fog.temperature_c, wavelength_nm))

    def extinction_per_m(self, mor_m: Tensor) -> Tensor:
        """alpha, 1/m, of the shape of ``mor_m``."""
        both: Tensor = self.table(mor_m)
        return both[..., 0]

    def backscatter_per_m_sr(self, mor_m: Tensor) -> Tensor:
        """beta, 1/(m sr), of the shape of ``mor_m``."""
        both: Tensor = self.table(mor_m)
        return both[..., 1]


@lru_cache(maxsize=32)
def _table(size_distribution: str, contrast: float, temperature_c: float, wavelength_nm: float) -> InterpolationTable:
    fog = Fog(size_distribution=size_distribution, contrast=contrast, temperature_c=temperature_c)

    def optics(mor_m: Tensor) -> Tensor:
        both = extinction_and_backscatter(fog.distribution(mor_m), wavelength_nm, temperature_c=temperature_c)
        return torch.stack(both, -1)

    return InterpolationTable(optics, *mor_range_m(fog), MOR_NODES, zero_at_inf=True)
