"""Closed forms of the size distributions against quadrature, the oracles' totals and each other."""

from __future__ import annotations

import math

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.oracles import load
from torchweather.physics import (
    Exponential,
    Gamma,
    LogNormal,
    ModifiedGamma,
    SizeDistribution,
    bernardin,
    brandes_snow,
    brandes_table4,
    deirmendjian_fog,
    gunn_marshall,
    marshall_palmer,
    rehearse_fog,
    sekhon_srivastava,
)

ALL: dict[str, SizeDistribution] = {
    "marshall-palmer": marshall_palmer(10.0),
    "sekhon-srivastava": sekhon_srivastava(1.0),
    "exponential, unbounded": Exponential(8000.0, 2.5),
    "gamma": Gamma(2.33e4, 1.23, 2.25, diameter_min_mm=0.1, diameter_max_mm=15.0),
    "gamma, narrow domain": Gamma(100.0, 3.0, 1.5, diameter_min_mm=1.0, diameter_max_mm=2.0),
    "brandes": brandes_snow(1.0),
    "brandes table 4": brandes_table4("3.03"),
    "chu-hogg": deirmendjian_fog("chu-hogg"),
    "strong-advection": deirmendjian_fog("strong-advection"),
    "log-normal": rehearse_fog(20),
    "log-normal, truncated": rehearse_fog(20).within(2e-4, 2e-2),
    "bernardin": bernardin(),
}


@pytest.mark.parametrize("name", ALL)
@pytest.mark.parametrize("order", [2.0, 2.9, 3.0, 6.0])
def test_moments_in_closed_form_agree_with_quadrature(name: str, order: float) -> None:
    distribution = ALL[name]
    diameter, width = distribution.quadrature()
    summed = (diameter**order * distribution.number_density_per_m3_mm(diameter) * width).sum()
    # 1e-8: the quadrature stops where 1e-12 of a moment is left
    assert float(summed) == pytest.approx(float(distribution.moment(order)), rel=1e-8)


@pytest.mark.parametrize("name", ALL)
def test_sampling_inverts_the_count(name: str) -> None:
    distribution = ALL[name]
    u = torch.linspace(0.0, 1.0 - 1e-9, 5001, dtype=torch.float64)
    diameter = distribution.sample_diameter_mm(u)
    assert bool((diameter[1:] >= diameter[:-1]).all())
    assert float(diameter.min()) >= distribution.diameter_min_mm
    assert float(diameter.max()) <= distribution.diameter_max_mm
    below = 1.0 - distribution.tail_per_m3(diameter) / distribution.total_per_m3
    assert float((below - u).abs().max()) < 2e-6  # the stated error of the table; exact where a closed form exists


@pytest.mark.parametrize("name", ALL)
def test_inverse_of_the_tail(name: str) -> None:
    distribution = ALL[name]
    wanted = distribution.total_per_m3 * torch.tensor([0.9, 0.5, 1e-2, 1e-4], dtype=torch.float64)
    tail = distribution.tail_per_m3(distribution.inverse_tail(wanted))
    assert torch.allclose(tail, wanted, rtol=1e-3)  # of the last 1e-4 of all particles


@pytest.mark.parametrize("name", ALL)
def test_no_particles_outside_the_domain_and_all_of_them_inside(name: str) -> None:
    distribution = ALL[name].within(0.5, 0.7) if ALL[name].particle != "drop" else ALL[name]
    low, high = distribution.diameter_min_mm, distribution.diameter_max_mm
    outside = torch.tensor([low - 1e-9, min(high, 1e6) + 1e-3], dtype=torch.float64)
    outside = outside[(outside < low) | (outside > high)]
    assert bool((distribution.number_density_per_m3_mm(outside) == 0).all())
    assert float(distribution.tail_per_m3(low - 1.0)) == pytest.approx(float(distribution.total_per_m3), rel=1e-12)
    assert float(distribution.tail_per_m3(min(high, 1e6))) == pytest.approx(0.0, abs=1e-9)


