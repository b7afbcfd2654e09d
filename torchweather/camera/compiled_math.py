"""Blending of single precision for compiled loops, and exp and ln of ``core/compiled_math.py`` beside it."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from torchweather.core.compiled import jit
from torchweather.core.compiled_math import exp_of, log_of_sum

__all__ = ["blend_row", "covered_share", "exp_of", "log_of_sum"]

Array = NDArray[np.float32]

HALF, ONE = np.float32(0.5), np.float32(1)
E3, E4, E5 = (np.float32(1 / math.factorial(n)) for n in (3, 4, 5))
THIN = np.float32(0.06)  # optical depth below which four terms of the series are exact to 1e-7 of it


@jit
def covered_share(optical: np.float32) -> np.float32:
    """``1 - exp(-optical)``, optical depth 0 or more; small shares keep their digits."""
    series = optical * (ONE - optical * (HALF - optical * (E3 - optical * (E4 - optical * E5))))
    return series if optical < THIN else ONE - exp_of(-optical)


@jit
def blend_row(out: Array, start: Array, end: Array, weight: Array) -> None:
    """``start + weight (end - start)``; either end exactly."""
    for at in range(out.size):
        way = end[at] - start[at]
        out[at] = start[at] + weight[at] * way if weight[at] < HALF else end[at] - (ONE - weight[at]) * way
