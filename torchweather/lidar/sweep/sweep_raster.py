"""A sweep as a raster of rings and azimuths: the nearest returns about a beam, and regions without any."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from torchweather.core.compiled import uses_compiled
from torchweather.core.errors import InputValueError, check_between

__all__ = ["Neighbour", "SweepRaster", "long_runs"]

Numbers = npt.NDArray[np.floating[Any]]
Mask = npt.NDArray[np.bool_]
Index = npt.NDArray[np.intp]

TURN_DEG = 360.0
# Beams without ring numbers: those within this elevation share a row.
_ROW_DEG = 0.3
_MOST_RINGS = 100_000
_STEP_M = 1e-4
_NOTHING = np.iinfo(np.int64).max


@dataclass(frozen=True)
class Neighbour:
    """The nearest return on one side of each beam.

    Args:
        range_m: ``(M,)`` its range; ``inf`` where none is near enough.
        away_deg: ``(M,)`` angle to it; ``inf`` likewise.
        raised: ``(M,)`` whether it lies above the ground.
    """

    range_m: Numbers
    away_deg: Numbers
    raised: Mask


class SweepRaster:
    """Returns and beams without return of one sweep by ring and azimuth.

    Args:
        points_xyz: ``(N, 3)`` returns, metres in the sensor's frame.
        raised: ``(N,)`` returns above the ground.
        direction: ``(M, 3)`` unit vectors of the beams without return.
        step_deg: width of a column.
        ring: ``(N,)`` and ``direction_ring`` ``(M,)``, any numbers; ``None``: rows of 0.3 degrees of elevation.
        direction_ring: see ``ring``.
    """

    def __init__(
        self,
        points_xyz: Numbers,
        raised: Mask,
        direction: Numbers,
        step_deg: float,
        ring: npt.NDArray[np.integer[Any]] | None,
        direction_ring: npt.NDArray[np.integer[Any]] | None,
    ) -> None:
        check_between("step_deg", step_deg, 1e-3, TURN_DEG, unit="degrees", owner="beam_ends")
        self.columns = max(1, round(TURN_DEG / step_deg))
        self.step_deg = TURN_DEG / self.columns
        x, y, z = points_xyz.T
        flat = np.hypot(x, y)
        range_m = np.hypot(flat, z)
        elevation = np.degrees(np.arctan2(z, flat))
        beam_elevation = np.degrees(np.arcsin(np.clip(direction[:, 2], -1.0, 1.0)))
        if ring is None or direction_ring is None:
            lowest = min(elevation.min(), beam_elevation.min())
            row = ((elevation - lowest) / _ROW_DEG).astype(np.intp)
            self.row = ((beam_elevation - lowest) / _ROW_DEG).astype(np.intp)
            rows = int(max(row.max(), self.row.max())) + 1
            self.elevation_deg = lowest + (np.arange(rows) + 0.5) * _ROW_DEG
        else:
            row, self.row, self.elevation_deg = _rows_of_rings(ring, direction_ring, elevation, beam_elevation)
            rows = len(self.elevation_deg)
        column = self._column(x, y)
        self.column = self._column(direction[:, 0], direction[:, 1])
        self.range_m = np.full((rows, self.columns), np.inf)
        # Range in steps of 0.1 mm, and above the ground or not in the last bit: one minimum finds both.
        flat_cells = np.full(rows * self.columns, _NOTHING)
        np.minimum.at(flat_cells, row * self.columns + column, (range_m / _STEP_M).astype(np.int64) * 2 + raised)
        nearest = flat_cells.reshape(rows, self.columns)
        self.range_m = np.where(nearest == _NOTHING, np.inf, (nearest // 2) * _STEP_M)
        self.raised = (nearest != _NOTHING) & (nearest % 2 == 1)

    def _column(self, x: Numbers, y: Numbers) -> Index:
        azimuth = np.degrees(np.arctan2(y, x))
        column = (np.where(azimuth < 0, azimuth + TURN_DEG, azimuth) / self.step_deg).astype(np.intp)
        return np.where(column < self.columns, column, column - self.columns)

    def neighbours(self, azimuth_deg: float, elevation_deg: float) -> tuple[Neighbour, Neighbour, Neighbour, Neighbour]:
        """The nearest returns to the left, right, above and below of every beam.

        Args:
            azimuth_deg: farthest to the sides.
            elevation_deg: farthest up and down.
        """
        if uses_compiled():
            return self._neighbours_by_loops(azimuth_deg, elevation_deg)
        reach = min(round(azimuth_deg / self.step_deg), self.columns)
        there = np.isfinite(self.range_m)
        around = np.concatenate([there[:, self.columns - reach :], there, there[:, :reach]], 1)
        place = self.column + reach
        index = np.arange(around.shape[1], dtype=np.int32)
        none = -4 * self.columns
        before = np.maximum.accumulate(np.where(around, index, none), 1)[self.row, place]
        after = np.minimum.accumulate(np.where(around, index, -none)[:, ::-1], 1)[:, ::-1][self.row, place]
        level = np.arange(len(there), dtype=np.int32)[:, None]
        under = np.maximum.accumulate(np.where(there, level, -1), 0)[self.row, self.column]
        over = np.minimum.accumulate(np.where(there, level, len(there))[::-1], 0)[::-1][self.row, self.column]
        left, right = (
            self._side(
                self.row,
                (found - reach) % self.columns,
                np.abs(found - place) * self.step_deg <= azimuth_deg,
                np.abs(found - place) * self.step_deg,
            )
            for found in (after, before)
        )
        ends = []
        for found in (over, under):
            row = np.clip(found, 0, len(there) - 1)
            away = np.abs(self.elevation_deg[row] - self.elevation_deg[self.row])
            ends.append(self._side(row, self.column, (row == found) & (away <= elevation_deg), away))
        return left, right, ends[0], ends[1]

    def _neighbours_by_loops(
        self, azimuth_deg: float, elevation_deg: float
    ) -> tuple[Neighbour, Neighbour, Neighbour, Neighbour]:
        from torchweather.lidar.sweep.compiled_raster import nearest_returns

        shape = (4, len(self.row))
        ranges, angles, raised = np.empty(shape), np.empty(shape), np.empty(shape, bool)
        beams = (self.elevation_deg, self.row, self.column, self.step_deg, float(azimuth_deg), float(elevation_deg))
        nearest_returns(self.range_m, self.raised, *beams, (ranges, angles, raised))
        left, right, above, below = (Neighbour(*one) for one in zip(ranges, angles, raised, strict=True))
        return left, right, above, below

    def _side(self, row: Index, column: Index, near: Mask, away_deg: Numbers) -> Neighbour:
        return Neighbour(
            np.where(near, self.range_m[row, column], np.inf),
            np.where(near, away_deg, np.inf),
            near & self.raised[row, column],
        )

    def regions(self, *, width_deg: float, below: Mask, reaching: Mask, except_: Mask) -> Mask:
        """Beams in connected regions without return.

        Args:
            width_deg: least width of a region.
            below: ``(M,)`` beams that may belong to one.
            reaching: ``(M,)`` beams of which a region must hold at least one.
            except_: ``(M,)`` beams that no region grows from.

        Returns:
            ``(M,)``.
        """
        from scipy.ndimage import label

        empty = np.zeros(self.range_m.shape, bool)
        empty[self.row[below], self.column[below]] = True
        empty &= ~np.isfinite(self.range_m)
        seed = empty.copy()
        seed[self.row[except_], self.column[except_]] = False
        width = max(2, round(width_deg / self.step_deg))
        # Around the turn once and a half, so that a region at the seam is whole.
        half = self.columns // 2
        seed = long_runs(np.concatenate([seed, seed[:, :half]], 1), width)
        seed[:, :half] |= seed[:, self.columns :]
        wanted = np.zeros(empty.shape, bool)
        wanted[self.row[reaching & below], self.column[reaching & below]] = True
        labels, count = label(np.concatenate([seed[:, : self.columns], seed[:, :half]], 1), np.ones((3, 3)))
        held = np.zeros(count + 1, bool)
        held[np.unique(labels[np.concatenate([wanted, wanted[:, :half]], 1)])] = True
        held[0] = False
        region = held[labels]
        region[:, :half] |= region[:, self.columns :]
        found: Mask = region[:, : self.columns][self.row, self.column]
        return found


def long_runs(mask: Mask, width: int) -> Mask:
    """Cells ``(rows, columns)`` in runs along the row of at least ``width`` columns."""
    edge = np.zeros((len(mask), 1), bool)
    padded = np.concatenate([edge, mask, edge], 1)
    # Starts and ends of all runs, row after row: a run lies in one row, as every row ends with an empty cell.
    change = np.flatnonzero(padded.ravel()[1:] != padded.ravel()[:-1]) + 1
    start, end = change[::2], change[1::2]
    long = end - start >= width
    step = np.zeros(padded.size + 1, np.int8)
    step[start[long]], step[end[long]] = 1, -1
    runs: Mask = np.cumsum(step[:-1], dtype=np.int8).reshape(padded.shape)[:, 1:-1] > 0
    return runs


def _rows_of_rings(
    ring: npt.NDArray[np.integer[Any]],
    direction_ring: npt.NDArray[np.integer[Any]],
    elevation: Numbers,
    beam_elevation: Numbers,
) -> tuple[Index, Index, Numbers]:
    """Rows of the rings by rising elevation: of the returns, of the beams, and the elevation of each row."""
    lowest = min(ring.min(), direction_ring.min())
    of_return, of_beam = ring - lowest, direction_ring - lowest
    numbers = int(max(of_return.max(), of_beam.max())) + 1
    if numbers > _MOST_RINGS:
        raise InputValueError(f"beam_ends: ring numbers must lie within {_MOST_RINGS} of each other; got {numbers}.")
    count, total = (
        np.bincount(of_return, weight, numbers) + np.bincount(of_beam, beam_weight, numbers)
        for weight, beam_weight in ((None, None), (elevation, beam_elevation))
    )
    there = np.flatnonzero(count)
    mean = total[there] / count[there]
    order = np.argsort(mean, kind="stable")
    rank = np.zeros(numbers, np.intp)
    rank[there[order]] = np.arange(len(there))
    return rank[of_return], rank[of_beam], mean[order]
