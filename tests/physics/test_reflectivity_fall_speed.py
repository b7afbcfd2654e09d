"""Fall speed as a radar that looks straight up sees it: weighted by the particles' backscatter."""

from __future__ import annotations

import math

import pytest
import torch

from torchweather.physics import (
    brandes_snow,
    marshall_palmer,
    melted_diameter_mm,
    mie_efficiencies,
    physical_diameter_mm,
    rain_fall_speed_m_per_s,
    reflectivity_weighted_fall_speed,
    rehearse_fog,
    sekhon_srivastava,
    snow_bulk_density_g_per_cm3,
    snow_fall_speed_m_per_s,
    snow_refractive_index_microwave,
    volume_reflectivity_m2_per_m3,
    water_refractive_index_microwave,
)

WAVELENGTH_MM = 299.792458 / 77.0


def _moments(weight: torch.Tensor, speed: torch.Tensor) -> tuple[float, float, float]:
    eta = float(weight.sum())
    mean = float((weight * speed).sum()) / eta
    return eta, mean, math.sqrt(float((weight * (speed - mean) ** 2).sum()) / eta)


def _middles(low: float, high: float, count: int = 8000) -> tuple[torch.Tensor, float]:
    step = (high - low) / count
    return low + step * (torch.arange(count, dtype=torch.float64) + 0.5), step


@pytest.mark.parametrize("rate", [1.0, 25.0, 100.0])
def test_rain_against_a_fine_sum(rate: float) -> None:
    rain = marshall_palmer(rate)
    diameter, step = _middles(rain.diameter_min_mm, rain.diameter_max_mm)
    index = complex(water_refractive_index_microwave(77.0, 10.0))
    sigma_b_m2 = mie_efficiencies(math.pi * diameter / WAVELENGTH_MM, index).q_back * math.pi / 4 * diameter**2 * 1e-6
    weight = sigma_b_m2 * rain.number_density_per_m3_mm(diameter) * step
    got = reflectivity_weighted_fall_speed(rain)
    wanted = _moments(weight, rain_fall_speed_m_per_s(diameter))
    # 2e-3 on eta, the tolerance of its oracle block; the speeds vary slowly over the table's steps
    for value, moment, tolerance in zip(got, wanted, (2e-3, 5e-4, 2e-3), strict=True):
        assert float(value) == pytest.approx(moment, rel=tolerance)


@pytest.mark.parametrize("particle", ["melted-flake", "flake"])
def test_dry_snow_against_a_fine_sum_over_flakes(particle: str) -> None:
    """Over the outline, where backscatter is smooth; the law by melted diameter is weighted by its Jacobian."""
    snow = sekhon_srivastava(2.5) if particle == "melted-flake" else brandes_snow(2.5)
    physical, step = _middles(float(physical_diameter_mm(0.1)), 20.0, 20000)
    melted = melted_diameter_mm(physical)
    index = snow_refractive_index_microwave(77.0, snow_bulk_density_g_per_cm3(physical), -5.0)
    sigma_b_m2 = mie_efficiencies(math.pi * physical / WAVELENGTH_MM, index).q_back * math.pi / 4 * physical**2 * 1e-6
    if particle == "flake":
        number = snow.number_density_per_m3_mm(physical) * step
    else:
        edges = melted_diameter_mm(torch.stack([physical - step / 2, physical + step / 2]))
        number = snow.number_density_per_m3_mm(melted) * (edges[1] - edges[0])
    got = reflectivity_weighted_fall_speed(snow)
    wanted = _moments(sigma_b_m2 * number, snow_fall_speed_m_per_s(melted))
    # 5e-3 on eta, the tolerance of its oracle block
    for value, moment, tolerance in zip(got, wanted, (5e-3, 5e-4, 5e-3), strict=True):
        assert float(value) == pytest.approx(moment, rel=tolerance)


