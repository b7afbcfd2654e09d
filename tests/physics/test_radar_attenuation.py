"""Rain, fog and snow at millimetre waves."""

from __future__ import annotations

import math

import pytest
import torch

from tests.oracles import load
from torchweather.physics import (
    DB_PER_KM,
    SizeDistribution,
    fog_attenuation_coefficient_db_per_km_per_g_per_m3,
    fog_attenuation_db_per_km,
    gunn_marshall,
    marshall_palmer,
    mie_efficiencies,
    particle_attenuation_db_per_km,
    physical_diameter_mm,
    rain_attenuation_coefficients,
    rain_attenuation_db_per_km,
    rain_attenuation_p838_db_per_km,
    rehearse_fog,
    sekhon_srivastava,
    snow_attenuation_db_per_km,
    snow_bulk_density_g_per_cm3,
    snow_refractive_index_microwave,
    volume_reflectivity_m2_per_m3,
    water_permittivity_microwave,
)

P838 = load("p838_3")["rows"]
LIGHT_MM_GHZ = 299.792458


def test_one_neper_of_power_per_metre_in_db_per_km() -> None:
    assert pytest.approx(4342.945, rel=1e-6) == DB_PER_KM


@pytest.mark.parametrize("frequency", P838)
def test_p838_coefficients_and_attenuation(frequency: str) -> None:
    row = P838[frequency]
    got = rain_attenuation_coefficients(float(frequency))
    for value, key in zip(got, ("kH", "aH", "kV", "aV"), strict=True):
        assert float(value) == pytest.approx(row[key], rel=1e-6)
    for key, tilt in (("gammaH", 0.0), ("gammaV", math.pi / 2)):
        for rate, wanted in row[key].items():
            gamma = rain_attenuation_p838_db_per_km(float(rate), float(frequency), polarisation_tilt_rad=tilt)
            assert float(gamma) == pytest.approx(wanted, rel=1e-6)


def test_circular_polarisation_lies_between_horizontal_and_vertical() -> None:
    horizontal, circular, vertical = (
        float(rain_attenuation_p838_db_per_km(25.0, polarisation_tilt_rad=t)) for t in (0.0, math.pi / 4, math.pi / 2)
    )
    assert vertical < circular < horizontal
    overhead = rain_attenuation_p838_db_per_km(25.0, elevation_rad=math.pi / 2)
    assert float(overhead) == pytest.approx(circular, rel=1e-9)


def test_no_rain_does_not_attenuate_and_has_a_finite_gradient() -> None:
    rate = torch.tensor([0.0, 10.0], requires_grad=True)
    gamma = rain_attenuation_p838_db_per_km(rate)
    assert float(gamma[0].detach()) == 0.0
    (gradient,) = torch.autograd.grad(gamma.sum(), rate)
    assert bool(torch.isfinite(gradient).all())


def test_sander_as_published() -> None:
    for rate, wanted in load("p838_3")["sander_as_coded"].items():
        assert float(rain_attenuation_db_per_km(float(rate), model="d3_4")) == pytest.approx(wanted, rel=1e-6)


@pytest.mark.parametrize("frequency", load("p840_Kl")["rows"])
def test_p840_coefficient(frequency: str) -> None:
    for celsius, row in load("p840_Kl")["rows"][frequency].items():
        got = float(fog_attenuation_coefficient_db_per_km_per_g_per_m3(float(frequency), float(celsius)))
        assert got == pytest.approx(row["itur"], rel=1e-6)


