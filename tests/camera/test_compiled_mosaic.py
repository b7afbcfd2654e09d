"""Mosaics to sRGB levels in bands: those of the whole colour image, by torch and by compiled loops."""

from __future__ import annotations

import pytest
import torch

from torchweather.camera.bayer import PATTERNS
from torchweather.camera.demosaic import demosaic
from torchweather.camera.srgb_bytes import bytes_of_light
from torchweather.camera.through_mosaic import _levels
from torchweather.core.compiled import SWITCH

# Sums of nine numbers in another order, 3e-7 at most beside levels of 3e-4 or more in linear light: one of a thousand
# samples or fewer lies that near to a limit between two levels.
ROUNDED_SHARE = 1e-3


def mosaics(*shape: int) -> torch.Tensor:
    return 1.1 * torch.rand(*shape, generator=torch.Generator().manual_seed(sum(shape))) - 0.05


@pytest.mark.parametrize("pattern", list(PATTERNS))
@pytest.mark.parametrize("shape", [(1, 4, 4), (2, 1, 6, 70), (1, 134, 48)])
def test_levels_are_those_of_the_whole_image(
    shape: tuple[int, ...], pattern: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    bayer = mosaics(*shape)
    whole = bytes_of_light(demosaic(bayer, pattern))
    monkeypatch.setenv(SWITCH, "0")
    assert torch.equal(_levels(bayer, pattern, "malvar"), whole)
    monkeypatch.setenv(SWITCH, "1")
    steps = (_levels(bayer, pattern, "malvar").int() - whole.int()).abs()
    assert int(steps.max()) <= 1
    assert float((steps > 0).float().mean()) <= ROUNDED_SHARE


def test_threads_leave_every_bit(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(SWITCH, "1")
    bayer, before = mosaics(2, 1, 62, 30), torch.get_num_threads()
    try:
        torch.set_num_threads(1)
        one = _levels(bayer, "GRBG", "malvar")
        torch.set_num_threads(3)
        assert torch.equal(_levels(bayer, "GRBG", "malvar"), one)
    finally:
        torch.set_num_threads(before)
    assert torch.equal(_levels(bayer[1], "GRBG", "malvar"), one[1])
