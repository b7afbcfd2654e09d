"""What is left, statistic by statistic: sums against loops, probabilities against drawn noise, levels of noise."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.stats import chi2

from torchweather.gap.inference.config import SCATTER
from torchweather.gap.inference.residual_tests import ResidualTest, residual_test
from torchweather.gap.statistics.frame_statistics import Group, Layout

RNG = np.random.default_rng
EDGES = (0.0, 1.0, 2.0, 3.0)
LAYOUT = Layout(
    (
        Group("lost", "x", "share", EDGES),
        Group("seldom", "x", "count", EDGES),
        Group("ratio", "x", "mean", EDGES),
        Group("never", "x", "share", EDGES),
    ),
    (),
    (),
    (),
)
ENTRIES = np.repeat(np.arange(4), 3)
PLACES = np.tile(ENTRIES, 2)  # two conditions
USED = PLACES.reshape(2, 12) < 3
USED[0, 3] = False  # the group "seldom" has five of six entries
NOISE = np.array([1.5, 0.5, 1.0, 1.0])[ENTRIES] * np.array([[1.0], [0.3]])  # less in the second condition
RESIDUAL = ResidualTest(ENTRIES, USED, NOISE)


def even(groups: int, entries: int, conditions: int = 1, noise: float = 1.0) -> ResidualTest:
    """Groups of so many entries each, that all count alike."""
    shape = (conditions, groups * entries)
    return ResidualTest(np.repeat(np.arange(groups), entries), np.ones(shape, bool), np.full(shape, noise))


def test_squares_are_those_of_loops() -> None:
    left = RNG(1).normal(size=24)
    squares = [
        sum(float(value) ** 2 for value, place in zip(left, PLACES, strict=True) if place == k) for k in range(4)
    ]
    np.testing.assert_allclose(RESIDUAL.squares(left), squares, rtol=1e-12)


def test_noise_leaves_no_excess_beyond_chance_and_a_departure_as_much_as_it_is() -> None:
    """40 groups of 60 entries: noise of level 1 is above its level by 0.4 sqrt(2 x 60) = 4.4 in each of them."""
    many = even(40, 60)
    noise = RNG(11).normal(size=(400, 40 * 60))
    every = np.array([np.maximum(many.squares(one) - 60.0, 0.0).sum() for one in noise])
    assert every.mean() == pytest.approx(40 * 4.4, rel=0.03)
    beyond = np.array([many.beyond_chance(one) for one in noise])
    # Of an excess that scatters by s about what chance makes of it 0.4 s are left on average: none counts below 0.
    assert beyond.mean() < 0.5 * every.std()
    noise[:, :60] += 3.0
    # All 540 of it, and half of the 4.4 of that group, which no longer is 0 where noise is low.
    found = np.mean([many.beyond_chance(one) for one in noise])
    assert found == pytest.approx(540.0 - 4.4, abs=5.0 * every.std() / 20.0)


def test_a_few_entries_that_depart_are_not_drowned_in_all_others() -> None:
    """One group of 60 entries three scatters off among 1,500: 540 of 1,980, where noise leaves 1,500 +- 55 and less."""
    groups, each = 25, 60
    many = even(groups, each, noise=1.5)
    left = 0.7 * RNG(2).normal(size=groups * each)
    assert many.p_value(left) > 0.5
    left[:each] += 3.0
    assert float(left @ left) < 1500.0  # no more than noise is said to leave
    assert many.p_value(left) < 1e-20
    assert many.p_value(left) == pytest.approx(25.0 * chi2.sf(float(left[:each] @ left[:each]) / 1.5, 60), rel=1e-9)


def test_noise_seldom_raises_an_alarm() -> None:
    noise = (np.sqrt(NOISE) * USED).ravel() * RNG(3).normal(size=(4000, 24))
    # Three groups, 4,000 draws: 5 x sqrt(0.05 x 0.95 / 4,000) = 0.017.
    for p_value in (RESIDUAL.p_value, RESIDUAL.common_p_value):
        found = np.array([p_value(one) for one in noise])
        assert (found < 0.05).mean() == pytest.approx(0.05, abs=0.017)
    nothing = ResidualTest(ENTRIES, np.zeros((2, 12), bool), NOISE)
    assert nothing.p_value(np.zeros(24)) == nothing.common_p_value(np.zeros(24)) == 1.0


def test_what_conditions_have_in_common_is_not_drowned_in_each() -> None:
    """A slope along one axis, alike in nine conditions, in 20 groups of five bins: its square is 90, of 45 entries of
    one group or of five bins of the mean. The same numbers in another order in each condition are no pattern."""
    conditions, groups = 9, 20
    several = even(groups, 5, conditions)
    left = np.zeros((conditions, groups * 5))
    left[:, :5] = np.array([-2.0, -1.0, 0.0, 1.0, 2.0])
    assert several.p_value(left.ravel()) == pytest.approx(20.0 * chi2.sf(90.0, 45), rel=1e-9)
    assert several.common_p_value(left.ravel()) == pytest.approx(20.0 * chi2.sf(90.0, 5), rel=1e-6)
    mixed = np.stack([np.roll(row[:5], k) for k, row in enumerate(left)])
    left[:, :5] = mixed
    assert several.common_p_value(left.ravel()) > 0.01


def test_one_condition_has_nothing_in_common() -> None:
    left = np.full(12, 9.0)
    alone = even(4, 3)
    assert alone.common_p_value(left) == 1.0
    some = np.ones((2, 12), bool)
    some[1, 1:] = False  # one entry counts in both
    of_two = np.concatenate([left, np.full(12, 9.0)])
    assert ResidualTest(ENTRIES, some, np.ones((2, 12))).common_p_value(of_two) == pytest.approx(
        chi2.sf(2.0 * 81.0, 1), rel=1e-9
    )


def test_noise_is_what_is_expected_of_the_entries_that_count() -> None:
    """Of an entry in which hardly anything can happen it is less, down to a least level."""
    names = ("c0", "c1")
    each = np.repeat([1.0, 0.5, 0.25, 0.0], 3)
    used = {name: np.ones(12, bool) for name in names}
    used["c1"][0] = False
    base: Any = SimpleNamespace(
        base=SimpleNamespace(
            expected={"c0": each, "c1": np.where(each == 0.5, 0.25, each)},
            used=used,
            model=dict.fromkeys(names, 0.5 * each),
            event=dict.fromkeys(names, 4.0 * each),
            degrees_of_freedom=dict.fromkeys(names, 10.0 + each),
        )
    )
    search: Any = SimpleNamespace(
        model=SimpleNamespace(layout=LAYOUT),
        measured=[SimpleNamespace(condition=SimpleNamespace(id=name, scene=name[1])) for name in names],
    )
    found = residual_test(search, base)
    np.testing.assert_array_equal(found.places, ENTRIES)
    np.testing.assert_array_equal(found.used, [used[name] for name in names])
    levels = np.repeat([[1.0, 0.5, 0.25, SCATTER.least_level], [1.0, 0.25, 0.25, SCATTER.least_level]], 3, axis=1)
    np.testing.assert_allclose(found.noise, levels, rtol=1e-12)
    np.testing.assert_array_equal(found.event, [4.0 * each] * 2)
    np.testing.assert_array_equal(found.model, [0.5 * each] * 2)
    np.testing.assert_array_equal(found.scene, [0, 1])
    np.testing.assert_array_equal(found.degrees_of_freedom, [10.0 + each] * 2)


def test_bins_without_events_make_no_statistic_of_many_entries() -> None:
    """Two bins that hold events and twelve that hardly ever do: nine of a square are as likely as they are of two."""
    level = np.full((1, 14), 0.04)
    level[0, :2] = 1.0, 0.5
    one = ResidualTest(np.zeros(14, int), np.ones((1, 14), bool), level)
    left = np.zeros(14)
    left[1] = 3.0
    drawn = (RNG(5).normal(size=(400_000, 14)) ** 2 * level).sum(1)
    # Satterthwaite's law beside the drawn one, whose tail is that of its largest term: within a factor of two.
    assert 0.5 < one.p_value(left) / (drawn >= 9.0).mean() < 2.0
    assert one.p_value(left) > 1e3 * chi2.sf(9.0 / level.mean(), 14)


@pytest.mark.parametrize("expected", [0.003, 0.01, 0.03])
def test_first_events_are_no_miracle(expected: float) -> None:
    """Six bins in which hardly any event is expected: sums of squares as drawn from Poisson's law."""
    number = RNG(6).poisson(expected, (400_000, 6))
    departure = np.sqrt(number + 0.375) - np.sqrt(expected + 0.375)
    departure *= SCATTER.one_event_sd / (np.sqrt(expected + 1.375) - np.sqrt(expected + 0.375))
    level = np.full((1, 6), float((departure**2).mean()))
    event = np.full((1, 6), SCATTER.one_event_sd**2)
    one = ResidualTest(np.zeros(6, int), np.ones((1, 6), bool), level, event)
    squares = (departure**2).sum(1)
    for events in (1, 2):
        left = np.zeros(6)
        left[:events] = SCATTER.one_event_sd
        true = float((squares > 0.9 * events * SCATTER.one_event_sd**2).mean())
        found, normal = one.p_value(left), ResidualTest(one.places, one.used, level).p_value(left)
        assert 0.2 * true < found < 6.0 * true
        assert normal < 1e-3 * found


