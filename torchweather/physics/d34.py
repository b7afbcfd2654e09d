"""Table 13 of ROADVIEW D3.4, fog extinction per colour: as printed, as its code computes it, and corrected."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch

from torchweather.physics.extinction import PER_M_PER_MM2_M3, extinction_per_m
from torchweather.physics.fog_distributions import REHEARSE, rehearse_fog
from torchweather.physics.mie import mie_efficiencies
from torchweather.physics.refractive_index import water_refractive_index_25c
from torchweather.physics.visibility import extinction_from_mor

__all__ = ["COLOURS_NM", "Table13Row", "table13"]

COLOURS_NM = {"blue": 460.0, "green": 530.0, "red": 600.0}  # D3.4 4.8

# D3.4 Table 13, 1/m: blue, green, red by nominal visibility. 10 m red is a misprint of .2979.
PRINTED_PER_M = {
    10: (0.2889, 0.2934, 0.2989),
    20: (0.1457, 0.1481, 0.1504),
    30: (0.1024, 0.1043, 0.1061),
    50: (0.0705, 0.0723, 0.0740),
}

# What reproduces the printed column: diameters 0.2-20 um on 199 nodes, x = pi r / lambda (a radius passed as a
# diameter) and water at 25 C. PHYSICS.md 3.3.
PUBLISHED_DIAMETER_UM = (0.2, 20.0)
PUBLISHED_NODES = 199


@dataclass(frozen=True)
class Table13Row:
    """Extinction of one measured fog at one colour, 1/m."""

    visibility_m: int
    """Nominal visibility of the fog, m."""
    colour: str
    wavelength_nm: float
    printed: float
    """As the deliverable prints it."""
    as_published: float
    """As its code computes it: ``x = pi r / lambda``, sizes cut at 0.2 and 20 um."""
    corrected: float
    """Mie over all sizes with ``x = pi D / lambda``, water at 10 C."""
    koschmieder: float
    """``ln 20 / V``: the same at every colour."""


def table13() -> list[Table13Row]:
    """D3.4's Table 13 beside its correction, four fogs by three colours, extinction in 1/m.

    Note:
        ``as_published`` rounds to every printed digit except 10 m red, printed .2989 and computed .2979.

    References:
        PHYSICS.md 3.3; D3.4 Table 13 and Table 5.

    Example:
        >>> row = table13()[0]
        >>> row.visibility_m, row.colour, row.printed, round(row.as_published, 4), round(row.corrected, 3)
        (10, 'blue', 0.2889, 0.2889, 0.33)
    """
    rows = []
    for visibility_m in REHEARSE:
        for (colour, wavelength_nm), printed in zip(COLOURS_NM.items(), PRINTED_PER_M[visibility_m], strict=True):
            rows.append(
                Table13Row(
                    visibility_m=visibility_m,
                    colour=colour,
                    wavelength_nm=wavelength_nm,
                    printed=printed,
                    as_published=_as_published(visibility_m, wavelength_nm),
                    corrected=float(extinction_per_m(rehearse_fog(visibility_m), wavelength_nm)),
                    koschmieder=float(extinction_from_mor(visibility_m)),
                )
            )
    return rows


def _as_published(visibility_m: int, wavelength_nm: float) -> float:
    low, high = PUBLISHED_DIAMETER_UM
    diameter_mm = 1e-3 * torch.linspace(low, high, PUBLISHED_NODES, dtype=torch.float64)
    half_x = 0.5 * math.pi * diameter_mm * 1e6 / wavelength_nm  # pi r / lambda, half of what it should be
    q_ext = mie_efficiencies(half_x, water_refractive_index_25c(wavelength_nm)).q_ext
    density = rehearse_fog(visibility_m).number_density_per_m3_mm(diameter_mm)
    area = torch.trapezoid(diameter_mm**2 * q_ext * density, diameter_mm)
    return float(0.25 * math.pi * PER_M_PER_MM2_M3 * area)
