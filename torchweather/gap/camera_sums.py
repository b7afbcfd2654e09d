"""Frames of a camera to sums over bins: brightness, sharpness, texture and tails of a frame against its clear scene.

Of blocks of 4 x 4 px the logarithm of each colour over the clear scene's (``log_ratio``); of pairs of 2 x 2 px cells at
several lags the scatter of the difference, on flat places (``difference_spread``: noise, and streaks by their
direction, width and length), and its regression on the clear one across edges (``edge_contrast``: sharpness); of cells
the share that stands out of its neighbours beside it (``bright_share``, ``dark_share``: how many streaks, how bright),
and the mean product with others at several lags (``streak_correlation``: which way streaks run, how far), and far along
a line (``column_correlation``, ``row_correlation``: what the readout of one adds). Of the two greens of a cell the
share of those that differ by so much (``green_pair_share``: faults of single pixels), and of each colour by how far it
is displaced (``shift``, ``camera_shift.py``).
What is left over the model as it is, in parts of the picture, makes a map, and so do pixels that stand out alone
(``camera_pixels.py``): of these, what stays in its place counts.

References:
    GAP.md 3 (1).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from torchweather.gap.camera_bins import Binned, Key
from torchweather.gap.camera_edges import SHARED_CELLS, Edges, lag_name
from torchweather.gap.camera_pixels import LonePixels
from torchweather.gap.camera_scene import (
    BLOCK_CELLS,
    COLOURS,
    DARKEST,
    DEPTH_CLASSES_M,
    FAR_M,
    FLAT,
    FLAT_SD,
    NEAR_M,
    SKY_M,
    CameraScene,
    cell_colours,
    green_pair,
    in_blocks,
    place_in,
)
from torchweather.gap.camera_shift import MOTIONS, Shifts, shift_name
from torchweather.gap.statistics import Group, Layout, Reduced

__all__ = ["CameraSums", "camera_layout"]

Floats = NDArray[np.float64]
Sums = dict[Key, tuple[Floats, Floats, Floats]]
"""Statistic and axis to the sums ``(F * portions, bins)`` of weights, of values and of squares."""

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
FAR_LAG = 20  # cells, farther than most streaks are long: what the readout of a column, or of a row, adds
HIGHEST = 12.0  # standard deviations of a single cell that count in those
TAIL_FROM_M = (0.0, 30.0, 1e6)  # depths of the scene: in front of what is near there are few particles
WHERE = ("near", "far")
SCALARS = ("near_log_ratio", "far_log_ratio", "sky_log_ratio", "log_difference_spread")
STEADY = (1e-3, 1e-3, 1e-3, 5e-3)  # of these, scatter below which frames are called alike
MAP_BLOCKS = 4  # blocks that a part of the map is high and wide
MAP_UNIT = 0.01  # of a logarithm
MAPS = ("log_ratio_map", "lone_pixel_map")


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
    groups += [Group(f"streak_correlation_{lag_name(lag)}", "depth_m", "mean", TAIL_FROM_M) for lag in STREAK_LAGS]
    groups += [Group(f"{line}_correlation", "depth_m", "mean", TAIL_FROM_M) for line in ("column", "row")]
    groups += [
        Group(shift_name(motion, colour), "depth_m", "mean", TAIL_FROM_M) for colour in colours for motion in MOTIONS
    ]
    for side in ("bright", "dark", "green_pair"):
        groups += [Group(f"{side}_share_{where}", "residual_sd", "share", TAILS_SD) for where in WHERE]
    return Layout(tuple(groups), SCALARS, STEADY, MAPS)


class CameraSums:
    """Reduces frames of one scene in one weather.

    Args:
        scene: with its clear frames.
        layout: of the statistics.
        pattern: of the colour filter array.
        colours: in rising order.
        modelled: ``(K + 1, 1, H, W)`` the references in this weather, as the model without effects and particles has
            them.
        edges: of the scene, where they are known already.
    """

    def __init__(
        self,
        scene: CameraScene,
        layout: Layout,
        pattern: str,
        colours: Sequence[str],
        modelled: Tensor,
        edges: Edges | None = None,
    ) -> None:
        self.scene, self.layout, self.pattern, self.colours = scene, layout, pattern, tuple(colours)
        self.green = self.colours.index("green")
        reference = cell_colours(scene.reference, pattern)  # (K + 1, C, h, w)
        in_weather = cell_colours(modelled, pattern)
        self._modelled = in_weather[:, self.green]  # (K + 1, h, w)
        self._log_reference = in_blocks(reference).clamp_min(DARKEST).log()
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
            colour: Binned(
                {(f"log_ratio_{colour}", a): known[a] for a in known if colour == "green" or a in ALL_COLOURS}
            )
            for colour in self.colours
        }
        self._depths = Binned({("log_ratio_spread", "depth_m"): axes["depth_m"]})
        self._noise_sums = {
            colour: self._blocks[colour].sums(noise[:, None], None, 1) for colour, noise in self._noise.items()
        }
        self._first = torch.cat([pairs.first for pairs in scene.flat.values()])
        self._second = torch.cat([pairs.second for pairs in scene.flat.values()])
        self._flat = self._flat_pairs()
        self.edges = edges or Edges(scene, reference[:, self.green])
        self._edge_noise = self._noise_across_edges()
        self._edge_noise_sums = self.edges.summed(self._edge_noise, None, 1)
        self._light = in_weather
        self._tail_noise, self._tail_class = self._tails(self._modelled[-1], self._depth_classes())
        # Of rows what is said of columns, in the picture on its side.
        self._row_noise, self._row_class = self._tails(self._modelled[-1].T, self._depth_classes().T)
        columns = {f"streak_correlation_{lag_name(lag)}": lag for lag in STREAK_LAGS}
        columns["column_correlation"] = (FAR_LAG, 0)
        self._column_bins = {key: (lag, _at_lag(key, lag, self._tail_class)) for key, lag in columns.items()}
        lag = (FAR_LAG, 0)
        self._row_bins = {"row_correlation": (lag, _at_lag("row_correlation", lag, self._row_class))}
        self._pair, self._pair_noise, self._pair_class = self._pairs(modelled)
        classes = len(TAIL_FROM_M) - 1
        self._shifts = Shifts(
            in_weather[-1], scene.noise_variance, self._tail_class, classes, self.colours, axis="depth_m"
        )
        self._map_bins, self._map_known = self._map()
        self._lone = LonePixels(modelled, scene.noise_variance, self._map_bins.number)
        self._parts = self._distances()

    def _flat_pairs(self) -> Binned:
        """The pairs on flat places, lag by lag, by the depth and some by the signal."""
        groups: dict[Key, tuple[Tensor, int]] = {}
        start, number = 0, len(self._first)

        def among_all(bins: Tensor) -> Tensor:
            found = torch.full((number,), -1)
            found[start : start + len(bins)] = bins
            return found

        for lag, pairs in self.scene.flat.items():
            statistic = f"difference_spread_{lag_name(lag)}"
            groups[statistic, "depth_m"] = among_all(pairs.depth_class), len(DEPTH_CLASSES_M) - 1
            if lag in BY_SIGNAL:
                level = self._modelled[-1].flatten()[pairs.first]
                groups[statistic, "modelled_signal"] = among_all(place_in(level, NOISE_SIGNAL)), len(NOISE_SIGNAL) - 1
            start += len(pairs.first)
        return Binned(groups)

    def _noise_across_edges(self) -> Floats:
        """Variance of the difference of each pair across an edge ``(P,)`` by the noise of its cells."""
        constant, growing = self.scene.noise_variance
        modelled = self._modelled[-1].flatten().double().numpy()
        found: Floats = 2.0 * constant + growing * (modelled[self.edges.second] + modelled[self.edges.first])
        return found

    def _tails(self, modelled: Tensor, classes: Tensor) -> tuple[Tensor, Tensor]:
        """Standard deviation of what the tails are told from ``(h, w)``, and class of depth ``(h, w)``, -1 for none."""
        constant, growing = self.scene.noise_variance
        variance = 1.5 * (constant + growing * modelled) + (TAIL_TEXTURE * _beside(modelled)).square()
        classes = classes.clone()
        classes[:, :ASIDE] = -1
        classes[:, -ASIDE:] = -1
        return variance.sqrt(), classes

    def _depth_classes(self) -> Tensor:
        """Class of depth of each cell ``(h, w)``, -1 for none."""
        block = self.scene.block_depth_m.view(self._block_size)
        depth_m = torch.full(self.scene.cells, torch.nan)
        spread = block.repeat_interleave(BLOCK_CELLS, 0).repeat_interleave(BLOCK_CELLS, 1)
        depth_m[: spread.shape[0], : spread.shape[1]] = spread
        return place_in(depth_m, TAIL_FROM_M)

    def _pairs(self, modelled: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Difference of the greens of each cell as modelled ``(K + 1, h, w)``, standard deviation of its noise and
        class of depth ``(h, w)``, -1 where it is not flat."""
        pair = green_pair(modelled, self.pattern)
        level, classes = self._modelled[-1], self._depth_classes()
        constant, growing = self.scene.noise_variance
        noise = 2.0 * (constant + growing * level).sqrt()  # of a difference, four times that of the mean
        return pair, noise, classes.where(pair[-1].abs() < FLAT * level + FLAT_SD * noise, -1)

    @property
    def _block_size(self) -> tuple[int, int]:
        return self.scene.cells[0] // BLOCK_CELLS, self.scene.cells[1] // BLOCK_CELLS

    def _map(self) -> tuple[Binned, Floats]:
        """Part of the map of each block, and how many known blocks each has."""
        rows, columns = self._block_size
        down, across = torch.arange(rows) // MAP_BLOCKS, torch.arange(columns) // MAP_BLOCKS
        cells = (down[:, None] * (int(across[-1]) + 1) + across).flatten()
        known = cells.where(self.scene.bins["depth_m"] >= 0, -1)
        binned = Binned({(MAPS[0], "place"): (known, int(cells[-1]) + 1)})
        return binned, np.maximum(binned.counts(None, 1)[0], 1.0)

    def _distances(self) -> Tensor:
        """Weights ``(B, 3)`` of near, of far blocks and of the sky in their means."""
        depth_m, known = self.scene.block_depth_m, self.scene.bins["depth_m"] >= 0
        parts = (depth_m < NEAR_M, (depth_m > FAR_M) & (depth_m < SKY_M), depth_m >= SKY_M)
        found = torch.stack([(known & part).double() for part in parts], 1)
        return found / found.sum(0).clamp_min(1.0)

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
        blocks, owner = self._portions(portions)
        ratio = in_blocks(cells).clamp_min_(DARKEST).log_()  # (F, C, B)
        over = ratio[:, self.green] - self._log_modelled[row]
        ratio -= self._log_reference[row]
        found = self._brightness(ratio, over, blocks, portions)
        residual = cells[:, self.green] - self._modelled[row]
        texture, spread = self._texture(residual, owner, portions)
        found |= texture
        found |= self._sharpness(cells[:, self.green], row, owner, portions)
        found |= _parted(self._shifts.place, *self._displaced(cells - self._light[row], owner, portions))
        relative = _beside(residual).div_(self._tail_noise)
        found |= self._tail_shares(relative, owner, portions)
        found |= _products(relative, self._tail_class, self._column_bins, owner, portions)
        rows = _beside(residual.mT).div_(self._row_noise)
        aside = None if owner is None else owner.view(self.scene.cells).T.flatten()
        found |= _products(rows, self._row_class, self._row_bins, aside, portions)
        found |= self._pair_shares(bayer, row, owner, portions)
        groups = [found[group.statistic, group.axis] for group in self.layout.binned]
        weight, value, square = (np.concatenate(parts, 1) for parts in zip(*groups, strict=True))
        means = ratio[:, self.green].double() @ self._parts
        scalar = np.concatenate([means.numpy(), spread[:, None]], 1).repeat(portions, 0)
        maps = np.stack([self._over_model(over), self._lone(bayer, row)], 1).repeat(portions, 0)
        return Reduced(weight, value, square, scalar, maps)

    def _brightness(self, ratio: Tensor, over: Tensor, portion: Tensor | None, portions: int) -> Sums:
        """Logarithm over the clear scene, and over the model, of blocks."""
        found: Sums = {}
        frames = len(ratio)
        for number, colour in enumerate(self.colours):
            binned = self._blocks[colour]
            total = binned.sums(ratio[:, number].T.contiguous(), portion, portions)
            count = np.tile(binned.counts(portion, portions), (frames, 1))
            noise = self._noise_sums[colour]
            if portion is not None:
                noise = binned.sums(self._noise[colour][:, None], portion, portions)
            found |= _parted(binned.place, count, total, _about(count, total, np.tile(noise, (frames, 1))))
        # The difference of two large sums: as float64.
        total, square = (
            self._depths.sums(one.T.contiguous(), portion, portions) for one in (over.double(), over.double().square())
        )
        count = np.tile(self._depths.counts(portion, portions), (frames, 1))
        return found | _parted(self._depths.place, count, total, square)

    def _texture(self, residual: Tensor, portion: Tensor | None, portions: int) -> tuple[Sums, Floats]:
        """Scatter of differences on flat places; that of neighbours in a row ``(F,)``, its logarithm."""
        own = None if portion is None else portion[self._first]
        frames = residual.flatten(1).T.contiguous()  # cells first: those of a pair are fetched for all frames at once
        difference = frames.index_select(0, self._second).sub_(frames.index_select(0, self._first))
        total = self._flat.sums(difference, own, portions) / SHARED_CELLS
        square = self._flat.sums(difference.square_(), own, portions) / SHARED_CELLS
        count = np.tile(self._flat.counts(own, portions), (len(residual), 1)) / SHARED_CELLS
        found = _parted(self._flat.place, count, total, square)
        number, _, squares = (
            one.reshape(len(residual), -1).sum(1) for one in found[f"difference_spread_{lag_name((0, 1))}", "depth_m"]
        )
        whole: Floats = 0.5 * np.log(np.maximum(squares / np.maximum(number, 1.0), 1e-14))
        return found, whole

    def _sharpness(self, green: Tensor, row: Tensor, portion: Tensor | None, portions: int) -> Sums:
        """Regression of differences across edges on those of the clear scene, each weighed with its square."""
        edges = self.edges
        total, number = edges.totals(green, row, portion, portions), edges.numbers(row, portion, portions)
        noise = self._edge_noise_sums
        if portion is not None:
            noise = edges.summed(self._edge_noise, portion, portions)
        noise = np.concatenate([noise / edges.scale[clear] for clear in row.tolist()])
        return _parted(edges.place, number, total, _about(number, total, noise))

    def _displaced(self, residual: Tensor, portion: Tensor | None, portions: int) -> tuple[Floats, Floats, Floats]:
        """By how far each colour is displaced."""
        number, total, noise = self._shifts.sums(residual, portion, portions)
        return number, total, _about(number, total, noise)

    def _tail_shares(self, relative: Tensor, portion: Tensor | None, portions: int) -> Sums:
        """Shares of the cells that stand out of those beside them by so many standard deviations."""
        of, counts = _far_out(relative, self._tail_class, portion, portions)
        return {
            (f"{side}_share_{where}", "residual_sd"): _of_all(of[:, number], counts[:, number, sign])
            for number, where in enumerate(WHERE)
            for side, sign in (("bright", 0), ("dark", 1))
        }

    def _pair_shares(self, bayer: Tensor, row: Tensor, portion: Tensor | None, portions: int) -> Sums:
        """Shares of the cells on flat places whose greens differ by so many standard deviations."""
        apart = green_pair(bayer, self.pattern).sub_(self._pair[row]).div_(self._pair_noise)
        of, counts = _far_out(apart, self._pair_class, portion, portions)
        return {
            (f"green_pair_share_{where}", "residual_sd"): _of_all(of[:, number], counts[:, number].sum(1))
            for number, where in enumerate(WHERE)
        }

    def _over_model(self, over: Tensor) -> Floats:
        """Map of what blocks are over the model ``(F, cells)``, in percent, without what all of a depth are."""
        bins = self.scene.bins["depth_m"].numpy()
        blocks = over.double()
        mean = self._depths.sums(blocks.T.contiguous(), None, 1) / np.maximum(self._depths.counts(None, 1), 1.0)
        apart = blocks - torch.from_numpy(mean[:, bins])  # of blocks without a depth, which are in no part, anything
        return self._map_bins.sums(apart.T.contiguous(), None, 1) / self._map_known / MAP_UNIT

    def _portions(self, portions: int) -> tuple[Tensor | None, Tensor | None]:
        """Portion of each block ``(B,)`` and of each cell ``(h w,)``: that of its block, the first where it is in none.

        ``None`` where there is one.
        """
        if portions == 1:
            return None, None
        blocks = len(self.scene.block_depth_m)
        portion = torch.from_numpy(np.random.default_rng(86028157).permutation(blocks) % portions)
        found = torch.zeros(self.scene.cells, dtype=torch.long)
        spread = portion.view(self._block_size).repeat_interleave(BLOCK_CELLS, 0).repeat_interleave(BLOCK_CELLS, 1)
        found[: spread.shape[0], : spread.shape[1]] = spread
        return portion, found.flatten()


