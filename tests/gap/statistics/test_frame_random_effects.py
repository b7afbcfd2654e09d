"""What whole frames do, what a model knows of means, what effects leave unmodelled: fabricated numbers, plain loops."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy import stats

from torchweather.gap.inference.config import NUMERICS, SCATTER
from torchweather.gap.inference.likelihood import SimulatorLikelihood
from torchweather.gap.inference.simulated_conditions import ParameterPoint
from torchweather.gap.inference.simulated_distribution import Observation, SimulatedDistribution, Whitening
from torchweather.gap.sensors.lidar.sums import lidar_layout
from torchweather.gap.statistics.frame_random_effects import (
    clear_errors,
    clear_means,
    frame_departures,
    model_errors,
    widened,
)
from torchweather.gap.statistics.frame_statistics import Group, Layout, Reduced
from torchweather.lidar.effects.all import EFFECTS as LIDAR_EFFECTS
from torchweather.stages import EFFECTS

RNG = np.random.default_rng
LAYOUT = Layout(
    (
        Group("ratio", "x", "mean", (0.0, 1.0, 2.0, 3.0)),
        Group("ratio", "y", "mean", (0.0, 1.0, 2.0)),
        Group("apart", "x", "mean", (0.0, 1.0, 2.0)),
        Group("lost", "x", "share", (0.0, 1.0, 2.0)),
        Group("log_particle_intensity", "particle_range_m", "mean", (0.0, 1.0, 2.0)),
        Group("many", "particle_range_m", "count", (0.0, 1.0)),
    ),
    ("ratio",),
    (1e-3,),
    (),
)
SIZE, BINS = LAYOUT.size, LAYOUT.bins  # 12 and two of the scalar
RATIO, APART, MEANS = slice(0, 5), slice(5, 7), [0, 1, 2, 3, 4, 5, 6, 9, 10]
AVERAGES = np.isin(np.arange(SIZE), range(7))
WEIGHT = np.array([3.0, 5.0, 1.0, 4.0, 5.0, 6.0, 2.0, 9.0, 9.0, 8.0, 8.0, 7.0])
CLEAR = {"s0": 4, "s1": 3}
SCENES, FRAMES = {"c0": "s0", "c1": "s0", "c2": "s1"}, {"c0": 5, "c1": 3, "c2": 2}


def of_frames(scene: str) -> Any:
    """What each clear frame of a scene says ``(K, bins)``, apart from the mean of the scene."""
    values = 0.1 * RNG([1, len(scene), CLEAR[scene]]).normal(size=(CLEAR[scene], BINS))
    values[:, RATIO] += 0.3 * np.arange(CLEAR[scene])[:, None]  # all entries of it together
    return values - values.mean(0)


def clear(scene: str, portions: int = 1) -> Reduced:
    """Clear frames, each compared with the mean of the others: further apart by K / (K - 1); elements without noise."""
    each = of_frames(scene)
    number = len(each)
    value = WEIGHT * (0.5 + each - (each.sum(0) - each) / (number - 1))
    weight = np.tile(WEIGHT, (number, 1))
    if portions > 1:
        value, weight = (
            np.repeat(np.tile(one.mean(0) / portions, (number, 1)), portions, 0) for one in (value, weight)
        )
    nothing = np.zeros((len(value), 0))
    return Reduced(weight, value, weight, np.zeros((len(value), 1)), nothing[..., None])


def bare(clear_frames: Mapping[str, int] = CLEAR) -> SimulatorLikelihood:
    """A search that has simulated nothing."""
    found = SimulatorLikelihood.__new__(SimulatorLikelihood)
    found.seed, found.pool_frames, found.least_frames, found.open = 5, 48, 5, {}
    found.measured = [
        Observation(
            SimpleNamespace(id=name, scene=scene, rel_sd=0.1, time_s=None),  # type: ignore[arg-type]
            np.zeros(SIZE),
            np.ones(SIZE, bool),
            FRAMES[name],
            clear_frames=clear_frames[scene],
        )
        for name, scene in SCENES.items()
    ]
    found.model = SimpleNamespace(layout=LAYOUT, clear=clear, each_frame_alone=True)  # type: ignore[assignment]
    found.kept, found._portioned_frames = found._nothing_kept(), 0
    found.start = base()
    return found


def base(mean: float = 0.0) -> SimulatedDistribution:
    """A simulator that has scatters of 1 without correlations, whose means differ from entry to entry."""
    each, ones = {name: mean * np.arange(1.0, SIZE + 1.0) * FRAMES[name] for name in SCENES}, np.ones(SIZE)
    one = dict.fromkeys(SCENES, ones)
    twice, nothing = dict.fromkeys(SCENES, 2.0 * ones), dict.fromkeys(SCENES, 0.0 * ones)
    return SimulatedDistribution(
        mean=each,
        sd=one,
        total=twice,
        used=dict.fromkeys(SCENES, ones > 0),
        whitening=Whitening(np.eye(SIZE)),
        draws={},
        independent={},
        shared=nothing,
        expected=one,
        model=one,
        event=nothing,
        degrees_of_freedom=one,
        told_by_clear=nothing,
    )


def covariance(columns: Any) -> Any:
    """Of the departures of all conditions ``(C, P, C, P)``, of nuisances of one standard deviation each."""
    response = np.stack(columns, 1)
    return (response @ response.T).reshape(len(SCENES), SIZE, len(SCENES), SIZE)


# ---- clear frames ----------------------------------------------------------------------------------------------------


def test_what_whole_frames_do_is_the_pooled_variance_of_clear_frames() -> None:
    """In the mean of a scene's clear frames, in all its conditions alike, and in each condition's own frames."""
    degrees_of_freedom = sum(number - 1 for number in CLEAR.values())
    pooled = np.zeros((SIZE, SIZE))
    for scene in CLEAR:
        each = of_frames(scene)
        entries = np.zeros((len(each), SIZE))
        even = {
            name: (each[:, part] * WEIGHT[part]).sum(1) / WEIGHT[part].sum()
            # All elements of one axis: each is in a bin of every axis.
            for name, part in (("ratio", slice(0, 3)), ("apart", APART))
        }
        for name, part in (("ratio", RATIO), ("apart", APART)):  # not of particles: clear frames hardly have any
            entries[:, part] = each[:, part] - even[name][:, None]
            pooled[part, part] += (even[name] ** 2).sum() / degrees_of_freedom
        for one in entries:
            pooled += np.outer(one, one) / degrees_of_freedom
    pooled *= stats.t.isf(0.5e-4, degrees_of_freedom) ** 2 / stats.norm.isf(0.5e-4) ** 2
    search, at = bare(), base()
    departures = frame_departures(search.model, search.measured)
    found = covariance(clear_errors(departures, search.measured, set(), partial(search._column, at)))
    for one, (name, scene) in enumerate(SCENES.items()):
        for other, (_, elsewhere) in enumerate(SCENES.items()):
            share = (scene == elsewhere) / CLEAR[scene] + (one == other) / FRAMES[name]
            np.testing.assert_allclose(found[one, :, other], share * pooled, rtol=1e-9, atol=1e-12)


def test_an_even_shift_that_is_simulated_is_no_error_of_the_clear_mean_as_well() -> None:
    """The conditions' own frames keep theirs."""
    search, at = bare(), base()
    departures = frame_departures(search.model, search.measured)
    assert [one.even for one in departures if one.even] == ["ratio", "apart"]
    column = partial(search._column, at)
    both, without = (clear_errors(departures, search.measured, names, column) for names in (set(), {"ratio"}))
    even = next(one.entries for one in departures if one.even == "ratio")
    expected = {
        scene: column({k: even / math.sqrt(CLEAR[scene]) for k, one in enumerate(SCENES.values()) if one == scene})
        for scene in CLEAR
    }
    gone = [one for one in both if not any(np.array_equal(one, other) for other in without)]
    np.testing.assert_array_equal(gone, list(expected.values()))


