"""Sky of a photograph, found by its colour, its smoothness and its place; no network.

The steps, one file each: cells of the photograph (`sky_cells`), surely sky (`sky_seeds`), all of the sky
(`sky_growth`), its share of each pixel (`sky_border`). Their constants come from PHOTOGRAPHS.md, section sky mask, or
were chosen on every second of the 16 frames with a mask drawn by hand: 000000, 000002, 000005, 000019, 000021 of KITTI
and p1_solidWhiteRight, straight_lines2, test3 of a highway camera. The choice that no region is too small came from
frame 000020 of the other half. ``benchmarks/sky_mask.json`` has the scores of both halves.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor
from torch.nn.functional import avg_pool2d, interpolate, max_pool2d

from torchweather.camera.depth.sky_border import sky_share
from torchweather.camera.depth.sky_cells import Cells, Floats, Mask, cells_of, enlarged
from torchweather.camera.depth.sky_growth import colour_model, grow
from torchweather.camera.depth.sky_seeds import fills_the_frame, sky_seeds
from torchweather.core.arguments import check_arguments
from torchweather.core.errors import InputTypeError, InputValueError

__all__ = ["Sky", "find_sky", "sky_mask"]

# A guessed horizon may lie this share of the height above the true one: 0.1 for the highway camera's 720 rows.
GUESS_SLACK = 0.1
# Where sky runs into the horizon without an edge, as in fog, it fades over this share of the height.
FADE = 0.05
# Wider pictures are halved, thirded, ... to about this width: their edges are soft, and cost time.
FULL_WIDTH = 1600
# A grey sky this much darker than the brightest of the picture (sRGB) is hill or ground seen through mist: between the
# two shares it fades. The darkest cells of clear and overcast skies are at 0.62 and more.
MIST = (0.35, 0.6)
# Cells beyond the last row of sky whose colours the border is compared with.
MARGIN = 8


@dataclass(frozen=True)
class Sky:
    """Sky of a photograph.

    Args:
        share: ``(1, H, W)`` float32 share of each pixel that is sky, 0..1.
        found: whether any sky was found. Without, ``share`` is 0 everywhere.
        blue: whether the sky has a colour. A white or grey sky is less sure: a pale wall may look the same.
    """

    share: Tensor
    found: bool
    blue: bool


def sky_mask(
    rgb: Tensor,
    *,
    horizon_row: float | None = None,
    vanishing_column: float | None = None,
    returns: Tensor | None = None,
) -> Tensor:
    """Share of sky of each pixel of a photograph, 0..1: exactly 0 far from the sky, exactly 1 deep inside.

    Args:
        rgb: sRGB ``(3, H, W)`` or ``(B, 3, H, W)``, uint8 or float in 0..1.
        horizon_row: row of the horizon, pixels; no sky lies below it. It may lie outside the picture. Default: the
            middle row, and sky may lie up to a tenth of the height below that.
        vanishing_column: column where the road vanishes, pixels. Default: the middle column.
        returns: bool ``(1, H, W)`` or ``(B, 1, H, W)``, pixels that a LiDAR's return fell on. A region with many of
            them is no sky.

    Returns:
        ``(1, H, W)`` or ``(B, 1, H, W)``, float32, on the device of ``rgb``.

    Note:
        Known to fail: a white wall against a white sky, without an edge between; pale hills in mist; a sky that no
        part of touches the picture's top; a picture of a bright road alone, unless ``horizon_row`` says that the
        horizon is above it. A night sky is not found. About 0.1 s for 1242 x 375 on one thread; not differentiable.

    References:
        PHOTOGRAPHS.md, section sky mask.

    Example:
        >>> photograph = torch.full((3, 60, 80), 0.2)
        >>> photograph[:, :20] = torch.tensor([0.5, 0.7, 0.9])[:, None, None]
        >>> sky_mask(photograph)[0, [5, 40], 40]
        tensor([1., 0.])
    """
    check_arguments(
        "sky_mask(rgb: real, horizon_row: float | None, vanishing_column: float | None, returns: real | mask | None)",
        rgb,
        horizon_row,
        vanishing_column,
        returns,
    )
    if rgb.ndim == 4:
        if returns is not None and len(returns) != len(rgb):
            raise InputValueError(
                f"sky_mask: returns must have one mask for each of {len(rgb)} pictures; got {tuple(returns.shape)}."
            )
        marks = [None] * len(rgb) if returns is None else returns
        frames = [
            sky_mask(frame, horizon_row=horizon_row, vanishing_column=vanishing_column, returns=mark)
            for frame, mark in zip(rgb, marks, strict=True)
        ]
        return torch.stack(frames) if frames else rgb.new_zeros((0, 1, *rgb.shape[-2:]), dtype=torch.float32)
    return find_sky(rgb, horizon_row=horizon_row, vanishing_column=vanishing_column, returns=returns).share


def find_sky(
    rgb: Tensor,
    *,
    horizon_row: float | None = None,
    vanishing_column: float | None = None,
    returns: Tensor | None = None,
) -> Sky:
    """Sky of one photograph ``(3, H, W)`` and how sure it is; the arguments are those of `sky_mask`.

    Example:
        >>> find_sky(torch.full((3, 60, 80), 0.2)).found
        False
    """
    check_arguments(
        "find_sky(rgb: real, horizon_row: float | None, vanishing_column: float | None, returns: Tensor | None)",
        rgb,
        horizon_row,
        vanishing_column,
        returns,
    )
    check_sky_arguments(rgb, horizon_row, vanishing_column, returns)
    height, width = rgb.shape[-2:]
    light = rgb.detach().cpu()
    light = light.to(torch.float32) if light.is_floating_point() else light.to(torch.float32) / 255
    guessed = horizon_row is None
    row = (height - 1) / 2 if horizon_row is None else float(horizon_row)
    column = (width - 1) / 2 if vanishing_column is None else float(vanishing_column)
    marks = None if returns is None else returns.detach().cpu()

    times = max(1, min(round(width / FULL_WIDTH), height))
    if times > 1:
        light = avg_pool2d(light[None], times, ceil_mode=True)[0]
        marks = None if marks is None else max_pool2d(marks[None].float(), times, ceil_mode=True)[0] > 0
        row, column = (row + 0.5) / times - 0.5, (column + 0.5) / times - 0.5
    share, blue = share_and_colour(light, row, column, marks, guessed)
    if times > 1:
        grown = interpolate(share[None], scale_factor=times, mode="bilinear", align_corners=False)[0]
        share = grown[:, :height, :width].contiguous()
    if not guessed:
        share[:, max(0, math.floor(float(horizon_row or 0.0)) + 1) :] = 0
    return Sky(share.to(rgb.device), bool(share.any()), blue)


def share_and_colour(
    rgb: Tensor, horizon_row: float, vanishing_column: float, returns: Tensor | None, guessed: bool
) -> tuple[Tensor, bool]:
    """Share of sky ``(1, H, W)`` of a float picture, and whether the sky is blue."""
    height, width = rgb.shape[-2:]
    slack = GUESS_SLACK * height if guessed else 0.0
    share = torch.zeros(1, height, width)
    cells = cells_of(rgb, horizon_row, slack, vanishing_column, returns)
    rows = len(cells.change)
    if guessed and fills_the_frame(cells):
        cells = replace(cells, horizon_row=float(2 * rows), end_row=rows)
    if not cells.end_row:
        return share, False
    seeds = sky_seeds(cells)
    if not seeds.sky.any():
        return share, False
    model, spread = colour_model(cells, seeds.sky)
    sky = to_the_top(grow(cells, seeds.sky, seeds.walls, model, spread))

    kept = min(rows, cells.end_row + MARGIN)
    pixels = round(kept * height / rows)
    upper = replace(cells, colour=cells.colour[:kept], change=cells.change[:kept], returns=None)
    share[:, :pixels] = sky_share(rgb[:, :pixels], upper, sky[:kept], model[:kept], spread)
    if not seeds.blue:
        share[:, :pixels] *= enlarged(fade_into_mist(cells)[:kept], pixels, width)
    if cells.end_row < rows:
        share *= fade_to_horizon(sky, cells, height, width)
    return share, seeds.blue


def to_the_top(sky: Mask) -> Mask:
    """The sky with the dark rows above it that undistortion leaves at a picture's top."""
    edge = 1 + round(0.01 * len(sky))
    return np.asarray(sky | (sky[edge][None] & (np.arange(len(sky)) < edge)[:, None])) if edge < len(sky) else sky


