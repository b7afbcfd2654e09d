"""MS-SSIM against the oracle."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

from tests.metrics.iqa import Case, cases
from torchweather.metrics.colour import luma
from torchweather.metrics.ms_ssim import ms_ssim


def noise(*shape: int, seed: int = 1) -> Tensor:
    return torch.rand(*shape, dtype=torch.float64, generator=torch.Generator().manual_seed(seed))


@pytest.mark.parametrize("case", list(cases("ms_ssim")), ids=lambda case: case.name)
def test_oracle(case: Case) -> None:
    assert float(ms_ssim(case.distorted, case.reference)) == pytest.approx(case.score, abs=1e-6)


def test_oracle_in_float32() -> None:
    found = list(cases("ms_ssim", "float32"))
    assert found
    for case in found:
        score = ms_ssim(case.distorted, case.reference)
        assert score.dtype == torch.float32
        assert float(score) == pytest.approx(case.score, abs=1e-4), case.name


def test_float32_images_score_like_float64() -> None:
    for case in list(cases("ms_ssim"))[::3]:
        assert float(ms_ssim(case.distorted.float(), case.reference.float())) == pytest.approx(case.score, abs=1e-4)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_identical_images_score_exactly_one(dtype: torch.dtype) -> None:
    image = noise(2, 3, 161, 170).to(dtype)
    assert torch.equal(ms_ssim(image, image), torch.ones(2, dtype=dtype))


def test_constant_images_score_by_their_brightness() -> None:
    light, dark = torch.full((1, 161, 161), 0.8, dtype=torch.float64), torch.full((1, 161, 161), 0.2).double()
    assert float(ms_ssim(light, light)) == 1.0
    # no contrast at any scale: the brightness of the coarsest, to its weight
    brightness = (2 * 0.16 + 1e-4) / (0.64 + 0.04 + 1e-4)
    assert float(ms_ssim(dark, light)) == pytest.approx(brightness**0.1333, abs=1e-7)


def test_symmetric_and_a_batch_gives_what_its_elements_give() -> None:
    y = noise(2, 3, 163, 166)
    x = 0.5 * y + 0.5 * noise(2, 3, 163, 166, seed=2)
    batch = ms_ssim(x, y)
    assert batch.shape == (2,)
    assert torch.equal(batch, ms_ssim(y, x))
    assert torch.allclose(batch, torch.stack([ms_ssim(x[i], y[i]) for i in range(2)]), rtol=0.0, atol=1e-14)


def test_luma_is_scored_like_a_grey_image() -> None:
    y = noise(3, 161, 161)
    x = 0.5 * y + 0.5 * noise(3, 161, 161, seed=2)
    grey = ms_ssim(luma(x[None])[0], luma(y[None])[0])
    assert float(ms_ssim(x, y, luma_only=True)) == pytest.approx(float(grey), abs=1e-14)
    assert abs(float(ms_ssim(x, y)) - float(grey)) > 1e-3
    assert torch.equal(ms_ssim(x[:1], y[:1], luma_only=True), ms_ssim(x[:1], y[:1]))


def test_opposite_images_score_zero() -> None:
    image = noise(1, 161, 161)
    assert float(ms_ssim(1.0 - image, image)) == 0.0


@pytest.mark.parametrize("kind", ["identical", "constant", "black", "opposite", "ordinary"])
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_gradients_are_finite(kind: str, dtype: torch.dtype) -> None:
    shape = (3, 161, 161)
    y = {"constant": torch.full(shape, 0.5), "black": torch.zeros(shape)}.get(kind, noise(*shape)).to(dtype)
    x = {"opposite": 1.0 - y, "ordinary": 0.5 * y + 0.5 * noise(*shape, seed=2).to(dtype)}.get(kind, y.clone())
    x, reference = x.requires_grad_(), y.clone().requires_grad_()
    for gradient in torch.autograd.grad(ms_ssim(x, reference), (x, reference)):
        assert bool(torch.isfinite(gradient).all())
    if kind == "ordinary":
        assert bool(gradient.any())


def test_images_below_five_scales_are_refused() -> None:
    with pytest.raises(ValueError, match="ms_ssim: images must be 161 x 161 pixels or larger; got 160 x 300"):
        ms_ssim(noise(1, 160, 300), noise(1, 160, 300))