# ---- conditions of one scene -----------------------------------------------------------------------------------------


def shared() -> SimulatedDistribution:
    """What conditions of a scene share differs from entry to entry; scatters, too."""
    share = {name: RNG([8, k]).uniform(0.2, 1.5, SIZE) for k, name in enumerate(SCENES)}
    sd = {name: RNG([9, k]).uniform(0.5, 2.0, SIZE) for k, name in enumerate(SCENES)}
    return replace(base(), shared=share, sd=sd)


def test_what_conditions_of_a_scene_share_is_made_independent() -> None:
    """Noise of each condition and one error of each scene's clear mean, drawn: 10,000 of them."""
    search, at, rng, number = bare(), shared(), RNG(10), 10_000
    own = rng.normal(size=(number, len(SCENES), SIZE))
    of_scene = {scene: rng.normal(size=(number, SIZE)) for scene in CLEAR}
    for place, (name, scene) in enumerate(SCENES.items()):
        own[:, place] = at.sd[name] * (own[:, place] + at.shared[name] * of_scene[scene])
    found = np.stack([search.whitened(at, list(one)) for one in own])
    # 5 x sqrt(2 / 10,000) = 7.1 % on the diagonal.
    np.testing.assert_allclose(found.T @ found / number, np.eye(found.shape[1]), atol=0.071)


