"""Blur of a mosaic: the dense products against convolutions with the edges held."""

from __future__ import annotations

import pytest
import torch

from torchweather.stages import mosaic_blur
from torchweather.stages.mosaic_blur import _convolved, gaussian_blur


@pytest.mark.parametrize("variance_px2", [1.0, 12.0, 192.0, 768.0])
@pytest.mark.parametrize("size", [(5, 4), (31, 60)])
def test_a_blur_by_dense_products_is_the_convolution(variance_px2: float, size: tuple[int, int]) -> None:
    planes = torch.rand(2, 4, *size, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    torch.testing.assert_close(
        gaussian_blur(planes, variance_px2), _convolved(planes, variance_px2), rtol=0, atol=1e-12
    )


def test_planes_much_wider_than_the_kernel_are_convolved(monkeypatch: pytest.MonkeyPatch) -> None:
    planes = torch.rand(1, 4, 2, 400, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    dense = gaussian_blur(planes, 16.0)
    monkeypatch.setattr(mosaic_blur, "DENSE", 1)
    assert not torch.equal(gaussian_blur(planes, 16.0), dense)  # another order of the same sums
    torch.testing.assert_close(gaussian_blur(planes, 16.0), dense, rtol=0, atol=1e-12)
