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
STAGE, SPARE = 512, 12  # beams whose numbers stay in the cache, and how many numbers of each


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
        range_m, signal: ``(echoes, beams)``, written.
        counts: ``(beams,)`` echoes that each list holds, raised.
        reach_m: ``(N,)`` up to which particles count.
        density: ``(N,)`` of each beam over that of the weather; ``(0,)`` is 1.
        part: returns of one kind of weather.
        is_counted: whether the density counts particles; else it is the share of the light.
        faintest: signal of the faintest echo that counts; 0 counts every one of the table.
        first, last: beams.
        origin: beam of the first list.
    """
    if part.arrival.shape[0] == 0:
        return
    # Taken out of the tuple here: that costs as much as an echo.
    arrivals, places, row_of, share_of, place_of = part.arrival, part.at, part.signal, part.share, part.place
    never, near_m, scale_m, photon_signal = part.never, part.near_m, part.scale_m, part.photon_signal
    late_scale, late_shift, position_scale, stretch = (
        part.late_scale,
        part.late_shift,
        part.position_scale,
        part.stretch,
    )
    nodes, late_nodes, cells, rows = part.nodes, part.arrivals, part.places, part.signals
    low, step = part.low, part.step
    last_node, last_arrival, last_cell = np.float32(nodes - 1), np.float32(late_nodes - 1), np.float32(cells - 1)
    last_column, last_early = np.int32(nodes - 2), np.int32(late_nodes - 2)
    has_density = density.size > 0
    spare, whole = np.empty((SPARE, STAGE), np.float32), np.empty((3, STAGE), np.int32)
    position, beyond, arrived, late, row, found = spare[0], spare[1], spare[2], spare[3], spare[4], spare[5]
    far_m, own, v_1, v_2, v_3, v_4 = spare[6], spare[7], spare[8], spare[9], spare[10], spare[11]
    beam_of, column, early = whole[0], whole[1], whole[2]
    for begin in range(first, last, STAGE):
        count, end = 0, min(begin + STAGE, last)
        for beam in range(begin, end):
            beam_of[count], far_m[count], own[count] = beam, reach_m[beam], density[beam] if has_density else ONE
            arrived[count] = ZERO
            count += 1 if arrivals[0, beam] < never and reach_m[beam] > near_m else 0
        for at in range(count):
            place = log_of_sum(ONE, (far_m[at] - near_m) / scale_m) * position_scale
            position[at] = min(place, last_node)
        for at in range(count):
            column[at] = min(max(np.int32(position[at]), np.int32(0)), last_column)
            beyond[at] = position[at] - np.float32(column[at])
        for echo in range(arrivals.shape[0]):
            if count == 0:
                break
            for at in range(count):
                v_1[at] = ONE - arrivals[echo, beam_of[at]]
            for at in range(count):
                arrived[at] -= log_of_sum(ZERO, v_1[at])
            for at in range(count):
                late[at] = arrived[at] / max(own[at], THINNEST) if has_density and is_counted else arrived[at]
            for at in range(count):
                reached = late[at]
                place = log_of_sum(ZERO, reached) * late_scale - late_shift
                late[at] = min(max(place if reached > ZERO else ZERO, ZERO), last_arrival)
            for at in range(count):
                early[at] = min(np.int32(late[at]), last_early)
                late[at] -= np.float32(early[at])
            for at in range(count):
                index = np.uintp(column[at]) * np.uintp(late_nodes) + np.uintp(early[at])
                v_1[at], v_2[at] = row_of[index], row_of[index + np.uintp(1)]
                index += np.uintp(late_nodes)
                v_3[at], v_4[at] = row_of[index], row_of[index + np.uintp(1)]
            for at in range(count):
                here = _between(v_1[at], v_2[at], late[at])
                row[at] = _between(here, _between(v_3[at], v_4[at], late[at]), beyond[at])
            if photon_signal > ZERO:
                for at in range(count):
                    along = low + step * row[at]
                    found[at] = along * along * photon_signal
            else:
                for at in range(count):
                    found[at] = exp_of(low + step * row[at])
            if has_density and not is_counted:
                for at in range(count):
                    found[at] *= own[at]
            left = 0
            for at in range(count):
                beam_of[left], column[left], beyond[left], position[left] = (
                    beam_of[at],
                    column[at],
                    beyond[at],
                    position[at],
                )
                far_m[left], own[left], arrived[left] = far_m[at], own[at], arrived[at]
                row[left], found[left] = row[at], found[at]
                left += 1 if row[at] > ZERO and found[at] >= faintest else 0
            count = left
            for at in range(count):
                early[at] = min(np.int32(row[at]), np.int32(rows - 2))
            for at in range(count):
                index = np.uintp(early[at]) * np.uintp(nodes) + np.uintp(column[at])
                v_1[at], v_2[at] = share_of[index], share_of[index + np.uintp(1)]
                v_3[at] = places[echo, beam_of[at]]
            for at in range(count):
                before = min(max(_between(v_1[at], v_2[at], beyond[at]) * v_3[at], ZERO), ONE)
                late[at] = np.sqrt(before / (ONE + np.sqrt(ONE - before))) * last_cell
            for at in range(count):
                cell = min(np.int32(late[at]), np.int32(cells - 2))
                late[at] -= np.float32(cell)
                index = np.uintp(early[at]) * np.uintp(cells) + np.uintp(cell)
                v_1[at], v_2[at] = place_of[index], place_of[index + np.uintp(1)]
            for at in range(count):
                place = min(_between(v_1[at], v_2[at], late[at]), position[at])
                v_3[at] = min(near_m + scale_m * (exp_of(place * stretch) - ONE), far_m[at])
            for at in range(count):
                list_of = beam_of[at] - origin
                number = counts[list_of]
                range_m[number, list_of], signal[number, list_of] = v_3[at], found[at]
                counts[list_of] = number + 1
