"""Statistics of frames: stabilised entries against closed forms, vectors against plain loops, the noise of portions."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from torchweather.gap.inference.config import SCATTER
from torchweather.gap.statistics.frame_statistics import FEWEST, Group, Layout, Pool, Reduced

RNG = np.random.default_rng
STEADY = 0.1


def reduced(weight: Any, value: Any = None, square: Any = None, scalar: Any = None, maps: Any = None) -> Reduced:
    """Frames of one bin each, or as given; what is not given is 0."""
    weight = np.asarray(weight, dtype=np.float64)
    weight = weight[:, None] if weight.ndim == 1 else weight
    parts = [np.zeros_like(weight) if part is None else np.reshape(part, weight.shape) for part in (value, square)]
    scalar = np.zeros((len(weight), 0)) if scalar is None else np.asarray(scalar, dtype=np.float64)
    maps = np.zeros((len(weight), 0, 1)) if maps is None else np.asarray(maps, dtype=np.float64)
    return Reduced(weight, *parts, scalar, maps)


def one_bin(kind: str) -> Layout:
    return Layout((Group("it", "axis", kind, (0.0, 1.0)),), (), (), ())


def each_alone(layout: Layout, frames: Reduced) -> Any:
    """The entry of each frame by itself."""
    return Pool(layout, frames).vectors(np.arange(len(frames))[:, None])[:, 0]


# ---- closed forms ----------------------------------------------------------------------------------------------------

# The variance of 20,000 draws is known to sqrt(2 / 20,000) = 1 %; 5 % is five times that.
DRAWS, TOLERANCE = 20_000, 0.05


@pytest.mark.parametrize("share", [0.1, 0.3, 0.5, 0.9])
def test_the_variance_of_a_share_is_a_quarter_over_the_number(share: float) -> None:
    number = 400
    hits = RNG(1).binomial(number, share, DRAWS)
    found = each_alone(one_bin("share"), reduced(np.full(DRAWS, number), hits, hits))
    assert found.var() == pytest.approx(1.0 / (4 * number), rel=TOLERANCE)
    assert np.sin(found.mean()) ** 2 == pytest.approx(share, abs=0.002)


@pytest.mark.parametrize("mean", [10.0, 40.0, 400.0])
def test_the_variance_of_a_count_is_a_quarter(mean: float) -> None:
    counts = RNG(2).poisson(mean, DRAWS)
    found = each_alone(one_bin("count"), reduced(np.ones(DRAWS), counts, counts))
    assert found.var() == pytest.approx(0.25, rel=TOLERANCE)


def test_the_variance_of_a_spread_is_a_half_over_the_number_whatever_the_scale() -> None:
    number = 200
    for scale in (0.01, 10.0):
        values = scale * RNG(3).normal(size=(DRAWS // 4, number)) + 3.0 * scale
        sums = (values.sum(1), (values**2).sum(1))
        found = each_alone(one_bin("spread"), reduced(np.full(len(values), number), *sums))
        # 5,000 draws: 2 %.
        assert found.var() == pytest.approx(1.0 / (2 * number), rel=2.0 * TOLERANCE)
        # Half of 1/n is lost to the mean of the bin, half to the curve of the logarithm; 4 x 0.05 / sqrt(5,000).
        assert found.mean() == pytest.approx(math.log(scale) - 1.0 / number, abs=0.003)


def test_a_share_and_a_count_of_nothing_are_finite() -> None:
    nothing = reduced(np.zeros(2))
    for kind in ("share", "count", "mean", "spread"):
        assert np.isfinite(each_alone(one_bin(kind), nothing)).all()


def test_between_is_the_logarithm_of_the_standard_deviation_of_the_frames() -> None:
    scalar = np.array([1.0, 4.0, 2.0, 9.0])
    pool = Pool(Layout((), ("it",), (STEADY,), ()), reduced(np.zeros((4, 0)), scalar=scalar[:, None]))
    between, _ = pool.vectors(np.array([[0, 1, 2, 3]]))[0]
    assert between == pytest.approx(math.log(math.hypot(scalar.std(ddof=1), STEADY)), rel=1e-12)


@pytest.mark.parametrize("time_s", [None, np.array([0.0, 1.0, 5.0, 6.0, 20.0])])
def test_slope_is_the_change_from_the_first_frame_to_the_last(time_s: Any) -> None:
    along = np.arange(5.0) / 4.0 if time_s is None else time_s / 20.0
    pool = Pool(Layout((), ("it",), (STEADY,), ()), reduced(np.zeros((5, 0)), scalar=(7.0 - 3.0 * along)[:, None]))
    assert pool.vectors(np.arange(5)[None], time_s)[0, 1] == pytest.approx(-3.0, rel=1e-12)
    backwards = pool.vectors(np.arange(5)[None, ::-1], None if time_s is None else time_s[::-1])[0, 1]
    assert backwards == pytest.approx(3.0 if time_s is None else -3.0, rel=1e-12)


def test_frames_of_one_time_have_no_slope() -> None:
    pool = Pool(Layout((), ("it",), (STEADY,), ()), reduced(np.zeros((3, 0)), scalar=np.array([[1.0], [2.0], [3.0]])))
    assert pool.vectors(np.arange(3)[None], np.zeros(3))[0, 1] == 0.0


def test_persistence_is_what_stays_in_its_place() -> None:
    same, apart = np.tile([3.0, 0.0, 4.0, 0.0], (3, 1)), 5.0 * np.eye(3, 4)
    for maps, expected in ((same, 5.0), (apart, 0.0)):
        pool = Pool(Layout((), (), (), ("it",)), reduced(np.zeros((3, 0)), maps=maps[:, None]))
        assert pool.vectors(np.arange(3)[None])[0, 0] == pytest.approx(expected, abs=1e-12)


# ---- the vector ------------------------------------------------------------------------------------------------------

WHOLE = Layout(
    (
        Group("a", "x", "share", (0.0, 1.0, 2.0)),
        Group("b", "x", "mean", (0.0, 1.0, 2.0, 3.0)),
        Group("b", "y", "spread", (0.0, 1.0, 2.0)),
        Group("c", "z", "count", (0.0, 5.0)),
    ),
    ("s", "t"),
    (STEADY, 0.2),
    ("m",),
)


def random_frames(number: int, seed: int = 4) -> Reduced:
    rng = RNG(seed)
    weight = rng.integers(30, 60, (number, WHOLE.bins)).astype(np.float64)
    value = weight * rng.uniform(0.1, 0.9, weight.shape)
    return Reduced(weight, value, 2.0 * value, rng.normal(size=(number, 2)), rng.poisson(2.0, (number, 1, 6)) * 1.0)


def looped(frames: Reduced, draw: Any, time_s: Any) -> list[float]:
    """One vector, entry by entry, in plain Python."""
    found, place = [], 0
    for group in WHOLE.binned:
        for _ in range(group.bins):
            w, v, q = (
                sum(float(part[k, place]) for k in draw) for part in (frames.weight, frames.value, frames.square)
            )
            found.append(
                {
                    "share": math.asin(math.sqrt((v + 0.375) / (w + 0.75))),
                    "count": math.sqrt(v + 0.375),
                    "mean": v / w,
                    "spread": math.log(math.sqrt(q / w - (v / w) ** 2)),
                }[group.kind]
            )
            place += 1
    columns = [[float(frames.scalar[k, place]) for k in draw] for place in range(2)]
    for column, steady in zip(columns, WHOLE.steady, strict=True):
        found.append(math.log(math.hypot(np.std(column, ddof=1), steady)))
    found += [float(np.polyfit(time_s, column, 1)[0]) * (max(time_s) - min(time_s)) for column in columns]
    pairs = [
        float(frames.maps[j, 0] @ frames.maps[k, 0])
        for place, j in enumerate(draw)
        for other, k in enumerate(draw)
        if place != other
    ]
    return [*found, math.sqrt(sum(pairs) / len(pairs))]


def test_vectors_agree_with_plain_loops() -> None:
    frames, time_s = random_frames(7), np.array([0.0, 0.1, 0.3, 0.35])
    index = np.array([[0, 3, 5, 6], [6, 5, 1, 2], [4, 4, 0, 1]])
    found = Pool(WHOLE, frames).vectors(index, time_s)
    assert found.shape == (3, WHOLE.size)
    expected = [looped(frames, draw, time_s) for draw in index]
    # Double precision; the variance of a bin loses two digits.
    np.testing.assert_allclose(found, expected, rtol=1e-10)


def test_the_layout_covers_the_vector_once() -> None:
    groups, slices = WHOLE.groups, WHOLE.slices
    assert [group.kind for group in groups[4:]] == ["between", "between", "slope", "slope", "persistence"]
    assert [place for part in slices for place in range(part.start, part.stop)] == list(range(WHOLE.size))
    assert all(part.stop - part.start == group.bins for part, group in zip(slices, groups, strict=True))
    assert (WHOLE.bins, WHOLE.size) == (8, 13)


def test_joined_frames_give_what_one_pool_gives() -> None:
    frames = random_frames(6)
    names = ("weight", "value", "square", "scalar", "maps")
    parts = [Reduced(*(getattr(frames, name)[cut] for name in names)) for cut in (slice(0, 2), slice(2, 6))]
    index = np.array([[1, 2, 5]])
    np.testing.assert_array_equal(Pool(WHOLE, Reduced.joined(parts)).vectors(index), Pool(WHOLE, frames).vectors(index))


AVERAGED = (
    Group("a", "x", "mean", (0.0, 1.0, 2.0)),
    Group("s", "x", "share", (0.0, 1.0)),
    Group("a", "y", "mean", (0.0, 1.0)),
    Group("a", "z", "spread", (0.0, 1.0)),
    Group("p", "particle_range_m", "mean", (0.0, 1.0)),
    Group("b", "y", "mean", (0.0, 1.0, 2.0)),
)


def test_averages_are_the_means_of_elements_that_a_whole_frame_moves() -> None:
    """Neither particles, which have no clear frame, nor a share or a spread, which no clock moves."""
    assert [one.is_average_of("a") for one in AVERAGED] == [True, False, True, False, False, False]
    assert [one.is_average_of("b") for one in AVERAGED] == [False] * 5 + [True]
    assert not AVERAGED[4].is_average_of("p")


def test_the_average_of_a_frame_is_that_of_all_its_elements_whatever_their_bins() -> None:
    #                  a    a    s    a    a    p    b    b
    weight = np.array([[1.0, 3.0, 9.0, 4.0, 4.0, 7.0, 2.0, 0.0], [2.0, 2.0, 9.0, 4.0, 4.0, 7.0, 0.0, 0.0]])
    value = np.array([[5.0, 3.0, 1.0, 8.0, 1.0, 7.0, 3.0, 0.0], [0.0, 6.0, 1.0, 6.0, 1.0, 7.0, 0.0, 0.0]])
    noise = np.array([0.3, 0.1, 9.0, 9.0, 9.0, 9.0, 0.2, 0.0])
    found = Pool(Layout(AVERAGED, (), (), ()), reduced(weight, value, value)).averages(noise)
    assert sorted(found) == ["a", "b"]
    np.testing.assert_allclose(found["a"][0], [(5.0 + 3.0) / 4.0, 6.0 / 4.0], rtol=1e-12)
    np.testing.assert_allclose(found["b"][0], [1.5, 0.0], rtol=1e-12)  # 0 where there is none
    # Shares of the elements: a quarter and a half in the first bin, three quarters and a half in the second.
    assert found["a"][1] == pytest.approx(0.375**2 * 0.3 + 0.625**2 * 0.1, rel=1e-12)


# ---- the noise of portions -------------------------------------------------------------------------------------------


def noise_variance(layout: Layout, frames: Reduced, portions: int, number: int, clear_frames: int = 10**6) -> Any:
    return (Pool(layout, frames).element_noise(portions, number, clear_frames) ** 2).sum(1).mean(0)


@pytest.mark.parametrize("number", [1, 3])
def test_the_noise_of_a_mean_is_that_of_its_elements_over_their_number(number: int) -> None:
    portions, frames = 50, 40
    values = RNG(5).normal(2.0, 3.0, (frames, portions))
    found = noise_variance(
        one_bin("mean"), reduced(np.ones(values.size), values.ravel(), values.ravel() ** 2), portions, number
    )
    # A mean is straight in the sums of its values, and its weights have no noise.
    np.testing.assert_allclose(found, values.var(0, ddof=1).mean() / (number * portions), rtol=1e-6)


def test_what_differs_from_element_to_element_in_all_frames_alike_is_no_noise() -> None:
    portions, frames = 50, 8
    pattern, noise = RNG(5).normal(2.0, 3.0, portions), RNG(6).normal(0.0, 0.1, (frames, portions))
    values = pattern + noise
    found = noise_variance(
        one_bin("mean"), reduced(np.ones(values.size), values.ravel(), values.ravel() ** 2), portions, 1
    )
    np.testing.assert_allclose(found, noise.var(0, ddof=1).mean() / portions, rtol=1e-6)


def test_frames_made_from_the_same_clear_ones_know_only_so_much_noise() -> None:
    """16 frames from 4 clear ones, four each: of the noise a quarter is in their mean."""
    portions, clear = 200, 4
    values = np.tile(RNG(7).normal(0.0, 1.0, (clear, portions)), (4, 1))
    frames = reduced(np.ones(values.size), values.ravel(), values.ravel() ** 2)
    found = noise_variance(one_bin("mean"), frames, portions, 1, clear)
    # 200 variances of three degrees of freedom: known to sqrt(2 / 600) = 6 %.
    assert found[0] * portions == pytest.approx(1.0, rel=3 * math.sqrt(2.0 / (3.0 * portions)))
    assert found[0] == pytest.approx(noise_variance(one_bin("mean"), frames, portions, 1)[0] * (4 / 3) / (16 / 15))


@pytest.mark.parametrize("number", [1, 4])
def test_the_noise_of_a_count_is_a_quarter(number: int) -> None:
    # Portions of a Poisson count are Poisson. 400 frames of 50 portions: known to sqrt(2 / 20,000) = 1 %; of the root's
    # variance 3/8 over the count, 0.4 %, is not there.
    portions, frames = 50, 400
    counts = RNG(6).poisson(2.0, frames * portions)
    found = noise_variance(one_bin("count"), reduced(np.ones(len(counts)), counts, counts), portions, number)
    assert found[0] == pytest.approx(0.25, rel=TOLERANCE)


def test_the_noise_of_portions_knows_nothing_of_what_is_between_frames() -> None:
    found = Pool(WHOLE, random_frames(12)).element_noise(4, 3, 3)
    assert found.shape == (3, 4, WHOLE.size)
    assert (found[..., WHOLE.bins :] == 0).all()
    assert (found[..., : WHOLE.bins].var(1) > 0).all()


# ---- what counts -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", sorted(FEWEST))
def test_a_bin_counts_from_its_least_weight(kind: str) -> None:
    for frames, expected in ((3, False), (4, True)):
        pool = Pool(one_bin(kind), reduced(np.full(2, FEWEST[kind] / 4.0)))
        assert pool.enough(frames).tolist() == [expected]


def test_what_is_between_frames_needs_three_of_them_and_persistence_two() -> None:
    layout = Layout((), ("it",), (STEADY,), ("m",))
    pool = Pool(layout, reduced(np.zeros((5, 0)), scalar=np.zeros((5, 1)), maps=np.zeros((5, 1, 2))))
    assert [pool.enough(number).tolist() for number in (1, 2, 3)] == [
        [False, False, False],
        [False, False, True],
        [True, True, True],
    ]
    assert np.isfinite(pool.vectors(np.array([[0]]))).all()


def test_the_scatter_of_independent_elements_is_that_of_their_law() -> None:
    number, weight, sd = 4, 100.0, 2.0
    frames = reduced(np.full(3, weight), np.zeros(3), np.full(3, weight * sd**2))
    elements = number * weight
    for kind, closed in (
        ("share", 0.5 / math.sqrt(elements)),
        ("count", 0.5),
        ("mean", sd / math.sqrt(elements)),
        ("spread", 1.0 / math.sqrt(2.0 * elements)),
    ):
        found = float(Pool(one_bin(kind), frames).independent_scatter(number)[0])
        assert found == pytest.approx(closed, rel=1e-12)


@pytest.mark.parametrize("number", [2, 20])
def test_no_number_of_frames_tells_more_of_what_each_element_has_in_all_of_them(number: int) -> None:
    """Nine paths in each frame, each off by a draw of its own that stays: their mean is off by a third of that."""
    weight, known_to = 9.0, 1.5
    off = np.random.default_rng(1).normal(0.0, known_to, (20_000, 9))
    frames = reduced(np.full(3, weight), np.zeros(3), np.full(3, 1e-6 * weight))
    layout = Layout((Group("it", "x", "mean", (0.0, 1.0), known_to),), (), (), ())
    # 20,000 draws: 0.5 %.
    assert float(Pool(layout, frames).known_to(number)[0]) == pytest.approx(off.mean(1).std(), rel=0.02)
    # What is no longer a whole one a frame is known no better than one is.
    few = reduced(np.full(3, 0.1), np.zeros(3), np.full(3, 1e-7))
    assert float(Pool(layout, few).known_to(number)[0]) == pytest.approx(known_to, rel=1e-3)


def particles(kind: str, values: Any, weight: Any) -> Pool:
    edges = tuple(float(place) for place in range(len(values) + 1))
    layout = Layout((Group("it", "particle_range_m", kind, edges),), (), (), ())
    one = (np.asarray(part, dtype=np.float64)[None] for part in (weight, values, values))
    return Pool(layout, reduced(*one))


def test_misplaced_particles_make_counts_uncertain_by_what_crosses_the_edges() -> None:
    """Of 100 particles in each bin 3 may belong to either side, and as many may come from each side."""
    pool = particles("count", [100.0] * 4, [1.0] * 4)
    assert not pool.known_to(1).any()
    crossing = np.array([6.0, 9.0, 9.0, 6.0])  # own ones, and those of the bins beside
    expected = np.sqrt(100.375 + 0.5 * crossing) - np.sqrt(100.375 - 0.5 * crossing)
    np.testing.assert_allclose(pool.known_to(1, 0.03), expected, rtol=0.01)


def test_one_element_seen_again_and_again_is_no_sure_mean() -> None:
    """Bins at 0 and 3 with no spread of their own: elements differ by 1.5 over all, which counts as five of them."""
    number, weight = 4, np.array([[5.0, 5.0]])
    value = weight * np.array([0.0, 3.0])
    layout = Layout((Group("it", "x", "mean", (0.0, 1.0, 2.0)), Group("many", "x", "count", (0.0, 1.0))), (), (), ())
    frames = [np.concatenate([one, [[1.0]]], 1) for one in (weight, value, value * np.array([0.0, 3.0]))]
    found = Pool(layout, reduced(*frames)).scatter_of_few(number, 5.0)
    np.testing.assert_allclose(found[:2], math.sqrt(5.0 * 1.5**2 / 25.0 / 20.0), rtol=1e-9)
    assert found[2] == 0.0


def test_misplaced_particles_move_what_stays_in_its_place() -> None:
    """Of 300 particles in one of two rings 3 % may lie in the other, which the first then has too many of."""
    maps = np.tile([300.0, 0.0], (2, 1, 1))
    pool = Pool(Layout((), (), (), ("it",)), reduced(np.zeros((2, 0)), maps=maps))
    assert pool.known_to(2)[0] == pytest.approx(3.0, rel=1e-9)
    moved = pool.vectors(np.arange(2)[None])[0, 0] - math.hypot(0.97 * 300.0, 0.03 * 300.0)
    assert pool.known_to(2, 0.03)[0] == pytest.approx(math.hypot(3.0, moved), rel=0.02)


def test_a_bin_beside_a_full_one_knows_nothing() -> None:
    pool = particles("count", [1000.0, 0.0, 0.0], [1.0] * 3)
    added = np.sqrt(pool.known_to(1, 0.03) ** 2 - pool.known_to(1) ** 2)
    assert added[1] == pytest.approx(0.5 * math.sqrt(0.375), rel=1e-9)  # all of it
    assert added[2] == pytest.approx(0.5 * 0.03 * math.sqrt(0.375), rel=1e-9)


def test_misplaced_particles_move_shares_and_means_of_their_bins() -> None:
    shares = particles("share", [40.0] * 3, [100.0] * 3)
    added = shares.known_to(1, 0.03)
    inside = 40.375 / 100.75
    expected = [abs(math.asin(math.sqrt(inside - part)) - math.asin(math.sqrt(inside))) for part in (0.06, 0.09, 0.06)]
    np.testing.assert_allclose(added, expected, rtol=1e-6)
    means = particles("mean", [40.0] * 3, [100.0] * 3)
    added = means.known_to(1, 0.03)
    np.testing.assert_allclose(added, [0.06, 0.09, 0.06], rtol=1e-6)


def test_the_spread_of_misplaced_particles_is_known_to_a_fifth() -> None:
    """As their readings are the largest of several; where none is misplaced it is known as others are."""
    pool = particles("spread", [0.0] * 3, [100.0] * 3)
    added = np.sqrt(pool.known_to(1, 0.03) ** 2 - pool.known_to(1) ** 2)
    np.testing.assert_allclose(added, np.hypot([0.06, 0.09, 0.06], SCATTER.log_read_spread_error), rtol=1e-6)
    assert SCATTER.log_read_spread_error == 0.2
    np.testing.assert_allclose(pool.known_to(1), SCATTER.log_spread_error, rtol=1e-9)  # no spread better than to 3 %


def test_only_what_lies_along_the_range_of_particles_is_misplaced() -> None:
    pool = Pool(one_bin("count"), reduced(np.ones(3), np.full(3, 100.0), np.full(3, 100.0)))
    np.testing.assert_array_equal(pool.known_to(2, 0.5), pool.known_to(2))


def test_a_mean_of_what_weather_leaves_of_a_bin_does_not_count() -> None:
    """Of 100 beams in each bin 60, 40 and 4 are seen in weather; a spread and another mean of them count as ever."""
    edges = (0.0, 1.0, 2.0, 3.0)
    groups = (Group("level", "x", "mean", edges), Group("level", "x", "spread", edges), Group("it", "x", "mean", edges))
    layout = Layout(groups, ("level",), (1e-3,), (), of_seen=("level",))

    def pool(weight: list[float], frames: int) -> Pool:
        rows = np.tile(weight, (frames, len(groups)))
        return Pool(layout, reduced(rows, rows, rows, scalar=np.zeros((frames, 1))))

    # One clear frame or five of them: a frame is compared with a frame.
    for number in (1, 5):
        found = pool([60.0, 40.0, 4.0], 2).mostly_seen(pool([100.0] * 3, number))
        np.testing.assert_array_equal(found, [True, False, False] + [True] * 8)


@pytest.mark.parametrize(("near", "share"), [(1000.0, 0.06), (30.0, 1.0), (0.0, 0.0)])
def test_frames_may_be_alike_where_few_particles_may_lie_beyond_an_edge(near: float, share: float) -> None:
    """Of 2,000 particles 60 may lie elsewhere: all of 30 near ones, but 6 % of 1,000."""
    steady = 0.35
    layout = Layout(
        (Group("it", "particle_range_m", "count", (0.0, 1.0, 2.0, 3.0)),),
        ("near",),
        (steady,),
        (),
        near_counts=("near",),
    )
    values = np.tile([near, 2000.0 - near, 0.0], (4, 1))
    pool = Pool(layout, reduced(np.ones((4, 3)), values, values, scalar=np.full((4, 1), math.sqrt(near + 0.375))))
    assert pool.known_to(4)[3] == 0.0
    # Counts scatter by 0.5; where there are none, by what is called alike.
    alike = math.log(math.hypot(0.5, steady) / steady)
    assert pool.known_to(4, 0.03)[3] == pytest.approx(share * alike, rel=1e-9)
