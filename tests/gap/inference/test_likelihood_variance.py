"""The likelihood of a simulation charges a wider scatter by its logarithm."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from torchweather.gap.inference.likelihood import SimulatorLikelihood
from torchweather.gap.statistics.frame_statistics import Group, Layout

LAYOUT = Layout((Group("ratio", "x", "mean", (0.0, 1.0, 2.0, 3.0)),), (), (), ())


def base(sd: list[float], used: list[bool]) -> Any:
    return SimpleNamespace(sd={"c0": np.array(sd)}, used={"c0": np.array(used)}, independent={"c0": np.zeros(3)})


def test_twice_the_scatter_costs_two_ln_two_an_entry_that_counts() -> None:
    """``-2 ln L`` of a Gaussian has ``2 ln sd``; without it, the widest simulation would always fit best."""
    search: Any = SimpleNamespace(
        model=SimpleNamespace(layout=LAYOUT),
        measured=[SimpleNamespace(condition=SimpleNamespace(id="c0"))],
        start=base([0.5, 0.5, 0.5], [True, True, False]),
    )
    assert SimulatorLikelihood._wider(search, base([0.5, 0.5, 0.5], [True] * 3)) == pytest.approx(0.0)
    assert SimulatorLikelihood._wider(search, base([1.0, 1.0, 9.0], [True] * 3)) == pytest.approx(4.0 * math.log(2.0))
    assert SimulatorLikelihood._wider(search, base([1.0, 1.0, 9.0], [True, False, True])) == pytest.approx(
        2.0 * math.log(2.0)
    )
