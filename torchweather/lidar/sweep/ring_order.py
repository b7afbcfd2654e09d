"""Rings of a sweep from the order of its rows: each ring is written whole, one after the other, as in KITTI."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from torchweather.lidar.sweep.cone_fit import ConeFit, cone_residual_deg, fit_cones

__all__ = ["rings_from_order"]

Numbers = npt.NDArray[np.floating[Any]]
Integers = npt.NDArray[np.integer[Any]]

_TURN_DEG = 360.0
# Rows of one ring follow each other in azimuth: this share of the steps goes forward, by less than this.
_FORWARD_SHARE = 0.97
_SMALL_STEP_DEG = 5.0
# A step back by less than this is jitter, a second return, or the parallax of a cloud in the vehicle's frame.
_JITTER_DEG = 20.0
# Places of the seam that are tried: where atan2 or the azimuth wraps first, then every so many degrees.
_SEAMS_DEG = (0.0, 180.0, *range(15, 180, 15), *range(195, 360, 15))
# A row so far from its ring's cone is on the wrong ring; a seam with so few of them is taken at once.
_WRONG_DEG = 0.15
_FEW_WRONG = 0.02
# With fewer wrong rows than this the ends of the rings are right; otherwise they are sought this far from the seam.
_EXACT = 0.001
# A seam must be better than an earlier one by this factor; where most rows lie off their cones (a tilted cloud), the
# ends are left alone.
_CLEARLY = 0.8
_UNCLEAR = 0.3
_REACH_DEG = 6.0
_SURE_DEG = 0.2  # the distances from the cones must fall by so much, summed over the rows that move
# Share of a ring's rows that makes no ring where all lie this near to the seam.
_SCRAP = 0.02
_BESIDE_DEG = 20.0
_STRAY = 0.01  # or wherever they lie
_SAMPLE_ROWS = 20_000
_ROUNDING_DEG = 1e-5  # of float32 coordinates


def rings_from_order(xyz: Numbers) -> Integers | None:
    """Number the rings by the order of the rows.

    The azimuth is followed from row to row, always forward; each time it passes the seam a ring ends. Of the seams
    tried the one is taken that leaves the rows of each ring on one cone.

    Args:
        xyz: ``(N, 3)`` returns, metres in the sensor's frame.

    Returns:
        int64 ``(N,)``, 0 for the first ring in the file; ``None`` where the rows do not follow rings.

    Example:
        >>> azimuth = np.radians(np.arange(0.5, 360.0, 2.0))
        >>> rows = [np.stack([np.cos(azimuth), np.sin(azimuth), np.full(180, np.tan(e))], -1) for e in (-0.1, 0.1)]
        >>> np.bincount(rings_from_order(10.0 * np.concatenate(rows))).tolist()
        [180, 180]
    """
    if len(xyz) < 3:
        return None
    azimuth = np.degrees(np.arctan2(xyz[:, 1].astype(np.float64), xyz[:, 0]))
    step = np.diff(azimuth)
    step -= _TURN_DEG * np.round(step / _TURN_DEG)
    small = np.abs(step) < _SMALL_STEP_DEG
    forward = np.sign(np.median(step[small])) if small.any() else 0.0
    if forward == 0:
        forward = 1.0
    step *= forward
    if (small & (step > -_JITTER_DEG)).mean() < _FORWARD_SHARE or (step[small] >= 0).mean() < _FORWARD_SHARE:
        return None
    step[step < -_JITTER_DEG] += _TURN_DEG
    way = forward * azimuth[0] % _TURN_DEG + np.r_[0.0, np.cumsum(step)]
    sample = slice(None, None, max(1, len(xyz) // _SAMPLE_ROWS))
    best, cones = np.inf, None
    ring: Integers = np.zeros(len(xyz), dtype=np.int64)
    for seam in (*_SEAMS_DEG[:2], way[0] - _REACH_DEG / 2.0, *_SEAMS_DEG[2:]):
        turns = (way - seam + _ROUNDING_DEG) / _TURN_DEG
        whole = np.floor(turns).astype(np.int64)
        number = _without_scraps(whole, (turns - whole) * _TURN_DEG)
        fit = fit_cones(xyz[sample], number[sample], int(number.max()) + 1)
        wrong = _wrong_share(xyz[sample], number[sample], fit)
        if wrong < _CLEARLY * best:
            best, cones, ring = wrong, fit, number
        if best < _FEW_WRONG:
            break
    return _moved_ends(xyz, way, ring, cones) if cones is not None and _EXACT < best < _UNCLEAR else ring


def _without_scraps(number: Integers, turned: Numbers) -> Integers:
    """Numbers from 0 on; a few rows beside the seam are no ring: they belong to the one before, or to the first."""
    number = number - number[0]
    count = np.bincount(number)
    beside = np.bincount(number, np.minimum(turned, _TURN_DEG - turned) < _BESIDE_DEG)
    typical = np.median(count)
    ring = (count >= _SCRAP * typical) | ((beside < count) & (count >= _STRAY * typical))
    kept: Integers = np.maximum(np.cumsum(ring)[number] - 1, 0)
    return kept


def _moved_ends(xyz: Numbers, way: Numbers, ring: Integers, fit: ConeFit) -> Integers:
    """Move the end of each ring to the row where the next cone begins: an Ouster's rings start at many azimuths."""
    moved = ring.copy()
    way = np.maximum.accumulate(way)
    for last in np.flatnonzero(np.diff(ring)):
        low = np.searchsorted(way, way[last] - _REACH_DEG)
        high = np.searchsorted(way, way[last] + _REACH_DEG)
        if not low <= last < high:
            continue
        part, before, after = xyz[low:high], ring[last], ring[last + 1]
        off = [np.minimum(np.abs(cone_residual_deg(part, np.full(high - low, k), fit)), 1.0) for k in (before, after)]
        # Rows before the cut pay the distance from the one cone, rows behind it that from the other.
        cost = np.r_[0.0, np.cumsum(off[0] - off[1])]
        place = int(cost.argmin())
        cut = low + place
        if cost[place] < cost[last + 1 - low] - _SURE_DEG:
            moved[low:cut], moved[cut:high] = before, after
    return moved


def _wrong_share(xyz: Numbers, ring: Integers, fit: ConeFit) -> float:
    """Share of rows that lie off the cone of their ring; rows nearer than the limit count in part."""
    return float(np.minimum(np.abs(cone_residual_deg(xyz, ring, fit)) / _WRONG_DEG, 1.0).mean())
