"""How often a target is lost because it fluctuates: what is said against targets that are drawn."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from torchweather.gap.sensors.radar.fading import (
    NOISE_AT_0_DB,
    chance_of_fading,
    fading,
    share_of_fading,
    shares_by_class,
)

THRESHOLD_DB, TYPICAL_DB, SHARE = 12.0, 0.3, 0.3
Floats = NDArray[np.float64]


def drawn(rng: np.random.Generator, number: int) -> tuple[Floats, NDArray[np.bool_]]:
    """Mean SNRs, dB, and which targets fluctuate."""
    return rng.uniform(11.0, 46.0, number), rng.random(number) < SHARE


def frames(rng: np.random.Generator, mean_db: Floats, fading: NDArray[np.bool_], count: int) -> Floats:
    """SNRs ``(count, N)``: amplitudes, of which some fluctuate, with receiver noise."""
    power = np.where(fading, rng.exponential(size=(count, len(mean_db))), 1.0) * 10.0 ** (0.1 * mean_db)
    noise = rng.standard_normal((2, count, len(mean_db))) / math.sqrt(2.0)
    snr_db = 10.0 * np.log10((np.sqrt(power) + noise[0]) ** 2 + noise[1] ** 2)
    return np.asarray(snr_db)


def listed(snr_db: Floats) -> Floats:
    return np.where(snr_db >= THRESHOLD_DB, snr_db, np.nan)


def margin_and_spread(snr_db: Floats) -> tuple[Floats, Floats]:
    return snr_db.mean(0) - THRESHOLD_DB, np.hypot(snr_db.std(0, ddof=1), 0.05)


@pytest.mark.parametrize("clear", [4, 7, 11])
def test_as_many_are_lost_as_is_said(clear: int) -> None:
    """Of targets that all clear frames have, in classes of what is said; later frames are drawn anew."""
    rng = np.random.default_rng(clear)
    mean_db, fading = drawn(rng, 8000)
    seen = listed(frames(rng, mean_db, fading, clear + 1))
    share = share_of_fading(seen, THRESHOLD_DB, TYPICAL_DB)
    assert share == pytest.approx(SHARE, abs=0.06)  # those that are lost tell less: it is a little low
    said = chance_of_fading(seen[1:], THRESHOLD_DB, TYPICAL_DB, share)
    later = (frames(rng, mean_db, fading, 50) < THRESHOLD_DB).mean(0)
    margin, _ = margin_and_spread(np.nan_to_num(seen[1:], nan=THRESHOLD_DB))
    # Those far enough above that the receiver's noise alone loses none.
    counted = ~np.isnan(seen[1:]).any(0) & (margin > 4.0 * NOISE_AT_0_DB * 10.0 ** (-0.05 * (margin + THRESHOLD_DB)))
    for low, high in ((0.01, 0.1), (0.1, 0.5)):
        some = counted & (said >= low) & (said < high)
        assert some.sum() > 50
        assert later[some].mean() == pytest.approx(said[some].mean(), rel=0.3)


def test_a_spread_alone_takes_those_that_chance_kept_together_for_steady() -> None:
    """The reason of false alarms: three spreads above the threshold, and lost in one frame of a hundred; the normal law
    says one of 700."""
    rng = np.random.default_rng(1)
    mean_db = rng.uniform(11.0, 46.0, 8000)
    fading = np.ones(8000, dtype=bool)
    seen = listed(frames(rng, mean_db, fading, 8))
    margin, spread = margin_and_spread(seen[1:])
    by_spread = ~np.isnan(seen[1:]).any(0) & (margin > 3.0 * spread)
    by_chance = by_spread & (chance_of_fading(seen[1:], THRESHOLD_DB, TYPICAL_DB, SHARE) < 1.35e-3)
    later = (frames(rng, mean_db, fading, 100) < THRESHOLD_DB).mean(0)
    assert later[by_spread].mean() > 6.0 * 1.35e-3
    assert by_chance.sum() > 500
    assert later[by_chance].mean() < 1.35e-3


def test_of_one_frame_only_the_share_of_all_targets_is_known() -> None:
    snr_db = np.array([[15.0, 30.0, np.nan]])
    said = chance_of_fading(snr_db, THRESHOLD_DB, TYPICAL_DB, 0.2)
    # 1 - (1 + t / s)^-1 = t / (t + s)
    threshold = 10.0**1.2
    assert said[:2] == pytest.approx([0.2 * threshold / (threshold + 10.0**power) for power in (1.5, 3.0)])
    assert np.isnan(said[2])
    assert share_of_fading(snr_db, THRESHOLD_DB, TYPICAL_DB) == 0.3  # nothing tells it


def test_a_class_of_cars_fluctuates_and_one_of_posts_does_not() -> None:
    """A target that a handful of frames find alike is a post among posts, and a car by chance among cars."""
    rng = np.random.default_rng(7)
    mean_db = rng.uniform(20.0, 40.0, 60)
    target_class = np.repeat([0.0, 1.0], [40, 20])
    seen = listed(frames(rng, mean_db, target_class == 1.0, 8))
    seen[:, 59] = 30.0 + 0.3 * rng.standard_normal(8)
    seen[4:, 59] = np.nan
    shares = shares_by_class(seen, THRESHOLD_DB, TYPICAL_DB, target_class)
    assert shares[0] < 0.1
    assert shares[59] > 0.85
    among_posts, among_cars = (fading(seen[:4], THRESHOLD_DB, TYPICAL_DB, one)[59] for one in (shares[0], shares[59]))
    assert among_cars > 10.0 * among_posts
    # A post 18 dB over the threshold would not be missing in half of the frames.
    assert fading(seen, THRESHOLD_DB, TYPICAL_DB, shares[0])[59] > 0.99
    single = shares_by_class(seen[:, :1], THRESHOLD_DB, TYPICAL_DB, target_class[:1])
    assert 0.0 < single[0] < 1.0
