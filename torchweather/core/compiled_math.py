"""exp and ln of single precision for compiled loops, by polynomials (relative error below 2e-7)."""

from __future__ import annotations

import math

import numpy as np

from torchweather.core.compiled import jit

__all__ = ["exp_of", "log_of_sum"]

ONE, TWO = np.float32(1), np.float32(2)
LN2, LOG2_E = np.float32(math.log(2)), np.float32(1 / math.log(2))
LN2_HIGH, LN2_LOW = np.float32(0.693359375), np.float32(-2.12194440e-4)
THIRD, FIFTH, SEVENTH, NINTH = np.float32(1 / 3), np.float32(1 / 5), np.float32(1 / 7), np.float32(1 / 9)
E2, E3, E4, E5, E6 = (np.float32(1 / math.factorial(n)) for n in (2, 3, 4, 5, 6))
ROOT_BITS, EXPONENT_BIAS = np.int32(0x3F3504F3), np.int32(127)
ROUNDING = np.float32(1.5 * 2**23)  # added and taken off, it rounds to the nearest whole number
LOWEST, HIGHEST = np.float32(-87.0), np.float32(88.0)


@jit
def log_of_sum(one: np.float32, x: np.float32) -> np.float32:
    """``ln(one + x)`` for one of 0 or 1 and x >= 0; small x beside 1 keep their digits."""
    bits = np.float32(one + x).view(np.int32)
    # Each step back to 32 bits: numba takes them to 64, half as many at once.
    exponent = np.int32(np.int32(bits - ROOT_BITS) >> np.int32(23))
    mantissa = np.int32(bits - np.int32(exponent << np.int32(23))).view(np.float32)
    f = x if exponent == 0 and one == ONE else mantissa - ONE
    s = f / (TWO + f)
    z = s * s
    return np.float32(exponent) * LN2 + TWO * s * (ONE + z * (THIRD + z * (FIFTH + z * (SEVENTH + z * NINTH))))


@jit
def exp_of(x: np.float32) -> np.float32:
    """``exp(x)``, x between -87 and 88."""
    x = min(max(x, LOWEST), HIGHEST)
    whole = (x * LOG2_E + ROUNDING) - ROUNDING
    r = x - whole * LN2_HIGH - whole * LN2_LOW
    series = ONE + r * (ONE + r * (E2 + r * (E3 + r * (E4 + r * (E5 + r * E6)))))
    return series * np.int32((np.int32(whole) + EXPONENT_BIAS) << np.int32(23)).view(np.float32)
