"""Columns of a turn and the azimuths at which a ring fires, from the gaps between the points of each ring."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

__all__ = ["AzimuthStep", "fit_azimuth_step"]

Numbers = npt.NDArray[np.floating[Any]]
Integers = npt.NDArray[np.integer[Any]]

_TURN_DEG = 360.0
# Two returns of one beam share its azimuth; gaps below this share of the typical one lie inside a beam.
_SAME_BEAM = 0.25
# Gaps up to this many typical ones hold no beam without return. (The HDL-64E rounds azimuths to 0.09 degree: gaps of
# one step are 0.09 or 0.18, those of two 0.27 or 0.36 degree.)
_ONE_STEP = 1.4
_FEWEST_GAPS = 100
_BLOCKS = 12


@dataclass(frozen=True)
class AzimuthStep:
    """Azimuth step of a scan.

    Args:
        step_deg: between two firings of a ring.
        step_error_deg: standard error (jackknife over sectors of azimuth).
        phase_deg: ``(K,)`` azimuth of a firing of each ring, 0 to ``step_deg``; NaN for a ring without points.
        phase_spread_deg: ``(K,)`` circular standard deviation of the azimuths about it; of the order of the step where
            the sensor's speed drifts and the phase means little.
        beams: beams with a return: rows of one ring and azimuth count once.
    """

    step_deg: float
    step_error_deg: float
    phase_deg: Numbers
    phase_spread_deg: Numbers
    beams: int


def fit_azimuth_step(azimuth_deg: Numbers, ring: Integers, rings: int) -> AzimuthStep | None:
    """Fit the azimuth step of a scan and the phase of each ring.

    The step is the mean of the gaps between neighbours of a ring that hold no further beam.

    Args:
        azimuth_deg: ``(N,)``.
        ring: ``(N,)`` 0 to ``rings - 1``.
        rings: number of rings K.

    Returns:
        The step, or ``None`` where fewer than 100 neighbours show it.

    Example:
        >>> azimuth = np.tile(np.arange(0.05, 360.0, 0.2), 4)
        >>> fitted = fit_azimuth_step(azimuth, np.repeat(np.arange(4), 1800), 4)
        >>> round(fitted.step_deg, 4), fitted.phase_deg.round(3).tolist()
        (0.2, [0.05, 0.05, 0.05, 0.05])
    """
    azimuth = np.asarray(azimuth_deg, dtype=np.float64) % _TURN_DEG
    order = np.argsort(ring * (2.0 * _TURN_DEG) + azimuth)
    azimuth, ring = azimuth[order], ring[order]
    gap = np.diff(azimuth)[ring[1:] == ring[:-1]]
    middle = azimuth[:-1][ring[1:] == ring[:-1]]
    positive = gap[gap > 0]
    if len(positive) < _FEWEST_GAPS:
        return None
    typical = _typical(positive)
    one = (gap > _SAME_BEAM * typical) & (gap < _ONE_STEP * typical)
    block = (middle[one] * (_BLOCKS / _TURN_DEG)).astype(np.intp).clip(0, _BLOCKS - 1)
    total, number = np.bincount(block, gap[one], _BLOCKS), np.bincount(block, minlength=_BLOCKS)
    if number.sum() < _FEWEST_GAPS:
        return None
    step = float(total.sum() / number.sum())
    filled = number > 0
    left_out = (total.sum() - total[filled]) / np.maximum(number.sum() - number[filled], 1)
    blocks = int(filled.sum())
    error = (
        float(np.sqrt((blocks - 1) / blocks * np.square(left_out - left_out.mean()).sum())) if blocks > 1 else np.inf
    )

    angle = azimuth * (2.0 * np.pi / step)
    count = np.bincount(ring, minlength=rings)
    with np.errstate(invalid="ignore", divide="ignore"):
        cosine = np.bincount(ring, np.cos(angle), rings) / count
        sine = np.bincount(ring, np.sin(angle), rings) / count
        phase = np.arctan2(sine, cosine) * (step / (2.0 * np.pi)) % step
        length = np.minimum(np.hypot(cosine, sine), 1.0)
        spread = np.sqrt(-2.0 * np.log(length)) * (step / (2.0 * np.pi))
    beams = len(azimuth) - int((gap <= _SAME_BEAM * typical).sum())
    return AzimuthStep(step, error, phase, spread, beams)


def _typical(gap: Numbers) -> float:
    """The gap that most neighbours have: the fullest bin of a histogram in steps of 10 percent, by its mean."""
    logarithm = np.log(gap)
    low, high = np.quantile(logarithm, [0.001, 0.9])
    edges = np.arange(low - 0.05, high + 0.15, 0.1)
    place = np.digitize(logarithm, edges)
    fullest = np.bincount(place).argmax()
    return float(gap[place == fullest].mean())
