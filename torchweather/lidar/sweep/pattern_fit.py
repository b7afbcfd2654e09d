"""Scan pattern of a sensor from several of its sweeps: the rings that they share, and how far they differ."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt
from torch import Tensor

from torchweather.core.arguments import check_arguments
from torchweather.core.errors import InputValueError
from torchweather.lidar.sweep.scan_pattern import ScanPattern, estimate_pattern, filled

if TYPE_CHECKING:
    from torchweather.lidar.sensor import Lidar

__all__ = ["PatternFit", "combine_patterns", "fit_pattern"]

Numbers = npt.NDArray[np.floating[Any]]
Integers = npt.NDArray[np.integer[Any]]

# Rings of two sweeps are the same where their elevations differ by less than this share of their distance.
_SAME_RING = 0.5
_SAME_SENSOR_DEG = 1.0
_NORMAL_95 = 1.96
_MAD_TO_STD = 1.4826


@dataclass(frozen=True)
class PatternFit:
    """Scan pattern of a sensor. K rings in the order of the ring column where there is one, else the lowest first.

    Args:
        elevations_deg: ``(K,)`` median over the sweeps.
        elevation_interval_deg: ``(K,)`` half the 95 percent interval of it.
        heights_m: ``(K,)`` height at which the beams start, median over the sweeps.
        height_interval_m: ``(K,)`` half the 95 percent interval; infinite where no sweep tells it.
        spread_deg: ``(K,)`` standard deviation of the points about their cone.
        columns: firings of a ring per turn, median over the sweeps.
        columns_range: fewest and most of a sweep: the turning speed drifts.
        sweeps: number of sweeps.
        found_by: how the rings were found.
        notes: what did not fit, each sentence once.
    """

    elevations_deg: Numbers
    elevation_interval_deg: Numbers
    heights_m: Numbers
    height_interval_m: Numbers
    spread_deg: Numbers
    columns: int
    columns_range: tuple[int, int]
    sweeps: int
    found_by: str
    notes: tuple[str, ...]

    @property
    def rings(self) -> int:
        """Number of rings."""
        return len(self.elevations_deg)

    def applied_to(self, lidar: Lidar) -> Lidar:
        """The same sensor with this pattern; it keeps its azimuth offsets where its rings are the same ones."""
        return replace(lidar, **self.fields(lidar))

    def fields(self, lidar: Lidar) -> dict[str, Any]:
        """Fields of a sensor that this pattern replaces.

        Sweeps tell azimuth offsets to a step only. Where ``lidar`` has as many rings within a degree, its offsets stay,
        and so does the order of its rings, unless a ring column gave another.
        """
        elevation, height = self.elevations_deg, self.heights_m
        same = False
        if lidar.elevations_deg is not None and len(lidar.elevations_deg) == self.rings:
            known = np.asarray(lidar.elevations_deg)
            if self.found_by != "ring column":
                place = np.argsort(np.argsort(known))  # the lowest ring is first here
                elevation, height = elevation[place], height[place]
            same = bool(np.nanmax(np.abs(known - elevation)) < _SAME_SENSOR_DEG)
        elevation = filled(elevation, lidar.elevations_deg if same else None)
        height = filled(height, lidar.origin_heights_m if same else None)
        return {
            "elevations_deg": tuple(np.round(elevation, 3).tolist()),
            "origin_heights_m": tuple(np.round(height, 4).tolist()),
            "columns": self.columns,
            "azimuth_offsets_deg": lidar.azimuth_offsets_deg if same else None,
        }


def fit_pattern(
    clouds: Iterable[Tensor | Numbers],
    ring: Sequence[Tensor | Integers] | None = None,
    rings: int | None = None,
    *,
    min_range_m: float = 0.0,
) -> PatternFit:
    """Fit the scan pattern of a sensor to several of its sweeps.

    Args:
        clouds: sweeps ``(N, 3 or more)``, as ``estimate_pattern`` takes them.
        ring: ring of every row of each sweep; ``None`` finds them.
        rings: number of rings; ``None`` takes as many as the sweeps show.
        min_range_m: nearer rows are no returns.

    Returns:
        The pattern, with 95 percent intervals: from the scatter of the sweeps, or within the sweep if there is one.

    Raises:
        ValueError: a sweep shows no pattern, or the sweeps are not of one sensor.

    Example:
        >>> azimuth = np.radians(np.arange(0.0, 360.0, 2.0))
        >>> def sweep(shift):
        ...     rho = 10.0 + 5.0 * np.cos(3.0 * azimuth + shift)
        ...     rows = [(rho, 0.1 + rho * np.tan(np.radians(e))) for e in (2.0, -1.0)]
        ...     return np.concatenate([np.stack([r * np.cos(azimuth), r * np.sin(azimuth), z], -1) for r, z in rows])
        >>> fit = fit_pattern([sweep(0.0), sweep(1.0)])
        >>> fit.elevations_deg.round(2).tolist(), fit.columns, fit.sweeps
        ([-1.0, 2.0], 180, 2)
    """
    check_arguments(
        "fit_pattern(clouds: Iterable, ring: Sequence | None, rings: int | None, min_range_m: float)",
        clouds,
        ring,
        rings,
        min_range_m,
    )
    sweeps = list(clouds)
    columns = [None] * len(sweeps) if ring is None else list(ring)
    if not sweeps or len(columns) != len(sweeps):
        raise InputValueError(
            f"fit_pattern: expected sweeps, and a ring column for each or none; got {len(sweeps)} and {len(columns)}."
        )
    return combine_patterns(
        [
            estimate_pattern(cloud, column, rings, min_range_m=min_range_m)
            for cloud, column in zip(sweeps, columns, strict=True)
        ]
    )


def combine_patterns(patterns: Sequence[ScanPattern]) -> PatternFit:
    """Combine the patterns of several sweeps of one sensor; see `fit_pattern`."""
    counts = sorted({pattern.rings for pattern in patterns})
    if len(counts) != 1:
        raise InputValueError(
            f"fit_pattern: expected sweeps of one sensor with as many rings each; got {counts[0]} to {counts[-1]} "
            "rings. Fit the sensors, or the parts of sweeps, one by one."
        )
    elevation, height, spread, own_elevation, own_height = (
        np.stack([getattr(pattern, name)[_order(pattern)] for pattern in patterns])
        for name in ("elevations_deg", "heights_m", "elevation_spread_deg", "elevation_error_deg", "height_error_m")
    )
    _check_same(elevation)
    known = np.isfinite(own_height)
    certain = np.where(known, height, np.nan)
    heights = np.where(known.any(0), _nanmedian(certain), _nanmedian(height))
    columns = sorted(pattern.columns for pattern in patterns)
    return PatternFit(
        elevations_deg=_nanmedian(elevation),
        elevation_interval_deg=_half_interval(elevation, own_elevation),
        heights_m=heights,
        height_interval_m=np.where(known.any(0), _half_interval(certain, np.where(known, own_height, np.nan)), np.inf),
        spread_deg=_nanmedian(spread),
        columns=round(float(np.median(columns))),
        columns_range=(columns[0], columns[-1]),
        sweeps=len(patterns),
        found_by=", ".join(sorted({pattern.found_by for pattern in patterns})),
        notes=tuple(dict.fromkeys(note for pattern in patterns for note in pattern.notes)),
    )


def _order(pattern: ScanPattern) -> Integers:
    """Rings as the column numbers them, or from the lowest to the highest."""
    if pattern.found_by == "ring column":
        return np.arange(pattern.rings)
    order: Integers = np.argsort(filled(pattern.elevations_deg, None), kind="stable")
    return order


def _check_same(elevation: Numbers) -> None:
    middle = _nanmedian(elevation)
    apart = float(np.nanmedian(np.abs(np.diff(middle)))) if len(middle) > 1 else np.inf
    off = np.nanmedian(np.abs(elevation - middle), axis=1)
    worst = int(off.argmax())
    if off[worst] > _SAME_RING * apart:
        raise InputValueError(
            f"fit_pattern: expected sweeps of one sensor; sweep {worst} has its rings {off[worst]:.2f} degrees beside "
            "those of the others. Fit it by itself."
        )


def _half_interval(values: Numbers, own_error: Numbers) -> Numbers:
    """Half the 95 percent interval of the median: from the scatter of the sweeps, never below a sweep's own error."""
    number = np.maximum(np.isfinite(values).sum(0), 1)
    own = _nanmedian(own_error) / np.sqrt(number)
    if len(values) == 1:
        return np.asarray(_NORMAL_95 * own)
    scatter = _MAD_TO_STD * _nanmedian(np.abs(values - _nanmedian(values)))
    # A median of n values scatters by 1.2533 of their mean's standard error.
    return np.asarray(_NORMAL_95 * np.maximum(1.2533 * scatter / np.sqrt(number), own))


def _nanmedian(values: Numbers) -> Numbers:
    empty = ~np.isfinite(values).any(0)
    middle: Numbers = np.nanmedian(np.where(empty, 0.0, values), axis=0)
    filled: Numbers = np.where(empty, np.nan, middle)
    return filled
