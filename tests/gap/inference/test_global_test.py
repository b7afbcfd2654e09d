"""Alarm of the whole model, on studies in which nothing is hidden."""

from __future__ import annotations

import numpy as np
import pytest

from tests.gap.tiny_study import tiny_study
from torchweather.core.threads import one_thread_an_operation
from torchweather.gap.inference.effect_forms import effect_class
from torchweather.gap.inference.global_test import best_of_places, run_global_test
from torchweather.gap.inference.likelihood import SimulatorLikelihood
from torchweather.gap.inference.simulated_distribution import observations
from torchweather.gap.sensors.lidar.frames import LidarFrames


# A lost beam or two where none was simulated: 24 of delta chi-square and 3e-7 by one statistic, as long as each event
# was counted along six axes, and a second one in a bin by as much as the first.
@pytest.mark.parametrize("seed", [0, 6])
def test_a_few_lost_beams_are_no_alarm(seed: int) -> None:
    model = LidarFrames(tiny_study([], seed=seed))
    with one_thread_an_operation():
        search = SimulatorLikelihood(model, observations(model, model.fit), 0)
        effects = [effect_class(model, name) for name in model.catalogue]
        found = run_global_test(search, effects, search.begin(), 0)
    assert found.p_value > 0.01


def test_a_null_is_tried_at_the_best_of_its_places() -> None:
    """Gains of chi-square at each of eight places, of which one was chosen: the best of eight, where a null may."""
    number, places = 20_000, 8
    rng = np.random.default_rng(4)
    every = rng.chisquare(1, (number, places))
    gains = np.stack([rng.chisquare(1, number), every[:, 0]], 1)
    found = best_of_places(gains, np.array([False, True]), places, 0)
    slow = np.maximum(gains[:, 0], every.max(1))
    for share in (0.5, 0.9, 0.99):
        # The error of a quantile of chi-square, five of those.
        here = np.quantile(slow, share)
        assert (found > here).mean() == pytest.approx(1.0 - share, abs=5.0 * np.sqrt(share * (1.0 - share) / number))
    alone = best_of_places(gains, np.array([False, False]), places, 0)
    np.testing.assert_array_equal(alone, gains.max(1))
