"""How lists are read out: values that come again, speeds far off; against plain loops and the normal law."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats

from tests.gap.tiny_radar_study import tiny_radar_study
from torchweather.gap.sensors.radar.frames import RadarFrames
from torchweather.gap.sensors.radar.readout import FAR_OFF_SD, far_off, repeated
from torchweather.gap.sensors.radar.scene import MEASURED, Detections, RadarScene
from torchweather.gap.sensors.radar.sums import RadarSums
from torchweather.gap.statistics.frame_statistics import Reduced

CLEAR, FRAMES = 4, 3
Floats = NDArray[np.float64]


def test_repeated_is_a_loop_over_pairs() -> None:
    rng = np.random.default_rng(2)
    values = np.where(rng.random((5, 30)) < 0.2, np.nan, np.floor(rng.normal(0.0, 8.0, (5, 30))))
    for row, found in zip(values, repeated(values), strict=True):
        for n, one in enumerate(row):
            assert found[n] == any(one == other for k, other in enumerate(row) if k != n)


def test_noise_of_a_receiver_repeats_nothing() -> None:
    assert not repeated(np.random.default_rng(3).normal(-90.0, 10.0, (20, 500))).any()


def test_far_off_is_the_normal_law() -> None:
    rng = np.random.default_rng(4)
    number, sd = 400_000, 0.3
    share = far_off(sd * rng.standard_normal((1, number)), np.full((1, number), sd))[0].mean(0)
    for place, (low, high) in enumerate(itertools.pairwise(FAR_OFF_SD)):
        expected = 2.0 * (stats.norm.sf(low) - stats.norm.sf(high))
        chance = math.sqrt(expected / number)
        assert share[place] == pytest.approx(expected, abs=5.0 * chance + 1e-9)


@pytest.fixture(scope="module")
def model() -> RadarFrames:
    return RadarFrames(tiny_radar_study(seed=5, number=60, clear=CLEAR, frames=FRAMES))


def group(model: RadarFrames, frames: Reduced, statistic: str) -> tuple[Floats, Floats]:
    """Weights and values ``(F, bins)`` of the group of a statistic."""
    for one, part in zip(model.layout.binned, model.layout.slices, strict=False):
        if one.statistic == statistic:
            return frames.weight[:, part], frames.value[:, part]
    raise AssertionError(statistic)


def reduced(model: RadarFrames, scene: RadarScene, frames: Detections, portions: int = 1) -> Reduced:
    count, targets = frames.power_db.shape
    return RadarSums(scene, model.layout)(frames, np.arange(count), np.zeros(targets), np.zeros(count), portions)


@pytest.mark.parametrize("name", MEASURED)
def test_values_in_steps_are_seen_unless_clear_ones_are_too(model: RadarFrames, name: str) -> None:
    scene = model.scenes["s0"]
    values = getattr(scene.clear, name)
    step = 0.05 * float(np.nanmax(values) - np.nanmin(values))
    stepped = replace(scene.clear, **{name: np.floor(values / step) * step})
    statistic = f"repeated_{name.split('_')[0]}_share"
    assert group(model, reduced(model, scene, scene.clear), statistic)[1].sum() == 0
    weight, again = group(model, reduced(model, scene, stepped), statistic)
    for row in range(CLEAR):
        own = [float(one) for one in getattr(stepped, name)[row][scene.counted[row]] if not math.isnan(one)]
        assert weight[row, 0] == len(own)
        assert again[row, 0] == sum(own.count(one) > 1 for one in own) > 0.8 * len(own)
    weight, again = group(model, reduced(model, replace(scene, clear=stepped), stepped), statistic)
    assert weight.sum() == again.sum() == 0


def test_folded_speeds_are_far_off(model: RadarFrames) -> None:
    scene = model.scenes["s0"]
    speed = scene.clear.speed_m_per_s.copy()
    there = np.flatnonzero(~np.isnan(speed[0]) & scene.counted[0])
    far = (FAR_OFF_SD[-2] + 1.0) * scene.spread["speed_m_per_s"][0, there[:2]]
    speed[0, there[:2]] = scene.reference["speed_m_per_s"][0, there[:2]] + far * [1.0, -1.0]
    found = reduced(model, scene, replace(scene.clear, speed_m_per_s=speed))
    weight, value = group(model, found, "speed_far_off_share")
    assert value[0, -1] == 2
    assert value[1:, -1].sum() == 0
    assert (weight == weight[:, :1]).all()
    assert weight[0, 0] == len(there)
    parts = reduced(model, scene, replace(scene.clear, speed_m_per_s=speed), 4)
    for whole, some in zip((weight, value), group(model, parts, "speed_far_off_share"), strict=True):
        np.testing.assert_array_equal(some.reshape(CLEAR, 4, -1).sum(1), whole)


def test_two_clear_frames_tell_no_speed_far_off() -> None:
    model = RadarFrames(tiny_radar_study(seed=5, number=60, clear=2, frames=FRAMES))
    weight, value = group(model, model.clear("s0"), "speed_far_off_share")
    assert weight.sum() == value.sum() == 0
