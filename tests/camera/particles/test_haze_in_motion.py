"""The haze in wind and from a moving vehicle (PHYSICS.md 10.10), against streaks drawn one by one.

Campbell's theorem gives variance and covariance of a picture of many faint streaks from single ones: particles are
thrown into the frustum, each one's way over the image follows from its velocity, and its mark, a line of a given area,
is laid on the pixels point by point.
"""

from __future__ import annotations

import numpy as np
import pytest
import torch
from numpy.typing import NDArray

from torchweather.atmosphere.weather import Rain
from torchweather.camera.particles.haze import haze_depth
from torchweather.camera.particles.population import Population
from torchweather.camera.particles.tables import BOX_OF_DISK
from torchweather.sensors import Camera
from torchweather.transforms import BayerRain

Array = NDArray[np.float64]
SIZE, F_PX, NEAR_M, DEPTH_M = 128, 110.0, 1.0, 10.0  # 60 degrees wide
EXPOSURE_S = 0.01
PARTICLES, POINTS, SEEDS = 20_000, 64, 24
LAGS = (0, 1, 2, 4)


def transform_of(wind: float, ego: float) -> BayerRain:
    camera = Camera.from_intrinsics(
        F_PX, F_PX, (SIZE - 1) / 2, (SIZE - 1) / 2, SIZE, SIZE, exposure_s=EXPOSURE_S, lens_blur_px=0.0
    )
    rain = Rain(50.0, wind_m_per_s=(0.0, -wind, 0.0))
    # Nothing is listed: all particles are haze.
    return BayerRain(
        rain, camera, near_m=NEAR_M, depth=DEPTH_M, airlight=0.5, ego_speed_m_per_s=ego, min_listed_coverage=1.0
    )


def covariances(wind: float, ego: float) -> tuple[Array, Array]:
    """Covariance of the optical depth down the image and across it at `LAGS`, up to the density of the particles."""
    rng = np.random.default_rng(7)
    rain = Rain(50.0)
    # Sizes and depths with a weight: number times squared area, and volume.
    diameter_mm = np.exp(rng.uniform(np.log(0.2), np.log(8.0), PARTICLES))
    depth = np.exp(rng.uniform(np.log(NEAR_M), np.log(DEPTH_M), PARTICLES))
    distribution = rain.distribution(torch.tensor(50.0))
    density = distribution.number_density_per_m3_mm(torch.from_numpy(diameter_mm)).numpy() * diameter_mm
    speed = rain.fall_speed_m_per_s(torch.from_numpy(diameter_mm)).numpy()
    foot = depth / F_PX
    area_px2 = np.pi / 4 * (1e-3 * diameter_mm / foot) ** 2
    weight = density * foot**3 * area_px2**2
    x, y = rng.uniform(-0.5, 0.5, (2, PARTICLES)) * SIZE / F_PX
    vx, vy, vz = wind, speed, -ego
    way_x, way_y = ((vx - x * vz) * EXPOSURE_S / foot, (vy - y * vz) * EXPOSURE_S / foot)
    width = BOX_OF_DISK * 1e-3 * diameter_mm / foot
    secant2 = 1 + x**2 + y**2
    down, aside = np.zeros(len(LAGS)), np.zeros(len(LAGS))
    chosen = rng.choice(PARTICLES, 4000, p=weight / weight.sum())
    for k in chosen:
        along = (np.arange(POINTS) + rng.random(POINTS)) / POINTS - 0.5
        spread = width[k] * (rng.random((2, POINTS)) - 0.5)
        column = np.floor(rng.random() + along * way_x[k] + spread[0]).astype(int)
        row = np.floor(rng.random() + along * way_y[k] + spread[1]).astype(int)
        # Pairs of different points, so that a point does not meet itself.
        apart_row, apart_column = row[:, None] - row, column[:, None] - column
        pairs = POINTS * (POINTS - 1)
        for place, lag in enumerate(LAGS):
            own = POINTS if lag == 0 else 0
            down[place] += (((apart_row == lag) & (apart_column == 0)).sum() - own) / pairs * secant2[k]
            aside[place] += (((apart_row == 0) & (apart_column == lag)).sum() - own) / pairs * secant2[k]
    total = weight.mean() / len(chosen)
    return down * total, aside * total


def of_haze(wind: float, ego: float) -> tuple[Array, Array]:
    """The same of the library's haze."""
    transform = transform_of(wind, ego)
    veil = transform.chain.stages["particle_veil"]
    part: Population = veil.parts[0]  # type: ignore[union-attr]
    frame = torch.full((1, SIZE, SIZE), 0.1)
    state = transform.state_of(frame)
    tables = part.in_air(state)
    fields = []
    for seed in range(SEEDS):
        noise = {name.partition(".")[2]: value for name, value in transform.chain.draw(state, seed=seed).items()}
        fields.append(haze_depth(part, state, noise, tables, 0, SIZE)[0][0, 0].double().numpy())
    away = np.stack(fields) - np.mean(fields, 0)  # the mean grows towards the edges
    frames = SEEDS / (SEEDS - 1)
    down = [frames * (away[:, lag:] * away[:, : SIZE - lag]).mean() for lag in LAGS]
    aside = [frames * (away[:, :, lag:] * away[:, :, : SIZE - lag]).mean() for lag in LAGS]
    return np.array(down), np.array(aside)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("wind", "ego"),
    [
        pytest.param(0.0, 0.0, marks=pytest.mark.long),
        pytest.param(3.0, 0.0, marks=pytest.mark.long),
        (0.0, 8.0),
        (3.0, 8.0),
    ],
)
def test_variance_and_correlation_are_those_of_single_streaks(wind: float, ego: float) -> None:
    still, moving = covariances(0.0, 0.0), covariances(wind, ego)
    ours_still, ours = of_haze(0.0, 0.0), of_haze(wind, ego)
    # Deviation against still air, where both have the density of the particles: 3 % (4000 streaks, 24 frames).
    assert np.sqrt(ours[0][0] / ours_still[0][0]) == pytest.approx(np.sqrt(moving[0][0] / still[0][0]), rel=0.03)
    # One axis for the whole frame: where streaks lean and fan out, it is a compromise.
    allowed = 0.07 if wind and ego else 0.05
    for mine, theirs in zip(ours, moving, strict=True):
        assert mine[1:] / mine[0] == pytest.approx(theirs[1:] / theirs[0], abs=allowed)
