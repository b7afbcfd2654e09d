"""Kinds of rain by Joss and Deirmendjian, snowfalls of D3.4's Table 4: families that a weather takes by name."""

from __future__ import annotations

import math

import pytest
import torch

from torchweather.atmosphere.weather import Rain, Snow
from torchweather.physics import (
    DEIRMENDJIAN_RAIN,
    JOSS,
    RAIN,
    SNOW,
    brandes_table4,
    deirmendjian_rain,
    extinction_per_m,
    joss_rain,
    precipitation_rate_mm_per_h,
)
from torchweather.sensors import Camera, Lidar
from torchweather.transforms import BayerRain, BayerSnow, LidarRain, LidarSnow


@pytest.mark.parametrize("kind", list(JOSS))
def test_joss_is_an_exponential_of_the_printed_numbers(kind: str) -> None:
    intercept, slope = JOSS[kind]
    found = joss_rain(kind, 5.0, diameter_min_mm=0.0, diameter_max_mm=40.0)
    rising = slope * 5.0**-0.21
    assert float(found.number_density_per_m3_mm(torch.tensor(1.0))) == pytest.approx(intercept * math.exp(-rising))
    assert float(found.total_per_m3) == pytest.approx(intercept / rising, rel=1e-9)


def test_kinds_of_rain_carry_their_rate_within_a_third_and_differ_in_extinction() -> None:
    rates = {kind: float(precipitation_rate_mm_per_h(joss_rain(kind, 10.0))) for kind in JOSS}
    assert all(7.0 < rate < 14.0 for rate in rates.values())
    alpha = {kind: float(extinction_per_m(joss_rain(kind, 10.0), 905.0, q_ext=2.0)) for kind in JOSS}
    assert alpha["drizzle"] > alpha["widespread"] > alpha["thunderstorm"]


@pytest.mark.parametrize(("name", "scale", "slope"), [("rain-l", 4.9757e7, 15.1186), ("rain-m", 5.3333e5, 8.9443)])
def test_deirmendjian_rain_has_the_printed_shape_and_carries_the_rate(name: str, scale: float, slope: float) -> None:
    """Deirmendjian 1969, models rain L and rain M: a r^alpha exp(-b sqrt(r)), r in mm, 1,000 drops per m^3."""
    name = f"deirmendjian-{name}"
    found = deirmendjian_rain(name, 5.0, diameter_min_mm=0.0, diameter_max_mm=1e3)
    alpha, _ = DEIRMENDJIAN_RAIN[name]
    radius = torch.tensor([0.05, 0.2, 1.0, 2.5], dtype=torch.float64)
    printed = scale * radius**alpha * torch.exp(-slope * radius.sqrt())
    per_radius = 2.0 * found.number_density_per_m3_mm(2.0 * radius) * (1000.0 / found.total_per_m3)
    assert per_radius.tolist() == pytest.approx(printed.tolist(), rel=1e-4)
    rates = torch.tensor([0.0, 0.5, 80.0])
    assert precipitation_rate_mm_per_h(deirmendjian_rain(name, rates)).tolist() == pytest.approx(rates.tolist())


@pytest.mark.parametrize("row", ["2.59", "2.70", "3.03"])
def test_a_row_of_table_4_keeps_its_sizes_and_carries_the_rate(row: str) -> None:
    family, measured = SNOW[f"colorado-{row}"], brandes_table4(row)
    at = torch.tensor([1.0, 3.0, 8.0])
    ratio = family(2.0).number_density_per_m3_mm(at) / measured.number_density_per_m3_mm(at)
    assert ratio.tolist() == pytest.approx([float(ratio[0])] * 3, rel=1e-9)
    assert float(precipitation_rate_mm_per_h(family(2.0))) == pytest.approx(2.0, rel=1e-6)
    assert float(family(0.0).total_per_m3) == 0.0


def test_a_row_of_table_4_is_found_by_its_number() -> None:
    for number, text in ((2.59, "2.59"), (2.7, "2.70")):
        assert float(brandes_table4(number).total_per_m3) == float(brandes_table4(text).total_per_m3)
    for other in (2.5, "2.6", 2.591):
        with pytest.raises(ValueError, match=r"row must be one of 2.59, 2.70, 3.03"):
            brandes_table4(other)


@pytest.mark.parametrize("name", [*RAIN, *SNOW])
def test_a_weather_takes_every_family_for_camera_and_lidar(name: str) -> None:
    frame, camera = torch.full((1, 24, 32), 0.2), Camera.from_intrinsics(100, 100, 15.5, 11.5, 32, 24)
    points, lidar = torch.tensor([[20.0, 0.0, 0.0, 0.3]]), Lidar(wavelength_nm=905.0)
    if name in RAIN:
        rain = Rain(20.0, size_distribution=name)
        image = BayerRain(rain, camera, depth=30.0, airlight=0.5)(frame, seed=1)
        cloud = LidarRain(rain, lidar)(points, seed=1)
    else:
        snow = Snow(2.0, size_distribution=name)
        image = BayerSnow(snow, camera, depth=30.0, airlight=0.5)(frame, seed=1)
        cloud = LidarSnow(snow, lidar)(points, seed=1)
    assert bool(image.isfinite().all())
    assert float((image - frame).abs().max()) > 1e-4
    assert bool(cloud.isfinite().all())
