"""Geometric optics of a sphere."""

from __future__ import annotations

import pytest

from tests.oracles import load
from torchweather.physics import axial_q_back, normal_reflectance, sphere_budget


@pytest.mark.parametrize("n", load("raindrop_fresnel_budget")["rows"])
def test_light_on_a_drop_is_reflected_refracted_and_kept_inside(n: str) -> None:
    block = load("raindrop_fresnel_budget")
    budget = sphere_budget(float(n))
    row = block["rows"][n]
    assert budget.external_reflection == pytest.approx(row["external_reflection"], abs=block["tol"])
    assert budget.refraction == pytest.approx(row["refraction_p1"], abs=block["tol"])
    assert budget.one_internal == pytest.approx(row["one_internal_p2"], abs=block["tol"])
    assert budget.rest == pytest.approx(row["rest"], abs=block["tol"])
    assert budget.full_field_of_view_deg == pytest.approx(row["full_field_of_view_deg"], abs=1e-9)


def test_a_drop_shows_94_percent_of_the_scene_behind_it() -> None:
    budget = sphere_budget(1.33)
    assert 1.0 - budget.external_reflection == pytest.approx(0.94, abs=0.01)  # Garg & Nayar, rounded


@pytest.mark.parametrize("name", load("refractive_index")["optical"])
def test_normal_reflectance_of_water(name: str) -> None:
    row = load("refractive_index")["optical"][name]
    wanted = row["fresnel_normal_water"]
    assert float(normal_reflectance(row["water_n_iapws"]["10"])) == pytest.approx(wanted, rel=1e-6)


def test_two_glints_of_a_transparent_drop() -> None:
    n = load("refractive_index")["optical"]["905nm"]["water_n_iapws"]["10"]
    # PHYSICS.md 3.2: 0.094; the digits from an independent evaluation with the same index
    assert float(axial_q_back(n)) == pytest.approx(0.09398214063147214, rel=1e-9)


def test_rear_glint_of_a_millimetre_drop_is_mostly_absorbed_at_1550_nm() -> None:
    n = load("refractive_index")["optical"]["1550nm"]["water_n_iapws"]["10"]
    # PHYSICS.md 3.2: 0.030 for k between 1.0e-4 and 1.3e-4
    for k, wanted in ((1.0e-4, 0.0317), (1.3e-4, 0.0267)):
        q = float(axial_q_back(complex(n, k), diameter_mm=1.0, wavelength_nm=1550.0))
        assert q == pytest.approx(wanted, abs=1e-4)


def test_front_glint_alone_is_the_normal_reflectance() -> None:
    opaque = axial_q_back(1.33 + 1e-2j, diameter_mm=10.0, wavelength_nm=905.0)
    assert float(opaque) == pytest.approx(float(normal_reflectance(1.33)), rel=1e-9)


def test_index_below_one_is_refused() -> None:
    with pytest.raises(ValueError, match="above 1"):
        sphere_budget(0.9)
