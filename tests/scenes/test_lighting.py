"""Light against numerical integration over the hemisphere."""

from __future__ import annotations

import math

import pytest
import torch
from torch import Tensor

from torchweather.scenes.lighting import DiffuseLight, SlabShade, SphereShade
from torchweather.scenes.materials import MATERIALS, surface_reflectance
from torchweather.scenes.position_noise import value_noise


def sky_directions(steps: int = 400) -> tuple[Tensor, Tensor]:
    """Directions of the upper hemisphere on a midpoint grid, and their solid angles."""
    elevation = (torch.arange(steps, dtype=torch.float64) + 0.5) / steps * math.pi / 2
    azimuth = (torch.arange(2 * steps, dtype=torch.float64) + 0.5) / (2 * steps) * 2 * math.pi
    e, a = torch.meshgrid(elevation, azimuth, indexing="ij")
    direction = torch.stack([e.cos() * a.cos(), e.cos() * a.sin(), e.sin()], -1).reshape(-1, 3)
    return direction, (e.cos() * (math.pi / 2 / steps) * (math.pi / steps)).reshape(-1)


@pytest.mark.parametrize("gradient", [0.0, 2.0])
@pytest.mark.parametrize("tilt_deg", [0.0, 35.0, 90.0, 140.0, 180.0])
def test_irradiance_of_a_tilted_surface_is_the_integral_over_the_sky_it_sees(gradient: float, tilt_deg: float) -> None:
    light = DiffuseLight(zenith_rgb=(1.0, 1.0, 1.0), gradient=gradient, cloud_contrast=0.0)
    tilt = math.radians(tilt_deg)
    normal = torch.tensor([math.sin(tilt), 0.0, math.cos(tilt)], dtype=torch.float64)
    direction, solid_angle = sky_directions()
    seen = (direction @ normal).clamp_min(0)
    integral = (light.sky_radiance(direction)[:, 0] * seen * solid_angle).sum()
    # Midpoint rule with 400 steps: error of some 1e-5 of the level irradiance, 2.4.
    assert float(light.irradiance(normal)[0][0]) == pytest.approx(float(integral), abs=2e-4)


def test_overcast_horizon_has_a_third_of_the_zenith() -> None:
    light = DiffuseLight(zenith_rgb=(0.9, 0.9, 0.9), cloud_contrast=0.0)
    sky = light.sky_radiance(torch.tensor([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]))
    torch.testing.assert_close(sky[0] * 3, sky[1])
    torch.testing.assert_close(sky[0], torch.tensor(light.horizon_rgb))


def test_clouds_leave_the_horizon_alone() -> None:
    direction = torch.tensor([[1.0, 0.3, 0.0], [1.0, -0.4, 0.0]])
    torch.testing.assert_close(
        DiffuseLight().sky_radiance(direction), DiffuseLight(cloud_contrast=0.0).sky_radiance(direction)
    )


@pytest.mark.parametrize("place", [(0.0, 0.0), (0.9, 0.3), (1.8, -0.6)])
def test_slab_hides_the_share_of_the_sky_that_it_covers(place: tuple[float, float]) -> None:
    slab = SlabShade(centre_m=(0.2, 0.1, 0.5), size_m=(2.0, 1.0), yaw_rad=0.4)
    direction, solid_angle = sky_directions(800)
    scaled = direction / direction[:, 2:] * 0.5
    x, y = scaled[:, 0] + place[0] - 0.2, scaled[:, 1] + place[1] - 0.1
    x, y = math.cos(0.4) * x + math.sin(0.4) * y, math.cos(0.4) * y - math.sin(0.4) * x
    covered = (x.abs() < 1.0) & (y.abs() < 0.5)
    share = (direction[:, 2] * solid_angle)[covered].sum() / math.pi
    point = torch.tensor([[*place, 0.0]], dtype=torch.float64)
    # The outline falls between grid points of 2 mrad: 1e-3 of the sky along its edge.
    assert float(slab.hidden_share(point)) == pytest.approx(float(share), abs=2e-3)


def test_ball_hides_the_share_of_the_sky_that_it_covers() -> None:
    ball = SphereShade(centre_m=(1.5, 0.0, 2.0), radius_m=0.8)
    direction, solid_angle = sky_directions(800)
    centre = torch.tensor([1.5, 0.0, 2.0], dtype=torch.float64)
    covered = centre.square().sum() - (direction @ centre) ** 2 < 0.8**2
    covered &= direction @ centre > 0
    share = (direction[:, 2] * solid_angle)[covered].sum() / math.pi
    assert float(ball.hidden_share(torch.zeros(1, 3, dtype=torch.float64))) == pytest.approx(float(share), abs=1e-3)


@pytest.mark.parametrize("name", MATERIALS)
def test_reflectance_stays_physical(name: str) -> None:
    generator = torch.Generator().manual_seed(1)
    point = 50 * torch.rand(500, 3, generator=generator)
    reflectance, emission = surface_reflectance(MATERIALS[name], point, torch.zeros(500))
    assert reflectance.min() >= 0
    assert reflectance.max() <= 1
    assert emission.min() >= 0
    assert emission.max() <= 1


def test_grain_fades_where_a_pixel_covers_many_cells_and_keeps_its_mean() -> None:
    generator = torch.Generator().manual_seed(2)
    point = 40 * torch.rand(20_000, 3, generator=generator)
    near, _ = surface_reflectance(MATERIALS["asphalt"], point, torch.zeros(20_000))
    far, _ = surface_reflectance(MATERIALS["asphalt"], point, torch.full((20_000,), 20.0))
    assert far.std() < 0.2 * near.std()
    # The mean's own error: contrast 0.45 of 0.118 over sqrt(20 000), some 2e-4; the noise of 1.3 m repeats in cells.
    torch.testing.assert_close(near.mean(0), torch.tensor(MATERIALS["asphalt"].rgb), rtol=0.02, atol=0)


def test_value_noise_is_continuous_and_repeatable() -> None:
    x = torch.linspace(0, 5, 5001, dtype=torch.float64)
    line = torch.stack([x, 0.3 * x, -0.7 * x], -1)
    noise = value_noise(line, 1.0, seed=3)
    assert torch.equal(noise, value_noise(line, 1.0, seed=3))
    # Slope of the smooth step is 1.5 a cell at most on each axis: 1.5 * (1 + 0.3 + 0.7) * 1e-3.
    assert noise.diff().abs().max() <= 3.0e-3
    assert 0 <= noise.min() < noise.max() < 1
