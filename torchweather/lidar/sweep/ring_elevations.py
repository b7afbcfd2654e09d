"""Rings of a sweep whose rows are in any order: cones on which many points lie."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt

from torchweather.lidar.sweep.cone_fit import ConeFit, cone_residual_deg, fit_cones

__all__ = ["rings_from_elevations"]

Numbers = npt.NDArray[np.floating[Any]]
Integers = npt.NDArray[np.integer[Any]]

# Heights of the lasers over the origin that are tried: of Velodyne, Ouster and Hesai 0 to 0.21 m.
_HEIGHT_STEP_M = 0.01
_HEIGHTS_M = np.arange(-0.10, 0.301, _HEIGHT_STEP_M)
_BIN_DEG = 0.02
_EDGE_DEG = 90.0
# Points of a ring lie within this of its cone, and rings at least twice as far apart.
_NEAR_DEG = 0.06
_APART = round(_NEAR_DEG / _BIN_DEG)  # bins
# A ring has at least this share of the points of the median ring.
_SMALLEST = 0.05
_MOST_RINGS = 256
_SAMPLE_ROWS = 60_000
# At most this share of the points may lie off the cones.
_MOST_OFF = 0.1
_ROUNDS = 3
# Neighbouring rings are at least so many spreads apart, seen at this range.
_SPREADS_APART = 5.0
_FAR_M = 20.0


def rings_from_elevations(xyz: Numbers, rings: int | None = None) -> Integers | None:
    """Number the rings by their elevation, the lowest first.

    A Hough transform: every point votes for the elevation of its cone at each of 41 heights; the cone with the most
    votes is taken and its points are removed, again and again. Then every point goes to its nearest cone, and the
    cones are fitted to their points, three times.

    Args:
        xyz: ``(N, 3)`` returns, metres in the sensor's frame, any order.
        rings: their number; ``None`` takes cones as long as they have 5 percent of the points of the median one.

    Returns:
        int64 ``(N,)``, or ``None`` where more than a tenth of the points lies off all cones, or another number of
        cones than ``rings`` is found.

    Example:
        >>> rng = np.random.default_rng(0)
        >>> ring, angle, rho = rng.integers(0, 4, 4000), rng.uniform(0, 6.28, 4000), rng.uniform(3, 40, 4000)
        >>> z = 0.1 + rho * np.tan(np.radians(2.0 * ring - 5.0))
        >>> found = rings_from_elevations(np.stack([rho * np.cos(angle), rho * np.sin(angle), z], -1))
        >>> np.array_equal(found, ring)
        True
    """
    sample = xyz[:: max(1, len(xyz) // _SAMPLE_ROWS)].astype(np.float64)
    elevation, height = _voted_cones(sample, rings)
    if not len(elevation):
        return None
    for _ in range(_ROUNDS):
        order = np.argsort(elevation)
        elevation, height = elevation[order], height[order]
        ring = _nearest(xyz, elevation, height)
        count = np.bincount(ring, minlength=len(elevation))
        kept = count >= max(1.0, _SMALLEST * float(np.median(count)))
        if not kept.all():
            elevation, height = elevation[kept], height[kept]
            ring = _nearest(xyz, elevation, height)
        fit = fit_cones(xyz, ring, len(elevation))
        if np.isnan(fit.elevation_deg).any():
            return None
        kept = ~_parts(fit, _middle_ranges(xyz, ring, len(elevation)))
        elevation, height = fit.elevation_deg[kept], fit.height_m[kept]
    order = np.argsort(elevation)
    ring = _nearest(xyz, elevation[order], height[order])
    fit = fit_cones(xyz, ring, len(elevation))
    return ring if _stand_apart(xyz, ring, fit, rings) else None


def _stand_apart(xyz: Numbers, ring: Integers, fit: ConeFit, rings: int | None) -> bool:
    """Check whether the cones explain the points and are no halves of one ring."""
    if rings is not None and len(fit.count) != rings:
        return False
    off = np.abs(cone_residual_deg(xyz, ring, fit)) > _NEAR_DEG
    if off.mean() > _MOST_OFF:
        return False
    middle = _middle_ranges(xyz, ring, len(fit.count))
    wider = np.maximum(fit.spread_deg[1:], fit.spread_deg[:-1])
    return all(
        bool((np.diff(_seen(fit, at))[:, 0] > _SPREADS_APART * wider).all()) for at in (_FAR_M, middle[1:], middle[:-1])
    )


def _seen(fit: ConeFit, flat_m: Numbers | float) -> Numbers:
    """Elevation of pairs of neighbouring cones, ``(K - 1, 2)``, at a distance."""
    pairs = np.stack([np.arange(len(fit.count) - 1), np.arange(1, len(fit.count))], -1)  # (K - 1, 2)
    way = np.asarray(flat_m)[..., None] if np.ndim(flat_m) else flat_m
    rise: Numbers = np.tan(np.radians(fit.elevation_deg))[pairs] + fit.height_m[pairs] / way
    return np.degrees(np.arctan(rise))


def _parts(fit: ConeFit, middle_m: Numbers) -> npt.NDArray[np.bool_]:
    """Cones that are a part of a neighbour: the same at the range at which the smaller one's points lie."""
    part = np.zeros(len(fit.count), dtype=bool)
    smaller = np.arange(len(part) - 1) + (fit.count[1:] < fit.count[:-1])
    part[smaller[np.abs(np.diff(_seen(fit, middle_m[smaller])))[:, 0] < _NEAR_DEG]] = True
    return part


