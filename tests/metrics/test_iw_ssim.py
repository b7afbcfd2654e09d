"""IW-SSIM against the oracle."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

from tests.metrics.iqa import Case, cases
from torchweather.metrics.colour import luma
from torchweather.metrics.iw_ssim import iw_ssim

# float32 rounding of bands that are flat enters the weights
FLOAT32 = 3e-3


def noise(*shape: int, seed: int = 1) -> Tensor:
    return torch.rand(*shape, dtype=torch.float64, generator=torch.Generator().manual_seed(seed))


@pytest.mark.parametrize("case", list(cases("iw_ssim")), ids=lambda case: case.name)
def test_oracle(case: Case) -> None:
    assert float(iw_ssim(case.distorted, case.reference)) == pytest.approx(case.score, abs=1e-6)


def test_oracle_in_float32() -> None:
    found = list(cases("iw_ssim", "float32"))
    assert found
    for case in found:
        score = iw_ssim(case.distorted, case.reference)
        assert score.dtype == torch.float32
        assert float(score) == pytest.approx(case.score, abs=FLOAT32), case.name


def test_float32_images_score_like_float64() -> None:
    for case in list(cases("iw_ssim"))[::4]:
        found = float(iw_ssim(case.distorted.float(), case.reference.float()))
        assert found == pytest.approx(case.score, abs=FLOAT32), case.name


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_identical_images_score_exactly_one(dtype: torch.dtype) -> None:
    image = noise(2, 3, 163, 170).to(dtype)
    assert torch.equal(iw_ssim(image, image), torch.ones(2, dtype=dtype))


def test_flat_reference_has_a_score() -> None:
    flat = torch.full((1, 161, 161), 0.5, dtype=torch.float64)
    assert float(iw_ssim(flat, flat)) == 1.0
    rough = noise(1, 161, 161)
    for pair in ((rough, flat), (flat, rough), (0.6 * flat, flat)):
        assert 0.0 <= float(iw_ssim(*pair)) <= 1.0
    # no information anywhere and no contrast: the brightness of the coarsest scale, whose values are 16 times as large
    near = (2 * 0.6 + 1e-4 / 64.0) / (0.36 + 1.0 + 1e-4 / 64.0)
    assert float(iw_ssim(0.6 * flat, flat)) == pytest.approx(near ** (0.1333 / 1.0001), abs=1e-9)


def test_reference_of_dependent_pixels_has_a_score() -> None:
    stripes = noise(1, 1, 170).expand(1, 170, 170)  # the three rows of each block are one
    assert float(iw_ssim(stripes, stripes)) == 1.0
    assert 0.0 < float(iw_ssim(0.5 * stripes + 0.2, stripes)) < 1.0


def test_reference_decides_the_weights() -> None:
    reference = noise(1, 161, 161)
    distorted = 0.5 * reference + 0.5 * noise(1, 161, 161, seed=2)
    assert abs(float(iw_ssim(distorted, reference)) - float(iw_ssim(reference, distorted))) > 1e-6


def test_a_batch_gives_what_its_elements_give() -> None:
    y = noise(2, 3, 163, 166)
    y[1] *= 0.3
    x = 0.5 * y + 0.5 * noise(2, 3, 163, 166, seed=2)
    batch = iw_ssim(x, y)
    assert batch.shape == (2,)
    assert torch.allclose(batch, torch.stack([iw_ssim(x[i], y[i]) for i in range(2)]), rtol=0.0, atol=1e-12)
    # a flat neighbour in the batch changes nothing
    x[1], y[1] = 0.4, 0.5
    assert float(iw_ssim(x, y)[0]) == pytest.approx(float(batch[0]), abs=1e-12)


def test_colour_is_scored_by_its_luma() -> None:
    y = noise(3, 161, 161)
    x = 0.5 * y + 0.5 * noise(3, 161, 161, seed=2)
    grey = iw_ssim(luma(x[None])[0], luma(y[None])[0])
    assert float(iw_ssim(x, y)) == pytest.approx(float(grey), abs=1e-9)


@pytest.mark.parametrize("kind", ["identical", "constant", "black", "stripes", "ordinary"])
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_gradients_are_finite(kind: str, dtype: torch.dtype) -> None:
    shape = (3, 161, 161)
    y = {
        "constant": torch.full(shape, 0.5),
        "black": torch.zeros(shape),
        "stripes": noise(3, 1, 161).expand(shape),
    }.get(kind, noise(*shape)).to(dtype)
    x = (0.5 * y + 0.5 * noise(*shape, seed=2).to(dtype) if kind == "ordinary" else y.clone()).requires_grad_()
    reference = y.clone().requires_grad_()
    for gradient in torch.autograd.grad(iw_ssim(x, reference), (x, reference)):
        assert bool(torch.isfinite(gradient).all())
        if kind == "ordinary":
            assert bool(gradient.any())


def test_gradient_is_that_of_differences() -> None:
    y = noise(1, 161, 161)
    x = (0.5 * y + 0.5 * noise(1, 161, 161, seed=2)).requires_grad_()
    way = noise(1, 161, 161, seed=3) - 0.5
    (gradient,) = torch.autograd.grad(iw_ssim(x, y), x)
    step = 1e-5
    ahead, behind = float(iw_ssim(x.detach() + step * way, y)), float(iw_ssim(x.detach() - step * way, y))
    assert float((gradient * way).sum()) == pytest.approx((ahead - behind) / (2.0 * step), rel=1e-5)


def test_images_below_five_scales_are_refused() -> None:
    with pytest.raises(ValueError, match="iw_ssim: images must be 161 x 161 pixels or larger; got 160 x 300"):
        iw_ssim(noise(1, 160, 300), noise(1, 160, 300))