def test_rain_by_mie_over_marshall_palmer() -> None:
    block = load("rain_radar_mie_marshall_palmer")
    for frequency, temperatures in block["rows"].items():
        for celsius, rates in temperatures.items():
            for rate, row in rates.items():
                rain = marshall_palmer(float(rate)).within(0.05, 10.0)
                options = {"temperature_c": float(celsius)}
                gamma = particle_attenuation_db_per_km(rain, float(frequency), **options)
                eta = volume_reflectivity_m2_per_m3(rain, float(frequency), **options)
                assert float(gamma) == pytest.approx(row["atten_dB_km"], rel=block["tol"])
                assert float(eta) == pytest.approx(row["eta_m2_m3"], rel=block["tol"])
                # Equivalent reflectivity as weather services state it: |K|^2 = 0.93 at every frequency, mm^6 m^-3
                wavelength_mm = LIGHT_MM_GHZ / float(frequency)
                z_e = float(eta) * 1e6 * wavelength_mm**4 / (math.pi**5 * 0.93)
                # in dB what the relative tolerance on eta leaves
                within_db = 10.0 * math.log10(1.0 + block["tol"])
                assert 10.0 * math.log10(z_e) == pytest.approx(row["Ze_dBZ_K2_0p93"], abs=within_db)
                water = complex(water_permittivity_microwave(float(frequency), float(celsius)))
                k_squared = abs((water - 1.0) / (water + 2.0)) ** 2
                all_sizes = float(rain.within(0.0, math.inf).moment(6.0))  # what the closed form has, mm^6 m^-3
                rayleigh = 1e-6 * math.pi**5 / wavelength_mm**4 * k_squared * all_sizes
                assert rayleigh == pytest.approx(row["eta_rayleigh"], rel=block["tol"])


def test_mie_rain_is_a_quarter_above_p838_at_77_ghz() -> None:
    for rate in (10.0, 25.0, 50.0):
        ratio = rain_attenuation_db_per_km(rate, model="dsd_mie") / rain_attenuation_db_per_km(rate)
        assert 1.22 < float(ratio) < 1.29


def test_fog_by_mie_and_by_p840() -> None:
    block = load("fog_radar_77GHz_10C")
    for mor, row in block["rows"].items():
        fog = rehearse_fog(int(mor))
        assert float(particle_attenuation_db_per_km(fog, 77.0)) == pytest.approx(row["mie_dB_km"], rel=block["tol"])
        # Absorption of small spheres: 6 pi / lambda Im((eps - 1) / (eps + 2)) per volume of water in the air
        water = complex(water_permittivity_microwave(77.0, 10.0))
        volume = 1e-9 * math.pi / 6.0 * float(fog.moment(3.0))
        rayleigh = DB_PER_KM * 6e3 * math.pi * 77.0 / LIGHT_MM_GHZ * ((water - 1.0) / (water + 2.0)).imag * volume
        assert rayleigh == pytest.approx(row["rayleigh_dB_km"], rel=block["tol"])
        by_water = fog_attenuation_db_per_km(fog.liquid_water_g_per_m3())
        assert float(by_water) == pytest.approx(row["Kl_LWC"], rel=1e-6)


def test_fog_as_published_is_340_times_too_much() -> None:
    table = load("fog_table5")["rows"]
    for mor, row in table.items():
        water = rehearse_fog(int(mor)).liquid_water_g_per_m3()
        as_published = float(fog_attenuation_db_per_km(water, variant="d3_4"))
        assert as_published == pytest.approx(row["attenuation77_as_coded_dB_km"], rel=1e-6)
        assert float(fog_attenuation_db_per_km(water)) == pytest.approx(row["attenuation77_dB_km_10C"], rel=1e-6)


@pytest.mark.parametrize(
    ("model", "density"),
    [("solid_ice_sphere", 0.917), ("MG_rho_0.1", 0.1), ("MG_rho_0.2", 0.2), ("MG_brandes_density", None)],
)
@pytest.mark.parametrize(("name", "law"), [("SS", sekhon_srivastava), ("GM", gunn_marshall)])
def test_dry_snow_sphere_models(model: str, density: float | None, name: str, law) -> None:
    for rate, row in load("snow_radar_77GHz")["rows"][model][name].items():
        snow = law(float(rate)).within(0.05, 8.0)  # the block's melted diameters
        options = {"temperature_c": -5.0, "flake_density_g_per_cm3": density}
        assert float(particle_attenuation_db_per_km(snow, **options)) == pytest.approx(row["ext_dB_km"], rel=5e-3)
        assert float(volume_reflectivity_m2_per_m3(snow, **options)) == pytest.approx(row["eta_m2_m3"], rel=5e-3)
        assert _absorption_db_per_km(snow, density) == pytest.approx(row["abs_dB_km"], rel=5e-3)


