"""Mask of the own vehicle: the bonnet that a camera behind a windscreen sees along the picture's lower edge."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from torchweather.core.arguments import check_arguments
from torchweather.core.arrays import as_numpy
from torchweather.core.errors import InputValueError

__all__ = ["find_near_mask"]

Array = npt.NDArray[np.floating[Any]]

# Rows searched, as a share of the height: a bonnet that fills more of a driving picture is cropped away or calibrated.
_SEARCHED_SHARE = 0.16
_COLUMNS = 160  # blocks across the picture: a block averages the road's and the bonnet's texture
_STEP_ROWS_SHARE = 0.007  # rows averaged above and below a candidate edge, of the height: 5 of 720
_FINE_ROWS_SHARE = 0.003  # the same for the exact row once the path is known
# The gates lie in the gap between eight highway pictures with a bonnet and twenty street pictures without one; thirty
# more without one, of a roadside camera, then gave no false alarm.
_EVIDENT_STEP = 0.03  # colour step across the edge, sRGB 0..1
_OVER_TEXTURE = 2.2  # and times the median step elsewhere: grass and gravel have steps everywhere
_EVIDENT_SHARE = 0.90  # of the columns
_ROUGHEST_SHARE = 0.006  # of the height: deviation of the edge from a polynomial of degree 6 (bonnets: 0.003)
_STEEPEST_SHARE = 0.06  # of the height: rise of the edge from left to right end; a kerb or a wall rises more
# A wing's edge may lie this far above the crease between wing and bonnet, of the height. There any evident step is as
# good as a stronger one, and the upper one is preferred by up to this many evident steps.
_WING_SHARE, _WING_EVIDENT, _WING_BONUS = 0.022, 1.3, 0.25
_ROW_COST = 0.12  # price of one row of change between two blocks, in evident steps


def find_near_mask(rgb: Tensor) -> Tensor:
    """Share of each pixel that shows the own vehicle, found in one picture.

    The edge of a bonnet crosses the whole picture, lies in its lowest sixth, is smooth and about level, and the colour
    changes across it in almost every column. The best such path is found by dynamic programming over the colour
    steps; everything below it is the vehicle. A picture without an edge that passes all gates gets zeros.

    Args:
        rgb: ``(3, H, W)`` or ``(1, H, W)``, sRGB, uint8 or float 0..1; or several pictures of one camera,
            ``(N, C, H, W)``: the mask is then the median of theirs, which shadows and lane marks do not move.

    Returns:
        ``(1, H, W)`` float32, 0..1, soft over two rows at the edge.

    Note:
        Mirrors, window frames and wipers are not looked for; draw those once for a camera and hand the mask over. A
        bonnet in deep shade in front of a road in deep shade has no edge and is not found.

    Example:
        >>> picture = torch.full((3, 100, 200), 0.4)
        >>> picture[:, 92:] = 0.15                      # a dark bonnet across the picture
        >>> find_near_mask(picture)[0, [90, 95], 100]
        tensor([0., 1.])
    """
    check_arguments("find_near_mask(rgb: real)", rgb)
    if rgb.ndim not in (3, 4) or rgb.shape[-3] not in (1, 3) or 0 in rgb.shape:
        raise InputValueError(
            f"find_near_mask: expected a picture (3, H, W) or (1, H, W), or (N, C, H, W); got {tuple(rgb.shape)}."
        )
    if rgb.ndim == 4:
        return torch.stack([find_near_mask(picture) for picture in rgb]).median(0).values
    height, width = rgb.shape[-2:]
    mask = torch.zeros((1, height, width), dtype=torch.float32, device=rgb.device)
    edge = _bonnet_edge(rgb)
    if edge is not None:
        row = torch.arange(height, dtype=torch.float32, device=rgb.device)[:, None]
        edge_row = torch.from_numpy(edge.astype(np.float32)).to(rgb.device)
        mask[0] = (0.5 * (row - edge_row) + 0.5).clamp(0.0, 1.0)
    return mask


def _bonnet_edge(rgb: Tensor) -> Array | None:
    """Row of the bonnet's edge in every column, ``(W,)``, or ``None``."""
    height, width = rgb.shape[-2:]
    half = max(2, round(_STEP_ROWS_SHARE * height))
    searched = round(_SEARCHED_SHARE * height)
    blocks = min(_COLUMNS, width)
    if searched < 2 * half + 3 or blocks < 16:
        return None
    block_edges = np.linspace(0, width, blocks + 1).round().astype(np.intp)
    band: Array = as_numpy(rgb[:, height - searched :]).astype(np.float32)
    band = band / (255.0 if rgb.dtype == torch.uint8 else 1.0)
    band = np.add.reduceat(band, block_edges[:-1], axis=-1) / np.diff(block_edges)
    steps, first_row = _colour_steps(band, half)
    path = _best_path(np.minimum(steps / _EVIDENT_STEP, 2.0), _ROW_COST)
    strength = steps[path, np.arange(blocks)]
    x = np.linspace(-1.0, 1.0, blocks)
    smooth = np.polynomial.Polynomial.fit(x, path, 6)(x)
    away = np.abs(np.arange(len(steps))[:, None] - path) > 2 * half
    texture = float(np.median(steps[away])) if away.any() else 0.0
    evident = float((strength > max(_EVIDENT_STEP, _OVER_TEXTURE * texture)).mean())
    rough = float(np.sqrt(np.square(path - smooth).mean()))
    rise = abs(float(path[-blocks // 8 :].mean() - path[: blocks // 8].mean()))
    if evident < _EVIDENT_SHARE or rough > _ROUGHEST_SHARE * height or rise > _STEEPEST_SHARE * height:
        return None
    height_above = path - np.arange(len(steps))[:, None]
    wing = max(1, round(_WING_SHARE * height))
    inside = (height_above >= -half) & (height_above <= wing)
    gain = np.minimum(steps / _EVIDENT_STEP, _WING_EVIDENT) + _WING_BONUS / wing * height_above
    path = _best_path(np.where(inside, gain, -1e3), _ROW_COST)
    row = _refined(band, path + first_row, half)
    # Median of five blocks against single leaps (lane marks, cracks), then between the blocks' centres.
    padded = np.pad(row.astype(np.float64), 2, mode="edge")
    steady = np.median(np.lib.stride_tricks.sliding_window_view(padded, 5), -1)
    centre = 0.5 * (block_edges[:-1] + block_edges[1:] - 1)
    edge: Array = np.interp(np.arange(width), centre, steady) + (height - searched - 0.5)
    return edge


def _refined(band: Array, row: npt.NDArray[np.intp], half: int) -> npt.NDArray[np.intp]:
    """First row of the vehicle in every block, by a step of fewer rows within ``half`` rows of a path."""
    narrow = max(1, round(_FINE_ROWS_SHARE / _STEP_ROWS_SHARE * half))
    steps, first_row = _colour_steps(band, narrow)
    far = np.abs(np.arange(len(steps))[:, None] + first_row - row) > half
    typical = np.median(np.where(far, 0.0, steps).max(0))
    gain = np.where(far, -1e3, np.minimum(steps / max(float(typical), 1e-6), 1.5))
    return _best_path(gain, _ROW_COST) + first_row


def _colour_steps(band: Array, half: int) -> tuple[Array, int]:
    """Colour difference between ``half`` rows above and below each row, ``(R, B)``, and the band's row of its first."""
    total = np.cumsum(np.pad(band, ((0, 0), (1, 0), (0, 0))), axis=1)
    mean = (total[:, half:] - total[:, :-half]) / half
    difference = mean[:, half:] - mean[:, :-half]
    steps: Array = np.sqrt(np.square(difference).mean(0))
    return steps, half


def _best_path(gain: Array, row_cost: float) -> npt.NDArray[np.intp]:
    """Row in every column of the path that gains most, a change of row costing ``row_cost`` a row (at most 3)."""
    rows, columns = gain.shape
    best, came_from = gain[:, 0].copy(), np.zeros((rows, columns), np.intp)
    row = np.arange(rows)
    for column in range(1, columns):
        value, origin = best.copy(), row.copy()
        for change in (-3, -2, -1, 1, 2, 3):
            start = row - change
            inside = (start >= 0) & (start < rows)
            candidate = np.where(inside, best[start.clip(0, rows - 1)] - abs(change) * row_cost, -np.inf)
            better = candidate > value
            value, origin = np.where(better, candidate, value), np.where(better, start, origin)
        best, came_from[:, column] = value + gain[:, column], origin
    path = np.empty(columns, np.intp)
    path[-1] = int(best.argmax())
    for column in range(columns - 1, 0, -1):
        path[column - 1] = came_from[path[column], column]
    return path
