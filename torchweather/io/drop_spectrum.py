"""Measured drop size spectra: drops per cubic metre and millimetre of diameter, from what a disdrometer counted."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from torchweather.core.arguments import check_arguments
from torchweather.core.errors import InputTypeError, InputValueError, check_at_least, check_finite, check_positive
from torchweather.physics import rain_fall_speed_m_per_s

__all__ = ["DropSpectrum", "spectrum_from_counts", "spectrum_from_drops"]

# R = 3.6e-3 / (t A) sum (pi/6) D^3: mm^3 per m^2 and second to mm/h.
_MM_PER_H_PER_MM3 = 3.6e-3 * math.pi / 6.0
_MOST_INTERVALS = 2_000_000  # nearly four years of minutes


@dataclass(frozen=True, eq=False)
class DropSpectrum:
    """Drop size spectra of consecutive intervals.

    Args:
        edges_mm: class edges of the diameter, mm, ``(K + 1,)`` float64.
        density_per_m3_mm: drops per cubic metre and mm of diameter, ``(T, K)`` float64.
        rate_mm_per_h: rain rate of the same drops, ``(T,)``.
        duration_s: length of one interval, seconds.
        time_s: end of the interval or its label in the file, seconds since 1970 UTC, ``(T,)``.
        instrument: what measured.
        reported_rate_mm_per_h: what the instrument itself reported, ``(T,)``; None where the file has none.
        reported_mor_m: visibility that the instrument reported, ``(T,)``; None where the file has none.
    """

    edges_mm: Tensor
    density_per_m3_mm: Tensor
    rate_mm_per_h: Tensor
    duration_s: float
    time_s: Tensor
    instrument: str
    reported_rate_mm_per_h: Tensor | None = None
    reported_mor_m: Tensor | None = None

    def chosen(self, which: Tensor) -> DropSpectrum:
        """The spectra of some intervals.

        Args:
            which: ``(T,)`` bool, or interval numbers.
        """
        return replace(
            self,
            density_per_m3_mm=self.density_per_m3_mm[which],
            rate_mm_per_h=self.rate_mm_per_h[which],
            time_s=self.time_s[which],
            reported_rate_mm_per_h=None if self.reported_rate_mm_per_h is None else self.reported_rate_mm_per_h[which],
            reported_mor_m=None if self.reported_mor_m is None else self.reported_mor_m[which],
        )

    def mean(self) -> DropSpectrum:
        """One spectrum, the mean over the intervals; the reported visibility is averaged as extinction, 1/V."""
        if len(self.time_s) == 0:
            raise InputValueError("DropSpectrum: the mean of no interval; choose at least one.")
        mor = self.reported_mor_m
        return replace(
            self,
            density_per_m3_mm=self.density_per_m3_mm.mean(0, keepdim=True),
            rate_mm_per_h=self.rate_mm_per_h.mean(0, keepdim=True),
            duration_s=self.duration_s * len(self.time_s),
            time_s=self.time_s[-1:],
            reported_rate_mm_per_h=(
                None if self.reported_rate_mm_per_h is None else self.reported_rate_mm_per_h.mean(0, keepdim=True)
            ),
            reported_mor_m=None if mor is None else 1.0 / (1.0 / mor).mean(0, keepdim=True),
        )


def spectrum_from_counts(
    counts: Tensor,
    edges_mm: Tensor,
    speed_m_per_s: Tensor,
    *,
    duration_s: float,
    area_mm2: Tensor,
    time_s: Tensor,
    instrument: str,
    fall_speed_tolerance: float = 0.5,
    reported_rate_mm_per_h: Tensor | None = None,
    reported_mor_m: Tensor | None = None,
) -> DropSpectrum:
    """Drops in the air from drops counted by size and speed.

    ``N_k = sum_v n_kv / (A_k t v dD_k)``: in the time t all drops within ``v t`` above the area A fall through it.
    Rate: ``R = 3.6e-3 / (t A) sum n (pi/6) D^3`` with t in s, A in m^2, D in mm.

    Args:
        counts: ``(T, K, V)``, drops by diameter class and speed class.
        edges_mm: ``(K + 1,)``.
        speed_m_per_s: class centres, ``(V,)``, above 0.
        duration_s: of one interval.
        area_mm2: sensing area by diameter class, ``(K,)``.
        time_s: ``(T,)``, seconds since 1970.
        instrument: what measured.
        fall_speed_tolerance: see `read_disdrometer`.
        reported_rate_mm_per_h: ``(T,)`` or None.
        reported_mor_m: ``(T,)`` or None.

    Example:
        >>> found = spectrum_from_counts(
        ...     torch.tensor([[[540.0]]]), torch.tensor([0.9, 1.1]), torch.tensor([4.0]), duration_s=60.0,
        ...     area_mm2=torch.tensor([5400.0]), time_s=torch.zeros(1), instrument="one class")
        >>> round(float(found.density_per_m3_mm))        # 540 / (0.0054 m2 60 s 4 m/s 0.2 mm)
        2083
    """
    check_arguments(
        "spectrum_from_counts(counts: real, edges_mm: real, speed_m_per_s: real, duration_s: float, "
        "area_mm2: real, time_s: Tensor, instrument: str, fall_speed_tolerance: float, "
        "reported_rate_mm_per_h: Tensor | None, reported_mor_m: Tensor | None)",
        counts,
        edges_mm,
        speed_m_per_s,
        duration_s,
        area_mm2,
        time_s,
        instrument,
        fall_speed_tolerance,
        reported_rate_mm_per_h,
        reported_mor_m,
    )
    owner = "spectrum_from_counts"
    counts, edges, speed, area, time = _numbers(
        owner, counts=counts, edges_mm=edges_mm, speed_m_per_s=speed_m_per_s, area_mm2=area_mm2, time_s=time_s
    )
    classes = len(_edges(edges, owner)) - 1
    expected = {"counts": (len(time), classes, len(speed)), "area_mm2": (classes,), "speed_m_per_s": (len(speed),)}
    for name, value in (("counts", counts), ("area_mm2", area), ("speed_m_per_s", speed)):
        if tuple(value.shape) != expected[name]:
            raise InputValueError(f"{owner}: {name} must have shape {expected[name]}; got {tuple(value.shape)}.")
    check_at_least("counts", counts, 0, owner=owner)
    check_positive("speed_m_per_s", speed, unit="m/s", owner=owner)
    check_positive("area_mm2", area, unit="mm^2", owner=owner)
    duration_s = _check_interval(duration_s, fall_speed_tolerance, owner)
    diameter = 0.5 * (edges[1:] + edges[:-1])
    law = rain_fall_speed_m_per_s(diameter)[:, None]
    counts = torch.where((speed - law).abs() <= fall_speed_tolerance * law, counts, 0.0)
    seconds_m2 = duration_s * area * 1e-6
    density = (counts / speed).sum(-1) / (seconds_m2 * edges.diff())
    rate = _MM_PER_H_PER_MM3 * (counts.sum(-1) * diameter**3 / seconds_m2).sum(-1)
    _check_result(density, rate, owner)
    return DropSpectrum(
        edges_mm=edges,
        density_per_m3_mm=density,
        rate_mm_per_h=rate,
        duration_s=float(duration_s),
        time_s=time,
        instrument=instrument,
        reported_rate_mm_per_h=reported_rate_mm_per_h,
        reported_mor_m=reported_mor_m,
    )


def spectrum_from_drops(
    diameter_mm: Tensor,
    speed_m_per_s: Tensor,
    area_mm2: Tensor,
    time_s: Tensor,
    *,
    edges_mm: Tensor,
    duration_s: float,
    instrument: str,
    fall_speed_tolerance: float = 0.5,
) -> DropSpectrum:
    """Drops in the air from drops measured one by one: each stands for ``1 / (A t v)`` per cubic metre.

    Args:
        diameter_mm: ``(N,)``, of the sphere of equal volume.
        speed_m_per_s: ``(N,)``, above 0.
        area_mm2: ``(N,)``, sensing area of each drop.
        time_s: ``(N,)``, seconds since 1970.
        edges_mm: ``(K + 1,)``, rising; drops outside are left out.
        duration_s: interval into which the drops are sorted.
        instrument: what measured.
        fall_speed_tolerance: see `read_disdrometer`.
    """
    check_arguments(
        "spectrum_from_drops(diameter_mm: real, speed_m_per_s: real, area_mm2: real, time_s: Tensor, "
        "edges_mm: real, duration_s: float, instrument: str, fall_speed_tolerance: float)",
        diameter_mm,
        speed_m_per_s,
        area_mm2,
        time_s,
        edges_mm,
        duration_s,
        instrument,
        fall_speed_tolerance,
    )
    owner = "spectrum_from_drops"
    diameter, speed, area, time, edges = _numbers(
        owner, diameter_mm=diameter_mm, speed_m_per_s=speed_m_per_s, area_mm2=area_mm2, time_s=time_s, edges_mm=edges_mm
    )
    _edges(edges, owner)
    if time.numel() == 0:
        raise InputValueError(f"{owner}: expected one drop or more; got none.")
    if {tuple(value.shape) for value in (diameter, speed, area, time)} != {(len(time),)}:
        shapes = ", ".join(str(tuple(value.shape)) for value in (diameter, speed, area, time))
        raise InputValueError(f"{owner}: diameters, speeds, areas and times must be (N,) each; got {shapes}.")
    check_positive("area_mm2", area, unit="mm^2", owner=owner)
    duration_s = _check_interval(duration_s, fall_speed_tolerance, owner)
    span = float(time.max() - time.min()) / duration_s
    if not span < _MOST_INTERVALS:
        raise InputValueError(
            f"{owner}: time_s must span at most {_MOST_INTERVALS:,} intervals of {duration_s:g} s; got {span:.3g}. "
            "Read the times in seconds, or choose a longer duration_s."
        )
    start = torch.floor(time.min() / duration_s) * duration_s
    interval = torch.floor((time - start) / duration_s).long()
    intervals, classes = int(interval.max()) + 1, len(edges) - 1
    size = torch.bucketize(diameter, edges, right=True) - 1
    law = rain_fall_speed_m_per_s(diameter.clamp_min(1e-3))
    kept = (size >= 0) & (size < classes) & (speed > 0) & ((speed - law).abs() <= fall_speed_tolerance * law)
    cell = (interval * classes + size)[kept]
    per_m3 = 1.0 / (area[kept] * 1e-6 * duration_s * speed[kept])
    density = torch.zeros(intervals * classes, dtype=torch.float64).index_add(0, cell, per_m3)
    flux = _MM_PER_H_PER_MM3 * diameter[kept] ** 3 / (area[kept] * 1e-6 * duration_s)
    rate = torch.zeros(intervals, dtype=torch.float64).index_add(0, interval[kept], flux)
    density = density.view(intervals, classes) / edges.diff()
    _check_result(density, rate, owner)
    return DropSpectrum(
        edges_mm=edges,
        density_per_m3_mm=density,
        rate_mm_per_h=rate,
        duration_s=float(duration_s),
        time_s=start + duration_s * torch.arange(1, intervals + 1, dtype=torch.float64),
        instrument=instrument,
    )


def _numbers(owner: str, **values: Tensor) -> list[Tensor]:
    """Finite numbers as float64; an axis of one stands for a single number."""
    found = []
    for name, value in values.items():
        if not isinstance(value, Tensor) or value.is_complex() or value.dtype == torch.bool or value.ndim == 0:
            got = f"{value.dtype} {tuple(value.shape)}" if isinstance(value, Tensor) else repr(value)
            raise InputTypeError(f"{owner}: {name} must be a tensor of real numbers; got {got}.")
        check_finite(name, value, owner=owner)
        found.append(value.to(torch.float64).contiguous())
    return found


def _edges(edges: Tensor, owner: str) -> Tensor:
    if edges.ndim != 1 or len(edges) < 2 or not bool((edges.diff() > 0).all()) or float(edges[0]) < 0:
        raise InputValueError(f"{owner}: edges_mm must be (K + 1,), 0 mm or more, and rise; got {tuple(edges.shape)}.")
    return edges


def _check_interval(duration_s: float, fall_speed_tolerance: float, owner: str) -> float:
    check_arguments(f"{owner}(duration_s: float, fall_speed_tolerance: float)", duration_s, fall_speed_tolerance)
    check_positive("duration_s", duration_s, unit="s", owner=owner)
    check_finite("duration_s", duration_s, unit="s", owner=owner)
    check_at_least("fall_speed_tolerance", fall_speed_tolerance, 0, owner=owner)
    if fall_speed_tolerance > 1e9 and not math.isinf(fall_speed_tolerance):
        raise InputValueError(f"{owner}: fall_speed_tolerance must be a share, or inf; got {fall_speed_tolerance:g}.")
    return float(duration_s)


def _check_result(density: Tensor, rate: Tensor, owner: str) -> None:
    """Refuse numbers of drops, areas or durations whose quotients overflow."""
    if not bool(density.isfinite().all() and rate.isfinite().all()):
        raise InputValueError(f"{owner}: the drops make an infinite density or rate. Check the counts and units.")
