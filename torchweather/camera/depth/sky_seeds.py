"""Surely sky: smooth, sky-coloured regions that hang from the picture's top and end above the horizon."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from torchweather.camera.depth.sky_cells import Cells, Mask

__all__ = ["Seeds", "fills_the_frame", "sky_coloured", "sky_seeds"]

Labels = NDArray[np.int32]

# Constants of this file: PHOTOGRAPHS.md, section sky mask, or chosen on the frames that `sky` names.
SMOOTH_CHANGE = 0.025  # sRGB a pixel
LOOSE_CHANGE = 0.06  # sRGB a pixel: a wall goes on below its smooth part, past plaster and shade
OPENING = 2  # cells; thinner necks join sky to walls
TOP_SHARE = 0.01  # of the rows: dark rows that undistortion leaves at the top
LARGEST_BELOW = 0.1  # of a region's area below the horizon
FOG_WIDTH = 0.5  # of the picture's width, at the horizon
LARGEST_RETURNS = 0.2  # of a region's area on LiDAR returns
NEAREST_SLACK = 0.03  # of the width
HIGH_END = 0.38  # of the way from the top to the horizon
POLE = (13, 9)  # cells: at least this tall, less than this wide


@dataclass(frozen=True)
class Region:
    """A smooth region: its labels, whether it is blue, where the wall or sky that it is part of ends, its light."""

    label: int
    behind_poles: int
    blue: bool
    end_row: int
    distance: float
    light: float


@dataclass(frozen=True)
class Seeds:
    """Cells ``(h, w)`` that are surely sky, cells that are surely walls, and whether any of the sky is blue."""

    sky: Mask
    walls: Mask
    blue: bool


def light_of_ground(cells: Cells) -> float:
    """Median light below the horizon, 0..1; 0 where nothing is below it."""
    ground = cells.light[cells.end_row :]
    return float(np.median(ground)) if ground.size else 0.0


def sky_coloured(cells: Cells, ground_light: float) -> tuple[Mask, Mask]:
    """Cells of the colour of blue sky, and cells of the colour of white or grey sky, ``(h, w)`` each.

    Sky is never warm, and neither dim nor darker than the ground: 0.35 leaves out shaded walls and nights.
    """
    red, green, blue = np.moveaxis(cells.colour, -1, 0)
    light = cells.light
    cold = (red - blue < 0.02) & (green - blue < 0.03)
    is_blue = cold & (blue - red > 0.12) & (blue > 0.35) & (green > red - 0.02) & (light > 0.8 * ground_light)
    return is_blue, cold & ~is_blue & (light > max(0.35, 1.15 * ground_light))


def behind_poles(smooth: Mask, unit: float) -> Mask:
    """Cells of upright poles between smooth cells: gaps few columns wide and many rows tall, ``(h, w)``.

    A slanting gap, such as the eaves between sky and facade, is not tall in any column.
    """
    from scipy.ndimage import binary_closing, binary_opening

    tall, wide = round(POLE[0] * unit), round(POLE[1] * unit)
    if wide < 3:
        return np.zeros_like(smooth)
    closed = binary_closing(np.pad(smooth, ((0, 0), (wide, wide))), np.ones((1, wide), bool))[:, wide:-wide]
    return np.asarray(binary_opening(closed & ~smooth, np.ones((tall, 1), bool)))


def opened(smooth: Mask, unit: float) -> Mask:
    """The mask without necks thinner than twice `OPENING`; the picture's edge does not count as one."""
    from scipy.ndimage import binary_opening

    radius = round(OPENING * unit)
    if not radius:
        return smooth
    disk = np.hypot(*np.mgrid[-radius : radius + 1, -radius : radius + 1]) < radius + 0.5
    return np.asarray(binary_opening(np.pad(smooth, radius, mode="edge"), disk)[radius:-radius, radius:-radius])


def reaches_the_ground(region: Mask, end_row: int, width: int) -> bool:
    """Check whether a region goes on below the horizon as a wall does; fog does so over most of the picture's width."""
    if end_row <= 0:
        return True
    below = int(region[end_row:].sum())
    return bool(below > LARGEST_BELOW * region.sum() and region[end_row - 1].sum() < FOG_WIDTH * width)