def test_one_parameter_set_of_a_batch_is_that_set_alone() -> None:
    rate = torch.tensor([1.0, 10.0, 50.0])
    diameter = torch.tensor([0.2, 1.0, 3.0], dtype=torch.float64)
    batch = marshall_palmer(rate)
    assert batch.batch_shape == (3,)
    assert batch.number_density_per_m3_mm(diameter).shape == (3, 3)
    assert batch.number_density_per_m3_mm(1.0).shape == (3,)
    assert batch.moment(3.0).shape == (3,)
    assert batch.sample_diameter_mm(torch.rand(3, 7)).shape == (3, 7)
    for i, one_rate in enumerate(rate.tolist()):
        one = marshall_palmer(one_rate)
        torch.testing.assert_close(
            batch.number_density_per_m3_mm(diameter)[i], one.number_density_per_m3_mm(diameter), rtol=1e-6, atol=0.0
        )
        assert float(batch.tail_per_m3(diameter)[i, 1]) == pytest.approx(float(one.tail_per_m3(1.0)), rel=1e-6)


def test_a_batch_of_tables_samples_row_by_row() -> None:
    batch = Gamma(torch.tensor([10.0, 200.0]), torch.tensor([0.5, 2.0]), 2.0, diameter_min_mm=0.1, diameter_max_mm=9.0)
    u = torch.linspace(0.0, 0.99, 50, dtype=torch.float64)
    sampled = batch.sample_diameter_mm(u)
    for i, (n0, mu) in enumerate([(10.0, 0.5), (200.0, 2.0)]):
        alone = Gamma(n0, mu, 2.0, diameter_min_mm=0.1, diameter_max_mm=9.0).sample_diameter_mm(u)
        torch.testing.assert_close(sampled[i], alone, rtol=1e-6, atol=0.0)


def test_mean_drop_of_an_exponential_is_one_over_its_slope() -> None:
    # D3.4's code takes the slope itself as the mean diameter
    generator = torch.Generator().manual_seed(1)
    u = torch.rand(200_000, generator=generator, dtype=torch.float64)
    mean = float(Exponential(8000.0, 2.528).sample_diameter_mm(u).mean())
    assert mean == pytest.approx(1 / 2.528, abs=4 / 2.528 / math.sqrt(200_000))  # four standard errors


def test_a_density_per_radius_counts_every_particle_once() -> None:
    per_radius = Exponential(7600.0, 2.55, "radius")
    assert float(per_radius.total_per_m3) == pytest.approx(float(Exponential(3800.0, 2.55).total_per_m3), rel=1e-12)


@pytest.mark.parametrize("name", ["chu-hogg", "moderate-spray"])
def test_modified_gamma_counts_its_stated_concentration_and_peaks_at_its_mode_radius(name: str) -> None:
    fog = deirmendjian_fog(name)
    assert float(fog.total_per_m3) == pytest.approx(float(fog.number_per_cm3) * 1e6, rel=1e-12)
    mode_mm = 2e-3 * float(fog.mode_radius_um)
    density = fog.number_density_per_m3_mm(torch.tensor([0.98, 1.0, 1.02], dtype=torch.float64) * mode_mm)
    assert int(density.argmax()) == 1


def test_log_normal_moments_are_those_of_the_textbook() -> None:
    fog = LogNormal(100.0, 2.0, 0.7)
    for k in (1, 2, 3):
        wanted = 1e8 * (2.0 * 2.0e-3) ** k * math.exp(0.5 * (k * 0.7) ** 2)
        assert float(fog.moment(float(k))) == pytest.approx(wanted, rel=1e-12)
    median = float(fog.sample_diameter_mm(0.5))
    assert median == pytest.approx(4e-3, rel=1e-12)
    assert 500.0 * float(fog.effective_diameter_mm) == pytest.approx(2.0 * math.exp(2.5 * 0.7**2), rel=1e-12)


