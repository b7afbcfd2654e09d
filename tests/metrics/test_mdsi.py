"""Mean deviation similarity index against the oracle."""

from __future__ import annotations

import importlib
from functools import partial

import pytest
import torch
from torch import Tensor

from tests.metrics.behaviour import (
    batch_gives_what_its_elements_give,
    gradients_are_finite,
    pair,
    refuses_smaller_than,
)
from tests.metrics.iqa import Case, cases
from torchweather.metrics.mdsi import mdsi

MODULE = importlib.import_module("torchweather.metrics.mdsi")


def _complex(value: Tensor) -> Tensor:
    return torch.complex(value, torch.zeros_like(value))


@pytest.mark.parametrize("case", list(cases("mdsi")), ids=lambda case: case.name)
def test_oracle(case: Case) -> None:
    assert float(mdsi(case.distorted, case.reference)) == pytest.approx(case.score, rel=0, abs=1e-6)
    single = mdsi(case.distorted.float(), case.reference.float())
    assert float(single) == pytest.approx(case.score, rel=0, abs=1e-4)


@pytest.mark.parametrize("case", list(cases("mdsi", "float32")), ids=lambda case: case.name)
def test_oracle_in_float32(case: Case) -> None:
    assert float(mdsi(case.distorted, case.reference)) == pytest.approx(case.score, rel=0, abs=1e-4)


@pytest.mark.parametrize("case", list(cases("mdsi_mult")), ids=lambda case: case.name)
def test_oracle_of_the_product(case: Case, monkeypatch: pytest.MonkeyPatch) -> None:
    """The oracle multiplies real parts and adds imaginary parts: with that slip all agrees; without it nearly."""
    score = partial(mdsi, case.distorted, case.reference, combination="product")
    # largest distance 9.3e-4, on the heaviest veil, where the similarity of 0.8 % of the pixels is below 0
    assert float(score()) == pytest.approx(case.score, rel=0, abs=1e-3)

    def slip(edges: Tensor, colours: Tensor, combination: str) -> tuple[Tensor, Tensor]:
        one, other = _complex(edges) ** 0.2, _complex(colours) ** 0.1
        root = torch.complex(one.real * other.real, one.imag + other.imag) ** 0.25
        return root.real, root.imag

    monkeypatch.setattr(MODULE, "_complex_root", slip)
    assert float(score()) == pytest.approx(case.score, rel=0, abs=1e-6)


def test_roots_are_those_of_complex_numbers() -> None:
    values = torch.tensor([-2.0, -0.3, 0.0, 0.4, 3.0], dtype=torch.float64)
    edges, colours = torch.meshgrid(values, values, indexing="ij")
    product = (_complex(edges) ** 0.2 * _complex(colours) ** 0.1) ** 0.25
    torch.testing.assert_close(torch.complex(*MODULE._complex_root(edges, colours, "product")), product)
    total = _complex(0.6 * edges + 0.4 * colours) ** 0.25
    torch.testing.assert_close(torch.complex(*MODULE._complex_root(edges, colours, "sum")), total)


@pytest.mark.parametrize("combination", ["sum", "product"])
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_identical_images_score_zero(dtype: torch.dtype, combination: str) -> None:
    clear = pair(2, 3, 31, 26, dtype=dtype)[1]
    assert mdsi(clear, clear, combination=combination).tolist() == [0.0, 0.0]
    large = pair(1, 390, 391, dtype=dtype)[1]  # shrunk twofold
    assert float(mdsi(large, large, combination=combination)) == 0.0


def test_constant_images() -> None:
    flat = torch.full((3, 16, 16), 0.3, dtype=torch.float64)
    assert float(mdsi(flat, flat)) == 0.0
    assert 0.0 < float(mdsi(flat, flat + 0.2)) < 1.0  # the border against the zeros around


def test_colour_alone_shows() -> None:
    clear = pair(3, 32, 32)[1].clamp(0.0, 0.7)
    shift = torch.tensor([0.0570, 0.0, -0.14945], dtype=torch.float64).reshape(3, 1, 1)  # of one luminance
    worse = clear + torch.where(torch.arange(32) < 16, shift, 0.0 * shift)
    assert float(mdsi(worse + 0.2, clear + 0.2)) > 0.1
    assert float(mdsi(worse + 0.2, worse + 0.2)) == 0.0


def test_not_symmetric() -> None:
    worse, clear = pair(3, 48, 48)
    assert abs(float(mdsi(worse, clear)) - float(mdsi(clear, worse))) > 1e-3


def test_data_range() -> None:
    worse, clear = pair(3, 24, 24)
    assert float(mdsi(255.0 * worse, 255.0 * clear, data_range=255.0)) == pytest.approx(float(mdsi(worse, clear)))


def test_unknown_combination() -> None:
    with pytest.raises(ValueError, match="'sum' or 'product'; got 'mult'"):
        mdsi(*pair(3, 8, 8), combination="mult")


@pytest.mark.parametrize("combination", ["sum", "product"])
def test_batch_gradients_symmetry_and_size(combination: str) -> None:
    score = partial(mdsi, combination=combination)
    batch_gives_what_its_elements_give(score, 3, 25, 32)
    gradients_are_finite(score, 3, 25, 32)
    refuses_smaller_than(score, 3)
