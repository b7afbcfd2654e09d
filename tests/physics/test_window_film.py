"""Water on a window: rain on a driven plane by drops, the film by its flow, layers by repeated reflection."""

from __future__ import annotations

import cmath
import math

import numpy as np
import pytest
import torch

from torchweather.physics import marshall_palmer, rain_fall_speed_m_per_s, water_refractive_index_microwave
from torchweather.physics.window_film import (
    drop_cover,
    film_thickness_mm,
    impinging_rain_mm_per_h,
    layers_transmittance,
    microwave_film_loss_db,
    optical_film_transmittance,
)


@pytest.mark.parametrize("inclination", [0.0, 30.0, 90.0])
def test_rain_on_a_driven_plane_is_that_of_drops(inclination: float) -> None:
    """Volume of drops of Marshall and Palmer's sizes that cross a plane of 1 m^2 in a second."""
    rain, speed = marshall_palmer(20.0), 15.0
    edges = np.linspace(0.05, 9.0, 3000)
    diameter = 0.5 * (edges[1:] + edges[:-1])
    number = rain.number_density_per_m3_mm(torch.from_numpy(diameter)).numpy() * np.diff(edges)
    fall = rain_fall_speed_m_per_s(torch.from_numpy(diameter)).numpy()
    tilt = math.radians(inclination)
    volume = math.pi / 6 * (1e-3 * diameter) ** 3
    crossing = (number * volume * (fall * math.cos(tilt) + speed * math.sin(tilt))).sum()
    flux = (number * volume * fall).sum() * 3.6e6
    water = (number * volume).sum() * 1e6
    found = float(impinging_rain_mm_per_h(flux, water, speed, inclination))
    assert found == pytest.approx(crossing * 3.6e6, rel=1e-9)


def test_the_film_carries_the_rain_away() -> None:
    """Integrated over its parabolic speed profile, the film at the lower end carries what fell on the plate."""
    rain, length = 100.0, 0.2
    mean_m = 1e-3 * float(film_thickness_mm(rain, length, 40.0, temperature_c=20.0))
    height = mean_m / 0.75
    depth = np.linspace(0.0, height, 4001)
    viscosity = 1.002e-6  # water at 20 C, m^2/s
    speed = 9.81 * math.sin(math.radians(40.0)) / viscosity * (height * depth - depth**2 / 2)
    carried = float(((speed[1:] + speed[:-1]) / 2 * np.diff(depth)).sum())
    assert carried == pytest.approx(rain / 3.6e6 * length, rel=0.01)  # Vogel's viscosity is good to 1 %


def test_layers_are_waves_that_go_to_and_fro() -> None:
    """Two layers by Airy's sums of repeated reflections, from the inside out."""
    first, second = 1.6 + 0.0j, complex(water_refractive_index_microwave(77.0))
    way = (1.2, 0.09)
    wave = 3.89
    n = [1.0 + 0.0j, first, second, 1.0 + 0.0j]

    def r(i: int, j: int) -> complex:
        return (n[i] - n[j]) / (n[i] + n[j])

    def t(i: int, j: int) -> complex:
        return 2 * n[i] / (n[i] + n[j])

    phase = [cmath.exp(2j * math.pi * n[k + 1] * way[k] / wave) for k in range(2)]
    back = r(2, 3)
    through = t(2, 3)
    for k in (1, 0):
        around = 1 + r(k, k + 1) * back * phase[k] ** 2
        through = t(k, k + 1) * phase[k] * through / around
        back = (r(k, k + 1) + back * phase[k] ** 2) / around
    found = float(layers_transmittance([first, second], list(way), wave))
    assert found == pytest.approx(abs(through) ** 2, rel=1e-9)


def test_a_film_on_a_cover_costs_decibels_and_none_costs_nothing() -> None:
    loss = microwave_film_loss_db(torch.tensor([0.0, 0.02, 0.1, 0.3]), 77.0)
    assert float(loss[0]) == 0.0
    assert bool((loss.diff() > 0).all())
    # Absorption alone, 4 pi k h / lambda in dB, is less than the loss of a thin film, which mirrors as well.
    k = complex(water_refractive_index_microwave(77.0)).imag
    assert float(loss[2]) > 10 / math.log(10) * 4 * math.pi * k * 0.1 / 3.893


def test_a_film_absorbs_at_1550_nm_alone() -> None:
    film = torch.tensor([0.0, 1.0])
    near, far = (optical_film_transmittance(film, nm) for nm in (905.0, 1550.0))
    assert float(near[0]) == float(far[0]) == 1.0
    assert 1.0 < float(near[1]) < 1.03
    # 4 pi k / lambda is about 1.1 per mm (Segelstein 1981).
    assert float(far[1]) == pytest.approx(1.02 * math.exp(-1.05), rel=0.1)


def test_drops_cover_what_their_volume_says_until_they_run_off() -> None:
    assert float(drop_cover(0.0)) == 0.0
    assert float(drop_cover(1e-4)) == pytest.approx(1e-4 / 0.25, rel=1e-3)
    assert float(drop_cover(math.inf)) == 0.55


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (lambda: film_thickness_mm(2001.0, 0.1), r"impinging_mm_per_h must lie in 0..2000 mm/h"),
        (lambda: film_thickness_mm(10.0, 0.1, 1.0), r"inclination_deg must lie in 5..90 degrees"),
        (lambda: microwave_film_loss_db(3.0, 77.0), r"film_mm must lie in 0..2 mm; got 3"),
        (lambda: impinging_rain_mm_per_h(1.0, 0.1, 101.0, 90.0), r"speed_m_per_s must lie in 0..100 m/s"),
        (lambda: layers_transmittance([1.5], [0.1, 0.2], 3.9), r"one thickness for each layer; got 1 indices and 2"),
    ],
)
def test_beyond_the_range_of_a_law_is_refused(call: object, said: str) -> None:
    with pytest.raises(ValueError, match=said):
        call()  # type: ignore[operator]
