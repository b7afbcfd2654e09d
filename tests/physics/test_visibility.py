"""Visibility to extinction and back, liquid water to visibility and back."""

from __future__ import annotations

import math

import pytest
import torch

from tests.oracles import load
from torchweather.physics import (
    extinction_from_mor,
    liquid_water_from_mor_g_per_m3,
    mor_from_extinction,
    mor_from_liquid_water_m,
)


def test_koschmieder_constants() -> None:
    block = load("koschmieder")
    assert float(extinction_from_mor(1.0)) == pytest.approx(block["ln20"], rel=1e-12)
    assert float(extinction_from_mor(1.0, contrast=block["eps2"])) == pytest.approx(block["ln50"], rel=1e-12)


def test_fog_at_visibility_distance_leaves_five_percent_contrast() -> None:
    mor = torch.tensor([10.0, 50.0, 300.0], dtype=torch.float64)
    left = torch.exp(-extinction_from_mor(mor) * mor)
    assert torch.allclose(left, torch.full_like(left, 0.05), rtol=1e-12)


def test_unlimited_visibility_is_no_extinction_both_ways() -> None:
    assert float(extinction_from_mor(math.inf)) == 0.0
    assert float(mor_from_extinction(0.0)) == math.inf


def test_gradient_is_finite_at_unlimited_visibility_and_at_no_extinction() -> None:
    mor = torch.tensor([math.inf, 20.0], requires_grad=True)
    assert bool(torch.isfinite(torch.autograd.grad(extinction_from_mor(mor).sum(), mor)[0]).all())
    extinction = torch.tensor([0.0, 0.1], requires_grad=True)
    assert bool(torch.isfinite(torch.autograd.grad(mor_from_extinction(extinction)[1], extinction)[0]).all())


@pytest.mark.parametrize("bad", [0.0, -5.0, math.nan])
def test_visibility_of_zero_or_less_is_refused(bad: float) -> None:
    with pytest.raises(ValueError, match="mor_m must be above 0 m"):
        extinction_from_mor(bad)


def test_liquid_water_laws_give_their_authors_numbers() -> None:
    for mor, row in load("fog_modified_gamma")["roadview_advection_gamma1_Dc10_re10"].items():
        wanted = row["LWC_GK_as_printed_g_m3_if_V_in_m"]
        assert float(liquid_water_from_mor_g_per_m3(float(mor))) == pytest.approx(wanted, rel=1e-12)
        kunkel = float(liquid_water_from_mor_g_per_m3(float(mor), "kunkel"))
        assert kunkel == pytest.approx(row["LWC_Kunkel_V"], rel=1e-12)


@pytest.mark.parametrize("law", ["grabner-kvicera", "kunkel"])
def test_liquid_water_laws_invert(law: str) -> None:
    mor = torch.tensor([10.0, 80.0, 900.0], dtype=torch.float64)
    assert torch.allclose(mor_from_liquid_water_m(liquid_water_from_mor_g_per_m3(mor, law), law), mor, rtol=1e-12)


def test_unknown_law_names_the_nearest() -> None:
    with pytest.raises(ValueError, match="Did you mean 'kunkel'"):
        liquid_water_from_mor_g_per_m3(100.0, "kunkle")
