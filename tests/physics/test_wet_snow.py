"""Melting snow at millimetre waves: mass, mixing rule, attenuation and backscatter between flake and drop."""

from __future__ import annotations

import math

import pytest
import torch

from torchweather.physics import (
    brandes_snow,
    gunn_marshall,
    marshall_palmer,
    maxwell_garnett,
    melted_diameter_mm,
    mie_efficiencies,
    particle_attenuation_db_per_km,
    physical_diameter_mm,
    rain_attenuation_db_per_km,
    reflectivity_weighted_fall_speed,
    sekhon_srivastava,
    snow_attenuation_db_per_km,
    snow_bulk_density_g_per_cm3,
    snow_refractive_index_microwave,
    volume_reflectivity_m2_per_m3,
    water_permittivity_microwave,
    water_refractive_index_microwave,
    wet_flake_diameter_mm,
    wet_snow_refractive_index_microwave,
)

LAWS = [sekhon_srivastava, gunn_marshall, brandes_snow]
FRACTIONS = torch.tensor([0.0, 0.01, 0.1, 0.3, 0.7, 0.99, 1.0], dtype=torch.float64)
PHYSICAL_MM = torch.logspace(-1.0, 1.3, 20, dtype=torch.float64)[:, None]


def test_mass_of_water_and_snow_fills_the_melting_flake() -> None:
    melted, density = melted_diameter_mm(PHYSICAL_MM), snow_bulk_density_g_per_cm3(PHYSICAL_MM)
    wet = wet_flake_diameter_mm(PHYSICAL_MM, melted, FRACTIONS)
    mass = density * PHYSICAL_MM**3  # in units of pi/6 mg
    torch.testing.assert_close(wet**3, FRACTIONS * mass + (1.0 - FRACTIONS) * mass / density)
    assert torch.equal(wet[:, :1], PHYSICAL_MM)
    assert bool((wet.diff(dim=1) <= 0).all())


def test_index_of_a_melting_flake_keeps_the_mixing_rule() -> None:
    density = snow_bulk_density_g_per_cm3(PHYSICAL_MM)
    got = wet_snow_refractive_index_microwave(77.0, density, FRACTIONS) ** 2
    snow = snow_refractive_index_microwave(77.0, density) ** 2
    water = water_permittivity_microwave(77.0, 0.0)
    # Maxwell-Garnett in Clausius-Mossotti's form; shares of volume from the masses of one cubic centimetre of dry snow
    of_water, of_snow = FRACTIONS * density, 1.0 - FRACTIONS
    share = of_snow / (of_water + of_snow)
    wanted = share * (snow - water) / (snow + 2.0 * water)
    torch.testing.assert_close((got - water) / (got + 2.0 * water), wanted)


def test_index_runs_from_dry_snow_to_water_at_the_melting_point() -> None:
    density = torch.tensor([0.05, 0.2, 0.9], dtype=torch.float64)
    dry = snow_refractive_index_microwave(77.0, density, -3.0)
    assert torch.equal(wet_snow_refractive_index_microwave(77.0, density, 0.0, -3.0), dry)
    barely = wet_snow_refractive_index_microwave(77.0, density, 1e-9, -3.0)
    # the limit, not a branch: 1e-9 of liquid moves the index by about its permittivity ratio times 1e-9
    torch.testing.assert_close(barely, dry, rtol=1e-7, atol=0.0)
    water = water_refractive_index_microwave(77.0, 0.0).expand(3)
    torch.testing.assert_close(wet_snow_refractive_index_microwave(77.0, density, 1.0, -3.0), water)


def test_water_around_the_snow_absorbs_more_than_water_spheres_in_it() -> None:
    density, fraction = 0.1, 0.3
    around = wet_snow_refractive_index_microwave(77.0, density, fraction) ** 2
    snow = snow_refractive_index_microwave(77.0, density) ** 2
    water_share = fraction * density / (1.0 - fraction + fraction * density)
    inside = maxwell_garnett(snow, water_permittivity_microwave(77.0, 0.0), water_share)
    assert float(around.imag) > 1.5 * float(inside.imag)


@pytest.mark.parametrize("law", LAWS)
def test_no_liquid_is_dry_snow(law) -> None:
    snow = law(torch.tensor([0.25, 1.0, 5.0], dtype=torch.float64))
    for function in (particle_attenuation_db_per_km, volume_reflectivity_m2_per_m3):
        dry = function(snow)
        assert torch.equal(function(snow, melt_fraction=0.0), dry)
        # continuous: the steepest slope is 100 times the dry value per unit of melt fraction
        torch.testing.assert_close(function(snow, melt_fraction=1e-9), dry, rtol=1e-6, atol=0.0)


