"""Rows of a cloud that are echoes of one beam: a dual-return file holds two for most."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

__all__ = ["first_rows", "holds_pairs", "shares_beams"]

Numbers = npt.NDArray[np.floating[Any]]
Integers = npt.NDArray[np.integer[Any]]

TURN_DEG = 360.0
# Echoes of one beam share its azimuth; neighbours are a step apart.
_SAME_BEAM = 0.25
# More returns than beams by this share: the file holds more than one a beam.
_TOO_MANY = 1.02
# Share of neighbours on a ring at one azimuth: KITTI at most 0.003, nuScenes 0.005, Seeing Through Fog 0.32.
_MANY_SHARED = 0.05
_RINGS_TO_JUDGE, _FEWEST_GAPS = 8, 100


def holds_pairs(returns: int, rings: int, columns: int) -> bool:
    """Tell whether a sweep has more returns than beams.

    Example:
        >>> holds_pairs(209_297, 64, 1800), holds_pairs(120_000, 64, 2155)
        (True, False)
    """
    return returns > _TOO_MANY * rings * columns


def shares_beams(xyz: Numbers, ring: Integers, step_deg: float) -> bool:
    """Tell whether many rows are further echoes of a beam, by the azimuths on the fullest rings.

    Args:
        xyz: ``(N, 3)`` metres in the sensor's frame.
        ring: ``(N,)`` of each row, below 0 for a row without return.
        step_deg: azimuth between neighbouring beams of a ring.

    Example:
        >>> azimuth = np.radians(np.arange(0.0, 360.0))
        >>> once = 9.0 * np.stack([np.cos(azimuth), np.sin(azimuth), 0.0 * azimuth], -1)
        >>> shares_beams(once, np.zeros(360, int), 1.0)
        False
        >>> shares_beams(np.concatenate([once, 0.5 * once[::5]]), np.zeros(432, int), 1.0)
        True
    """
    count = np.bincount(ring + 1)[1:]
    gaps = []
    for number in np.argsort(-count, kind="stable")[:_RINGS_TO_JUDGE]:
        own = xyz[ring == number]
        gaps.append(np.diff(np.sort(np.degrees(np.arctan2(own[:, 1], own[:, 0])))))
    every = np.concatenate(gaps) if gaps else np.zeros(0)
    return len(every) >= _FEWEST_GAPS and bool((every < _SAME_BEAM * step_deg).mean() > _MANY_SHARED)


def first_rows(xyz: Numbers, ring: Integers, step_deg: float) -> Integers:
    """Find the first row of each row's beam.

    Args:
        xyz: ``(N, 3)`` metres in the sensor's frame; rows at the origin are no returns and alone.
        ring: ``(N,)`` of each row, below 0 for none.
        step_deg: azimuth between neighbouring beams of a ring.

    Returns:
        int64 ``(N,)``; a row that is alone, or comes first, has its own number.

    Example:
        >>> xyz = np.array([[9.0, 0.0, 0.0], [9.0, 0.1, 0.0], [4.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
        >>> first_rows(xyz, np.zeros(4, int), step_deg=0.2).tolist()
        [0, 1, 0, 3]
    """
    count = len(xyz)
    rows = np.arange(count)
    seen = np.flatnonzero((xyz != 0).any(1) & (ring >= 0))
    if len(seen) < 2:
        return rows
    azimuth = np.degrees(np.arctan2(xyz[seen, 1], xyz[seen, 0])) % TURN_DEG
    key = 4.0 * TURN_DEG * ring[seen] + azimuth
    order = np.argsort(key, kind="stable")
    apart = np.diff(key[order]) > _SAME_BEAM * step_deg
    beam = np.concatenate([[0], np.cumsum(apart)])
    first = np.full(int(beam[-1]) + 1, count)
    np.minimum.at(first, beam, seen[order])
    found = rows.copy()
    found[seen[order]] = first[beam]
    return found
