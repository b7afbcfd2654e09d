"""Sizes and densities of flakes."""

from __future__ import annotations

import pytest
import torch

from tests.oracles import load
from torchweather.physics import (
    equal_visibility_rain_rate,
    melted_diameter_mm,
    physical_diameter_mm,
    snow_bulk_density_g_per_cm3,
)
from torchweather.physics.snow_geometry import MELTED_DIAMETER_MAX_MM

DIAMETERS = torch.logspace(-2, 1.3, 60, dtype=torch.float64)


def test_a_flake_keeps_its_mass_when_it_melts() -> None:
    physical = physical_diameter_mm(DIAMETERS)
    mass = snow_bulk_density_g_per_cm3(physical) * physical**3
    torch.testing.assert_close(mass, DIAMETERS**3)


def test_melted_and_physical_diameter_invert_each_other() -> None:
    torch.testing.assert_close(melted_diameter_mm(physical_diameter_mm(DIAMETERS)), DIAMETERS)


def test_the_powers_of_the_audit() -> None:
    assert float(physical_diameter_mm(1.0)) == pytest.approx(2.2947, abs=5e-5)
    assert float(physical_diameter_mm(0.01)) == pytest.approx(1.0293 * 0.01, rel=1e-4)
    assert float(physical_diameter_mm(2.0)) == pytest.approx(2.2947 * 2.0**1.4437, rel=1e-4)


def test_snow_is_never_denser_than_ice_and_the_largest_flake_is_20_mm() -> None:
    assert float(snow_bulk_density_g_per_cm3(0.01)) == 0.917
    assert float(physical_diameter_mm(MELTED_DIAMETER_MAX_MM)) == pytest.approx(20.0, rel=1e-12)


def test_printed_density_exponent_is_a_variant() -> None:
    ratio = snow_bulk_density_g_per_cm3(10.0, variant="d3_4") / snow_bulk_density_g_per_cm3(10.0)
    assert float(ratio) == pytest.approx(10.0**-0.07, rel=1e-9)


def test_rain_of_equal_visibility() -> None:
    for rate, row in load("snow")["rows"]["snowfall_to_rain_formula"].items():
        assert float(equal_visibility_rain_rate(float(rate))) == pytest.approx(row["hahner_3_2"], rel=1e-9)
        as_published = float(equal_visibility_rain_rate(float(rate), variant="d3_4"))
        assert as_published == pytest.approx(row["as_published_3_4"], rel=1e-9)
        theirs = equal_visibility_rain_rate(float(rate), density_g_per_cm3=0.1, diameter_mm=3.0)
        assert float(theirs) == pytest.approx(row["with_their_defaults_rho0p1_D3mm_v1p6"], rel=1e-9)
