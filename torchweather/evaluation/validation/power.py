"""Power of a comparison: the changes of weather and effects that frames as many as these would have flagged."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from scipy import special

from torchweather.atmosphere.weather import Weather
from torchweather.core.errors import InputValueError

__all__ = ["FACTOR", "FURTHER", "POWER", "changed_weather", "crossing", "detection_probability", "smallest"]

POWER = 0.8  # Cohen, Statistical Power Analysis for the Behavioral Sciences (1988): the usual demand
# A study that would not show a rate or a visibility wrong by this factor, either way, decides nothing.
FACTOR = 2.0
# Simulated as well where no score of a condition shows FACTOR.
FURTHER = 4.0
NODES = 256  # midpoints of equal probability: 0.8 comes out within 0.002 of the noncentral t
HALVINGS = 10  # of a strength, or of the logarithm of a factor: to a thousandth


def detection_probability(shift: float, error: float, bound: float, freedom: float) -> float:
    """Probability that Student's test of a shift is beyond its bound: the noncentral t distribution.

    Args:
        shift: true difference of the means.
        error: standard error of their difference, true.
        bound: two-sided bound of the test, in estimated standard errors.
        freedom: degrees of freedom of the estimate.

    Returns:
        ``P(|T| > bound)`` for ``T = (Z + shift / error) / sqrt(chi2 / freedom)``; 0 where a number is missing.

    Example:
        >>> round(detection_probability(3.0, 1.0, 2.0, 1000.0), 2)
        0.84
    """
    if math.isinf(shift):
        return 1.0
    if any(math.isnan(each) for each in (shift, error, bound, freedom)):
        return 0.0
    if error == 0:
        return float(shift != 0)
    chance = (np.arange(NODES) + 0.5) / NODES
    edge = bound * np.sqrt(2.0 * special.gammaincinv(freedom / 2.0, chance) / freedom)
    away = abs(shift) / error
    return float(np.mean(special.ndtr(away - edge) + special.ndtr(-edge - away)))


def crossing(factors: Sequence[float], probability: Callable[[float], float]) -> float:
    """Factor next to 1 at which a probability reaches ``POWER``, on the side of the factors.

    Args:
        factors: simulated ones, away from 1 and all on one side of it.
        probability: of detection at a factor between 1 and the farthest.

    Returns:
        The factor; infinite (or 0, below 1) where none does.
    """
    if not factors:
        return math.nan
    side = math.copysign(1.0, math.log(factors[0]))
    found = smallest([abs(math.log(factor)) for factor in factors], lambda away: probability(math.exp(side * away)))
    return math.exp(side * found)


def smallest(strengths: Sequence[float], probability: Callable[[float], float]) -> float:
    """Smallest strength at which a probability reaches ``POWER``.

    Args:
        strengths: simulated ones, above 0.
        probability: of detection at a strength between 0 and the largest.

    Returns:
        The strength, to a thousandth of the weakest of those that are flagged; infinite where none is.

    Example:
        >>> round(smallest([1.0, 4.0], lambda strength: float(strength >= 2.0)), 2)
        2.0
    """
    flagged = [strength for strength in sorted(strengths) if probability(strength) >= POWER]
    if not flagged:
        return math.inf
    low, high = 0.0, flagged[0]
    for _ in range(HALVINGS):
        middle = (low + high) / 2
        low, high = (low, middle) if probability(middle) >= POWER else (middle, high)
    return high


def changed_weather(weather: Weather, factor: float) -> Weather | None:
    """The weather at a multiple of its rate or visibility; ``None`` where that is out of its range.

    Example:
        >>> from torchweather.atmosphere.weather import Fog
        >>> changed_weather(Fog(mor_m=100.0), 2.0).mor_m
        200.0
    """
    name = weather.intensity_name
    with warnings.catch_warnings():
        # The user did not ask for this rate: what lies outside a law's fitted range is no news.
        warnings.simplefilter("ignore")
        try:
            return replace(weather, **{name: getattr(weather, name) * factor})  # type: ignore[type-var]
        except InputValueError:
            return None