@pytest.mark.parametrize(
    ("function", "at"),
    [
        (lambda r: marshall_palmer(r).moment(2.3), 3.0),
        (lambda r: marshall_palmer(r).tail_per_m3(torch.tensor([0.3, 1.0])), 3.0),
        (lambda r: sekhon_srivastava(r).number_density_per_m3_mm(torch.tensor([0.3, 1.0])), 0.7),
        (lambda r: gunn_marshall(r).liquid_water_g_per_m3(), 0.7),
        (lambda r: brandes_snow(r).liquid_water_g_per_m3(), 0.7),
        (lambda s: LogNormal(10.0, s, 0.7).moment(2.0, 1e-3, 1e-2), 2.0),
        (lambda s: ModifiedGamma(10.0, 3.0, 1.0, s).moment(2.0, 1e-3, 1e-2), 5.0),
        (lambda s: Gamma(10.0, -0.5, s).moment(0.0), 2.0),
    ],
)
def test_gradients_in_the_intensity(function, at: float) -> None:
    assert torch.autograd.gradcheck(function, torch.tensor([at], dtype=torch.float64, requires_grad=True))


def test_gradients_are_finite_where_there_is_no_precipitation() -> None:
    for named in (marshall_palmer, sekhon_srivastava, gunn_marshall, brandes_snow):
        rate = torch.tensor([0.0, 5.0], requires_grad=True)
        distribution = named(rate)
        value = distribution.moment(2.0)
        assert float(value[0].detach()) == 0.0
        (gradient,) = torch.autograd.grad(value.sum(), rate)
        assert bool(torch.isfinite(gradient).all())


def test_totals_of_rain_and_snow_are_the_oracles() -> None:
    for rate, row in load("rain")["rows"].items():
        rain = marshall_palmer(float(rate), diameter_min_mm=0.0, diameter_max_mm=math.inf)
        assert float(rain.slope_per_mm) == pytest.approx(row["Lambda_per_mm"], rel=1e-9)
        assert float(rain.total_per_m3) == pytest.approx(row["N_total_m3"], rel=1e-9)
        assert float(rain.liquid_water_g_per_m3()) == pytest.approx(row["LWC_g_m3"], rel=1e-9)
        for (low, high), key in (
            ((0.05, 10), "N_D_0.05_10_m3"),
            ((0.1, 10), "N_D_0.1_10_m3"),
            ((0.5, 6), "N_D_0.5_6_m3"),
        ):
            assert float(rain.within(low, high).total_per_m3) == pytest.approx(row[key], rel=1e-9)
    named = {
        "sekhon_srivastava": (sekhon_srivastava, "diameter"),
        "gunn_marshall": (gunn_marshall, "diameter"),
    }
    for name, (law, per_size) in named.items():
        for rate, row in load("snow")["rows"][name].items():
            snow = law(float(rate), per_size=per_size, diameter_min_mm=0.0, diameter_max_mm=math.inf)
            assert float(snow.intercept_per_m3_mm) == pytest.approx(row["N0"], rel=1e-9)
            assert float(snow.slope_per_mm) == pytest.approx(row["Lambda_per_mm"], rel=1e-9)
            assert float(snow.total_per_m3) == pytest.approx(row["N_total_m3"], rel=1e-9)
            assert float(snow.liquid_water_g_per_m3()) == pytest.approx(row["IWC_g_m3"], rel=1e-9)


@pytest.mark.parametrize(
    ("oracle", "law"), [("rasshofer_GM_7600", gunn_marshall), ("rasshofer_SS_5000", sekhon_srivastava)]
)
def test_rasshofers_doubled_intercepts_are_the_same_snow_per_radius(oracle: str, law) -> None:
    for rate, row in load("snow")["rows"][oracle].items():
        snow = law(float(rate), per_size="radius", diameter_min_mm=0.0, diameter_max_mm=math.inf)
        assert float(snow.intercept_per_m3_mm) == pytest.approx(row["N0"], rel=1e-9)
        # the block reads the doubled N0 as per diameter: twice the particles
        assert 2.0 * float(snow.total_per_m3) == pytest.approx(row["N_total_m3"], rel=1e-9)


