"""Shrinking by averages about every n-th pixel."""

from __future__ import annotations

import pytest
import torch

from torchweather.metrics.filters import subsampled


@pytest.mark.parametrize("factor", [1, 2, 3, 4])
@pytest.mark.parametrize("width", [12, 13, 14])
def test_means_about_every_nth_pixel(factor: int, width: int) -> None:
    image = torch.rand(2, 3, 11, width, dtype=torch.float64, generator=torch.Generator().manual_seed(7))
    found = subsampled(image, factor)
    assert found.shape == (2, 3, -(-11 // factor), -(-width // factor))
    for row in range(found.shape[2]):
        for column in range(found.shape[3]):
            top, left = (place * factor - (factor - 1) // 2 for place in (row, column))
            window = image[..., max(top, 0) : top + factor, max(left, 0) : left + factor]
            torch.testing.assert_close(found[..., row, column], window.sum((2, 3)) / factor**2)
