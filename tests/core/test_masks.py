"""Comparisons and places by numpy against torch's."""

from __future__ import annotations

import operator

import pytest
import torch

from torchweather.core.masks import compare, ends_of, least_of, most_of, places_of

SIGNS = {"<": operator.lt, "<=": operator.le, ">": operator.gt, ">=": operator.ge}


@pytest.mark.parametrize("sign", list(SIGNS))
def test_comparisons_are_those_of_torch(sign: str) -> None:
    values = torch.tensor([[-1.0, 0.0, 0.1, torch.inf], [torch.nan, 2.0, -0.0, 0.3]])
    for bound in (0, 0.1, 0.3, torch.tensor([0.0, 0.0, torch.nan, 0.3]), torch.tensor(0.1)):
        found = compare(values, sign, bound)
        assert found.dtype == torch.bool
        assert torch.equal(found, SIGNS[sign](values, bound))
        assert torch.equal(compare(values.clone().requires_grad_(), sign, bound), found)
        assert bool(compare(values[0, 2], sign, bound).any()) == bool(SIGNS[sign](values[0, 2], bound).any())


@pytest.mark.parametrize("number", [0, 1, 1000])
def test_places_are_those_of_torch(number: int) -> None:
    mask = torch.rand(number, generator=torch.Generator().manual_seed(2)) > 0.4
    assert torch.equal(places_of(mask), mask.nonzero().squeeze(1))
    assert places_of(mask).dtype == torch.int64


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64, torch.bfloat16])
@pytest.mark.parametrize("shift", [0.0, 0.5, -0.5, -2.0])
def test_ends_are_those_of_torch(shift: float, dtype: torch.dtype) -> None:
    values = (torch.rand(3, 4, 5, generator=torch.Generator().manual_seed(1)) + shift).to(dtype)
    for some in (values, values[:, ::2], values[..., :1], values.clone().requires_grad_()):
        low, high = (float(end) for end in torch.aminmax(some.detach()))
        assert ends_of(some) == (low, high)
        assert (least_of(some), most_of(some)) == (low, high)
    values[1, 2, 3] = torch.inf
    assert ends_of(values)[1] == most_of(values) == torch.inf
    for nan in (torch.nan, -torch.nan):
        values[2, 0, 0] = nan
        assert all(end != end for end in (*ends_of(values), least_of(values), most_of(values)))
    assert ends_of(torch.tensor([-0.0, 0.0])) == (0.0, 0.0)
