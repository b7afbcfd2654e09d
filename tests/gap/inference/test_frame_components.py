"""Components of variance within and between clear frames against frames whose components are known."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from torchweather.gap.inference.frame_components import between_share, frame_components
from torchweather.gap.statistics.frame_statistics import Group, Layout, Pool, Reduced

BINS, WEIGHT = 200, 50.0
LAYOUT = Layout((Group("level", "x", "mean", tuple(float(one) for one in range(BINS + 1))),), ("level",), (0.0,), ())


def made(within: float, between: float, frames: int, clear: int, seed: int) -> Pool:
    """Frames of means with standard deviations from frame to frame and from clear frame to clear frame."""
    rng = np.random.default_rng(seed)
    start = np.arange(frames) % clear
    base: NDArray[np.float64] = between * rng.normal(size=(clear, BINS))
    mean = base[start] + within * rng.normal(size=(frames, BINS))
    weight = np.full((frames, BINS), WEIGHT)
    scalar = mean[:, :1]
    return Pool(LAYOUT, Reduced(weight, weight * mean, weight * mean**2, scalar, np.zeros((frames, 0, 1))), start)


@pytest.mark.parametrize(("within", "between"), [(1.0, 0.0), (0.0, 1.0), (1.0, 2.0)])
@pytest.mark.parametrize("clear", [2, 8])
def test_components_are_those_that_were_put_in(within: float, between: float, clear: int) -> None:
    number, frames = 4, 48
    found = frame_components(made(within, between, frames, clear, 5), number)
    # 200 bins of frames - clear and of clear - 1 degrees of freedom; five standard deviations.
    of_within = 5.0 * np.sqrt(2.0 / (BINS * (frames - clear)))
    of_between = 5.0 * np.sqrt(2.0 / (BINS * (clear - 1))) * (between**2 + within**2 * clear / frames)
    part = found.within[:BINS] * number
    assert part.mean() == pytest.approx(within**2, rel=of_within, abs=1e-9)
    assert (found.between[:BINS] * number).mean() == pytest.approx(between**2, abs=of_between + 1e-9)
    assert not found.within[BINS:].any()  # of what is no sum over bins nothing is said


def test_the_share_between_clear_frames_is_pooled_over_bins_and_conditions() -> None:
    parts = {str(seed): frame_components(made(1.0, 1.0, 48, 2, seed), 4) for seed in range(4)}
    share = between_share(LAYOUT, parts)
    assert set(share[:BINS]) == {share[0]}
    # Of each bin one degree of freedom, 800 in all: a square of 1 to 7 %; the share of W in it is known.
    assert share[0] == pytest.approx(0.5, abs=0.2)
    assert between_share(LAYOUT, {"a": frame_components(made(1.0, 0.0, 48, 2, 9), 4)})[0] < 0.1
    assert between_share(LAYOUT, {"a": frame_components(made(0.0, 1.0, 48, 2, 9), 4)})[0] == pytest.approx(1.0)


def test_a_single_clear_frame_tells_nothing_between() -> None:
    found = frame_components(made(1.0, 0.0, 48, 1, 0), 4)
    assert not found.between.any()
    assert found.within[:BINS].any()
