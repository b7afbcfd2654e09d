"""The rate a distribution carries, and closing it."""

from __future__ import annotations

import math

import pytest
import torch

from tests.oracles import load
from torchweather.physics import (
    brandes_snow,
    brandes_table4,
    close_rate,
    gunn_marshall,
    marshall_palmer,
    precipitation_rate_mm_per_h,
    rain_fall_speed_m_per_s,
    rain_rate_mm_per_h,
    sekhon_srivastava,
)


def test_flux_of_marshall_palmer() -> None:
    for rate, row in load("rain")["rows"].items():
        rain = marshall_palmer(float(rate), diameter_min_mm=0.0, diameter_max_mm=math.inf)
        power = rain_rate_mm_per_h(rain, lambda d: rain_fall_speed_m_per_s(d, "atlas-ulbrich"))
        assert float(power) == pytest.approx(row["R_closed_378D067_mm_h"], rel=1e-9)
        atlas = rain_rate_mm_per_h(rain, lambda d: rain_fall_speed_m_per_s(d, "atlas-1973"))
        # 3e-6: the law's kink at 0.109 mm inside a panel of the quadrature
        assert float(atlas) == pytest.approx(row["R_closed_atlas73_mm_h"], rel=3e-6)


@pytest.mark.parametrize(("name", "law"), [("sekhon_srivastava", sekhon_srivastava), ("gunn_marshall", gunn_marshall)])
def test_flux_of_snow(name: str, law) -> None:
    for rate, row in load("snow")["rows"][name].items():
        snow = law(float(rate), diameter_min_mm=0.0, diameter_max_mm=math.inf)
        assert float(precipitation_rate_mm_per_h(snow)) == pytest.approx(row["R_closed_v_2p07_mm_h"], rel=1e-9)


def test_sekhon_srivastava_carries_1_206_times_its_rate_at_every_rate() -> None:
    rate = torch.tensor([0.1, 1.0, 10.0], dtype=torch.float64)
    snow = sekhon_srivastava(rate, diameter_min_mm=0.0, diameter_max_mm=math.inf)
    ratio = precipitation_rate_mm_per_h(snow) / rate
    # the exponents -0.94 and -0.45 leave R^0.9995
    assert torch.allclose(ratio, torch.full_like(ratio, 1.206), atol=2e-3)


def test_rate_closure_solves_the_intercept() -> None:
    for rate, row in load("snow")["rows"]["rate_closure_best_N0"].items():
        for law, key in ((sekhon_srivastava, "SS_shape"), (gunn_marshall, "GM_shape")):
            snow = law(float(rate), diameter_min_mm=0.0, diameter_max_mm=math.inf)
            assert float(close_rate(snow, float(rate)).intercept_per_m3_mm) == pytest.approx(row[key], rel=1e-9)


@pytest.mark.parametrize("named", [marshall_palmer, sekhon_srivastava, gunn_marshall, brandes_snow])
def test_closed_distributions_carry_exactly_their_rate(named) -> None:
    rate = torch.tensor([0.3, 2.0, 30.0], dtype=torch.float64)
    closed = close_rate(named(rate), rate)
    assert torch.allclose(precipitation_rate_mm_per_h(closed), rate, rtol=1e-12)


def test_no_rain_stays_no_rain() -> None:
    rate = torch.tensor([0.0, 1.0], dtype=torch.float64)
    assert float(precipitation_rate_mm_per_h(close_rate(marshall_palmer(rate), rate))[0]) == 0.0


@pytest.mark.parametrize("row_name", ["2.59", "2.70", "3.03"])
def test_mean_fall_speed_that_table_4_would_need(row_name: str) -> None:
    row = load("snow")["rows"]["brandes_table4"][row_name]
    snow = brandes_table4(row_name)
    one_metre_per_second = precipitation_rate_mm_per_h(snow, torch.ones_like)
    needed = float(row_name) / float(one_metre_per_second)
    # 5e-3: the oracle's density is not capped at that of ice
    assert needed == pytest.approx(row["mean_fall_speed_needed_m_s"], rel=5e-3)


def test_gradient_of_the_flux() -> None:
    rate = torch.tensor([0.5, 5.0], dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(lambda r: precipitation_rate_mm_per_h(marshall_palmer(r)), rate)
