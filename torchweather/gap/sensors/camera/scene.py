"""References of a camera scene's frames: its clear frames, and the bins that pixels are put into.

Pixels are looked at in cells of the colour filter array (2 x 2 px: one value per colour) and in blocks of 2 x 2 cells.
A simulated frame starts from one clear frame and is compared with the mean of the others, a measured one with the mean
of all but one too: both differ from what they are compared with by the noise of a frame of their own.

References:
    GAP.md 3 (1, 2).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import torch
from torch import Tensor

from torchweather.camera.bayer import cfa_colour_index
from torchweather.camera.sensor import Camera
from torchweather.core.errors import TorchweatherError
from torchweather.gap.study.conditions import StudyScene

__all__ = [
    "COLOURS",
    "LAGS",
    "CameraScene",
    "Pairs",
    "block_levels",
    "camera_scene",
    "cell_colours",
    "in_blocks",
    "level_ground",
    "place_in",
    "tile_blocks",
]

COLOURS = ("red", "green", "blue")  # of the colour filter array; green is the clear pixel's where there is one
GREEN = 1
BLOCK_CELLS = 2  # a block is so many cells high and wide
TILES_MIN = 160  # into which a frame is divided, for the noise of portions of it
LEAST_PX = 48  # of a frame, either way: a hundred blocks
SKY_M = 1e5  # stands for an infinite depth
DEPTH_M = (0.0, 6.0, 9.0, 13.0, 19.0, 28.0, 42.0, 65.0, 110.0, 300.0, 1e4, 1e6)
DEPTH_CLASSES_M = (0.0, 12.0, 30.0, 80.0, 1e4, 1e6)
NEAR_M, FAR_M = 20.0, 40.0
ONE_DEPTH = 1.3  # largest over least depth of a block that has one depth
RADIUS_BINS, ELEVATION_BINS, COLUMN_BINS, LEVELS = 6, 6, 8, 3
UPRIGHT, LEVEL_GROUND = 0.3, 0.7  # upward component of the normal below and above which a surface is upright or level
# Rows and columns, in cells, between the two of a pair whose difference is looked at.
LAGS = ((0, 1), (1, 0), (1, 1), (1, -1), (0, 2), (2, 0), (4, 0), (8, 0), (8, 2), (8, -2))
EDGE_LAGS = LAGS[:6]
MOST_PAIRS = 12000  # of a lag; more tell no better
FLAT, FLAT_SD = 0.06, 2.0  # of the level, and in standard deviations of the noise: differences of flat places are less
EDGE, EDGE_SD = 0.12, 6.0  # and of edges more
DARKEST = 2e-3  # of saturation; what is darker counts as that in logarithms
MOST_GROWN, LEAST_VARIANCE = 1e4, 1e-12  # of a variance
MOVED_SD = 6.0  # standard deviations of the noise by which a pixel departs that something moves in


def tile_blocks(rows: int, columns: int) -> int:
    """Blocks that a tile is high and wide: as many as leave ``TILES_MIN`` tiles, a power of two.

    A pair of cells of the texture is up to eight of them apart, and one cell is in pairs of every lag. What such
    statistics have in common shows where a portion of the frame holds both cells of most pairs.

    Example:
        >>> tile_blocks(90, 120), tile_blocks(24, 32)
        (8, 2)
    """
    side = 1
    while math.ceil(rows / (2 * side)) * math.ceil(columns / (2 * side)) >= TILES_MIN:
        side *= 2
    return side


@dataclass(frozen=True)
class Pairs:
    """Pairs of cells at one lag.

    Args:
        first, second: ``(P,)`` index of each cell.
        depth_class: ``(P,)`` bin of ``DEPTH_CLASSES_M``, -1 for none.
    """

    first: Tensor
    second: Tensor
    depth_class: Tensor


@dataclass(frozen=True)
class CameraScene:
    """The clear frames of a scene and what each frame is compared with.

    Args:
        clear: ``(K, 1, H, W)`` clear frames.
        reference: ``(K + 1, 1, H, W)`` mean over the clear frames other than k, the last row over all.
        depth_m: ``(1, H, W)``, infinity is sky.
        normal: ``(3, H, W)`` in the vehicle's frame, or ``None``.
        noise_variance: c and v of the variance ``c + v I`` of a cell's green in a clear frame.
        log_scale: ``(K,)`` mean logarithm of each clear frame over the mean of all.
        bins: axis to the bin of each block ``(B,)``, -1 for none.
        edges: axis to the edges of its bins.
        flat, sharp: lag to its pairs on flat places and across edges.
        cells: rows and columns of cells.
        block_depth_m: ``(B,)`` depth of each block, NaN where it has more than one.
    """

    clear: Tensor
    reference: Tensor
    depth_m: Tensor
    normal: Tensor | None
    noise_variance: tuple[float, float]
    log_scale: Tensor
    bins: dict[str, Tensor]
    edges: dict[str, tuple[float, ...]]
    flat: dict[tuple[int, int], Pairs]
    sharp: dict[tuple[int, int], Pairs]
    cells: tuple[int, int]
    block_depth_m: Tensor

    @property
    def level_ground(self) -> Tensor:
        """Mask of the blocks on level ground ``(h, w)``."""
        assert self.normal is not None
        return level_ground(self.normal)

    def with_noise(self, signal: Tensor, transmission: Tensor | None, covered: Tensor | None, row: Tensor) -> Tensor:
        """Frames with the noise of clear frames: what each is over the mean of the others, at the light of now.

        In clear air the clear frame itself comes out. Noise of a frame has a variance of ``c + v I``; that of the
        mean of the other clear frames a share m of it, and is in the signal as far as the scene is seen in it. With g,
        what the light of now makes of the variance, t of the medium and c of the exposure under particles, a of the
        difference ``clear - mean`` is added so that a frame departs from ``t mean``, what it is compared with, by the
        variance of a frame of its own: ``a^2 + m (a + c t)^2 = g + m t^2``.

        Args:
            signal: ``(F, 1, H, W)`` without noise.
            transmission: share of the scene's light that the medium leaves, of the same shape; ``None`` is 1.
            covered: share of the exposure in which particles hide the scene, of the same shape; ``None`` is 0.
            row: ``(F,)`` clear frame of each.
        """
        of_mean = 1.0 / (len(self.clear) - 1)
        constant, growing = self.noise_variance
        inverse, apart = self._noise_parts
        found = torch.empty_like(signal)
        # Frame by frame and in place: temporaries of many frames would leave the cache.
        for number, clear in enumerate(row.tolist()):
            square = (signal[number] * growing).add_(constant).mul_(inverse[clear]).clamp_(0.0, MOST_GROWN)
            left = None if transmission is None else transmission[number]
            square = square.add_(of_mean) if left is None else square.addcmul_(left, left, value=of_mean)
            square.mul_(1.0 + of_mean)
            if covered is None:
                share = square.sqrt_()
            else:
                lost = covered[number] if left is None else covered[number] * left
                share = square.addcmul_(lost, lost, value=-of_mean).sqrt_().sub_(lost, alpha=of_mean)
            share.mul_(1.0 / (1.0 + of_mean))
            torch.addcmul(signal[number], apart[clear], share, out=found[number]).clamp_(0.0, 1.0)
        return found

    @cached_property
    def _noise_parts(self) -> tuple[Tensor, Tensor]:
        """One over the noise's variance of each clear frame, and its difference from the mean of the others."""
        constant, growing = self.noise_variance
        before = self.reference[:-1]
        return 1.0 / (constant + growing * before).clamp_min(LEAST_VARIANCE), self.clear - before


