"""A perfect model departs by one in the mean square: whole measurements made anew, again and again."""

from __future__ import annotations

import math
from statistics import NormalDist

import numpy as np
import pytest
from numpy.typing import NDArray

from torchweather.gap.inference.calibrated_scatter import (
    CalibratedScatter,
    MeasuredSize,
    calibrated_scatter,
    log_sd_tail_variance,
    log_sd_variance,
)
from torchweather.gap.inference.config import METHOD, SCATTER
from torchweather.gap.statistics.frame_statistics import Group, Layout, Pool, Reduced

BINS, FRAMES, CLEAR, POOL = 40, 6, 8, 48
EDGES = tuple(float(one) for one in range(BINS + 1))
Made = tuple[NDArray[np.float64], NDArray[np.float64]]


def counts(rng: np.random.Generator, rate: NDArray[np.float64], frames: int) -> Made:
    """Particles: independent from frame to frame."""
    return np.ones((frames, BINS)), rng.poisson(rate, (frames, BINS)).astype(np.float64)


def shares(rng: np.random.Generator, rate: NDArray[np.float64], frames: int) -> Made:
    """Beams that are lost in every frame, as many as stands in ``rate``, and in one frame of four one more."""
    lost = np.floor(rate * 20.0) + (rng.random((frames, BINS)) < 0.25)
    return np.full((frames, BINS), 400.0), lost


@pytest.mark.parametrize(("kind", "draw"), [("count", counts), ("share", shares)])
def test_departures_of_a_perfect_model_have_their_expected_square(kind: str, draw: object) -> None:
    assert callable(draw)
    rng = np.random.default_rng(7)
    rate = 10.0 ** np.linspace(-3.0, 1.0, BINS)  # from one in 1,000 frames to ten a frame
    layout = Layout((Group("events", "range_m", kind, EDGES),), (), (), ())
    size = {"rain": MeasuredSize(FRAMES, CLEAR)}
    squares, expected, largest = 0.0, 0.0, 0.0
    for seed in range(40):
        pool, fresh = (
            Pool(layout, Reduced(weight, value, value, np.zeros((len(value), 0)), np.zeros((len(value), 0, 1))), start)
            for (weight, value), start in (
                (draw(rng, rate, POOL), np.arange(POOL) % CLEAR),
                (draw(rng, rate, FRAMES), np.arange(FRAMES)),
            )
        )
        found = calibrated_scatter({"rain": pool}, size, {"rain": np.zeros(BINS)}, seed)["rain"]
        total = found.own + found.simulated + found.clear
        z2 = (fresh.vectors(np.arange(FRAMES)[None])[0] - found.mean) ** 2 / total
        squares, expected, largest = squares + z2.sum(), expected + found.expected.sum(), max(largest, z2.max())
    # 40 studies of some 20 entries that tell something: sqrt(2 / 800) = 5 %, three of those.
    assert squares / expected == pytest.approx(1.0, abs=0.15)
    assert largest < 5.5**2  # of 1,600 entries; a first event is no miracle


@pytest.mark.parametrize("rate", [0.5, 10.0])
def test_a_variance_of_counts_has_the_degrees_of_freedom_that_it_says(rate: float) -> None:
    """Over pools made anew it scatters by the root of 2 / v: two in 2,400 variances, 3 %."""
    rng = np.random.default_rng(8)
    layout = Layout((Group("events", "range_m", "count", EDGES),), (), (), ())
    own, said = [], []
    for seed in range(60):
        weight, value = counts(rng, np.full(BINS, rate), POOL)
        empty = np.zeros((POOL, 0))
        pool = Pool(layout, Reduced(weight, value, value, empty, empty[..., None]), np.arange(POOL) % CLEAR)
        size = {"rain": MeasuredSize(FRAMES, CLEAR)}
        found = calibrated_scatter({"rain": pool}, size, {"rain": np.zeros(BINS)}, seed)["rain"]
        own.append(found.own)
        said.append(found.degrees_of_freedom)
    scattered = 2.0 / np.var(np.concatenate(own) / np.mean(own))
    # 256 draws make it a sixth less; of what only eight clear frames tell it says less than it knows.
    assert 0.7 * np.mean(said) < scattered < 1.8 * np.mean(said)