def test_a_scatter_that_few_frames_tell_is_no_sure_measure() -> None:
    """Normal numbers over a scatter that four of their kind tell: F, not chi-square; alike in five bins of it."""
    rng, degrees_of_freedom = RNG(7), 4.0
    scale = rng.chisquare(degrees_of_freedom, 200_000) / degrees_of_freedom
    squares = (rng.normal(size=(200_000, 5)) ** 2).sum(1) / scale
    shape = (1, 5)
    one = ResidualTest(np.zeros(5, int), np.ones(shape, bool), np.ones(shape), 0.0, np.full(shape, degrees_of_freedom))
    for chance in (0.1, 1e-2, 1e-3):
        left = np.full(5, np.sqrt(np.quantile(squares, 1.0 - chance) / 5.0))
        # 200 of 200,000 scatter by 7 %; three of those.
        assert one.p_value(left) == pytest.approx(chance, rel=0.21)


@pytest.mark.parametrize("share", [0.5, 0.98])
def test_an_error_of_the_model_in_all_conditions_is_no_alarm(share: float) -> None:
    """Six conditions, three entries: noise of each, and a departure of each entry that is one number in all of them."""
    rng, conditions, draws = RNG(8), 6, 100_000
    noise, model = np.full((conditions, 3), 1.0 - share), np.full((conditions, 3), share)
    one = ResidualTest(np.zeros(3, int), np.ones((conditions, 3), bool), noise, model=model)
    common = math.sqrt(share) * rng.normal(size=(draws, 1, 3))
    left = common + math.sqrt(1.0 - share) * rng.normal(size=(draws, conditions, 3))
    squares, patterns = (left**2).sum((1, 2)), (left.sum(1) ** 2).sum(1) / conditions
    unit = np.ones((conditions, 3))
    for chance in (1e-2, 1e-3):
        # Satterthwaite's law is off by a factor of four in the tail; without the model's error by a thousand.
        of_all = unit * math.sqrt(np.quantile(squares, 1.0 - chance) / (3 * conditions))
        assert 0.25 * chance < one.p_value(of_all.ravel()) < 2.0 * chance
        of_common = unit * math.sqrt(np.quantile(patterns, 1.0 - chance) / (3 * conditions))
        assert 0.25 * chance < one.common_p_value(of_common.ravel()) < 2.0 * chance
    assert ResidualTest(np.zeros(3, int), one.used, noise).common_p_value(of_common.ravel()) < 1e-3 * chance


