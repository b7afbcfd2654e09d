"""Compiled table of returns: the counts of ``BeamParticles.between`` and the solutions of ``ReturnTable.of``.

Both are searches in rising rows for rising values: one walk along the row answers all of them.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from torchweather.core.compiled import jit
from torchweather.core.compiled_math import exp_of, log_of_sum

__all__ = ["Air", "Sizes", "count_between", "place_on_nodes", "signals_on_nodes"]

Array = NDArray[np.float32]

ZERO, HALF, ONE = np.float32(0), np.float32(0.5), np.float32(1)
FEWEST, LEAST_RISE, LEAST_FALL, DARKEST = np.float32(1e-20), np.float32(1e-12), np.float32(1e-6), np.float32(1e-30)


class Air(NamedTuple):
    """The beam at the nodes of its quadrature, ``(cells, G)`` each.

    Args:
        full: signal of a particle that fills the beam.
        beam_m, area_m2: diameter and cross-section.
        width_m: of the quadrature.
    """

    full: Array
    beam_m: Array
    area_m2: Array
    width_m: Array


class Sizes(NamedTuple):
    """Particles by their diameter.

    Args:
        tails: ``(D,)`` number of larger ones per m^3 at the nodes of the diameter.
        smallest_m, log_step: first node, and step of the logarithm.
        pulse: pi/4 of the pulse's length; 0 where a particle returns alone.
    """

    tails: Array
    smallest_m: np.float32
    log_step: np.float32
    pulse: np.float32


@jit
def _others(out: Array, outline_m: Array, sizes: Sizes) -> None:
    """Write the diameters of the nodes, and what all smaller particles of a pulse return, of the full beam."""
    total, tails = ZERO, sizes.tails
    for node in range(out.size):
        outline_m[node] = sizes.smallest_m * exp_of(sizes.log_step * np.float32(node))
        out[node] = sizes.pulse * total
        if node + 1 < out.size:
            middle_m = sizes.smallest_m * exp_of(sizes.log_step * (np.float32(node) + HALF))
            total += (tails[node] - tails[node + 1]) * (middle_m * middle_m)


@jit
def count_between(between: Array, air: Air, sizes: Sizes, signal: Array) -> None:
    """Write the expected numbers of particles as ``BeamParticles.between``.

    Args:
        between: ``(E, P)``, written.
        air: with P - 1 cells.
        sizes: of the weather.
        signal: ``(E,)`` its nodes.
    """
    nodes, places = between.shape
    tails, full, beam_of, area_m2, width_m = sizes.tails, air.full, air.beam_m, air.area_m2, air.width_m
    diameters = tails.size
    others, outline_m = np.empty(diameters, np.float32), np.empty(diameters, np.float32)
    share, per_m, added = np.empty(diameters, np.float32), np.empty(nodes + 1, np.float32), np.empty(nodes, np.float32)
    # One loop a step, each without branches and on few arrays: so the processor takes several nodes at once.
    wanted, along, rise = np.empty(nodes, np.float32), np.empty(nodes, np.float32), np.empty(nodes, np.float32)
    larger, smaller = np.empty(nodes, np.float32), np.empty(nodes, np.float32)
    _others(others, outline_m, sizes)
    for node in range(nodes):
        between[node, 0] = ZERO
    for cell in range(places - 1):
        for node in range(nodes):
            added[node] = ZERO
        for at in range(full.shape[1]):
            beam_m = beam_of[cell, at]
            # What fills the beam returns no more, nor do the others of it: both are held from there on.
            filling = (
                int(log_of_sum(ZERO, beam_m / sizes.smallest_m) / sizes.log_step) if beam_m > sizes.smallest_m else 0
            )
            held = others[min(filling, diameters - 1)]
            most = min(filling + 2, diameters)
            for node in range(most):
                wide = min(outline_m[node] / beam_m, ONE)
                share[node] = min(others[node], held) + wide * wide
            largest, scale = share[most - 1], max(full[cell, at], DARKEST)
            for node in range(nodes):
                wanted[node] = signal[node] / scale
            found, seen = 0, 0
            while seen < nodes and wanted[seen] < largest:
                while found < most - 2 and share[found + 1] <= wanted[seen]:
                    found += 1
                low = share[found]
                rise[seen], along[seen] = share[found + 1] / low, wanted[seen] / low
                larger[seen], smaller[seen] = tails[found], tails[found + 1]
                seen += 1
            for node in range(seen):
                rise[node] = max(log_of_sum(ZERO, rise[node]), LEAST_RISE)
            for node in range(seen):
                along[node] = min(max(log_of_sum(ZERO, along[node]) / rise[node], ZERO), ONE)
            for node in range(seen):
                way, part = smaller[node] - larger[node], along[node]
                number = larger[node] + part * way if part < HALF else smaller[node] - (ONE - part) * way
                per_m[node] = number * area_m2[cell, at]
            for node in range(seen, nodes + 1):
                per_m[node] = ZERO
            for node in range(nodes):
                added[node] += max(per_m[node] - per_m[node + 1], ZERO) * width_m[cell, at]
        for node in range(nodes):
            between[node, cell + 1] = between[node, cell] + added[node]


@jit
def signals_on_nodes(out: Array, between: Array, arrivals: Array, fainter: np.float32) -> None:
    """Write the signal at every node of the reach and of the arrival.

    Args:
        out: ``(P, arrivals)``, written.
        between: ``(E, P)``.
        arrivals: rising.
        fainter: nodes below the faintest signal to which a solution is continued.
    """
    nodes, places = between.shape
    above, logs = np.empty(nodes, np.float32), np.empty(nodes, np.float32)
    late = np.empty(arrivals.size, np.float32)
    for at in range(arrivals.size):
        late[at] = log_of_sum(ZERO, arrivals[at])
    for place in range(places):
        total = ZERO
        for node in range(nodes - 1, -1, -1):
            total += between[node, place]
            above[node], logs[node] = total, log_of_sum(ZERO, max(total, FEWEST))
        larger = nodes  # rows above the arrival
        for at in range(arrivals.size):
            while larger > 0 and not above[larger - 1] > arrivals[at]:
                larger -= 1
            row = min(max(larger - 1, 0), nodes - 2)
            # A power law inside the cell: Lambda falls by a factor from node to node.
            within = (logs[row] - late[at]) / max(logs[row] - logs[row + 1], LEAST_FALL)
            out[place, at] = np.float32(row) + min(max(within, -fainter), ONE)


@jit
def place_on_nodes(share: Array, place: Array, where: Array, shares: Array) -> None:
    """Write the share of the particles of a signal before each node of the range, and its inverse.

    Args:
        share: ``(E, P)``, written.
        place: ``(E, nodes)``, written.
        where: ``(E, P)`` rising along the range.
        shares: ``(nodes,)`` of the end at the nodes of the inverse, rising.
    """
    nodes, places = where.shape
    for node in range(nodes):
        end, found = where[node, places - 1], 0
        scale = max(end, FEWEST)
        for at in range(places):
            share[node, at] = where[node, at] / scale
        for at in range(shares.size):
            wanted = end * shares[at]
            while found < places - 2 and where[node, found + 1] <= wanted:
                found += 1
            low = where[node, found]
            along = (wanted - low) / max(where[node, found + 1] - low, FEWEST)
            place[node, at] = np.float32(found) + min(max(along, ZERO), ONE)
