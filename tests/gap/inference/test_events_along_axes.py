"""Counts of the same events along several axes, against events drawn one by one."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from torchweather.gap.inference.config import NUMERICS, SCATTER
from torchweather.gap.inference.events_along_axes import EventsAlongAxes, events_along_axes
from torchweather.gap.inference.simulated_distribution import ElementNoise, Whitening
from torchweather.gap.statistics.frame_statistics import Group, Layout, Pool, Reduced

RANGE, AZIMUTH = np.array([0.5, 0.3, 0.2]), np.array([0.1, 0.2, 0.3, 0.4])  # shares of the events in each bin
ISOLATED = np.array([0.6, 0.4])  # the same of another statistic that counts the same events
LAYOUT = Layout(
    (
        Group("lost", "range_m", "count", (0.0, 1.0, 2.0, 3.0)),
        Group("lost", "azimuth_rad", "count", (0.0, 1.0, 2.0, 3.0, 4.0)),
        Group("thin", "isolated", "count", (0.0, 1.0, 2.0)),
        Group("ratio", "range_m", "mean", (0.0, 1.0)),
    ),
    (),
    (),
    (),
    same_events={"thin": "lost"},
)
COUNTS = 9  # entries that are counts


def made(per_frame: float, frames: int) -> Pool:
    """Frames with the same share of the events each."""
    value = per_frame * np.concatenate([RANGE, AZIMUTH, ISOLATED, [0.0]])
    values = np.tile(value, (frames, 1))
    empty = np.zeros((frames, 0))
    return Pool(LAYOUT, Reduced(np.ones_like(values), values, values, empty, empty[..., None]), np.arange(frames))


def drawn(mean: float, number: int) -> NDArray[np.float64]:
    """Counts of measurements of Poisson events, each in one bin of every axis."""
    rng = np.random.default_rng(3)
    found = np.zeros((number, LAYOUT.size))
    for row in found:
        for _ in range(rng.poisson(mean)):
            row[rng.choice(3, p=RANGE)] += 1.0
            row[3 + rng.choice(4, p=AZIMUTH)] += 1.0
            row[7 + rng.choice(2, p=ISOLATED)] += 1.0
    return found


def test_correlations_are_those_of_events_that_are_counted_on_every_axis() -> None:
    number, mean = 4000, 2.0
    found = events_along_axes(LAYOUT, {"snow": made(mean, NUMERICS.pool_frames)}).correlation
    counts = drawn(mean, number)[:, :COUNTS]
    # The scatter of a correlation of so many, five of those; the prior of half an event in 96 moves it by 1 %.
    np.testing.assert_allclose(found[:COUNTS, :COUNTS], np.corrcoef(counts.T), atol=5.0 / np.sqrt(number) + 0.01)
    assert found[COUNTS, COUNTS] == 1.0
    assert np.all(found[COUNTS, :COUNTS] == 0.0)


@pytest.mark.parametrize(("per_frame", "low", "high"), [(0.0, 1.0, 1.0), (20.0, 0.02, 0.3), (1000.0, 0.0, 0.01)])
def test_portions_are_believed_where_they_hold_events(per_frame: float, low: float, high: float) -> None:
    unseen = events_along_axes(LAYOUT, {"snow": made(per_frame, 48)}).unseen
    assert np.all((unseen[:COUNTS] >= low) & (unseen[:COUNTS] <= high))
    assert unseen[COUNTS] == 0.0


def test_one_event_at_an_unseen_place_departs_once() -> None:
    events = events_along_axes(LAYOUT, {"snow": made(0.0, 48)})
    noise = ElementNoise({"snow": np.zeros(LAYOUT.size)}, np.zeros((LAYOUT.size, LAYOUT.size)))
    whitening = Whitening.of(noise, {"snow": np.ones(LAYOUT.size)}, events)
    everywhere = np.zeros(LAYOUT.size)
    for part in LAYOUT.slices[:3]:
        everywhere[part] = 1.0 / np.sqrt(part.stop - part.start)  # as events go on each axis
    apart = whitening(everywhere)
    # Three axes that are alike but for the shrinkage count as one; without correlations they count as three.
    assert apart @ apart == pytest.approx(3.0 / (1.0 + 2.0 * (1.0 - SCATTER.shrinkage)))
    alone = EventsAlongAxes(np.eye(LAYOUT.size), events.unseen)
    apart = Whitening.of(noise, {"snow": np.ones(LAYOUT.size)}, alone)(everywhere)
    assert apart @ apart == pytest.approx(3.0)
