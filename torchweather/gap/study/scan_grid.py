"""Point clouds on the grid of a scan: one range and one intensity for each beam."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from torchweather.core.errors import TorchweatherError
from torchweather.gap.study.frames import Frame
from torchweather.io import PointCloud
from torchweather.lidar.scan import recover_ring
from torchweather.lidar.sensor import Lidar

__all__ = ["DirectionMean", "organised_frame", "scan_frame"]

# Names under which files keep the ring; case does not matter.
RING_NAMES = ("ring", "channel", "laser_id")
TURN_DEG = 360.0
# Two returns of one beam share its azimuth: within this share of a step, as in `torchweather.lidar.scan`.
SAME_BEAM = 0.25

Floats = NDArray[np.float64]


def scan_frame(cloud: PointCloud, lidar: Lidar, name: str) -> tuple[Frame, int]:
    """A cloud on the sensor's scan pattern, and how many of its points found no place of their own.

    The ring is that of the cloud (``Lidar.ring_column``, or a column named ring), else the one nearest in elevation
    (`recover_ring`). The column is the nearest in azimuth. Of several points in one cell that nearest to its centre
    stays, and of returns of one beam the stronger.

    Args:
        cloud: x, y, z in metres and intensity.
        lidar: with ``elevations_deg`` and ``columns``.
        name: of the cloud, for messages.

    Returns:
        ``range_m`` and ``intensity`` ``(rings, columns)``, 0 where no return; the number of points lost to a nearer
        neighbour of their cell or to a ring that the sensor does not have. Points nearer than ``min_range_m`` are no
        returns and not counted.

    Note:
        A beam points along the pattern's direction, up to half a step in azimuth from where its point was. Clouds that
        are compensated for the vehicle's motion, and sensors whose beams do not start at the origin (HDL-64E), leave
        the pattern and lose points; clouds of two returns per beam lose the weaker of each pair.

    Example:
        >>> import torch
        >>> lidar = Lidar(905.0, elevations_deg=(0.0, 30.0), columns=4)
        >>> points = torch.tensor([[5.0, 0.0, 0.0, 0.2], [5.0, 0.1, 0.0, 0.3], [0.0, -8.0, 0.0, 0.4]])
        >>> frame, lost = scan_frame(PointCloud(points, ("x", "y", "z", "intensity")), lidar, "cloud")
        >>> frame["range_m"].round(1).tolist(), lost
        ([[5.0, 8.0, 0.0, 0.0], [0.0, 0.0, 0.0, 0.0]], 1)
    """
    if not lidar.elevations_deg or lidar.columns is None:
        raise TorchweatherError(
            f"{name}: an unorganised cloud needs the sensor's scan pattern: expected Lidar(elevations_deg=..., "
            f"columns=...); got {lidar.elevations_deg} and {lidar.columns}. Take a preset that has them."
        )
    rings, columns = len(lidar.elevations_deg), lidar.columns
    xyz, range_m, intensity = _returns(cloud, lidar)
    ring = _rings(cloud, lidar)
    there = range_m > 0
    known = there & (ring >= 0) & (ring < rings)
    lost = int(np.count_nonzero(there & ~known))
    xyz, range_m, intensity, ring = xyz[known], range_m[known], intensity[known], ring[known]

    step = TURN_DEG / columns
    offsets = np.array(lidar.azimuth_offsets_deg or np.zeros(rings))
    steps = (offsets[ring] - np.degrees(np.arctan2(xyz[:, 1], xyz[:, 0]))) / step  # the azimuth falls with the column
    nearest = np.rint(steps)
    cell = ring * columns + nearest.astype(np.int64) % columns
    beam = np.floor(np.abs(steps - nearest) / SAME_BEAM)
    order = np.lexsort((-intensity, beam, cell))  # the last key counts most
    cells, first = np.unique(cell[order], return_index=True)
    lost += len(cell) - len(cells)
    frame = {"range_m": np.zeros(rings * columns), "intensity": np.zeros(rings * columns)}
    frame["range_m"][cells], frame["intensity"][cells] = range_m[order][first], intensity[order][first]
    return {key: values.astype(np.float32).reshape(rings, columns) for key, values in frame.items()}, lost


def organised_frame(cloud: PointCloud, lidar: Lidar) -> Frame:
    """A cloud that is a grid already: ``range_m`` and ``intensity`` ``(H, W)``, 0 where no return."""
    assert cloud.grid is not None
    _, range_m, intensity = _returns(cloud, lidar)
    return {
        "range_m": range_m.astype(np.float32).reshape(cloud.grid),
        "intensity": intensity.astype(np.float32).reshape(cloud.grid),
    }


class DirectionMean:
    """Directions of the cells of organised clouds: the mean of where their returns were.

    Args:
        grid: ``(H, W)``.
    """

    def __init__(self, grid: tuple[int, int]) -> None:
        self._sum = np.zeros((*grid, 3))

    def update(self, cloud: PointCloud, lidar: Lidar) -> None:
        """Add the returns of a cloud."""
        xyz, range_m, _ = _returns(cloud, lidar)
        there = range_m > 0
        flat = self._sum.reshape(-1, 3)
        flat[there] += xyz[there] / range_m[there, None]

    def compute(self, name: str) -> Floats:
        """``(H, W, 3)`` unit vectors. A cell that never had a return gets the median elevation of its row and the mean
        azimuth of its column.

        Raises:
            TorchweatherError: a whole row or column never had a return.
        """
        length = np.linalg.norm(self._sum, axis=-1)
        seen = length > 0
        for axis, what in ((1, "row"), (0, "column")):
            empty = np.flatnonzero(~seen.any(axis))
            if len(empty):
                raise TorchweatherError(
                    f"{name}: {what} {int(empty[0])} of the organised clouds has no return in any of them, so where "
                    "its beams point is unknown. Give directions=(H, W, 3), unit vectors."
                )
        unit = self._sum / np.where(seen, length, 1.0)[..., None]
        elevation = np.where(seen, np.arctan2(unit[..., 2], np.linalg.norm(unit[..., :2], axis=-1)), np.nan)
        row = np.nanmedian(elevation, axis=1)[:, None]
        azimuth = np.arctan2(unit[..., 1].sum(0), unit[..., 0].sum(0))[None, :]
        guess = np.stack(
            np.broadcast_arrays(np.cos(row) * np.cos(azimuth), np.cos(row) * np.sin(azimuth), np.sin(row)), -1
        )
        return np.where(seen[..., None], unit, guess)


def _returns(cloud: PointCloud, lidar: Lidar) -> tuple[Floats, Floats, Floats]:
    """x, y, z, range (0 where no return) and intensity of each row, float64."""
    points = cloud.points.detach().cpu().double().numpy()
    xyz = points[:, :3]
    range_m = np.linalg.norm(xyz, axis=-1)
    there = np.isfinite(range_m) & (range_m > 0) & (range_m >= lidar.min_range_m)
    has = cloud.points.shape[1] > 3 and lidar.intensity_unit != "none"
    intensity = points[:, 3] if has else np.full(len(points), lidar.assumed_reflectivity)
    return xyz, np.where(there, range_m, 0.0), np.where(there, intensity, 0.0)


def _rings(cloud: PointCloud, lidar: Lidar) -> NDArray[np.int64]:
    named = [place for place, name in enumerate(cloud.columns) if name.lower() in RING_NAMES]
    column = lidar.ring_column if lidar.ring_column is not None else next(iter(named), None)
    if column is not None and column < cloud.points.shape[1]:
        return cloud.points[:, column].long().cpu().numpy()
    found: NDArray[np.int64] = recover_ring(cloud.points.detach().double(), lidar).cpu().numpy()
    return found
