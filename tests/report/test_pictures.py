from __future__ import annotations

import pytest
import torch

from torchweather.image import mosaic, srgb_encode
from torchweather.report.pictures import liveliest_window, look_of, shrunk, tinted_raw
from torchweather.sensors import Camera

CAMERA = Camera.from_intrinsics(30.0, 30.0, 15.5, 11.5, 32, 24)


def test_sky_of_the_clear_frame_becomes_grey() -> None:
    sky = torch.tensor([0.2, 0.4, 0.5])[:, None, None].expand(3, 24, 32)
    ground = torch.tensor([0.05, 0.1, 0.02])[:, None, None].expand(3, 24, 32)
    up = torch.arange(24)[:, None].expand(24, 32) < 12
    linear = mosaic(torch.where(up, sky, ground), "RGGB")
    depth = torch.where(up, torch.inf, 10.0)[None]
    look = look_of(linear, depth, CAMERA)
    seen = look.develop(linear, "RGGB")[:, 3, 5]
    assert look.gains == pytest.approx((2.0, 1.0, 0.8))
    assert float(seen.max() - seen.min()) < 1e-3


def test_frames_of_one_look_keep_their_order_of_brightness() -> None:
    linear = torch.full((1, 24, 32), 0.3)
    look = look_of(linear, torch.full((1, 24, 32), torch.inf), CAMERA)
    clear, brighter = look.develop(linear, "RGGB").mean(), look.develop(1.2 * linear, "RGGB").mean()
    assert clear < brighter


def test_shrinking_averages_light_and_not_display_values() -> None:
    half_lit = torch.tensor([[0.0, 1.0], [1.0, 0.0]]).expand(3, 2, 2)
    assert torch.allclose(shrunk(half_lit, 1), srgb_encode(torch.full((3, 1, 1), 0.5)))


@pytest.mark.parametrize(("pattern", "strongest"), [("RGGB", 0), ("BGGR", 2), ("GRBG", 1)])
def test_raw_pixels_show_their_own_filter(pattern: str, strongest: int) -> None:
    tint = tinted_raw(torch.full((1, 4, 4), 0.5), pattern, 1.0)
    assert int(tint[:, 0, 0].argmax()) == strongest


def test_close_up_lies_where_the_streaks_are() -> None:
    mask = torch.zeros(1, 120, 160)
    mask[:, 80:100, 100:140:4] = 0.3
    before = torch.full((3, 120, 160), 0.2)
    top, left, height, width = liveliest_window(
        before, before + 0.5 * mask, mask, torch.full((1, 120, 160), 9.0), 40, 60
    )
    assert (height, width) == (40, 60)
    assert top <= 80
    assert top + height >= 100
    assert left <= 110
    assert left + width >= 130
