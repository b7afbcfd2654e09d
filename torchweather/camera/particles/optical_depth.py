"""Optical depth of a population of particles, by the compiled path where it covers the frame and else by torch."""

from __future__ import annotations

from collections.abc import Mapping

from torch import Tensor

from torchweather.camera.particles import compiled, haze
from torchweather.camera.particles.population import AtRate, Population
from torchweather.camera.state import CameraState

__all__ = ["haze_depth", "listed_depth"]


def listed_depth(
    population: Population,
    state: CameraState,
    noise: Mapping[str, Tensor],
    tables: AtRate,
    fog_per_m: Tensor | None = None,
) -> tuple[Tensor, Tensor | None]:
    """Optical depth of the listed particles; see ``Population.listed_depth``."""
    if compiled.covers(population, state, noise, tables):
        return compiled.listed_depth(population, state, noise, tables, fog_per_m)
    return population.listed_depth(state, noise, tables, fog_per_m)


def haze_depth(
    population: Population,
    state: CameraState,
    noise: Mapping[str, Tensor],
    tables: AtRate,
    first: int,
    last: int,
    fog_per_m: Tensor | None = None,
) -> tuple[Tensor, Tensor | None]:
    """Optical depth of the haze in the rows ``first..last``; see ``haze.haze_depth``."""
    if compiled.covers(population, state, noise, tables):
        return compiled.haze_depth(population, state, noise, tables, first, last, fog_per_m)
    return haze.haze_depth(population, state, noise, tables, first, last, fog_per_m)
