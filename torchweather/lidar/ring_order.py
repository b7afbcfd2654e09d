"""Rings of a sweep from the order of its rows: each ring is written whole, one after the other, as in KITTI."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from torchweather.lidar.cone_fit import cone_residual_deg, fit_cones

__all__ = ["rings_from_order"]

Numbers = npt.NDArray[np.floating[Any]]
Integers = npt.NDArray[np.integer[Any]]

_TURN_DEG = 360.0
# Rows of one ring follow each other in azimuth: this share of the steps goes forward, by less than this.
_FORWARD_SHARE = 0.9
_SMALL_STEP_DEG = 5.0
# A step back by less than this is the sensor's jitter or a second return, not a new turn.
_JITTER_DEG = 2.0
# Places of the seam that are tried: where atan2 or the azimuth wraps first, then every so many degrees.
_SEAMS_DEG = (0.0, 180.0, *range(15, 180, 15), *range(195, 360, 15))
# A row so far from its ring's cone is on the wrong ring; a seam with so few of them is taken at once.
_WRONG_DEG = 0.15
_FEW_WRONG = 0.005
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
    best, ring = np.inf, None
    for seam in _SEAMS_DEG:
        number = np.floor((way - seam + _ROUNDING_DEG) / _TURN_DEG).astype(np.int64)
        number -= number[0]
        wrong = _wrong_share(xyz[sample], number[sample])
        if wrong < best:
            best, ring = wrong, number
        if wrong < _FEW_WRONG:
            break
    return ring


def _wrong_share(xyz: Numbers, ring: Integers) -> float:
    """Share of rows that lie off the cone of their ring."""
    fit = fit_cones(xyz, ring, int(ring.max()) + 1)
    return float((np.abs(cone_residual_deg(xyz, ring, fit)) > _WRONG_DEG).mean())
