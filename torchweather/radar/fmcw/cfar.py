r"""CFAR detectors: a threshold for each cell of a power map from the cells around it.

Noise in a cell is the mean of L independent exponential looks, ``P = mu Gamma(L) / L``, with an unknown mean ``mu``
that is taken to be the same in the cell and in its N training cells. A detector estimates ``mu`` (their mean, or their
k-th smallest) and multiplies it with a factor ``alpha`` such that a cell of noise alone exceeds the product with the
probability ``false_alarm_rate``, whatever ``mu`` is.

The window is a rectangle around the cell less the rectangle of the guard. The Doppler axis is a circle. The range axis
is not: near its ends the training cells that exist count, with a factor of their own.

References:
    Gandhi and Kassam 1988, IEEE Trans. Aerosp. Electron. Syst. 24, 427-445 (cell averaging, both factors).
    Rohling 1983, IEEE Trans. Aerosp. Electron. Syst. 19, 608-621 (order statistics).
    PHYSICS.md 6.8.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import numpy.typing as npt
import torch
from scipy import special
from scipy.optimize import brentq
from torch import Tensor
from torch.nn import functional

from torchweather.core.arguments import check_arguments
from torchweather.core.errors import InputValueError, check_at_least, check_between, check_finite

__all__ = ["HANN_CORRELATION", "CellAveragingCfar", "Cfar", "OrderStatisticCfar", "window_correlation"]

Array = npt.NDArray[np.float64]

# Amplitude correlation of noise between bins 1 and 2 apart after a Hann window: its spectrum is 1/4, 1/2, 1/4, so
# 2 (1/4 1/2) / (1/4 + 1/16 + 1/16) and (1/4 1/4) / (1/4 + 1/16 + 1/16).
HANN_CORRELATION = (2.0 / 3.0, 1.0 / 6.0)

# A weaker correlation shares less than 1e-4 of the power and moves no factor.
LEAST_CORRELATION = 0.01
# Beyond it the sums of the false-alarm rate leave double precision (exp(-looks * factor) near 1e-308).
MOST_LOOKS = 512
# Steps of the trapezoid over the order statistic: against the closed form for one look the error is below 1e-9.
STEPS = 768


def window_correlation(window: Tensor) -> tuple[float, ...]:
    r"""Amplitude correlation of white noise between neighbouring bins of a windowed FFT.

    ``rho_m = |sum_n w_n^2 exp(-2 pi j m n / N)| / sum_n w_n^2`` for bins m apart.

    Args:
        window: ``(N,)`` real samples of the window.

    Returns:
        ``rho_1, rho_2, ...`` up to the last one of 0.01 or more; empty for a rectangular window.

    Note:
        The FFT has the length of the window: zero padding correlates more bins.

    Example:
        >>> [round(rho, 4) for rho in window_correlation(torch.hann_window(64))]
        [0.6667, 0.1667]
    """
    spectrum = torch.fft.fft(window.double().square()).abs()
    correlation = (spectrum[1 : len(window) // 2] / spectrum[0]).tolist()
    last = max((m for m, rho in enumerate(correlation, 1) if rho >= LEAST_CORRELATION), default=0)
    return tuple(correlation[:last])


@dataclass(frozen=True, kw_only=True)
class Cfar:
    """Common parts of both detectors: the window, the noise in it, and the factor of each range column."""

    false_alarm_rate: float = 1e-4
    guard: tuple[int, int] = (2, 2)
    training: tuple[int, int] = (4, 8)
    looks: int = 1
    correlation: tuple[tuple[float, ...], tuple[float, ...]] = (HANN_CORRELATION, HANN_CORRELATION)

    def __post_init__(self) -> None:
        check_arguments(
            f"{type(self).__name__}(false_alarm_rate: float, looks: int, correlation: Sequence[Sequence])",
            self.false_alarm_rate,
            self.looks,
            self.correlation,
        )
        # Tuples, so that lists from a file serve as well and the detector can be hashed.
        object.__setattr__(self, "guard", _cells("guard", self.guard, self))
        object.__setattr__(self, "training", _cells("training", self.training, self))
        object.__setattr__(self, "correlation", tuple(tuple(axis) for axis in self.correlation))
        if not 0.0 < self.false_alarm_rate < 0.5:
            raise InputValueError(
                f"{type(self).__name__}: false_alarm_rate must lie between 0 and 0.5 (both excluded), per cell; "
                f"got {self.false_alarm_rate!r}."
            )
        if self.training == (0, 0):
            raise InputValueError(
                f"{type(self).__name__}: training must be 1 cell or more on one axis at least; got {self.training}."
            )
        check_between("looks", self.looks, 1, MOST_LOOKS, owner=self)
        if self.looks != int(self.looks):
            raise InputValueError(f"{type(self).__name__}: looks must be a whole number; got {self.looks!r}.")
        if len(self.correlation) != 2:
            raise InputValueError(
                f"{type(self).__name__}: correlation must be a pair (Doppler, range) of tuples; "
                f"got {len(self.correlation)} of them."
            )
        for rho in (*self.correlation[0], *self.correlation[1]):
            check_between("correlation", rho, 0.0, 1.0, owner=self)

    @property
    def reach(self) -> tuple[int, int]:
        """Cells from the cell under test to the window's edge, (Doppler, range)."""
        return self.guard[0] + self.training[0], self.guard[1] + self.training[1]

    def factors(self, columns: int) -> Tensor:
        """Threshold over estimated noise for each range column.

        Args:
            columns: number of range cells of the map.

        Returns:
            ``(columns,)``, double precision; larger at the ends, where fewer cells estimate the noise.
        """
        return _column_factors(self, columns).clone()

    def threshold(self, power: Tensor) -> Tensor:
        """Power above which a cell is a detection."""
        raise NotImplementedError

    def detect_at(self, power: Tensor, rows: Tensor, columns: Tensor) -> tuple[Tensor, Tensor]:
        """Detections among some cells, and the noise that is estimated around those.

        Args:
            power: linear power of one map, ``(N_doppler, N_range)``.
            rows, columns: of the cells, ``(D,)``.

        Returns:
            ``(D,)`` bool, and the linear noise power of each detection.
        """
        threshold = self.threshold(power)[rows, columns]
        found = power[rows, columns] > threshold
        factors = _column_factors(self, power.shape[-1]).to(power)
        return found, threshold[found] / factors[columns[found]]

    def _window(self, before: int, after: int) -> npt.NDArray[np.bool_]:
        """Training cells of a window with so many columns before and after the cell under test."""
        doppler = np.arange(-self.reach[0], self.reach[0] + 1)[:, None]
        columns = np.arange(-before, after + 1)
        return (abs(doppler) > self.guard[0]) | (abs(columns) > self.guard[1])

    def _coherence(self, window: npt.NDArray[np.bool_]) -> Array:
        """Amplitude correlation between each two training cells, ``(N, N)``."""
        cells = np.argwhere(window)
        coherence = np.ones((len(cells), len(cells)))
        for axis, correlation in enumerate(self.correlation):
            by_lag = np.zeros(max(window.shape[axis], len(correlation) + 1))
            by_lag[: len(correlation) + 1] = (1.0, *correlation)
            coherence *= by_lag[abs(cells[:, None, axis] - cells[:, axis])]
        return coherence

    def _rate(self, window: npt.NDArray[np.bool_]) -> Callable[[float], float]:
        """False-alarm rate over the factor."""
        raise NotImplementedError

    def _padded(self, power: Tensor, beyond: float) -> Tensor:
        """The map with its window's reach on each side: Doppler goes round, range meets ``beyond``."""
        self._check(power)
        doppler, columns = self.reach
        around = [power[..., power.shape[-2] - doppler :, :], power, power[..., :doppler, :]]
        return functional.pad(torch.cat(around, dim=-2), (columns, columns), value=beyond)

    def _check(self, power: Tensor) -> None:
        owner = type(self).__name__
        if power.dtype not in (torch.float32, torch.float64):
            raise InputValueError(f"{owner}: power must be linear power in float32 or float64; got {power.dtype}.")
        rows, columns = 2 * self.reach[0] + 1, 2 * self.reach[1] + 1
        if power.ndim < 2 or power.shape[-2] < rows or power.shape[-1] < columns:
            raise InputValueError(
                f"{owner}: power must be a map (..., Doppler, range) of {rows} x {columns} cells or more, "
                f"the window of guard={self.guard} and training={self.training}; got shape {tuple(power.shape)}. "
                "Make guard or training smaller."
            )
        if not power.numel():
            return
        check_at_least("power", power, 0.0, owner=self, advice="Give linear power, not dB.")
        check_finite("power", power, owner=self)