def test_vectors_are_whitened_again_as_they_would_have_been() -> None:
    search, old, factor = bare(), shared(), np.linalg.cholesky(0.7 * np.eye(SIZE) + 0.3)
    old = replace(old, whitening=Whitening(factor))
    scatter = {name: 1.0 + 0.1 * np.arange(SIZE) for name in SCENES}
    share = {name: 0.5 * one for name, one in old.shared.items()}
    new = replace(old, sd=scatter, shared=share)
    differences = RNG(11).normal(size=(4, len(SCENES), SIZE))
    before, expected = (np.stack([search.whitened(at, list(one)) for one in differences]) for at in (old, new))
    np.testing.assert_allclose(search.rewhitened(before, old, new), expected, rtol=1e-10, atol=1e-12)
    np.testing.assert_allclose(search.rewhitened(before[2], old, new), expected[2], rtol=1e-10, atol=1e-12)
    assert np.abs(before - expected).max() > 0.1


def test_a_single_clear_frame_of_each_scene_tells_nothing_of_whole_frames() -> None:
    search = bare(dict.fromkeys(CLEAR, 1))
    assert frame_departures(search.model, search.measured) == []
    assert clear_errors([], search.measured, set(), partial(search._column, base())) == []


@pytest.mark.parametrize("clock", [0.0, 1.0])
def test_the_noise_of_elements_is_nothing_that_whole_frames_do(clock: float) -> None:
    """Elements with noise of 1 in two bins of 512; a clock that moves all of them together by a tenth of that or so."""
    portions, number, scenes = NUMERICS.portions, 24, 12
    layout = Layout(
        (Group("apart", "x", "mean", (0.0, 1.0, 2.0)), Group("level", "x", "spread", (0.0, 1.0))), (), (), ()
    )
    each = 4  # elements of a portion in each bin

    def frames(scene: str, parts: int = 1) -> Reduced:
        rng = RNG([7, int(scene)])
        value = rng.normal(size=(number, portions, 3, each))
        value[..., :2, :] += 0.1 * clock * rng.normal(size=(number, 1, 1, 1))
        value -= value.mean(0)
        value *= number / (number - 1)  # compared with the mean of the others
        sums = (np.full(value.shape[:3], float(each)), value.sum(-1), (value**2).sum(-1))
        shaped = [one.reshape(-1, 3) if parts > 1 else one.sum(1) for one in sums]
        rows = len(shaped[0])
        return Reduced(*shaped, np.zeros((rows, 0)), np.zeros((rows, 0, 1)))

    measured = [
        Observation(SimpleNamespace(scene=str(scene)), np.zeros(3), np.ones(3, bool), 1, clear_frames=number)  # type: ignore[arg-type]
        for scene in range(scenes)
    ]
    model: Any = SimpleNamespace(layout=layout, clear=frames)
    departures = [one.entries for one in frame_departures(model, measured)]
    found = sum((np.outer(one, one) for one in departures), np.zeros((3, 3)))
    # 276 degrees of freedom: the variance of a clock is known to sqrt(2 / 276) = 8.5 %, nothing to a tenth of the
    # element noise of a bin, 1 / 512 (of the spread, half of that).
    assert found[:2, :2] == pytest.approx(
        np.full((2, 2), 0.01 * clock * widened(scenes * (number - 1))), rel=0.3, abs=4e-4
    )
    assert abs(found[2]).max() < 2e-4


