"""Light on a flake (PHYSICS.md 10.2) against the mean radiance over the sphere, summed direction by direction."""

from __future__ import annotations

import math

import pytest
import torch
from torch import Tensor

from torchweather.atmosphere.weather import Snow
from torchweather.camera.flake_light import _gradient_of_graph, flake_light, sky_gradient
from torchweather.camera.state import CameraState
from torchweather.core.compiled import SWITCH
from torchweather.sensors import Camera
from torchweather.transforms import AsBayer, BayerSnow

HEIGHT, WIDTH = 128, 192
HORIZON, GROUND = 0.3, 0.06


def camera() -> Camera:
    """A wide one that looks level: elevations of -33 to 33 degrees."""
    return Camera.from_intrinsics(100.0, 100.0, 95.5, 63.5, WIDTH, HEIGHT, height_m=1.5, lens_blur_px=0.0)


def frame(gradient: float, ground: float = GROUND) -> tuple[Tensor, Tensor]:
    """Linear planes ``(1, 3, H, W)`` of sky over ground, and their depth; the sky is ``0.3 (1 + g sin e)``."""
    rays = camera().ray_directions()
    sine = -rays[1] / rays.norm(dim=0)
    light = torch.where(sine > 0, HORIZON * (1 + gradient * sine), ground)
    depth = torch.where(sine > 0, math.inf, 1.5 / (-sine).clamp_min(1e-3))
    return light.expand(1, 3, -1, -1).clone(), depth[None, None]


def state_of(light: Tensor, depth: Tensor) -> CameraState:
    inner = BayerSnow(Snow(1.0), camera(), depth=10.0)
    return inner.planes_state(light, inner.scene_of(light, depth), (1,))


def over_the_sphere(gradient: float, ground: float) -> float:
    """Mean radiance of all directions: sines of the elevation are uniform over the sphere."""
    sine = (torch.arange(200_000, dtype=torch.float64) + 0.5) / 100_000 - 1
    return float(torch.where(sine > 0, HORIZON * (1 + gradient * sine), ground).mean())


@pytest.mark.parametrize("gradient", [0.0, 0.7, 2.0])
@pytest.mark.parametrize("ground", [0.03, 0.3])
def test_a_flake_shows_the_mean_over_the_sphere(gradient: float, ground: float) -> None:
    light, depth = frame(gradient, ground)
    found = flake_light(state_of(light, depth), torch.full((1, 3), HORIZON))
    # Sky seen up to 33 degrees, every fourth row and sixteenth column: exact for a straight line in the sine.
    torch.testing.assert_close(found, torch.full((1, 3), over_the_sphere(gradient, ground)), rtol=1e-3, atol=0)


def test_a_snow_covered_ground_under_an_even_sky_gives_the_skys_own_light() -> None:
    light, depth = frame(0.0, HORIZON)
    found = flake_light(state_of(light, depth), torch.full((1, 3), HORIZON))
    torch.testing.assert_close(found, torch.full((1, 3), HORIZON), rtol=1e-5, atol=0)


def test_a_clear_sky_that_darkens_upwards_counts_as_even() -> None:
    assert float(sky_gradient(state_of(*frame(-0.5)))) == 0.0


def test_cells_of_a_mosaic_that_are_sky_in_part_show_no_gradient() -> None:
    """Roofs whose edges cross the cells, dark before an even sky: cells that both share are neither."""
    light, depth = frame(0.0)
    roofs = (torch.arange(HEIGHT)[:, None] + (torch.arange(WIDTH) // 3) % 9) > 57
    light, depth = torch.where(roofs, 0.02, light), torch.where(roofs & depth.isinf(), 30.0, depth)
    for sky in (None, (~roofs).float()[None, None]):
        scene = {} if sky is None else {"sky": sky}
        state = BayerSnow(Snow(1.0), camera()).state_of(light[:, :1], depth).changed(**scene)
        assert float(sky_gradient(state)) == pytest.approx(0.0, abs=1e-5)  # with such cells 0.06
        sine = state.scene.sine_elevation
        assert sine is not None
        seen = state.changed(signal=state.image.signal * torch.where(roofs, 1.0, 1.0 + 0.7 * sine))
        assert float(sky_gradient(seen)) == pytest.approx(0.7, rel=1e-3)
        # An exported graph reads the same cells at once.
        assert float(_gradient_of_graph(state, sine)) == pytest.approx(0.0, abs=1e-5)
        assert float(_gradient_of_graph(seen, sine)) == pytest.approx(0.7, rel=1e-3)


def test_without_ground_in_the_frame_asphalt_stands_in() -> None:
    light, depth = frame(0.0)
    up = CameraState.of(**{name: state_of(light, depth).field(name) for name in ("signal", "depth_m", "intrinsics")},
                        ray_per_depth=torch.ones_like(depth), cfa_index=None)  # fmt: skip
    found = flake_light(up, torch.full((1, 3), HORIZON))
    torch.testing.assert_close(found, torch.full((1, 3), HORIZON * (1 + 0.1) / 2), rtol=1e-5, atol=0)


def test_the_own_vehicle_is_no_ground() -> None:
    light, depth = frame(0.0)
    before = state_of(light.clone(), depth)
    bonnet = torch.zeros_like(depth)
    bonnet[..., 100:, :] = 1.0
    light[..., 100:, :] = 0.9
    found = flake_light(state_of(light, depth).changed(near_mask=bonnet), torch.full((1, 3), HORIZON))
    torch.testing.assert_close(found, flake_light(before, torch.full((1, 3), HORIZON)), rtol=1e-3, atol=0)


def test_flakes_before_asphalt_are_half_as_bright_as_the_horizon() -> None:
    """The published albedo times horizon was 1.8 times too bright here: it forgets that the lower half is dark."""
    light, depth = frame(0.0, 0.1 * HORIZON)
    snow = AsBayer(BayerSnow(Snow(3.0, albedo=1.0), camera(), airlight=(HORIZON,) * 3))
    encoded = torch.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)[0]
    result = snow.run(encoded, depth[0], seed=3)
    linear = torch.where(result.rgb <= 0.04045, result.rgb / 12.92, ((result.rgb + 0.055) / 1.055) ** 2.4)
    mask = result.particle_mask[0, 70:]
    before, after = light[0, 1, 70:], linear[1, 70:]
    colour = ((after - before) * mask).sum() / mask.square().sum() + 0.1 * HORIZON  # least squares of (C - I) M
    assert float(colour) == pytest.approx(0.55 * HORIZON, rel=0.01)


@pytest.mark.parametrize("masks", [(), ("sky",), ("near_mask",), ("sky", "near_mask")])
def test_compiled_loops_find_the_ground_of_torch(masks: tuple[str, ...], monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("numba")
    generator = torch.Generator().manual_seed(7)
    light = torch.rand(2, 3, HEIGHT, WIDTH, generator=generator)
    depth = frame(0.0)[1]
    state = state_of(light, depth).changed(**{name: torch.rand(depth.shape, generator=generator) for name in masks})
    found = []
    for chosen in "10":
        monkeypatch.setenv(SWITCH, chosen)
        found.append(flake_light(state, torch.full((2, 3), HORIZON)))
    # Both add up in single precision, by columns and by pairs: 2e-7 a step of at most 128 rows, on average far less.
    torch.testing.assert_close(found[0], found[1], rtol=2e-6, atol=0)