@dataclass(frozen=True, kw_only=True)
class CellAveragingCfar(Cfar):
    r"""Detector whose noise estimate is the mean of the training cells.

    For one look and independent cells ``alpha = N (P_fa^(-1/N) - 1)``. Neighbouring bins of a windowed FFT are
    correlated, so that their mean scatters like that of fewer cells. With the eigenvalues ``lambda_i`` of the
    training cells' amplitude correlation, for L looks::

        P_fa = sum_{l<L} [z^l] prod_i (1 + alpha lambda_i (1 - z) / N)^(-L)

    where ``[z^l]`` is the coefficient of ``z^l``; this is solved for ``alpha``.

    Args:
        false_alarm_rate: probability that a cell of noise alone is detected, above 0 and below 0.5. The default
            leaves three such cells in a map of 128 x 256.
        guard: cells left out on each side of the cell under test, (Doppler, range). Two hold the main lobe of a Hann
            window.
        training: cells beyond the guard on each side that estimate the noise, (Doppler, range); 0 on one axis makes
            the window a strip.
        looks: number of independent exponential looks whose mean a cell is (channels summed in power), 1 to 512.
        correlation: amplitude correlation between cells 1, 2, ... apart along (Doppler, range), in [0, 1]; see
            `window_correlation`. The default is that of Hann windows; ``((), ())`` is white noise.

    Note:
        The rate is exact for homogeneous noise when the guard reaches as far as the correlation. With a smaller one
        it is lower than asked. A second target among the training cells raises the threshold; `OrderStatisticCfar`
        holds.

    References:
        Gandhi and Kassam 1988; PHYSICS.md 6.8.

    Example:
        >>> power = torch.ones(32, 64)
        >>> power[20, 40] = 100.0
        >>> CellAveragingCfar()(power).nonzero().tolist()
        [[20, 40]]
    """

    def threshold(self, power: Tensor) -> Tensor:
        """Power above which a cell is a detection.

        Args:
            power: linear power, ``(..., N_doppler, N_range)``, 0 or more, float32 or float64.

        Returns:
            Linear power, in the shape and dtype of ``power``.
        """
        check_arguments("CellAveragingCfar.threshold(power: Tensor)", power)
        rows, columns = power.shape[-2:] if power.ndim > 1 else (0, 0)
        padded = self._padded(power, 0.0)
        (guard_rows, guard_columns), (train_rows, train_columns) = self.guard, self.training
        # Sums of positive terms only: less the guard's share of a whole window, a strong target would leave rounding.
        strip = _running_sum(padded, train_rows, -2)
        outside = strip[..., :rows, :] + strip[..., -rows:, :]
        inside = _running_sum(padded.narrow(-2, train_rows, rows + 2 * guard_rows), 2 * guard_rows + 1, -2)
        side = _running_sum(outside + inside, train_columns, -1)
        centre = _running_sum(outside.narrow(-1, train_columns, columns + 2 * guard_columns), 2 * guard_columns + 1, -1)
        total = side[..., :columns] + side[..., -columns:] + centre
        return total * (_column_factors(self, columns) / _column_cells(self, columns)).to(power)

    def __call__(self, power: Tensor) -> Tensor:
        """Detections.

        Args:
            power: linear power, ``(..., N_doppler, N_range)``, 0 or more, float32 or float64.

        Returns:
            ``True`` where the power exceeds the threshold, in the shape of ``power``.
        """
        return power > self.threshold(power)

    def _rate(self, window: npt.NDArray[np.bool_]) -> Callable[[float], float]:
        # Rounding may leave an eigenvalue just below 0.
        eigenvalues = np.linalg.eigvalsh(self._coherence(window)).clip(min=0.0) / window.sum()

        def rate(factor: float) -> float:
            scaled = factor * eigenvalues
            ratio = scaled / (1.0 + scaled)
            powers = ratio ** np.arange(1, self.looks)[:, None]  # (looks - 1, N)
            sums = self.looks * powers.sum(axis=1)
            # Power series of the exponential of a power series; every term is positive.
            coefficients = np.zeros(self.looks)
            coefficients[0] = np.exp(-self.looks * np.log1p(scaled).sum())
            for order in range(1, self.looks):
                coefficients[order] = sums[:order] @ coefficients[:order][::-1] / order
            return float(coefficients.sum())

        return rate


