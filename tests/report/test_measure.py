from __future__ import annotations

import math

import numpy as np
import pytest
import torch

from torchweather.atmosphere.weather import Fog, Mixture, Rain, Snow
from torchweather.physics import extinction_per_m
from torchweather.report.measure import falling_numbers, light_path, mean_over_bins, populations
from torchweather.sensors import Camera
from torchweather.stages import CameraState
from torchweather.transforms import BayerWeather

CAMERA = Camera.from_intrinsics(300.0, 330.0, 31.5, 23.5, 64, 48)
DEPTH_M = 12.0


def test_particles_in_view_are_density_times_frustum() -> None:
    rain = BayerWeather(Rain(25.0), CAMERA, airlight=0.5)
    numbers = falling_numbers(rain, torch.full((1, 48, 64), DEPTH_M, dtype=torch.float64))
    # Pyramid of 64 x 48 px: base Z^2 W H / (fx fy), a third of base times height, less the part before 0.5 m.
    frustum_m3 = (DEPTH_M**3 - 0.5**3) / 3 * 64 * 48 / (300.0 * 330.0)
    per_m3 = float(Rain(25.0).distribution().total_per_m3)
    assert numbers["particles_in_view"] == pytest.approx(per_m3 * frustum_m3, rel=1e-9)


@pytest.mark.parametrize("weather", [Rain(50.0), Snow(3.0)])
def test_as_many_particles_are_drawn_as_expected(weather: Rain | Snow) -> None:
    transform = BayerWeather(weather, CAMERA, airlight=0.5)
    depth = torch.full((1, 48, 64), DEPTH_M)
    expected = falling_numbers(transform, depth)["particles_drawn_one_by_one"]
    part = populations(transform)[0]
    state = CameraState.of(
        signal=torch.zeros(1, 1, 48, 64),
        depth_m=depth[None],
        ray_per_depth=torch.ones(1, 1, 48, 64),
        cfa_index=torch.tensor([[0, 1], [1, 2]]),
        intrinsics=torch.tensor([CAMERA.intrinsics]),
    )
    noise = {
        key.partition(".")[2]: value[None] for key, value in transform.draw(torch.zeros(1, 48, 64), seed=3).items()
    }
    tables, count = part.at_rate(1), 0
    for number in range(len(part.tables.listed)):
        for marks in part.marks(state, noise, tables, number):
            inside = (marks.u_px >= -0.5) & (marks.u_px < 63.5) & (marks.v_px >= -0.5) & (marks.v_px < 47.5)
            count += int((inside & (marks.depth_m < DEPTH_M) & (marks.opacity > 0)).sum())
    # A Poisson count, four deviations, and 1 % for the interpolation of the tables.
    assert count == pytest.approx(expected, abs=4 * math.sqrt(expected) + 0.01 * expected)


def test_a_lower_cut_draws_more_one_by_one_and_leaves_the_expected_mask() -> None:
    depth = torch.full((1, 48, 64), DEPTH_M)
    fine, coarse = (
        falling_numbers(BayerWeather(Snow(1.0), CAMERA, airlight=0.5, min_listed_coverage=cut), depth)
        for cut in (1 / 256, 1 / 8)
    )
    assert fine["share_drawn_one_by_one"] > coarse["share_drawn_one_by_one"] > 0
    assert 1 > fine["share_of_optical_depth_drawn_one_by_one"] > coarse["share_of_optical_depth_drawn_one_by_one"] > 0
    assert fine["mask_mean_expected"] == coarse["mask_mean_expected"]


def test_optical_depths_of_fog_and_rain_add() -> None:
    def optical(weather: Rain | Fog | Mixture) -> float:
        return light_path(BayerWeather(weather, CAMERA, airlight=0.5)).optical_depth(28.0)

    fog, rain = Fog(mor_m=100.0), Rain(25.0)
    assert optical(Mixture(fog, rain)) == pytest.approx(optical(fog) + optical(rain), rel=1e-12)


def test_camera_loses_to_drops_what_their_outline_covers() -> None:
    geometric = float(extinction_per_m(Rain(25.0).distribution(), 550.0, q_ext=1.0))
    path = light_path(BayerWeather(Rain(25.0), CAMERA, airlight=0.5))
    assert path.optical_depth(28.0) == pytest.approx(geometric * 27.5, rel=1e-12)
    everything = float(extinction_per_m(Rain(25.0).distribution(), 550.0))
    # Mie's efficiency of drops of a millimetre is 2 and some per cent.
    assert everything / geometric == pytest.approx(2.03, abs=0.03)


def test_means_over_bins_are_those_of_a_loop() -> None:
    random = np.random.default_rng(0)
    distance, value = random.uniform(1, 100, 5000), random.uniform(0, 1, 5000)
    edges = np.array([2.0, 10.0, 50.0, 90.0])
    found = mean_over_bins(distance, {"v": value}, edges)
    for number in range(3):
        inside = (distance >= edges[number]) & (distance < edges[number + 1])
        assert found["v"][number] == pytest.approx(value[inside].mean())
        assert found["distance_m"][number] == pytest.approx(distance[inside].mean())
