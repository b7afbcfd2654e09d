"""Visual information fidelity against the oracle, in both orders of its arguments."""

from __future__ import annotations

import pytest
import torch

from tests.metrics.behaviour import (
    batch_gives_what_its_elements_give,
    gradients_are_finite,
    pair,
    refuses_smaller_than,
)
from tests.metrics.iqa import Case, cases
from torchweather.metrics.vif import vif


@pytest.mark.parametrize("case", list(cases("vif")), ids=lambda case: case.name)
def test_oracle(case: Case) -> None:
    assert float(vif(case.distorted, case.reference)) == pytest.approx(case.score, rel=0, abs=1e-6)
    single = vif(case.distorted.float(), case.reference.float())
    assert float(single) == pytest.approx(case.score, rel=0, abs=1e-3)


@pytest.mark.parametrize("case", list(cases("vif", "float32")), ids=lambda case: case.name)
def test_oracle_in_float32(case: Case) -> None:
    assert float(vif(case.distorted, case.reference)) == pytest.approx(case.score, rel=0, abs=1e-3)


# The oracle's own float32 of the swapped order is up to 0.002 from its float64; the latter counts.
@pytest.mark.parametrize("case", list(cases("vif_arguments_swapped")), ids=lambda case: case.name)
def test_oracle_of_swapped_arguments(case: Case) -> None:
    assert float(vif(case.reference, case.distorted)) == pytest.approx(case.score, rel=0, abs=1e-6)
    single = vif(case.reference.float(), case.distorted.float())
    assert float(single) == pytest.approx(case.score, rel=0, abs=1e-3)


def test_a_veil_lowers_the_score_and_raises_it_with_arguments_swapped() -> None:
    clear = pair(3, 64, 64)[1]
    veils = [share * clear + (1.0 - share) * 0.85 for share in (0.9, 0.6, 0.3, 0.1)]
    right, wrong = (
        [float(vif(*order)) for order in orders]
        for orders in ([(veil, clear) for veil in veils], [(clear, veil) for veil in veils])
    )
    assert right == sorted(right, reverse=True)
    assert right[0] < 1.0
    assert wrong == sorted(wrong)
    assert wrong[0] > 1.0


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_identical_images_score_one(dtype: torch.dtype) -> None:
    clear = pair(2, 3, 64, 50, dtype=dtype)[1]
    assert vif(clear, clear).tolist() == [1.0, 1.0]


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_constant_images(dtype: torch.dtype) -> None:
    worse, clear = pair(1, 48, 48, dtype=dtype)
    flat = torch.full_like(clear, 0.3)
    assert float(vif(flat, flat + 0.1)) == 1.0  # nothing to lose
    assert float(vif(worse, flat)) == 1.0
    assert float(vif(flat, clear)) == 0.0  # everything lost


def test_data_range() -> None:
    worse, clear = pair(3, 48, 48)
    assert float(vif(255.0 * worse, 255.0 * clear, data_range=255.0)) == pytest.approx(float(vif(worse, clear)))


def test_batch_gradients_and_size() -> None:
    batch_gives_what_its_elements_give(vif, 3, 44, 52)
    gradients_are_finite(vif, 3, 44, 52)
    refuses_smaller_than(vif, 41)