def test_two_frames_that_are_alike_by_chance_make_no_steady_clock() -> None:
    """Means of 1,024 elements with noise of 1, without a clock: as much as that noise, twice the scatter of its square
    from two scenes of two frames, may be hidden in it."""
    portions, each = NUMERICS.portions, 8

    def frames(scene: str, parts: int = 1) -> Reduced:
        value = RNG([11, int(scene)]).normal(size=(2, portions, each))
        value -= value.mean(1, keepdims=True).mean(2, keepdims=True)  # their means are the same to the last digit
        sums = (np.full((2, portions, 1), float(each)), value.sum(-1)[..., None], (value**2).sum(-1)[..., None])
        shaped = [one.reshape(-1, 1) if parts > 1 else one.sum(1) for one in sums]
        return Reduced(*shaped, np.zeros((len(shaped[0]), 0)), np.zeros((len(shaped[0]), 0, 1)))

    measured = [
        Observation(SimpleNamespace(scene=str(scene)), np.zeros(1), np.ones(1, bool), 1, clear_frames=2)  # type: ignore[arg-type]
        for scene in range(2)
    ]
    layout = Layout((Group("apart", "x", "mean", (0.0, 1.0)),), (), (), ())
    model: Any = SimpleNamespace(layout=layout, clear=frames)
    (even,) = (one.entries for one in frame_departures(model, measured) if one.even)
    # The departure of a frame from the mean of two has half of a frame's variance. The error is that of the mean of
    # both frames, which is half of that. Twice the scatter of a variance with two degrees of freedom is 2.
    assert even[0] ** 2 == pytest.approx(widened(2) * 2.0 * 0.25 / 1024, rel=0.1)


def test_a_scatter_known_from_few_frames_is_widened_as_student_has_it() -> None:
    # Two-sided one in ten thousand, from tables of Student's t; 3.8906 of the normal law.
    for degrees_of_freedom, quantile in ((1, 6366.2), (5, 11.178), (10, 6.211), (30, 4.482), (120, 4.025)):
        assert widened(degrees_of_freedom) == pytest.approx((quantile / 3.8906) ** 2, rel=1e-3)
        # The normal law of that variance reaches as far as often.
        reach = stats.t.ppf(1.0 - 0.5 * SCATTER.frame_noise_p, degrees_of_freedom)
        assert 2.0 * stats.norm.sf(reach / math.sqrt(widened(degrees_of_freedom))) == pytest.approx(1e-4, rel=1e-6)
    each = [widened(degrees_of_freedom) for degrees_of_freedom in range(1, 60)]
    assert each == sorted(each, reverse=True)
    assert widened(10**7) == pytest.approx(1.0, abs=1e-5)


# ---- the model -------------------------------------------------------------------------------------------------------


def test_what_weather_does_to_means_is_known_to_half_a_percent_in_all_conditions_and_in_each() -> None:
    at = base(3.0)
    in_clear_air = {"s0": np.linspace(0.0, 2.0, SIZE), "s1": np.linspace(1.0, 0.0, SIZE)}
    columns = model_errors(LAYOUT, bare().measured, at, in_clear_air, partial(bare()._column, at))
    found = covariance(columns)
    known = {
        name: np.where(AVERAGES, SCATTER.weather_mean_rel_error * (at.mean[name] - in_clear_air[scene]), 0.0)
        for name, scene in SCENES.items()
    }
    assert SCATTER.weather_mean_rel_error == 0.005
    for one, name in enumerate(SCENES):
        for other, elsewhere in enumerate(SCENES):
            expected = (1.0 + (one == other)) * np.outer(known[name], known[elsewhere])
            np.testing.assert_allclose(found[one, :, other], expected, rtol=1e-9, atol=1e-15)


def test_what_weather_does_is_against_all_clear_frames_of_the_scene() -> None:
    found = clear_means(bare().model, bare().measured)
    assert sorted(found) == sorted(CLEAR)
    for scene, vector in found.items():
        assert vector[RATIO] == pytest.approx(0.5 + of_frames(scene).mean(0)[RATIO], abs=1e-12)


# ---- seeds -----------------------------------------------------------------------------------------------------------