def test_rayleigh_drops_of_melted_snow_in_closed_form() -> None:
    # At 1 GHz sigma_b goes as D^6 and v as D^0.31, so the moments of an exponential law are gamma functions.
    snow = sekhon_srivastava(0.1).within(0.005, 5.0)  # 6e-6 of the sixth moment lies beyond 5 mm
    slope = 2.29 * 0.1**-0.45
    first, second = (
        (2.07 * (10.0 * slope) ** -0.31) ** k * math.gamma(7.0 + 0.31 * k) / math.gamma(7.0) for k in (1, 2)
    )
    _, mean, std = reflectivity_weighted_fall_speed(snow, 1.0, melt_fraction=1.0)
    # 2e-3: the next term of the series in the size parameter, |m| x = 0.09 at the median size
    assert float(mean) == pytest.approx(first, rel=2e-3)
    assert float(std) == pytest.approx(math.sqrt(second - first**2), rel=5e-3)


def test_rain_shows_a_car_radar_four_to_six_metres_per_second() -> None:
    _, mean, std = reflectivity_weighted_fall_speed(marshall_palmer(torch.tensor([1.0, 10.0, 100.0])))
    assert bool(((mean > 4.0) & (mean < 6.0)).all())
    assert bool(((std > 0.7) & (std < 2.0)).all())
    assert bool((mean.diff() > 0).all())
    # Rayleigh's D^6 of a weather radar shows the large drops, 8 m/s
    _, weather_radar, _ = reflectivity_weighted_fall_speed(marshall_palmer(10.0), 3.0)
    assert 6.5 < float(weather_radar) < 8.5


def test_snow_falls_about_a_metre_per_second_and_fog_hardly() -> None:
    _, mean, std = reflectivity_weighted_fall_speed(sekhon_srivastava(1.0))
    assert 0.8 < float(mean) < 1.3
    assert 0.05 < float(std) < 0.3
    # The measured fogs are wide: droplets of 0.1 mm, which fall at 0.27 m/s, carry most of the sixth moment.
    _, mean, _ = reflectivity_weighted_fall_speed(rehearse_fog(30))
    assert 0.0 < float(mean) < 0.4


def test_reflectivity_is_that_of_volume_reflectivity() -> None:
    rain, snow = marshall_palmer(torch.tensor([1.0, 30.0])), sekhon_srivastava(1.0)
    eta, _, _ = reflectivity_weighted_fall_speed(rain, 79.0, 20.0)
    assert torch.equal(eta, volume_reflectivity_m2_per_m3(rain, 79.0, temperature_c=20.0))
    eta, _, _ = reflectivity_weighted_fall_speed(snow, melt_fraction=0.3)
    assert torch.equal(eta, volume_reflectivity_m2_per_m3(snow, melt_fraction=0.3))


def test_a_batch_is_its_rates_one_by_one() -> None:
    rates = torch.tensor([[1.0, 5.0], [20.0, 80.0]], dtype=torch.float64)
    batch = torch.stack(reflectivity_weighted_fall_speed(marshall_palmer(rates)))
    assert batch.shape == (3, 2, 2)
    alone = torch.stack([torch.stack(reflectivity_weighted_fall_speed(marshall_palmer(r))) for r in rates.flatten()])
    # 1e-4: a batch may share a wider table of sizes than its members, which each hold all but 1e-5
    torch.testing.assert_close(batch.flatten(1).T, alone, rtol=1e-4, atol=0.0)


def test_where_nothing_falls_all_is_zero_and_gradients_are_finite() -> None:
    rate = torch.tensor([0.0, 10.0], dtype=torch.float64, requires_grad=True)
    for value in reflectivity_weighted_fall_speed(marshall_palmer(rate)):
        assert float(value[0].detach()) == 0.0
        assert float(value[1].detach()) > 0.0
        (gradient,) = torch.autograd.grad(value.sum(), rate, retain_graph=True)
        assert bool(torch.isfinite(gradient).all())


def test_moments_are_differentiable_in_the_rate() -> None:
    rate = torch.tensor([0.5, 5.0], dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(lambda r: reflectivity_weighted_fall_speed(marshall_palmer(r)), rate)
    assert torch.autograd.gradcheck(
        lambda r: reflectivity_weighted_fall_speed(sekhon_srivastava(r), 77.0, None, 0.3), rate
    )


@pytest.mark.parametrize("frequency", [0.5, 1500.0, math.nan])
def test_frequencies_without_a_permittivity_are_refused(frequency: float) -> None:
    with pytest.raises(ValueError, match=r"reflectivity_weighted_fall_speed: frequency_ghz must lie in 1\.\.1000 GHz"):
        reflectivity_weighted_fall_speed(marshall_palmer(10.0), frequency)