def cell_colours(bayer: Tensor, pattern: str) -> Tensor:
    """Mean of each colour in each cell of mosaics ``(F, 1, H, W)``: ``(F, C, H/2, W/2)``, colours in rising order."""
    index = cfa_colour_index(pattern)
    phases: dict[int, list[Tensor]] = {}
    for row in (0, 1):
        for column in (0, 1):
            phases.setdefault(int(index[row][column]), []).append(bayer[:, 0, row::2, column::2])
    planes = [phases[colour] for colour in sorted(phases)]
    return torch.stack([some[0] if len(some) == 1 else 0.5 * (some[0] + some[1]) for some in planes], 1)


def block_levels(bayer: Tensor, pattern: str) -> Tensor:
    """Logarithm of the green of blocks ``(h, w)``, its mean over frames ``(F, 1, H, W)``."""
    cells = cell_colours(bayer, pattern)
    size = [size // BLOCK_CELLS for size in cells.shape[-2:]]
    return in_blocks(cells)[:, cells.shape[1] // 2].clamp_min(DARKEST).log().mean(0).view(size)


def level_ground(normal: Tensor) -> Tensor:
    """Mask of the blocks ``(h, w)`` that lie on level ground, from normals ``(3, H, W)`` in the vehicle's frame."""
    up = torch.nn.functional.avg_pool2d(normal[None, 2:], 2 * BLOCK_CELLS)[0, 0]
    return up > LEVEL_GROUND


def in_blocks(cells: Tensor) -> Tensor:
    """Means over blocks ``(F, C, B)`` of cells ``(F, C, h, w)``; a last odd row or column of cells is left out."""
    height, width = (size // BLOCK_CELLS * BLOCK_CELLS for size in cells.shape[-2:])
    # Sums of slices: pooling takes four times as long.
    parts = [
        cells[..., down:height:BLOCK_CELLS, aside:width:BLOCK_CELLS]
        for down in range(BLOCK_CELLS)
        for aside in range(BLOCK_CELLS)
    ]
    total = parts[0] + parts[1]
    for part in parts[2:]:
        total += part
    return total.mul_(1.0 / len(parts)).flatten(2)


def block_of_colours(bayer: Tensor, pattern: str) -> Tensor:
    """Means of each colour over blocks of mosaics ``(F, 1, H, W)``: ``(F, C, B)``."""
    return in_blocks(cell_colours(bayer, pattern))


def noise_of_difference(grown: Tensor, left: Tensor, lost: Tensor, of_mean: float) -> Tensor:
    """Share a of ``clear - mean`` that is added (``CameraScene.with_noise``): ``a^2 + m (a + c t)^2 = g + m t^2``.

    Args:
        grown: g, what the light of now makes of the noise's variance.
        left: t, share of the light that the medium leaves.
        lost: c t, what of it particles hide.
        of_mean: m, noise of the mean of the other clear frames over that of one.
    """
    square = (1.0 + of_mean) * (grown + of_mean * left.square()) - of_mean * lost.square()
    return (square.clamp_min(0.0).sqrt() - of_mean * lost) / (1.0 + of_mean)


def place_in(value: Tensor, edges: tuple[float, ...]) -> Tensor:
    """Bin of each value, -1 outside and for NaN."""
    place = torch.bucketize(value.double().contiguous(), torch.tensor(edges, dtype=torch.float64), right=True) - 1
    return torch.where((place >= 0) & (place < len(edges) - 1), place, -1)


def camera_scene(scene: StudyScene, camera: Camera) -> CameraScene:
    """A scene of a study, reduced to what frames are compared with.

    Args:
        scene: of the study.
        camera: that took the frames.

    Raises:
        TorchweatherError: there is a single clear frame, or the frames are too small.
    """
    number = len(scene.clear)
    height, width = scene.geometry["depth_m"].shape
    if min(height, width) < LEAST_PX:
        raise TorchweatherError(
            f"find_gap: not enough data to decide: the frames of scene {scene.id} have {width} x {height} pixels; "
            f"expected {LEAST_PX} or more either way, better 160 x 120: light is compared block by block."
        )
    if number < 2:
        raise TorchweatherError(
            f"find_gap: not enough data to decide: the scene {scene.id} has one clear frame; the noise of a frame is "
            "known from how clear frames differ. Give 2 at least, better 8."
        )
    clear = torch.stack([torch.from_numpy(np.array(scene.clear[k]["bayer"], dtype=np.float32)) for k in range(number)])
    keep = torch.ones(number + 1, number)
    keep[:number] -= torch.eye(number)
    reference = torch.tensordot(keep / keep.sum(1, keepdim=True), clear, 1)[:, None]
    clear = clear[:, None]
    depth_m = torch.from_numpy(np.array(scene.geometry["depth_m"], dtype=np.float32))[None]
    normal = None
    if "normal" in scene.geometry:
        normal = torch.from_numpy(np.array(scene.geometry["normal"], dtype=np.float32)).movedim(-1, 0)
    pattern = camera.bayer_pattern
    cells, mean = cell_colours(clear, pattern), cell_colours(reference[-1:], pattern)[0]
    green = mean.shape[0] // 2
    apart = cells[:, green] - mean[green]
    variance = apart.square().sum(0) / (number - 1)
    noise = _variances(variance, mean[green])
    still = variance < MOVED_SD**2 * (noise[0] + noise[1] * mean[green])
    size = (int(mean.shape[1]), int(mean.shape[2]))
    block_depth_m = _block_depth(depth_m)
    bins, edges = _bins(mean[None], depth_m, normal, still, camera, block_depth_m)
    cell_depth_m = _one_depth(depth_m, 2)
    flat, sharp = _pairs(mean[green], noise, cell_depth_m, still)
    level = in_blocks(cells).clamp_min(DARKEST).log() - in_blocks(mean[None]).clamp_min(DARKEST).log()
    return CameraScene(
        clear=clear,
        reference=reference,
        depth_m=depth_m,
        normal=normal,
        noise_variance=noise,
        log_scale=level.double().mean((1, 2)),
        bins=bins,
        edges=edges,
        flat=flat,
        sharp=sharp,
        cells=size,
        block_depth_m=block_depth_m,
    )


def _variances(variance: Tensor, level: Tensor) -> tuple[float, float]:
    """c and v, 0 or more, of a variance ``c + v I``, from the medians in bins of the level: things may move."""
    order = level.flatten().argsort()
    parts = [part for part in order.tensor_split(16) if len(part)]
    at = torch.stack([level.flatten()[part].double().mean() for part in parts])
    # Of few frames the median of a variance lies below its mean; a factor of two at most, which the bounds can bear.
    spread = torch.stack([variance.flatten()[part].double().median() for part in parts])
    centred = at - at.mean()
    growing = max(0.0, float((centred * spread).sum() / centred.square().sum().clamp_min(1e-12)))
    return max(1e-10, float((spread - growing * at).mean())), growing


def _one_depth(depth_m: Tensor, pixels: int) -> Tensor:
    """Depth of squares of so many pixels ``(S,)``, ``SKY_M`` for sky, NaN where a square has more than one."""
    height, width = (size // pixels * pixels for size in depth_m.shape[-2:])
    known = depth_m[:, :height, :width].clamp_max(SKY_M)
    far = torch.nn.functional.max_pool2d(known, pixels).flatten()
    near = -torch.nn.functional.max_pool2d(-known, pixels).flatten()
    return torch.where(far <= ONE_DEPTH * near, 0.5 * (near + far), torch.nan)


def _block_depth(depth_m: Tensor) -> Tensor:
    return _one_depth(depth_m, 2 * BLOCK_CELLS)


def _bins(
    mean: Tensor, depth_m: Tensor, normal: Tensor | None, still: Tensor, camera: Camera, block_depth_m: Tensor
) -> tuple[dict[str, Tensor], dict[str, tuple[float, ...]]]:
    """Bins of each block along every axis that does not depend on the weather."""
    height, width = depth_m.shape[-2:]
    level = in_blocks(mean)[0, mean.shape[1] // 2]
    same = in_blocks(still[None, None].float())[0, 0] > 0.5
    directions = camera.ray_directions(height, width)  # (3, H, W), z = 1
    length = directions.square().sum(0).sqrt()
    down = camera.down_direction()
    fall = sum(direction * part for direction, part in zip(directions, down, strict=True))
    assert isinstance(fall, Tensor)
    place = {
        "elevation_rad": -torch.asin((fall / length).clamp(-1.0, 1.0)),
        "off_axis_rad": torch.acos((1.0 / length).clamp(-1.0, 1.0)),
        "column_share": (torch.arange(width) / width).expand(height, width),
    }
    pooled = {
        name: torch.nn.functional.avg_pool2d(value[None, None].float(), 2 * BLOCK_CELLS).flatten()
        for name, value in place.items()
    }
    low, high = float(pooled["elevation_rad"].min()), float(pooled["elevation_rad"].max())
    edges = {
        "depth_m": DEPTH_M,
        "elevation_rad": _evenly(low, high, ELEVATION_BINS),
        "off_axis_rad": _evenly(0.0, float(pooled["off_axis_rad"].max()), RADIUS_BINS),
        "column_share": _evenly(0.0, 1.0, COLUMN_BINS),
    }
    depth = place_in(block_depth_m, DEPTH_M).where(same, -1)
    thirds = torch.quantile(level[same], torch.tensor([1 / 3, 2 / 3])).tolist() if bool(same.any()) else [0.0, 1.0]
    third = (level > thirds[0]).int() + (level > thirds[1]).int()
    near, far = block_depth_m < NEAR_M, (block_depth_m > FAR_M) & (block_depth_m < SKY_M)
    bins = {"depth_m": depth}
    for number, name in enumerate(("dark", "medium", "bright")):
        bins[f"depth_m_{name}"] = depth.where(third == number, -1)
    for axis, value in pooled.items():
        found = place_in(value, edges[axis]).where(same, -1)
        bins[f"{axis}_near"], bins[f"{axis}_far"] = found.where(near, -1), found.where(far, -1)
        bins[axis] = found
    if normal is not None:
        up = torch.nn.functional.avg_pool2d(normal[None, 2:], 2 * BLOCK_CELLS).flatten()
        bins["depth_m_level"] = depth.where(up > LEVEL_GROUND, -1)
        bins["depth_m_upright"] = depth.where((up.abs() < UPRIGHT) & (block_depth_m < SKY_M), -1)
    for axis in bins:
        edges.setdefault(axis, edges[next(base for base in edges if axis.startswith(base))])
    return bins, edges


def _pairs(
    green: Tensor, noise: tuple[float, float], depth_m: Tensor, still: Tensor
) -> tuple[dict[tuple[int, int], Pairs], dict[tuple[int, int], Pairs]]:
    """Pairs of cells at each lag, on flat places and across edges, of one class of depth."""
    height, width = green.shape
    classes, level = place_in(depth_m, DEPTH_CLASSES_M), green.flatten()
    cell = torch.arange(height * width).view(height, width)
    generator = np.random.default_rng(5081)
    flat: dict[tuple[int, int], Pairs] = {}
    sharp: dict[tuple[int, int], Pairs] = {}
    for down, aside in LAGS:
        left, right = max(-aside, 0), width - max(aside, 0)
        first = cell[: height - down, left:right].flatten()
        second = cell[down:, left + aside : right + aside].flatten()
        together = still.flatten()[first] & still.flatten()[second] & (classes[first] >= 0)
        # Across a contour the depth may change; the farther one says how the fog softens it.
        known = together & (classes[second] >= 0)
        difference = (level[second] - level[first]).abs()
        brighter = torch.maximum(level[first], level[second])
        sd = (noise[0] + noise[1] * brighter).sqrt()
        even = known & (classes[first] == classes[second]) & (difference < FLAT * brighter + FLAT_SD * sd)
        steep = known & (difference > EDGE * brighter + EDGE_SD * sd)
        for kept, which in ((flat, even), (sharp, steep)):
            if kept is sharp and (down, aside) not in EDGE_LAGS:
                continue
            chosen = which.nonzero()[:, 0].numpy()
            if len(chosen) > MOST_PAIRS:
                chosen = np.sort(generator.permutation(chosen)[:MOST_PAIRS])
            some = torch.from_numpy(chosen)
            far = torch.maximum(classes[first[some]], classes[second[some]])
            kept[down, aside] = Pairs(first[some], second[some], far)
    return flat, sharp


def _evenly(low: float, high: float, bins: int) -> tuple[float, ...]:
    margin = 1e-6 * max(1.0, math.fabs(high))
    return tuple(float(value) for value in np.linspace(low - margin, high + margin, bins + 1))