def test_seeds_go_round_the_clear_frames_evenly() -> None:
    search = bare()
    for place, target in enumerate(search.measured):
        clear_frames = target.clear_frames
        seeds = search.seeds(place, search.pool_frames)
        assert len(set(seeds)) == search.pool_frames
        assert all(0 <= seed < 2**62 for seed in seeds)
        for rounds in (1, 2, search.pool_frames // clear_frames):
            number = Counter(seed % clear_frames for seed in seeds[: rounds * clear_frames])
            assert number == dict.fromkeys(range(clear_frames), rounds)
        assert search.seeds(place, 7) == seeds[:7]


def test_seeds_differ_between_conditions_and_searches() -> None:
    search, other = bare(), bare()
    other.seed = 6
    each = [one.seeds(place, 48) for one in (search, other) for place in range(3)]
    assert len({seed for seeds in each for seed in seeds}) == 6 * 48


def test_every_point_is_simulated_with_the_same_seeds_a_cost_with_more_than_a_response() -> None:
    search, given = bare(), []

    def simulated(condition: Any, effects: Any, log_intensity: float, seeds: Any, portions: int = 1) -> Reduced:
        given.append((condition.id, tuple(seeds)))
        nothing = np.zeros((len(seeds), BINS))
        return Reduced(nothing, nothing, nothing, np.zeros((len(seeds), 1)), np.zeros((len(seeds), 0, 1)))

    search.model.simulated = simulated  # type: ignore[method-assign]
    search.model.systematics = lambda condition, strengths: []  # type: ignore[method-assign]
    for point in (ParameterPoint(), ParameterPoint({"lidar.window_loss": {"loss_db": 1.0}}, {"c1": 0.3})):
        search.mean(point)
        search.mean(point, NUMERICS.screen_frames)
    assert (NUMERICS.probe_frames, NUMERICS.screen_frames) == (16, 6)
    # The first six are those of a response: none is simulated twice.
    parts = slice(0, 6), slice(6, 16)
    wanted = {(name, tuple(search.seeds(k, 16)[part])) for k, name in enumerate(SCENES) for part in parts}
    assert set(given) == wanted
    assert len(given) == 12
    assert search.simulated_frames == 2 * 3 * 16


# ---- what effects leave unmodelled -------------------------------------------------------------------------------


def test_what_an_effect_leaves_unmodelled_is_known_to_half_of_what_it_does() -> None:
    search, there = bare(), base(-0.7)
    search.start = base(0.2)
    found = search._loosened(there, {"log_particle_intensity", "no_such_statistic"})
    assert SCATTER.unmodelled_share == 0.5
    for name in SCENES:
        open_entries = np.isin(np.arange(SIZE), (9, 10))
        moved = 0.5 * 0.9 * np.arange(1.0, SIZE + 1.0) * FRAMES[name]
        for scatter, before in ((found.sd[name], 1.0), (found.total[name], 2.0)):
            np.testing.assert_allclose(scatter[open_entries], np.hypot(before, moved)[open_entries], rtol=1e-12)
            np.testing.assert_array_equal(scatter[~open_entries], before)
        np.testing.assert_array_equal(found.mean[name], there.mean[name])


def test_effects_leave_unmodelled_only_what_is_looked_at() -> None:
    axes = ("range_m", "margin_db", "azimuth_rad", "elevation_rad", "cos_incidence", "up", "log_intensity", "isolated")
    groups = lidar_layout(dict.fromkeys(axes, (0.0, 1.0)), True, 100).groups
    names = {group.statistic for group in groups}
    unmodelled = {name: EFFECTS[name].unmodelled for name in LIDAR_EFFECTS if EFFECTS[name].unmodelled}
    unmodelled = {name: found for name, found in unmodelled.items() if name.startswith("lidar.")}
    # Things that are there with a brightness of their own.
    assert sorted(unmodelled) == ["lidar.crosstalk", "lidar.spray", "lidar.static_structure"]
    for found in unmodelled.values():
        assert set(found) == {"log_particle_intensity", "log_particle_intensity_spread"} <= names
    beside = {name: EFFECTS[name].not_simulated for name in LIDAR_EFFECTS if EFFECTS[name].not_simulated}
    # A more sensitive receiver sees surfaces that were too faint in clear air.
    assert list(beside) == ["lidar.threshold_shift"]
    assert set(beside["lidar.threshold_shift"]) < names


def test_first_counts_of_what_there_was_nothing_of_widen_nothing() -> None:
    """A likelihood counts the logarithm of a scatter; of shares and counts up to that of counting it does not."""
    search, there = bare(), base()
    counts = np.isin(np.arange(SIZE), (7, 8, 11))  # "lost" and "many"
    search.start = replace(base(), independent=dict.fromkeys(SCENES, np.where(counts, 2.0, 0.0)))
    for factor, wider in ((1.5, 0.0), (2.0, 0.0), (3.0, math.log(3.0 / 2.0))):
        sd = {name: np.where(counts, factor, 1.0) for name in SCENES}
        # Three entries of three conditions.
        assert search._wider(replace(there, sd=sd)) == pytest.approx(2.0 * 9 * wider, abs=1e-12)
    sd = {name: np.where(counts, 1.0, 1.5) for name in SCENES}
    assert search._wider(replace(there, sd=sd)) == pytest.approx(2.0 * 3 * (SIZE - 3) * math.log(1.5), rel=1e-12)
