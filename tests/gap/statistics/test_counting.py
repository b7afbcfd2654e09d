"""Scatter of stabilised counts and shares against draws of the law of counting."""

from __future__ import annotations

import numpy as np
import pytest

from torchweather.gap.statistics.counting import (
    ANSCOMBE,
    counted_variance,
    expected_number,
    root_variance,
    unseen_events,
)

DRAWS = 200_000
# Of a variance from so many draws, relative: sqrt((kurtosis - 1) / DRAWS), for a kurtosis up to 1 / expected + 3.
FIVE_SIGMA = 5.0


def known_to(expected: float) -> float:
    return FIVE_SIGMA * float(np.sqrt((1.0 / expected + 2.0) / DRAWS))


@pytest.mark.parametrize("expected", [0.02, 0.3, 1.0, 4.0, 30.0, 200.0])
def test_the_root_of_a_count_scatters_as_drawn_ones_do(expected: float) -> None:
    drawn = np.sqrt(np.random.default_rng(1).poisson(expected, DRAWS) + ANSCOMBE)
    assert float(root_variance(np.array(expected))) == pytest.approx(drawn.var(), rel=known_to(expected))


@pytest.mark.parametrize(("weight", "expected"), [(200, 0.1), (200, 1.0), (200, 10.0), (200, 100.0), (5000, 30.0)])
def test_a_share_scatters_as_drawn_ones_do(weight: int, expected: float) -> None:
    number = np.random.default_rng(2).binomial(weight, expected / weight, DRAWS)
    drawn = np.arcsin(np.sqrt((number + ANSCOMBE) / (weight + 2.0 * ANSCOMBE)))
    found = float(counted_variance("share", np.array([weight]), np.array([expected]))[0])
    # The root's variance stands for the arc sine's: off by the share of the elements that a count is, twice at most.
    assert found == pytest.approx(drawn.var(), rel=known_to(expected) + 2.0 * min(expected / weight, 0.02) + 0.01)


def test_what_was_never_seen_is_expected_as_half_an_event_in_all_frames() -> None:
    np.testing.assert_allclose(expected_number(np.zeros(2), np.array([10.0, 50.0]), 5), [0.25, 0.05])
    assert counted_variance("count", np.ones(1), np.zeros(1))[0] < 1e-3


def test_events_of_an_unknown_rate_are_predicted_without_bias() -> None:
    """A rate with Jeffreys' prior: the mean of what follows is what was expected, over all that could have been."""
    rng = np.random.default_rng(3)
    rate = rng.gamma(0.5, 40.0, 100_000)  # as flat as the prior over what 48 frames may show
    counted, then = rng.poisson(rate * 48), rng.poisson(rate * 6)
    ratio = (then.mean() - expected_number(counted, 48, 6).mean()) / then.mean()
    assert abs(ratio) < 0.001


def test_what_is_still_to_come_in_empty_bins_is_as_much_as_was_seen_once() -> None:
    """Of 200 bins 150 can never hold an event; the others have one in 5 to 1,000 frames. 48 frames, then six more."""
    rate = np.concatenate([np.zeros(150), 10.0 ** np.linspace(-3.0, -0.7, 50)])
    rng = np.random.default_rng(3)
    come, predicted, by_half_an_event = 0.0, 0.0, 0.0
    for _ in range(400):
        counted = rng.poisson(48.0 * rate).astype(float)
        empty = counted == 0.0
        come += rng.poisson(6.0 * rate)[empty].sum()
        predicted += expected_number(counted[empty], 48, 6, unseen_events(counted)).sum()
        by_half_an_event += expected_number(counted[empty], 48, 6).sum()
    # Some 440 events: 5 %, three of those. Half an event for each bin by itself is 10 times as much.
    assert predicted / come == pytest.approx(1.0, abs=0.15)
    assert by_half_an_event > 5.0 * come
