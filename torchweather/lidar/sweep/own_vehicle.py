"""The own vehicle in the sweeps of one drive: beams that it blocks, and beams that return from its body.

The vehicle is rigid and moves with the sensor. It is what stays the same while everything else changes.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
import numpy.typing as npt
from torch import Tensor

from torchweather.core.archives import read_archive
from torchweather.core.arguments import check_arguments
from torchweather.core.atomic import atomic_write
from torchweather.core.errors import InputValueError, TorchweatherError
from torchweather.lidar.cloud_frame import points_in_sensor_frame
from torchweather.lidar.sensor import Lidar
from torchweather.lidar.sweep.ground import fit_ground
from torchweather.lidar.sweep.sweep_raster import long_runs
from torchweather.lidar.sweep.sweep_rings import sweep_rings

__all__ = [
    "FEWEST_VIEWS",
    "Box",
    "OwnVehicle",
    "OwnVehicleMask",
    "checked_own_vehicle",
    "own_vehicle_mask",
    "rows_in_box",
]

Numbers = npt.NDArray[np.floating[Any]]
Mask = npt.NDArray[np.bool_]
Box = tuple[float, float, float, float, float, float]

TURN_DEG = 360.0
FEWEST_VIEWS = 5
# Where the body of a car can return: horizontal distance from the sensor, metres.
_NEAREST_M, _FARTHEST_M = 0.5, 3.0
# Above the ground, which is as rigid as the car on a flat road: sills lie at 0.2 to 0.3 m, kerbs at 0.15 m.
_RAISED_M = 0.3
# A body returns from the same range in so large a share of the views. Range noise is 0.02 m; a beam near an edge of the
# body meets it anywhere within a cell (0.3 degrees at 2 m are 0.01 m, on slanted sheet metal several times as much).
_BODY_SHARE = 0.8
_SAME_M = 0.25
# Returns within this of those seen in the drive are the body's.
_MARGIN_M = 0.15
# Blocked cells hold a return in at most this share of the views: the car pitches, and near its edge a beam passes by.
# In KITTI (13 views) cells hold returns in none or in more than half of the views; 0.25 is the gap between the two.
_PASSED_SHARE = 0.25
# A cell is blocked, rather than unlucky, where chance would leave it empty in all views less often than this.
_CHANCE = 1e-3
# Rings that look for the ground: their returns lie nearer than this in the median. One that far meets the road at
# 1.7 m below at -4 degrees.
_GROUND_RING_M = 25.0
# Blocked regions are so wide, and reach down to rings that meet the road this near (as in `beam_ends`).
_WIDTH_DEG = 1.5
_ROAD_M = 8.0
# Beams without return this near a blocked cell end on the vehicle too: the edge lies elsewhere in each sweep, as the
# columns start elsewhere and the vehicle pitches.
_EDGE_DEG = 1.0
# Two sweeps show the same view where fewer than this share of the cells beyond 5 m changed by more than 0.5 m and 2 %.
_CHANGED_SHARE = 0.15
_CHANGED_M, _CHANGED_RATIO, _FAR_M = 0.5, 0.02, 5.0
# So many cells are enough to compare two sweeps.
_MOST_CELLS = 20_000


@dataclass(frozen=True, eq=False)
class OwnVehicleMask:
    """Cells of ring and azimuth in which a LiDAR sees its own vehicle.

    Args:
        blocked: ``(R, C)`` cells of ring and azimuth that the vehicle hides.
        nearest_m: ``(R, C)`` float32, least range of the body's returns, metres; ``inf`` where it returns nothing.
        farthest_m: ``(R, C)`` float32, greatest range of them; 0 where it returns nothing.
        sweeps: from which it was found.
        views: that differed, as standing still shows one view again and again.
    """

    blocked: Mask
    nearest_m: npt.NDArray[np.float32]
    farthest_m: npt.NDArray[np.float32]
    sweeps: int
    views: float

    def __post_init__(self) -> None:
        check_arguments(
            "OwnVehicleMask(blocked: ndarray, nearest_m: array, farthest_m: array, sweeps: int, views: float)",
            self.blocked,
            self.nearest_m,
            self.farthest_m,
            self.sweeps,
            self.views,
        )
        shapes = {self.blocked.shape, self.nearest_m.shape, self.farthest_m.shape}
        if len(shapes) != 1 or self.blocked.ndim != 2:
            raise InputValueError(
                f"OwnVehicleMask: expected three arrays of one shape (rings, columns); got {sorted(shapes)}. Take them "
                "from own_vehicle_mask or OwnVehicleMask.load."
            )

    @property
    def returning(self) -> Mask:
        """``(R, C)`` cells that return from the body."""
        found: Mask = self.farthest_m > 0
        return found

    @property
    def beams(self) -> int:
        """Number of cells, a beam each, that are blocked or return from the body."""
        return int((self.blocked | self.returning).sum())

    @property
    def words(self) -> str:
        """Size and origin, for a manifest."""
        return (
            f"own vehicle from {self.sweeps} sweeps: {int(self.blocked.sum())} beams blocked, "
            f"{int(self.returning.sum())} on its body"
        )

    def hides(self, direction: Numbers, ring: npt.NDArray[np.integer[Any]]) -> Mask:
        """Beams without return that end on the vehicle: in a cell of the mask or within a degree of one.

        Args:
            direction: ``(M, 3)`` unit vectors in the sensor's frame.
            ring: ``(M,)`` in the sensor's numbers.

        Returns:
            ``(M,)``.
        """
        from scipy.ndimage import binary_dilation

        cells = self.blocked | self.returning
        reach = max(1, round(_EDGE_DEG * cells.shape[1] / TURN_DEG))
        wide = np.concatenate([cells[:, -reach:], cells, cells[:, :reach]], 1)
        wide = binary_dilation(wide, np.ones((1, 2 * reach + 1), bool))[:, reach:-reach]
        found: Mask = (
            wide[np.clip(ring, 0, len(cells) - 1), self._column(direction)] & (ring >= 0) & (ring < len(cells))
        )
        return found

    def holds(self, xyz: Numbers, ring: npt.NDArray[np.integer[Any]]) -> Mask:
        """Returns that lie on the vehicle: in a cell that returns from the body, and within 0.15 m of its range.

        A person in front of the body is nearer than that. What stands beside it lies in other cells.

        Args:
            xyz: ``(N, 3)`` metres in the sensor's frame.
            ring: ``(N,)`` in the sensor's numbers, -1 for rows without return.

        Returns:
            ``(N,)``.
        """
        near, far = _over_neighbours(self.nearest_m, np.minimum), _over_neighbours(self.farthest_m, np.maximum)
        place = np.clip(ring, 0, len(near) - 1), self._column(xyz)
        range_m = np.sqrt(np.square(xyz.astype(np.float64)).sum(-1))
        known = (ring >= 0) & (ring < len(near)) & _in_zone(xyz)
        found: Mask = known & (range_m > near[place] - _MARGIN_M) & (range_m < far[place] + _MARGIN_M)
        return found

    def _column(self, xyz: Numbers) -> npt.NDArray[np.intp]:
        return _columns(xyz, self.blocked.shape[1])

    def save(self, path: str | Path | BinaryIO) -> None:
        """Write it to a ``.npz`` file, whole or not at all."""
        if isinstance(path, (str, Path)):
            with atomic_write(path) as unfinished, unfinished.open("wb") as file:
                self.save(file)
            return
        values = {"blocked": self.blocked, "nearest_m": self.nearest_m, "farthest_m": self.farthest_m}
        np.savez_compressed(path, allow_pickle=False, **values, sweeps=self.sweeps, views=self.views)

    @classmethod
    def load(cls, path: str | Path | BinaryIO) -> OwnVehicleMask:
        """Read what `save` wrote.

        Raises:
            ValueError: the file holds no mask.
        """
        named = path if isinstance(path, (str, Path)) else "the own vehicle"
        try:
            found, _ = read_archive(named, None if isinstance(path, (str, Path)) else path)
            nearest, farthest = (found[name].astype(np.float32) for name in ("nearest_m", "farthest_m"))
            if any(np.isnan(one).any() or (one < 0).any() for one in (nearest, farthest)):
                raise InputValueError("ranges must be 0 m or more")
            views = float(found["views"])
            if not 0 <= views < np.inf:
                raise InputValueError(f"views must be 0 or more, and finite; got {views:g}")
            return cls(found["blocked"].astype(bool), nearest, farthest, int(found["sweeps"]), views)
        except (KeyError, ValueError, TypeError, OverflowError, TorchweatherError) as error:
            raise InputValueError(
                f"{named}: expected a mask of the own vehicle (.npz); got something else ({error}). Write one with "
                "own_vehicle_mask(clouds, sensor).save(path)."
            ) from error


OwnVehicle = OwnVehicleMask | Box


def own_vehicle_mask(clouds: Iterable[Tensor], sensor: Lidar) -> OwnVehicleMask:
    """Find the own vehicle in sweeps of one drive.

    A cell of ring and azimuth is *blocked* where it returns nothing in three quarters of the views or more, although
    chance would leave it empty less often than once in 1000; its ring looks at the ground (median range below 25 m);
    it belongs to a region at least 1.5 degrees wide that reaches down to a ring that meets the road within 8 m.

    A cell is on the *body* where four fifths of the views return from the same range within 0.25 m, 0.5 to 3 m away
    horizontally and 0.3 m or more above the ground.

    Sweeps of a vehicle that stands show one view again and again, and count as one. So a person or a car beside the
    vehicle at a red light is not taken for a part of it.

    Args:
        clouds: ``(N, C)`` each: x, y, z in metres, further columns, of one sensor on one vehicle. 50 sweeps evenly over
            a drive are enough; each keeps one float32 a beam in memory.
        sensor: with its scan pattern (``elevations_deg`` and ``columns``).

    Returns:
        The mask. Its order of sweeps does not matter.

    Raises:
        ValueError: fewer than 5 sweeps differ.

    Note:
        Parts of the body that shine back from the ground's height, or from beyond 3 m (a trailer), are not found. A
        mask of two vehicles holds what both have in common.

    Example:
        >>> import torch
        >>> sensor = Lidar(905.0, elevations_deg=(-14.0, -6.0), columns=360)
        >>> azimuth = (torch.arange(360) + 0.5).mul(torch.pi / 180).repeat(2)
        >>> down = torch.tensor([14.0, 6.0]).mul(torch.pi / 180).repeat_interleave(360)
        >>> beam = torch.stack([down.cos() * azimuth.cos(), down.cos() * azimuth.sin(), -down.sin()], -1)
        >>> free = (azimuth > 0.3) | (down < 0.15)  # the vehicle blocks 17 beams of the lower ring
        >>> wall_m = lambda k: 9.0 + 2.0 * torch.cos(3.0 * azimuth + k)
        >>> sweeps = [(beam * torch.minimum(1.7 / down.sin(), wall_m(k))[:, None])[free] for k in range(6)]
        >>> own_vehicle_mask(sweeps, sensor).words
        'own vehicle from 6 sweeps: 17 beams blocked, 0 on its body'
    """
    ranges, bodies = [], []
    for cloud in clouds:
        far, body = _cells(points_in_sensor_frame(cloud.detach(), sensor), sensor)
        ranges.append(far)
        bodies.append(body)
    weight = _weights(ranges)
    views = round(float(weight.sum()), 6)
    if views < FEWEST_VIEWS:
        raise InputValueError(
            f"own_vehicle_mask: expected {FEWEST_VIEWS} or more sweeps that differ, as what stays the same is the "
            f"vehicle; got {len(ranges)} sweeps, which show {views:.1f} views. Take sweeps from a longer part of the "
            "drive."
        )
    weight = weight / weight.sum()
    blocked = _blocked(ranges, weight, views)
    nearest_m, farthest_m = _body(bodies, weight)
    return OwnVehicleMask(blocked & (farthest_m == 0), nearest_m, farthest_m, len(ranges), views)


def rows_in_box(xyz: Tensor, box: Box) -> Tensor:
    """Points ``(..., 3)`` in a box ``(x from, x to, y from, y to, z from, z to)``, metres, one frame: ``(...)``.

    Example:
        >>> import torch
        >>> rows_in_box(torch.tensor([[1.0, 0.0, -0.8], [1.0, 2.0, -0.8]]), (-2.4, 2.1, -0.9, 0.9, -1.6, -0.2)).tolist()
        [True, False]
    """
    low, high = xyz.new_tensor(box[0::2]), xyz.new_tensor(box[1::2])
    found: Tensor = ((xyz >= low) & (xyz <= high)).all(-1)
    return found


def checked_own_vehicle(value: object, sensor: Lidar, owner: str) -> OwnVehicle | None:
    """The mask or the box that ``own_vehicle=`` of a transform gives: a mask, its file, or six numbers."""
    if isinstance(value, (str, Path)):
        value = OwnVehicleMask.load(value)
    if isinstance(value, OwnVehicleMask):
        rings, known = len(value.blocked), len(sensor.elevations_deg or ())
        if rings != known:
            raise InputValueError(
                f"{owner}: own_vehicle: expected a mask of the sensor's {known} rings; got one of {rings}: of another "
                "sensor. Find it anew, own_vehicle_mask(clouds, sensor)."
            )
        return value
    if value is None:
        return None
    if isinstance(value, Sequence) and len(value) == 6:
        try:
            x0, x1, y0, y1, z0, z1 = (float(one) for one in value)
        except (TypeError, ValueError):
            x0 = x1 = float("nan")
        else:
            if x0 < x1 and y0 < y1 and z0 < z1:
                return x0, x1, y0, y1, z0, z1
    raise InputValueError(
        f"{owner}: own_vehicle: expected a mask (own_vehicle_mask), its .npz file, or a box of the vehicle's body; "
        f"got {value!r}. A box is x from, x to, y from, y to, z from, z to, in metres in the sensor's frame. Pass e.g. "
        "own_vehicle=(-2.4, 2.1, -0.9, 0.9, -1.6, -0.2)."
    )


def _cells(cloud: Tensor, sensor: Lidar) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.float32]]:
    """Range of the nearest return of each cell ``(R, C)``, metres, and of that on a body; ``inf`` for none."""
    ring = sweep_rings(cloud, sensor).ring.cpu().numpy()
    xyz = cloud[:, :3].cpu().double().numpy()
    shape = len(sensor.elevations_deg or ()), sensor.columns or 1
    range_m = np.sqrt(np.square(xyz).sum(-1)).astype(np.float32)
    there = (ring >= 0) & (range_m > 0)
    ground = fit_ground(xyz[there])
    raised = np.zeros(len(xyz), bool) if ground is None else ground.height_above(xyz) > _RAISED_M
    column = _columns(xyz, shape[1])
    found = []
    for rows in (there, there & raised & _in_zone(xyz)):
        cells = np.full(shape, np.inf, np.float32)
        np.minimum.at(cells, (ring[rows], column[rows]), range_m[rows])
        found.append(cells)
    return found[0], found[1]


def _columns(xyz: Numbers, columns: int) -> npt.NDArray[np.intp]:
    azimuth = np.degrees(np.arctan2(xyz[:, 1].astype(np.float64), xyz[:, 0])) % TURN_DEG
    column: npt.NDArray[np.intp] = (azimuth * (columns / TURN_DEG)).astype(np.intp) % columns
    return column


def _in_zone(xyz: Numbers) -> Mask:
    flat = np.hypot(xyz[:, 0], xyz[:, 1])
    found: Mask = (flat > _NEAREST_M) & (flat < _FARTHEST_M)
    return found


def _over_neighbours(cells: Numbers, best: np.ufunc) -> Numbers:
    """The least or greatest of each cell and its two neighbours in azimuth."""
    found: Numbers = best(best(np.roll(cells, 1, -1), np.roll(cells, -1, -1)), cells)
    return found


def _weights(ranges: Sequence[Numbers]) -> Numbers:
    """One over the number of sweeps that show the same view, of each sweep ``(S,)``; itself included."""
    part = [cells.reshape(-1)[:: max(1, cells.size // _MOST_CELLS)] for cells in ranges]
    far = [np.where(np.isfinite(cells) & (cells > _FAR_M), cells, 0.0) for cells in part]
    alike = np.eye(len(far))
    for first in range(len(far)):
        for second in range(first):
            both = (far[first] > 0) & (far[second] > 0)
            a, b = far[first][both], far[second][both]
            changed = np.abs(a - b) > np.maximum(_CHANGED_M, _CHANGED_RATIO * np.minimum(a, b))
            if not both.any() or changed.mean() < _CHANGED_SHARE:
                alike[first, second] = alike[second, first] = 1.0
    weights: Numbers = 1.0 / alike.sum(0)
    return weights


def _blocked(ranges: Sequence[Numbers], weight: Numbers, views: float) -> Mask:
    """Cells of regions without return that the vehicle hides, ``(R, C)``."""
    from scipy.ndimage import label

    shape = ranges[0].shape
    hits = np.zeros(shape)
    for cells, share in zip(ranges, weight, strict=True):
        hits += share * np.isfinite(cells)
    empty = hits <= _PASSED_SHARE + 1e-9
    ring_m, unlucky = np.full(shape[0], np.inf), np.ones(shape[0])
    for ring in range(shape[0]):
        seen = np.concatenate([cells[ring][np.isfinite(cells[ring])] for cells in ranges])
        if len(seen):
            ring_m[ring] = np.median(seen)
            unlucky[ring] = (1.0 - min(1.0, hits[ring][~empty[ring]].mean())) ** (views * (1.0 - _PASSED_SHARE))
    empty &= ((ring_m < _GROUND_RING_M) & (unlucky < _CHANCE))[:, None]
    order = np.argsort(ring_m, kind="stable")  # from the steepest ring on
    columns = shape[1]
    twice = np.concatenate([empty[order]] * 2, 1)  # so that a region at the seam is whole
    width = max(2, round(_WIDTH_DEG * columns / TURN_DEG))
    twice = long_runs(twice, width)
    labels, count = label(twice, np.ones((3, 3)))
    held = np.zeros(count + 1, bool)
    held[np.unique(labels[ring_m[order] < _ROAD_M])] = True
    held[0] = False
    region = held[labels]
    found = np.zeros(shape, bool)
    found[order] = region[:, :columns] | region[:, columns:]
    return found


def _body(bodies: Sequence[Numbers], weight: Numbers) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.float32]]:
    """Least and greatest range of the body's returns in each cell ``(R, C)``; ``inf`` and 0 for none."""
    shape = bodies[0].shape
    # Beams fall into a cell or beside it, as each sweep starts elsewhere.
    wide = np.stack([_over_neighbours(cells, np.minimum) for cells in bodies]).reshape(len(bodies), -1)
    place = np.flatnonzero((weight[:, None] * np.isfinite(wide)).sum(0) >= _BODY_SHARE - 1e-9)
    nearest, farthest = np.full(shape, np.inf, np.float32), np.zeros(shape, np.float32)
    if not len(place):
        return nearest, farthest
    some = wide[:, place]
    there = np.isfinite(some)
    middle = np.nanmedian(np.where(there, some, np.nan), 0)
    same = there & (np.abs(np.where(there, some, 0.0) - middle) < _SAME_M)
    share = (weight[:, None] * same).sum(0)
    kept = share >= _BODY_SHARE - 1e-9
    nearest.reshape(-1)[place[kept]] = np.where(same, some, np.inf).min(0)[kept]
    farthest.reshape(-1)[place[kept]] = np.where(same, some, 0.0).max(0)[kept]
    return nearest, farthest
