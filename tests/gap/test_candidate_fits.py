"""Where an effect is looked for that the nuisances can look like."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from torchweather.gap.candidate_fits import SETTLED_ROUNDS, _least, _settled_along
from torchweather.gap.candidates import lines
from torchweather.gap.matched import Node
from torchweather.gap.search import Setting
from torchweather.stages.effects_lidar import EFFECTS


def test_the_least_of_a_parabola_is_found_between_its_points() -> None:
    place = np.array([1.0, 1.13, 1.015, 0.985])  # in no order
    assert _least(place, 425.0 + 9e3 * (place - 1.064) ** 2) == pytest.approx(1.064, rel=1e-9)


def test_the_least_is_not_looked_for_beyond_the_points() -> None:
    place = np.array([0.0, 1.0, 2.0])
    assert _least(place, (place - 5.0) ** 2) == 2.0
    assert _least(place, (place + 5.0) ** 2) == 0.0
    # A hill has no least but its ends.
    assert _least(place, np.array([3.0, 4.0, 2.0])) == 2.0


@pytest.mark.parametrize("truth", [1.064, 0.93])
def test_nuisances_are_settled_beside_weak_strengths_of_either_sign(truth: float) -> None:
    """The misfit is a parabola of the factor: it is found exactly, whatever sign the response was of."""
    asked = []

    def settle(setting: Setting, rounds: int) -> Any:
        assert rounds == SETTLED_ROUNDS
        factor = setting.values["lidar.extinction_scale"]["factor"]
        asked.append(factor)
        return SimpleNamespace(setting=setting, misfit=200.0 + 5e4 * (factor - truth) ** 2)

    search: Any = SimpleNamespace(settle=settle, model=SimpleNamespace(sizes={}))
    (line, _) = lines(EFFECTS["lidar.extinction_scale"], [])
    node = Node(line, 0, line.settings[0], np.zeros(3))
    found = _settled_along(search, Setting(), node, 200.0 + 5e4 * (1.0 - truth) ** 2)
    assert found.misfit == pytest.approx(200.0, abs=1e-6)
    assert len(asked) == 5
    assert min(asked) < 1.0 < max(asked)


def test_an_effect_whose_identity_is_infinitely_far_is_settled_at_its_settings() -> None:
    asked = []

    def settle(setting: Setting, rounds: int) -> Any:
        asked.append(setting.values["lidar.limited_extent"]["extent_m"])
        return SimpleNamespace(setting=setting, misfit=abs(asked[-1] - 90.0))

    search: Any = SimpleNamespace(settle=settle, model=SimpleNamespace(sizes={}))
    (line,) = lines(EFFECTS["lidar.limited_extent"], [])
    found = _settled_along(search, Setting(), Node(line, 0, line.settings[0], np.zeros(3)), math.inf)
    assert found.setting.values["lidar.limited_extent"]["extent_m"] == min(asked, key=lambda one: abs(one - 90.0))
    assert len(asked) == 3
