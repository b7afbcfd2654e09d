"""Coarse statistics of frames against what the scene is known to hold: the generator's own measure of strength."""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_matrix

from .lidar_shot import Report, View
from .scene import FloatArray

__all__ = ["BROAD", "Tally"]

RANGE_EDGES_M = (4.0, 7.0, 10.0, 14.0, 20.0, 30.0, 45.0, 70.0, 121.0)
PARTICLE_EDGES_M = (1.0, 2.0, 2.5, 3.0, 3.5, 4.0, 5.0, 6.0, 8.0, 11.0, 15.0, 22.0, 35.0, 60.0, 121.0)
SECTORS, RING_GROUPS = 12, 8
INTENSITY_EDGES = (0.0, 0.03, 0.06, 0.12, 0.25, 1.0)
# A return this much nearer than the surface is a particle, this much farther is spurious, m.
APART_M = 1.0
# Bins that hold fewer beams than this say nothing.
FEWEST = 20
# Range noise towards which the spread of a thin bin is drawn, m, and a reflectivity that particles have.
LEAST_SPREAD_M, TYPICAL_PARTICLE = 0.02, 0.002
BROAD = 3


class Tally:
    """Statistics of the frames of one view.

    Shares of beams (as asin sqrt) that lost their target, hold a nearer or a farther return; mean log intensity ratio,
    mean and log variance of the range residual of the survivors; each over range, azimuth, ring, slope and expected
    intensity of the target. Numbers of nearer returns (as sqrt) by their range, with their mean log intensity, and the
    share of them that has a neighbour. The last `BROAD` are totals over the frame: lost, nearer, log ratio.
    """

    def __init__(self, view: View) -> None:
        target, scan = view.target, view.scan
        self.there = np.isfinite(target.range_m)
        self.range_m = np.where(self.there, target.range_m, 0.0)
        self.expected = np.where(self.there, target.reflectivity * np.nan_to_num(target.cos_incidence), 0.0)
        self.grid = scan.shape
        there = self.there
        bins = [
            np.where(there, np.digitize(self.range_m, RANGE_EDGES_M), -1),
            np.floor((scan.azimuth_rad + np.pi) / (2.0 * np.pi) * SECTORS).astype(int) % SECTORS,
            (scan.ring * RING_GROUPS // scan.shape[0]).astype(int),
            np.where(there, np.where(np.nan_to_num(target.up) > 0.5, 0, 1), -1),
            np.where(there & (self.range_m < 45.0), np.digitize(self.expected, INTENSITY_EDGES) - 1, -1),
        ]
        rows, beams, start = [], [], 0
        for index in bins:
            inside = np.flatnonzero(index >= 0)
            rows.append(index[inside] + start)
            beams.append(inside)
            start += int(index.max()) + 1
        row, beam = np.concatenate(rows), np.concatenate(beams)
        self._bins = csr_matrix((np.ones(len(row)), (row, beam)), shape=(start, view.beams))
        self._of = np.asarray(self._bins.sum(1)).ravel()

    def __call__(self, report: Report) -> tuple[FloatArray, FloatArray]:
        """Statistics ``(F, S)``, 0 in bins that the scene leaves nearly empty, and their least scatter ``(S,)``."""
        seen = report.range_m > 0.0
        residual = np.where(seen & self.there, report.range_m - self.range_m, 0.0)
        nearer = seen & np.where(self.there, residual < -APART_M, True)
        farther = seen & self.there & (residual > APART_M)
        kept = seen & self.there & ~nearer & ~farther
        residual = residual * kept
        ratio = np.zeros_like(residual)
        ratio[kept] = np.log(
            np.maximum(report.intensity[kept], 1e-6)
            / np.maximum(np.broadcast_to(self.expected, kept.shape)[kept], 1e-6)
        )
        lost = self.there & ~seen
        stacked = np.concatenate([lost, nearer, farther, ratio, residual, residual**2, kept]).astype(np.float64)
        sums = (self._bins @ stacked.T).T.reshape(7, len(seen), -1)

        full, of = self._of >= FEWEST, np.maximum(self._of, 1.0)
        count = sums[6] + FEWEST  # bins that lose their beams fade instead of jumping
        mean = sums[4] / count
        spread = np.log(np.maximum((sums[5] + FEWEST * LEAST_SPREAD_M**2) / count - mean**2, 1e-8))
        shares = [np.arcsin(np.sqrt(np.clip(sums[k] / of, 0.0, 1.0))) for k in range(3)]
        columns = [np.where(full, values, 0.0) for values in (*shares, sums[3] / count, mean, spread)]
        # Scatter of asin sqrt of a share near 0 or 1, of a mean over the bin's beams, of a log variance.
        floors = [scale / np.sqrt(of) for scale in (0.35, 0.35, 0.35, 0.1, 0.05, 1.4)]
        particles, particle_floors = self._particles(report, nearer)
        broad = [
            np.arcsin(np.sqrt(lost.mean(1))),
            np.sqrt(nearer.sum(1)),
            ratio.sum(1) / np.maximum(kept.sum(1), 1),
        ]
        floors += [*particle_floors, np.array([0.35 / np.sqrt(self.there.size), 0.35, 1e-3])]
        return np.concatenate([*columns, *particles, np.stack(broad, 1)], 1), np.concatenate(floors)

    def _particles(self, report: Report, nearer: FloatArray) -> tuple[list[FloatArray], list[FloatArray]]:
        frames, size = nearer.shape[0], len(PARTICLE_EDGES_M) + 1
        found, floors = [], []
        for which in (nearer & ~self.there, nearer & self.there):
            frame, beam = np.nonzero(which)
            flat = frame * size + np.digitize(report.range_m[frame, beam], PARTICLE_EDGES_M)
            counts = np.bincount(flat, minlength=frames * size).reshape(frames, size).astype(np.float64)
            logs = np.log(np.maximum(report.intensity[frame, beam], 1e-6) / TYPICAL_PARTICLE)
            level = np.bincount(flat, logs, minlength=frames * size).reshape(frames, size) / (counts + FEWEST)
            found += [np.sqrt(counts), level]
            floors += [np.full(size, 0.35), np.full(size, 0.02)]
        grid = np.where(nearer, report.range_m, 0.0).reshape(frames, *self.grid)
        near = np.zeros_like(grid, dtype=bool)
        for moved in (np.roll(grid, 1, 2), np.roll(grid, -1, 2)):
            near |= (grid > 0.0) & (moved > 0.0) & (np.abs(grid - moved) < APART_M)
        number = nearer.sum(1) + FEWEST
        found.append(np.arcsin(np.sqrt(near.sum((1, 2)) / number))[:, None])
        return found, [*floors, np.array([0.02])]
