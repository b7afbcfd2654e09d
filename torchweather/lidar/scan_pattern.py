"""Scan pattern of a LiDAR, estimated from its sweep: ring of each point, cones of the lasers, columns a turn."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt
from torch import Tensor

from torchweather.lidar.azimuth_step import fit_azimuth_step
from torchweather.lidar.cone_fit import fit_cones
from torchweather.lidar.ring_order import rings_from_order

if TYPE_CHECKING:
    from torchweather.sensors.lidar import Lidar

__all__ = ["ScanPattern", "estimate_pattern"]

Numbers = npt.NDArray[np.floating[Any]]
Integers = npt.NDArray[np.integer[Any]]

_TURN_DEG = 360.0


@dataclass(frozen=True)
class ScanPattern:
    """Scan pattern of a sweep. K rings in the order of their numbers; NaN for a ring without points.

    Args:
        ring: ``(N,)`` int64 ring of each row of the cloud, -1 for a row without return.
        elevations_deg: ``(K,)`` elevation of each ring's beams, seen from their start.
        heights_m: ``(K,)`` height over the origin at which they start.
        columns: firings of a ring per turn.
        phase_deg: ``(K,)`` azimuth of a firing of each ring, modulo ``step_deg``.
        counts: ``(K,)`` points.
        step_deg: azimuth from one firing to the next; ``columns`` is 360 over it, rounded.
        elevation_spread_deg: ``(K,)`` standard deviation of the points about the ring's cone.
        elevation_error_deg: ``(K,)`` standard error of the elevation.
        height_error_m: ``(K,)`` standard error of the height; infinite where the sweep cannot tell it (then the height
            is that of the other rings, or 0).
        columns_interval: low and high end of the 95 percent interval of ``columns``.
        phase_spread_deg: ``(K,)`` spread of the azimuths about the phase.
        found_by: ``file order``, ``ring column`` or ``elevations``.
        notes: sentences about what does not fit; empty where all does.
    """

    ring: Integers
    elevations_deg: Numbers
    heights_m: Numbers
    columns: int
    phase_deg: Numbers
    counts: Integers
    step_deg: float
    elevation_spread_deg: Numbers
    elevation_error_deg: Numbers
    height_error_m: Numbers
    columns_interval: tuple[float, float]
    phase_spread_deg: Numbers
    found_by: str
    notes: tuple[str, ...] = ()

    @property
    def rings(self) -> int:
        """Number of rings."""
        return len(self.elevations_deg)

    def applied_to(self, lidar: Lidar) -> Lidar:
        """The same sensor with this pattern: elevations, heights, columns and azimuths of the rings.

        A ring without points keeps the sensor's elevation where the number of rings is the same; otherwise it lies
        evenly between its neighbours.

        Example:
            >>> from torchweather import Lidar
            >>> azimuth = np.radians(np.arange(0.0, 360.0))
            >>> ring = np.stack([9.0 * np.cos(azimuth), 9.0 * np.sin(azimuth), np.full(360, -1.0)], -1)
            >>> lidar = estimate_pattern(ring).applied_to(Lidar(905.0))
            >>> round(lidar.elevations_deg[0], 2), lidar.columns
            (-6.34, 360)
        """
        same = lidar.elevations_deg is not None and len(lidar.elevations_deg) == self.rings
        elevations = _filled(self.elevations_deg, lidar.elevations_deg if same else None)
        heights = _filled(self.heights_m, lidar.origin_heights_m if same else None)
        phase = np.where(np.isnan(self.phase_deg), 0.0, self.phase_deg)
        return replace(
            lidar,
            elevations_deg=tuple(elevations.tolist()),
            origin_heights_m=tuple(heights.tolist()),
            columns=self.columns,
            azimuth_offsets_deg=tuple(phase.tolist()),
        )


def estimate_pattern(
    points: Tensor | Numbers, ring: Tensor | Integers | None = None, rings: int | None = None
) -> ScanPattern:
    """Estimate the scan pattern of one sweep.

    Args:
        points: ``(N, 3 or more)`` one turn: x, y, z in metres in the sensor's frame, x forward, y left, z up; a row
            that is 0, 0, 0 or not finite is no return.
        ring: ``(N,)`` integers, ring of each row, below 0 for none; ``None`` takes the order of the rows.
        rings: number of rings of the sensor; ``None`` is as many as are found.

    Returns:
        The pattern, with how sure it is.

    Raises:
        ValueError: the sweep does not show a pattern, or another than declared.

    Example:
        >>> azimuth = np.radians(np.arange(0.0, 360.0, 2.0))
        >>> def row(elevation_deg):
        ...     rho = 10.0 + 5.0 * np.cos(3.0 * azimuth)
        ...     z = 0.1 + rho * np.tan(np.radians(elevation_deg))
        ...     return np.stack([rho * np.cos(azimuth), rho * np.sin(azimuth), z], -1)
        >>> pattern = estimate_pattern(np.concatenate([row(2.0), row(-1.0)]))
        >>> pattern.elevations_deg.round(3).tolist(), pattern.heights_m.round(3).tolist(), pattern.columns
        ([2.0, -1.0], [0.1, 0.1], 180)
        >>> pattern.found_by
        'file order'
    """
    values = points.detach().cpu().numpy() if isinstance(points, Tensor) else np.asarray(points)
    if values.ndim != 2 or values.shape[1] < 3 or values.dtype.kind != "f":
        raise ValueError(
            "estimate_pattern: points must be one cloud of floating point (N, 3 or more) = x, y, z in metres; got "
            f"{values.dtype}, {values.shape}."
        )
    xyz = values[:, :3]
    seen = np.isfinite(xyz).all(1) & (np.abs(xyz[:, :2]).max(1, initial=0.0) > 0)
    if ring is not None:
        given = ring.detach().cpu().numpy() if isinstance(ring, Tensor) else np.asarray(ring)
        if given.shape != (len(xyz),):
            raise ValueError(f"estimate_pattern: ring must have shape ({len(xyz)},), one per row; got {given.shape}.")
        seen &= given >= 0
        number: Integers | None = given[seen].astype(np.int64)
        found_by = "ring column"
    else:
        number, found_by = rings_from_order(xyz[seen]), "file order"
    xyz = xyz[seen].astype(np.float64)
    if number is None or not len(number):
        raise ValueError(
            "estimate_pattern: the order of the rows shows no rings (they are shuffled, thinned, or in another frame). "
            "Pass ring=..., the ring of each row."
        )
    found = max(int(number.max()) + 1, rings or 0)
    if rings is not None and found != rings:
        raise ValueError(f"estimate_pattern: {rings} rings were declared, but the sweep shows {found}.")
    azimuth = np.degrees(np.arctan2(xyz[:, 1], xyz[:, 0]))
    step = fit_azimuth_step(azimuth, number, found)
    if step is None:
        raise ValueError(
            f"estimate_pattern: too few neighbours on the rings to tell the azimuth step; got {len(xyz)} returns on "
            f"{found} rings. Pass a whole sweep."
        )
    cones = fit_cones(xyz, number, found)
    every = np.full(len(seen), -1, dtype=np.int64)
    every[seen] = number
    low, high = (_TURN_DEG / (step.step_deg + sign * 1.96 * step.step_error_deg) for sign in (1.0, -1.0))
    return ScanPattern(
        ring=every,
        elevations_deg=cones.elevation_deg,
        heights_m=cones.height_m,
        columns=round(_TURN_DEG / step.step_deg),
        phase_deg=step.phase_deg,
        counts=cones.count,
        step_deg=step.step_deg,
        elevation_spread_deg=cones.spread_deg,
        elevation_error_deg=cones.elevation_error_deg,
        height_error_m=cones.height_error_m,
        columns_interval=(low, high),
        phase_spread_deg=step.phase_spread_deg,
        found_by=found_by,
    )


def _filled(values: Numbers, instead: tuple[float, ...] | None) -> Numbers:
    """Values with the gaps (NaN) filled from ``instead``, or in equal steps between the neighbours."""
    gap = np.isnan(values)
    if not gap.any():
        return values
    if instead is not None:
        return np.where(gap, np.asarray(instead), values)
    place = np.arange(len(values))
    return np.interp(place, place[~gap], values[~gap])
