"""Near-range response of a LiDAR's receiver, from recordings with the signal and the reflectivity of every return.

A target of reflectivity rho at range R gives ``S = K rho xi(R) / R^2`` photons; xi is 1 far away and falls near the
sensor, where the receiver does not see all of the spot. So ``S R^2 / rho`` shows K and xi without any weather.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt
from torch import Tensor

from torchweather.core.arrays import as_numpy
from torchweather.core.errors import InputValueError

if TYPE_CHECKING:
    from torchweather.lidar.sensor import Lidar

__all__ = ["NearResponseFit", "fit_near_response"]

Numbers = npt.NDArray[np.floating[Any]]

# Returns of a diffuse target whose reflectivity is not lost in its rounding (uint8_calibrated: 2 percent and more).
_DARKEST, _BRIGHTEST = 0.02, 1.0
_BINS_PER_E = 10  # bins of range, per factor e
_FEWEST_IN_BIN = 30
_FEWEST_BINS = 5
# Candidates of the range from which on the response is full, metres.
_FULL_M = np.geomspace(2.0, 120.0, 240)
_PARTS = 10
_STUDENT_95 = 2.262  # 9 degrees of freedom


@dataclass(frozen=True)
class NearResponseFit:
    """Response ``xi(R) = min(1, R / near_full_m) ** near_power`` and the photon constant K.

    Args:
        photon_constant: K, photons m^2 of a white target at full response; half its 95 percent interval beside it.
        near_full_m: range from which on the response is full, and half its interval.
        near_power: exponent below, and half its interval.
        range_m: ``(M,)`` middles of the bins of range.
        response: ``(M,)`` median of ``S R^2 / (rho K)`` of each bin.
        spread: ``(M,)`` standard deviation within the bin (from the median deviation).
        count: ``(M,)`` returns.
        notes: what the recording cannot tell.
    """

    photon_constant: float
    photon_constant_interval: float
    near_full_m: float
    near_full_interval_m: float
    near_power: float
    near_power_interval: float
    range_m: Numbers
    response: Numbers
    spread: Numbers
    count: npt.NDArray[np.integer[Any]]
    notes: tuple[str, ...]

    def xi(self, range_m: Numbers) -> Numbers:
        """Fitted response at ranges in metres."""
        response: Numbers = np.minimum(1.0, np.asarray(range_m) / self.near_full_m) ** self.near_power
        return response

    def photons_at_threshold(self, range_at_10_percent_m: float) -> float:
        """Photons of a 10 percent target at the range at which the sensor just detects it: ``0.1 K / R10^2``."""
        return 0.1 * self.photon_constant / range_at_10_percent_m**2

    def applied_to(self, lidar: Lidar) -> Lidar:
        """The same sensor with this response and photon constant."""
        return replace(
            lidar,
            near_start_m=0.0,
            near_full_m=round(self.near_full_m, 2),
            near_power=round(self.near_power, 3),
            photons_at_threshold=round(self.photons_at_threshold(lidar.range_at_10_percent_m), 3),
        )


def fit_near_response(
    signal: Tensor | Numbers | Sequence[float],
    reflectivity: Tensor | Numbers | Sequence[float],
    range_m: Tensor | Numbers | Sequence[float],
) -> NearResponseFit:
    """Fit the near-range response and the photon constant.

    Bins of range of 10 percent; of each the median of ``log(S R^2 / rho)``, so that a bin counts once, however many
    returns it has; least squares over K and the power for each of 240 ranges of full response. Intervals: jackknife
    over ten parts of the rows in their order.

    Args:
        signal: ``(N,)`` photons, not corrected for range (Ouster: SIGNAL).
        reflectivity: ``(N,)`` of the same returns, 1 = white (Ouster: REFLECTIVITY / 100, up to 1).
        range_m: ``(N,)`` metres; 0 is no return.

    Returns:
        The fit and the bins that it was made to.

    Raises:
        ValueError: fewer than five bins of 30 returns of diffuse targets.

    Note:
        REFLECTIVITY is the sensor's own calibration: an error of it that grows with range is taken for response. Close
        targets on the own car or on a window stand for what they are not.

    Example:
        >>> range_m = np.linspace(3.0, 90.0, 5000)
        >>> signal = 373_000 * 0.2 * np.minimum(1, range_m / 30) ** 2 / range_m**2
        >>> fit = fit_near_response(signal, np.full(5000, 0.2), range_m)
        >>> round(fit.photon_constant, -3), round(fit.near_full_m, 1), round(fit.near_power, 2)
        (373000.0, 30.0, 2.0)
    """
    s, rho, r = (_flat(values) for values in (signal, reflectivity, range_m))
    if not len(s) == len(rho) == len(r):
        raise InputValueError(
            "fit_near_response: signal, reflectivity and range_m must have one value a return each; got "
            f"{len(s)}, {len(rho)} and {len(r)}."
        )
    with np.errstate(invalid="ignore"):
        good = (s > 0) & (rho >= _DARKEST) & (rho <= _BRIGHTEST) & (r > 0) & np.isfinite(s) & np.isfinite(r)
    part = np.arange(len(s))[good] * _PARTS // max(len(s), 1)
    value, way = np.log(s[good] * r[good] ** 2 / rho[good]), np.log(r[good])
    cell = np.floor(way * _BINS_PER_E).astype(np.intp)
    cell -= cell.min(initial=0)
    middles = _bins(value, way, cell)
    if len(middles) < _FEWEST_BINS:
        raise InputValueError(
            f"fit_near_response: expected {_FEWEST_BINS} or more bins of range with {_FEWEST_IN_BIN} returns of "
            f"diffuse targets (reflectivity {_DARKEST:g} to {_BRIGHTEST:g}) each; got {len(middles)}. Pass more "
            "frames, and reflectivity with 1 = white."
        )
    best = _fitted(middles)
    left_out = np.array([_fitted(_bins(value[part != k], way[part != k], cell[part != k])) for k in range(_PARTS)])
    errors = np.sqrt((_PARTS - 1) / _PARTS * np.square(left_out - left_out.mean(0)).sum(0))
    log_constant, log_full, power = best
    full = math.exp(log_full)
    return NearResponseFit(
        photon_constant=math.exp(log_constant),
        photon_constant_interval=_STUDENT_95 * float(errors[0]) * math.exp(log_constant),
        near_full_m=full,
        near_full_interval_m=_STUDENT_95 * float(errors[1]) * full,
        near_power=power,
        near_power_interval=_STUDENT_95 * float(errors[2]),
        range_m=np.exp(middles[:, 0]),
        response=np.exp(middles[:, 1] - log_constant),
        spread=middles[:, 2] * np.exp(middles[:, 1] - log_constant),
        count=middles[:, 3].astype(np.int64),
        notes=_notes(np.exp(middles[:, 0]), full),
    )


def _flat(values: Tensor | Numbers | Sequence[float]) -> Numbers:
    array = as_numpy(values) if isinstance(values, Tensor) else np.asarray(values)
    flat: Numbers = array.reshape(-1).astype(np.float64)
    return flat


def _bins(value: Numbers, way: Numbers, cell: npt.NDArray[np.integer[Any]]) -> Numbers:
    """Middle, median, spread and count of each full bin, ``(M, 4)``."""
    found = []
    for number in np.unique(cell):
        inside = cell == number
        if inside.sum() >= _FEWEST_IN_BIN:
            middle = np.median(value[inside])
            spread = 1.4826 * np.median(np.abs(value[inside] - middle))
            found.append((np.median(way[inside]), middle, spread, inside.sum()))
    return np.array(found, dtype=np.float64).reshape(-1, 4)


def _fitted(middles: Numbers) -> tuple[float, float, float]:
    """``log K, log R_full, power``: absolute deviations, as the nearest bins may hold the own car."""
    way, value = middles[:, 0], middles[:, 1]
    best, found = math.inf, (0.0, 0.0, 0.0)
    for full in np.log(_FULL_M):
        short = np.minimum(0.0, way - full)
        if not (short < 0).any() or not (short == 0).any():
            continue
        design = np.stack([np.ones(len(way)), short], -1)
        weight = np.ones(len(way))
        for _ in range(8):  # least absolute deviations, reweighted
            normal = design.T @ (design * weight[:, None])
            answer = np.linalg.solve(normal + 1e-12 * np.eye(2), design.T @ (weight * value))
            off = np.abs(value - design @ answer)
            weight = 1.0 / np.maximum(off, 0.02)
        cost = float(np.maximum(off, 0.02).sum())
        if cost < best:
            best, found = cost, (float(answer[0]), float(full), float(answer[1]))
    return found


def _notes(range_m: Numbers, full: float) -> tuple[str, ...]:
    notes = []
    if (range_m > full).sum() < 3:
        notes.append(
            f"The response still rises at the farthest range ({range_m.max():.0f} m): near_full_m is at least that, "
            "and the photon constant a lower limit."
        )
    if (range_m < full).sum() < 3:
        notes.append(
            f"The nearest returns lie at {range_m.min():.1f} m: the recording shows little of the response below."
        )
    return tuple(notes)
