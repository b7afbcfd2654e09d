"""Cells of camera frames that stand out of those beside them, as streaks do, and lines that do as a whole.

Of a cell less the mean of those beside it the shares far out are counted (``bright_share``, ``dark_share``: how many
streaks, how bright), and the mean products with others at several lags (``streak_correlation``: which way streaks run,
how far) and far along a line (``column_correlation``, ``row_correlation``: offsets that the readout of a line adds).
"""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from torchweather.gap.sensors.camera.bins import Binned, Sums, about
from torchweather.gap.sensors.camera.edges import SHARED_CELLS, lag_name
from torchweather.gap.statistics.frame_statistics import Group

__all__ = [
    "ASIDE",
    "FAR_LAG",
    "HIGHEST",
    "TAILS_SD",
    "TAIL_FROM_M",
    "Beside",
    "correlation_groups",
    "products_share",
    "share_groups",
]

Floats = NDArray[np.float64]

ASIDE = 2  # cells to either side with whose mean a cell is compared
TAILS_SD = (2.0, 3.0, 4.5, 7.0, 11.0, 18.0, 1e4)
TAIL_TEXTURE = 0.05  # of the modelled difference, which counts as noise
# Rows and columns, in cells, between the two of which the product says how streaks run.
STREAK_LAGS = ((1, 0), (2, 0), (4, 0), (8, 0), (1, 1), (1, -1), (2, 1), (2, -1), (4, 1), (4, -1), (4, 2), (4, -2))
FAR_LAG = 20  # cells, farther than most streaks are long
HIGHEST = 12.0  # standard deviations of a single cell that count in products
TAIL_FROM_M = (0.0, 30.0, 1e6)  # depths of the scene: in front of what is near there are few particles
CLASSES, WHERE = len(TAIL_FROM_M) - 1, ("near", "far")


def correlation_groups() -> list[Group]:
    """Mean products along which axis."""
    statistics = [f"streak_correlation_{lag_name(lag)}" for lag in STREAK_LAGS]
    statistics += ["column_correlation", "row_correlation"]
    return [Group(statistic, "depth_m", "mean", TAIL_FROM_M) for statistic in statistics]


def products_share(block_cells: int) -> float:
    """Variance of a sum of products of cells less those beside them, over that of independent blocks of cells.

    A cell less half of those two to either side has the autocovariance 3/2, -1, 1/4 at 0, 2 and 4 cells; products with
    another row correlate by its square over 9/4.

    Args:
        block_cells: width of a block, in which neighbours are together.

    Example:
        >>> round(products_share(4), 3)
        1.346
    """
    of = {0: 9.0 / 4.0, ASIDE: 2.0, 2 * ASIDE: 2.0 / 16.0}  # both sides
    in_one = {apart: max(1.0 - apart / block_cells, 0.0) for apart in of}
    return sum(of.values()) / sum(value * in_one[apart] for apart, value in of.items())


def share_groups() -> list[Group]:
    """Shares of what stands out along which axis."""
    return [
        Group(f"{side}_share_{where}", "residual_sd", "share", TAILS_SD)
        for side in ("bright", "dark")
        for where in WHERE
    ]


