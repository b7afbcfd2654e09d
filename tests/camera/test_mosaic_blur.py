"""Blur of a mosaic: the dense products against convolutions with the edges held."""

from __future__ import annotations

import pytest
import torch
from kornia.filters import filter2d_separable

from torchweather.camera.mosaic_blur import _gaussian, gaussian_blur


@pytest.mark.parametrize("variance_px2", [1.0, 12.0, 192.0, 768.0])
@pytest.mark.parametrize("size", [(5, 4), (31, 60), (48, 130)])
def test_a_blur_by_products_with_parts_of_its_band_matrix_is_the_convolution(
    variance_px2: float, size: tuple[int, int]
) -> None:
    planes = torch.rand(2, 4, *size, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    weights = torch.tensor([_gaussian(variance_px2 / 2**2)], dtype=planes.dtype)  # of each colour's own pixels
    convolved = filter2d_separable(planes, weights, weights, "replicate")
    torch.testing.assert_close(gaussian_blur(planes, variance_px2), convolved, rtol=0, atol=1e-12)
