"""Counts of points in a region and of a kind."""

from __future__ import annotations

import math

import pytest
import torch

from torchweather.metrics.clouds import Region
from torchweather.metrics.point_counts import KINDS, point_counts
from torchweather.stages import PointKind

POINTS = torch.tensor(
    [[5.0, 0.0, 0.0], [1.0, 1.0, 0.0], [30.0, 0.0, 2.0], [0.0, 0.0, 0.0], [math.nan, 0.0, 0.0], [28.0, -3.0, 0.0]]
)
KIND = torch.tensor([0, 1, 0, 2, 2, 1], dtype=torch.int8)


def test_there_are_as_many_kinds_as_the_stages_know() -> None:
    assert len(PointKind) == KINDS


def test_points_that_are_there() -> None:
    assert point_counts(POINTS).tolist() == 4
    assert point_counts(POINTS, region=Region(x_m=(0.0, 28.0))).tolist() == 3  # its faces are inside
    assert point_counts(POINTS, region=Region(x_m=(0.0, 28.0), y_m=(0.0, 9.0))).tolist() == 2


def test_kinds() -> None:
    assert point_counts(POINTS, KIND).tolist() == [2, 2, 2]
    assert point_counts(POINTS, KIND, region=Region(x_m=(-1.0, 28.0))).tolist() == [1, 2, 0]  # lost beams are nowhere
    assert point_counts(POINTS, KIND, valid=torch.arange(6) < 4).tolist() == [2, 1, 1]
    assert point_counts(POINTS, KIND, kinds=4).tolist() == [2, 2, 2, 0]


def test_kinds_sum_to_the_rows_and_regions_to_the_points() -> None:
    points = torch.randn(2, 3, 500, 4, generator=torch.Generator().manual_seed(1))
    kind = torch.randint(0, 2, (2, 3, 500), generator=torch.Generator().manual_seed(2))
    assert torch.equal(point_counts(points, kind).sum(-1), torch.full((2, 3), 500))
    near, far = Region(x_m=(-math.inf, 0.0)), Region(x_m=(1e-30, math.inf))
    halves = point_counts(points, kind, region=near) + point_counts(points, kind, region=far)
    assert torch.equal(halves, point_counts(points, kind))


def test_empty_and_wrong_input() -> None:
    assert point_counts(torch.zeros(0, 3)).tolist() == 0
    assert point_counts(torch.zeros(0, 3), torch.zeros(0, dtype=torch.int64)).tolist() == [0, 0, 0]
    with pytest.raises(ValueError, match="kind must hold integers from 0 to 2"):
        point_counts(POINTS, KIND + 1)
    with pytest.raises(ValueError, match=r"kind must be \(6,\); got \(5,\)"):
        point_counts(POINTS, KIND[:5])
    with pytest.raises(ValueError, match=r"points must be a tensor \(..., N, 3 or more\)"):
        point_counts(torch.zeros(6, 2))
