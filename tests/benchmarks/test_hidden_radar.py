"""The generator of the radar bench: how strong an effect counts."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.gap_bench.generator.radar.design import Size, draw_design
from benchmarks.gap_bench.generator.radar.detectability import LEAST_OF_COUNT, Statistics
from benchmarks.gap_bench.generator.radar.radar_sensor import Weather, shoot, study_radar

FRAMES = 6


@pytest.mark.parametrize("more", [3.0, 6.0, 12.0, 30.0])
def test_a_few_rare_counts_are_as_strong_as_the_likelihood_of_poisson_s_law_says(more: float) -> None:
    """Of a bin that has 0.02 detections a frame by chance, and so many more in six frames.

    Expected is ``2 ((b + s) ln(1 + s / b) - s)``, twice the logarithm of the ratio of likelihoods; the squared d' of
    the root of the counts with its least scatter is that within a factor of two. By the roots' own scatter it is ten
    times too much.
    """
    rng = np.random.default_rng(3)
    background = 0.02 * FRAMES
    expected = 2.0 * ((background + more) * np.log1p(more / background) - more)
    with_, without = (
        np.sqrt(rng.poisson(mean / FRAMES, (4000, FRAMES)) + 0.375).mean(1) for mean in (background + more, background)
    )
    change = with_.mean() - without.mean()
    counted = (change / (LEAST_OF_COUNT / np.sqrt(FRAMES))) ** 2
    assert 0.5 * expected < counted < 2.0 * expected
    assert (change / without.std()) ** 2 > 2.5 * expected


def test_counts_stand_where_they_are_said_to() -> None:
    rng = np.random.default_rng(4)
    targets = draw_design(rng, "rain", Size(targets=16)).scenes[0]
    statistics = Statistics(targets, 5)
    report = shoot(study_radar(), targets, Weather(), (), np.arange(FRAMES), rng)
    before = statistics(report, 1)[0]
    frame = np.zeros(50, dtype=int)
    near = np.stack([np.full(50, 2.0), *np.full((2, 50), 0.6), np.zeros(50), np.full(50, -100.0), np.zeros(50)], 1)
    report.clutter, report.clutter_frame = (
        np.concatenate([report.clutter, near]),
        np.concatenate([report.clutter_frame, frame]),
    )
    moved = np.flatnonzero(np.abs(statistics(report, 1)[0] - before) > 0.1)
    counts = np.arange(len(before))[statistics.counts]
    assert moved[0] == counts[0]  # and what differs between frames, behind the counts
    assert not set(moved) & set(counts[1:])
    assert len(counts) == 5
