"""CW-SSIM against the oracle and against waves whose bands are known."""

from __future__ import annotations

import math

import pytest
import torch
from torch import Tensor

from tests.metrics.iqa import Case, cases
from torchweather.metrics.cw_ssim import cw_ssim
from torchweather.metrics.steerable_pyramid import least_size, steerable_bands


def noise(*shape: int, seed: int = 1, dtype: torch.dtype = torch.float64) -> Tensor:
    return torch.rand(*shape, generator=torch.Generator().manual_seed(seed), dtype=dtype)


# ---- oracle --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("case", list(cases("cw_ssim_pyiqa")), ids=lambda case: case.name)
def test_oracle(case: Case) -> None:
    # METRICS.md 1: 1e-5 in float64; the oracle breaks ties of the rounded luma by its float32 weights (up to 7e-6)
    assert float(cw_ssim(case.distorted, case.reference)) == pytest.approx(case.score, abs=1e-5)
    single = cw_ssim(case.distorted.float(), case.reference.float())
    assert single.dtype == torch.float32
    assert float(single) == pytest.approx(case.score, abs=1e-5)


@pytest.mark.parametrize("case", list(cases("cw_ssim_pyiqa", "float32")), ids=lambda case: case.name)
def test_oracle_in_float32(case: Case) -> None:
    assert float(cw_ssim(case.distorted, case.reference)) == pytest.approx(case.score, abs=1e-5)


def test_the_oracle_needs_whole_grey_values() -> None:
    (case,) = (case for case in cases("cw_ssim_pyiqa") if case.name == "texture-veil-160")
    raw = float(cw_ssim(case.distorted, case.reference, whole_grey=False))
    assert 1e-4 < abs(raw - case.score) < 1e-3


# ---- pyramid -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("level", "period"), [(1, 4), (2, 8), (4, 32)])
def test_a_wave_is_seen_by_its_level_and_orientation(level: int, period: int) -> None:
    place = torch.arange(128, dtype=torch.float64)
    upright = torch.cos(2.0 * math.pi / period * place).expand(1, 1, 128, 128)  # changes along x: orientation 0
    strength = [steerable_bands(upright, each, 8).abs().square().mean((0, 2, 3)) for each in range(1, 6)]
    best = max(range(5), key=lambda each: float(strength[each].sum()))
    assert best == level - 1
    assert int(strength[best].argmax()) == 0
    assert float(strength[best][0]) == pytest.approx(0.25, rel=1e-9)  # half of a cosine lies at one frequency
    lying = steerable_bands(upright.mT.contiguous(), level, 8).abs().square().sum((0, 2, 3))
    assert int(lying.argmax()) == 4
    # cos^7 of 22.5 degrees, squared
    assert float(lying[3] / lying[4]) == pytest.approx(math.cos(math.pi / 8) ** 14, rel=1e-9)


def test_a_shift_of_a_wave_turns_the_phase_of_its_band_and_leaves_its_amplitude() -> None:
    place = torch.arange(128, dtype=torch.float64)
    bands = [
        steerable_bands(torch.cos(2.0 * math.pi / 32 * (place - shift)).expand(1, 1, 128, 128), 4, 8)[0, 0]
        for shift in (0, 4)
    ]
    torch.testing.assert_close(bands[1].abs(), bands[0].abs())
    turn = (bands[1] * bands[0].conj()).angle()
    torch.testing.assert_close(turn, torch.full_like(turn, -2.0 * math.pi * 4 / 32))


@pytest.mark.parametrize(("height", "width"), [(64, 96), (49, 50), (101, 75)])
def test_bands_are_those_of_the_whole_spectrum(height: int, width: int) -> None:
    image = noise(1, 1, height, width)
    found = steerable_bands(image, 4, 8)
    assert found.shape[-2:] == (math.ceil(height / 8), math.ceil(width / 8))
    # By definition, over the whole plane: frequencies outside the ring's square are 0.
    rows, columns = (torch.fft.fftfreq(size, dtype=torch.float64) * 2.0 for size in (height, width))
    radius = (rows[:, None].square() + columns.square()).sqrt().clamp_min(1e-30)
    octave = radius.log2()
    ring = torch.sin(0.5 * math.pi * (octave + 5).clamp(0, 1)) * torch.cos(0.5 * math.pi * (octave + 4).clamp(0, 1))
    angle = torch.atan2(rows[:, None].expand(height, width), columns.expand(height, width))
    facing = torch.cos(angle - 2.0 * math.pi / 8).clamp_min(0.0) ** 7
    spectrum = torch.fft.fft2(image[0, 0]) * ring * facing
    # Parseval: mean energy over the places of the smaller and of the whole plane
    torch.testing.assert_close(found[0, 2].abs().square().mean(), torch.fft.ifft2(spectrum).abs().square().mean())
    # The mean of the image passes nowhere.
    torch.testing.assert_close(steerable_bands(image + 3.0, 4, 8), found)


# ---- what it says --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("channels", [1, 3])
def test_identical_images_score_1_exactly(channels: int) -> None:
    image = noise(channels, 64, 80)
    assert float(cw_ssim(image, image)) == 1.0
    assert float(cw_ssim(image.float(), image.float())) == 1.0


