"""Display values of pictures: linear in light inside, as they came where nothing changed, refused outside 0..1."""

from __future__ import annotations

import math
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext

import pytest
import torch

from tests.fake_trace import as_exported
from torchweather.camera.rgb_planes import check_rgb_values, linear_planes
from torchweather.camera.through_mosaic import image_of_mosaic, mosaic_of_image
from torchweather.sensors import Camera


def srgb_to_linear(display: float) -> float:
    """IEC 61966-2-1."""
    return display / 12.92 if display <= 0.04045 else ((display + 0.055) / 1.055) ** 2.4


@pytest.mark.parametrize("within", [nullcontext, as_exported])
@pytest.mark.parametrize("dtype", [torch.uint8, torch.uint16, torch.float32, torch.float64])
def test_planes_are_linear_in_light(dtype: torch.dtype, within: Callable[[], AbstractContextManager[None]]) -> None:
    full = float(torch.iinfo(dtype).max) if not dtype.is_floating_point else 1.0
    display = (0.0, 0.02, 0.2, 0.5, 1.0)
    stored = torch.tensor([value * full for value in display], dtype=torch.float64)
    rgb = (stored if dtype.is_floating_point else stored.round()).to(dtype).expand(3, 1, -1)
    wanted = [srgb_to_linear(float(value) / full) for value in rgb[0, 0]]
    with within():
        found = linear_planes(rgb)
    assert found[1, 0].tolist() == pytest.approx(wanted, abs=1e-6)


@pytest.mark.parametrize("value", [-0.01, 1.01, 255.0, math.nan])
def test_float_pictures_outside_0_to_1_are_refused(value: float) -> None:
    rgb = torch.full((3, 4, 4), 0.5)
    check_rgb_values(rgb, "x")
    rgb[0, 0, 0] = value
    with pytest.raises(ValueError, match=r"x: float images must lie in 0\.\.1"):
        check_rgb_values(rgb, "x")


@pytest.mark.parametrize("dtype", [torch.uint8, torch.float32])
def test_a_picture_whose_mosaic_did_not_change_comes_back_bit_for_bit(dtype: torch.dtype) -> None:
    rgb = torch.rand(2, 3, 16, 20, generator=torch.Generator().manual_seed(1))
    rgb = (rgb * 255).to(dtype) if dtype == torch.uint8 else rgb
    camera = Camera.from_intrinsics(20.0, 20.0, 9.5, 7.5, 20, 16)
    before = mosaic_of_image(rgb, camera)
    after = before.clone()
    after[1] *= 0.5
    found = image_of_mosaic(before, after, rgb, camera, "malvar")
    assert torch.equal(found[0], rgb[0])
    assert not torch.equal(found[1], rgb[1])
