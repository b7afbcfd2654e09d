"""Rate or visibility of a loss on the path: the library's own laws, inverted."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from torchweather.atmosphere.weather import Weather
from torchweather.evaluation.fit.result import Value
from torchweather.evaluation.validation.power import changed_weather

__all__ = ["PathLaw"]

# From a hundredth to a hundred times the recorded value, eight nodes a decade.
FACTORS = np.logspace(-2.0, 2.0, 33)


@dataclass(frozen=True)
class PathLaw:
    """Loss on the path over the rate or visibility.

    Args:
        intensity, loss: ``(N,)`` of the nodes, loss rising. Between and beyond them the law is a power.
        is_visibility: True where a larger value is less weather.
    """

    intensity: NDArray[np.float64]
    loss: NDArray[np.float64]
    is_visibility: bool

    @classmethod
    def of(cls, weather: Weather, loss: Callable[[Weather], float]) -> PathLaw:
        """The law of a weather at other rates or visibilities.

        Args:
            weather: as recorded; its own value is the middle.
            loss: of a weather, 1/m or dB/km.
        """
        known = [each for each in (changed_weather(weather, float(factor)) for factor in FACTORS) if each is not None]
        pairs = sorted((loss(each), float(each.intensity)) for each in known)
        found = np.array([pair for pair in pairs if pair[0] > 0])
        return cls(found[:, 1], found[:, 0], weather.intensity_name == "mor_m")

    def inverse(self, loss: Value) -> Value:
        """Rate or visibility with its interval; no loss is no rain, and a visibility without limit."""
        ends = [self._at(each) for each in (loss.low, loss.high)]
        low, high = (ends[1], ends[0]) if self.is_visibility else (ends[0], ends[1])
        return Value(self._at(loss.value), low, high)

    def _at(self, loss: float) -> float:
        if math.isnan(loss):
            return math.nan
        if loss <= 0:
            return math.inf if self.is_visibility else 0.0
        x, y = np.log(self.loss), np.log(self.intensity)
        place = int(np.clip(np.searchsorted(x, math.log(loss)), 1, len(x) - 1))
        slope = (y[place] - y[place - 1]) / (x[place] - x[place - 1])
        return float(np.exp(y[place - 1] + slope * (math.log(loss) - x[place - 1])))
