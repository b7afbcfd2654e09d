"""FSIM with and without colour against the oracle."""

from __future__ import annotations

import math
from functools import partial

import pytest
import torch

from tests.metrics.behaviour import (
    batch_gives_what_its_elements_give,
    gradients_are_finite,
    pair,
    refuses_smaller_than,
    symmetric,
)
from tests.metrics.iqa import Case, cases
from torchweather.metrics.fsim import fsim
from torchweather.metrics.phase_congruency import _bank, phase_congruency

VARIANTS = {"fsimc": fsim, "fsim": partial(fsim, chromatic=False)}
DOUBLE = [(key, case) for key in VARIANTS for case in cases(key)]
SINGLE = [(key, case) for key in VARIANTS for case in cases(key, "float32")]


def _name(value: object) -> str:
    return value.name if isinstance(value, Case) else str(value)


@pytest.mark.parametrize(("key", "case"), DOUBLE, ids=_name)
def test_oracle(key: str, case: Case) -> None:
    assert float(VARIANTS[key](case.distorted, case.reference)) == pytest.approx(case.score, rel=0, abs=1e-6)


@pytest.mark.parametrize(("key", "case"), SINGLE, ids=_name)
def test_oracle_in_float32(key: str, case: Case) -> None:
    assert float(VARIANTS[key](case.distorted, case.reference)) == pytest.approx(case.score, rel=0, abs=1e-4)


@pytest.mark.parametrize("case", [case for case in cases("fsimc") if "-fog-" in case.name], ids=_name)
def test_float32_against_the_oracle_in_float64(case: Case) -> None:
    single = fsim(case.distorted.float(), case.reference.float())
    assert float(single) == pytest.approx(case.score, rel=0, abs=1e-4)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_identical_images_score_one(dtype: torch.dtype) -> None:
    clear = pair(2, 3, 31, 40, dtype=dtype)[1]
    assert fsim(clear, clear).tolist() == [1.0, 1.0]
    assert fsim(torch.full_like(clear, 0.3), torch.full_like(clear, 0.3)).tolist() == [1.0, 1.0]


def test_colour_counts_only_where_asked_for() -> None:
    clear = pair(3, 32, 32)[1] * 0.5 + 0.2
    # more red and less blue at one luma: 0.299 * 0.114 = 0.114 * 0.299
    tinted = clear + 0.4 * torch.tensor([0.114, 0.0, -0.299], dtype=clear.dtype)[:, None, None]
    assert float(fsim(tinted, clear, chromatic=False)) == pytest.approx(1.0, abs=1e-9)
    assert float(fsim(tinted, clear)) < 0.999
    grey = tinted[:1], clear[:1]
    assert float(fsim(*grey)) == float(fsim(*grey, chromatic=False))


def test_phase_congruency_finds_edges_whatever_their_contrast() -> None:
    step = torch.zeros(1, 1, 64, 64, dtype=torch.float64)
    step[..., 32:] = 1.0
    found = phase_congruency(step)
    assert float(found.min()) >= 0.0
    assert float(found.max()) <= 1.0
    assert float(found[0, 0, 32, 31:33].min()) > 0.7  # the edge lies half a pixel beside both
    assert int(found[0, 0, 32, 8:56].argmax()) + 8 in (31, 32)
    torch.testing.assert_close(phase_congruency(7.0 * step + 3.0), found, rtol=0, atol=1e-9)
    assert float(phase_congruency(torch.full_like(step, 0.7)).abs().max()) == 0.0


def test_constant_images() -> None:
    worse, clear = pair(3, 32, 32)
    flat = torch.full_like(clear, 0.3)
    for x, y in ((flat, clear), (worse, flat), (flat, flat + 0.2)):
        assert 0.0 < float(fsim(x, y)) < 1.0


def test_data_range() -> None:
    worse, clear = pair(3, 32, 32)
    assert float(fsim(255.0 * worse, 255.0 * clear, data_range=255.0)) == pytest.approx(float(fsim(worse, clear)))


def test_batch_gradients_symmetry_and_size() -> None:
    batch_gives_what_its_elements_give(fsim, 3, 20, 26)
    gradients_are_finite(fsim, 3, 20, 26)
    symmetric(fsim, 3, 20, 26)
    refuses_smaller_than(fsim, 8)


@pytest.mark.parametrize("size", [(48, 36), (33, 50), (25, 27)], ids=str)
def test_noise_through_the_filters_is_that_over_the_image(size: tuple[int, int]) -> None:
    """The authors sum the filters' real parts over the image, shape by shape and pair by pair."""
    bank = _bank(*size, torch.float64, torch.device("cpu"))
    filters = bank.orientations[:, None] * bank.scales
    shapes = torch.fft.ifft2(filters).real * math.sqrt(size[0] * size[1])
    squares = shapes.square().sum((1, 2, 3))
    crossed = torch.stack([2.0 * (shapes[:, a] * shapes[:, b]).sum((1, 2)) for b in range(4) for a in range(b)]).sum(0)
    torch.testing.assert_close(bank.real_power, squares + crossed, rtol=1e-12, atol=0.0)
    torch.testing.assert_close(bank.finest_power, filters[:, 0].square().sum((1, 2)), rtol=1e-12, atol=0.0)


def test_filters_of_a_call_without_gradients_serve_one_with_them() -> None:
    image = torch.rand(1, 1, 23, 29)
    with torch.inference_mode():
        wanted = phase_congruency(image)
    image.requires_grad_()
    found = phase_congruency(image)
    found.sum().backward()  # type: ignore[no-untyped-call]
    assert torch.allclose(found, wanted, atol=1e-6)
    assert image.grad is not None