def _absorption_db_per_km(snow: SizeDistribution, density: float | None) -> float:
    """What the flakes turn to heat at 77 GHz: the ice's small loss, which the scattering of extinction hides."""
    melted, width = snow.quadrature()
    physical = physical_diameter_mm(melted) if density is None else melted / density ** (1.0 / 3.0)
    bulk = snow_bulk_density_g_per_cm3(physical) if density is None else torch.full_like(physical, density)
    q = mie_efficiencies(math.pi * physical * 77.0 / LIGHT_MM_GHZ, snow_refractive_index_microwave(77.0, bulk, -5.0))
    area = 1e-6 * math.pi / 4.0 * physical**2 * snow.number_density_per_m3_mm(melted) * width
    return DB_PER_KM * float(((q.q_ext - q.q_sca) * area).sum())


def test_snow_as_published() -> None:
    for rate, wanted in load("snow_radar_77GHz")["as_coded_0p8205_S"].items():
        assert float(snow_attenuation_db_per_km(float(rate), model="d3_4")) == pytest.approx(wanted, rel=1e-9)


def test_default_dry_snow_is_negligible_at_77_ghz() -> None:
    rate = torch.tensor([0.25, 1.0, 2.5], dtype=torch.float64)
    gamma = snow_attenuation_db_per_km(rate)
    assert bool((gamma > 0).all())
    assert float(2.0 * 0.2 * gamma.max()) < 0.25  # dB two way at 200 m, PHYSICS.md 6.7


def test_differentiable_in_the_rate() -> None:
    rate = torch.tensor([0.5, 5.0], dtype=torch.float64, requires_grad=True)
    for function in (
        rain_attenuation_db_per_km,
        lambda r: rain_attenuation_db_per_km(r, model="dsd_mie"),
        snow_attenuation_db_per_km,
        fog_attenuation_db_per_km,
    ):
        assert torch.autograd.gradcheck(function, rate)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: rain_attenuation_db_per_km(-1.0), "rate_mm_per_h"),
        (lambda: rain_attenuation_db_per_km(1.0, 5000.0), "frequency_ghz"),
        (lambda: rain_attenuation_db_per_km(1.0, model="sander"), "model must be one of"),
        (lambda: fog_attenuation_db_per_km(-0.1), "liquid_water_g_per_m3"),
        (lambda: snow_attenuation_db_per_km(math.nan), "rate_mm_per_h"),
        (lambda: rain_attenuation_db_per_km(1.0, 0.5), r"frequency_ghz must lie in 1\.\.1000 GHz; got"),
        (lambda: rain_attenuation_db_per_km(1.0, 1001.0, model="dsd_mie"), r"lie in 1\.\.1000 GHz; got 1001"),
        (lambda: snow_attenuation_db_per_km(1.0, 0.5), r"lie in 1\.\.1000 GHz; got 0\.5"),
        (lambda: volume_reflectivity_m2_per_m3(marshall_palmer(1.0), math.nan), "volume_reflectivity_m2_per_m3: freq"),
        (lambda: fog_attenuation_db_per_km(0.1, 201.0), r"lie in 1\.\.200 GHz \(ITU-R P\.840\); got .*201"),
        (lambda: fog_attenuation_db_per_km(0.1, 0.5), r"lie in 1\.\.200 GHz"),
        (lambda: fog_attenuation_db_per_km(0.1, -77.0, variant="d3_4"), "frequency_ghz must be above 0 GHz"),
    ],
)
def test_bad_arguments_are_refused(call, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        call()


def test_formulas_hold_to_the_ends_of_their_ranges_and_those_as_published_are_free() -> None:
    assert float(fog_attenuation_db_per_km(0.1, 200.0)) > float(fog_attenuation_db_per_km(0.1, 1.0)) > 0.0
    assert float(rain_attenuation_db_per_km(10.0, 1000.0)) > float(rain_attenuation_db_per_km(10.0, 1.0)) > 0.0
    # measured near one frequency, used at another: the published lines do not look at it
    assert float(rain_attenuation_db_per_km(10.0, 2000.0, model="d3_4")) == pytest.approx(1.07 * 10.0**0.69)
    assert float(snow_attenuation_db_per_km(2.0, 2000.0, model="d3_4")) == pytest.approx(1.641)
    assert float(fog_attenuation_db_per_km(0.1, 300.0, variant="d3_4")) == pytest.approx(0.182 * 0.1 * 300.0**2)
