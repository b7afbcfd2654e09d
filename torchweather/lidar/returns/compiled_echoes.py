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

__all__ = ["Part", "position_of", "range_before", "row_before", "signal_at", "write_echoes"]

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
def position_of(part: Part, range_m: np.float32) -> np.float32:
    """Place of a range on the grid; those before its first node are 0."""
    along = log_of_sum(ONE, max(range_m - part.near_m, ZERO) / part.scale_m) * part.position_scale
    return min(along, np.float32(part.nodes - 1))


@jit
def row_before(part: Part, position: np.float32, arrived: np.float32) -> np.float32:
    """Place on the axis of signals of the strongest particle before a place of the grid; not above 0: none."""
    late = log_of_sum(ZERO, arrived) * part.late_scale - part.late_shift if arrived > ZERO else ZERO
    late = min(max(late, ZERO), np.float32(part.arrivals - 1))
    column, early = _node(position, part.nodes), _node(late, part.arrivals)
    own, index, row_of = late - np.float32(early), column * part.arrivals + early, part.signal
    here = _between(row_of[index], row_of[index + 1], own)
    index += part.arrivals
    farther = _between(row_of[index], row_of[index + 1], own)
    return _between(here, farther, position - np.float32(column))


@jit
def signal_at(part: Part, row: np.float32) -> np.float32:
    """Signal at a place of its axis."""
    along = part.low + part.step * row
    return along * along * part.photon_signal if part.photon_signal > ZERO else exp_of(along)


@jit
def range_before(part: Part, row: np.float32, position: np.float32, place: np.float32, far_m: np.float32) -> np.float32:
    """Range, m, of the particle of a place on the axis of signals, at a variate of its place, before ``far_m``."""
    column, node = _node(position, part.nodes), _node(row, part.signals)
    index, share_of, place_of = node * part.nodes + column, part.share, part.place
    before = _between(share_of[index], share_of[index + 1], position - np.float32(column)) * place
    before = min(max(before, ZERO), ONE)
    v = np.sqrt(before / (ONE + np.sqrt(ONE - before))) * np.float32(part.places - 1)
    cell = _node(v, part.places)
    index = node * part.places + cell
    found = min(_between(place_of[index], place_of[index + 1], v - np.float32(cell)), position)
    return min(part.near_m + part.scale_m * (exp_of(found * part.stretch) - ONE), far_m)


@jit
def write_echoes(
    range_m: Array,
    signal: Array,
    reach_m: Array,
    density: Array,
    part: Part,
    is_counted: bool,
    faintest: np.float32,
    first: int,
    last: int,
) -> int:
    """Write the echoes of some beams; those that a beam does not have are left as they are.

    Args:
        range_m, signal: ``(echoes, N)``, written.
        reach_m: ``(N,)`` up to which particles count.
        density: ``(N,)`` of each beam over that of the weather; ``(0,)`` is 1.
        part: returns of one kind of weather.
        is_counted: whether the density counts particles; else it is the share of the light.
        faintest: signal of the faintest echo that counts; 0 counts every one of the table.
        first, last: beams.

    Returns:
        The largest number of echoes of a beam.
    """
    most, has_density = 0, density.size > 0
    arrivals, places = part.arrival, part.at
    for beam in range(first, last):
        far_m, own = reach_m[beam], density[beam] if has_density else ONE
        if arrivals[0, beam] >= part.never or not far_m > part.near_m:
            continue
        position, arrived = position_of(part, far_m), ZERO
        for echo in range(part.arrival.shape[0]):
            arrived -= log_of_sum(ZERO, ONE - arrivals[echo, beam])
            row = row_before(part, position, arrived / max(own, THINNEST) if is_counted else arrived)
            if not row > ZERO:
                break
            found = signal_at(part, row)
            if not is_counted:
                found *= own
            if found < faintest:
                break
            range_m[echo, beam] = range_before(part, row, position, places[echo, beam], far_m)
            signal[echo, beam] = found
            most = max(most, echo + 1)
    return most
