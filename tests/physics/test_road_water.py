"""Water on a road: the law in its published units, and the optics of a film by ray counting."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch

from torchweather.physics.road_water import damp_share, drowned_share, road_water_mm, wet_albedo

INCH_MM, FOOT_M = 25.4, 0.3048


def gallaway_inches(rain_in_per_h: float, length_ft: float, slope: float, texture_in: float) -> float:
    """The regression as published: film over the tops of the texture, inches."""
    return 3.38e-3 * texture_in**0.11 * length_ft**0.43 * rain_in_per_h**0.59 * slope**-0.42 - texture_in


@pytest.mark.parametrize(
    ("rain", "length", "slope", "texture"), [(10.0, 5.0, 2.5, 0.7), (50.0, 12.0, 1.0, 1.5), (100.0, 3.6, 4.0, 0.4)]
)
def test_depth_is_that_of_the_law_in_inches(rain: float, length: float, slope: float, texture: float) -> None:
    film_in = gallaway_inches(rain / INCH_MM, length / FOOT_M, slope / 100.0, texture / INCH_MM)
    found = float(road_water_mm(rain, length, slope, texture))
    assert found == pytest.approx(film_in * INCH_MM + texture, rel=2e-3)  # 0.103 is rounded from 0.1029


def test_no_rain_leaves_no_water() -> None:
    assert float(road_water_mm(0.0)) == 0.0


@pytest.mark.parametrize(
    ("name", "values", "said"),
    [
        ("rain", {"rain_mm_per_h": 201.0}, "rain_mm_per_h must lie in 0..200 mm/h; got 201"),
        ("slope", {"rain_mm_per_h": 5.0, "slope_percent": 0.0}, "slope_percent must lie in 0.3..10 %"),
        ("texture", {"rain_mm_per_h": 5.0, "texture_mm": 9.0}, "texture_mm must lie in 0.1..5 mm"),
        ("length", {"rain_mm_per_h": 5.0, "drainage_m": 500.0}, "drainage_m must lie in 0.5..50 m"),
    ],
)
def test_beyond_the_range_of_the_law_is_refused(name: str, values: dict[str, float], said: str) -> None:
    with pytest.raises(ValueError, match=said.replace(".", r"\.")):
        road_water_mm(**values)


def test_wet_albedo_is_that_of_photons_in_a_film() -> None:
    """Photons between a Lambertian floor and a film that is totally reflecting beyond the critical angle."""
    n, albedo, photons = 1.33, 0.3, 400_000
    random = np.random.default_rng(3)
    inside, out, critical = photons, 0, math.asin(1.0 / n)
    for _ in range(60):
        kept = random.binomial(inside, albedo)  # not absorbed by the floor
        sine = np.sqrt(random.random(kept))  # Lambert's law
        leaves = np.arcsin(sine) < critical
        out += int(leaves.sum())
        inside = kept - int(leaves.sum())
    expected = float(wet_albedo(albedo, n))
    error = math.sqrt(expected * (1 - expected) / photons)
    assert out / photons == pytest.approx(expected, abs=4 * error)


def test_shares_grow_from_nothing_to_all() -> None:
    water = torch.tensor([0.0, 0.1, 1.0, 20.0])
    for share in (damp_share(water), drowned_share(water, 0.7)):
        assert share[0] == 0.0
        assert bool((share.diff()[:2] > 0).all())
        assert float(share[-1]) == pytest.approx(1.0)
    # Exponential textures of mean T: the share of places below the water, drawn.
    drawn = np.random.default_rng(1).exponential(0.7, 100_000)
    assert float(drowned_share(water, 0.7)[1]) == pytest.approx(float((drawn < 0.1).mean()), abs=4e-3)
