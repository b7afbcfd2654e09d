"""Reflectivity of a flake (PHYSICS.md 10.3): closed forms, and photons followed through a layer of grains."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch

from torchweather.physics import (
    FLAKE_COLUMN_KG_PER_M2,
    flake_reflectivity,
    ice_refractive_index,
    snow_bulk_density_g_per_cm3,
)


@pytest.mark.parametrize(
    ("asymmetry", "expected"), [(0.77, (0.40, 0.25, 0.14)), (0.89, (0.25, 0.14, 0.07))], ids=["crystals", "spheres"]
)
def test_table_of_physics_10_3(asymmetry: float, expected: tuple[float, ...]) -> None:
    found = flake_reflectivity(532.0, grain_radius_um=torch.tensor([50.0, 100.0, 200.0]), asymmetry=asymmetry)
    assert found.tolist() == pytest.approx(expected, abs=0.0101)  # printed with two digits, tau rounded to 4, 2, 1


def test_column_is_that_of_brandes_density_at_any_size() -> None:
    diameter_mm = torch.tensor([1.0, 3.0, 10.0])
    column = 2 / 3 * snow_bulk_density_g_per_cm3(diameter_mm) * diameter_mm  # g/cm^3 mm = kg/m^2
    assert column.tolist() == pytest.approx([FLAKE_COLUMN_KG_PER_M2] * 3, rel=0.19)


@pytest.mark.parametrize("wavelength_nm", [532.0, 1550.0])
@pytest.mark.parametrize("radius_um", [50.0, 100.0, 200.0])
def test_photons_through_a_layer_of_grains(wavelength_nm: float, radius_um: float) -> None:
    """Monte Carlo of a slab under diffuse light: reflection and refraction with Henyey and Greenstein's phase function.

    The two-stream layer is within 20 %, far inside the factor of 2 that the grains' size leaves open.
    """
    g, photons = 2 * 0.77 - 1, 40_000
    tau = 0.75 * 0.12 / (917.0 * radius_um * 1e-6)
    index = complex(ice_refractive_index(wavelength_nm))
    chord_m = 4 / 3 * radius_um * 1e-6 * (index.real**3 - (index.real**2 - 1) ** 1.5) / index.real
    kept = math.exp(-4 * math.pi * index.imag / (wavelength_nm * 1e-9) * chord_m)
    rng = np.random.default_rng(0)
    depth, mu, reflected = np.zeros(photons), np.sqrt(rng.random(photons)), 0
    while depth.size:
        depth = depth - mu * np.log(rng.random(depth.size))
        reflected += np.count_nonzero(depth < 0)
        inside = (depth > 0) & (depth < tau) & (rng.random(depth.size) < kept)
        depth, mu = depth[inside], mu[inside]
        turn = (1 + g * g - ((1 - g * g) / (1 - g + 2 * g * rng.random(mu.size))) ** 2) / (2 * g)
        mu = mu * turn + np.sqrt((1 - mu**2) * (1 - turn**2)) * np.cos(2 * np.pi * rng.random(mu.size))
    error = 3 * math.sqrt(reflected) / photons
    found = float(flake_reflectivity(wavelength_nm, grain_radius_um=radius_um))
    assert found == pytest.approx(reflected / photons, abs=0.2 * reflected / photons + error)


def test_limits() -> None:
    assert float(flake_reflectivity(905.0, column_kg_per_m2=0.0)) == 0.0
    assert float(flake_reflectivity(905.0, column_kg_per_m2=1e4)) > 0.9  # a pack
    assert float(flake_reflectivity(2000.0)) >= 0.0


def test_bad_input_is_named() -> None:
    for bad in ({"grain_radius_um": 0.0}, {"asymmetry": 1.5}, {"column_kg_per_m2": -1.0}):
        with pytest.raises(ValueError, match=next(iter(bad))):
            flake_reflectivity(905.0, **bad)
