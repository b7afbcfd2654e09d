"""Frames of a camera to sums over bins: brightness, sharpness, texture and tails of a frame against its clear scene.

Of blocks of 4 x 4 px the logarithm of each colour over the clear scene's (``log_ratio``); of pairs of 2 x 2 px cells at
several lags the scatter of the difference, on flat places (``difference_spread``: noise, and streaks by their
direction, width and length), and its regression on the clear one across edges (``edge_contrast``: sharpness,
``camera_edges.py``). Which cells stand out of those beside them, and how that runs, is in ``camera_tails.py``; by how
far each colour is displaced (``shift``) in ``camera_shift.py``.
What is left over the model as it is, in parts of the picture, makes a map, and so do pixels that stand out alone
(``camera_pixels.py``): of these, what stays in its place counts.

References:
    GAP.md 3 (1).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from torchweather.gap.sensors.camera.bins import Binned, Key, Sums, about, parted
from torchweather.gap.sensors.camera.edges import SHARED_CELLS, Edges, lag_name
from torchweather.gap.sensors.camera.pixels import LonePixels
from torchweather.gap.sensors.camera.scene import (
    BLOCK_CELLS,
    COLOURS,
    DARKEST,
    DEPTH_CLASSES_M,
    FAR_M,
    NEAR_M,
    SKY_M,
    CameraScene,
    block_levels,
    cell_colours,
    in_blocks,
    place_in,
    tile_blocks,
)
from torchweather.gap.sensors.camera.shift import MOTIONS, Shifts, shift_name
from torchweather.gap.sensors.camera.tails import (
    FAR_LAG,
    TAIL_FROM_M,
    Beside,
    correlation_groups,
    products_share,
    share_groups,
)
from torchweather.gap.statistics.frame_statistics import Group, Layout, Reduced

__all__ = ["CameraSums", "camera_layout"]

Floats = NDArray[np.float64]

SIGNAL = (0.0, 0.02, 0.04, 0.07, 0.11, 0.16, 0.23, 0.32, 0.45, 0.6, 0.8, 1.01)  # of saturation
NOISE_SIGNAL = (0.0, 0.04, 0.1, 0.2, 0.35, 0.6, 1.01)
ALL_COLOURS = ("depth_m", "depth_m_dark", "depth_m_medium", "depth_m_bright", "modelled_signal")
GREEN_ALONE = (
    *("elevation_rad_near", "elevation_rad_far", "off_axis_rad_near", "off_axis_rad_far", "off_axis_rad"),
    *("column_share_near", "column_share_far", "depth_m_level", "depth_m_upright"),
)
BY_SIGNAL = ((0, 1), (1, 0))  # lags whose spread is looked at along the signal as well
SCALARS = ("near_log_ratio", "far_log_ratio", "sky_log_ratio", "log_difference_spread")
STEADY = (1e-3, 1e-3, 1e-3, 5e-3)  # of these, scatter below which frames are called alike
MAP_BLOCKS = 4  # blocks that a part of the map is high and wide
MAP_UNIT = 0.01  # of a logarithm
MAPS = ("log_ratio_map", "lone_pixel_map")


def camera_layout(scene: CameraScene, colours: Sequence[str]) -> Layout:
    """Statistics along each of the axes that a scene has.

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
    groups += correlation_groups()
    groups += [
        Group(shift_name(motion, colour), "depth_m", "mean", TAIL_FROM_M) for colour in colours for motion in MOTIONS
    ]
    groups += share_groups()
    products = tuple(group.statistic for group in correlation_groups())
    blocks = tile_blocks(scene.cells[0] // BLOCK_CELLS, scene.cells[1] // BLOCK_CELLS)
    shared = dict.fromkeys(products, products_share(blocks * BLOCK_CELLS))
    return Layout(tuple(groups), SCALARS, STEADY, MAPS, about_clear_mean=products, scatter_share=shared)


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
        self.axes = axes  # to the bin of each block, and how many there are
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
        green, classes, noise = self._modelled[-1], self._depth_classes(), scene.noise_variance
        self.beside = Beside(green, noise, classes)
        self.in_rows = Beside(green.T, noise, classes.T)  # of rows what is said of columns, in the picture on its side
        self._light = in_weather
        self._shifts = Shifts(
            in_weather[-1], noise, self.beside.classes, len(TAIL_FROM_M) - 1, self.colours, axis="depth_m"
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

    def _depth_classes(self) -> Tensor:
        """Class of depth of each cell ``(h, w)``, -1 for none."""
        block = self.scene.block_depth_m.view(self._block_size)
        depth_m = torch.full(self.scene.cells, torch.nan)
        spread = block.repeat_interleave(BLOCK_CELLS, 0).repeat_interleave(BLOCK_CELLS, 1)
        depth_m[: spread.shape[0], : spread.shape[1]] = spread
        return place_in(depth_m, TAIL_FROM_M)

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
        return block_levels(bayer, self.pattern)

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
        found |= parted(self._shifts.place, *self._displaced(cells - self._light[row], owner, portions))
        relative = self.beside(residual)
        found |= self.beside.shares(relative, owner, portions)
        found |= self.beside.streaks(relative, owner, portions)
        aside = None if owner is None else owner.view(self.scene.cells).T.flatten()
        found |= self.in_rows.products({"row_correlation": (FAR_LAG, 0)}, self.in_rows(residual.mT), aside, portions)
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
            found |= parted(binned.place, count, total, about(count, total, np.tile(noise, (frames, 1))))
        # The difference of two large sums: as float64.
        total, square = (
            self._depths.sums(one.T.contiguous(), portion, portions) for one in (over.double(), over.double().square())
        )
        count = np.tile(self._depths.counts(portion, portions), (frames, 1))
        return found | parted(self._depths.place, count, total, square)

    def _texture(self, residual: Tensor, portion: Tensor | None, portions: int) -> tuple[Sums, Floats]:
        """Scatter of differences on flat places; that of neighbours in a row ``(F,)``, its logarithm."""
        own = None if portion is None else portion[self._first]
        frames = residual.flatten(1).T.contiguous()  # cells first: those of a pair are fetched for all frames at once
        difference = frames.index_select(0, self._second).sub_(frames.index_select(0, self._first))
        total = self._flat.sums(difference, own, portions) / SHARED_CELLS
        square = self._flat.sums(difference.square_(), own, portions) / SHARED_CELLS
        count = np.tile(self._flat.counts(own, portions), (len(residual), 1)) / SHARED_CELLS
        found = parted(self._flat.place, count, total, square)
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
        return parted(edges.place, number, total, about(number, total, noise))

    def _displaced(self, residual: Tensor, portion: Tensor | None, portions: int) -> tuple[Floats, Floats, Floats]:
        """Displacement of each colour."""
        number, total, noise = self._shifts.sums(residual, portion, portions)
        return number, total, about(number, total, noise)

    def _over_model(self, over: Tensor) -> Floats:
        """Map of what blocks are over the model ``(F, cells)``, in percent, without what all of a depth are."""
        bins = self.scene.bins["depth_m"].numpy()
        blocks = over.double()
        mean = self._depths.sums(blocks.T.contiguous(), None, 1) / np.maximum(self._depths.counts(None, 1), 1.0)
        apart = blocks - torch.from_numpy(mean[:, bins])  # of blocks without a depth, which are in no part, anything
        return self._map_bins.sums(apart.T.contiguous(), None, 1) / self._map_known / MAP_UNIT

    def _portions(self, portions: int) -> tuple[Tensor | None, Tensor | None]:
        """Portion of each block ``(B,)`` and of each cell ``(h w,)``: that of its block, the first where it is in none.

        A portion is made of tiles of neighbouring blocks. ``None`` where there is one.
        """
        if portions == 1:
            return None, None
        rows, columns = self._block_size
        side = tile_blocks(rows, columns)
        down, across = torch.arange(rows) // side, torch.arange(columns) // side
        tile = (down[:, None] * (int(across[-1]) + 1) + across).flatten()
        drawn = torch.from_numpy(np.random.default_rng(86028157).permutation(int(tile[-1]) + 1) % portions)
        portion = drawn[tile]
        found = torch.zeros(self.scene.cells, dtype=torch.long)
        spread = portion.view(self._block_size).repeat_interleave(BLOCK_CELLS, 0).repeat_interleave(BLOCK_CELLS, 1)
        found[: spread.shape[0], : spread.shape[1]] = spread
        return portion, found.flatten()


def _noise_of_logarithm(level: Tensor, variance: tuple[float, float], colour: str) -> Tensor:
    """Variance of the logarithm of blocks ``(B,)`` by the noise of their pixels."""
    pixels = BLOCK_CELLS**2 * (1.0 if colour == "green" else 0.5)  # in the unit of green, two in a cell
    seen = level.clamp_min(DARKEST)
    return (variance[0] + variance[1] * level) / (pixels * seen.square())


def colours_of(pattern_index: Sequence[Sequence[int]]) -> tuple[str, ...]:
    """Names of the colours of a filter array, in rising order."""
    return tuple(COLOURS[number] for number in sorted({int(k) for row in pattern_index for k in row}))
