"""Which images contradict the data range that they are declared to have, and which are only dark."""

from __future__ import annotations

import math

import pytest
import torch
from torch import Tensor

from torchweather.metrics.psnr import psnr


def grain(top: float, dtype: torch.dtype = torch.float32) -> Tensor:
    """Values up to ``top``, which one pixel has."""
    values = torch.rand(3, 8, 8, generator=torch.Generator().manual_seed(1)).to(dtype)
    values[0, 0, 0] = 1.0
    return top * values


# Recordings in 0..255, bright and dark.
BRIGHT = grain(255.0)
DARK = {
    "black": torch.zeros(3, 8, 8),
    "black but for rounding": grain(1e-6),
    "a grey step in few pixels": (grain(1.0) > 0.98).float(),
    "a dark grey": torch.ones(3, 8, 8),
    "fractions of up to two grey steps": grain(2.0),
}


@pytest.mark.parametrize("kind", list(DARK))
def test_dark_images_are_scored(kind: str) -> None:
    dark = DARK[kind]
    for pair in ((dark, BRIGHT), (BRIGHT, dark), (torch.stack((dark, BRIGHT)), torch.stack((BRIGHT, dark)))):
        found = psnr(*pair, data_range=255.0)
        error = (pair[0].double() - pair[1].double()).square().mean((-3, -2, -1))
        wanted = 10.0 * (255.0**2 / error).log10()
        torch.testing.assert_close(found.double(), wanted, rtol=1e-5, atol=0.0)
    assert float(psnr(dark, dark, data_range=255.0)) == math.inf


@pytest.mark.parametrize("data_range", [100.0, 255.0, 4095.0, 65535.0])
@pytest.mark.parametrize("top", [1.0, 0.1, 0.01])
def test_an_image_in_0_to_1_is_refused_on_either_side(data_range: float, top: float) -> None:
    bright, small = grain(data_range), grain(top)
    for pair, which in (((small, bright), "distorted"), ((bright, small), "reference")):
        with pytest.raises(ValueError, match=rf"no value is above {top:g} in image 0 of {which}: images in \[0, 1\]"):
            psnr(*pair, data_range=data_range)
    # The way that the message names.
    assert math.isfinite(float(psnr(small / data_range, bright / data_range)))


def test_images_of_small_ranges_may_stay_below_1() -> None:
    small = grain(0.9)
    assert float(psnr(0.5 * small, small, data_range=2.0)) == pytest.approx(
        float(psnr(0.25 * small, 0.5 * small)), rel=1e-6
    )


def test_images_of_8_bits_are_refused_as_16_bits_unless_they_are_dark() -> None:
    for top in (255.0, 200.0, 20.0):
        for change in (torch.round, torch.clone):
            eight = change(grain(top))
            with pytest.raises(ValueError, match=rf"data_range is 65535, but no value is above {top:g}: .* 8 bits"):
                psnr(0.5 * eight, eight, data_range=65535.0)
            bright = grain(65535.0)
            assert math.isfinite(float(psnr(eight, bright, data_range=65535.0)))
            whole = eight.to(torch.uint16)
            assert math.isfinite(float(psnr(bright.to(torch.int32), whole, data_range=65535)))
            assert float(psnr(whole, whole, data_range=65535)) == math.inf
            assert math.isfinite(float(psnr(0.5 * eight, whole, data_range=65535)))  # the type says 16 bits
    for top, white in ((15.0, 65535.0), (255.0, 4095.0)):
        assert float(psnr(grain(top), grain(top), data_range=white)) == math.inf


@pytest.mark.parametrize("dtype", [torch.uint8, torch.uint16, torch.int64])
def test_dark_whole_numbers_are_taken_at_their_word(dtype: torch.dtype) -> None:
    dark = (grain(1.0) > 0.5).to(dtype)
    assert float(psnr(dark, dark, data_range=255)) == math.inf
    share = float(dark.double().mean())
    found = float(psnr(torch.zeros_like(dark), dark, data_range=255))  # a share of the pixels is 1 off
    assert found == pytest.approx(10.0 * math.log10(255.0**2 / share), rel=1e-5)
