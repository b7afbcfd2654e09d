"""What a further effect must explain where others act."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from torchweather.gap.inference.likelihood import ParameterPoint
from torchweather.gap.inference.model_error import explained_beside, response_of
from torchweather.gap.inference.systematics import Systematics

NAMES = ("c0", "c1")
NOTHING = Systematics(np.zeros((4, 1)), np.zeros(1), 0)


def search(start: list[float]) -> Any:
    """Two conditions of two entries; scatter 0.5."""

    def mean(point: ParameterPoint, frames: int) -> list[Any]:
        moved = sum(values["by"] for values in point.values.values()) + sum(point.log_intensity.values())
        return [np.array([moved, 0.0]), np.array([0.0, 2.0 * moved])]

    return SimpleNamespace(
        measured=[SimpleNamespace(condition=SimpleNamespace(id=name)) for name in NAMES],
        start=SimpleNamespace(mean=dict(zip(NAMES, np.array(start).reshape(2, 2), strict=True))),
        whitened=lambda base, change: np.concatenate(change) / 0.5,
        mean=mean,
    )


def fit(mean: list[float], nuisance: Systematics = NOTHING, point: ParameterPoint | None = None) -> Any:
    base = SimpleNamespace(mean=dict(zip(NAMES, np.array(mean).reshape(2, 2), strict=True)))
    return SimpleNamespace(base=base, nuisance=nuisance, point=point or ParameterPoint())


def test_what_acts_alike_shares_all_and_what_acts_elsewhere_nothing() -> None:
    found = fit([4.0, 0.0, 1.0, 2.0])  # from (1, 0, 1, 0): 3 and 2, whitened 6 and 4
    given = np.array([[6.0, 0.0, 0.0, 4.0], [-0.6, 0.0, 0.0, 0.4], [0.0, 9.0, 1.0, 0.0], [0.0, 0.0, 0.0, 7.0]])
    shared = explained_beside(search([1.0, 0.0, 1.0, 0.0]), found, given)
    # All of 36 + 16, whatever sign and length; nothing; the one entry's own 16.
    assert shared == pytest.approx([52.0, 52.0, 0.0, 16.0])


def test_no_error_of_a_first_effect_gives_a_further_one_more_than_its_share() -> None:
    """Off by 10 % anywhere along its signature: what any response gains of that is at most 1 % of what it shares."""
    generator = np.random.default_rng(3)
    signature, added = generator.normal(size=(2, 4))
    shared = explained_beside(search([0.0] * 4), fit((0.5 * signature).tolist()), added[None])[0]
    off = 0.1 * signature * generator.choice([-1.0, 1.0], size=(200, 4))
    gained = (off @ added) ** 2 / (added @ added)
    assert gained.max() <= 0.01 * shared * (1.0 + 1e-9)
    assert gained.max() > 0.999 * 0.01 * shared  # and it is reached


def test_what_nuisances_explain_counts_for_neither() -> None:
    clock = Systematics(np.array([[1e4], [0.0], [0.0], [0.0]]), np.zeros(1), 0)
    found = fit([4.0, 0.0, 1.0, 2.0], clock)
    shared = explained_beside(search([1.0, 0.0, 1.0, 0.0]), found, np.array([[99.0, 0.0, 0.0, 1.0]]))
    assert shared == pytest.approx([16.0], rel=1e-6)


def test_a_response_is_that_of_one_effect_beside_the_others_and_the_weather() -> None:
    point = ParameterPoint({"first": {"by": 5.0}, "further": {"by": 0.25}}, {"c0": 7.0})
    found = response_of(search([0.0] * 4), fit([0.0] * 4, point=point), "further")
    assert found == pytest.approx([0.5, 0.0, 0.0, 1.0])