def _parted(place: dict[Key, slice], weight: Floats, value: Floats, square: Floats) -> Sums:
    """Sums ``(F * portions, bins)`` of several groups, each for itself."""
    return {key: (weight[:, own], value[:, own], square[:, own]) for key, own in place.items()}


def _about(number: Floats, total: Floats, noise: Floats) -> Floats:
    """Sum of squares whose variance is that of noise: how elements of a bin differ otherwise is no scatter."""
    found: Floats = total**2 / np.maximum(number, 1e-12) + noise
    return found


def _noise_of_logarithm(level: Tensor, variance: tuple[float, float], colour: str) -> Tensor:
    """Variance of the logarithm of blocks ``(B,)`` by the noise of their pixels."""
    pixels = BLOCK_CELLS**2 * (1.0 if colour == "green" else 0.5)  # in the unit of green, two in a cell
    seen = level.clamp_min(DARKEST)
    return (variance[0] + variance[1] * level) / (pixels * seen.square())


def _beside(values: Tensor) -> Tensor:
    """Values ``(..., h, w)`` less the mean of those to either side; 0 at the ends of rows."""
    found = torch.zeros(values.shape, dtype=values.dtype)
    mean = 0.5 * (values[..., : -2 * ASIDE] + values[..., 2 * ASIDE :])
    found[..., ASIDE:-ASIDE] = values[..., ASIDE:-ASIDE] - mean
    return found


