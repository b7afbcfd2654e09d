"""Haar wavelet-based perceptual similarity against the oracle."""

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
from torchweather.metrics.haarpsi import haarpsi


@pytest.mark.parametrize("case", list(cases("haarpsi")), ids=lambda case: case.name)
def test_oracle(case: Case) -> None:
    assert float(haarpsi(case.distorted, case.reference)) == pytest.approx(case.score, rel=0, abs=1e-6)
    single = haarpsi(case.distorted.float(), case.reference.float())
    assert float(single) == pytest.approx(case.score, rel=0, abs=1e-4)


@pytest.mark.parametrize("case", list(cases("haarpsi", "float32")), ids=lambda case: case.name)
def test_oracle_in_float32(case: Case) -> None:
    assert float(haarpsi(case.distorted, case.reference)) == pytest.approx(case.score, rel=0, abs=1e-4)


@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_identical_images_score_one(dtype: torch.dtype, channels: int) -> None:
    clear = pair(2, channels, 37, 26, dtype=dtype)[1]
    assert haarpsi(clear, clear).tolist() == [1.0, 1.0]


def test_the_least_change_does_not_exceed_one() -> None:
    clear = pair(3, 24, 24, dtype=torch.float32)[1].clamp(0.1, 0.9)
    noise = torch.rand(clear.shape, generator=torch.Generator().manual_seed(6))
    for step in (1e-7, 1e-6, 1e-5, 1e-4, 1e-3):
        assert 0.99 < float(haarpsi(clear + step * noise, clear)) <= 1.0


def test_constant_images() -> None:
    flat = torch.full((3, 16, 16), 0.3, dtype=torch.float64)
    assert float(haarpsi(flat, flat)) == 1.0
    assert float(haarpsi(0.0 * flat, 0.0 * flat)) == 1.0  # no weight anywhere
    assert 0.0 <= float(haarpsi(flat, flat + 0.2)) < 1.0  # the border against the zeros around


def test_colour_alone_shows() -> None:
    clear = pair(3, 32, 32)[1].clamp(0.0, 0.7)
    worse = clear + torch.tensor([0.114, 0.0, -0.299], dtype=torch.float64).reshape(3, 1, 1) * 0.5
    worse, clear = worse + 0.2, clear + 0.2
    luma = torch.tensor([0.299, 0.587, 0.114], dtype=torch.float64)
    grey = [(luma @ image.flatten(1)).reshape(1, 32, 32) for image in (worse, clear)]
    assert float(haarpsi(*grey)) == pytest.approx(1.0, abs=1e-9)
    assert float(haarpsi(worse, clear)) < 0.95


def test_data_range() -> None:
    worse, clear = pair(3, 24, 24)
    assert float(haarpsi(255.0 * worse, 255.0 * clear, data_range=255.0)) == pytest.approx(float(haarpsi(worse, clear)))


@pytest.mark.parametrize("channels", [1, 3])
def test_batch_gradients_symmetry_and_size(channels: int) -> None:
    batch_gives_what_its_elements_give(haarpsi, channels, 25, 32)
    gradients_are_finite(haarpsi, channels, 25, 32)
    symmetric(haarpsi, channels, 25, 32)
    refuses_smaller_than(haarpsi, 16, channels)
