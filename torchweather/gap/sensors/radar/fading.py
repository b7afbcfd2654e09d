"""Probability that a fluctuating radar target is lost by chance.

A target either stands still, and its power departs by the receiver's noise alone, or its parts move against each other
and its power is exponential (Swerling's case 1). A handful of clear frames does not tell which by their spread: of
targets that fluctuate those that chance kept together look as if they stood still, and just those are lost later. So
both laws are weighed by what was detected and what was not, with the share of targets that fluctuate found for each
class:

    p(lost) = q (1 - (1 + t / sum SNR)^-n),   t threshold, n frames,

q the probability that a target fluctuates; the power law is the exponential one, averaged over what n frames leave open
of its mean.

References:
    Swerling 1960 (fluctuating targets); primary text not seen. Expectation maximisation: Dempster, Laird & Rubin 1977.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm

__all__ = ["FADING_SPREAD_DB", "NOISE_AT_0_DB", "chance_of_fading", "fading", "share_of_fading", "shares_by_class"]

Floats = NDArray[np.float64]

DB = 10.0 / np.log(10.0)
NOISE_AT_0_DB = DB * np.sqrt(2.0)  # spread of a steady target's power, dB, times the root of its SNR, for large ones
FADING_SPREAD_DB = DB * np.pi / np.sqrt(6.0)  # of an exponential power: the logarithm has a Gumbel law
ROUNDS, CENSORED_ROUNDS = 30, 5
START = 0.3
OF_ALL = 1.0  # targets of all classes that count in the share of each


def share_of_fading(snr_db: Floats, threshold_db: float, typical_db: float) -> float:
    """Share of the targets that fluctuate.

    Args:
        snr_db: ``(F, N)`` of frames, NaN where not detected.
        threshold_db: SNR of the detection.
        typical_db: spread of a steady target that the noise does not explain.
    """
    some = (~np.isnan(snr_db)).sum(0) >= 2
    if not some.any():
        return START
    odds = _log_odds(snr_db[:, some], threshold_db, typical_db)
    share = START
    for _ in range(ROUNDS):
        share = float(np.clip(_posterior(odds, share).mean(), 1e-3, 1.0 - 1e-3))
    return share


def shares_by_class(
    snr_db: Floats, threshold_db: float, typical_db: float, target_class: NDArray[np.float64]
) -> Floats:
    """Share ``(N,)`` of the targets of each one's class that fluctuate: cars do, posts do not. The few of a small class
    count beside ``OF_ALL`` of all classes.

    Args:
        snr_db, threshold_db, typical_db: as of ``share_of_fading``.
        target_class: ``(N,)``.
    """
    of_all = share_of_fading(snr_db, threshold_db, typical_db)
    found = np.empty(snr_db.shape[1])
    for one in np.unique(target_class):
        own = target_class == one
        known = int(((~np.isnan(snr_db[:, own])).sum(0) >= 2).sum())
        share = share_of_fading(snr_db[:, own], threshold_db, typical_db)
        found[own] = (known * share + OF_ALL * of_all) / (known + OF_ALL)
    return found


def fading(snr_db: Floats, threshold_db: float, typical_db: float, share: float | Floats) -> Floats:
    """Probability ``(N,)`` that each target fluctuates; arguments as of ``chance_of_fading``."""
    return _posterior(_log_odds(snr_db, threshold_db, typical_db), share)


def chance_of_fading(snr_db: Floats, threshold_db: float, typical_db: float, share: float | Floats) -> Floats:
    """Chance ``(N,)`` that a frame loses each target because it fluctuates; NaN of one that no frame has.

    Args:
        snr_db: ``(F, N)`` of frames, NaN where not detected.
        threshold_db: SNR of the detection.
        typical_db: spread of a steady target that the noise does not explain.
        share: of all targets that fluctuate (``share_of_fading``), or of those like each one ``(N,)``.

    Example:
        >>> alike, apart = np.array([[20.0], [20.2], [20.1]]), np.array([[20.0], [26.0], [23.0]])
        >>> [round(float(chance_of_fading(snr_db, 12.0, 0.3, 0.3)[0]), 4) for snr_db in (alike, apart)]
        [0.0001, 0.0652]
    """
    number = (~np.isnan(snr_db)).sum(0)
    whole = np.where(number > 0, np.nansum(10.0 ** (0.1 * snr_db), 0), 1.0)
    below = np.where(number > 0, 1.0 - (1.0 + 10.0 ** (0.1 * threshold_db) / whole) ** -number, np.nan)
    found: Floats = below * fading(snr_db, threshold_db, typical_db, share)
    return found


def _posterior(log_odds: Floats, share: float | Floats) -> Floats:
    found: Floats = 1.0 / (1.0 + (1.0 - share) / share * np.exp(-np.clip(log_odds, -500.0, 500.0)))
    return found


def _log_odds(snr_db: Floats, threshold_db: float, typical_db: float) -> Floats:
    """Logarithm ``(N,)`` of how much better the exponential law explains what was detected and what was not than the
    noise, each with the mean that explains it best; of those that one frame has it is 0."""
    there = ~np.isnan(snr_db)
    number, lost = np.maximum(there.sum(0), 1), (~there).sum(0)
    snr, threshold = np.where(there, 10.0 ** (0.1 * snr_db), 0.0), 10.0 ** (0.1 * threshold_db)
    mean = np.maximum(snr.sum(0) / number, 1e-12)
    for _ in range(CENSORED_ROUNDS):
        # Of an exponential power below the threshold the mean is this.
        below = mean - threshold / np.expm1(np.minimum(threshold / mean, 500.0))
        mean = np.maximum((snr.sum(0) + lost * below) / len(snr_db), 1e-12)
    relative = np.where(there, snr / mean, 1.0)
    # Densities over the decibel.
    exponential = np.where(there, np.log(relative) - relative - np.log(DB), 0.0).sum(0)
    exponential += lost * np.log(-np.expm1(-threshold / mean))
    middle = np.where(there, snr_db, 0.0).sum(0) / number
    spread = np.maximum(NOISE_AT_0_DB * 10.0 ** (-0.05 * middle), typical_db)
    apart = np.where(there, (np.where(there, snr_db, 0.0) - middle) / spread, 0.0)
    steady = (-0.5 * apart**2 - np.where(there, np.log(spread * np.sqrt(2.0 * np.pi)), 0.0)).sum(0)
    steady += lost * norm.logcdf(threshold_db, middle, spread)
    found: Floats = np.where(number >= 2, exponential - steady, 0.0)
    return found
