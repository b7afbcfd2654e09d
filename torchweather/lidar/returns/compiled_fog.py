"""Compiled table of fog's return: the waveform and the two counts of ``SoftReturn.tables``, to rounding."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from torchweather.core.compiled import jit
from torchweather.core.compiled_math import exp_of

__all__ = ["Readings", "count_readings", "light_of_fog"]

Array = NDArray[np.float32]

ZERO, HALF, ONE, OUT_AND_BACK = np.float32(0), np.float32(0.5), np.float32(1), np.float32(-2)


class Readings(NamedTuple):
    """Tables over the expected photons, ``(PHOTON_NODES, E)`` each.

    Args:
        never: ln of -ln F.
        mills: ln M.
    """

    never: Array
    mills: Array


@jit
def light_of_fog(
    signal: Array,
    per_m: Array,
    response: Array,
    source_m: Array,
    pulse: Array,
    changing: Array,
    extinction_per_m: np.float32,
) -> None:
    """Write what a fog of backscatter 1 returns at each node of the quadrature, and its change per metre.

    Args:
        signal, per_m: ``(n,)``, written.
        response: ``(n, sources)`` of the receiver, over the square of the range.
        source_m: ``(n, sources)`` where in the fog the light comes from.
        pulse, changing: ``(n, sources)`` its weight, and the change of that.
        extinction_per_m: of all weather.
    """
    twice = OUT_AND_BACK * extinction_per_m
    light = np.empty(source_m.shape[1], np.float32)
    for node in range(source_m.shape[0]):
        for place in range(light.size):
            light[place] = response[node, place] * exp_of(twice * source_m[node, place])
        total, change = ZERO, ZERO
        for place in range(light.size):
            total += light[place] * pulse[node, place]
            change += light[place] * changing[node, place]
        signal[node], per_m[node] = total, change


@jit
def _read(out: Array, table: Array, position: np.float32) -> None:
    """Write the exponential of a table's rows at a place between them; below the first the first two go on."""
    node = min(max(int(np.floor(position)), 0), table.shape[0] - 2)
    share = position - np.float32(node)
    low, high = table[node], table[node + 1]
    for reading in range(table.shape[1]):
        way = high[reading] - low[reading]
        between = low[reading] + share * way if share < HALF else high[reading] - (ONE - share) * way
        out[reading] = exp_of(between)


@jit
def count_readings(
    between: Array,
    weight: Array,
    position: Array,
    largest: Array,
    chance: Array,
    alike: Array,
    width_m: Array,
    readings: Readings,
    scale: np.float32,
    rising: np.float32,
) -> None:
    """Write Lambda and the weight of the places, as ``SoftReturn.tables``.

    Args:
        between, weight: ``(E, P)``, written.
        position: ``(P - 1, G)`` place of the expected photons on the nodes of the tables.
        largest: ``(P - 1,)`` likewise of the largest so far.
        chance, alike: ``(P - 1, G)`` of a crossing, and of a slope like that of the noise.
        width_m: ``(P - 1, G)`` of the quadrature.
        readings: the tables.
        scale: of the crossings.
        rising: weight of where the waveform rises.
    """
    number = between.shape[0]
    never, mills = readings.never, readings.mills
    read, crossed, placed = np.empty(number, np.float32), np.zeros(number), np.zeros(number)
    last = number - 1
    for reading in range(number):
        between[reading, 0], weight[reading, 0] = ZERO, ZERO
    for cell in range(position.shape[0]):
        for at in range(position.shape[1]):
            _read(read, mills, position[cell, at])
            crossing, likeness = chance[cell, at] * width_m[cell, at], alike[cell, at] * width_m[cell, at]
            for reading in range(last):
                apart = max(read[reading] - read[reading + 1], ZERO)
                crossed[reading] += apart * crossing
                placed[reading] += apart * likeness
            crossed[last] += read[last] * crossing
            placed[last] += read[last] * likeness
        _read(read, never, largest[cell])
        for reading in range(number):
            risen = max(read[reading] - read[reading + 1], ZERO) if reading < last else read[last]
            between[reading, cell + 1] = risen + np.float32(crossed[reading]) * scale
            weight[reading, cell + 1] = np.float32(placed[reading]) + rising * risen
