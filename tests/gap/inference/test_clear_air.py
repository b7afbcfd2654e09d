"""Clear frames against clear frames: halves that agree, a laser that drifts, too few frames."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np

from torchweather.gap.inference.clear_air import ClearAir, clear_air
from torchweather.gap.inference.config import SCATTER
from torchweather.gap.statistics.frame_statistics import Group, Layout, Reduced

BINS, WEIGHT = 6, 400.0
EDGES = tuple(float(place) for place in range(BINS + 1))
LAYOUT = Layout(
    (Group("log_intensity_ratio", "range_m", "mean", EDGES), Group("lost_share", "range_m", "share", EDGES)),
    ("lost_share",),
    (1e-3,),
    (),
)


def frames(number: int, seed: int, drift: float = 0.0) -> Reduced:
    """Means of noise, with a drift from the first frame to the last; shares of a tenth."""
    rng = np.random.default_rng(seed)
    mean = rng.normal(size=(number, BINS)) / np.sqrt(WEIGHT)
    mean += drift * np.linspace(0.0, 1.0, number)[:, None]
    lost = rng.binomial(int(WEIGHT), 0.1, (number, BINS))
    weight = np.full((number, 2 * BINS), WEIGHT)
    value = np.concatenate([WEIGHT * mean, lost], 1)
    square = np.concatenate([WEIGHT * (mean**2 + 1.0), lost], 1)
    return Reduced(weight, value, square, rng.normal(size=(number, 1)), np.zeros((number, 0, 1)))


def found(seed: int = 0, **scenes: Reduced) -> list[ClearAir]:
    model: Any = SimpleNamespace(
        layout=LAYOUT,
        clear_frames={name: len(frames) for name, frames in scenes.items()},
        clear=lambda name: scenes[name],
    )
    return clear_air(model, seed)


def test_halves_of_steady_frames_differ_as_halves_drawn_at_random() -> None:
    chances = [found(s0=frames(12, seed))[0].p_value for seed in range(60)]
    # Uniform chances: 0.29 / sqrt(60) of their mean, four of those.
    assert abs(np.mean(chances) - 0.5) < 0.15
    assert 0.1 < np.mean(np.array(chances) < 0.3) < 0.5


def test_a_laser_that_drifts_is_told_with_what_and_by_how_much() -> None:
    (one,) = found(s0=frames(12, 1, drift=-1.0))
    # Of 924 ways to halve 12 frames two are as far apart.
    assert one.p_value < 0.01
    assert (one.scene, one.statistic, one.axis) == ("s0", "log_intensity_ratio", "range_m")
    # The drift is 0.55 from half to half; halves at random differ by 0.33 / sqrt(3).
    assert 2.0 < one.z < 4.0


def test_scenes_with_too_few_frames_are_left_out() -> None:
    few = SCATTER.clear_frames_min - 1
    assert [one.scene for one in found(s0=frames(few, 1), s1=frames(SCATTER.clear_frames_min, 1))] == ["s1"]


def test_frames_that_are_copies_do_not_differ() -> None:
    one = frames(1, 2)
    same = Reduced.joined([one] * 8)
    (answer,) = found(s0=same)
    assert (answer.p_value, answer.z) == (1.0, 0.0)
