"""Departures in units of the simulator's own scatter: whitening, noise of the elements, studies that lack nothing."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from tests.gap.tiny_study import tiny_study
from torchweather.atmosphere.weather import Snow
from torchweather.gap.inference.config import NUMERICS, SCATTER
from torchweather.gap.inference.events_along_axes import EventsAlongAxes
from torchweather.gap.inference.simulated_distribution import (
    ElementNoise,
    Observation,
    SimulatedDistribution,
    Whitening,
    _degrees_of_freedom,
    element_noise,
    observations,
    simulated_distribution,
    squares_go_together,
)
from torchweather.gap.sensors.lidar.frames import LidarFrames
from torchweather.gap.statistics.frame_statistics import Group, Layout, Pool, Reduced
from torchweather.gap.study.study import Condition, Study
from torchweather.lidar.effects.all import EFFECTS

RNG = np.random.default_rng
BINS = 6
LAYOUT = Layout((Group("a", "x", "mean", tuple(range(BINS + 1))),), (), (), ())


def pool(frames: int, seed: int, *, common: float = 0.0, elements: int = 400) -> Pool:
    """Means of normal elements; of the variance of each mean a part may be common to a frame."""
    rng = RNG(seed)
    mean = rng.normal(size=(frames, BINS)) / np.sqrt(elements) + common * rng.normal(size=(frames, 1))
    weight = np.full((frames, BINS), float(elements))
    square = weight * (mean**2 + 1.0)
    # All from one clear frame: what differs is the weather's.
    begun = np.zeros(frames, dtype=np.intp)
    return Pool(LAYOUT, Reduced(weight, weight * mean, square, np.zeros((frames, 0)), np.zeros((frames, 0, 1))), begun)


MANY = 10**15  # clear frames, whose mean has no error


def target(study: Study, vector: Any, frames: int, clear: int = MANY) -> Observation:
    condition = replace(study.conditions[0], time_s=None)
    return Observation(condition, vector, np.ones(len(vector), bool), frames, clear_frames=clear)


@pytest.fixture(scope="module")
def study() -> Study:
    return tiny_study(rows=16, columns=32, clear=8, frames=5, weathers=(Snow(2.0), Snow(1.5)))


@pytest.fixture(scope="module")
def model(study: Study) -> LidarFrames:
    return LidarFrames(study)


def no_noise(name: str) -> ElementNoise:
    return ElementNoise({name: np.zeros(BINS)}, np.eye(BINS))


def residual(found: SimulatedDistribution, aim: Observation) -> Any:
    """Whitened departure of a condition."""
    return found.whitened(aim.condition.id, aim.vector - found.mean[aim.condition.id])


# ---- the scatter of a condition --------------------------------------------------------------------------------------


@pytest.mark.parametrize("frames", [1, 4, 10])
def test_the_scatter_is_that_of_a_fresh_measurement_against_the_mean_of_the_pool(study: Study, frames: int) -> None:
    """All of it, with what whole frames do."""
    count, common = 40, 0.2
    aim = target(study, np.zeros(BINS), frames)
    name = aim.condition.id
    z = []
    for seed in range(60):
        found = simulated_distribution({name: pool(count, seed, common=common)}, [aim], no_noise(name), None, seed)
        fresh = pool(frames, 10_000 + seed, common=common).vectors(np.arange(frames)[None])[0]
        z.append(found.z(target(study, fresh, frames)))
    # 60 departures whose entries go together: mean square known to 18 %; the scatter of 40 frames in addition to 22 %
    # each, over 60 pools 3 %.
    assert np.mean(np.square(z)) == pytest.approx(1.0, abs=0.6)


def test_the_scatter_is_at_least_that_of_the_elements(study: Study) -> None:
    aim = target(study, np.zeros(BINS), 4)
    name = aim.condition.id
    noise = ElementNoise({name: np.linspace(0.0, 5.0, BINS)}, np.eye(BINS))
    found = simulated_distribution({name: pool(40, 0)}, [aim], noise, None, 0)
    assert (found.sd[name] >= noise.scatter[name]).all()
    assert found.sd[name][-1] == pytest.approx(5.0, rel=1e-3)  # what is simulated is not noisy


def test_departures_are_in_units_of_all_scatter_and_whitened_ones_of_each_conditions_own(study: Study) -> None:
    count, frames, clear, common = 40, 4, 8, 0.3
    aim = target(study, np.zeros(BINS), frames, clear)
    name = aim.condition.id
    noise = ElementNoise({name: np.full(BINS, 0.5)}, np.eye(BINS))
    found = simulated_distribution({name: pool(count, 3, common=common)}, [aim], noise, None, 0)
    off = replace(aim, vector=found.mean[name] + found.total[name])
    np.testing.assert_allclose(found.z(off), 1.0, rtol=1e-9)
    whitened = found.whitening.undone(residual(found, off))
    np.testing.assert_allclose(whitened, found.total[name] / found.sd[name], rtol=1e-9)


def test_means_of_frames_that_differ_are_known_no_better_than_those_frames_tell(study: Study) -> None:
    """Of means of elements as well: of weather that comes in patches each frame tells something else."""
    count, frames, common = 40, 4, 0.3
    aim = target(study, np.zeros(BINS), frames)
    name = aim.condition.id
    found = simulated_distribution({name: pool(count, 5, common=common)}, [aim], no_noise(name), None, 0)
    expected = np.sqrt((common**2 + 1.0 / 400) / frames * (1.0 + frames / count))
    # 40 draws of the common part: 11 %, three of those.
    np.testing.assert_allclose(found.sd[name], expected, rtol=0.35)


def test_means_carry_the_error_of_the_clear_frames_that_their_elements_have(study: Study) -> None:
    """Frames that are all alike but for what lies between clear frames: the same for all conditions of a scene."""
    count, frames, clear = 40, 5, 8
    rng = RNG(4)
    begun = np.arange(count) % clear
    mean = 0.1 * rng.normal(size=(clear, BINS))[begun]
    weight = np.full((count, BINS), 100.0)
    nothing = np.zeros((count, 0))
    sums = Reduced(weight, weight * mean, weight * (mean**2 + 1.0), nothing, nothing[..., None])
    aim = target(study, np.zeros(BINS), frames, clear)
    name = aim.condition.id
    noise = ElementNoise({name: np.full(BINS, 5.0)}, np.eye(BINS))
    found = simulated_distribution({name: Pool(LAYOUT, sums, begun)}, [aim], noise, None, 0)
    np.testing.assert_allclose(found.sd[name], 5.0, rtol=1e-9)
    np.testing.assert_allclose(found.shared[name], np.sqrt(frames / clear), rtol=1e-9)
    np.testing.assert_allclose(found.total[name], 5.0 * np.sqrt(1.0 + frames / clear), rtol=1e-9)


def test_the_noise_of_elements_grows_as_their_spread_does_and_never_shrinks(study: Study) -> None:
    """An effect that makes ranges noisier makes their means noisier; of other entries the pool itself tells it."""
    aim = target(study, np.zeros(BINS), 4)
    name = aim.condition.id
    noise = ElementNoise({name: np.full(BINS, 0.5)}, np.eye(BINS))
    quiet = pool(40, 0)

    def spread(factor: float) -> Pool:
        frames = quiet.frames
        return Pool(LAYOUT, replace(frames, square=factor**2 * frames.square))

    start = simulated_distribution({name: quiet}, [aim], noise, None, 0)
    for factor, grown in ((3.0, 3.0), (1.0, 1.0), (0.3, 1.0)):
        found = simulated_distribution({name: spread(factor)}, [aim], noise, start, 0)
        # The square holds the mean's, too, a 400th of it.
        np.testing.assert_allclose(found.sd[name], 0.5 * grown, rtol=0.03)
        assert found.whitening is start.whitening


@pytest.mark.parametrize(("before", "expected"), [(0.0, 0.05), (49.0, 0.05), (51.0, 0.01)])
def test_bins_that_other_weather_fills_have_the_noise_of_their_own_elements(
    study: Study, before: float, expected: float
) -> None:
    """Of 100 elements with a spread of 1, in four frames: 1/20, where fewer than half as many told their noise."""
    aim = target(study, np.zeros(BINS), 4)
    name = aim.condition.id
    weight, nothing = np.full((40, BINS), 100.0), np.zeros((40, 0))
    alike = Pool(
        LAYOUT, Reduced(weight, 0.0 * weight, weight, nothing, nothing[..., None]), np.zeros(40, dtype=np.intp)
    )
    noise = ElementNoise({name: np.full(BINS, 0.01)}, np.eye(BINS), {name: np.full(BINS, before)})
    found = simulated_distribution({name: alike}, [aim], noise, None, 0)
    np.testing.assert_allclose(found.sd[name], expected, rtol=1e-6)


@pytest.mark.parametrize("few", [4, 64])
@pytest.mark.parametrize("independent", [1, 7])
def test_a_sum_of_variances_has_degrees_of_freedom_as_drawn(few: int, independent: int) -> None:
    """Portions of which a few make most of the noise; each is seen in so many independent frames."""
    sd = np.where(np.arange(64) < few, 1.0, 0.1)
    squares = (sd[:, None] ** 2) * RNG(12).chisquare(independent, (64, 4000)) / independent
    drawn = 2.0 / np.var(squares.sum(0) / squares.sum(0).mean())
    assert np.median(_degrees_of_freedom(squares, independent)) == pytest.approx(drawn, rel=0.4)


@pytest.mark.parametrize("clear", [2, MANY])
def test_what_the_clear_frames_share_goes_together_as_the_elements_noise_does(study: Study, clear: int) -> None:
    """Correlations are those of the elements, however large a part of the scatter is the clear frames'."""
    aim = target(study, np.zeros(BINS), 4, clear)
    name = aim.condition.id
    noise = ElementNoise({name: np.full(BINS, 5.0)}, correlation(0.6))
    found = simulated_distribution({name: pool(40, 0, common=0.3)}, [aim], noise, None, 0).whitening.factor
    expected = (1.0 - SCATTER.shrinkage) * correlation(0.6) + SCATTER.shrinkage * np.eye(BINS)
    np.testing.assert_allclose(found @ found.T, expected, atol=1e-12)


