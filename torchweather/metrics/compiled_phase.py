"""The sums of phase congruency over the scales of one orientation, pixel by pixel, compiled by numba.

torch makes some twenty passes over the responses of four filters; here each response is read once.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from torchweather.core.compiled import jit

__all__ = ["add_orientation", "finest_power"]

Responses = NDArray[np.complex64]
Plane = NDArray[np.float32]


def _add(responses: Responses, noise: Any, above: Plane, amplitudes: Plane) -> None:
    """Add one orientation's energy above the noise, and its amplitudes.

    Args:
        responses: ``(S, N)`` of the filters, even part real and odd part imaginary.
        noise: threshold on the energy.
        above, amplitudes: ``(N,)``, written.
    """
    scales, pixels = responses.shape
    zero = np.float32(0.0)
    for pixel in range(pixels):
        even_sum, odd_sum, amplitude, across = zero, zero, zero, zero
        for scale in range(scales):
            even, odd = responses[scale, pixel].real, responses[scale, pixel].imag
            even_sum += even
            odd_sum += odd
            amplitude += np.float32(math.sqrt(even * even + odd * odd))
        strength = np.float32(math.sqrt(even_sum * even_sum + odd_sum * odd_sum))
        if strength > zero:
            even_mean, odd_mean = even_sum / strength, odd_sum / strength
            for scale in range(scales):
                even, odd = responses[scale, pixel].real, responses[scale, pixel].imag
                across += abs(even * odd_mean - odd * even_mean)
            in_phase = even_sum * even_mean + odd_sum * odd_mean
            above[pixel] += max(in_phase - across - noise, zero)
        amplitudes[pixel] += amplitude


@lru_cache(maxsize=1)
def _compiled() -> Any:
    return jit(_add)


def finest_power(response: Tensor) -> float:
    """Median of the squared amplitudes of a response ``(H, W)``, the lower of two in the middle."""
    values: NDArray[Any] = response.numpy().ravel()
    squared = values.real * values.real + values.imag * values.imag
    middle = (squared.size - 1) // 2
    return float(np.partition(squared, middle)[middle])


def add_orientation(responses: Tensor, noise: float, above: Tensor, amplitudes: Tensor) -> None:
    """Add one orientation of complex responses ``(S, H, W)`` to the energy and the amplitudes ``(H, W)``."""
    flat = responses.flatten(1).numpy()
    _compiled()(flat, np.float32(noise), above.view(-1).numpy(), amplitudes.view(-1).numpy())
