"""Multi-scale gradient magnitude similarity deviation against the oracle."""

from __future__ import annotations

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
from torchweather.metrics.ms_gmsd import ms_gmsd

KEYS = {"ms_gmsd": False, "ms_gmsd_chromatic": True}


def _cases(precision: str) -> list[object]:
    return [
        pytest.param(case, chromatic, id=f"{key}-{case.name}")
        for key, chromatic in KEYS.items()
        for case in cases(key, precision)
    ]


@pytest.mark.parametrize(("case", "chromatic"), _cases("float64"))
def test_oracle(case: Case, chromatic: bool) -> None:
    found = ms_gmsd(case.distorted, case.reference, chromatic=chromatic)
    assert float(found) == pytest.approx(case.score, rel=0, abs=1e-6)
    single = ms_gmsd(case.distorted.float(), case.reference.float(), chromatic=chromatic)
    assert float(single) == pytest.approx(case.score, rel=0, abs=1e-4)


@pytest.mark.parametrize(("case", "chromatic"), _cases("float32"))
def test_oracle_in_float32(case: Case, chromatic: bool) -> None:
    found = ms_gmsd(case.distorted, case.reference, chromatic=chromatic)
    assert float(found) == pytest.approx(case.score, rel=0, abs=1e-4)


@pytest.mark.parametrize("chromatic", [False, True])
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_identical_images_score_zero(dtype: torch.dtype, chromatic: bool) -> None:
    clear = pair(2, 3, 31, 26, dtype=dtype)[1]
    assert ms_gmsd(clear, clear, chromatic=chromatic).tolist() == [0.0, 0.0]


def test_colour_alone_shows_in_the_chromatic_score_only() -> None:
    worse = torch.full((3, 32, 32), 0.5, dtype=torch.float64)
    clear = worse.clone()
    worse[0] += 0.114  # red for blue at one luma
    worse[2] -= 0.299
    assert float(ms_gmsd(worse, clear)) == pytest.approx(0.0, abs=1e-9)
    assert float(ms_gmsd(worse, clear, chromatic=True)) > 0.1


def test_chromatic_needs_colour() -> None:
    worse, clear = pair(1, 32, 32)
    assert float(ms_gmsd(worse, clear)) > 0.0
    with pytest.raises(ValueError, match=r"C = 3; got \(1, 32, 32\)"):
        ms_gmsd(worse, clear, chromatic=True)


def test_constant_images() -> None:
    flat = torch.full((3, 16, 16), 0.3, dtype=torch.float64)
    assert float(ms_gmsd(flat, flat)) == 0.0
    assert 0.0 < float(ms_gmsd(flat, flat + 0.2)) < 0.1  # the border against the zeros around


@pytest.mark.parametrize("chromatic", [False, True])
def test_batch_gradients_symmetry_and_size(chromatic: bool) -> None:
    score = partial(ms_gmsd, chromatic=chromatic)
    batch_gives_what_its_elements_give(score, 3, 25, 32)
    gradients_are_finite(score, 3, 25, 32)
    symmetric(score, 3, 25, 32)
    refuses_smaller_than(score, 16)
