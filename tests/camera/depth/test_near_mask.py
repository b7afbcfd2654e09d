"""Own bonnet: found where a smooth edge crosses the picture's lower end, and never on a plain road."""

from __future__ import annotations

import math

import pytest
import torch
from torch import Tensor

from tests.camera.depth.street_corridor import corridor, leaves
from torchweather.camera.depth.near_mask import find_near_mask
from torchweather.sensors import Camera

CAMERA = Camera.from_intrinsics(fx=480.0, fy=480.0, cx=319.5, cy=160.0, width=640, height=360, height_m=1.3)


def road(seed: int = 0) -> Tensor:
    """A street with the noise of a camera, ``(3, 360, 640)``."""
    picture, _, _ = corridor(CAMERA, half_width_m=(9.0, 9.0))
    noise = torch.randn(picture.shape, generator=torch.Generator().manual_seed(seed))
    return (picture + 0.02 * noise).clamp(0.0, 1.0)


def bonnet_row(arch_px: float, wave_px: float) -> Tensor:
    """Row of a bonnet's edge in every column: an arch, with the wings' waves."""
    x = torch.linspace(-1.0, 1.0, 640)
    return 332.0 + arch_px * x.square() + wave_px * torch.cos(3.0 * math.pi * x)


def with_bonnet(picture: Tensor, row: Tensor, colour: tuple[float, float, float]) -> Tensor:
    below = torch.arange(360.0)[:, None] >= row
    paint = torch.tensor(colour)[:, None, None] + 0.15 * (leaves(360, 640, seed=5) - 0.5)
    return torch.where(below, paint, picture)


@pytest.mark.parametrize("shape", [(0.0, 0.0), (14.0, 0.0), (10.0, 1.5)])
@pytest.mark.parametrize("colour", [(0.15, 0.15, 0.16), (0.55, 0.2, 0.15), (0.75, 0.75, 0.78)])
def test_a_bonnet_is_found_within_two_rows(shape: tuple[float, float], colour: tuple[float, float, float]) -> None:
    row = bonnet_row(*shape)
    mask = find_near_mask(with_bonnet(road(), row, colour))
    assert mask.shape == (1, 360, 640)
    edge = 360.0 - mask[0].sum(0)
    assert float((edge - row).abs().median()) < 2.0
    assert float((edge - row).abs().quantile(0.95)) < 5.0
    assert float(mask[0, :300].max()) == 0.0
    assert float(mask[0, -1].min()) == 1.0


@pytest.mark.parametrize("seed", range(3))
def test_a_road_without_a_bonnet_has_no_mask(seed: int) -> None:
    assert not find_near_mask(road(seed)).any()


@pytest.mark.parametrize("case", ["shadow", "step", "zigzag", "slope", "plain"])
def test_what_is_no_bonnet_is_not_taken_for_one(case: str) -> None:
    picture = road()
    if case == "shadow":  # over 60 % of the width
        picture[:, 335:, :390] *= 0.4
    elif case == "step":  # a kerb: half a picture's width at one row, the other half 20 rows lower
        picture[:, 330:, :320] *= 0.4
        picture[:, 350:, 320:] *= 0.4
    elif case == "zigzag":
        row = 335.0 + 8.0 * (torch.arange(640) // 16 % 2)
        picture = torch.where(torch.arange(360.0)[:, None] >= row, 0.4 * picture, picture)
    elif case == "slope":  # the foot of a wall, which rises to one side
        row = torch.linspace(310.0, 352.0, 640)
        picture = torch.where(torch.arange(360.0)[:, None] >= row, 0.4 * picture, picture)
    else:
        picture = torch.full((3, 360, 640), 0.3)
    assert not find_near_mask(picture).any()


@pytest.mark.parametrize("seed", range(5))
def test_texture_that_has_steps_everywhere_is_no_bonnet(seed: int) -> None:
    assert not find_near_mask(leaves(360, 640, seed=seed)).any()


def test_bytes_and_floats_and_grey_pictures_give_the_same_mask() -> None:
    picture = with_bonnet(road(), bonnet_row(10.0, 0.0), (0.15, 0.15, 0.16))
    mask = find_near_mask(picture)
    in_bytes = find_near_mask((255 * picture).round().to(torch.uint8))
    assert float((mask - in_bytes).abs().mean()) < 1e-3
    assert float((mask - find_near_mask(picture.mean(0, keepdim=True))).abs().mean()) < 5e-3


def test_several_pictures_of_one_camera_share_a_mask_that_a_shadow_does_not_move() -> None:
    row = bonnet_row(10.0, 0.0)
    pictures = [with_bonnet(road(seed), row, (0.55, 0.2, 0.15)) for seed in range(3)]
    pictures[1][:, 326:334, 150:450] = 0.02  # a shadow that touches the bonnet
    mask = find_near_mask(torch.stack(pictures))
    assert mask.shape == (1, 360, 640)
    assert float((360.0 - find_near_mask(pictures[1])[0].sum(0) - row).abs().max()) > 3.0
    assert float((360.0 - mask[0].sum(0) - row).abs().max()) < 3.0


@pytest.mark.parametrize("shape", [(3, 8, 200), (3, 100, 10), (3, 1, 1)])
def test_a_picture_too_small_to_judge_has_no_mask(shape: tuple[int, int, int]) -> None:
    mask = find_near_mask(torch.rand(shape, generator=torch.Generator().manual_seed(0)))
    assert mask.shape == (1, *shape[1:])
    assert not mask.any()


def test_a_wrong_shape_is_refused() -> None:
    with pytest.raises(ValueError, match="find_near_mask: expected a picture"):
        find_near_mask(torch.zeros(4, 20, 20))
