"""CFAR detectors: closed forms, false-alarm rates on noise, a reference in plain loops, targets, bad input."""

from __future__ import annotations

import math
from collections.abc import Iterator

import pytest
import torch
from scipy import stats
from scipy.optimize import brentq
from torch import Tensor

from torchweather.radar.fmcw.cfar import HANN_CORRELATION, CellAveragingCfar, OrderStatisticCfar, window_correlation

WHITE = ((), ())
DETECTORS = [CellAveragingCfar, OrderStatisticCfar]
ROWS, COLUMNS = 64, 128
MAPS_AT_ONCE = 20
# A correct detector exceeds it once in 150,000 comparisons.
STANDARD_ERRORS = 4.5

Detector = CellAveragingCfar | OrderStatisticCfar


def white_noise(maps: int, looks: int, seed: int = 0) -> Iterator[Tensor]:
    """Maps of the mean of independent exponential looks of mean 3e-9."""
    generator = torch.Generator().manual_seed(seed)
    for _ in range(maps // MAPS_AT_ONCE):
        shape = (MAPS_AT_ONCE, looks, ROWS, COLUMNS)
        yield 3e-9 * torch.empty(shape).exponential_(generator=generator).mean(dim=1)


def hann_noise(maps: int, looks: int, seed: int = 0) -> Iterator[Tensor]:
    """The same from complex white noise through Hann-windowed FFTs along both axes."""
    generator = torch.Generator().manual_seed(seed)
    window = torch.hann_window(ROWS)[:, None] * torch.hann_window(COLUMNS)
    for _ in range(maps // MAPS_AT_ONCE):
        shape = (MAPS_AT_ONCE, looks, ROWS, COLUMNS)
        cube = torch.randn(shape, dtype=torch.complex64, generator=generator)
        yield torch.fft.fft2(cube * window).abs().square().mean(dim=1)


def rates_and_errors(detectors: list[Detector], noise: Iterator[Tensor]) -> list[tuple[Detector, bool, float, float]]:
    """False-alarm rate of each over the cells near the range axis' ends, and over all others, and its standard error.

    The error is the binomial one or, where larger, that from the spread between maps: cells of one map share training
    cells, and those of a windowed FFT are correlated. All see the same maps.
    """
    held: dict[tuple[int, bool], list[Tensor]] = {}
    for power in noise:
        for number, cfar in enumerate(detectors):
            found = cfar(power).double()
            near = ends(cfar)
            for edges in (False, True):
                held.setdefault((number, edges), []).append(found[..., near == edges].mean(dim=(-2, -1)))
    rows = []
    for (number, edges), parts in held.items():
        cfar, rates = detectors[number], torch.cat(parts)
        cells = rates.numel() * ROWS * int((ends(cfar) == edges).sum())
        binomial = math.sqrt(cfar.false_alarm_rate / cells)
        rows.append((cfar, edges, float(rates.mean()), max(binomial, float(rates.std() / math.sqrt(rates.numel())))))
    return rows


def ends(cfar: Detector) -> Tensor:
    """Columns whose window reaches over an end of the range axis."""
    near = torch.ones(COLUMNS, dtype=torch.bool)
    near[cfar.reach[1] : -cfar.reach[1]] = False
    return near


def rate_and_error(cfar: Detector, noise: Iterator[Tensor]) -> tuple[float, float]:
    """False-alarm rate away from the ends of the range axis, and its standard error."""
    (_, _, rate, error), _ = rates_and_errors([cfar], noise)
    return rate, error


# Closed forms.


@pytest.mark.parametrize("rate", [1e-2, 1e-4, 1e-6])
def test_cell_averaging_has_the_classical_factor(rate: float) -> None:
    cfar = CellAveragingCfar(false_alarm_rate=rate, guard=(1, 2), training=(2, 5), correlation=WHITE)
    factors = cfar.factors(40).tolist()
    # 7 x 15 less 3 x 5 in the middle, 7 x 8 less 3 x 3 at either end.
    for column, cells in ((20, 90), (0, 47), (39, 47)):
        assert factors[column] == pytest.approx(cells * (rate ** (-1 / cells) - 1), rel=1e-9)


@pytest.mark.parametrize("looks", [2, 12, 192, 512])
def test_cell_averaging_of_several_looks_has_the_factor_of_an_f_distribution(looks: int) -> None:
    cfar = CellAveragingCfar(guard=(1, 2), training=(2, 5), correlation=WHITE, looks=looks)
    assert float(cfar.factors(40)[20]) == pytest.approx(stats.f.isf(1e-4, 2 * looks, 2 * looks * 90), rel=1e-9)


@pytest.mark.parametrize("looks", [1, 12])
def test_correlated_cells_scatter_like_fewer(looks: int) -> None:
    """The mean of correlated cells as a gamma distribution of the same variance: near the exact factor when N is large.

    In the window of 248 cells the rates of the two differ by 1.4 % for one look, the factors by less than 0.5 %.
    """
    cfar = CellAveragingCfar(looks=looks)
    cells = [(row, column) for row in range(-6, 7) for column in range(-10, 11) if abs(row) > 2 or abs(column) > 2]
    correlation = (1.0, *HANN_CORRELATION)
    shared = sum(
        (correlation[abs(a - c)] * correlation[abs(b - d)]) ** 2
        for a, b in cells
        for c, d in cells
        if abs(a - c) < 3 and abs(b - d) < 3
    )
    effective = len(cells) ** 2 / shared
    assert float(cfar.factors(64)[32]) == pytest.approx(stats.f.isf(1e-4, 2 * looks, 2 * looks * effective), rel=5e-3)


def rohling_rate(factor: float, rank: int, cells: int) -> float:
    return math.prod((cells - i) / (cells - i + factor) for i in range(rank))


@pytest.mark.parametrize("rate", [1e-2, 1e-4, 1e-6])
@pytest.mark.parametrize("share", [0.1, 0.75, 1.0])
def test_order_statistic_has_rohlings_factor(rate: float, share: float) -> None:
    cfar = OrderStatisticCfar(false_alarm_rate=rate, guard=(0, 2), training=(0, 10), correlation=WHITE, rank=share)
    factors = cfar.factors(40).tolist()
    for column, cells in ((20, 20), (0, 10), (39, 10)):
        rank = math.ceil(share * cells)
        assert rohling_rate(factors[column], rank, cells) == pytest.approx(rate, rel=1e-8)


def test_order_statistic_of_several_looks_by_a_plain_integral() -> None:
    """The density of the k-th smallest of 20, on a fine grid of powers."""
    cfar = OrderStatisticCfar(guard=(0, 2), training=(0, 10), correlation=WHITE, looks=12)
    noise, factor = stats.gamma(12, scale=1 / 12), float(cfar.factors(40)[20])
    step = 1e-4
    power = torch.arange(step / 2, 6.0, step, dtype=torch.float64).numpy()
    below = noise.cdf(power)
    density = 15 * math.comb(20, 15) * below**14 * (1 - below) ** 5 * noise.pdf(power)
    assert (density * noise.sf(factor * power)).sum() * step == pytest.approx(1e-4, rel=1e-5)


@pytest.mark.parametrize("detector", DETECTORS)
def test_ends_of_the_range_axis_have_larger_factors(detector: type[Detector]) -> None:
    factors, reach = detector().factors(64), detector().reach[1]
    assert torch.equal(factors, factors.flip(0))
    assert factors[0] > factors[reach]
    assert (factors[reach:-reach] == factors[reach]).all()


@pytest.mark.parametrize(
    ("window", "expected"),
    [
        (torch.ones(64), ()),
        (torch.hann_window(64), HANN_CORRELATION),
        # 0.54 - 0.46 cos: the spectrum is 0.54, 0.23, 0.23.
        (torch.hamming_window(64), (2 * 0.54 * 0.23 / 0.3974, 0.23**2 / 0.3974)),
    ],
)
def test_correlation_of_a_window(window: Tensor, expected: tuple[float, ...]) -> None:
    assert window_correlation(window) == pytest.approx(expected, rel=1e-5)


# False-alarm rates.


RATES = (1e-2, 1e-3, 1e-4)


@pytest.mark.parametrize("looks", [1, 12])
@pytest.mark.parametrize("detector", DETECTORS)
def test_false_alarm_rate_in_white_noise(detector: type[Detector], looks: int) -> None:
    """300 maps: 2.0 million cells away from the ends and 0.46 million near them, so +-0.3 to 0.7 % at 1e-2."""
    detectors: list[Detector] = [
        detector(false_alarm_rate=rate, training=(2, 10), looks=looks, correlation=WHITE) for rate in RATES
    ]
    for cfar, edges, measured, error in rates_and_errors(detectors, white_noise(300, looks)):
        rate = cfar.false_alarm_rate
        assert abs(measured - rate) < STANDARD_ERRORS * error, (rate, edges, measured, error)
        # The bound has teeth: 20 % at 1e-2 would be seen.
        assert rate < 1e-2 or STANDARD_ERRORS * error < 0.2 * rate


@pytest.mark.parametrize("looks", [1, 12])
def test_cell_averaging_keeps_its_rate_after_hann_windows(looks: int) -> None:
    """600 maps of one look (4.0 and 0.92 million cells), 100 of twelve; a window of few cells, where it is hardest."""
    detectors: list[Detector] = [
        CellAveragingCfar(false_alarm_rate=rate, training=(2, 10), looks=looks) for rate in RATES
    ]
    for cfar, edges, measured, error in rates_and_errors(detectors, hann_noise(600 if looks == 1 else 100, looks)):
        rate = cfar.false_alarm_rate
        assert abs(measured - rate) < STANDARD_ERRORS * error, (rate, edges, measured, error)


@pytest.mark.parametrize("detector", DETECTORS)
def test_hann_windows_taken_for_white_raise_the_rate(detector: type[Detector]) -> None:
    """What the correlation is for: without it the same noise gives a third more at 1e-3."""
    cfar = detector(false_alarm_rate=1e-3, training=(2, 4), correlation=WHITE)
    measured, error = rate_and_error(cfar, hann_noise(100, 1))
    assert measured - 1e-3 > STANDARD_ERRORS * error
    assert measured > 1.3e-3


# The approximation of the order statistic, by the number of looks: rate over the rate asked for, in its own window.
@pytest.mark.parametrize(
    ("looks", "rate", "low", "high"),
    [(1, 1e-2, 0.95, 1.0), (1, 1e-3, 0.85, 0.95), (1, 1e-4, 0.7, 0.9), (12, 1e-2, 0.97, 1.01), (12, 1e-3, 0.92, 1.0)],
)
def test_order_statistic_after_hann_windows(looks: int, rate: float, low: float, high: float) -> None:
    """The rate lies within the stated limits, widened by the error of 2.2 million (one look: 5.2 million) cells."""
    cfar = OrderStatisticCfar(false_alarm_rate=rate, looks=looks)
    measured, error = rate_and_error(cfar, hann_noise(700 if looks == 1 else 300, looks))
    assert low * rate - STANDARD_ERRORS * error < measured < high * rate + STANDARD_ERRORS * error, measured / rate


# The fast paths against plain loops.


def training_powers(power: Tensor, row: int, column: int, guard: tuple[int, int], training: tuple[int, int]) -> Tensor:
    rows, columns = power.shape
    found = []
    for down in range(-guard[0] - training[0], guard[0] + training[0] + 1):
        for right in range(-guard[1] - training[1], guard[1] + training[1] + 1):
            in_guard = abs(down) <= guard[0] and abs(right) <= guard[1]
            if not in_guard and 0 <= column + right < columns:
                found.append(power[(row + down) % rows, column + right])
    return torch.stack(found)


WINDOWS = [((1, 2), (2, 3)), ((0, 2), (0, 4)), ((2, 1), (3, 0)), ((1, 1), (0, 3)), ((0, 0), (1, 1))]


@pytest.mark.parametrize(("guard", "training"), WINDOWS)
def test_cell_averaging_agrees_with_plain_loops(guard: tuple[int, int], training: tuple[int, int]) -> None:
    power = next(white_noise(20, 1))[0, :12, :17].double()
    cfar = CellAveragingCfar(false_alarm_rate=1e-3, guard=guard, training=training, correlation=WHITE)
    threshold = cfar.threshold(power)
    for row in range(12):
        for column in range(17):
            cells = training_powers(power, row, column, guard, training)
            expected = float(cells.sum()) * (1e-3 ** (-1 / len(cells)) - 1)
            assert float(threshold[row, column]) == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize(("guard", "training"), WINDOWS)
def test_order_statistic_agrees_with_plain_loops(guard: tuple[int, int], training: tuple[int, int]) -> None:
    power = next(white_noise(20, 1))[0, :12, :17].double()
    cfar = OrderStatisticCfar(false_alarm_rate=1e-2, guard=guard, training=training, correlation=WHITE)
    threshold = cfar.threshold(power)
    factors: dict[int, float] = {}
    for row in range(12):
        for column in range(17):
            cells = training_powers(power, row, column, guard, training).sort().values
            count, rank = len(cells), math.ceil(0.75 * len(cells))
            if count not in factors:
                factors[count] = brentq(lambda a, k, n: rohling_rate(a, k, n) - 1e-2, 0.0, 1e6, args=(rank, count))
            assert float(threshold[row, column]) == pytest.approx(factors[count] * float(cells[rank - 1]), rel=1e-8)


@pytest.mark.parametrize(("guard", "training"), WINDOWS)
@pytest.mark.parametrize("detector", DETECTORS)
def test_detections_are_the_cells_above_the_threshold(
    detector: type[Detector], guard: tuple[int, int], training: tuple[int, int]
) -> None:
    """Equal powers and zeros among them: a cell at its threshold is none, on both paths."""
    cfar = detector(false_alarm_rate=0.1, guard=guard, training=training)
    power = (4 * next(white_noise(20, 1)) / 3e-9).floor()
    detections = cfar(power)
    assert detections.dtype == torch.bool
    assert 0 < int(detections.sum()) < detections.numel() / 4
    assert torch.equal(detections, power > cfar.threshold(power))
    assert not cfar(torch.zeros(12, 17)).any()


@pytest.mark.parametrize("detector", DETECTORS)
def test_batches_dtypes_and_level(detector: type[Detector]) -> None:
    cfar = detector(false_alarm_rate=1e-2)
    power = next(white_noise(20, 1))[:6]
    with torch.no_grad():
        batch, detections = cfar.threshold(power.view(2, 3, ROWS, COLUMNS)), cfar(power.view(2, 3, ROWS, COLUMNS))
    assert batch.shape == detections.shape == (2, 3, ROWS, COLUMNS)
    for number in range(6):
        assert torch.equal(batch.view_as(power)[number], cfar.threshold(power[number]))
        assert torch.equal(detections.view_as(power)[number], cfar(power[number]))
    double = cfar.threshold(power.double())
    assert double.dtype == torch.float64
    # 248 additions in single precision, each within 6e-8.
    torch.testing.assert_close(batch.view_as(power), double.float(), rtol=2e-5, atol=0.0)
    # The noise level cancels; a power of two changes no rounding.
    assert torch.equal(cfar(power * 2.0**30), detections.view_as(power))
    assert cfar(power[:0]).shape == (0, ROWS, COLUMNS)
    # The Doppler axis is a circle.
    assert torch.equal(cfar(power.roll(9, dims=-2)), detections.view_as(power).roll(9, dims=-2))


@pytest.mark.gpu
@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a CUDA device")
@pytest.mark.parametrize("detector", DETECTORS)
def test_the_gpu_finds_the_same_detections(detector: type[Detector]) -> None:
    cfar, power = detector(false_alarm_rate=1e-2), next(white_noise(20, 1))
    threshold, detections = cfar.threshold(power.cuda()), cfar(power.cuda())
    assert threshold.is_cuda
    assert detections.is_cuda
    torch.testing.assert_close(threshold.cpu(), cfar.threshold(power), rtol=2e-5, atol=0.0)
    # Of 160,000 cells, 1 in 1e4 at most lies within rounding of its threshold.
    assert (detections.cpu() != cfar(power)).sum() <= 16


# Targets.


def with_target(power: Tensor, row: int, column: int, peak_db: float) -> Tensor:
    """A target with the main lobe of a Hann window, in dB above a mean of 1."""
    lobe = torch.tensor([0.25, 1.0, 0.25])
    power = power.clone()
    power[row - 1 : row + 2, column - 1 : column + 2] += 10 ** (peak_db / 10) * lobe[:, None] * lobe
    return power


@pytest.mark.parametrize("column", [2, 64, 125])
@pytest.mark.parametrize("detector", DETECTORS)
def test_a_target_does_not_raise_its_own_threshold(detector: type[Detector], column: int) -> None:
    """120 dB: a sum taken as the difference of two others would lose the noise beside it."""
    noise = next(white_noise(20, 1))[0] / 3e-9
    cfar = detector()
    power = with_target(noise, 30, column, 120.0)
    assert cfar(power)[30, column]
    changed = cfar.threshold(power) != cfar.threshold(noise)
    assert not changed[30, column]
    # Nothing beyond the reach of the target's cells is touched, to the last bit.
    rows, columns = (reach + 1 for reach in cfar.reach)
    changed[30 - rows : 31 + rows, max(column - columns, 0) : column + columns + 1] = False
    assert not changed.any()


def test_a_second_target_hides_the_weaker_one_from_cell_averaging_only() -> None:
    noise = next(white_noise(20, 1))[0] / 3e-9
    power = with_target(with_target(noise, 30, 60, 20.0), 30, 66, 40.0)
    averaging, ordered = CellAveragingCfar(training=(4, 4)), OrderStatisticCfar()
    assert averaging(with_target(noise, 30, 60, 20.0))[30, 60]
    assert not averaging(power)[30, 60]
    assert ordered(power)[30, 60]
    assert averaging(power)[30, 66]
    # 9 of 144 training cells move the 108th smallest by 9 places at most: 0.8 dB in exponential noise.
    raised = ordered.threshold(power)[30, 60] / ordered.threshold(with_target(noise, 30, 60, 20.0))[30, 60]
    assert 1.0 <= float(raised) < 10**0.15


# Bad input.


@pytest.mark.parametrize("detector", DETECTORS)
@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"training": (0, 0)}, r"training must be 1 cell or more on one axis at least; got \(0, 0\)"),
        ({"training": (4, -1)}, r"training must be a pair .* got \(4, -1\)"),
        ({"training": (4, 2.5)}, r"training must be a pair .* got \(4, 2.5\)"),
        ({"guard": (2, 2, 2)}, r"guard must be a pair .* got \(2, 2, 2\)"),
        ({"guard": 2}, r"guard must be a pair .* got 2"),
        ({"false_alarm_rate": 0.0}, r"false_alarm_rate must lie between 0 and 0.5 .* got 0.0"),
        ({"false_alarm_rate": 0.5}, r"false_alarm_rate must lie between 0 and 0.5 .* got 0.5"),
        ({"false_alarm_rate": math.nan}, r"false_alarm_rate must lie between 0 and 0.5 .* got nan"),
        ({"looks": 0}, r"looks must lie in 1..512; got 0"),
        ({"looks": 513}, r"looks must lie in 1..512; got 513"),
        ({"looks": 1.5}, r"looks must be a whole number; got 1.5"),
        ({"correlation": ((),)}, r"correlation must be a pair .* got 1 of them"),
        ({"correlation": ((1.5,), ())}, r"correlation must lie in 0..1; got 1.5"),
    ],
)
def test_bad_parameters(detector: type[Detector], arguments: dict[str, object], message: str) -> None:
    with pytest.raises((TypeError, ValueError), match=f"{detector.__name__}: {message}"):
        detector(**arguments)  # type: ignore[arg-type]