def test_flat_images_are_equal_and_unlike_all_others() -> None:
    # At these sizes the transform of a flat image leaves rounding behind.
    flat, other = torch.full((2, 3, 101, 75), 0.3), noise(2, 3, 101, 75, dtype=torch.float32)
    flat[1] = 0.0
    assert cw_ssim(flat, flat).tolist() == [1.0, 1.0]
    for whole in (True, False):
        assert cw_ssim(flat, flat.flip(0), whole_grey=whole).tolist() == [1.0, 1.0]
        assert cw_ssim(flat.double() * 0.7, flat.flip(0).double(), whole_grey=whole).tolist() == [1.0, 1.0]
    assert cw_ssim(flat, other).tolist() == pytest.approx([0.0, 0.0], abs=1e-6)
    assert cw_ssim(other, flat).tolist() == pytest.approx([0.0, 0.0], abs=1e-6)


def test_contrast_and_light_cost_what_the_formula_says() -> None:
    image = 0.4 * noise(1, 96, 64)
    assert float(cw_ssim(image + 0.3, image)) == pytest.approx(1.0, abs=1e-9)
    assert float(cw_ssim(0.5 * image, image)) == pytest.approx(2 * 0.5 / (1 + 0.5**2), rel=1e-9)
    assert float(cw_ssim(1.0 - image, image)) == pytest.approx(1.0, abs=1e-9)  # a phase turned everywhere alike


def test_symmetric_and_between_0_and_1() -> None:
    first, second = noise(4, 3, 64, 72, seed=2), noise(4, 3, 64, 72, seed=3)
    score = cw_ssim(first, second)
    assert torch.equal(score, cw_ssim(second, first))
    assert bool(((score > 0) & (score < 1)).all())


def test_a_batch_gives_what_its_elements_give() -> None:
    first, second = noise(2, 3, 3, 64, 72, seed=4), noise(2, 3, 3, 64, 72, seed=5)
    together = cw_ssim(first, second)
    assert together.shape == (2, 3)
    alone = torch.stack([cw_ssim(a, b) for a, b in zip(first.flatten(0, 1), second.flatten(0, 1), strict=True)])
    torch.testing.assert_close(together.flatten(), alone, rtol=1e-12, atol=0)


def test_data_range_and_integers() -> None:
    pair = torch.randint(0, 256, (2, 3, 64, 64), generator=torch.Generator().manual_seed(6), dtype=torch.uint8)
    whole = cw_ssim(pair[0], pair[1], data_range=255)
    assert float(whole) == pytest.approx(float(cw_ssim(pair[0] / 255.0, pair[1] / 255.0)), abs=1e-6)


# ---- gradients -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("dtype", [torch.float64, torch.float32])
@pytest.mark.parametrize("kind", ["ordinary", "identical", "constant", "one constant", "black"])
def test_gradients_are_finite(kind: str, dtype: torch.dtype) -> None:
    reference = noise(3, 64, 64, dtype=dtype)
    flat = torch.full_like(reference, 0.5)
    pairs = {
        "ordinary": (noise(3, 64, 64, seed=7, dtype=dtype), reference),
        "identical": (reference.clone(), reference),
        "constant": (flat.clone(), flat),
        "one constant": (flat.clone(), reference),
        "black": (torch.zeros_like(flat), torch.zeros_like(flat)),
    }
    moving, still = pairs[kind]
    moving.requires_grad_()
    (gradient,) = torch.autograd.grad(cw_ssim(moving, still), moving)
    assert gradient.dtype == dtype
    assert bool(torch.isfinite(gradient).all())
    if kind == "ordinary":
        assert float(gradient.abs().max()) > 1e-7
    if kind in ("constant", "black"):
        assert not bool(gradient.any())


def test_gradient_is_that_of_the_score() -> None:
    moving, still = noise(1, 49, 49, seed=8).requires_grad_(), noise(1, 49, 49, seed=9)
    way = noise(1, 49, 49, seed=10) - 0.5
    (gradient,) = torch.autograd.grad(cw_ssim(moving, still), moving)
    step = 1e-6
    with torch.no_grad():
        up, down = (cw_ssim((moving + sign * step * way).clamp(0, 1), still) for sign in (1, -1))
    assert float((gradient * way).sum()) == pytest.approx(float((up - down) / (2 * step)), rel=1e-4)


def test_rounding_to_grey_values_lets_the_gradient_through() -> None:
    still = noise(3, 64, 64, seed=11)
    moving = noise(3, 64, 64, seed=12).requires_grad_()
    rounded, raw = (torch.autograd.grad(cw_ssim(moving, still, whole_grey=whole), moving)[0] for whole in (True, False))
    # Rounding moves each luma by up to 1/510 of its range: the two gradients are nearly parallel.
    assert float(torch.nn.functional.cosine_similarity(rounded.flatten(), raw.flatten(), dim=0)) > 0.99


# ---- mistakes ------------------------------------------------------------------------------------------------------


def test_images_must_be_large_enough() -> None:
    assert least_size(4, 7) == 49
    with pytest.raises(ValueError, match="cw_ssim: images must be 49 x 49 pixels or larger; got 48 x 64"):
        cw_ssim(noise(1, 48, 64), noise(1, 48, 64))
    assert cw_ssim(noise(1, 49, 49), noise(1, 49, 49)).shape == ()
    assert cw_ssim(noise(1, 7, 7), noise(1, 7, 7), level=1).shape == ()


@pytest.mark.parametrize("option", ["level", "orientations"])
def test_numbers_must_be_1_or_more(option: str) -> None:
    with pytest.raises(ValueError, match=f"{option} must be 1 or more; got 0"):
        cw_ssim(noise(1, 64, 64), noise(1, 64, 64), **{option: 0})
