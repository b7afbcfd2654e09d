"""Gradient magnitude similarity deviation against the oracle."""

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
from torchweather.metrics.gmsd import gmsd


@pytest.mark.parametrize("case", list(cases("gmsd")), ids=lambda case: case.name)
def test_oracle(case: Case) -> None:
    assert float(gmsd(case.distorted, case.reference)) == pytest.approx(case.score, rel=0, abs=1e-6)
    single = gmsd(case.distorted.float(), case.reference.float())
    assert float(single) == pytest.approx(case.score, rel=0, abs=1e-4)


@pytest.mark.parametrize("case", list(cases("gmsd", "float32")), ids=lambda case: case.name)
def test_oracle_in_float32(case: Case) -> None:
    assert float(gmsd(case.distorted, case.reference)) == pytest.approx(case.score, rel=0, abs=1e-4)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_identical_images_score_zero(dtype: torch.dtype) -> None:
    clear = pair(2, 3, 31, 26, dtype=dtype)[1]
    assert gmsd(clear, clear).tolist() == [0.0, 0.0]


def test_constant_images() -> None:
    flat = torch.full((3, 16, 16), 0.3, dtype=torch.float64)
    assert float(gmsd(flat, flat)) == 0.0
    # inside there is no gradient on either side; what remains is the border against the zeros around
    edge = float(gmsd(flat, flat + 0.2))
    assert 0.0 < edge < 0.1


def test_half_of_the_edges_lost_is_the_worst() -> None:
    """Similarity 1 on one half and near 0 on the other: a standard deviation of nearly 0.5."""
    steps = (torch.arange(128) // 4 % 2).to(torch.float64).expand(1, 128, 128)
    half = steps.clone()
    half[:, 64:] = 0.5
    found = float(gmsd(half, steps))
    assert 0.45 < found <= 0.5


def test_data_range() -> None:
    worse, clear = pair(3, 24, 24)
    assert float(gmsd(255.0 * worse, 255.0 * clear, data_range=255.0)) == pytest.approx(float(gmsd(worse, clear)))


def test_batch_gradients_symmetry_and_size() -> None:
    batch_gives_what_its_elements_give(gmsd, 3, 25, 32)
    gradients_are_finite(gmsd, 3, 25, 32)
    symmetric(gmsd, 3, 25, 32)
    refuses_smaller_than(gmsd, 5)
