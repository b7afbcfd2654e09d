"""Particles at the edge of a wide picture (PHYSICS.md 10.1): the optical depth is that of the ray."""

from __future__ import annotations

import math

import pytest
import torch

from tests.reference.every_particle import Kind, geometric_extinction, population
from torchweather.atmosphere.weather import Rain, Snow
from torchweather.sensors import Camera
from torchweather.transforms import BayerWeather

SIZE, F_PX, NEAR_M = 96, 1137.4, 1.5
SEEDS = 24


@pytest.mark.parametrize(("kind", "rate"), [("rain", 50.0), ("snow", 3.0)])
@pytest.mark.parametrize("distance_m", [20.0, 120.0])
def test_cover_at_the_corner_is_that_of_the_rays(kind: Kind, rate: float, distance_m: float) -> None:
    """At 120 m nine tenths of the cover are haze; at 20 m a third."""
    camera = Camera.from_intrinsics(F_PX, F_PX, -871.5, -635.5, SIZE, SIZE, exposure_s=0.005, lens_blur_px=2.2)
    weather = Rain(rate) if kind == "rain" else Snow(rate)
    transform = BayerWeather(weather, camera, near_m=NEAR_M, depth=distance_m, airlight=0.5)
    frame = torch.zeros(1, SIZE, SIZE)
    covers = torch.stack(
        [transform.run(frame, noise=transform.draw(frame, seed=seed)).particle_mask.mean() for seed in range(SEEDS)]
    )
    ray = camera.ray_directions().norm(dim=0)
    alpha = geometric_extinction(population(kind, rate))
    wanted = float(-torch.expm1(-alpha * (distance_m - NEAR_M) * ray).mean())
    error = float(covers.std()) / math.sqrt(SEEDS)
    assert float(covers.mean()) == pytest.approx(wanted, abs=0.01 * wanted + 3 * error)
    on_axis = -math.expm1(-alpha * (distance_m - NEAR_M))
    assert wanted - on_axis > 3 * (0.01 * wanted + 3 * error)  # the test could see the factor
