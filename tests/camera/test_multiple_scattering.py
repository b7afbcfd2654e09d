"""Forward-scattered light in dense fog: against photons traced one by one, theory, and limits."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch

import torchweather as tw
from tests.reference import fog_photons
from torchweather.atmosphere.forward_scattering import FREQUENCIES_PER_RAD, WIDTHS_RAD, ForwardScattering
from torchweather.camera.fog import ExtinctionAndAirlight
from torchweather.camera.multiple_scattering import forward_scattered, kernel_weights
from torchweather.camera.state import CameraState
from torchweather.core.errors import TorchweatherError
from torchweather.physics import rehearse_fog

GREEN_NM = 550.0


@pytest.fixture(scope="module")
def kernel() -> ForwardScattering:
    return ForwardScattering.of_fog(rehearse_fog(30), GREEN_NM)


@pytest.fixture(scope="module")
def angles():
    return fog_photons.scattering_angles(rehearse_fog(30), GREEN_NM)


@pytest.mark.parametrize("optical_depth", [0.5, 2.0, 5.0])
def test_the_transfer_is_that_of_photons_traced_one_by_one(kernel, angles, optical_depth) -> None:
    photons = 20_000
    ends = fog_photons.ends_on_a_plane(optical_depth, angles, photons, seed=3)
    frequency = np.array([0.5, 1.0, 2.0, 4.0, 8.0, 16.0])
    found = np.nan_to_num(np.cos(2.0 * np.pi * frequency * ends[:, :1])).mean(0)
    theory = kernel.transfer(optical_depth, torch.from_numpy(frequency)).numpy()
    # Three standard errors of the photons; the theory's own error, small angles taken as large as 1 rad, by frequency.
    error = 3.0 * math.sqrt(0.5 / photons)
    assert np.all(np.abs(theory - found) < error + np.array([0.04, 0.015, 0.01, 0.008, 0.008, 0.008]))


def test_without_a_diffraction_peak_the_transfer_of_fine_patterns_is_lower(kernel) -> None:
    smooth = ForwardScattering.henyey_greenstein(0.84)
    assert float(kernel.transfer(2.0, 4.0)) > 1.4 * float(smooth.transfer(2.0, 4.0))
    assert float(smooth.transfer(2.0, 200.0)) == pytest.approx(math.exp(-2.0), rel=0.05)


@pytest.mark.parametrize("optical_depth", [0.1, 1.0, 3.0])
def test_the_gaussians_add_up_to_the_transfer(kernel, optical_depth) -> None:
    weight = kernel.weights(torch.tensor([optical_depth]))[0].numpy()
    bells = np.exp(-2.0 * (np.pi * FREQUENCIES_PER_RAD[:, None] * np.array(WIDTHS_RAD)) ** 2)
    fitted = math.exp(-optical_depth) + bells @ weight
    theory = kernel.transfer(optical_depth, torch.from_numpy(FREQUENCIES_PER_RAD)).numpy()
    assert np.abs(fitted - theory).max() < 0.011
    assert np.all(weight >= 0)


def frame_behind(signal: torch.Tensor, focal_px: float, cfa: torch.Tensor | None = None) -> CameraState:
    height, width = signal.shape[-2:]
    intrinsics = torch.tensor([[focal_px, focal_px, (width - 1) / 2, (height - 1) / 2]])
    return CameraState.of(
        signal=signal,
        depth_m=torch.ones(1, 1, height, width),
        ray_per_depth=torch.ones(1, 1, height, width),
        cfa_index=cfa,
        intrinsics=intrinsics,
    )


@pytest.mark.parametrize("cycles_per_rad", [4.0, 16.0])
@pytest.mark.parametrize("optical_depth", [1.1, 2.0])
@pytest.mark.parametrize("mosaic", [False, True])
def test_a_pattern_keeps_the_contrast_that_the_theory_leaves(cycles_per_rad, optical_depth, mosaic) -> None:
    focal_px, height, width = 300.0, 160, 480
    column = (torch.arange(width) - (width - 1) / 2) / focal_px
    wave = torch.cos(2.0 * math.pi * cycles_per_rad * column)
    pattern = (0.5 + 0.5 * wave).expand(1, 1 if mosaic else 3, height, width).contiguous()
    state = frame_behind(pattern, focal_px, torch.tensor([[0, 1], [1, 2]]) if mosaic else None)
    weights = kernel_weights(tw.Fog(30.0), GREEN_NM, torch.tensor([30.0]))
    through = torch.full_like(pattern, math.exp(-optical_depth))
    added = forward_scattered(state, through, torch.zeros_like(pattern), weights)[0, 0, height // 2]
    middle = slice(width // 4, 3 * width // 4)
    basis = torch.stack([torch.ones(width), wave], 1)[middle]
    mean, contrast = torch.linalg.lstsq(basis, added[middle, None]).solution[:, 0] / 0.5
    kernel = ForwardScattering.of_fog(tw.Fog(30.0).distribution(30.0), GREEN_NM)
    straight = math.exp(-optical_depth)
    assert float(mean) == pytest.approx(math.exp(-optical_depth * (1.0 - kernel.share)) - straight, abs=0.015)
    assert float(contrast) == pytest.approx(float(kernel.transfer(optical_depth, cycles_per_rad)) - straight, abs=0.02)


CAMERA = tw.Camera.from_intrinsics(150.0, 150.0, 95.5, 71.5, 192, 144, height_m=1.5)


def street() -> tuple[torch.Tensor, torch.Tensor]:
    """Radiance ``(144, 192)`` and depth of the scene of `fog_photons.street_radiance`."""
    down = ((torch.arange(144) - 71.5) / 150.0)[:, None].expand(144, 192)
    right = ((torch.arange(192) - 95.5) / 150.0).expand(144, 192)
    depth = torch.where(down > 0, 1.5 / down, torch.inf)
    light = torch.where(down > 0, fog_photons.GROUND, fog_photons.SKY)
    y_m, z_m = -fog_photons.WALL_X_M * right, -fog_photons.WALL_X_M * down
    wall = (y_m.abs() < fog_photons.WALL_HALF_WIDTH_M) & (z_m < fog_photons.WALL_TOP_Z_M) & (depth > 20.0)
    light = torch.where(wall, torch.from_numpy(fog_photons.wall_radiance(y_m.numpy())).float(), light)
    return light, torch.where(wall, fog_photons.WALL_X_M, depth)


def test_a_street_in_fog_of_30_m_looks_as_photons_show_it() -> None:
    light, depth = street()
    fog = tw.Fog(mor_m=30.0)
    alpha = float(ExtinctionAndAirlight(fog, (600.0, GREEN_NM, 450.0)).extinction_per_m(1)[0, 1])
    turn = fog_photons.scattering_angles(fog.distribution(30.0), GREEN_NM)
    airlight = float(fog_photons.street_radiance(np.array([[1.0, 0.0, 0.02]]), alpha, turn, 10_000, 1, wall=False)[0])
    rows, columns = (60, 72, 84, 96, 120), (30, 75, 96, 130)
    direction = np.array([[1.0, -(c - 95.5) / 150.0, -(r - 71.5) / 150.0] for r in rows for c in columns])
    truth = fog_photons.street_radiance(direction, alpha, turn, 1500, 2).reshape(len(rows), len(columns))
    error = {}
    for scattering in ("single", "multiple"):
        fog_stage = tw.BayerFog(fog, CAMERA, airlight=airlight, scattering=scattering, layer_top_m=61.5)
        frame = fog_stage(light[None], depth[None])[0].numpy()
        error[scattering] = frame[np.ix_(rows, columns)] - truth
    # A path ends on 0.05 to 1: 0.01 standard error of 1500 paths. Walls are thin shells of depth in the model.
    rms = {scattering: math.sqrt((one**2).mean()) for scattering, one in error.items()}
    assert rms["multiple"] < 0.4 * rms["single"]
    # The road: single scattering puts the airlight of an open sky where paths end on dark asphalt.
    assert np.abs(error["multiple"][2:].mean()) < 0.25 * error["single"][2:].mean()


def test_a_scene_as_bright_as_the_airlight_stays_so() -> None:
    _, depth = street()
    fog = tw.BayerFog(tw.Fog(mor_m=20.0), CAMERA, airlight=0.6, scattering="multiple")
    torch.testing.assert_close(fog(torch.full((1, 144, 192), 0.6), depth[None]), torch.full((1, 144, 192), 0.6))


def test_no_fog_is_the_input_bit_for_bit_beside_a_foggy_sample() -> None:
    light, depth = street()
    frames = torch.stack([light, light])[:, None]
    fog = tw.BayerFog(tw.Fog(mor_m=torch.tensor([math.inf, 25.0])), CAMERA, airlight=0.6, scattering="multiple")
    found = fog(frames, depth.expand(2, 1, 144, 192))
    assert torch.equal(found[0], frames[0])
    assert not torch.equal(found[1], frames[1])
    clear = tw.BayerFog(tw.Fog(), CAMERA, airlight=0.6, scattering="multiple")
    eight = (light * 255).round().to(torch.uint8)[None]
    assert torch.equal(clear(eight, depth[None]), eight)


def test_a_bright_sign_lightens_the_dark_around_it_and_not_the_bonnet() -> None:
    light = torch.zeros(1, 144, 192)
    light[0, 60:80, 86:106] = 1.0
    depth = torch.full((1, 144, 192), 20.0)
    depth[0, 120:] = 0.05  # next to the camera: hardly any fog in front of it
    fog = tw.BayerFog(tw.Fog(mor_m=30.0), CAMERA, airlight=0.0, scattering="multiple")
    found = fog(light, depth)[0]
    assert float(found[90, 96]) > float(found[110, 96]) > 0.001
    assert float(found[125:, 90:100].max()) < 0.0005


def test_it_has_a_gradient_in_the_visibility() -> None:
    light, depth = street()
    mor_m = torch.tensor(30.0, requires_grad=True)
    fog = tw.BayerFog(tw.Fog(mor_m=mor_m), CAMERA, airlight=0.3, scattering="multiple")
    fog(light[None], depth[None])[0, 96:, :].mean().backward()
    assert mor_m.grad is not None
    assert float(mor_m.grad) < 0  # the road darkens as the fog thins


def test_an_unknown_kind_of_scattering_is_refused() -> None:
    with pytest.raises(TorchweatherError, match="scattering"):
        tw.BayerFog(tw.Fog(mor_m=30.0), CAMERA, scattering="double")