def test_entries_that_do_not_count_are_zero(study: Study) -> None:
    aim = target(study, np.full(BINS, 100.0), 4)
    aim.enough[2] = False
    name = aim.condition.id
    found = simulated_distribution({name: pool(40, 0)}, [aim], no_noise(name), None, 0)
    assert found.z(aim)[2] == 0.0
    assert residual(found, aim)[2] == 0.0
    assert (np.abs(found.z(aim)[[0, 1, 3, 4, 5]]) > 10.0).all()


# ---- whitening -------------------------------------------------------------------------------------------------------


def correlation(rho: float) -> Any:
    place = np.arange(BINS)
    return rho ** np.abs(place[:, None] - place[None])


NO_EVENTS = EventsAlongAxes(np.eye(BINS), np.zeros(BINS))


def test_whitened_departures_are_independent() -> None:
    shrunk = (1.0 - SCATTER.shrinkage) * correlation(0.8) + SCATTER.shrinkage * np.eye(BINS)
    whitening = Whitening.of(ElementNoise({"c": np.ones(BINS)}, correlation(0.8)), {"c": np.ones(BINS)}, NO_EVENTS)
    draws = RNG(1).normal(size=(20_000, BINS)) @ np.linalg.cholesky(shrunk).T
    found = whitening(draws)
    # 20,000 draws: 5 x sqrt(2 / 20,000) on the diagonal.
    np.testing.assert_allclose(found.T @ found / len(found), np.eye(BINS), atol=0.05)
    np.testing.assert_allclose(whitening(draws[0]), found[0], rtol=1e-12)
    np.testing.assert_allclose(whitening.undone(found), draws, atol=1e-12)


