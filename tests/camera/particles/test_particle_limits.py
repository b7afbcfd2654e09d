"""Particles where formulas end: before the near limit, at rest, off the axis, in large batches, above the capacity."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch

from tests.camera.particles.test_streaks import mask_of, padded
from tests.reference.every_particle import Particles, mark_patches
from torchweather.atmosphere.weather import Fog, Mixture, Rain, Snow
from torchweather.physics import Binned
from torchweather.sensors import Camera
from torchweather.transforms import BayerRain, BayerWeather

CAMERA = Camera.from_intrinsics(300.0, 300.0, 15.5, 11.5, 32, 24)


def test_pixels_before_the_near_limit_do_not_spoil_the_gradient() -> None:
    rate = torch.tensor(20.0, requires_grad=True)
    depth = torch.full((1, 24, 32), 30.0)
    depth[:, :6] = 0.2
    BayerRain(Rain(rate), CAMERA, airlight=0.7)(torch.full((1, 24, 32), 0.2), depth).mean().backward()
    assert rate.grad is not None
    assert math.isfinite(float(rate.grad))


def test_bins_of_a_disdrometer_may_begin_at_zero() -> None:
    BayerRain(Rain(5.0, size_distribution=Binned([0.0, 0.5, 1.0], [10.0, 5.0])), CAMERA, airlight=0.7)


@pytest.mark.parametrize("options", [{"far_m": math.inf}, {"rate_capacity_mm_per_h": -5.0}])
def test_senseless_limits_are_named(options: dict[str, float]) -> None:
    with pytest.raises(ValueError, match=next(iter(options))):
        BayerRain(Rain(5.0), CAMERA, airlight=0.7, **options)  # type: ignore[arg-type]


def test_a_rate_above_the_capacity_is_refused() -> None:
    rain = BayerRain(Rain(5.0), CAMERA, depth=30.0, airlight=0.7)
    rain.chain.stages["particle_veil"].parts[0].rate_mm_per_h.fill_(400.0)  # type: ignore[union-attr]
    with pytest.raises(ValueError, match="rate_capacity_mm_per_h"):
        rain(torch.full((1, 24, 32), 0.2))


def test_large_batches_equal_their_elements_bit_for_bit() -> None:
    camera = Camera.from_intrinsics(1137.4, 1137.4, 483.5, 365.5, 968, 732)
    rain = BayerRain(Rain(50.0), camera, depth=80.0, airlight=0.7)
    frames = torch.rand(3, 1, 732, 968)
    together = rain(frames, noise=rain.draw(frames, seed=1))
    for row in range(3):
        assert torch.equal(together[row], rain(frames[row], noise=rain.draw(frames[row], seed=1 + row)))


@pytest.mark.parametrize(("width_px", "length_px"), [(40.0, 1.0), (8.0, 1.0), (8.0, 4.0), (3.0, 3.0)])
def test_a_slow_slanted_mark_stays_round(width_px: float, length_px: float) -> None:
    mark, height, width = padded(width_px, length_px, math.pi / 4)
    mask = mask_of(mark, height, width).numpy()
    assert mask.sum() == pytest.approx(math.pi / 4 * width_px**2, rel=1e-2)
    particle = Particles(*(np.array([float(v)]) for v in (mark.u_px, mark.v_px, 1.0, width_px, length_px)))
    wanted = np.zeros((height, width))
    for values, row, column, _ in mark_patches(particle, math.pi / 4):
        wanted[row[0] : row[0] + values.shape[1], column[0] : column[0] + values.shape[2]] += values[0]
    # A sheared mark of equal second moments; it is worst, 14 % of the area, where the path is half as long as the
    # disk is wide. Leaning at its full slope it would be off by 45 %.
    assert np.abs(mask - wanted).sum() / wanted.sum() < 0.15


def test_flakes_fade_along_the_ray() -> None:
    """Two windows of one camera, on the axis and 45 degrees off it: at equal ray length equal contrast of flakes."""
    contrast = []
    for left, slope in ((0.0, 1.0), (400.0, math.sqrt(2))):
        camera = Camera.from_intrinsics(400.0, 400.0, 31.5 - left, 31.5, 64, 64)
        near = 14.9 / slope, 15.1 / slope
        options = {
            "near_m": near[0],
            "far_m": 2 * near[0] + 0.1,
            "depth": near[1],
            "airlight": 0.9,
            "min_listed_coverage": 1e-6,
        }
        black = torch.zeros(1, 64, 64)
        foggy = BayerWeather(Mixture(Snow(10.0), Fog(20.0)), camera, **options)  # type: ignore[arg-type]
        result = foggy.run(black, noise=foggy.draw(black, seed=1))
        behind = 0.9 * (1 - result.transmission)
        mask = result.particle_mask
        light = (result.bayer - (1 - mask) * behind)[mask > 1e-3] / mask[mask > 1e-3]
        contrast.append(float((0.9 - light).mean()) / (0.9 - 0.81))
    assert contrast[1] == pytest.approx(contrast[0], rel=0.02)