@pytest.mark.parametrize("mean", [0.03, 0.1, 0.3])
def test_no_rare_count_departs_by_more_than_its_deviance(mean: float) -> None:
    """Several events in one bin, where simulated frames show none or are alike."""
    layout = Layout((Group("events", "range_m", "share", (0.0, 1.0)),), (), (), ())
    # Half an event a pool is the prior of what was never seen.
    each = max(mean / FRAMES - 0.5 / POOL, 0.0)
    weight, empty = np.full((POOL, 1), 400.0), np.zeros((POOL, 0))
    pool = Pool(layout, Reduced(weight, each + 0.0 * weight, weight, empty, empty[..., None]), np.zeros(POOL, int))
    found = calibrated_scatter({"rain": pool}, {"rain": MeasuredSize(FRAMES, POOL)}, {"rain": np.zeros(1)}, 0)["rain"]
    scatter = np.sqrt(found.own[0] * FRAMES * 400.0)  # of the root of the count
    expected = max(mean, FRAMES * 0.5 / POOL)
    for count in range(math.ceil(expected + 1.0), 9):
        departure = (np.sqrt(count + 0.375) - np.sqrt(expected + 0.375)) / scatter
        deviance = 2.0 * (count * np.log(count / expected) - count + expected)
        # The root is not quite the root of the deviance: 12 % at most, up to eight events.
        assert departure < 1.12 * max(np.sqrt(deviance), SCATTER.one_event_sd / 2.0)


@pytest.mark.parametrize(("alike", "repeated"), [(True, True), (False, True), (True, False)])
def test_a_beam_that_is_lost_in_every_frame_is_one_event_where_others_are(alike: bool, repeated: bool) -> None:
    """In a bin in which no simulated frame loses one: as many losses of different beams are no chance."""
    rng, beams, lost = np.random.default_rng(4), 400.0, 3.0
    layout = Layout((Group("lost", "range_m", "share", EDGES),), (), (), ())
    weight, empty = np.full((POOL, BINS), beams), np.zeros((POOL, 0))
    value = np.full((POOL, BINS), lost) if alike else rng.poisson(lost, (POOL, BINS)).astype(float)
    value[:, 0] = 0.0
    pool = Pool(layout, Reduced(weight, value, value, empty, empty[..., None]), np.arange(POOL) % CLEAR)
    size = {"rain": MeasuredSize(FRAMES, CLEAR, repeated=float(FRAMES if repeated else 1))}
    found = calibrated_scatter({"rain": pool}, size, {"rain": np.zeros(BINS)}, 0)["rain"]
    measured = math.asin(math.sqrt(FRAMES / (FRAMES * beams)))  # one beam in each frame
    departure = (measured - found.mean[0]) / math.sqrt(found.own[0])
    if alike and repeated:
        assert departure < 1.12 * SCATTER.one_event_sd
    else:
        assert departure > 4.0


@pytest.mark.parametrize("least", [0.0, 0.3])
def test_means_of_few_elements_are_no_surer_than_is_said(least: float) -> None:
    """Simulated frames that are all alike: of what only an effect brings they are no measure."""
    layout = Layout((Group("speed", "particle_range_m", "mean", EDGES),), (), (), ())
    weight, empty = np.ones((POOL, BINS)), np.zeros((POOL, 0))
    pool = Pool(layout, Reduced(weight, weight, weight, empty, empty[..., None]), np.arange(POOL) % CLEAR)
    size, nothing = {"fog": MeasuredSize(FRAMES, CLEAR)}, {"fog": np.zeros(BINS)}
    found = calibrated_scatter({"fog": pool}, size, nothing, 0, None, {"fog": np.full(BINS, least)})["fog"]
    np.testing.assert_allclose(np.sqrt(found.own), least, atol=1e-9)


def test_what_the_clear_frames_do_not_tell_is_in_the_scatter() -> None:
    """Means whose noise lies between clear frames: eight frames know it to an eighth of a frame's variance."""
    layout = Layout((Group("level", "particle_range_m", "mean", EDGES),), (), (), ())
    weight = np.full((POOL, BINS), 100.0)
    base = np.random.default_rng(3).normal(size=(CLEAR, BINS))[np.arange(POOL) % CLEAR]
    frames = Reduced(weight, weight * base, weight * base**2, np.zeros((POOL, 0)), np.zeros((POOL, 0, 1)))
    pool = Pool(layout, frames, np.arange(POOL) % CLEAR)
    found = calibrated_scatter({"snow": pool}, {"snow": MeasuredSize(FRAMES, CLEAR)}, {"snow": np.zeros(BINS)}, 0)
    one = found["snow"]
    np.testing.assert_allclose(one.clear / one.own, FRAMES / CLEAR, rtol=1e-6)
    np.testing.assert_allclose(one.simulated / one.own, 0.0, atol=1e-6)