def _at_lag(statistic: str, lag: tuple[int, int], classes: Tensor) -> Binned:
    """Cells by the class of depth ``(h, w)`` that they share with the one at a lag."""
    first, second = classes.flatten(), torch.full((classes.numel(),), -1)
    offset = lag[0] * classes.shape[1] + lag[1]
    second[: len(first) - offset] = first[offset:]
    return Binned({(statistic, "depth_m"): (first.where(first == second, -1), len(TAIL_FROM_M) - 1)})


def _products(
    relative: Tensor,
    classes: Tensor,
    bins: Mapping[str, tuple[tuple[int, int], Binned]],
    portion: Tensor | None,
    portions: int,
) -> Sums:
    """Mean products of cells at several lags: in which direction, how wide and how long streaks are.

    Args:
        relative: ``(F, h, w)``; a single cell counts up to ``HIGHEST``.
        classes: ``(h, w)`` of depth.
        bins: statistic to its lag, and to the cells by the class that they share with the one there.
        portion: ``(h w,)`` of each cell; ``None``: all are one.
        portions: number of them.
    """
    found: Sums = {}
    cells = relative.clamp_(-HIGHEST, HIGHEST).flatten(1)
    # Cells of one class alone, all others 0. The ends of rows have none: a product over them adds nothing.
    apart = [(cells * (classes.flatten() == kind)).numpy() for kind in range(len(TAIL_FROM_M) - 1)]
    for lag, binned in bins.values():
        offset = lag[0] * classes.shape[1] + lag[1]
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
        found |= _parted(binned.place, number, total, _about(number, total, number))
    return found


