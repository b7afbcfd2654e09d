"""SSIM against the oracle."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

from tests.metrics.iqa import Case, cases
from torchweather.metrics.ssim import ssim


def noise(*shape: int, seed: int = 1) -> Tensor:
    return torch.rand(*shape, dtype=torch.float64, generator=torch.Generator().manual_seed(seed))


@pytest.mark.parametrize("case", list(cases("ssim")), ids=lambda case: case.name)
def test_oracle(case: Case) -> None:
    assert float(ssim(case.distorted, case.reference)) == pytest.approx(case.score, abs=1e-6)


@pytest.mark.parametrize("case", list(cases("ssim_full_resolution")), ids=lambda case: case.name)
def test_oracle_at_full_resolution(case: Case) -> None:
    assert float(ssim(case.distorted, case.reference, full_resolution=True)) == pytest.approx(case.score, abs=1e-6)


@pytest.mark.parametrize("case", list(cases("ssim_skimage"))[::4], ids=lambda case: case.name)
def test_full_resolution_is_that_of_scikit_image(case: Case) -> None:
    found = ssim(255.0 * case.distorted, 255.0 * case.reference, data_range=255.0, full_resolution=True)
    assert float(found) == pytest.approx(case.score, abs=1e-6)


@pytest.mark.parametrize("key", ["ssim", "ssim_full_resolution"])
def test_oracle_in_float32(key: str) -> None:
    found = list(cases(key, "float32"))
    assert found
    for case in found:
        score = ssim(case.distorted, case.reference, full_resolution=key == "ssim_full_resolution")
        assert score.dtype == torch.float32
        assert float(score) == pytest.approx(case.score, abs=1e-4), case.name


def test_float32_images_score_like_float64() -> None:
    for case in list(cases("ssim"))[::3]:
        assert float(ssim(case.distorted.float(), case.reference.float())) == pytest.approx(case.score, abs=1e-4)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_identical_images_score_exactly_one(dtype: torch.dtype) -> None:
    image = noise(2, 3, 40, 52).to(dtype)
    assert torch.equal(ssim(image, image), torch.ones(2, dtype=dtype))


def test_constant_images_score_by_their_brightness() -> None:
    light, dark = torch.full((1, 12, 12), 0.8, dtype=torch.float64), torch.full((1, 12, 12), 0.2, dtype=torch.float64)
    assert float(ssim(dark, dark)) == 1.0
    # no contrast in either: only the factor of brightness is left
    assert float(ssim(dark, light)) == pytest.approx((2 * 0.16 + 1e-4) / (0.64 + 0.04 + 1e-4), abs=1e-12)


def test_symmetric_and_a_batch_gives_what_its_elements_give() -> None:
    x, y = noise(2, 2, 3, 30, 34), noise(2, 2, 3, 30, 34, seed=2)
    batch = ssim(x, y)
    assert batch.shape == (2, 2)
    assert torch.equal(batch, ssim(y, x))
    one_by_one = torch.stack([ssim(x[i, j], y[i, j]) for i in range(2) for j in range(2)]).reshape(2, 2)
    assert torch.allclose(batch, one_by_one, rtol=0.0, atol=1e-14)


def test_score_of_colour_is_the_mean_over_its_channels() -> None:
    x, y = noise(3, 20, 20), noise(3, 20, 20, seed=2)
    channels = [float(ssim(x[i : i + 1], y[i : i + 1])) for i in range(3)]
    assert float(ssim(x, y)) == pytest.approx(sum(channels) / 3.0, abs=1e-14)


@pytest.mark.parametrize("kind", ["identical", "constant", "black", "ordinary"])
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_gradients_are_finite(kind: str, dtype: torch.dtype) -> None:
    shape = (3, 24, 24)
    y = {"constant": torch.full(shape, 0.5), "black": torch.zeros(shape)}.get(kind, noise(*shape)).to(dtype)
    x = (noise(*shape, seed=2).to(dtype) if kind == "ordinary" else y.clone()).requires_grad_()
    reference = y.clone().requires_grad_()
    for gradient in torch.autograd.grad(ssim(x, reference), (x, reference)):
        assert bool(torch.isfinite(gradient).all())
        if kind == "ordinary":
            assert bool(gradient.any())


def test_gradient_is_that_of_differences() -> None:
    x, y = noise(1, 12, 12).requires_grad_(), noise(1, 12, 12, seed=2)
    assert torch.autograd.gradcheck(lambda image: ssim(image, y), (x,))


def test_images_below_the_window_are_refused() -> None:
    assert torch.isfinite(ssim(noise(1, 11, 11), noise(1, 11, 11, seed=2)))
    with pytest.raises(ValueError, match="ssim: images must be 11 x 11 pixels or larger; got 10 x 40"):
        ssim(noise(1, 10, 40), noise(1, 10, 40))
