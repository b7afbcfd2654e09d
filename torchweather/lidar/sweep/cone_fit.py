"""Cones of a LiDAR's lasers: the elevation and the height at which the beams of each ring start, fitted to its points.

The laser of ring k at height h_k and elevation e_k draws a cone, ``z = h_k + rho tan e_k`` with
``rho = sqrt(x^2 + y^2)``. Points at several ranges tell the two apart.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

__all__ = ["ConeFit", "cone_residual_deg", "fit_cones"]

Numbers = npt.NDArray[np.floating[Any]]
Integers = npt.NDArray[np.integer[Any]]

# Reweighted least squares: a residual above this many spreads loses weight with its square.
_OUTLIER_SPREADS = 3.0
_ROUNDS = 5
_MAD_TO_STD = 1.4826
# The receiver's own noise bounds the spread from below (float32, rounding), radians.
_LEAST_SPREAD_RAD = 1e-6
# The standard errors come from leaving out one of these many sectors: residuals of neighbours are not independent.
_SECTORS = 12
# A height less sure than this is taken from the other rings, metres.
_UNSURE_HEIGHT_M = 0.05
# The lasers of a sensor sit within this of each other.
_MOST_APART_M = 0.5
_FEWEST_POINTS = 8


@dataclass(frozen=True)
class ConeFit:
    """Cones of the rings; NaN for a ring without points.

    Args:
        elevation_deg: ``(K,)``.
        height_m: ``(K,)`` height of the cone's tip over the origin.
        spread_deg: ``(K,)`` standard deviation of the points about their cone (from the median deviation).
        elevation_error_deg: ``(K,)`` standard error (jackknife over sectors).
        height_error_m: ``(K,)`` standard error; infinite where the points cannot tell the height.
        count: ``(K,)`` points.
    """

    elevation_deg: Numbers
    height_m: Numbers
    spread_deg: Numbers
    elevation_error_deg: Numbers
    height_error_m: Numbers
    count: Integers


def fit_cones(xyz: Numbers, ring: Integers, rings: int) -> ConeFit:
    """Fit a cone to the points of each ring.

    ``z / rho = tan e + h / rho`` by reweighted least squares: far points tell e, near ones h.
    Where the ranges of a ring are too alike to tell its height (standard error above 0.05 m), the height is the median
    of the rings that do, and 0 if there are none.

    Args:
        xyz: ``(N, 3)`` metres in the sensor's frame, no row on the vertical axis.
        ring: ``(N,)`` 0 to ``rings - 1``.
        rings: number of rings K.

    Returns:
        One cone a ring.

    Example:
        >>> rho = np.linspace(5.0, 50.0, 200)
        >>> angle = np.linspace(0.0, 6.28, 200)
        >>> cone = np.stack([rho * np.cos(angle), rho * np.sin(angle), 0.2 + rho * np.tan(np.radians(-3.0))], -1)
        >>> fit = fit_cones(cone, np.zeros(200, np.int64), 1)
        >>> fit.elevation_deg.round(3).tolist(), fit.height_m.round(3).tolist()
        ([-3.0], [0.2])
    """
    order = np.argsort(ring, kind="stable")
    xyz, ring = xyz[order].astype(np.float64), ring[order]
    count = np.bincount(ring, minlength=rings)
    ends: Integers = np.cumsum(count)
    flat = np.hypot(xyz[:, 0], xyz[:, 1])
    near, slope = 1.0 / flat, xyz[:, 2] / flat
    sector = ((np.arctan2(xyz[:, 1], xyz[:, 0]) + np.pi) * (_SECTORS / (2.0 * np.pi))).astype(np.intp) % _SECTORS
    cell = ring.astype(np.intp) * _SECTORS + sector
    weight = np.ones(len(ring))
    spread = np.full(rings, np.inf)
    for _ in range(_ROUNDS):
        sums = _sums(near, slope, weight, cell, rings)
        tangent, height = _solved(sums.sum(1))
        off = np.abs(slope - tangent[ring] - height[ring] * near)
        spread = _spreads(off, ends)
        weight = 1.0 / np.maximum(1.0, np.square(off / (_OUTLIER_SPREADS * spread[ring])))
    tangent_error, height_error = _jackknife(sums, count)
    unsure = (count > 0) & ~(height_error < _UNSURE_HEIGHT_M)
    if (count > 0).any() and not unsure[count > 0].all():
        # All points of a ring on a flat road lie on a cone of 0 degrees as well, which starts down there.
        usual = np.median(height[(count > 0) & ~unsure])
        unsure |= (count > 0) & (np.abs(height - usual) > _MOST_APART_M)
    if unsure.any():
        sure = (count > 0) & ~unsure
        height[unsure] = np.median(height[sure]) if sure.any() else 0.0
        w, wx, wy = sums.sum(1)[:, 0], sums.sum(1)[:, 1], sums.sum(1)[:, 3]
        tangent[unsure] = ((wy - height * wx) / np.maximum(w, 1e-300))[unsure]
        tangent_error[unsure] = np.maximum(spread / np.sqrt(np.maximum(count, 1)), 1e-9)[unsure]
        height_error[unsure] = np.inf
        off = np.abs(slope - tangent[ring] - height[ring] * near)
        spread = _spreads(off, ends)
    none = count == 0
    widen = np.degrees(1.0 / (1.0 + np.square(tangent)))  # d e = d tan e cos^2 e
    return ConeFit(
        elevation_deg=np.where(none, np.nan, np.degrees(np.arctan(tangent))),
        height_m=np.where(none, np.nan, height),
        spread_deg=np.where(none, np.nan, spread * widen),
        elevation_error_deg=np.where(none, np.nan, tangent_error * widen),
        height_error_m=np.where(none, np.nan, height_error),
        count=count,
    )


def cone_residual_deg(xyz: Numbers, ring: Integers, fit: ConeFit) -> Numbers:
    """Elevation of points above the cone of their ring, degrees, ``(N,)``: seen from the tip of the cone."""
    elevation = np.degrees(np.arctan2(xyz[:, 2] - fit.height_m[ring], np.hypot(xyz[:, 0], xyz[:, 1])))
    residual: Numbers = elevation - fit.elevation_deg[ring]
    return residual


def _sums(near: Numbers, slope: Numbers, weight: Numbers, cell: Integers, rings: int) -> Numbers:
    """Weighted sums of 1, u, u^2, t, t u of each ring and sector, ``(K, sectors, 5)``."""
    size = rings * _SECTORS
    parts = (weight, weight * near, weight * near * near, weight * slope, weight * slope * near)
    return np.stack([np.bincount(cell, part, size).astype(np.float64) for part in parts], -1).reshape(
        rings, _SECTORS, 5
    )


def _solved(sums: Numbers) -> tuple[Numbers, Numbers]:
    """Tangent of the elevation and height from the sums ``(..., 5)``; height 0 where the ranges are alike."""
    w, wx, wxx, wy, wxy = np.moveaxis(sums, -1, 0)
    w = np.maximum(w, 1e-300)
    variance = wxx - wx * wx / w
    alike = variance <= 1e-9 * wxx
    height = np.where(alike, 0.0, (wxy - wx * wy / w) / np.where(alike, 1.0, variance))
    return (wy - height * wx) / w, height


def _jackknife(sums: Numbers, count: Integers) -> tuple[Numbers, Numbers]:
    tangent, height = _solved(sums.sum(1, keepdims=True) - sums)  # (K, sectors)
    filled = (sums[..., 0] > 0).sum(1)
    factor = np.where(filled > 1, (filled - 1.0) / np.maximum(filled, 1), np.inf)
    factor = np.where(count >= _FEWEST_POINTS, factor, np.inf)
    errors = []
    for values in (tangent, height):
        squares = np.square(values - values.mean(1, keepdims=True)).sum(1)
        with np.errstate(invalid="ignore"):
            errors.append(np.sqrt(np.where(np.isinf(factor), np.inf, factor * squares)))
    w, wx, wxx = np.moveaxis(sums.sum(1)[:, :3], -1, 0)
    alike = wxx - wx * wx / np.maximum(w, 1e-300) <= 1e-9 * wxx
    return errors[0], np.where(alike, np.inf, errors[1])


def _spreads(off: Numbers, ends: Integers) -> Numbers:
    """Standard deviation of each ring from the median of the absolute deviations; the rows are sorted by ring."""
    spread = np.full(len(ends), np.nan)
    start = 0
    for number, end in enumerate(ends):
        if end > start:
            part = off[start:end]
            spread[number] = np.partition(part, len(part) // 2)[len(part) // 2]
        start = end
    return np.maximum(_MAD_TO_STD * spread, _LEAST_SPREAD_RAD)
