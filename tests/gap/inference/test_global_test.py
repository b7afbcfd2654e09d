"""Alarm of the whole model, on studies in which nothing is hidden."""

from __future__ import annotations

import pytest

from tests.gap.tiny_study import tiny_study
from torchweather.core.threads import one_thread_an_operation
from torchweather.gap.inference.effect_forms import effect_class
from torchweather.gap.inference.global_test import run_global_test
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