def test_scatter_that_is_an_entrys_own_counts_as_independent() -> None:
    noise = ElementNoise({"c": np.ones(BINS)}, correlation(0.8))
    factor = Whitening.of(noise, {"c": np.full(BINS, 1e6)}, NO_EVENTS).factor
    np.testing.assert_allclose(factor, np.eye(BINS), atol=1e-9)
    half = Whitening.of(noise, {"c": np.full(BINS, 2.0)}, NO_EVENTS).factor
    assert (half @ half.T)[0, 1] == pytest.approx((1.0 - SCATTER.shrinkage) * 0.8 * 0.25, rel=1e-12)


def test_of_correlations_that_few_portions_tell_each_group_is_left_one(study: Study) -> None:
    """80 entries of 12 groups, 60 portions of 4 frames: late entries scatter by more, and those that nearly follow from
    earlier ones by less, unless each fold of the portions is made independent with the others'."""
    groups, bins, portions = 12, 8, 60
    layout = Layout(tuple(Group(f"g{n}", "x", "mean", tuple(range(bins + 1))) for n in range(groups)), (), (), ())
    rng = RNG(8)
    mixing = rng.normal(size=(layout.size, layout.size)) / np.sqrt(layout.size)
    mixing[-bins:] = mixing[:bins] + 0.1 * mixing[-bins:]  # the last group hardly says more than the first
    values = rng.normal(size=(4 * portions, layout.size)) @ mixing.T
    weight = np.full(values.shape, 100.0)
    reduced = Reduced(weight, weight * values, weight, np.zeros((len(values), 0)), np.zeros((len(values), 0, 1)))
    condition = replace(study.conditions[0], time_s=None)
    aim = Observation(condition, np.zeros(layout.size), np.ones(layout.size, bool), 5)
    noise = element_noise({condition.id: Pool(layout, reduced)}, [aim], portions)
    assert noise.folds is not None
    np.testing.assert_allclose(noise.folds.sum(0), noise.correlation, atol=1e-12)
    no_events = EventsAlongAxes(np.eye(layout.size), np.zeros(layout.size))
    scatter = {condition.id: noise.scatter[condition.id]}
    fresh = rng.normal(size=(4000, layout.size)) @ mixing.T / np.sqrt((mixing**2).sum(1))

    def squares(whitening: Whitening) -> Any:
        return (whitening(fresh) ** 2).mean(0).reshape(groups, bins).mean(1)

    calibrated = squares(Whitening.of(noise, scatter, no_events, layout))
    as_told = squares(Whitening.of(replace(noise, folds=None), scatter, no_events, layout))
    # Of n free portions the entry behind p others is left n / (n - p): of those of the other folds somewhat more, so
    # that its square ends below 1. 180 of them tell a square to 11 %, the mean of 8 entries to 4 %: three times that.
    free, before = 3 * portions, np.arange(groups) * bins + 0.5 * bins
    others = free * (1.0 - 1.0 / NUMERICS.whitening_folds)
    expected = (1.0 - before / others) / (1.0 - before / free)
    np.testing.assert_allclose(calibrated, expected, atol=0.13)
    assert as_told[:-1].max() > 1.2
    assert as_told[-1] < 0.8