@pytest.mark.parametrize("rank", [0.0, 1.01, math.nan])
def test_bad_rank(rank: float) -> None:
    with pytest.raises(ValueError, match="OrderStatisticCfar: rank must be above 0 and up to 1; got"):
        OrderStatisticCfar(rank=rank)


@pytest.mark.parametrize("detector", DETECTORS)
@pytest.mark.parametrize(
    ("power", "message"),
    [
        (torch.full((64, 64), -90.0), r"power must be 0 or more; got .*-90.*Give linear power, not dB"),
        (torch.ones(64, 64).index_fill(0, torch.tensor(3), math.nan), "power must be 0 or more"),
        (torch.ones(64, 64).index_fill(0, torch.tensor(3), math.inf), "power must be a finite number"),
        (torch.ones(64, 64, dtype=torch.int32), "power must be linear power in float32 or float64; got torch.int32"),
        (torch.ones(64, 64, dtype=torch.complex64), "float32 or float64; got torch.complex64"),
        (torch.ones(12, 64), r"13 x 13 cells or more.*training=\(4, 4\); got shape \(12, 64\)"),
        (torch.ones(2, 64, 12), r"13 x 13 cells or more.*got shape \(2, 64, 12\)"),
        (torch.ones(64), r"13 x 13 cells or more.*got shape \(64,\)"),
    ],
)
def test_bad_power(detector: type[Detector], power: Tensor, message: str) -> None:
    cfar = detector(training=(4, 4))
    for call in (cfar, cfar.threshold):
        with pytest.raises(ValueError, match=message):
            call(power)