def fade_into_mist(cells: Cells) -> Floats:
    """Factor ``(h, w)`` that lets a grey sky fade where hills in mist darken it; 1 where it is bright."""
    from scipy.ndimage import grey_dilation

    brightest = cells.colour.max(-1)
    glare = max(float(np.quantile(brightest[: max(1, cells.end_row)], 0.98)), 1e-3)
    # The brightest cell around: trees in front of a bright sky are no mist.
    around = grey_dilation(brightest, size=3) / glare
    factor: Floats = np.clip((around - MIST[0]) / (MIST[1] - MIST[0]), 0.0, 1.0).astype(np.float32)
    return factor


def fade_to_horizon(sky: Mask, cells: Cells, height: int, width: int) -> Tensor:
    """Factor ``(1, H, W)`` that lets the sky fade where it reaches the last row that may hold sky; 1 elsewhere."""
    from scipy.ndimage import uniform_filter1d

    last = cells.end_row * height / len(sky)
    rows = torch.arange(height, dtype=torch.float32)
    fading = ((last - 1 - rows) / max(1.0, FADE * height)).clamp(0, 1)[:, None]
    reaching = uniform_filter1d(sky[cells.end_row - 1].astype(np.float32), 9)
    open_end = interpolate(torch.from_numpy(reaching)[None, None], width, mode="linear", align_corners=False)[0]
    inside = (rows < math.floor(last))[:, None]
    return (1 - open_end * (1 - fading))[None] * inside