def _far_out(relative: Tensor, classes: Tensor, portion: Tensor | None, portions: int) -> tuple[Floats, Floats]:
    """How many cells there are ``(F * portions, classes)``, and how many are far out on either side, upwards first,
    ``(F * portions, classes, 2, bins)`` of ``TAILS_SD``.

    Args:
        relative: ``(F, h, w)``.
        classes: ``(h, w)`` of depth, -1 for none.
        portion, portions: as of the call.
    """
    bins, number = len(TAILS_SD) - 1, len(TAIL_FROM_M) - 1
    values, kinds = relative.flatten(1).numpy(), classes.flatten().numpy()
    owner = np.zeros(len(kinds), np.int64) if portion is None else portion.numpy()
    frame, cell = np.nonzero(np.abs(values) >= TAILS_SD[0])
    frame, cell = (one[kinds[cell] >= 0] for one in (frame, cell))
    out = values[frame, cell]
    height = np.searchsorted(np.array(TAILS_SD[:-1], np.float32), np.abs(out), side="right") - 1
    index = ((frame * portions + owner[cell]) * 2 * number + 2 * kinds[cell] + (out < 0)) * bins + height
    shape = (len(values) * portions, number, 2, bins)
    counts = np.bincount(index, minlength=int(np.prod(shape))).reshape(shape) / SHARED_CELLS
    known = kinds >= 0
    of = np.bincount(owner[known] * number + kinds[known], minlength=portions * number)
    return np.tile(of.reshape(portions, number), (len(values), 1)) / SHARED_CELLS, counts


def _of_all(number: Floats, counts: Floats) -> tuple[Floats, Floats, Floats]:
    """Sums of shares ``(F, bins)`` of so many elements ``(F,)``."""
    return number[:, None].repeat(counts.shape[1], 1), counts, counts


def colours_of(pattern_index: Sequence[Sequence[int]]) -> tuple[str, ...]:
    """Names of the colours of a filter array, in rising order."""
    return tuple(COLOURS[number] for number in sorted({int(k) for row in pattern_index for k in row}))