@dataclass(frozen=True, kw_only=True)
class OrderStatisticCfar(Cfar):
    r"""Detector whose noise estimate is the k-th smallest of the training cells.

    Up to N - k training cells may hold other targets. For one look and independent cells ``P_fa = prod_{i<k}
    (N - i) / (N - i + alpha)``; for L looks, with the share u of the noise's distribution below the estimate,
    ``u ~ Beta(k, N - k + 1)``::

        P_fa = E_u[ Q(L, alpha P^-1(L, u)) ]

    with the regularised incomplete gamma functions P and Q. Both are the same for L = 1.

    Args:
        false_alarm_rate: probability that a cell of noise alone is detected, above 0 and below 0.5. The default
            leaves three such cells in a map of 128 x 256.
        guard: cells left out on each side of the cell under test, (Doppler, range). Two hold the main lobe of a Hann
            window.
        training: cells beyond the guard on each side that estimate the noise, (Doppler, range); 0 on one axis makes
            the window a strip.
        looks: number of independent exponential looks whose mean a cell is (channels summed in power), 1 to 512.
        correlation: amplitude correlation between cells 1, 2, ... apart along (Doppler, range), in [0, 1]; see
            `window_correlation`. The default is that of Hann windows; ``((), ())`` is white noise.
        rank: k / N, above 0 and up to 1; k is rounded up. 0.75 after Rohling 1983.

    Note:
        The rate is exact for independent cells. Correlated cells count as ``N_eff = N^2 / sum_ij rho_ij^2``
        independent ones, which is exact for the variance of a mean and errs to the safe side here: simulated after
        Hann windows (9e7 cells for one look, 1.5e7 for twelve), the default window has 0.97, 0.90 and 0.81 times the
        rates 1e-2, 1e-3 and 1e-4 for one look, and 0.99, 0.96 and 0.93 times for twelve.

    References:
        Rohling 1983; Gandhi and Kassam 1988.

    Example:
        >>> power = torch.ones(32, 64)
        >>> power[20, 40] = power[20, 46] = 100.0
        >>> OrderStatisticCfar()(power).nonzero().tolist()
        [[20, 40], [20, 46]]
    """

    training: tuple[int, int] = (4, 4)
    rank: float = 0.75

    def __post_init__(self) -> None:
        check_arguments("OrderStatisticCfar(training: Sequence, rank: float)", self.training, self.rank)
        super().__post_init__()
        if not 0.0 < self.rank <= 1.0:
            raise InputValueError(f"{type(self).__name__}: rank must be above 0 and up to 1; got {self.rank!r}.")

    def threshold(self, power: Tensor) -> Tensor:
        """Power above which a cell is a detection.

        Args:
            power: linear power, ``(..., N_doppler, N_range)``, 0 or more, float32 or float64.

        Returns:
            Linear power, in the shape and dtype of ``power``.

        Note:
            It gathers every window, N values for each cell. The detections alone need no such memory.
        """
        padded = self._padded(power, torch.inf)
        columns = power.shape[-1]
        window = self._window(self.reach[1], self.reach[1])
        windows = padded.unfold(-2, window.shape[0], 1).unfold(-2, window.shape[1], 1)
        training = windows[..., torch.from_numpy(window).to(power.device)]  # (..., N_doppler, N_range, N)
        ranks = self._kth(_column_cells(self, columns)).to(power.device)
        noise = torch.empty_like(power)
        for rank in sorted(set(ranks.tolist())):
            at = ranks == rank
            noise[..., at] = training[..., at, :].kthvalue(rank, dim=-1).values
        return noise * _column_factors(self, columns).to(power)

    def __call__(self, power: Tensor) -> Tensor:
        """Detections.

        A cell exceeds ``alpha`` times the k-th smallest exactly when it exceeds ``alpha`` times k of the training cells
        or more, so that counting replaces sorting.

        Args:
            power: linear power, ``(..., N_doppler, N_range)``, 0 or more, float32 or float64.

        Returns:
            ``True`` where the power exceeds the threshold, in the shape of ``power``.
        """
        padded = self._padded(power, torch.inf)
        rows, columns = power.shape[-2:]
        factors = _column_factors(self, columns).to(power)
        exceeded = torch.zeros_like(power, dtype=torch.int32)
        for row, column in np.argwhere(self._window(self.reach[1], self.reach[1])).tolist():
            exceeded += power > padded[..., row : row + rows, column : column + columns] * factors
        return exceeded >= self._kth(_column_cells(self, columns)).to(power.device)

    def detect_at(self, power: Tensor, rows: Tensor, columns: Tensor) -> tuple[Tensor, Tensor]:
        """As the base's, from the windows of these cells alone."""
        padded = self._padded(power, torch.inf)
        place = torch.from_numpy(np.argwhere(self._window(self.reach[1], self.reach[1]))).to(power.device)
        training = padded[rows[:, None] + place[:, 0], columns[:, None] + place[:, 1]]  # (D, N)
        factors = _column_factors(self, power.shape[-1]).to(power)[columns]
        ranks = self._kth(_column_cells(self, power.shape[-1])).to(power.device)[columns]
        found = (power[rows, columns, None] > training * factors[:, None]).sum(-1) >= ranks
        training, ranks = training[found], ranks[found]
        noise = power.new_empty(len(ranks))
        for rank in sorted(set(ranks.tolist())):
            noise[ranks == rank] = training[ranks == rank].kthvalue(rank, dim=-1).values
        return found, noise

    def _kth(self, cells: Tensor) -> Tensor:
        # A product such as 0.7 * 10 must not be rounded up to 8 for its last bit.
        return (self.rank * cells.double() - 1e-9).ceil().long()

    def _rate(self, window: npt.NDArray[np.bool_]) -> Callable[[float], float]:
        cells = int(window.sum())
        independent = cells**2 / np.square(self._coherence(window)).sum()
        # The mean of u stays; its variance is that of the independent cells.
        share = int(self._kth(torch.tensor(cells))) / (cells + 1)
        above, below = share * (independent + 1), (1.0 - share) * (independent + 1)
        # Trapezoid over t = logit u: the tails fall as exp(above t) and exp(-below t), 46 = -ln 1e-20; the middle is a
        # Gaussian.
        middle, width = np.log(above / below), 9.0 * np.sqrt(1.0 / above + 1.0 / below)
        t = np.linspace(middle - width - 46.0 / above, middle + width + 46.0 / below, STEPS)
        density = np.exp(above * special.log_expit(t) + below * special.log_expit(-t) - special.betaln(above, below))
        weights = density * (t[1] - t[0])
        looks = self.looks
        noise = np.where(
            t < 0, special.gammaincinv(looks, special.expit(t)), special.gammainccinv(looks, special.expit(-t))
        )
        return lambda factor: float(weights @ special.gammaincc(looks, factor * noise))