def check_sky_arguments(
    rgb: Tensor, horizon_row: float | None, vanishing_column: float | None, returns: Tensor | None
) -> None:
    """Raise unless a photograph, its vanishing point and its LiDAR returns are as `sky_mask` says."""
    if not isinstance(rgb, Tensor) or not (rgb.dtype == torch.uint8 or rgb.is_floating_point()):
        kind = rgb.dtype if isinstance(rgb, Tensor) else type(rgb).__name__
        raise InputTypeError(f"sky_mask.rgb: expected an sRGB tensor, uint8 or float in 0..1; got {kind}.")
    if rgb.ndim != 3 or rgb.shape[0] != 3 or not rgb.numel():
        raise InputValueError(
            f"sky_mask.rgb: expected (3, H, W) or (B, 3, H, W), H and W at least 1; got {tuple(rgb.shape)}. "
            "Demosaic a raw frame first; repeat a grey one three times."
        )
    if rgb.is_floating_point() and not bool(torch.isfinite(rgb).all() & (rgb.amin() >= 0) & (rgb.amax() <= 1)):
        raise InputValueError(
            "sky_mask.rgb: expected sRGB values in 0..1; divide by the greatest value that it can hold."
        )
    for name, value in (("horizon_row", horizon_row), ("vanishing_column", vanishing_column)):
        if value is not None and not math.isfinite(value):
            raise InputValueError(f"sky_mask.{name}: expected a finite number of pixels or None; got {value}.")
    if returns is not None and (returns.dtype != torch.bool or returns.shape != (1, *rgb.shape[-2:])):
        raise InputValueError(
            f"sky_mask.returns: expected a bool tensor (1, {rgb.shape[-2]}, {rgb.shape[-1]}), True where a return "
            f"fell; got {returns.dtype} {tuple(returns.shape)}."
        )
