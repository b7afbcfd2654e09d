"""Frames of a camera to sums over bins: brightness, sharpness, texture and tails of a frame against its clear scene.

Of blocks of 4 x 4 px the logarithm of each colour over the clear scene's (``log_ratio``); of pairs of 2 x 2 px cells at
several lags the scatter of the difference, on flat places (``difference_spread``: noise, and streaks by their
direction, width and length), and its regression on the clear one across edges (``edge_contrast``: sharpness); of cells
the share that stands out of its neighbours beside it (``bright_share``, ``dark_share``: how many streaks, how bright),
and the mean product with others at several lags (``streak_correlation``: which way streaks run, how far).
What is left over the model as it is, in parts of the picture, makes a map, of which what stays in its place counts.

References:
    GAP.md 3 (1).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import torch
from torch import Tensor

from torchweather.gap.camera_scene import (
    BLOCK_CELLS,
    COLOURS,
    DARKEST,
    DEPTH_CLASSES_M,
    FAR_M,
    NEAR_M,
    SKY_M,
    CameraScene,
    Pairs,
    cell_colours,
    in_blocks,
    place_in,
)
from torchweather.gap.statistics import Group, Layout, Reduced

__all__ = ["CameraSums", "camera_layout"]

SIGNAL = (0.0, 0.02, 0.04, 0.07, 0.11, 0.16, 0.23, 0.32, 0.45, 0.6, 0.8, 1.01)  # of saturation
NOISE_SIGNAL = (0.0, 0.04, 0.1, 0.2, 0.35, 0.6, 1.01)
ALL_COLOURS = ("depth_m", "depth_m_dark", "depth_m_medium", "depth_m_bright", "modelled_signal")
GREEN_ALONE = (
    *("elevation_rad_near", "elevation_rad_far", "off_axis_rad_near", "off_axis_rad_far", "off_axis_rad"),
    *("column_share_near", "column_share_far", "depth_m_level", "depth_m_upright"),
)
BY_SIGNAL = ((0, 1), (1, 0))  # lags whose spread is looked at along the signal as well
ASIDE = 2  # cells to either side with whose mean a cell is compared for the tails
TAILS_SD = (2.0, 3.0, 4.5, 7.0, 11.0, 18.0, 1e4)
TAIL_TEXTURE = 0.05  # of the modelled difference, which counts as noise
# Rows and columns, in cells, between the two of which the product says how streaks run.
STREAK_LAGS = ((1, 0), (2, 0), (4, 0), (8, 0), (1, 1), (1, -1), (2, 1), (2, -1), (4, 1), (4, -1), (4, 2), (4, -2))
HIGHEST = 12.0  # standard deviations of a single cell that count in those
TAIL_FROM_M = (0.0, 30.0, 1e6)  # depths of the scene: in front of what is near there are few particles
SHARED_CELLS = 4.0  # neighbouring cells that one streak or one blurred edge makes depend on each other
SCALARS = ("near_log_ratio", "far_log_ratio", "sky_log_ratio", "log_difference_spread")
STEADY = (1e-3, 1e-3, 1e-3, 5e-3)  # of these, scatter below which frames are called alike
MAP_BLOCKS = 4  # blocks that a part of the map is high and wide
MAP_UNIT = 0.01  # of a logarithm
MAPS = ("log_ratio_map",)


def lag_name(lag: tuple[int, int]) -> str:
    """A lag in pixels down and to the right, as part of a name.

    Example:
        >>> lag_name((8, -2))
        '16_-4_px'
    """
    return f"{2 * lag[0]}_{2 * lag[1]}_px"


def camera_layout(scene: CameraScene, colours: Sequence[str]) -> Layout:
    """Which statistics along which of the axes that a scene has.

    Args:
        scene: any of the study.
        colours: of the colour filter array.
    """
    edges = {**scene.edges, "modelled_signal": SIGNAL}
    groups = []
    for colour in colours:
        axes = ALL_COLOURS if colour != "green" else (*ALL_COLOURS, *GREEN_ALONE)
        groups += [Group(f"log_ratio_{colour}", axis, "mean", edges[axis]) for axis in axes if axis in edges]
    groups.append(Group("log_ratio_spread", "depth_m", "spread", edges["depth_m"]))
    for lag in scene.flat:
        groups.append(Group(f"difference_spread_{lag_name(lag)}", "depth_m", "spread", DEPTH_CLASSES_M))
        if lag in BY_SIGNAL:
            groups.append(Group(f"difference_spread_{lag_name(lag)}", "modelled_signal", "spread", NOISE_SIGNAL))
    groups += [Group(f"edge_contrast_{lag_name(lag)}", "depth_m", "mean", DEPTH_CLASSES_M) for lag in scene.sharp]
    groups += [
        Group(f"streak_correlation_{lag_name(lag)}", "depth_m", "mean", tuple(TAIL_FROM_M)) for lag in STREAK_LAGS
    ]
    for side in ("bright", "dark"):
        groups += [Group(f"{side}_share_{where}", "residual_sd", "share", TAILS_SD) for where in ("near", "far")]
    return Layout(tuple(groups), SCALARS, STEADY, MAPS)


class _Binned:
    """Elements of a frame, summed up in the bins of some axes.

    Args:
        axes: axis to the bin of each element ``(N,)``, -1 for none, and the number of bins.
    """

    def __init__(self, axes: Mapping[str, tuple[Tensor, int]]) -> None:
        self.axes = dict(axes)
        self.place: dict[str, slice] = {}
        start, hot = 0, []
        for axis, (bins, count) in self.axes.items():
            one = torch.zeros(len(bins), count + 1)
            one.scatter_(1, bins.where(bins >= 0, count)[:, None].long(), 1.0)
            hot.append(one[:, :count])
            self.place[axis] = slice(start, start + count)
            start += count
        self._hot = torch.cat(hot, 1)

    def sums(self, values: Tensor, portion: Tensor | None, portions: int) -> Tensor:
        """Sums ``(F * portions, R, bins)`` of values ``(F, R, N)``; ``portion (N,)`` tells the rows apart."""
        if portion is None:
            return (values.flatten(0, 1) @ self._hot).double().reshape(*values.shape[:2], -1)
        parts = []
        for bins, count in self.axes.values():
            index = torch.where(bins >= 0, portion * count + bins, portions * count).expand(values.shape)
            total = torch.zeros(*values.shape[:2], portions * count + 1, dtype=torch.float64)
            total.scatter_add_(2, index, values.double())
            parts.append(total[..., :-1].reshape(*total.shape[:2], portions, count))
        return torch.cat(parts, 3).transpose(1, 2).flatten(0, 1)


class CameraSums:
    """Reduces frames of one scene in one weather.

    Args:
        scene: with its clear frames.
        layout: of the statistics.
        pattern: of the colour filter array.
        colours: in rising order.
        modelled: ``(K + 1, 1, H, W)`` the references in this weather, as the model without effects and particles has
            them.
    """

    def __init__(
        self, scene: CameraScene, layout: Layout, pattern: str, colours: Sequence[str], modelled: Tensor
    ) -> None:
        self.scene, self.layout, self.pattern, self.colours = scene, layout, pattern, tuple(colours)
        self.green = self.colours.index("green")
        self._reference = cell_colours(scene.reference, pattern)  # (K + 1, C, h, w)
        in_weather = cell_colours(modelled, pattern)
        self._modelled = in_weather[:, self.green]  # (K + 1, h, w)
        self._log_reference = in_blocks(self._reference).clamp_min(DARKEST).log()
        blocks = in_blocks(in_weather)
        self._noise = {
            colour: _noise_of_logarithm(blocks[-1, number], scene.noise_variance, colour)
            for number, colour in enumerate(self.colours)
        }
        blocks = blocks[:, self.green]
        self._log_modelled = blocks.clamp_min(DARKEST).log()
        signal = place_in(blocks[-1], SIGNAL).where(scene.bins["off_axis_rad"] >= 0, -1)
        axes = {axis: (bins, len(scene.edges[axis]) - 1) for axis, bins in scene.bins.items()}
        axes["modelled_signal"] = (signal, len(SIGNAL) - 1)
        known = {name: axes[name] for name in (*ALL_COLOURS, *GREEN_ALONE) if name in axes}
        self._blocks = {
            colour: _Binned({a: known[a] for a in known if colour == "green" or a in ALL_COLOURS})
            for colour in self.colours
        }
        self._flat = {lag: self._pairs(lag, pairs, by_signal=lag in BY_SIGNAL) for lag, pairs in scene.flat.items()}
        self._sharp = {lag: self._pairs(lag, pairs, by_signal=False) for lag, pairs in scene.sharp.items()}
        self._tail_noise, self._tail_class = self._tails()
        self._streak_bins = {lag: self._streak(lag) for lag in STREAK_LAGS}
        self._streak_count: dict[tuple[tuple[int, int], int], Tensor] = {}
        self._map_cells = self._map()

    def _pairs(self, lag: tuple[int, int], pairs: Pairs, *, by_signal: bool) -> _Binned:
        axes = {"depth_m": (pairs.depth_class, len(DEPTH_CLASSES_M) - 1)}
        if by_signal:
            level = self._modelled[-1].flatten()[pairs.first]
            axes["modelled_signal"] = (place_in(level, NOISE_SIGNAL), len(NOISE_SIGNAL) - 1)
        return _Binned(axes)

    def _streak(self, lag: tuple[int, int]) -> _Binned:
        """Pairs of cells at a lag by the class of depth that they share."""
        height, width = self.scene.cells
        down, aside = lag
        left, right = max(-aside, 0), width - max(aside, 0)
        first = self._tail_class[: height - down, left:right]
        second = self._tail_class[down:, left + aside : right + aside]
        classes = first.where(first == second, -1).flatten()
        return _Binned({"depth_m": (classes, len(TAIL_FROM_M) - 1)})

    def _tails(self) -> tuple[Tensor, Tensor]:
        """Standard deviation of what the tails are told from ``(h, w)``, and class of depth ``(h, w)``, -1 for none."""
        modelled = self._modelled[-1]
        constant, growing = self.scene.noise_variance
        variance = 1.5 * (constant + growing * modelled) + (TAIL_TEXTURE * _beside(modelled)).square()
        block = self.scene.block_depth_m.view(self._block_size)
        depth_m = torch.full(self.scene.cells, torch.nan)
        spread = block.repeat_interleave(BLOCK_CELLS, 0).repeat_interleave(BLOCK_CELLS, 1)
        depth_m[: spread.shape[0], : spread.shape[1]] = spread
        classes = place_in(depth_m, TAIL_FROM_M)
        classes[:, :ASIDE] = -1
        classes[:, -ASIDE:] = -1
        return variance.sqrt(), classes

    @property
    def _block_size(self) -> tuple[int, int]:
        return self.scene.cells[0] // BLOCK_CELLS, self.scene.cells[1] // BLOCK_CELLS

    def _map(self) -> Tensor:
        """Part of the map of each block ``(B,)``."""
        rows, columns = self._block_size
        down, across = torch.arange(rows) // MAP_BLOCKS, torch.arange(columns) // MAP_BLOCKS
        return (down[:, None] * (int(across[-1]) + 1) + across).flatten()

    @property
    def modelled_level(self) -> Tensor:
        """Logarithm of the green of blocks of the clear scene in this weather, ``(h, w)``."""
        return self._log_modelled[-1].view(self._block_size)

    def mean_level(self, bayer: Tensor) -> Tensor:
        """That of frames ``(F, 1, H, W)``, their mean."""
        green = in_blocks(cell_colours(bayer, self.pattern))[:, self.green]
        return green.clamp_min(DARKEST).log().mean(0).view(self._block_size)

    def __call__(self, bayer: Tensor, row: Tensor, portions: int = 1) -> Reduced:
        """Sums of frames ``(F, 1, H, W)``.

        Args:
            bayer: the frames.
            row: ``(F,)`` what each is compared with (``CameraScene``).
            portions: into which the blocks are divided at random, the same ones in each frame; the result then has
                ``F * portions`` rows, one for each frame and portion, frame by frame.
        """
        cells = cell_colours(bayer, self.pattern)
        portion = self._portions(portions)
        found: dict[tuple[str, str], tuple[Tensor, Tensor, Tensor]] = {}
        ratio = in_blocks(cells).clamp_min(DARKEST).log_()  # (F, C, B)
        over = ratio[:, self.green] - self._log_modelled[row]
        ratio -= self._log_reference[row]
        self._brightness(found, ratio, over, portion, portions)
        residual = cells[:, self.green] - self._modelled[row]
        spread = self._texture(found, residual.flatten(1), portion, portions)
        self._sharpness(found, cells[:, self.green].flatten(1), row, portion, portions)
        relative = _beside(residual) / self._tail_noise
        self._tail_shares(found, relative, portion, portions)
        self._streaks(found, relative.clamp(-HIGHEST, HIGHEST), portion, portions)
        weight, value, square = (
            torch.cat([found[group.statistic, group.axis][which] for group in self.layout.binned], 1).numpy()
            for which in range(3)
        )
        scalar = torch.cat([self._means(ratio[:, self.green]), spread[:, None]], 1).repeat_interleave(portions, 0)
        maps = self._over_model(over).repeat_interleave(portions, 0)
        return Reduced(weight, value, square, scalar.numpy(), maps[:, None].numpy())

    def _brightness(
        self,
        found: dict[tuple[str, str], tuple[Tensor, Tensor, Tensor]],
        ratio: Tensor,
        over: Tensor,
        portion: Tensor | None,
        portions: int,
    ) -> None:
        """Logarithm over the clear scene, and over the model, of blocks."""
        for number, colour in enumerate(self.colours):
            binned, own = self._blocks[colour], ratio[:, number]
            rows = [torch.ones_like(own), own, self._noise[colour].expand(own.shape)]
            if colour == "green":
                rows += [over, over.square()]
            sums = binned.sums(torch.stack(rows, 1), portion, portions)
            for axis, place in binned.place.items():
                number_of, total, square = (sums[:, which, place] for which in range(3))
                found[f"log_ratio_{colour}", axis] = (number_of, total, _about(number_of, total, square))
            if colour == "green":
                place = binned.place["depth_m"]
                found["log_ratio_spread", "depth_m"] = (sums[:, 0, place], sums[:, 3, place], sums[:, 4, place])

    def _texture(
        self,
        found: dict[tuple[str, str], tuple[Tensor, Tensor, Tensor]],
        residual: Tensor,
        portion: Tensor | None,
        portions: int,
    ) -> Tensor:
        """Scatter of differences on flat places; that of neighbours in a row ``(F,)``, its logarithm."""
        whole = torch.zeros(len(residual), dtype=torch.float64)
        for lag, pairs in self.scene.flat.items():
            binned = self._flat[lag]
            difference = residual[:, pairs.second] - residual[:, pairs.first]
            rows = torch.stack([torch.ones_like(difference), difference, difference.square()], 1) / SHARED_CELLS
            if lag == (0, 1):
                whole = 0.5 * difference.square().double().mean(1).clamp_min(1e-14).log()
            sums = binned.sums(rows, self._of_cells(portion, pairs), portions)
            for axis, place in binned.place.items():
                found[f"difference_spread_{lag_name(lag)}", axis] = tuple(sums[:, k, place] for k in range(3))  # type: ignore[assignment]
        return whole

    def _sharpness(
        self,
        found: dict[tuple[str, str], tuple[Tensor, Tensor, Tensor]],
        green: Tensor,
        row: Tensor,
        portion: Tensor | None,
        portions: int,
    ) -> None:
        """Regression of differences across edges on those of the clear scene, each weighed with its square."""
        clear, modelled = self._reference[:, self.green].flatten(1), self._modelled[-1].flatten()
        constant, growing = self.scene.noise_variance
        for lag, pairs in self.scene.sharp.items():
            binned = self._sharp[lag]
            before = (clear[:, pairs.second] - clear[:, pairs.first])[row]
            after = green[:, pairs.second] - green[:, pairs.first]
            scale = SHARED_CELLS * before.square().mean(1, keepdim=True).clamp_min(1e-12)
            noise = (2.0 * constant + growing * (modelled[pairs.second] + modelled[pairs.first])).expand(after.shape)
            rows = torch.stack([before.square() / scale, before * after / scale, noise / scale], 1)
            number, total, square = binned.sums(rows, self._of_cells(portion, pairs), portions).unbind(1)
            found[f"edge_contrast_{lag_name(lag)}", "depth_m"] = (number, total, _about(number, total, square))

    def _tail_shares(
        self,
        found: dict[tuple[str, str], tuple[Tensor, Tensor, Tensor]],
        relative: Tensor,
        portion: Tensor | None,
        portions: int,
    ) -> None:
        """Shares of the cells that stand out of those beside them by so many standard deviations."""
        bins, classes = len(TAILS_SD) - 1, len(TAIL_FROM_M) - 1
        inner = torch.tensor(TAILS_SD[:-1])
        height = torch.bucketize(relative.abs(), inner, right=True)  # 0 is none
        kind = 2 * self._tail_class + (relative < 0)  # (F, h, w), negative where not looked at
        kind = kind.where(self._tail_class >= 0, 2 * classes)
        of = torch.zeros(self.scene.cells, dtype=torch.long) if portion is None else self._cell_portion(portion)
        slot = torch.arange(len(relative))[:, None, None] * portions + of
        index = (slot * (2 * classes + 1) + kind) * (bins + 1) + height
        counts = torch.bincount(index.flatten(), minlength=len(relative) * portions * (2 * classes + 1) * (bins + 1))
        counts = counts.double().view(-1, 2 * classes + 1, bins + 1) / SHARED_CELLS
        for number, where in enumerate(("near", "far")):
            total = counts[:, 2 * number : 2 * number + 2].sum((1, 2))[:, None].expand(-1, bins)
            for side, sign in (("bright", 0), ("dark", 1)):
                share = counts[:, 2 * number + sign, 1:]
                found[f"{side}_share_{where}", "residual_sd"] = (total, share, share)

    def _streaks(
        self,
        found: dict[tuple[str, str], tuple[Tensor, Tensor, Tensor]],
        relative: Tensor,
        portion: Tensor | None,
        portions: int,
    ) -> None:
        """Mean products of cells at several lags: in which direction, how wide and how long streaks are."""
        height, width = relative.shape[-2:]
        owner = None if portion is None else self._cell_portion(portion)
        for lag in STREAK_LAGS:
            down, aside = lag
            left, right = max(-aside, 0), width - max(aside, 0)
            first = (..., slice(0, height - down), slice(left, right))
            product = relative[first] * relative[..., down:, left + aside : right + aside] / SHARED_CELLS
            own = None if owner is None else owner[first].flatten()
            total = self._streak_bins[lag].sums(product.flatten(1)[:, None], own, portions)[:, 0]
            key = portions
            if (lag, key) not in self._streak_count:
                one = torch.full((1, 1, product[0].numel()), 1.0 / SHARED_CELLS)
                self._streak_count[lag, key] = self._streak_bins[lag].sums(one, own, portions)[:, 0]
            number = self._streak_count[lag, key].repeat(len(relative), 1)
            # Products of independent normal values have a variance of 1.
            found[f"streak_correlation_{lag_name(lag)}", "depth_m"] = (number, total, _about(number, total, number))

    def _means(self, ratio: Tensor) -> Tensor:
        """Mean logarithm of near, of far blocks and of the sky, ``(F, 3)``."""
        depth_m = self.scene.block_depth_m
        known = self.scene.bins["depth_m"] >= 0
        parts = (depth_m < NEAR_M, (depth_m > FAR_M) & (depth_m < SKY_M), depth_m >= SKY_M)
        return torch.stack([_mean(ratio, known & part) for part in parts], 1)

    def _over_model(self, over: Tensor) -> Tensor:
        """Map of what blocks are over the model ``(F, cells)``, in percent, without what all of a depth are."""
        bins, count = self.scene.bins["depth_m"], len(self.scene.edges["depth_m"]) - 1
        place = bins.where(bins >= 0, count).expand(over.shape)
        known = (bins >= 0).double().expand(over.shape)
        total, number = (
            torch.zeros(len(over), count + 1, dtype=torch.float64).scatter_add_(1, place, values)
            for values in (over.double(), known)
        )
        apart = (over - (total / number.clamp_min(1.0)).gather(1, place)) * known
        cells = int(self._map_cells[-1]) + 1
        sums, counts = (
            torch.zeros(len(over), cells, dtype=torch.float64).scatter_add_(
                1, self._map_cells.expand(over.shape), values
            )
            for values in (apart, known)
        )
        return sums / counts.clamp_min(1.0) / MAP_UNIT

    def _portions(self, portions: int) -> Tensor | None:
        """Portion of each block ``(B,)``; ``None`` where there is one."""
        if portions == 1:
            return None
        blocks = len(self.scene.block_depth_m)
        order = np.random.default_rng(86028157).permutation(blocks)
        return torch.from_numpy(order % portions)

    def _cell_portion(self, portion: Tensor) -> Tensor:
        """Portion of each cell ``(h, w)``: that of its block; the first where it is in none."""
        found = torch.zeros(self.scene.cells, dtype=torch.long)
        spread = portion.view(self._block_size).repeat_interleave(BLOCK_CELLS, 0).repeat_interleave(BLOCK_CELLS, 1)
        found[: spread.shape[0], : spread.shape[1]] = spread
        return found

    def _of_cells(self, portion: Tensor | None, pairs: Pairs) -> Tensor | None:
        return None if portion is None else self._cell_portion(portion).flatten()[pairs.first]


def _about(number: Tensor, total: Tensor, noise: Tensor) -> Tensor:
    """Sum of squares whose variance is that of noise: how elements of a bin differ otherwise is no scatter."""
    return total.square() / number.clamp_min(1e-12) + noise


def _noise_of_logarithm(level: Tensor, variance: tuple[float, float], colour: str) -> Tensor:
    """Variance of the logarithm of blocks ``(B,)`` by the noise of their pixels."""
    pixels = BLOCK_CELLS**2 * (1.0 if colour == "green" else 0.5)  # in the unit of green, two in a cell
    seen = level.clamp_min(DARKEST)
    return (variance[0] + variance[1] * level) / (pixels * seen.square())


def _beside(values: Tensor) -> Tensor:
    """Values ``(..., h, w)`` less the mean of those to either side; 0 at the ends of rows."""
    found = torch.zeros_like(values)
    mean = 0.5 * (values[..., : -2 * ASIDE] + values[..., 2 * ASIDE :])
    found[..., ASIDE:-ASIDE] = values[..., ASIDE:-ASIDE] - mean
    return found


def _mean(values: Tensor, which: Tensor) -> Tensor:
    if not bool(which.any()):
        return torch.zeros(len(values), dtype=torch.float64)
    return values[:, which].double().mean(1)


def colours_of(pattern_index: Sequence[Sequence[int]]) -> tuple[str, ...]:
    """Names of the colours of a filter array, in rising order."""
    return tuple(COLOURS[number] for number in sorted({int(k) for row in pattern_index for k in row}))