class Beside:
    """Cells less the mean of those to either side, in standard deviations.

    Args:
        light: ``(h, w)`` of the green of the cells as the model has it.
        noise_variance: c and v of the variance ``c + v I`` of a cell.
        classes: ``(h, w)`` of depth, bins of ``TAIL_FROM_M``, -1 for none.
    """

    def __init__(self, light: Tensor, noise_variance: tuple[float, float], classes: Tensor) -> None:
        constant, growing = noise_variance
        variance = 1.5 * (constant + growing * light) + (TAIL_TEXTURE * _beside(light)).square()
        self.noise, self.classes = variance.sqrt(), classes.clone()
        self.classes[:, :ASIDE] = -1
        self.classes[:, -ASIDE:] = -1
        self._bins: dict[tuple[int, int], Binned] = {}

    def __call__(self, residual: Tensor) -> Tensor:
        """Of frames less the model ``(F, h, w)``."""
        return _beside(residual).div_(self.noise)

    def shares(self, relative: Tensor, portion: Tensor | None, portions: int) -> Sums:
        """Shares of the cells that stand out by so many standard deviations."""
        of, counts = _far_out(relative, self.classes, portion, portions)
        return {
            (f"{side}_share_{where}", "residual_sd"): _of_all(of[:, number], counts[:, number, sign])
            for number, where in enumerate(WHERE)
            for side, sign in (("bright", 0), ("dark", 1))
        }

    def streaks(self, relative: Tensor, portion: Tensor | None, portions: int) -> Sums:
        """In which direction, how wide and how long streaks are; what cells far apart in a column share."""
        lags = {f"streak_correlation_{lag_name(lag)}": lag for lag in STREAK_LAGS}
        return self.products({**lags, "column_correlation": (FAR_LAG, 0)}, relative, portion, portions)

    def products(
        self, lags: dict[str, tuple[int, int]], relative: Tensor, portion: Tensor | None, portions: int
    ) -> Sums:
        """Mean products of cells at some lags.

        Args:
            lags: of each statistic, in cells down and to the right.
            relative: ``(F, h, w)``, changed: a single cell counts up to ``HIGHEST``.
            portion: ``(h w,)`` of each cell; ``None``: all are one.
            portions: number of them.
        """
        found: Sums = {}
        cells, classes = relative.clamp_(-HIGHEST, HIGHEST).flatten(1), self.classes.flatten()
        # Cells of one class alone, all others 0. The ends of rows have none: a product over them adds nothing.
        apart = [(cells * (classes == kind)).numpy() for kind in range(CLASSES)]
        for statistic, lag in lags.items():
            offset, binned = lag[0] * self.classes.shape[1] + lag[1], self._at(lag)
            if portion is None:
                dots = [one[:, None, :-offset] @ one[:, offset:, None] for one in apart]
                total = np.concatenate(dots, 1)[..., 0].astype(np.float64)
            else:
                product = torch.zeros_like(cells)
                product[:, :-offset] = cells[:, :-offset] * cells[:, offset:]
                total = binned.sums(product.T.contiguous(), portion, portions)
            total /= SHARED_CELLS
            number = np.tile(binned.counts(portion, portions), (len(cells), 1)) / SHARED_CELLS
            # Products of independent normal values have a variance of 1.
            found[statistic, "depth_m"] = number, total, about(number, total, number)
        return found

    def _at(self, lag: tuple[int, int]) -> Binned:
        """Cells by the class of depth that they share with the one at a lag."""
        if lag not in self._bins:
            first, second = self.classes.flatten(), torch.full((self.classes.numel(),), -1)
            offset = lag[0] * self.classes.shape[1] + lag[1]
            second[: len(first) - offset] = first[offset:]
            self._bins[lag] = Binned({("product", "depth_m"): (first.where(first == second, -1), CLASSES)})
        return self._bins[lag]


def _beside(values: Tensor) -> Tensor:
    """Values ``(..., h, w)`` less the mean of those to either side; 0 at the ends of rows."""
    found = torch.zeros(values.shape, dtype=values.dtype)
    mean = 0.5 * (values[..., : -2 * ASIDE] + values[..., 2 * ASIDE :])
    found[..., ASIDE:-ASIDE] = values[..., ASIDE:-ASIDE] - mean
    return found


def _far_out(relative: Tensor, classes: Tensor, portion: Tensor | None, portions: int) -> tuple[Floats, Floats]:
    """Number of cells ``(F * portions, classes)``, and of those far out on either side, upwards first,
    ``(F * portions, classes, 2, bins)`` of ``TAILS_SD``.

    Args:
        relative: ``(F, h, w)``.
        classes: ``(h, w)`` of depth, -1 for none.
        portion: ``(h w,)`` of each cell; ``None``: all are one.
        portions: number of them.
    """
    bins = len(TAILS_SD) - 1
    values, kinds = relative.flatten(1).numpy(), classes.flatten().numpy()
    owner = np.zeros(len(kinds), np.int64) if portion is None else portion.numpy()
    far = np.flatnonzero(np.abs(values) >= TAILS_SD[0])  # in the flat array, which takes a third of the time
    far = far[kinds[far % len(kinds)] >= 0]
    frame, cell = np.divmod(far, len(kinds))
    out = values.ravel()[far]
    height = np.searchsorted(np.array(TAILS_SD[:-1], np.float32), np.abs(out), side="right") - 1
    index = ((frame * portions + owner[cell]) * 2 * CLASSES + 2 * kinds[cell] + (out < 0)) * bins + height
    shape = (len(values) * portions, CLASSES, 2, bins)
    counts = np.bincount(index, minlength=int(np.prod(shape))).reshape(shape) / SHARED_CELLS
    known = kinds >= 0
    of = np.bincount(owner[known] * CLASSES + kinds[known], minlength=portions * CLASSES)
    return np.tile(of.reshape(portions, CLASSES), (len(values), 1)) / SHARED_CELLS, counts


def _of_all(number: Floats, counts: Floats) -> tuple[Floats, Floats, Floats]:
    """Sums of shares ``(F, bins)`` of so many elements ``(F,)``."""
    return number[:, None].repeat(counts.shape[1], 1), counts, counts