@pytest.mark.parametrize("scenes", [1, 2])
def test_each_scene_has_an_error_of_its_noise(scenes: int) -> None:
    """Four conditions of five entries; the scatter of each scene is told by ten of its kind, and right in the mean of
    the squares."""
    rng, degrees_of_freedom, draws = RNG(9), 10.0, 200_000
    scene = np.arange(4) % scenes
    scale = rng.chisquare(degrees_of_freedom, (draws, scenes))[:, scene] / (degrees_of_freedom - 2.0)
    squares = (rng.chisquare(5, (draws, 4)) / scale).sum(1)
    unit = np.ones((4, 5))
    one = ResidualTest(np.zeros(5, int), unit > 0, unit, 0.0, degrees_of_freedom * unit, scene=scene)
    alike = ResidualTest(np.zeros(5, int), unit > 0, unit, 0.0, degrees_of_freedom * unit)
    for chance in (0.1, 1e-2, 1e-3):
        left = unit * math.sqrt(np.quantile(squares, 1.0 - chance) / 20.0)
        # The law of F has the variance of the errors, and a shorter tail than two of them.
        assert 0.4 * chance < one.p_value(left.ravel()) < 4.0 * chance
        assert (alike.p_value(left.ravel()) > 1.5 * one.p_value(left.ravel())) == (scenes == 2)
