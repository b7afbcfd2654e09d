"""DSS against the oracle."""

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
from torchweather.metrics.dss import dss


@pytest.mark.parametrize("case", list(cases("dss")), ids=lambda case: case.name)
def test_oracle(case: Case) -> None:
    # METRICS.md asks for 1e-4
    assert float(dss(case.distorted, case.reference)) == pytest.approx(case.score, rel=0, abs=1e-6)
    single = dss(case.distorted.float(), case.reference.float())
    assert float(single) == pytest.approx(case.score, rel=0, abs=1e-4)


@pytest.mark.parametrize("case", list(cases("dss", "float32")), ids=lambda case: case.name)
def test_oracle_in_float32(case: Case) -> None:
    assert float(dss(case.distorted, case.reference)) == pytest.approx(case.score, rel=0, abs=1e-4)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_identical_images_score_exactly_one(dtype: torch.dtype) -> None:
    clear = pair(2, 3, 65, 50, dtype=dtype)[1]
    assert dss(clear, clear).tolist() == [1.0, 1.0]
    flat = torch.full_like(clear, 0.3)
    assert dss(flat, flat).tolist() == [1.0, 1.0]


def test_constant_images() -> None:
    worse, clear = pair(3, 64, 64)
    flat = torch.full_like(clear, 0.3)
    for x, y in ((flat, clear), (worse, flat), (flat, flat + 0.2)):
        assert 0.0 < float(dss(x, y)) < 1.0


def test_pixels_beyond_the_last_block_do_not_count() -> None:
    worse, clear = pair(3, 64, 64)
    wider = torch.nn.functional.pad(worse, (0, 7, 0, 5), value=1.0), torch.nn.functional.pad(clear, (0, 7, 0, 5))
    assert float(dss(*wider)) == pytest.approx(float(dss(worse, clear)), rel=1e-12)


def test_data_range() -> None:
    worse, clear = pair(3, 32, 32)
    assert float(dss(255.0 * worse, 255.0 * clear, data_range=255.0)) == pytest.approx(float(dss(worse, clear)))


def test_batch_gradients_symmetry_and_size() -> None:
    batch_gives_what_its_elements_give(dss, 3, 32, 42)
    gradients_are_finite(dss, 3, 32, 42)
    symmetric(dss, 3, 32, 42)
    refuses_smaller_than(dss, 8)
