"""SR-SIM against the oracle."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

from tests.metrics.behaviour import (
    batch_gives_what_its_elements_give,
    gradients_are_finite,
    pair,
    refuses_smaller_than,
    symmetric,
)
from tests.metrics.iqa import Case, cases
from torchweather.metrics.sr_sim import sr_sim


def _tolerance(case: Case) -> float:
    """1e-6; more where whitening magnifies rounding.

    Rounding the reduced image of texture-fog-60 to float32 moves its score by 7e-6, that of no other pair by 1e-6.
    """
    return 3e-6 if case.name == "texture-fog-60" else 1e-6


@pytest.mark.parametrize("case", list(cases("srsim")), ids=lambda case: case.name)
def test_oracle(case: Case) -> None:
    assert float(sr_sim(case.distorted, case.reference)) == pytest.approx(case.score, rel=0, abs=_tolerance(case))
    single = sr_sim(case.distorted.float(), case.reference.float())
    assert float(single) == pytest.approx(case.score, rel=0, abs=1e-4)


@pytest.mark.parametrize("case", list(cases("srsim", "float32")), ids=lambda case: case.name)
def test_oracle_in_float32(case: Case) -> None:
    assert float(sr_sim(case.distorted, case.reference)) == pytest.approx(case.score, rel=0, abs=1e-4)


@pytest.mark.parametrize("pattern", ["bars", "checker", "disc", "ramp", "square", "sky", "point"])
def test_float32_gives_the_float64_value_where_frequencies_are_absent(pattern: str) -> None:
    # Whitening divides by the amplitude: rounding noise of absent frequencies moved the score by up to 0.35.
    clear = _drawn(pattern)
    for worse in (0.4 * clear + 0.5, 0.5 * clear, 1.0 - clear, (15.0 * clear).round() / 15.0, clear.roll(3, -1)):
        double, single = sr_sim(worse, clear), sr_sim(worse.float(), clear.float())
        assert single.dtype == torch.float32
        assert abs(float(single) - float(double)) < 1e-6
        assert float(sr_sim(worse.float().double(), clear.float().double())) == pytest.approx(float(double), abs=1e-6)


def _drawn(pattern: str) -> Tensor:
    """A drawing in 8 bits, ``(3, 96, 128)`` float64, of which many frequencies are exactly absent."""
    y, x = torch.meshgrid(torch.arange(96.0), torch.arange(128.0), indexing="ij")
    plane = {
        "bars": (x // 16) % 2,
        "checker": (x // 8 + y // 8) % 2,
        "disc": ((x - 64) ** 2 + (y - 48) ** 2 < 400).float(),
        "ramp": x / 127,
        "square": 0.2 + 0.5 * ((x > 40) & (x < 80) & (y > 40) & (y < 70)).float(),
        "sky": torch.where(y < 48, 0.8, 0.3 + y / 400),
        "point": ((x == 64) & (y == 48)).float(),
    }[pattern]
    return (255 * torch.stack([plane, 0.9 * plane, 0.8 * plane + 0.1])).round().double() / 255


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_identical_images_score_exactly_one(dtype: torch.dtype) -> None:
    clear = pair(2, 3, 65, 50, dtype=dtype)[1]
    assert sr_sim(clear, clear).tolist() == [1.0, 1.0]
    flat = torch.full_like(clear, 0.3)
    assert sr_sim(flat, flat).tolist() == [1.0, 1.0]


def test_constant_images() -> None:
    worse, clear = pair(3, 64, 64)
    flat = torch.full_like(clear, 0.3)
    for x, y in ((flat, clear), (worse, flat), (flat, flat + 0.2)):
        assert 0.0 < float(sr_sim(x, y)) < 1.0


@pytest.mark.parametrize("case", list(cases("srsim_chromatic")), ids=lambda case: case.name)
def test_oracle_with_colour(case: Case) -> None:
    found = float(sr_sim(case.distorted, case.reference, chromatic=True))
    assert found == pytest.approx(case.score, rel=0, abs=_tolerance(case))


def test_data_range() -> None:
    worse, clear = pair(3, 32, 32)
    assert float(sr_sim(255.0 * worse, 255.0 * clear, data_range=255.0)) == pytest.approx(float(sr_sim(worse, clear)))


def test_batch_gradients_symmetry_and_size() -> None:
    batch_gives_what_its_elements_give(sr_sim, 3, 32, 42)
    gradients_are_finite(sr_sim, 3, 32, 42)
    symmetric(sr_sim, 3, 32, 42)
    refuses_smaller_than(sr_sim, 12)
