"""Drops on the window that refract, against rays that are followed through a sphere's cap one by one."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch

from tests.camera.effects.camera_effect_scene import camera
from torchweather.atmosphere.weather import Rain
from torchweather.camera.effects.refraction import DROPS, CameraRefractingDrops, refracted
from torchweather.stages import CameraState
from torchweather.transforms import BayerWeather

H, W, N = 240, 320, 1.33


def state_of(picture: torch.Tensor) -> CameraState:
    own = camera().resized(W, H)
    return BayerWeather(Rain(0.0), own, depth=20.0, airlight=0.5).state_of(picture)


def snell(direction: np.ndarray, normal: np.ndarray, before: float, after: float) -> np.ndarray | None:
    """A ray at a surface whose normal points along the ray's way; ``None`` where it is totally reflected."""
    tangential = direction - (direction @ normal) * normal
    tangential = tangential * before / after
    if (square := 1.0 - float(tangential @ tangential)) < 0:
        return None
    out: np.ndarray = tangential + math.sqrt(square) * normal
    return out


@pytest.mark.parametrize("place", [(0.0, 0.0), (0.5, 0.0), (0.1, -0.7), (-0.9, 0.2), (0.0, 0.97)])
@pytest.mark.parametrize("contact_deg", [30.0, 60.0, 90.0])
@pytest.mark.parametrize("ray", [(0.0, 0.0), (0.3, -0.2)])
def test_a_ray_is_bent_as_by_a_cap_of_a_sphere(
    place: tuple[float, float], contact_deg: float, ray: tuple[float, float]
) -> None:
    """The cap of contact angle c on a disk of radius 1 is of a sphere of radius 1 / sin c, centred 1 / tan c inside."""
    direction = np.array([*ray, 1.0]) / math.sqrt(1 + ray[0] ** 2 + ray[1] ** 2)
    window = np.array([0.0, 0.0, 1.0])
    inner = snell(direction, window, 1.0, N)
    assert inner is not None
    contact = math.radians(contact_deg)
    sphere, centre = 1.0 / math.sin(contact), -1.0 / math.tan(contact)
    # The point of the cap over the place: thin drops, in which a ray goes on at its place.
    top = np.array([*place, centre + math.sqrt(sphere**2 - place[0] ** 2 - place[1] ** 2)])
    normal = (top - np.array([0.0, 0.0, centre])) / sphere
    out = snell(inner, normal, N, 1.0)
    (x, y, z), through = refracted(
        tuple(torch.tensor([v], dtype=torch.float64) for v in ray),  # type: ignore[arg-type]
        tuple(torch.tensor([v], dtype=torch.float64) for v in place),  # type: ignore[arg-type]
        torch.tensor(math.sin(contact), dtype=torch.float64),
    )
    if out is None:
        assert float(through) == 0.0
    else:
        assert np.allclose([float(x), float(y), float(z)], out, atol=1e-9)
        assert 0.0 < float(through) <= 0.99


def one_drop(row: float, column: float) -> torch.Tensor:
    """A drop of some size at a place, and all the others behind the frame's corner."""
    drops = torch.full((1, DROPS, 3), 0.999)
    drops[..., 2] = 0.0
    drops[0, 0] = torch.tensor([column / W, row / H, 1.0])
    return drops


def test_the_scene_stands_upside_down_in_a_drop() -> None:
    picture = torch.full((1, H, W), 0.1)
    picture[:, : H // 2] = 0.8
    state = state_of(picture)
    effect = CameraRefractingDrops(cover=0.5, contact_deg=45.0)
    after = effect(state, {"drops": one_drop(H / 2, W / 2)}).image.signal[0, 0]
    radius = math.sqrt(-math.log(0.5) * H * W * 4.0 / (4.0 + DROPS - 1) / math.pi)
    assert radius > 20
    above, below = after[H // 2 - int(radius / 2), W // 2], after[H // 2 + int(radius / 2), W // 2]
    assert float(above) < 0.15
    assert float(below) > 0.7
    assert torch.equal(after[:, : W // 2 - int(radius) - 2], picture[0, :, : W // 2 - int(radius) - 2])


def test_drops_cover_their_share_and_a_wide_aperture_smears_them() -> None:
    picture = torch.zeros(1, H, W) + 0.5
    picture[:, ::2, ::2] = 0.51  # so that the light of a drop differs by its transmittance alone
    state = state_of(picture)
    shares, depths = [], []
    for seed in range(2):
        noise = {"drops": torch.rand(1, DROPS, 3, generator=torch.Generator().manual_seed(seed))}
        sharp = CameraRefractingDrops(cover=0.3, contact_deg=40.0)(state, noise).image.signal
        soft = CameraRefractingDrops(cover=0.3, contact_deg=40.0, blur_px=60.0)(state, noise).image.signal
        shares.append(float((sharp != state.image.signal).float().mean()))
        depths.append([float((state.image.signal - one).clamp_min(0).amax()) for one in (sharp, soft)])
    # Drops that leave the frame at an edge lose a part of their area: radius over size of the frame.
    assert np.mean(shares) == pytest.approx(0.3, abs=0.07)
    assert np.mean([soft for _, soft in depths]) < 0.9 * np.mean([sharp for sharp, _ in depths])


def test_a_mosaic_shows_the_light_of_its_own_colour() -> None:
    """A red scene stays red in the drops: no pixel takes the light of another colour."""
    picture = torch.full((1, H, W), 0.05)
    picture[:, ::2, ::2] = 0.9
    state = state_of(picture)
    noise = {"drops": torch.rand(1, DROPS, 3, generator=torch.Generator().manual_seed(2))}
    after = CameraRefractingDrops(cover=0.4, blur_px=4.0)(state, noise).image.signal[0, 0]
    assert float(after[1::2].max()) < 0.051
    assert float(after[::2, 1::2].max()) < 0.051