def spreads(clear: int, seed: int, uneven: float = 0.0) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Scatter of a spread in each bin over the true one, and its degrees of freedom: noise of a few clear frames.

    Args:
        clear: frames from which all others start.
        seed: of everything.
        uneven: scatter of the logarithm of what the elements' noise says of single bins.
    """
    rng = np.random.default_rng(seed)
    layout = Layout((Group("noise", "range_m", "spread", EDGES),), (), (), ())
    start = np.arange(POOL) % clear
    weight = np.full((POOL, BINS), 400.0)
    squares = 400.0 * (1.0 + 0.3 * rng.normal(size=(clear, BINS)))[start]
    pool = Pool(layout, Reduced(weight, 0.0 * weight, squares, np.zeros((POOL, 0)), np.zeros((POOL, 0, 1))), start)
    unit = 0.15 / math.sqrt(3.0)  # the logarithm of a root: half of 30 %
    elements = unit * 0.9 * np.exp(uneven * rng.normal(size=BINS))
    found = calibrated_scatter({"snow": pool}, {"snow": MeasuredSize(3, clear)}, {"snow": elements}, seed)["snow"]
    return np.sqrt(found.own - SCATTER.log_spread_error**2) / unit, found.degrees_of_freedom


def test_few_clear_frames_do_not_make_a_spread_sure() -> None:
    """Five clear frames tell a variance to 70 %, elements in 40 bins that go with it to a few percent."""
    ratio, degrees_of_freedom = map(np.concatenate, zip(*(spreads(5, seed) for seed in range(20)), strict=True))
    logs = np.log(ratio)
    assert abs(logs.mean()) < 0.1
    assert logs.std() < 0.2  # 0.38 by five frames alone
    assert np.median(degrees_of_freedom) > SCATTER.element_law_degrees


def test_elements_that_say_little_of_a_spread_are_not_believed() -> None:
    degrees_of_freedom = np.concatenate([spreads(5, seed, uneven=1.5)[1] for seed in range(5)])
    assert np.median(degrees_of_freedom) < 4.0 + 0.2 * SCATTER.element_law_degrees


def test_what_clear_frames_leave_open_is_known_and_one_error_of_a_scene() -> None:
    """Variances 4 and 1 more where it is shared, by a scatter of 2 and 1; a third entry is not."""
    ones = np.ones(3)
    one = CalibratedScatter(
        mean=0.0 * ones,
        draws=np.zeros((1, 3)),
        own=2.0 * ones,
        simulated=ones,
        clear=ones,
        shared=np.array([True, True, False]),
        expected=0.5 * ones,
        model=0.1 * ones,
        event=0.2 * ones,
        degrees_of_freedom=6.0 * ones,
        told_by_clear=ones,
    )
    found = one.beside(np.array([2.0, 1.0, 3.0]))
    np.testing.assert_allclose(found.clear, [5.0, 2.0, 1.0])
    np.testing.assert_allclose(found.own, one.own)
    np.testing.assert_allclose(found.expected, [0.75, 0.6, 0.5])  # (0.5 x 4 + 4) / 8, (0.5 x 4 + 1) / 5
    np.testing.assert_allclose(found.model, [0.05, 0.08, 0.1])
    np.testing.assert_allclose(found.event, [0.1, 0.16, 0.2])
    np.testing.assert_allclose(found.degrees_of_freedom, [24.0, 9.375, 6.0])  # the rest is known
    assert one.beside(0.0) is one


@pytest.mark.parametrize("number", [3, 6, 12])
def test_a_difference_between_frames_is_as_unlikely_as_it_is_said(number: int) -> None:
    """Beside a steady part that is far larger the entry goes as a variance, which has the far tail of chi-square."""
    steady = 30.0
    squares = np.random.default_rng(4).chisquare(number - 1, 4_000_000) / (number - 1)
    entry = 0.5 * np.log(squares + steady**2)
    apart = (entry - entry.mean()) / math.sqrt(log_sd_tail_variance(number, 1.0, steady))
    sure = -NormalDist().inv_cdf(METHOD.residual_p)
    assert (apart > sure).mean() == pytest.approx(METHOD.residual_p, rel=0.2)  # of 400: four times their root
    # With the scatter alone that is said of ten times as many and more.
    narrow = (entry - entry.mean()) / math.sqrt(log_sd_variance(number, 1.0, steady))
    assert (narrow > sure).mean() > 10.0 * METHOD.residual_p


def test_clear_frames_that_are_alike_by_chance_have_the_noise_of_their_elements() -> None:
    """Mean of 4,000 elements whose noise is 0.3, in 40 bins: frames differ by 0.3 / sqrt(4,000), and by no less."""
    layout = Layout((Group("level", "range_m", "mean", EDGES),), ("level",), (0.01,), ())
    weight = np.full((POOL, BINS), 100.0)
    alike = Reduced(weight, 0.0 * weight, 0.09 * weight, np.zeros((POOL, 1)), np.zeros((POOL, 0, 1)))
    pool = Pool(layout, alike, np.arange(POOL) % CLEAR)
    elements = np.full(layout.size, 0.03 / math.sqrt(FRAMES))
    found = calibrated_scatter({"rain": pool}, {"rain": MeasuredSize(FRAMES, CLEAR)}, {"rain": elements}, 0)["rain"]
    between = np.flatnonzero(layout.each(lambda group: group.kind == "between"))
    expected = log_sd_tail_variance(FRAMES, 0.09 / 4000.0, 0.01)
    np.testing.assert_allclose(found.own[between], expected, rtol=1e-9)