def test_elements_that_are_measured_again_are_no_sample_of_others(study: Study) -> None:
    """96 targets along three axes, half of them 3 times as noisy: what is measured has the same ones, with new noise.
    Each tenth of the targets tells of noise that no other has, so folds are made of targets and frames together."""
    targets, rng = 96, RNG(11)
    groups = (12, 12, 4)
    layout = Layout(
        tuple(Group(f"g{n}", "x", "mean", tuple(range(bins + 1))) for n, bins in enumerate(groups)), (), (), ()
    )
    where = np.concatenate([np.eye(bins)[rng.integers(0, bins, targets)] for bins in groups], 1)
    sd = np.where(rng.random(targets) < 0.5, 3.0, 1.0)
    aim = Observation(
        replace(study.conditions[0], time_s=None),
        np.zeros(layout.size),
        np.ones(layout.size, bool),
        5,
        clear_frames=NUMERICS.portioned_frames,
    )
    mean_of = where / where.sum(0)
    scatter = np.sqrt(((sd[:, None] * mean_of) ** 2).sum(0))

    def squares() -> Any:
        noise_of_targets = sd[:, None] * rng.normal(size=(NUMERICS.portioned_frames, targets, 1))
        weight = np.tile(where, (NUMERICS.portioned_frames, 1))
        nothing = np.zeros((len(weight), 0)), np.zeros((len(weight), 0, 1))
        reduced = Reduced(weight, weight * noise_of_targets.reshape(-1, 1), weight, *nothing)
        noise = element_noise({aim.condition.id: Pool(layout, reduced)}, [aim], targets)
        events = EventsAlongAxes(np.eye(layout.size), np.zeros(layout.size))
        whitening = Whitening.of(noise, {aim.condition.id: noise.scatter[aim.condition.id]}, events, layout)
        fresh = (sd * rng.normal(size=(2000, targets))) @ mean_of / scatter
        return [float((whitening(fresh)[:, part] ** 2).mean()) for part in layout.slices]

    # Ten studies, in each of which a group's mean square is told to 5 %: 1.6 % for their mean, four times that.
    np.testing.assert_allclose(np.mean([squares() for _ in range(10)], 0), 1.0, atol=0.065)


