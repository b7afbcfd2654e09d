"""Where the beams without a return end: on the ground, the own vehicle, an obstacle, or in the sky.

A beam without a return has met something that gave too little light back, or nothing. Flakes and drops can only lie
before that. What it met follows from its neighbours in the sweep, as nearest returns to the left and right, above and
below, and from the plane of the ground.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import IntEnum
from typing import Any

import numpy as np
import numpy.typing as npt

from torchweather.core.arguments import check_arguments
from torchweather.core.errors import InputValueError
from torchweather.lidar.sweep.ground import GroundPlane, fit_ground
from torchweather.lidar.sweep.sweep_raster import SweepRaster

__all__ = ["BeamEnd", "BeamEnds", "beam_ends", "ways_above_ground"]

Numbers = npt.NDArray[np.floating[Any]]
Mask = npt.NDArray[np.bool_]

# Chosen on views of KITTI 000008 and WADS 042223.
# A pane of the next car is this wide and high; wider gaps between houses show sky.
_ENCLOSED_AZIMUTH_DEG = 10.0
_ENCLOSED_ELEVATION_DEG = 6.0
# So narrow a gap between two returns is a beam that failed, whatever lies above.
_NARROW_DEG = 1.5
# Parts of the own vehicle hide regions at least this wide that reach down to where the road is this near, and whose
# neighbours lie on the ground rather than this much above it.
_OWN_WIDTH_DEG = 1.5
_OWN_ROAD_M = 8.0
_RAISED_M = 0.4
# Returns farther below the ground than this come by way of a mirror or water; nothing floats there.
_BELOW_GROUND_M = 0.25
# The ground is what a beam meets unless its neighbours on both sides are this much nearer.
_GROUND_RATIO = 1.1


class BeamEnd(IntEnum):
    """End of a beam: what it meets.

    RETURN: it has a return. SKY: nothing. GROUND: the ground, too dark or too slant to return. OWN_VEHICLE: the car
    that carries the sensor. OBSTACLE: something between its neighbours' returns, such as a pane or a gap behind an
    edge; it ends at the nearer of them. UNKNOWN: a row without return whose direction is not known.
    """

    RETURN = 0
    SKY = 1
    GROUND = 2
    OWN_VEHICLE = 3
    OBSTACLE = 4
    UNKNOWN = 5


@dataclass(frozen=True)
class BeamEnds:
    """Ends of the beams without return.

    Args:
        distance_m: ``(M,)`` way to the end, metres; 0 on the own vehicle, the maximum range in the sky.
        end: ``(M,)`` int8, `BeamEnd`.
        ground: the plane that was used, or ``None`` where the sweep shows none.
    """

    distance_m: Numbers
    end: npt.NDArray[np.int8]
    ground: GroundPlane | None


def beam_ends(
    points_xyz: Numbers,
    direction: Numbers,
    max_range_m: float,
    *,
    ring: npt.NDArray[np.integer[Any]] | None = None,
    direction_ring: npt.NDArray[np.integer[Any]] | None = None,
    origin_height_m: Numbers | float = 0.0,
    step_deg: float = 0.2,
    own_vehicle: Mask | None = None,
    ground: GroundPlane | None = None,
) -> BeamEnds:
    """Find where beams without a return end.

    Args:
        points_xyz: ``(N, 3)`` returns of one sweep, metres in the sensor's frame, x forward, y left, z up.
        direction: ``(M, 3)`` unit vectors of the beams without return.
        max_range_m: of the sensor: the end of a beam in the sky.
        ring: ``(N,)`` of every return, ``direction_ring`` ``(M,)`` of every beam: any numbers; without them, beams
            of one elevation share a ring.
        direction_ring: see ``ring``.
        origin_height_m: ``(M,)`` heights at which the beams start, metres.
        step_deg: between neighbouring beams of a ring.
        own_vehicle: ``(M,)`` beams known to meet the own vehicle; ``None`` finds regions without return that reach
            down to the nearest road and are at least 1.5 degrees wide.
        ground: plane of the ground; ``None`` fits one to the returns.

    Returns:
        One end a beam.

    Note:
        An end is inferred, not measured. A black vehicle close by is taken for an obstacle only where its other parts
        return; sky that leaves enclose counts as an obstacle.

    Example:
        >>> azimuth = np.radians(np.arange(0.0, 360.0, 1.0))
        >>> ring = lambda e: np.stack([np.cos(azimuth) * np.cos(e), np.sin(azimuth) * np.cos(e),
        ...     np.full(360, np.sin(e))], -1)
        >>> elevations = np.radians(np.arange(-20.0, 0.0))
        >>> road = np.concatenate([ring(e) * -1.7 / np.sin(e) for e in elevations])
        >>> up_and_down = np.array([[0.995, 0.0, 0.0998], [0.995, 0.0, -0.0998]])
        >>> ends = beam_ends(road, up_and_down, 120.0)
        >>> [BeamEnd(e).name for e in ends.end], ends.distance_m.round(1).tolist()
        (['SKY', 'GROUND'], [120.0, 17.0])
    """
    check_arguments(
        "beam_ends(points_xyz: array, direction: array, max_range_m: float, ring: array | None, "
        "direction_ring: array | None, origin_height_m: array | float, step_deg: float, ground: GroundPlane | None)",
        points_xyz,
        direction,
        max_range_m,
        ring,
        direction_ring,
        origin_height_m,
        step_deg,
        ground,
    )
    max_range_m, step_deg = float(max_range_m), float(step_deg)
    xyz = np.asarray(points_xyz, dtype=np.float64)
    direction = np.asarray(direction, dtype=np.float64)
    if not np.isfinite(direction).all() or not (np.abs(xyz) < 1e9).all():
        raise InputValueError("beam_ends: direction must be finite, points_xyz finite and below 1e9 m.")
    if xyz.ndim != 2 or xyz.shape[1] != 3 or direction.ndim != 2 or direction.shape[1] != 3:
        raise InputValueError(
            f"beam_ends: points_xyz and direction must be (N, 3) and (M, 3); got {xyz.shape} and {direction.shape}."
        )
    if ground is None:
        ground = fit_ground(xyz)
    count = len(direction)
    road_m = np.full(count, np.inf) if ground is None else ground.distance_along(direction, origin_height_m)
    if not count or not len(xyz):
        return BeamEnds(np.minimum(road_m, max_range_m), _road_or_sky(road_m, max_range_m), ground)
    raised = np.ones(len(xyz), bool) if ground is None else ground.height_above(xyz) > _RAISED_M
    raster = SweepRaster(xyz, raised, direction, step_deg, ring, direction_ring)
    left, right, above, below = raster.neighbours(_ENCLOSED_AZIMUTH_DEG, _ENCLOSED_ELEVATION_DEG)
    beside_m = np.minimum(left.range_m, right.range_m)
    between = np.isfinite(left.range_m) & np.isfinite(right.range_m)
    narrow = between & (left.away_deg + right.away_deg < _NARROW_DEG + 2 * step_deg)
    upright = np.isfinite(above.range_m) & np.isfinite(below.range_m)
    enclosed = narrow | (between & np.isfinite(above.range_m)) | (upright & ~between)
    enclosing_m = np.where(between, beside_m, np.minimum(above.range_m, below.range_m))
    end = _road_or_sky(road_m, max_range_m)
    distance_m = np.minimum(road_m, max_range_m)
    obstacle = enclosed & (enclosing_m * _GROUND_RATIO < distance_m)
    end[obstacle] = BeamEnd.OBSTACLE
    distance_m[obstacle] = enclosing_m[obstacle]
    own = own_vehicle
    if own is not None and (not isinstance(own, np.ndarray) or own.dtype != np.bool_ or own.shape != end.shape):
        raise InputValueError(f"beam_ends: own_vehicle must be a mask {end.shape}; got {own!r:.100}.")
    if own is None:
        # Among returns from something above the ground, it is that which does not return: a dark vehicle, a pane.
        sides = (left, right, above, below)
        raised_sides = np.sum([side.raised for side in sides], 0)
        level_sides = np.sum([np.isfinite(side.range_m) & ~side.raised for side in sides], 0)
        own = raster.regions(
            width_deg=_OWN_WIDTH_DEG,
            below=np.isfinite(road_m),
            reaching=road_m < _OWN_ROAD_M,
            except_=(raised_sides > 0) & (raised_sides >= level_sides),
        )
    end[own] = BeamEnd.OWN_VEHICLE
    distance_m[own] = 0.0
    return BeamEnds(distance_m, end, ground)


def ways_above_ground(points_xyz: Numbers, ground: GroundPlane | None, origin_height_m: Numbers | float) -> Numbers:
    """Way of beams with a return on which particles may lie: ``inf``, or to the ground for a return below it.

    Args:
        points_xyz: ``(N, 3)`` returns, metres in the sensor's frame.
        ground: the plane, or ``None``.
        origin_height_m: ``(N,)`` heights at which the beams start.

    Returns:
        ``(N,)`` metres.

    Example:
        >>> returns = np.array([[10.0, 0.0, -1.0], [10.0, 0.0, -3.4]])
        >>> ways_above_ground(returns, GroundPlane(-1.7, 0.0, 0.0, 0.0), 0.0).round(2).tolist()
        [inf, 6.06]
    """
    way = np.full(len(points_xyz), np.inf)
    if ground is None:
        return way
    below = ground.height_above(points_xyz) < -_BELOW_GROUND_M
    if below.any():
        height = np.broadcast_to(np.asarray(origin_height_m, np.float64), way.shape)[below]
        beam = points_xyz[below].astype(np.float64)
        beam[:, 2] -= height
        lower = replace(ground, height_m=ground.height_m - _BELOW_GROUND_M)
        way[below] = lower.distance_along(beam / np.linalg.norm(beam, axis=-1, keepdims=True), height)
    return way


def _road_or_sky(road_m: Numbers, max_range_m: float) -> npt.NDArray[np.int8]:
    kind: npt.NDArray[np.int8] = np.where(road_m < max_range_m, BeamEnd.GROUND, BeamEnd.SKY).astype(np.int8)
    return kind