@pytest.mark.parametrize("row_name", ["2.59", "2.70", "3.03"])
def test_brandes_table_4(row_name: str) -> None:
    row = load("snow")["rows"]["brandes_table4"][row_name]
    snow = brandes_table4(row_name)
    assert float(snow.total_per_m3) == pytest.approx(row["N_total_0_inf"], rel=1e-9)
    assert float(snow.within(0.1, 10.0).total_per_m3) == pytest.approx(row["N_0p1_10"], rel=1e-9)
    assert float(snow.within(0.5, 30.0).total_per_m3) == pytest.approx(row["N_0p5_30"], rel=1e-9)
    uncapped = math.pi / 6e3 * 0.178 * float(snow.moment(2.078, 0.0, 60.0))  # the oracle stops at 60 mm
    assert uncapped == pytest.approx(row["IWC_g_m3_density_0p178"], rel=1e-9)
    # the cap at the density of ice takes mass only from flakes below 0.17 mm
    assert float(snow.liquid_water_g_per_m3()) == pytest.approx(row["IWC_g_m3_density_0p178"], rel=5e-3)


@settings(deadline=None, max_examples=40)
@given(rate=st.floats(0.01, 300.0), factor=st.floats(1.001, 3.0))
def test_more_rain_never_means_fewer_large_drops(rate: float, factor: float) -> None:
    diameter = torch.linspace(0.1, 7.9, 40, dtype=torch.float64)
    less, more = (marshall_palmer(r).tail_per_m3(diameter) for r in (rate, rate * factor))
    assert bool((more >= less).all())


@settings(deadline=None, max_examples=40)
@given(low=st.floats(0.05, 2.0), width=st.floats(0.01, 3.0), order=st.floats(0.0, 6.0))
def test_parts_of_a_moment_add_up(low: float, width: float, order: float) -> None:
    rain = marshall_palmer(10.0)
    whole = rain.moment(order)
    parts = rain.moment(order, None, low) + rain.moment(order, low, low + width) + rain.moment(order, low + width)
    assert float(parts) == pytest.approx(float(whole), rel=1e-10)


def test_scaling_multiplies_the_count_only() -> None:
    for distribution in ALL.values():
        twice = distribution.scaled(2.0)
        assert float(twice.total_per_m3) == pytest.approx(2.0 * float(distribution.total_per_m3), rel=1e-12)
        assert float(twice.effective_diameter_mm) == pytest.approx(float(distribution.effective_diameter_mm), rel=1e-12)


@pytest.mark.parametrize(
    ("build", "message"),
    [
        (lambda: Exponential(-1.0, 2.0), "intercept_per_m3_mm must be 0"),
        (lambda: Exponential(1.0, 0.0), "slope_per_mm must be above 0"),
        (lambda: Exponential(1.0, 1.0, "volume"), "per_size must be one of"),
        (lambda: Gamma(1.0, -1.0, 2.0), "total diverges"),
        (lambda: LogNormal(1.0, 0.0, 0.5), "median_radius_um"),
        (lambda: ModifiedGamma(1.0, 3.0, 1.0, math.nan), "mode_radius_um"),
        (lambda: Exponential(1.0, 1.0, diameter_min_mm=2.0, diameter_max_mm=1.0), "diameter_max_mm"),
        (lambda: Exponential(1.0, 1.0, particle="hail"), "particle must be one of"),
        (lambda: marshall_palmer(-1.0), "rate_mm_per_h must be 0 mm/h or more"),
        (lambda: brandes_snow(1.0, 3.0), "temperature_c"),
        (lambda: brandes_table4("2.95"), "Did you mean"),
    ],
)
def test_impossible_parameters_are_refused(build, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        build()