def test_the_noise_of_the_elements_is_that_of_the_mean_of_independent_ones(study: Study) -> None:
    """Element noise with known sd and correlation: x in three bins, 0.6 x + 0.8 y in the other three."""
    elements, number = 64, 5
    rng = RNG(2)
    x, y = rng.normal(size=(2, NUMERICS.portioned_frames, NUMERICS.portions))
    values = np.stack([x, x, x, *([0.6 * x + 0.8 * y] * 3)], -1).reshape(-1, BINS) / np.sqrt(elements)
    weight = np.full(values.shape, float(elements))
    frames = len(values)
    portioned = Reduced(weight, weight * values, weight, np.zeros((frames, 0)), np.zeros((frames, 0, 1)))
    aim = target(study, np.zeros(BINS), number)
    found = element_noise({aim.condition.id: Pool(LAYOUT, portioned)}, [aim], NUMERICS.portions)
    # Frames of three clear ones, each apart from the mean of the other two, are further apart by 3 / 2.
    few = target(study, np.zeros(BINS), number, clear=3)
    wide = portioned.value * 1.5
    own = element_noise({few.condition.id: Pool(LAYOUT, replace(portioned, value=wide))}, [few], NUMERICS.portions)
    alike = np.sqrt(
        (3 / 2) / (NUMERICS.portioned_frames / (NUMERICS.portioned_frames - 1))
    )  # of so few independent ones
    np.testing.assert_allclose(own.scatter[aim.condition.id], alike * found.scatter[aim.condition.id], rtol=1e-9)
    # 128 portions of 8 frames, 7 of them free: sqrt(0.5 / 896) = 2.4 % of a standard deviation, 3 % of a correlation;
    # three to five times that.
    expected = 1.0 / np.sqrt(number * NUMERICS.portions * elements)
    np.testing.assert_allclose(found.scatter[aim.condition.id], expected, rtol=0.12)
    assert found.correlation[0, 5] == pytest.approx(0.6, abs=0.15)
    assert found.correlation[0, 1] == pytest.approx(1.0, rel=1e-9)


# ---- studies that lack nothing ---------------------------------------------------------------------------------------


