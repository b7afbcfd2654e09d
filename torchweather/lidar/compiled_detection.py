"""Compiled detection and reading of a LiDAR's echoes, one beam after the other: ``Detection`` and ``ToPoints``.

For chains with stages beside the five that ``compiled_beams.py`` runs in one pass.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from torchweather.core.compiled import jit
from torchweather.lidar.compiled_beams import LOST, PARTICLE, Array, Receiver, _dimmed, _end, _of_particle, _strongest

__all__ = ["choose_echoes", "read_echo"]

ZERO, ONE, INFINITE = np.float32(0), np.float32(1), np.float32(np.inf)
DUAL = 3

Kinds = NDArray[np.int8]


@jit
def choose_echoes(
    found_m: Array,
    found_signal: Array,
    found_kind: Kinds,
    range_m: Array,
    signal: Array,
    kind: Kinds,
    threshold: Array,
    clear_m: Array,
    receiver: Receiver,
) -> None:
    """Write the reported echoes of one sample, as ``Detection``.

    Args:
        found_m, found_signal, found_kind: ``(reported, N)``, written.
        range_m, signal, kind: ``(echoes, N)``, the object's first.
        threshold: ``(N or 1,)``.
        clear_m: ``(N,)`` range of the objects, 0 without one.
        receiver: the sensor; its own threshold is not looked at.
    """
    count, beams = signal.shape
    ranges, strengths = np.empty((count, 1), np.float32), np.empty((count, 1), np.float32)
    for beam in range(beams):
        least, own_m = threshold[beam if threshold.size > 1 else 0], clear_m[beam]
        for echo in range(count):
            value = signal[echo, beam]
            strengths[echo, 0] = value if value >= least else ZERO
            ranges[echo, 0] = range_m[echo, beam]
        # Nothing lies in front of an object that near; one without any signal was taken away.
        if own_m > ZERO and own_m < receiver.nearest_m and signal[0, beam] > ZERO:
            strengths[0, 0] = INFINITE
        strongest = _strongest(strengths, 0, count)
        end = strongest
        if receiver.mode > 0 and count > 1:
            end = _end(ranges, strengths, 0, count, receiver.apart_m, receiver.mode == 1)
        for number in range(found_m.shape[0]):
            chosen = strongest if receiver.mode == DUAL and number == 0 else end
            if number == 1 and end >= 0 and ranges[end, 0] == ranges[strongest, 0]:
                chosen = -1  # one echo is reported once
            found_m[number, beam] = ranges[chosen, 0] if chosen >= 0 else ZERO
            found_signal[number, beam] = signal[chosen, beam] if chosen >= 0 else ZERO
            found_kind[number, beam] = kind[chosen, beam] if chosen >= 0 else LOST


@jit
def read_echo(
    found_m: Array,
    found_intensity: Array,
    range_m: Array,
    signal: Array,
    kind: Kinds,
    clear_m: Array,
    clear_signal: Array,
    points: Array,
    borrowed: Array,
    noise: Array,
    is_integral: bool,
    receiver: Receiver,
) -> None:
    """Write range and intensity of one reported echo of a sample, as ``ToPoints.measurement``.

    Args:
        found_m, found_intensity: ``(N,)``, written.
        range_m, signal, kind: ``(N,)`` of the echo.
        clear_m, clear_signal: ``(N,)`` of the objects.
        points: ``(N, C)`` that came in; intensities in column 3.
        borrowed: ``(N,)`` intensity of a particle; ``(0,)``: from its signal.
        noise: ``(N,)`` of the range; ``(0,)``: none.
        is_integral: whether intensities are integers.
        receiver: the sensor.
    """
    for beam in range(range_m.size):
        own_m, label = range_m[beam], kind[beam]
        if label == LOST:
            own_m, value = ZERO, ZERO
        elif label == PARTICLE:
            if noise.size > 0:
                own_m = max(own_m + receiver.range_noise_m * noise[beam], ZERO)
            if receiver.range_step_m > ZERO:
                own_m = np.rint(own_m / receiver.range_step_m) * receiver.range_step_m
            value = borrowed[beam] if borrowed.size > 0 else _of_particle(signal[beam], own_m, is_integral, receiver)
        else:
            gain = signal[beam] / (clear_signal[beam] if clear_m[beam] > ZERO else ONE)
            value = _dimmed(points[beam, 3], gain, is_integral, receiver)
        found_m[beam], found_intensity[beam] = own_m, value