def test_a_list_from_a_file_is_a_pair_too() -> None:
    cfar = CellAveragingCfar(guard=[2, 2], training=[4, 8], correlation=[[], []])  # type: ignore[arg-type]
    assert cfar == CellAveragingCfar(correlation=WHITE)
    assert cfar(torch.ones(32, 64)).shape == (32, 64)


@pytest.mark.parametrize("cfar", [CellAveragingCfar(false_alarm_rate=1e-2), OrderStatisticCfar(false_alarm_rate=1e-2)])
def test_single_cells_are_judged_as_the_map_is(cfar: CellAveragingCfar | OrderStatisticCfar) -> None:
    """Everywhere, the ends of the range axis and the circle of speeds too; the noise is threshold over factor."""
    power = torch.empty(32, 48).exponential_(generator=torch.Generator().manual_seed(8))
    rows, columns = (index.flatten() for index in torch.meshgrid(torch.arange(32), torch.arange(48), indexing="ij"))
    found, noise = cfar.detect_at(power, rows, columns)
    assert 0 < int(found.sum()) < 100
    assert torch.equal(found.reshape(32, 48), cfar(power))
    estimate = cfar.threshold(power) / cfar.factors(48).float()
    assert torch.allclose(noise, estimate[found.reshape(32, 48)], rtol=1e-6)
