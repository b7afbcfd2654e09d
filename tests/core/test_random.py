"""Keyed streams: a draw belongs to (sample seed, stage, variate) and to nothing else."""

from __future__ import annotations

import math
from dataclasses import replace
from statistics import NormalDist

import numpy as np
import pytest
import torch
from torch import Tensor
from torch.utils.data import DataLoader, Dataset

from torchweather.core.compiled import SWITCH
from torchweather.core.random import (
    ABSENT,
    Variate,
    draw_variates,
    keyed_stream,
    normal_table,
    normals_of_key,
    sample_seeds,
    sizes_of,
)

SIZES = sizes_of(24, 32)
NORMAL = Variate("noise", "normal", ("H", "W"))


def test_the_same_triple_gives_the_same_numbers() -> None:
    first = keyed_stream(7, "veil.haze").random(100)
    assert np.array_equal(first, keyed_stream(7, "veil.haze").random(100))


@pytest.mark.parametrize(
    ("seed", "stream"), [(8, "veil.haze"), (7, "veil.shell_0"), (7, "other.haze"), (7 + 2**40, "veil.haze")]
)
def test_another_seed_stage_or_variate_gives_unrelated_numbers(seed: int, stream: str) -> None:
    n = 100_000
    first, second = keyed_stream(7, "veil.haze").standard_normal(n), keyed_stream(seed, stream).standard_normal(n)
    # The correlation of n independent pairs has standard deviation 1/sqrt(n); 4.5 of them: once in 1e5.
    assert abs(np.corrcoef(first, second)[0, 1]) < 4.5 / math.sqrt(n)


def test_neighbouring_seeds_are_unrelated() -> None:
    n = 100_000
    drawn = draw_variates([0, 1], "stage", [Variate("noise", "normal", (n,))], SIZES)["stage.noise"]
    assert abs(np.corrcoef(drawn)[0, 1]) < 4.5 / math.sqrt(n)


def test_a_variate_does_not_depend_on_which_others_are_drawn() -> None:
    alone = draw_variates([3], "stage", [NORMAL], SIZES)["stage.noise"]
    with_others = draw_variates([3], "stage", [Variate("first", "uniform", (1000,)), NORMAL], SIZES)["stage.noise"]
    assert np.array_equal(alone, with_others)


def test_a_batch_holds_its_samples_own_draws() -> None:
    together = draw_variates([5, 9], "stage", [NORMAL], SIZES)["stage.noise"]
    for row, seed in enumerate((5, 9)):
        assert np.array_equal(together[row], draw_variates([seed], "stage", [NORMAL], SIZES)["stage.noise"][0])


def test_threads_change_nothing() -> None:
    big = Variate("noise", "normal", (1 << 19,))  # two of them pass THREADED_FROM
    together = draw_variates([5, 9], "stage", [big], SIZES)["stage.noise"]
    assert np.array_equal(together[1], draw_variates([9], "stage", [big], SIZES)["stage.noise"][0])


