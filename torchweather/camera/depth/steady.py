"""Scenes of a drive that are steady in time: medians and means over neighbouring frames, pixel by pixel."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Generic, TypeVar

import torch
from torch import Tensor

from torchweather.camera.depth.scene_depth import GUESSED, SceneDepth
from torchweather.core.errors import check_at_least

__all__ = ["common_near_mask", "is_cut", "reach_of", "steady_scenes"]

T = TypeVar("T")

# The horizon, walls and skyline of single frames jitter from frame to frame; a street changes within a second.
WINDOW_S = 0.2
FEWEST, MOST = 2, 6  # frames on each side: some to average at 5 Hz, bounded memory at 60 Hz and more
# Standard deviation in 0..1 of the same surface's grey value in two frames: noise, compression, half a pixel of motion.
# Leaves against sky differ by some 0.3. Of 0.01, 0.02, 0.04 and 0.08 the one with the least change of sky from frame to
# frame where the picture stays, on the first half of a highway drive of 38 frames; so it is on the second half.
ALIKE = 0.04
# Mean absolute difference of successive frames in cells of 16 px, 0..1: 0.016 to 0.034 on that drive.
CUT = 0.15
CELL_PX = 16
SKY_ALONE = 1.0 - 1e-3
ROUNDING = 1e-5  # of sums of weights
SMALLEST_DEPTH_M = 1e-3


def reach_of(frame_rate_hz: float) -> int:
    """Number of frames on each side over which scenes are averaged, 2 to 6: 0.2 s.

    Example:
        >>> reach_of(10.0), reach_of(25.0)
        (2, 5)
    """
    return int(min(max(round(WINDOW_S * frame_rate_hz), FEWEST), MOST))


def is_cut(before: Tensor, after: Tensor) -> bool:
    """Check whether one frame shows another scene than the other: a cut.

    Args:
        before: ``(C, H, W)``, uint8, uint16 or float in 0..1.
        after: the same.
    """
    if before.shape != after.shape:
        return True
    cells = [_in_cells(_grey(image)) for image in (before, after)]
    return bool((cells[0] - cells[1]).abs().mean() > CUT)


def common_near_mask(scenes: Sequence[SceneDepth]) -> Tensor | None:
    """The own vehicle in a fixed camera's picture: the median over frames, ``(..., 1, H, W)``; ``None`` without any.

    Args:
        scenes: of frames far apart, so that shadows and reflections differ.
    """
    masks = [scene.near_mask for scene in scenes if scene.near_mask is not None]
    if not masks:
        return None
    blank = torch.zeros_like(masks[0])
    return torch.stack([*masks, *[blank] * (len(scenes) - len(masks))]).median(0).values


def steady_scenes(frames: Iterable[tuple[T, Tensor, SceneDepth]], *, reach: int) -> Iterator[tuple[T, SceneDepth]]:
    r"""Scenes of successive frames without flicker.

    Over the frames j within ``reach`` of frame k and between the same two cuts, with the weights

    ``w_jk = (1 - |j - k| / (reach + 1)) exp(-(I_j - I_k)^2 / (2 s^2))``

    of a pixel's grey value I and s = 0.04, the sky share becomes the weighted median, the depth the weighted geometric
    mean. So a pixel takes over only from frames in which it showed the same surface: leaves that pass in front of the
    sky keep their edge. Horizon and own vehicle become means with the first factor alone. The window is symmetric, so
    nothing lags.

    Args:
        frames: for each frame whatever is to come out with its scene, the image ``(C, H, W)``, and its scene.
        reach: number of frames on each side.

    Yields:
        What came in, and the steady scene, in order. Scenes that are not ``guessed`` pass as they are: measured depth
        has objects that move. At most ``2 reach + 1`` frames are held.

    Example:
        >>> grey = torch.full((3, 1, 1), 0.5)
        >>> sky = [1.0, 1.0, 0.0, 1.0, 1.0]  # one frame's mistake
        >>> scenes = [SceneDepth(torch.tensor([[[30.0]]]), "guessed", sky=torch.tensor([[[s]]])) for s in sky]
        >>> steady = steady_scenes(((k, grey, scene) for k, scene in enumerate(scenes)), reach=2)
        >>> [round(scene.sky_share.item(), 2) for _, scene in steady]
        [1.0, 1.0, 1.0, 1.0, 1.0]
    """
    check_at_least("reach", reach, 0, owner="steady_scenes")
    window: deque[_Held[T]] = deque()
    shot = 0
    for item, image, scene in frames:
        if window and is_cut(window[-1].image, image):
            shot += 1
        window.append(_Held(item, image, scene, shot))
        if len(window) > 2 * reach + 1:
            window.popleft()
        # The middle one has all its neighbours, except at the start, where there are fewer behind it.
        middle = len(window) - 1 - reach
        if middle >= 0:
            yield window[middle].item, _mean_scene(window, middle, reach)
        del item, image, scene
    for middle in range(max(0, len(window) - reach), len(window)):
        yield window[middle].item, _mean_scene(window, middle, reach)


@dataclass
class _Held(Generic[T]):
    """A frame in the window."""

    item: T
    image: Tensor
    scene: SceneDepth
    shot: int


def _mean_scene(window: Sequence[_Held[T]], middle: int, reach: int) -> SceneDepth:
    own = window[middle]
    if own.scene.confidence != GUESSED or reach == 0:
        return own.scene
    near = [
        (1.0 - abs(number - middle) / (reach + 1), held)
        for number, held in enumerate(window)
        if abs(number - middle) <= reach and held.shot == own.shot and held.scene.confidence == GUESSED
    ]
    guide = _smooth_grey(own.image)
    depth = own.scene.depth_m
    depth_total, log_depth_sum = torch.zeros_like(depth), torch.zeros_like(depth)
    weights = []
    for weight_of_time, held in near:
        other = guide if held is own else _smooth_grey(held.image)
        weight = weight_of_time * torch.exp(-0.5 * ((other - guide) / ALIKE).square()).to(depth)
        weights.append(weight.expand_as(depth))
        known = torch.isfinite(held.scene.depth_m)
        depth_total += torch.where(known, weight, 0.0)
        log_depth = torch.log(held.scene.depth_m.clamp_min(SMALLEST_DEPTH_M))
        log_depth_sum += torch.where(known, weight * log_depth, 0.0)
    sky = _median_share([held.scene.sky_share for _, held in near], weights)
    seen = depth_total > 0
    mean = torch.exp(log_depth_sum / depth_total.clamp_min(1e-12))
    # Sky alone has no depth, as in a single frame's scene; a place without any depth keeps its own (inf or NaN).
    alone = (sky > SKY_ALONE) & ~depth.isnan()
    sky = torch.where(alone, 1.0, sky)
    depth = torch.where(alone, torch.inf, torch.where(seen, mean, depth))
    masks = [(weight, held.scene.near_mask) for weight, held in near]
    near_mask = _mean([(weight, mask) for weight, mask in masks if mask is not None])
    grounds = [(weight, held.scene.ground) for weight, held in near]
    ground = _mean([(weight, share) for weight, share in grounds if share is not None])
    rows = [(weight, torch.tensor(row)) for weight, held in near if (row := held.scene.horizon_row) is not None]
    mean_row = _mean(rows)
    any_sky = any(held.scene.sky is not None for _, held in near)
    return replace(
        own.scene,
        depth_m=depth,
        sky=sky if any_sky else None,
        near_mask=near_mask,
        ground=ground,
        horizon_row=None if mean_row is None else float(mean_row),
    )


def _median_share(shares: Sequence[Tensor], weights: Sequence[Tensor]) -> Tensor:
    """Weighted median of each pixel; between two values that have half of the weight each, their mean."""
    low, high = shares[0].clone(), shares[0].clone()
    for share in shares[1:]:
        torch.minimum(low, share, out=low)
        torch.maximum(high, share, out=high)
    median = shares[0].clone()
    # Nearly all pixels are sky alone or no sky in every frame: only the others are sorted.
    differ = high > low
    if bool(differ.any()):
        values, order = torch.stack([share[differ] for share in shares]).sort(0)
        weight = torch.stack([one[differ] for one in weights]).gather(0, order)
        reached = weight.cumsum(0) / weight.sum(0)
        below = (reached >= 0.5 - ROUNDING).to(torch.uint8).argmax(0, keepdim=True)
        above = (reached > 0.5 + ROUNDING).to(torch.uint8).argmax(0, keepdim=True)
        median[differ] = 0.5 * (values.gather(0, below) + values.gather(0, above))[0]
    return median


def _mean(values: Sequence[tuple[float, Tensor]]) -> Tensor | None:
    """Weighted mean; ``None`` of nothing."""
    if not values:
        return None
    total = sum(weight for weight, _ in values)
    mean = torch.zeros_like(values[0][1])
    for weight, value in values:
        mean = mean + (weight / total) * value
    return mean


def _grey(image: Tensor) -> Tensor:
    """``(1, H, W)`` mean of the channels, float32 in 0..1."""
    if image.is_floating_point():
        return image.float().mean(0, keepdim=True)
    top = float(torch.iinfo(image.dtype).max)
    return image.to(torch.int32).sum(0, keepdim=True).float() / (top * image.shape[0])


def _smooth_grey(image: Tensor) -> Tensor:
    """Grey values averaged over 3 x 3 pixels, which takes away most of the noise."""
    # kornia.filters.box_blur: 3.3 times the time at 1920 x 1080 (62 against 19 ms)
    padded = torch.nn.functional.pad(_grey(image)[None], (1, 1, 1, 1), mode="replicate")
    return torch.nn.functional.avg_pool2d(padded, 3, stride=1)[0]


def _in_cells(grey: Tensor) -> Tensor:
    cell = min(CELL_PX, *grey.shape[-2:])
    return torch.nn.functional.avg_pool2d(grey[None], cell)[0]