def _cells(name: str, cells: Sequence[int], owner: object) -> tuple[int, int]:
    """A pair of whole numbers, (Doppler, range)."""
    pair = isinstance(cells, Sequence) and len(cells) == 2
    if not pair or not all(type(count) is int and count >= 0 for count in cells):
        raise InputValueError(
            f"{type(owner).__name__}: {name} must be a pair (Doppler, range) of whole numbers of cells, 0 or more; "
            f"got {cells!r}."
        )
    return cells[0], cells[1]


def _running_sum(values: Tensor, width: int, dim: int) -> Tensor:
    """Sums of ``width`` neighbours along ``dim``, which gets shorter by ``width - 1``."""
    length = values.shape[dim] - width + 1
    shape = list(values.shape)
    shape[dim] = length
    total = values.new_zeros(shape)
    for start in range(width):
        total = total + values.narrow(dim, start, length)
    return total


def _windows(cfar: Cfar, columns: int) -> list[tuple[int, int]]:
    """Columns on the shorter and on the longer side of each cell's window; a window and its mirror image are alike."""
    reach = cfar.reach[1]
    sides = [(min(column, reach), min(columns - 1 - column, reach)) for column in range(columns)]
    return [(min(pair), max(pair)) for pair in sides]


@lru_cache(maxsize=1024)
def _factor(cfar: Cfar, before: int, after: int) -> float:
    """The factor that gives the detector's false-alarm rate in one window."""
    rate = cfar._rate(cfar._window(before, after))
    high = 1.0
    while rate(np.exp(high)) > cfar.false_alarm_rate:
        high += 4.0
    # The rate of a factor near 0 is 1.
    return float(np.exp(brentq(lambda log: rate(np.exp(log)) - cfar.false_alarm_rate, -20.0, high, xtol=1e-12)))


@lru_cache(maxsize=64)
def _column_factors(cfar: Cfar, columns: int) -> Tensor:
    return torch.tensor([_factor(cfar, *window) for window in _windows(cfar, columns)], dtype=torch.float64)


@lru_cache(maxsize=64)
def _column_cells(cfar: Cfar, columns: int) -> Tensor:
    return torch.tensor([int(cfar._window(*window).sum()) for window in _windows(cfar, columns)])