def of_study(
    study: Study, model: LidarFrames, seed: int, frames: int = 32
) -> tuple[list[Observation], SimulatedDistribution]:
    aims = observations(model, study.fit)
    seeds = [seed * 1000 + place for place in range(frames)]
    pools, portioned = (
        {
            aim.condition.id: Pool(model.layout, model.simulated(aim.condition, (), 0.0, seeds[:number], portions))
            for aim in aims
        }
        for number, portions in ((frames, 1), (NUMERICS.portioned_frames, NUMERICS.portions))
    )
    return aims, simulated_distribution(pools, aims, element_noise(portioned, aims, NUMERICS.portions), None, seed)


def test_measured_vectors_are_those_of_the_conditions_frames(study: Study, model: LidarFrames) -> None:
    (aim,) = observations(model, study.fit)
    condition: Condition = aim.condition
    frames = Pool(model.layout, model.measured(condition))
    assert (aim.frames, aim.intensity_sd) == (5, 0.05)
    np.testing.assert_array_equal(aim.vector, frames.vectors(np.arange(5)[None], condition.time_s)[0])


@pytest.mark.slow
def test_departures_of_studies_that_lack_nothing_are_about_one() -> None:
    """Root mean square over three studies of about 230 entries each, before and after whitening."""
    squares: dict[str, list[float]] = {"z": [], "whitened": [], "expected": []}
    for seed in range(3):
        made = tiny_study(seed=seed, rows=16, columns=32, weathers=(Snow(2.0), Snow(1.5)))
        aims, found = of_study(made, LidarFrames(made), seed)
        for aim in aims:
            used = found.used[aim.condition.id]
            assert used.sum() > 150
            squares["z"] += list(found.z(aim)[used] ** 2)
            squares["expected"] += list(found.expected[aim.condition.id][used])
            squares["whitened"] += list(residual(found, aim)[used] ** 2)
    for name in ("z", "whitened"):
        # Entries of three studies, half of them with something to tell: 4 x sqrt(0.5 / 400).
        assert np.sqrt(np.sum(squares[name]) / np.sum(squares["expected"])) == pytest.approx(1.0, abs=0.14)


def test_a_vector_of_the_simulator_departs_as_much_as_its_draws(study: Study, model: LidarFrames) -> None:
    (aim,), found = of_study(study, model, 7)
    name = aim.condition.id
    others = Pool(model.layout, model.simulated(aim.condition, (), 0.0, range(90_000, 90_025)))
    vectors = others.vectors(np.arange(25).reshape(5, 5), aim.condition.time_s)
    used = found.used[name]
    own = [residual(found, replace(aim, vector=vector))[used] for vector in vectors]
    # Without the error of the clear frames, from which both start, they depart by less than a measurement would.
    assert 0.6 < np.sqrt(np.mean(np.square(own)) / found.expected[name][used].mean()) < 1.12
    # An effect shows: half a decibel of all intensities.
    window = [EFFECTS["lidar.window_loss"](loss_db=0.5)]
    moved = Pool(model.layout, model.simulated(aim.condition, window, 0.0, range(90_000, 90_005)))
    weaker = replace(aim, vector=moved.vectors(np.arange(5)[None])[0])
    assert np.sqrt(np.mean(residual(found, weaker)[used] ** 2)) > 3.0


# ---- noise that a scene's conditions share ---------------------------------------------------------------------------


