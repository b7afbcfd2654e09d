"""What water mirrors from above the picture: means of its upper part, against loops over pixels."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from torch import Tensor

from tests.camera.effects.camera_effect_scene import H, W, begin, camera, rain_in_fog
from torchweather.camera.effects.air import CameraWetSurface
from torchweather.camera.effects.mirrored import seen_along
from torchweather.camera.state import CameraState


def state_of(picture: Tensor, mosaic: bool) -> CameraState:
    """A state that shows a picture, as a mosaic or as one plane."""
    state = begin(rain_in_fog(), batch=1, dtype=torch.float64).changed(signal=picture[None, None])
    return state if mosaic else state.changed(cfa_index=None)


def toward(row: Tensor, column: Tensor) -> Tensor:
    """Directions in the camera's frame that meet the image plane there, ``(1, 3, H, W)``."""
    own = camera()
    return torch.stack([(column - own.cx) / own.fx, (row - own.cy) / own.fy, torch.ones_like(row)])[None]


def box_mean(picture: np.ndarray, column: int, beyond: int) -> float:
    """Mean within `beyond` rows below the upper edge and `beyond` columns to each side, of those that there are."""
    values = [
        picture[row, aside]
        for row in range(min(beyond + 1, picture.shape[0]))
        for aside in range(column - beyond, column + beyond + 1)
        if 0 <= aside < picture.shape[1]
    ]
    return float(np.mean(values))


@pytest.mark.parametrize("beyond", [0, 1, 3, 7, 15])
@pytest.mark.parametrize("mosaic", [False, True])
def test_above_the_picture_stands_the_mean_of_its_upper_part(beyond: int, mosaic: bool) -> None:
    picture = torch.rand(H, W, dtype=torch.float64, generator=torch.Generator().manual_seed(1))
    down, aside = torch.meshgrid(torch.arange(H).double(), torch.arange(W).double(), indexing="ij")
    step = 2 if mosaic else 1  # a mosaic's phases are pictures of half the size
    row = down % step - step * beyond
    found = seen_along(state_of(picture, mosaic), toward(row, aside))[0, 0]
    for v, u in ((0, 0), (1, 1), (4, 23), (7, W - 1)):
        plane = picture.numpy()[v % step :: step, u % step :: step]
        assert float(found[v, u]) == pytest.approx(box_mean(plane, u // step, beyond), rel=1e-6), (v, u)


@pytest.mark.parametrize("mosaic", [False, True])
def test_a_lamp_is_mirrored_where_a_ray_meets_it_alone(mosaic: bool) -> None:
    picture, lamps = torch.full((H, W), 0.1, dtype=torch.float64), torch.zeros(1, 1, H, W, dtype=torch.float64)
    lamps[..., 2:4, 10:12] = 1e4
    down, aside = torch.meshgrid(torch.arange(H).double(), torch.arange(W).double(), indexing="ij")
    state = state_of(picture, mosaic)
    assert float(seen_along(state, toward(down, aside), lamps)[0, 0, 3, 11]) == pytest.approx(1e4 + 0.1)
    above = seen_along(state, toward(-1.0 - 2.0 * down, aside), lamps)
    torch.testing.assert_close(above, torch.full_like(above, 0.1))


def test_rays_above_the_picture_show_no_bands() -> None:
    """Columns of random brightness: their spread falls with the box's width, and joins the edge without a step."""
    shades = torch.rand(W, dtype=torch.float64, generator=torch.Generator().manual_seed(2))
    state = state_of(shades.expand(H, W).clone(), mosaic=False)
    down, aside = torch.meshgrid(torch.arange(H).double(), torch.arange(W).double(), indexing="ij")
    found = seen_along(state, toward(-down, aside))[0, 0]
    torch.testing.assert_close(found[0], shades)
    just = seen_along(state, toward(torch.full((H, W), -1e-6).double(), aside))[0, 0, 0]
    torch.testing.assert_close(just, shades, rtol=0, atol=1e-5)
    middle = slice(8, W - 8)
    # The mean of 2 d + 1 independent columns has a deviation of 1 / sqrt(2 d + 1) of theirs.
    assert float(found[7, middle].std() / shades[middle].std()) < 1.6 / 15**0.5


def test_water_on_a_guessed_ground_mirrors_as_level() -> None:
    """A pixel whose normal points aside would mirror another place: the guess's ground is flat."""
    state = begin(rain_in_fog(), batch=1, dtype=torch.float64)
    normal = torch.zeros(1, 3, H, W, dtype=torch.float64)
    normal[:, 2] = 1.0
    shades = torch.rand(H, W, dtype=torch.float64, generator=torch.Generator().manual_seed(3))
    ground = torch.ones(1, 1, H, W, dtype=torch.float64)
    state = state.changed(signal=shades[None, None], normal=normal, ground=ground, cfa_index=None)
    wet = CameraWetSurface(darkening=0.0, mirror=1.0)
    level = wet(state, {}).image.signal
    tilted = normal.clone()
    tilted[0, :, 5, 7] = torch.tensor([0.8, 0.0, 0.6], dtype=torch.float64)
    at_edge = wet(state.changed(normal=tilted), {}).image.signal
    own, mirrored = shades[5, 7], level[0, 0, 5, 7]
    # 0.6 of the mirror's share is left where the normal is 0.6 upright; its direction is that of the level ground.
    assert float(at_edge[0, 0, 5, 7]) == pytest.approx(float(own + 0.6 * (mirrored - own)), rel=1e-6)
    found = wet(state.changed(normal=tilted, ground=None), {}).image.signal[0, 0, 5, 7]
    assert abs(float(found - at_edge[0, 0, 5, 7])) > 1e-3  # a measured slope mirrors its own direction