def hanging_regions(cells: Cells, is_blue: Mask, is_white: Mask) -> tuple[Labels, list[Region], Mask]:
    """Smooth regions that touch the top, do not reach the ground and carry no LiDAR returns.

    Returns:
        The labels ``(h, w)`` of all smooth regions, those that hang from the top, and the cells of walls.
    """
    from scipy.ndimage import find_objects, label

    height, width = cells.change.shape
    coloured = is_blue | is_white
    smooth = opened((cells.change < SMOOTH_CHANGE * cells.steepness) & coloured, cells.unit)
    labels, _ = label(smooth)
    groups, _ = label(smooth | behind_poles(smooth, cells.unit))
    loose, _ = label(((cells.change < LOOSE_CHANGE * cells.steepness) & coloured) | smooth)
    loose_windows = find_objects(loose)
    regions, walls = [], []
    for number, window in enumerate(find_objects(labels), start=1):
        inside = labels[window] == number
        area = int(inside.sum())
        on_returns = 0 if cells.returns is None else int((cells.returns[window] & inside).sum())
        if on_returns > LARGEST_RETURNS * area or reaches_the_ground(inside, cells.end_row - window[0].start, width):
            walls.append(number)
            continue
        if window[0].start > 1 + round(TOP_SHARE * height):
            continue
        rows, columns = np.nonzero(inside)
        rows, columns = rows + window[0].start, columns + window[1].start
        away = np.hypot(rows - cells.horizon_row, columns - cells.vanishing_column)
        regions.append(
            Region(
                label=number,
                behind_poles=int(groups[rows[0], columns[0]]),
                blue=bool((is_blue[window] & inside).sum() > 0.5 * area),
                end_row=loose_windows[loose[rows[0], columns[0]] - 1][0].stop,
                distance=float(away.min()),
                light=float(cells.colour[rows, columns].mean(0).max()),
            )
        )
    return labels, regions, np.isin(labels, walls)


def sky_seeds(cells: Cells) -> Seeds:
    """Cells that are surely sky.

    White has no colour to tell a sky from a wall. So of white regions remain the one nearest to the vanishing point
    and those not much further, where a street opens to the sky, and those that end high above the horizon.
    """
    is_blue, is_white = sky_coloured(cells, light_of_ground(cells))
    labels, regions, walls = hanging_regions(cells, is_blue, is_white)
    # Sky is the brightest thing of an overcast day, and on a clear day no sky is much darker than the other sky.
    glare = float(np.quantile(cells.colour[: max(1, cells.end_row)].max(-1), 0.98))
    brightest = max((region.light for region in regions), default=0.0)
    regions = [
        region for region in regions if region.light > 0.7 * brightest and (region.blue or region.light > 0.7 * glare)
    ]
    nearest = min((region.distance for region in regions), default=0.0) + NEAREST_SLACK * labels.shape[1]
    open_sky = [
        region
        for region in regions
        if region.blue or region.distance <= nearest or region.end_row < HIGH_END * cells.horizon_row
    ]
    beside_poles = {region.behind_poles for region in open_sky}
    regions = [region for region in regions if region.behind_poles in beside_poles]
    seeds = np.isin(labels, [region.label for region in regions])
    seeds[cells.end_row :] = False
    return Seeds(seeds, walls, any(region.blue for region in regions))


def fills_the_frame(cells: Cells) -> bool:
    """Check whether a smooth sky-coloured region reaches from the top to nearly all of the bottom (no horizon)."""
    from scipy.ndimage import label

    is_blue, is_white = sky_coloured(cells, 0.0)
    labels, _ = label((cells.change < SMOOTH_CHANGE * cells.steepness) & (is_blue | is_white))
    bottom, top = labels[-1], labels[0]
    if not (top.any() and bottom.any()):
        return False
    number = np.bincount(bottom[bottom > 0]).argmax()
    same = bool((top == number).any()) and float((bottom == number).mean()) > 0.95
    contrast = float(np.abs(cells.colour[-1].mean(0) - cells.colour[0].mean(0)).max())
    return same and bool(is_blue[labels == number].mean() > 0.5 or contrast < 0.2)
