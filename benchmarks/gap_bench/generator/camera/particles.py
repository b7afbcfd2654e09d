"""Drops and flakes in front of the camera: drawn from the size distribution, each with the streak of its exposure.

A particle of diameter D at depth z covers a disk of ``f D / z`` px that moves ``f v t / z`` px while the shutter is
open; off the axis, seen along a ray that is longer than its depth, the disk is larger by as much in its area. Wide
streaks are drawn one by one from the convolution of disk and path, narrow ones as boxes. Where a class of size and
depth has very many, their numbers are drawn pixel by pixel. What peaks below a share of the exposure is a smooth veil
of the mean optical depth.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import torch
from scipy import ndimage

from torchweather.atmosphere.weather import Rain, Snow
from torchweather.physics import physical_diameter_mm, rain_fall_speed_m_per_s, snow_fall_speed_m_per_s

from .scene import FloatArray, Street

__all__ = ["EXPOSURE_S", "Population", "Streaks", "optical_depth", "population"]

EXPOSURE_S = 5e-3
NEAR_M, FAR_M = 0.5, 200.0
FAINTEST = 8e-4  # peak share of the exposure below which a particle is part of the veil
SIZES, DEPTHS = 48, 40
WIDE_PX = 2.5  # from which a streak is drawn by itself
MOST_COVER = 0.999
LISTED = 400.0  # particles of a class of size and depth, beyond which they are counted pixel by pixel
BOX_OF_DISK = np.sqrt(0.75)  # width of the box with the variance of a unit disk's profile
DENSE = 0.1  # share of the exposure from which what a particle covers does not simply add up
GROUPED = 12  # sizes whose counts are drawn together


@dataclass(frozen=True)
class Population:
    """Particles of a weather by size.

    Args:
        diameter_mm: ``(S,)`` physical.
        number_per_m3: ``(S,)`` in each class.
        speed_m_per_s: ``(S,)`` of fall.
    """

    diameter_mm: FloatArray
    number_per_m3: FloatArray
    speed_m_per_s: FloatArray


@lru_cache(maxsize=256)
def population(kind: str, rate_mm_per_h: float) -> Population:
    """Classes of the drops, or of the flakes, of a rate."""
    law = (Rain if kind == "rain" else Snow)(rate_mm_per_h).distribution()
    low, high = (float(end) for end in (law.diameter_min_mm, law.diameter_max_mm))
    fine = np.geomspace(low, high, 16 * SIZES + 1)
    density = law.number_density_per_m3_mm(torch.from_numpy(np.sqrt(fine[1:] * fine[:-1]))).numpy()
    number = (density * np.diff(fine)).reshape(SIZES, 16).sum(1)
    middle = torch.from_numpy(np.sqrt(fine[16::16] * fine[:-16:16]))
    if kind == "rain":
        return Population(middle.numpy(), number, rain_fall_speed_m_per_s(middle).numpy())
    # Snow is counted by the diameter of the melted flake.
    return Population(physical_diameter_mm(middle).numpy(), number, snow_fall_speed_m_per_s(middle).numpy())


@dataclass(frozen=True)
class Crowd:
    """Many like particles of one layer of depth, counted pixel by pixel.

    Args:
        per_px: mean number in a pixel.
        area_px: that each covers.
        down_px: path of the exposure.
        near_m, far_m: ends of their layer along the axis.
    """

    per_px: float
    area_px: float
    down_px: float
    near_m: float
    far_m: float


@dataclass
class Streaks:
    """Particles in a frame, and what effects make of them.

    Args:
        column_px, row_px: ``(P,)`` middle of the path.
        depth_m: along the axis.
        width_px: of the disk.
        aside_px, down_px: path of the exposure.
        peak: share of the exposure that the middle is covered, over that of the disk at rest.
        slant: sideways over downward path of the crowds.
        crowds: what is too many to be listed.
        veil_per_m: ``(DEPTHS,)`` optical depth of those too faint, by layers, and
        veil_edges_m: ``(DEPTHS + 1,)`` their ends.
    """

    column_px: FloatArray
    row_px: FloatArray
    depth_m: FloatArray
    width_px: FloatArray
    aside_px: FloatArray
    down_px: FloatArray
    peak: FloatArray
    crowds: list[Crowd]
    slant: float
    veil_per_m: FloatArray
    veil_edges_m: FloatArray


def draw(
    street: Street, kind: str, rate_mm_per_h: float, count: float, reach_m: float, rng: np.random.Generator
) -> Streaks:
    """A list of particles.

    Args:
        street: with the camera.
        kind: ``rain`` or ``snow``.
        rate_mm_per_h: of the weather.
        count: particles over those of the rate.
        reach_m: depth beyond which there are none.
        rng: of number, size and place.
    """
    eye, found = street.eye, population(kind, rate_mm_per_h)
    focal = eye.focal_px
    edges = np.geomspace(NEAR_M, FAR_M, DEPTHS + 1)
    middle = np.sqrt(edges[1:] * edges[:-1])
    width = 1e-3 * found.diameter_mm[:, None] * focal / middle
    path = found.speed_m_per_s[:, None] * EXPOSURE_S * focal / middle
    cover = 0.25 * np.pi * width**2 / (np.maximum(width, 1.0) * np.maximum(path + width, 1.0))
    seen = np.minimum(cover, 1.0) >= FAINTEST
    layer_m = np.diff(np.minimum(edges, max(reach_m, NEAR_M)))
    number_per_m = count * found.number_per_m3[:, None] * (layer_m > 0)
    veil = (number_per_m * 0.25e-6 * np.pi * found.diameter_mm[:, None] ** 2 * ~seen).sum(0) * layer_m / np.diff(edges)
    many = seen & (number_per_m * layer_m * eye.width * eye.height * (middle / focal) ** 2 > LISTED) & (cover < DENSE)
    crowds = _crowds(number_per_m * layer_m * (middle / focal) ** 2 * many, width, path, edges)
    seen = seen & ~many
    margin = 2.0 + 0.6 * path + width  # px beyond the frame from where a streak may reach in
    volume = np.diff(np.minimum(edges, max(reach_m, NEAR_M)) ** 3) / (3.0 * focal**2)  # m^3 behind a pixel, by layers
    mean = count * found.number_per_m3[:, None] * volume * (eye.width + 2 * margin) * (eye.height + 2 * margin) * seen
    drawn = rng.poisson(mean)
    size, layer = (np.repeat(index.ravel(), drawn.ravel()) for index in np.indices(drawn.shape))
    # Inside a layer the volume grows as the square of the depth.
    low, high = edges[layer], np.minimum(edges[layer + 1], reach_m)
    depth = np.cbrt(rng.uniform(low**3, np.maximum(high, low * 1.0001) ** 3))
    side = margin[size, layer]
    column = rng.uniform(-side, eye.width + side)
    row = rng.uniform(-side, eye.height + side)
    diameter = 1e-3 * found.diameter_mm[size]
    down = found.speed_m_per_s[size] * EXPOSURE_S * focal / depth
    x, y = (column - 0.5 * (eye.width - 1)) / focal, (row - 0.5 * (eye.height - 1)) / focal
    width_px = diameter * focal / depth * (1.0 + x**2 + y**2) ** 0.25
    return Streaks(
        column, row, depth, width_px, np.zeros_like(down), down, np.ones_like(down), crowds, 0.0, veil, edges
    )


def _crowds(per_px: FloatArray, width: FloatArray, path: FloatArray, edges_m: FloatArray) -> list[Crowd]:
    """Classes of neighbouring sizes in one layer as one, of the mean and the variance of their optical depth."""
    found = []
    area = 0.25 * np.pi * width**2
    for layer, (near, far) in enumerate(itertools.pairwise(edges_m.tolist())):
        for first in range(0, SIZES, GROUPED):
            some = slice(first, first + GROUPED)
            mean = float((per_px[some, layer] * area[some, layer]).sum())
            square = float((per_px[some, layer] * area[some, layer] ** 2).sum())
            if mean > 0:
                down = float((per_px[some, layer] * area[some, layer] * path[some, layer]).sum()) / mean
                found.append(Crowd(mean**2 / square, square / mean, down, near, far))
    return found


def optical_depth(street: Street, streaks: Streaks, rng: np.random.Generator) -> FloatArray:
    """Optical depth ``(H, W)`` of all particles in front of the scene: each covers its pixels for its share of time."""
    eye = street.eye
    depth = np.minimum(street.depth_m, FAR_M)
    upto = np.concatenate([[0.0], np.cumsum(streaks.veil_per_m * np.diff(streaks.veil_edges_m))])
    total = np.interp(depth, streaks.veil_edges_m, upto) * street.ray_per_depth
    for crowd in streaks.crowds:
        before = np.clip((depth - crowd.near_m) / (crowd.far_m - crowd.near_m), 0.0, 1.0)  # share of the layer
        total += _counted(crowd, street, streaks.slant, rng) * street.ray_per_depth * before
    narrow = np.maximum(streaks.width_px, 0.0) < WIDE_PX
    _splat(total, street.depth_m, streaks, narrow)
    inside = (np.abs(streaks.column_px - 0.5 * eye.width) < 0.5 * eye.width + streaks.width_px + 64) & (
        np.abs(streaks.row_px - 0.5 * eye.height) < 0.5 * (eye.height + streaks.down_px) + streaks.width_px + 4
    )
    for place in np.flatnonzero(~narrow & inside):
        _one(total, street.depth_m, streaks, int(place))
    return total


def _counted(crowd: Crowd, street: Street, slant: float, rng: np.random.Generator) -> FloatArray:
    """Optical depth of many like particles: their numbers in each pixel, moved along the path of the exposure.

    Where in a pixel the path begins is drawn once for all of them.
    """
    shape = street.depth_m.shape
    side = BOX_OF_DISK * np.sqrt(crowd.area_px * 4.0 / np.pi)
    aside, along = _shares(side, rng.random()), _shares(crowd.down_px + side, rng.random())
    # Of a pixel that a share m is covered of, the optical depth is -ln(1 - m) = m + m^2 / 2 + ...
    depth_px = crowd.area_px * (1.0 + 0.5 * crowd.area_px * (aside**2).sum() * (along**2).sum())
    counts = rng.poisson(crowd.per_px, shape) * depth_px
    counts = ndimage.correlate1d(counts, aside, axis=1, mode="wrap")
    if slant == 0.0:
        return np.asarray(ndimage.correlate1d(counts, along, axis=0, mode="wrap"))
    found = np.zeros(shape)
    for step, share in enumerate(along):
        shift = slant * float(_middle(np.asarray(step - 0.5 * (len(along) - 1)), crowd.down_px, side))
        whole = int(np.floor(shift))
        for aside_px, part in ((whole, whole + 1 - shift), (whole + 1, shift - whole)):
            found += share * part * np.roll(counts, (step - len(along) // 2, aside_px), (0, 1))
    return found


def _shares(length_px: float, start: float) -> FloatArray:
    """Shares of a piece of a line in the pixels that it crosses, from a place in the first one; an odd number."""
    pixels = int(np.ceil(start + length_px))
    pixels += 1 - pixels % 2
    ends = np.clip(np.arange(pixels + 1), start, start + length_px)
    return np.asarray(np.diff(ends) / length_px)


def _splat(total: FloatArray, depth_m: FloatArray, streaks: Streaks, which: np.ndarray) -> None:
    """Narrow streaks as boxes: their shares of the rows that they cross times those of the columns in each row."""
    height, width = total.shape
    side = BOX_OF_DISK * streaks.width_px[which]
    down, v, u = streaks.down_px[which], streaks.row_px[which], streaks.column_px[which]
    slope = streaks.aside_px[which] / np.maximum(down, 1e-6)
    length = down + side
    top = np.floor(v - 0.5 * length + 0.5).astype(int)
    rows = np.floor(v + 0.5 * length + 0.5).astype(int) - top + 1
    owner = np.repeat(np.arange(len(rows)), rows)
    row = top[owner] + np.arange(len(owner)) - np.concatenate([[0], np.cumsum(rows)[:-1]])[owner]
    middle, flat, ramp = v[owner], 0.5 * np.abs(down - side)[owner], np.minimum(down, side)[owner]
    share = _below(row + 0.5 - middle, flat, ramp) - _below(row - 0.5 - middle, flat, ramp)
    area = (0.25 * np.pi * streaks.width_px[which] ** 2 * streaks.peak[which])[owner]
    # While a row is covered the disk moves aside: a box that a box is smeared over.
    moves = np.abs(slope[owner]) * np.minimum(down[owner], np.hypot(1.0, side[owner]))
    z, across = streaks.depth_m[which][owner], side[owner] + moves
    level, rise = 0.5 * np.abs(side[owner] - moves), np.minimum(side[owner], moves)
    column = u[owner] + _middle(row - v[owner], down[owner], side[owner]) * slope[owner]
    left = np.floor(column - 0.5 * across + 0.5).astype(int)
    for aside in range(int(np.ceil(BOX_OF_DISK * WIDE_PX)) + 4):
        c = left + aside
        ok = (np.abs(c - column) < 0.5 * across + 0.5) & (row >= 0) & (row < height) & (c >= 0) & (c < width)
        r, c = row[ok], c[ok]
        apart = c - column[ok]
        upto, before = (_below(apart + end, level[ok], rise[ok]) for end in (0.5, -0.5))
        cover = np.minimum(area[ok] * share[ok] * (upto - before), MOST_COVER)
        weight = np.where(z[ok] < depth_m[r, c], -np.log1p(-cover), 0.0)
        total += np.bincount(r * width + c, weight, height * width).reshape(height, width)


def _middle(row: FloatArray, down: FloatArray | float, side: FloatArray | float) -> FloatArray:
    """Where on its path, from -down / 2 to down / 2, a disk is in the mean while it covers part of a row."""
    reach = 0.5 * np.hypot(1.0, side)
    half = 0.5 * np.asarray(down)
    return np.asarray(0.5 * (np.clip(row - reach, -half, half) + np.clip(row + reach, -half, half)))


def _below(place: FloatArray, flat: FloatArray, ramp: FloatArray) -> FloatArray:
    """Share of a trapezoid, flat to either side of 0 and falling over a ramp, that lies below a place."""
    ramp = np.maximum(ramp, 1e-6)
    whole = 2.0 * flat + ramp
    far = np.clip(np.abs(place) - flat, 0.0, ramp)
    part = np.minimum(np.abs(place), flat) + far - 0.5 * far**2 / ramp
    return np.asarray(0.5 + np.sign(place) * part / whole)


def _one(total: FloatArray, depth_m: FloatArray, streaks: Streaks, place: int) -> None:
    """A wide streak: the time that a moving disk covers each pixel, by points inside of the pixels' rows."""
    height, width = total.shape
    u, v, b = streaks.column_px[place], streaks.row_px[place], streaks.width_px[place]
    du, dv = streaks.aside_px[place], streaks.down_px[place]
    left, right = int(np.floor(u - 0.5 * (b + abs(du)))), int(np.ceil(u + 0.5 * (b + abs(du))))
    top, bottom = int(np.floor(v - 0.5 * (b + abs(dv)))), int(np.ceil(v + 0.5 * (b + abs(dv))))
    rows, columns = (
        np.arange(max(top, 0), min(bottom, height - 1) + 1),
        np.arange(max(left, 0), min(right, width - 1) + 1),
    )
    if not len(rows) or not len(columns):
        return
    length = max(np.hypot(du, dv), 0.05)
    du, dv = (du, dv) if np.hypot(du, dv) >= 0.05 else (0.0, 0.05)
    cover = np.zeros((len(rows), len(columns)))
    for sub_y in (-1 / 3, 0.0, 1 / 3):
        for sub_x in (-1 / 3, 0.0, 1 / 3):
            y, x = rows[:, None] - v + sub_y, columns[None] - u + sub_x
            along, across = (x * du + y * dv) / length, (x * dv - y * du) / length
            half = 0.5 * np.sqrt(np.maximum(b**2 - 4.0 * across**2, 0.0))
            # The disk's chord passes a place for the part of the path in which it lies over it.
            part = np.minimum(along + half, 0.5 * length) - np.maximum(along - half, -0.5 * length)
            cover += np.where(half > 0, np.maximum(part, 0.0), 0.0) / length / 9.0
    cover = np.minimum(cover * streaks.peak[place], MOST_COVER)
    window = (slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1))
    total[window] += np.where(streaks.depth_m[place] < depth_m[window], -np.log1p(-cover), 0.0)
