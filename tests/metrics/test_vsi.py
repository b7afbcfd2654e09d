"""VSI against the oracle."""

from __future__ import annotations

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
from torchweather.metrics.vsi import vsi


@pytest.mark.parametrize("case", list(cases("vsi")), ids=lambda case: case.name)
def test_oracle(case: Case) -> None:
    assert float(vsi(case.distorted, case.reference)) == pytest.approx(case.score, rel=0, abs=1e-6)


@pytest.mark.parametrize("case", list(cases("vsi"))[::3], ids=lambda case: case.name)
def test_oracle_from_float32(case: Case) -> None:
    single = vsi(case.distorted.float(), case.reference.float())
    assert float(single) == pytest.approx(case.score, rel=0, abs=1e-4)


@pytest.mark.parametrize("case", list(cases("vsi", "float32")), ids=lambda case: case.name)
def test_oracle_in_float32(case: Case) -> None:
    assert float(vsi(case.distorted, case.reference)) == pytest.approx(case.score, rel=0, abs=1e-4)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_identical_images_score_one(dtype: torch.dtype) -> None:
    """Up to the rounding of a weighted mean of ones."""
    clear = pair(2, 3, 65, 50, dtype=dtype)[1]
    flat = torch.full_like(clear, 0.3)
    for image in (clear, flat):
        assert vsi(image, image).tolist() == pytest.approx([1.0, 1.0], abs=4 * torch.finfo(dtype).eps)


def test_constant_images() -> None:
    worse, clear = pair(3, 64, 64)
    flat = torch.full_like(clear, 0.3)
    for x, y in ((flat, clear), (worse, flat), (flat, flat + 0.2)):
        assert 0.0 < float(vsi(x, y)) <= 1.0


def test_batch_gradients_symmetry_and_size() -> None:
    batch_gives_what_its_elements_give(vsi, 3, 32, 42)
    gradients_are_finite(vsi, 3, 32, 42)
    symmetric(vsi, 3, 32, 42)
    refuses_smaller_than(vsi, 3)


def test_data_range() -> None:
    worse, clear = pair(3, 32, 32)
    assert float(vsi(255.0 * worse, 255.0 * clear, data_range=255.0)) == pytest.approx(float(vsi(worse, clear)))
