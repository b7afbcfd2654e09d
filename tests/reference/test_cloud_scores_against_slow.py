"""The cloud scores of the package against loops over points, on small clouds of many kinds."""

from __future__ import annotations

import itertools
import math
import statistics
from typing import Any

import pytest
import torch
from torch import Tensor

from tests.reference.slow_cloud_scores import (
    Box,
    slow_cloud_scores,
    slow_counts,
    slow_double_validation,
    slow_index_rmse,
    slow_verdict,
)
from torchweather.metrics import CLOUD_SCORES, Region, cloud_scores, double_validation, expected_trends, point_counts

NAMES = (*CLOUD_SCORES, "chamfer", "chamfer_squared")
# Sums of a few hundred float64 in another order.
TOLERANCE = 1e-12


def draw(n: int, seed: int, spread_m: float = 10.0) -> Tensor:
    return spread_m * torch.randn(n, 3, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


def grid(n: int, seed: int) -> Tensor:
    """Many equal distances and copies of points."""
    return torch.randint(-2, 4, (n, 3), generator=torch.Generator().manual_seed(seed)).double()


def lost(n: int, seed: int) -> Tensor:
    """Every third row is no point."""
    points = draw(n, seed)
    points[::6] = 0.0
    points[3::6, 1] = math.nan
    points[5::12, 2] = math.inf
    return points


PAIRS: dict[str, tuple[Tensor, Tensor]] = {
    "equal sizes": (draw(30, 1), draw(30, 2)),
    "few against many": (draw(3, 3), draw(45, 4)),
    "one against many": (draw(1, 5), draw(20, 6)),
    "two against two": (draw(2, 7), draw(2, 8)),
    "a fifth moved": (torch.cat((draw(24, 9)[:19], draw(24, 9)[19:] * 0.2)), draw(24, 9)),
    "on a grid": (grid(40, 10), grid(25, 11)),
    "with lost rows": (lost(60, 12), lost(72, 13)),
    "far from the origin": (draw(20, 14) + 1e5, draw(22, 15) + 1e5),
    "in a line": (draw(20, 16) * torch.tensor([1.0, 0.0, 0.0]).double(), draw(21, 17) * torch.tensor([1.0, 0.0, 0.0])),
    "none shared": (draw(15, 18) + 500.0, draw(15, 19)),
}


@pytest.mark.parametrize("search", ["tree", "exhaustive"])
@pytest.mark.parametrize("case", list(PAIRS))
def test_scores_are_those_of_the_loops(case: str, search: str) -> None:
    p, r = PAIRS[case]
    wanted = slow_cloud_scores(p.tolist(), r.tolist())
    found = {name: float(score) for name, score in cloud_scores(p, r, names=NAMES, search=search).items()}
    assert found == pytest.approx(wanted, rel=TOLERANCE, abs=TOLERANCE)
    turned = {name: float(score) for name, score in cloud_scores(r, p, names=NAMES, search=search).items()}
    assert turned == pytest.approx(wanted, rel=TOLERANCE, abs=TOLERANCE)


def test_the_loops_know_a_triangle() -> None:
    """Two points 3 m apart against one, at the middle: 1.5 m either way, and a shape against none."""
    found = slow_cloud_scores([[1.0, 0.0, 0.0], [4.0, 0.0, 0.0]], [[2.5, 0.0, 0.0], [0.0, 0.0, 0.0]])
    ones = dict.fromkeys(("rmse", "mde", "mmde", "hd", "hd95"), 1.5)
    assert found == {"sdm": 1.0, **ones, "chamfer": 3.0, "chamfer_squared": 4.5}


@pytest.mark.parametrize("case", ["equal sizes", "a fifth moved", "two against two"])
def test_index_rmse_is_that_of_the_loops(case: str) -> None:
    p, r = PAIRS[case]
    found = cloud_scores(p, r, names=("rmse",), correspondence="index")["rmse"]
    assert float(found) == pytest.approx(slow_index_rmse(p.tolist(), r.tolist()), rel=TOLERANCE)


def test_index_rmse_of_rows_that_either_lost_or_that_leave_the_region() -> None:
    p, r = lost(36, 20), lost(36, 21).roll(1, 0)
    found = float(cloud_scores(p, r, names=("rmse",), correspondence="index")["rmse"])
    assert found == pytest.approx(slow_index_rmse(p.tolist(), r.tolist()), rel=TOLERANCE)
    box: Box = ((-14.0, 15.0), (-math.inf, 12.0), (-11.0, math.inf))
    bounded = cloud_scores(p, r, names=("rmse",), correspondence="index", region=Region(*box))["rmse"]
    assert float(bounded) == pytest.approx(slow_index_rmse(p.tolist(), r.tolist(), box), rel=TOLERANCE)
    assert float(bounded) != pytest.approx(found, rel=0.01)


@pytest.mark.parametrize("case", ["equal sizes", "on a grid", "with lost rows"])
def test_scores_and_counts_in_a_region_with_points_on_its_faces(case: str) -> None:
    p, r = PAIRS[case]
    box: Box = ((-1.0, 15.0), (-9.0, 3.0), (-math.inf, 9.0))
    wanted = slow_cloud_scores(p.tolist(), r.tolist(), box)
    found = {name: float(score) for name, score in cloud_scores(p, r, names=NAMES, region=Region(*box)).items()}
    assert found == pytest.approx(wanted, rel=TOLERANCE, abs=TOLERANCE)
    kind = torch.arange(len(p)) % 3
    counts = point_counts(p, kind, region=Region(*box)).tolist()
    assert counts == slow_counts(p.tolist(), kind.tolist(), box)
    assert 0 < sum(counts) < len(p)
    assert int(point_counts(p, region=Region(*box))) == sum(counts)
    assert point_counts(p, kind).tolist() == [len(p) // 3 + (which < len(p) % 3) for which in range(3)]  # lost ones too


def test_drawn_pairs_are_close_to_all_pairs() -> None:
    """1500 copies of 15 points: every pair of places as often, up to the pairs of a point with its copy."""
    p, r = draw(15, 22), draw(15, 23, 14.0)
    many = float(cloud_scores(p.repeat(100, 1), r.repeat(100, 1), names=("sdm",))["sdm"])
    few = slow_cloud_scores(p.repeat(2, 1).tolist(), r.repeat(2, 1).tolist())["sdm"]
    # A share of 99 / 1499 of the pairs is of one place, against 1 / 29: mu falls by 3 % on both sides and W as much;
    # 2^20 draws add 0.6 sqrt(2) / 2^10 = 0.0008 in a standard deviation.
    assert many == pytest.approx(few, abs=4 * 0.0008 + 0.03 * few)
    assert few > 0.1


SAMPLES: dict[str, tuple[list[float], list[float]]] = {
    "whole numbers": ([3.0, 1.0, 2.0, 2.0, 9.0], [0.0, 0.0, 1.0]),
    "one against many": ([4.0], [0.5, 0.25, 8.0, -3.0]),
    "spread": (draw(7, 24).flatten().tolist(), draw(11, 25, 3.0).flatten().tolist()),
}


@pytest.mark.parametrize("centre", ["median", "mean"])
@pytest.mark.parametrize("case", list(SAMPLES))
def test_bias_and_scatter_are_those_of_the_loops(case: str, centre: str) -> None:
    simulated, measured = SAMPLES[case]
    bias, area = slow_double_validation(simulated, measured, getattr(statistics, centre))
    found = double_validation(
        *(torch.tensor(values, dtype=torch.float64) for values in (simulated, measured)), centre=centre
    )
    assert float(found.bias) == pytest.approx(bias, rel=TOLERANCE, abs=TOLERANCE)
    assert float(found.scatter) == pytest.approx(area, rel=TOLERANCE, abs=TOLERANCE)


@pytest.mark.parametrize("direction", ["up", "down"])
def test_verdicts_are_those_of_the_loops_for_all_scores_of_three_values(direction: str) -> None:
    """All 340 rows of up to four levels of 1, 2, 3 or none."""
    rows: list[Any] = [row for n in range(1, 5) for row in itertools.product((1.0, 2.0, 3.0, None), repeat=n)]
    assert len(rows) == 340
    for row in rows:
        trends = expected_trends({"road": {"score": list(row)}}, {"score": direction})["road"]
        assert trends.metrics["score"].verdict == slow_verdict(row, direction == "up"), row
        assert trends.expected == (slow_verdict(row, direction == "up") == "expected")
        assert trends.out_of == (sum(score is not None for score in row) > 1)
