"""Compiled echoes of a table of returns: the strongest particle of a beam, the next strongest and so on.

The same formulas as `ReturnTable.signal_before` and `ReturnTable.place_before`, beam by beam, with polynomials for exp
and ln (relative error below 2e-7).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from torchweather.core.compiled import jit
from torchweather.core.compiled_math import exp_of, log_of_sum

__all__ = ["Part", "write_echoes"]

Array = NDArray[np.float32]

ZERO, HALF, ONE = np.float32(0), np.float32(0.5), np.float32(1)
THINNEST = np.float32(1e-6)  # density of a beam, at least


class Part(NamedTuple):
    """Returns of one kind of weather.

    Args:
        signal, share, place: of its ``ReturnTable``, flat.
        arrival, at: ``(echoes, N)`` variates; ``(0, 0)``: there is no such kind.
        nodes, signals, arrivals, places: numbers of the table's nodes.
        late_scale, late_shift: from ln of an arrival to its node.
        near_m, scale_m, position_scale, stretch: of the grid of ranges.
        low, step, photon_signal: of the axis of signals; photons of fog go with the square, 0 of particles.
        never: variate of the arrival from which on no echo counts.
    """

    signal: Array
    share: Array
    place: Array
    arrival: Array
    at: Array
    nodes: int
    signals: int
    arrivals: int
    places: int
    late_scale: np.float32
    late_shift: np.float32
    near_m: np.float32
    scale_m: np.float32
    position_scale: np.float32
    stretch: np.float32
    low: np.float32
    step: np.float32
    photon_signal: np.float32
    never: np.float32


@jit
def _between(low: np.float32, high: np.float32, share: np.float32) -> np.float32:
    return low + share * (high - low) if share < HALF else high - (ONE - share) * (high - low)


@jit
def _node(position: np.float32, nodes: int) -> int:
    """Node at or below a place, such that there is one after it."""
    return min(max(int(np.floor(position)), 0), nodes - 2)


@jit
def write_echoes(
    range_m: Array,
    signal: Array,
    counts: NDArray[np.int32],
    reach_m: Array,
    density: Array,
    part: Part,
    is_counted: bool,
    faintest: np.float32,
    first: int,
    last: int,
    origin: int,
) -> None:
    """Add the echoes of some beams to their lists.

    Args:
        range_m, signal: ``(beams, echoes)``, written.
        counts: ``(beams,)`` echoes that each list holds, raised.
        reach_m: ``(N,)`` up to which particles count.
        density: ``(N,)`` of each beam over that of the weather; ``(0,)`` is 1.
        part: returns of one kind of weather.
        is_counted: whether the density counts particles; else it is the share of the light.
        faintest: signal of the faintest echo that counts; 0 counts every one of the table.
        first, last: beams.
        origin: beam of the first list.
    """
    # Taken out of the tuple here: that costs as much as an echo.
    arrivals, places, row_of, share_of, place_of = part.arrival, part.at, part.signal, part.share, part.place
    last_node, last_arrival = np.float32(part.nodes - 1), np.float32(part.arrivals - 1)
    has_density = density.size > 0
    for beam in range(first, last if arrivals.shape[0] > 0 else first):
        far_m = reach_m[beam]
        if arrivals[0, beam] >= part.never or not far_m > part.near_m:
            continue
        own = density[beam] if has_density else ONE
        position = log_of_sum(ONE, (far_m - part.near_m) / part.scale_m) * part.position_scale
        position = min(position, last_node)
        column = _node(position, part.nodes)
        beyond, arrived, at = position - np.float32(column), ZERO, beam - origin
        count = counts[at]
        for echo in range(arrivals.shape[0]):
            arrived -= log_of_sum(ZERO, ONE - arrivals[echo, beam])
            reached = arrived / max(own, THINNEST) if has_density and is_counted else arrived
            late = log_of_sum(ZERO, reached) * part.late_scale - part.late_shift if reached > ZERO else ZERO
            late = min(max(late, ZERO), last_arrival)
            early = _node(late, part.arrivals)
            share, index = late - np.float32(early), column * part.arrivals + early
            here = _between(row_of[index], row_of[index + 1], share)
            index += part.arrivals
            row = _between(here, _between(row_of[index], row_of[index + 1], share), beyond)
            if not row > ZERO:
                break
            along = part.low + part.step * row
            found = along * along * part.photon_signal if part.photon_signal > ZERO else exp_of(along)
            if not is_counted:
                found *= own
            if found < faintest:
                break
            node = _node(row, part.signals)
            index = node * part.nodes + column
            before = _between(share_of[index], share_of[index + 1], beyond) * places[echo, beam]
            before = min(max(before, ZERO), ONE)
            v = np.sqrt(before / (ONE + np.sqrt(ONE - before))) * np.float32(part.places - 1)
            cell = _node(v, part.places)
            index = node * part.places + cell
            place = min(_between(place_of[index], place_of[index + 1], v - np.float32(cell)), position)
            grown = exp_of(place * part.stretch) - ONE
            range_m[at, count] = min(part.near_m + part.scale_m * grown, far_m)
            signal[at, count] = found
            count += 1
        counts[at] = count