@pytest.mark.parametrize("density", [None, 0.1])
@pytest.mark.parametrize("law", [sekhon_srivastava, gunn_marshall])
def test_all_liquid_is_drops_of_the_melted_diameter(law, density: float | None) -> None:
    snow = law(2.5)
    low, high = snow.diameter_min_mm, snow.diameter_max_mm
    step = (high - low) / 4000
    melted = low + step * (torch.arange(4000, dtype=torch.float64) + 0.5)
    wavelength_mm = 299.792458 / 77.0
    q = mie_efficiencies(math.pi * melted / wavelength_mm, complex(water_refractive_index_microwave(77.0, 0.0)))
    area = 1e-6 * math.pi / 4.0 * melted**2 * snow.number_density_per_m3_mm(melted) * step
    options = {"melt_fraction": 1.0, "flake_density_g_per_cm3": density}
    # 2e-3: the table's own steps, the tolerance of its oracle blocks
    attenuation = 4342.945 * float((q.q_ext * area).sum())
    assert float(particle_attenuation_db_per_km(snow, **options)) == pytest.approx(attenuation, rel=2e-3)
    assert float(volume_reflectivity_m2_per_m3(snow, **options)) == pytest.approx(
        float((q.q_back * area).sum()), rel=2e-3
    )


@pytest.mark.parametrize("fraction", [0.1, 0.5, 0.9])
def test_partly_melted_snow_against_a_fine_sum(fraction: float) -> None:
    snow = sekhon_srivastava(2.5)
    edges = torch.logspace(
        math.log10(snow.diameter_min_mm), math.log10(snow.diameter_max_mm), 4001, dtype=torch.float64
    )
    melted, step = (edges[1:] * edges[:-1]).sqrt(), edges.diff()
    physical = physical_diameter_mm(melted)
    volume = (1.0 - fraction) * physical**3 + fraction * melted**3
    density = (melted**3 / physical**3).clamp_max(0.917)  # rounding at solid ice
    index = wet_snow_refractive_index_microwave(77.0, density, fraction)
    q = mie_efficiencies(math.pi * volume ** (1.0 / 3.0) * 77.0 / 299.792458, index)
    area = 1e-6 * math.pi / 4.0 * volume ** (2.0 / 3.0) * snow.number_density_per_m3_mm(melted) * step
    attenuation = 4342.945 * float((q.q_ext * area).sum())
    assert float(snow_attenuation_db_per_km(2.5, melt_fraction=fraction)) == pytest.approx(attenuation, rel=2e-3)
    eta = float((q.q_back * area).sum())
    assert float(volume_reflectivity_m2_per_m3(snow, melt_fraction=fraction)) == pytest.approx(eta, rel=2e-3)


@pytest.mark.parametrize("frequency", [24.0, 77.0])
@pytest.mark.parametrize("law", LAWS)
def test_the_first_third_of_melting_raises_the_attenuation(law, frequency: float) -> None:
    snow = law(torch.tensor([0.5, 2.0], dtype=torch.float64))
    steps = [particle_attenuation_db_per_km(snow, frequency, melt_fraction=0.05 * k) for k in range(7)]
    assert bool((torch.stack(steps).diff(dim=0) > 0).all())


def test_melting_snow_can_exceed_rain_of_the_same_rate() -> None:
    rate = torch.tensor([1.0, 2.5, 5.0], dtype=torch.float64)
    rain = rain_attenuation_db_per_km(rate)
    assert bool((snow_attenuation_db_per_km(rate) < 0.3 * rain).all())
    assert bool((snow_attenuation_db_per_km(rate, melt_fraction=0.05) < rain).all())
    assert bool((snow_attenuation_db_per_km(rate, melt_fraction=0.1) > rain).all())
    ratio = snow_attenuation_db_per_km(rate, melt_fraction=0.7) / rain
    assert bool(((ratio > 5.0) & (ratio < 7.0)).all())


def test_wet_snow_is_differentiable_in_the_rate() -> None:
    rate = torch.tensor([0.5, 5.0], dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(lambda r: snow_attenuation_db_per_km(r, melt_fraction=0.3), rate)


def test_bad_melt_fractions_are_refused() -> None:
    for fraction in (-0.1, 1.1, math.nan):
        with pytest.raises(ValueError, match=r"particle_attenuation.*melt_fraction must lie in 0\.\.1"):
            snow_attenuation_db_per_km(1.0, melt_fraction=fraction)
        with pytest.raises(ValueError, match=r"volume_reflectivity.*melt_fraction must lie in 0\.\.1"):
            volume_reflectivity_m2_per_m3(sekhon_srivastava(1.0), melt_fraction=fraction)
        with pytest.raises(ValueError, match=r"wet_snow.*melt_fraction must lie in 0\.\.1"):
            wet_snow_refractive_index_microwave(77.0, 0.1, fraction)
        with pytest.raises(ValueError, match=r"wet_flake.*melt_fraction must lie in 0\.\.1"):
            wet_flake_diameter_mm(1.0, 0.5, fraction)
    rain = marshall_palmer(5.0)
    for call in (
        lambda: particle_attenuation_db_per_km(rain, melt_fraction=0.2),
        lambda: volume_reflectivity_m2_per_m3(rain, melt_fraction=0.2),
        lambda: reflectivity_weighted_fall_speed(rain, melt_fraction=0.2),
    ):
        with pytest.raises(ValueError, match="must be 0 for a distribution of drops"):
            call()
    with pytest.raises(ValueError, match="'d3_4' is a fit to dry snow"):
        snow_attenuation_db_per_km(1.0, model="d3_4", melt_fraction=0.2)
    with pytest.raises(ValueError, match="density_g_per_cm3 must be above 0"):
        wet_snow_refractive_index_microwave(77.0, 0.0, 0.5)
