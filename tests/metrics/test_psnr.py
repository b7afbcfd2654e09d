"""PSNR against the oracle, which caps it at 80 dB."""

from __future__ import annotations

import math

import pytest
import torch

from tests.metrics.iqa import Case, cases
from torchweather.metrics.psnr import psnr


@pytest.mark.parametrize("case", list(cases("psnr")), ids=lambda case: case.name)
def test_oracle(case: Case) -> None:
    found = float(psnr(case.distorted, case.reference))
    if torch.equal(case.distorted, case.reference):
        assert found == math.inf
    else:
        # 1e-8 inside the oracle's logarithm
        error = 10.0 ** (-found / 10.0)
        assert -10.0 * math.log10(error + 1e-8) == pytest.approx(case.score, rel=1e-6)


def test_the_48_db_of_a_wrong_range_are_refused() -> None:
    image = torch.rand(3, 8, 8, generator=torch.Generator().manual_seed(1))
    with pytest.raises(ValueError, match=r"images in \[0, 1\] have data_range=1"):
        psnr(image * 0.5, image, data_range=255.0)
    with pytest.raises(ValueError, match=r"must lie in 0\.\.data_range = 1; got 0\.\.255"):
        psnr(torch.tensor([0.0, 255.0]).expand(3, 2, 2), torch.zeros(3, 2, 2))


def test_integers_and_floats_agree() -> None:
    pair = torch.randint(0, 256, (2, 3, 6, 6), generator=torch.Generator().manual_seed(2), dtype=torch.uint8)
    whole = psnr(pair[0], pair[1], data_range=255)
    assert float(whole) == pytest.approx(float(psnr(pair[0] / 255.0, pair[1] / 255.0)), rel=1e-6)


def test_gradient_is_finite_for_identical_images() -> None:
    image = torch.rand(3, 8, 8, dtype=torch.float64, generator=torch.Generator().manual_seed(3))
    moving = image.clone().requires_grad_()
    (gradient,) = torch.autograd.grad(psnr(moving, image), moving)
    assert bool(torch.isfinite(gradient).all())