def test_counts_that_clear_frames_tell_are_off_alike_in_all_conditions(study: Study) -> None:
    """Poisson counts whose rate the clear frames tell: what a condition departs by is its own noise and theirs."""
    frames, clear, rate, count = 6, 4, 3.0, 200
    layout = Layout((Group("a", "x", "count", tuple(range(BINS + 1))),), (), (), (), from_clear=("a",))
    rng = RNG(0)

    def counted(mean: Any, number: int) -> Pool:
        value = rng.poisson(np.broadcast_to(mean, (number, BINS))).astype(float)
        return Pool(layout, Reduced(np.ones_like(value), value, value, np.zeros((number, 0)), np.zeros((number, 0, 1))))

    name = study.conditions[0].id
    square, product, own, together = 0.0, 0.0, 0.0, 0.0
    for draw in range(count):
        mean = counted(rate, clear).frames.value.mean(0)  # as few clear frames as there are say
        aim = target(study, np.zeros(BINS), frames, clear)
        found = simulated_distribution({name: counted(mean, 48)}, [aim], no_noise(name), None, draw)
        apart = [
            (counted(rate, frames).vectors(np.arange(frames)[None])[0] - found.mean[name]) / found.total[name]
            for _ in range(2)
        ]
        square += float(np.mean(np.square(apart))) / count
        product += float(np.mean(apart[0] * apart[1])) / count
        own += float(np.mean(found.sd[name] ** 2 / found.total[name] ** 2)) / count
        together += float(np.mean((found.shared[name] * found.sd[name]) ** 2 / found.total[name] ** 2)) / count
    # 200 draws of 6 bins: mean squares known to about 6 %.
    assert square == pytest.approx(1.0, abs=0.15)
    assert own + together == pytest.approx(1.0, abs=1e-9)
    assert product == pytest.approx(together, abs=0.15)
    assert together > 0.5  # 6 frames against 4


def test_of_two_clear_frames_spreads_are_known_as_badly_as_their_elements_tell(study: Study) -> None:
    """Departures from the one other clear frame are d and -d: their squares are the same in all simulated frames."""
    elements, count = 80, 150
    layout = Layout((Group("a", "x", "mean", tuple(range(BINS + 1))),), (), (), (), from_clear=("a",))
    rng = RNG(2)

    def reduced(apart: Any) -> Pool:
        wide = np.log1p(np.square(apart))  # (frames, bins, elements)
        number = len(apart)
        weight = np.full((number, BINS), float(elements))
        sums = (weight, wide.sum(-1), np.square(wide).sum(-1))
        return Pool(layout, Reduced(*sums, np.zeros((number, 0)), np.zeros((number, 0, 1))))

    name = study.conditions[0].id
    aim = target(study, np.zeros(BINS), 2, 2)
    square, product, together = 0.0, 0.0, 0.0
    for draw in range(count):
        clear = rng.normal(size=(2, BINS, elements))
        found = simulated_distribution(
            {name: reduced(np.tile(clear - clear[::-1], (12, 1, 1)))}, [aim], no_noise(name), None, draw
        )
        apart = [
            (reduced(rng.normal(size=clear.shape) - clear).vectors(np.arange(2)[None])[0] - found.mean[name])
            / found.total[name]
            for _ in range(2)
        ]
        square += float(np.mean(np.square(apart))) / count
        product += float(np.mean(apart[0] * apart[1])) / count
        together += float(np.mean((found.shared[name] * found.sd[name]) ** 2 / found.total[name] ** 2)) / count
    # 150 draws of 6 bins: mean squares known to about 6 %. More than stated would be false alarms.
    assert square == pytest.approx(1.0, abs=0.15)
    assert product == pytest.approx(together, abs=0.15)
    assert together == pytest.approx(0.5, abs=1e-9)


@pytest.mark.parametrize(("together", "clear"), [(3, 3), (6, 6), (8, 8), (4, 8), (2, 8)])
def test_squares_about_an_own_mean_have_the_scatter_that_is_said(together: int, clear: int) -> None:
    """The sum over m frames drawn anew, against m times the scatter from frame to frame of K clear ones in blocks."""

    def squares(number: int) -> Any:
        values = RNG(number).normal(size=(40_000, number // together, together))
        return np.square(values - values.mean(-1, keepdims=True))

    true = squares(together).sum(-1).var()
    known = squares(clear).reshape(-1, clear).var(-1, ddof=1).mean()
    assert squares_go_together(together, clear) == pytest.approx(true / (together * known), rel=0.05)