def _middle_ranges(xyz: Numbers, ring: Integers, rings: int) -> Numbers:
    """Median horizontal range of each ring's points, metres."""
    flat = np.hypot(xyz[:, 0], xyz[:, 1])
    order = np.lexsort((flat, ring))
    count = np.bincount(ring, minlength=rings)
    middle: Numbers = flat[order][np.cumsum(count) - count + count // 2]
    return middle


def _voted_cones(xyz: Numbers, rings: int | None) -> tuple[Numbers, Numbers]:
    flat = np.hypot(xyz[:, 0], xyz[:, 1])
    near_way, slope = 1.0 / flat, xyz[:, 2] / flat
    size = round(2.0 * _EDGE_DEG / _BIN_DEG) + 1
    # Elevation of the cone through each point, for each height: (heights, N).
    elevation = np.degrees(np.arctan2(xyz[:, 2] - _HEIGHTS_M[:, None], flat))
    place = np.rint((elevation + _EDGE_DEG) / _BIN_DEG).astype(np.int32)
    votes = np.stack([np.bincount(row, minlength=size) for row in place]).astype(np.int64)
    alive = np.ones(len(xyz), dtype=bool)
    cones: list[tuple[float, float]] = []
    numbers: list[int] = []
    limit = _MOST_RINGS if rings is None else rings
    blocked = np.zeros(votes.shape, dtype=bool)
    while len(cones) < limit:
        near = votes.copy()
        near[:, 1:] += votes[:, :-1]
        near[:, :-1] += votes[:, 1:]
        near[blocked] = 0
        best = int(near.argmax())
        row, column = divmod(best, size)
        number = int(near[row, column])
        if number < max(3.0, _SMALLEST * (np.median(numbers) if numbers else 0.0)):
            break
        middle = column * _BIN_DEG - _EDGE_DEG
        member = np.flatnonzero(alive & (np.abs(elevation[row] - middle) <= _NEAR_DEG))
        tangent, tip = math.tan(math.radians(middle)), float(_HEIGHTS_M[row])
        for _ in range(_ROUNDS):  # the true height lies between those tried
            tangent, tip = _line(near_way[member], slope[member], tangent, tip)
            seen = np.degrees(np.arctan2(xyz[:, 2] - tip, flat))
            member = np.flatnonzero(alive & (np.abs(seen - math.degrees(math.atan(tangent))) <= _NEAR_DEG))
            if not len(member):
                break
        blocked[row, max(0, column - _APART) : column + _APART + 1] = True
        if len(member) < max(3.0, _SMALLEST * (np.median(numbers) if numbers else 0.0)):
            continue
        cones.append((math.degrees(math.atan(tangent)), tip))
        numbers.append(len(member))
        alive[member] = False
        for height, part in enumerate(place[:, member]):
            votes[height] -= np.bincount(part, minlength=size)
    found = np.array(cones).reshape(-1, 2)
    return found[:, 0], found[:, 1]


def _line(near: Numbers, slope: Numbers, tangent: float, tip: float) -> tuple[float, float]:
    """``z / rho = tan e + h / rho`` through some points by least squares; the start where their ranges are alike."""
    middle = near.mean()
    variance = float(np.square(near - middle).mean())
    if variance < 1e-4 * middle * middle:
        return float((slope - tip * near).mean()), tip
    height = float(((near - middle) * slope).mean()) / variance
    if abs(height - tip) > 2.0 * _HEIGHT_STEP_M:
        return tangent, tip
    return float(slope.mean()) - height * middle, height


def _nearest(xyz: Numbers, elevation_deg: Numbers, height_m: Numbers) -> Integers:
    """The cone that each point lies nearest to, of cones with rising elevation."""
    flat = np.hypot(xyz[:, 0], xyz[:, 1])
    best = np.full(len(xyz), np.inf)
    ring = np.zeros(len(xyz), dtype=np.int64)
    # Neighbours in elevation at the middle height hold the nearest cone unless the heights differ a lot.
    for height in np.unique(np.round(height_m, 2)):
        members = np.flatnonzero(np.round(height_m, 2) == height)
        seen = np.degrees(np.arctan2(xyz[:, 2] - height, flat))
        middles = 0.5 * (elevation_deg[members][1:] + elevation_deg[members][:-1])
        chosen = members[np.searchsorted(middles, seen)]
        off = np.abs(np.degrees(np.arctan2(xyz[:, 2] - height_m[chosen], flat)) - elevation_deg[chosen])
        nearer = off < best
        ring[nearer], best[nearer] = chosen[nearer], off[nearer]
    return ring
