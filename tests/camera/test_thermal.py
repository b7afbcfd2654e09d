"""Thermal camera: against Planck's law integrated finely, Rayleigh's limit, and what weather leaves as it is."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from torch import Tensor

from torchweather.atmosphere.weather import Fog, Mixture, Rain, Snow, Weather
from torchweather.camera.thermal import ThermalWeather
from torchweather.core.distributions import Uniform
from torchweather.core.errors import TorchweatherError
from torchweather.physics import extinction_per_m, water_refractive_index
from torchweather.physics.size_distributions import LogNormal
from torchweather.physics.thermal_band import ThermalBand, planck_w_per_m2_sr_um
from torchweather.sensors import Camera

CAMERA = Camera.from_intrinsics(40.0, 40.0, 15.5, 11.5, 32, 24)


def frame(temperature_c: float = 30.0) -> Tensor:
    return torch.full((1, 24, 32), temperature_c)


def test_planck_peaks_where_wien_says_and_sums_to_stefan_and_boltzmann() -> None:
    wavelength = torch.logspace(-0.3, 3.7, 40001, dtype=torch.float64)
    radiance = planck_w_per_m2_sr_um(wavelength, 26.85)
    assert float(wavelength[radiance.argmax()]) == pytest.approx(2897.771955 / 300.0, rel=1e-3)
    assert math.pi * float(torch.trapezoid(radiance, wavelength)) == pytest.approx(5.670374419e-8 * 300.0**4, rel=1e-4)


def test_a_band_gives_its_temperature_back() -> None:
    band, temperature_c = ThermalBand(8.0, 14.0), torch.linspace(-100.0, 400.0, 1001)
    found = band.temperature_c(band.radiance(temperature_c).sum(-1))
    assert float((found - temperature_c).abs().max()) < 1e-3


@pytest.mark.parametrize(
    ("weather", "steps"),
    [(Fog(mor_m=60.0), 31), (Fog.advection(60.0), 31), (Rain(40.0), 7)],
    ids=["small", "large", "rain"],
)
def test_the_seven_wavelengths_are_enough(weather: Weather, steps: int) -> None:
    """Against the band in more wavelengths, each with its own Mie extinction, and a temperature found by bisection."""
    wavelengths_um = np.linspace(8.0, 14.0, steps)
    alpha = np.array([float(extinction_per_m(weather.distribution(), 1e3 * one)) for one in wavelengths_um])
    alpha *= 0.55 if weather.kind == "rain" else 1.0
    depth_m = 45.0

    def band_radiance(temperature_c: float) -> np.ndarray:
        return planck_w_per_m2_sr_um(torch.from_numpy(wavelengths_um), temperature_c).numpy()

    clear = np.exp(-alpha * depth_m)
    wanted = np.trapezoid(band_radiance(35.0) * clear + band_radiance(4.0) * (1 - clear), wavelengths_um)
    low, high = -50.0, 100.0
    for _ in range(60):
        middle = 0.5 * (low + high)
        below = np.trapezoid(band_radiance(middle), wavelengths_um) < wanted
        low, high = (middle, high) if below else (low, middle)
    # The pixel beside the optical axis.
    ray = math.sqrt(1 + 2 * (0.5 / 40.0) ** 2)
    found = ThermalWeather(weather, CAMERA, air_temperature_c=4.0)(frame(35.0), depth_m / ray)[0, 11, 15]
    assert float(found) == pytest.approx(low, abs=0.05)


def test_droplets_far_smaller_than_the_wavelength_absorb_by_their_volume() -> None:
    """Rayleigh: ``6 pi / lambda Im((m^2 - 1) / (m^2 + 2))`` times the share of the volume that is water."""
    tiny = LogNormal(1e4, 0.05, 0.1)
    m = complex(water_refractive_index(10_000.0))
    volume = float(tiny.liquid_water_g_per_m3()) * 1e-6
    wanted = 6 * math.pi / 10e-6 * ((m**2 - 1) / (m**2 + 2)).imag * volume
    assert float(extinction_per_m(tiny, 10_000.0)) == pytest.approx(wanted, rel=0.02)


def test_small_droplets_let_heat_through_and_large_ones_do_not() -> None:
    """Radiation fog is thinner at 10 um than to the eye, advection fog is not (Beier & Gemperlein 2004)."""
    seen = {
        name: float(ThermalWeather(fog, CAMERA, air_temperature_c=0.0)(frame(30.0), 60.0)[0, 12, 16])
        for name, fog in (("small", Fog(mor_m=60.0)), ("large", Fog.advection(60.0)))
    }
    eye = 30.0 * 0.05
    assert seen["small"] > 4 * eye
    assert seen["large"] < 2 * eye


@pytest.mark.parametrize("weather", [Fog(mor_m=math.inf), Rain(0.0), Snow(0.0)], ids=["fog", "rain", "snow"])
def test_no_weather_leaves_every_bit(weather: Weather) -> None:
    given = 20.0 + 5.0 * torch.randn(2, 1, 24, 32, generator=torch.Generator().manual_seed(1))
    assert torch.equal(ThermalWeather(weather, CAMERA)(given, math.inf), given)


def test_an_intensity_for_each_sample_and_a_mixture() -> None:
    both = ThermalWeather(Rain(torch.tensor([0.0, 30.0])), CAMERA, air_temperature_c=5.0)(
        frame().expand(2, 1, 24, 32), 80.0
    )
    assert torch.equal(both[0], frame())
    alone = ThermalWeather(Rain(30.0), CAMERA, air_temperature_c=5.0)(frame(), 80.0)
    assert torch.allclose(both[1], alone, atol=1e-4)
    mixed = ThermalWeather(Mixture(Rain(30.0), Fog(mor_m=300.0)), CAMERA, air_temperature_c=5.0)
    parts = [ThermalWeather(one, CAMERA) for one in (Rain(30.0), Fog(mor_m=300.0))]
    assert torch.allclose(mixed.extinction_per_m, parts[0].extinction_per_m + parts[1].extinction_per_m)


def test_the_sky_keeps_its_cold_through_the_top_of_the_layer() -> None:
    level, up = ThermalWeather(Fog(mor_m=400.0), CAMERA, air_temperature_c=10.0, layer_top_m=20.0)(
        frame(-40.0), math.inf
    )[0, (12, 0), 16].tolist()
    assert level == pytest.approx(10.0, abs=0.1)
    assert up < 0.0


def test_it_learns_the_temperature_and_the_depth() -> None:
    given, depth = frame().requires_grad_(), torch.full((1, 24, 32), 50.0, requires_grad=True)
    ThermalWeather(Fog(mor_m=80.0), CAMERA, air_temperature_c=0.0)(given, depth).sum().backward()
    assert given.grad is not None
    assert depth.grad is not None
    assert bool((given.grad > 0).all())
    assert bool((depth.grad < 0).all())


@pytest.mark.parametrize(
    ("call", "told"),
    [
        (lambda: ThermalWeather(Fog(mor_m=50.0), CAMERA)(frame(300.0), 20.0), "looks like kelvin"),
        (lambda: ThermalWeather(Fog(mor_m=50.0), CAMERA)(torch.zeros(1, 10, 10), 20.0), "24 x 32"),
        (lambda: ThermalWeather(Fog(mor_m=50.0), CAMERA)(frame(), -1.0), "0 m or more"),
        (lambda: ThermalWeather(Fog(mor_m=50.0), CAMERA)(frame(), torch.ones(1, 3, 3)), "shapes must broadcast"),
        (
            lambda: ThermalWeather(Fog(mor_m=50.0), CAMERA)(frame().half(), 20.0),
            "float32 or float64; got torch.float16",
        ),
        (lambda: ThermalWeather(Fog(mor_m=50.0), CAMERA, low_um=3.0), "low_um"),
        (lambda: ThermalWeather(Fog(mor_m=50.0), CAMERA, low_um=12.0, high_um=9.0), "below high_um"),
        (lambda: ThermalWeather(Rain(Uniform(1.0, 5.0)), CAMERA), "drawn"),
    ],
)
def test_bad_input_is_refused_with_what_to_do(call: object, told: str) -> None:
    assert callable(call)
    with pytest.raises(TorchweatherError, match=told):
        call()