@pytest.mark.parametrize("law", ["uniform", "normal"])
@pytest.mark.parametrize("count", [4096, 8197, 65_536])
def test_compiled_numbers_are_the_bits_of_numpy(count: int, law: str, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("numba")  # loaded, which a draw alone does not do
    variate = Variate("u", law, (2, "N"))
    found = {}
    for switch in ("1", "0"):
        monkeypatch.setenv(SWITCH, switch)
        found[switch] = draw_variates([3, -(2**62)], "stage", [variate], {"N": count})["stage.u"]
    assert np.array_equal(found["1"], found["0"])


def test_compiled_normals_of_the_tail_are_the_bits_of_numpy() -> None:
    pytest.importorskip("numba")
    from torchweather.core.compiled_philox import draw_standard_normals, ziggurat

    tables = ziggurat()
    assert tables is not None, "numpy's normals are drawn otherwise here; they are then left to numpy"
    found = np.empty(2_000_000, np.float32)
    draw_standard_normals(found, np.uint64(11), np.uint64(2**64 - 3), tables)
    numpys = np.random.Generator(np.random.Philox(key=np.array([11, 2**64 - 3], np.uint64)))
    drawn = numpys.standard_normal(found.size, dtype=np.float32)
    assert np.array_equal(found, drawn)
    assert (np.abs(drawn) > tables.tail).sum() > 400  # 500 are expected: 4.5 standard deviations


@pytest.mark.parametrize(
    ("law", "mean", "variance"), [("uniform", 0.5, 1 / 12), ("normal", 0.0, 1.0), ("exponential", 1.0, 1.0)]
)
def test_standard_variates_have_their_mean_and_variance(law: str, mean: float, variance: float) -> None:
    n = 200_000
    drawn = draw_variates([11], "stage", [Variate("x", law, (n,))], SIZES)["stage.x"].astype(np.float64)
    # 4.5 standard errors; the fourth central moment is at most 9 variances squared (exponential).
    assert abs(drawn.mean() - mean) < 4.5 * math.sqrt(variance / n)
    assert abs(drawn.var() - variance) < 4.5 * variance * math.sqrt(8 / n)


def test_number_of_points_is_poisson() -> None:
    points = Variate("drops", "points", (), per_px2=0.05, margin_x_px=2.0, margin_y_px=3.0, columns=4)
    mean = 0.05 * (32 + 4) * (24 + 6)
    assert points.mean_points(SIZES) == pytest.approx(mean)
    n = 4000
    drawn = draw_variates(range(n), "stage", [points], SIZES)["stage.drops"]
    counts = (drawn[..., -1] < ABSENT).sum(1).astype(np.float64)
    # Mean and variance of a Poisson count are equal; the sample variance scatters by sqrt((2 + 1/mean) / n) of itself.
    assert abs(counts.mean() - mean) < 4.5 * math.sqrt(mean / n)
    assert abs(counts.var(ddof=1) - mean) < 4.5 * mean * math.sqrt((2 + 1 / mean) / n)


def test_points_are_uniform_and_the_present_ones_come_first() -> None:
    points = Variate("drops", "points", (), per_px2=20.0, columns=4)
    drawn = draw_variates([2], "stage", [points], SIZES)["stage.drops"][0]
    present = drawn[:, -1] < ABSENT
    n = int(present.sum())
    assert present[:n].all()
    assert not present[n:].any()
    assert drawn[:n].min() >= 0.0
    assert drawn[:n].max() < 1.0
    assert np.all(np.abs(drawn[:n].mean(0) - 0.5) < 4.5 * math.sqrt(1 / 12 / n))


def test_a_draw_up_to_a_level_is_the_beginning_of_a_whole_one() -> None:
    whole = Variate("drops", "points", (), per_px2=20.0, columns=4)
    part = replace(whole, level_limit=0.02)
    every, some = (draw_variates([2], "stage", [one], SIZES)["stage.drops"][0] for one in (whole, part))
    assert 2 * len(some) < len(every)
    assert np.array_equal(every[: len(some)], some)
    assert np.all(np.diff(every[:, 3]) >= 0)
    assert some[-1, 3] > 0.02  # no point of a lower level is left out


@pytest.mark.parametrize("first", [0, 1, 3, 16, 37, 16 * 4096, 100_001])
def test_normals_of_a_key_begin_at_any_number(first: int) -> None:
    key = np.array([3, 2**63 + 5], np.uint64)
    every = normals_of_key(key, (300_000,))
    for number in (1, 5, 70_000, 150_000):
        assert np.array_equal(normals_of_key(key, (number,), first), every[first : first + number])


def test_the_tabulated_normal_law_is_the_normal_one() -> None:
    """Against the closed form: mean, variance, kurtosis, quantiles; and a log-normal of it, as the haze has."""
    table = normal_table().astype(float)
    assert table.mean() == pytest.approx(0.0, abs=1e-7)
    assert (table**2).mean() == pytest.approx(1.0, abs=1e-6)
    assert (table**4).mean() == pytest.approx(3.0, abs=3e-4)  # the ends of the law lie in two values
    assert np.array_equal(table, np.sort(table))
    inner = NormalDist()
    for k in (1, 100, 3000, 30000, 60000, 65534):
        assert inner.inv_cdf(k / 65536) < table[k] < inner.inv_cdf((k + 1) / 65536)
    for deviation in (0.1, 0.5, 1.0):
        assert np.exp(deviation * table).mean() == pytest.approx(math.exp(0.5 * deviation**2), rel=2e-5)
    drawn = draw_variates([3], "stage", [Variate("haze", "tabulated_normal", (400, 500))], {})["stage.haze"][0]
    n = drawn.size  # four standard errors of each
    assert drawn.mean() == pytest.approx(0.0, abs=4 / math.sqrt(n))
    assert drawn.var() == pytest.approx(1.0, abs=4 * math.sqrt(2 / n))
    for lag in (1, 2, 3, 4, 500):  # four values come from one word of random bits
        flat = drawn.ravel().astype(float)
        assert (flat[lag:] * flat[:-lag]).mean() == pytest.approx(0.0, abs=4 / math.sqrt(n))


def test_capacity_depends_on_sizes_only() -> None:
    points = Variate("drops", "points", (), per_px2=0.01, columns=4)
    shapes = {draw_variates([seed], "stage", [points], SIZES)["stage.drops"].shape for seed in range(50)}
    assert len(shapes) == 1


@pytest.mark.parametrize("batch", [(), (1,), (4,), (2, 3)])
def test_exactly_one_integer_per_sample_is_taken_from_the_generator(batch: tuple[int, ...]) -> None:
    taken, counted = torch.Generator().manual_seed(5), torch.Generator().manual_seed(5)
    sample_seeds(batch, taken)
    for _ in range(math.prod(batch)):
        torch.randint(0, 2**63 - 1, (), generator=counted)
    assert torch.equal(taken.get_state(), counted.get_state())


def test_the_global_generator_is_untouched_where_one_is_given() -> None:
    before = torch.get_rng_state()
    sample_seeds((3,), torch.Generator().manual_seed(1))
    sample_seeds((3,), seed=1)
    assert torch.equal(before, torch.get_rng_state())


def test_without_a_generator_the_global_one_decides() -> None:
    torch.manual_seed(4)
    first = sample_seeds((3,))
    torch.manual_seed(4)
    assert first == sample_seeds((3,))
    assert first != sample_seeds((3,))


def test_seeds_come_as_integers_in_row_major_order() -> None:
    assert sample_seeds((2, 2), seed=10) == [10, 11, 12, 13]
    assert sample_seeds((2, 2), seed=torch.tensor([[4, 3], [2, 1]])) == [4, 3, 2, 1]
    assert all(0 <= seed < 2**63 for seed in sample_seeds((100,)))


def test_wrong_seeds_are_refused_with_what_was_wanted() -> None:
    with pytest.raises(ValueError, match=r"either seed or generator"):
        sample_seeds((2,), torch.Generator(), seed=1)
    with pytest.raises(ValueError, match=r"batch shape \(2,\); got shape \(3,\)"):
        sample_seeds((2,), seed=torch.arange(3))
    with pytest.raises(TypeError, match=r"integers; got dtype torch.float32"):
        sample_seeds((2,), seed=torch.ones(2))
    with pytest.raises(TypeError, match=r"integer"):
        sample_seeds((2,), seed=1.5)  # type: ignore[arg-type]


def test_unknown_law_is_refused() -> None:
    with pytest.raises(
        ValueError, match=r"law must be one of uniform, normal, tabulated_normal, exponential, points; got 'gaussian'"
    ):
        Variate("x", "gaussian")


class _SeedsOfWorkers(Dataset[Tensor]):
    def __len__(self) -> int:
        return 8

    def __getitem__(self, index: int) -> Tensor:
        return torch.tensor(sample_seeds((), None)[0])


def test_data_loader_workers_and_epochs_draw_different_weather() -> None:
    loader = DataLoader(_SeedsOfWorkers(), batch_size=1, num_workers=2)
    seeds = [int(seed) for _ in range(2) for seed in loader]
    assert len(set(seeds)) == len(seeds) == 16
