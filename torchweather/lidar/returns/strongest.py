r"""The strongest particle of a beam, drawn exactly without listing particles.

The particles of a beam are a Poisson process. Let ``Lambda(e, R)`` be the expected number with a signal above e in
front of range R. Then the strongest signal has ``P(e_max <= e) = exp(-Lambda(e, R))``: with a standard exponential E,
solve ``Lambda(e*, R) = E``. The next strongest solve it with the sum of two exponentials, and so on. The range of a
particle of signal e* has the distribution function ``d_e Lambda(e*, r) / d_e Lambda(e*, R)``: between two rows of the
table, ``W(r) = Lambda(e_i, r) - Lambda(e_{i+1}, r)``, solve ``W(r) = u W(R)``. (``Lambda(e*, r) / Lambda(e*, R)`` would
be the range of all particles above e*.) The finite difference keeps the atom that a particle larger than the beam puts
at the full-beam signal. What is not a list of particles, as a waveform of fog, may have places of its own, W.

``strongest_before`` solves both equations by bisection for every beam. ``ReturnTable`` solves them once on a grid of E
and of u, and reads the solutions; tests hold the two together.

Signals and ranges are places on the table's axes: a fraction of nodes.

References:
    PHYSICS.md 5.3.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from torchweather.pipeline.tiling import is_exporting

__all__ = ["ReturnTable", "expected_number", "last_below", "strongest_before", "table_at"]

FEW = 1e-20  # expected number that stands for none, so that logarithms stay finite
NOTHING = 1e-9  # the same, where its logarithm must keep a gradient
FAINTER = 4.0  # nodes below the faintest signal to which a solution is continued

# Grid of the solutions. Arrivals: ln E from ARRIVAL_LOW to ARRIVAL_HIGH; a smaller E comes once in 1e6 beams.
ARRIVAL_LOW, ARRIVAL_HIGH, ARRIVAL_NODES = 1e-6, 1e2, 385
# Places: over v with W(r) / W(end) = 1 - (1 - v^2)^2, which spreads both ends: W starts as a power of the range and
# ends in a long tail.
PLACE_NODES = 513
LAST_PLACE = 1.0 - 1e-6


def strongest_before(
    between: Tensor,
    arrivals: Tensor,
    place: Tensor,
    reach: Tensor,
    start: Tensor | None = None,
    where: Tensor | None = None,
    sector: Tensor | None = None,
    sectors: int = 1,
) -> tuple[Tensor, Tensor, Tensor]:
    """The strongest particles in front of each beam's reach, by bisection.

    Args:
        between: ``(B, E, P)`` expected number of particles with a signal from node i to node i + 1 (the last: above
            node E - 1), from the first place on the grid to place p.
        arrivals: ``(B, N)`` standard exponential E for the strongest, the sum of k of them for the k-th strongest.
        place: ``(B, N)`` standard uniform u.
        reach: ``(B, N)`` place on the grid up to which particles count, 0 to P - 1.
        start: ``(B, N)`` place from which they count; ``None`` is the first node.
        where: W where it is not ``between``, of its shape.
        sector: ``(B, N)`` int64, which of a sample's tables is a beam's; ``None`` is the only one.
        sectors: so many tables has each sample: they are ``(B * sectors, E, P)``.

    Returns:
        ``(B, N)`` each: signal, 0 to E - 1; range; and whether there is such a particle at all.
    """
    signal = _signal(between, arrivals, reach, start, sector, sectors)
    _, signals, places = between.shape
    cells = (between if where is None else where).reshape(arrivals.shape[0], sectors * signals * places)
    base = _below(signal, signals) * places + _first(sector, signals * places)
    column = _below(reach, places)
    wanted = place * _lerp(cells, base + column, reach - column)
    if start is not None:
        begin = _below(start, places)
        wanted = wanted + (1.0 - place) * _lerp(cells, base + begin, start - begin)
    found = _place(cells, base, wanted, places)
    return signal.clamp_min(0.0), torch.minimum(found, reach), signal > 0.0


def expected_number(between: Tensor, signal: Tensor, reach: Tensor) -> Tensor:
    """Lambda: expected number of particles with more than a signal in front of the reach, ``(B, N)``.

    Args:
        between: ``(B, E, P)``, as in ``strongest_before``.
        signal: ``(B, N)`` place on the axis of signals.
        reach: ``(B, N)`` place on the grid.
    """
    # A power law inside the cell, as in the drawing.
    here, louder, share = _rows_at(_above(between), signal, reach)
    return torch.exp(torch.lerp((here + NOTHING).log(), (louder + NOTHING).log(), share)) - NOTHING


def table_at(table: Tensor, signal: Tensor, reach: Tensor) -> Tensor:
    """A table ``(B, E, P)`` between its nodes, linearly, at places ``(B, N)`` on the axes of signals and ranges."""
    return torch.lerp(*_rows_at(table, signal, reach))


def _rows_at(table: Tensor, signal: Tensor, reach: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Values of the rows below and above a signal, and its place between them."""
    batch, signals, places = table.shape
    flat = table.reshape(batch, signals * places)
    row, column = _below(signal, signals), _below(reach, places)
    index = row * places + column
    return _lerp(flat, index, reach - column), _lerp(flat[:, places:], index, reach - column), signal - row


@dataclass(frozen=True)
class ReturnTable:
    """The solutions of both equations on a grid.

    Args:
        signal: ``(B, P * ARRIVAL_NODES)`` signal of the strongest particle for each reach and arrival.
        share: ``(B, E * P)`` W(r) / W(end) of each signal's cell.
        place: ``(B, E * PLACE_NODES)`` its inverse, over v.
        places: P.
        signals: E.
    """

    signal: Tensor
    share: Tensor
    place: Tensor
    places: int
    signals: int

    @classmethod
    def of(cls, between: Tensor, places_of: Tensor | None = None) -> ReturnTable:
        """Solve for every node of the grid; ``between`` as in ``strongest_before``.

        Args:
            between: Lambda.
            places_of: ``(B, E, P)`` W where it is not ``between``.
        """
        where = between if places_of is None else places_of
        batch, signals, places = between.shape
        end = where[..., -1:]
        v = torch.arange(PLACE_NODES).to(between) / (PLACE_NODES - 1)
        # Short of 1: W stays at its end behind the last particle of a signal, whose place is where it gets there.
        wanted = end * (1.0 - (1.0 - v * v).square()).clamp_max(LAST_PLACE)
        cells = where.reshape(batch, signals * places)
        found = None if is_exporting() else _last_not_above(where, wanted).flatten(1)
        base = (torch.arange(signals, device=between.device) * places)[:, None].expand(signals, PLACE_NODES)
        place = _place(cells, base.reshape(1, -1).expand(batch, -1), wanted.flatten(1), places, found)
        share = (where / end.clamp_min(FEW)).flatten(1)
        return cls(_signals_on_nodes(between), share, place, places, signals)

    @classmethod
    def compiled(cls, between: Tensor, places_of: Tensor | None = None) -> ReturnTable:
        """As ``of``, by compiled loops; to rounding."""
        from torchweather.lidar.returns.compiled_table import place_on_nodes, signals_on_nodes

        between = between.contiguous()
        where = between if places_of is None else places_of.contiguous()
        batch, signals, places = between.shape
        v = torch.arange(PLACE_NODES) / (PLACE_NODES - 1)
        shares = (1.0 - (1.0 - v * v).square()).clamp_max(LAST_PLACE).numpy()
        step = math.log(ARRIVAL_HIGH / ARRIVAL_LOW) / (ARRIVAL_NODES - 1)
        arrivals = torch.exp(math.log(ARRIVAL_LOW) + step * torch.arange(ARRIVAL_NODES)).numpy()
        signal, share = torch.empty(batch, places, ARRIVAL_NODES), torch.empty_like(where)
        place = torch.empty(batch, signals, PLACE_NODES)
        for sample in range(batch):
            signals_on_nodes(signal[sample].numpy(), between[sample].numpy(), arrivals, np.float32(FAINTER))
            place_on_nodes(share[sample].numpy(), place[sample].numpy(), where[sample].numpy(), shares)
        return cls(signal.flatten(1), share.flatten(1), place.flatten(1), places, signals)

    def expanded(self, batch: int) -> ReturnTable:
        """A table of one sample for so many, without a copy."""
        signal, share, place = (values.expand(batch, -1) for values in (self.signal, self.share, self.place))
        return ReturnTable(signal, share, place, self.places, self.signals)

    def strongest_before(self, arrivals: Tensor, place: Tensor, reach: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """As the function of that name, read from the grid."""
        signal = self.signal_before(arrivals, reach)
        return signal.clamp_min(0.0), self.place_before(signal, place, reach), signal > 0.0

    def signal_before(self, arrivals: Tensor, reach: Tensor) -> Tensor:
        """Signal of the strongest particle ``(B, N)``; 0 or less where there is none. Arguments as above."""
        step = math.log(ARRIVAL_HIGH / ARRIVAL_LOW) / (ARRIVAL_NODES - 1)
        late = (torch.log(arrivals) * (1.0 / step) - math.log(ARRIVAL_LOW) / step).clamp(0.0, ARRIVAL_NODES - 1.0)
        column, early = _floor(reach, self.places), _floor(late, ARRIVAL_NODES)
        share, own = reach - column, late - early
        index = _index(column * ARRIVAL_NODES + early)
        here, farther = _lerp(self.signal, index, own), _lerp(self.signal[:, ARRIVAL_NODES:], index, own)
        return torch.lerp(here, farther, share)

    def place_before(self, signal: Tensor, place: Tensor, reach: Tensor) -> Tensor:
        """Range ``(B, N)`` of the particle of a signal that ``signal_before`` gave. Arguments as above."""
        column = _floor(reach, self.places)
        row = _floor(signal, self.signals)
        before = (_lerp(self.share, _index(row * self.places + column), reach - column) * place).clamp(0.0, 1.0)
        v = (before / (1.0 + (1.0 - before).sqrt())).sqrt() * (PLACE_NODES - 1)
        node = _floor(v, PLACE_NODES)
        found = _lerp(self.place, _index(row * PLACE_NODES + node), v - node)
        return torch.minimum(found, reach)

    def of_sample(self, sample: int) -> ReturnTable:
        """The table of one sample of the batch, without a copy."""
        one = slice(sample, sample + 1)
        return ReturnTable(self.signal[one], self.share[one], self.place[one], self.places, self.signals)


def _first(sector: Tensor | None, cells: int) -> Tensor | int:
    """Where the table of each beam's sector begins."""
    return 0 if sector is None else sector * cells


def _signal(
    between: Tensor,
    arrivals: Tensor,
    reach: Tensor,
    start: Tensor | None = None,
    sector: Tensor | None = None,
    sectors: int = 1,
) -> Tensor:
    """Solve ``Lambda(e*, R) = E`` for the signal; 0 or less where there is no such particle."""
    _, signals, places = between.shape
    flat = _above(between).reshape(arrivals.shape[0], sectors * signals * places)
    column, first = _below(reach, places), _first(sector, signals * places)
    begin = column if start is None else _below(start, places)

    def before(row: Tensor) -> Tensor:
        """Lambda of a row up to the reach, from the start."""
        of_row = row * places + first
        number = _lerp(flat, of_row + column, reach - column)
        return number if start is None else number - _lerp(flat, of_row + begin, start - begin)

    row = last_below(lambda i: before(i) > arrivals, torch.zeros_like(column), signals - 1)
    # A power law inside the cell: Lambda falls by a factor from node to node.
    log_above, log_below = before(row).clamp_min(FEW).log(), before(row + 1).clamp_min(FEW).log()
    fall = (log_above - log_below).clamp_min(1e-6)
    return row + ((log_above - arrivals.clamp_min(FEW).log()) / fall).clamp(-FAINTER, 1.0)


def _signals_on_nodes(between: Tensor) -> Tensor:
    """`_signal` at every node of the reach and of the arrival, ``(B, P * ARRIVAL_NODES)``.

    An arrival lies above as many rows of Lambda as the other way round: each Lambda is placed among the arrivals, which
    are fewer questions, and the rows are counted.
    """
    batch, signals, places = between.shape
    step = math.log(ARRIVAL_HIGH / ARRIVAL_LOW) / (ARRIVAL_NODES - 1)
    arrivals = torch.exp(math.log(ARRIVAL_LOW) + step * torch.arange(ARRIVAL_NODES).to(between))
    if is_exporting():
        reach = torch.arange(places).to(between)[:, None].expand(places, ARRIVAL_NODES).reshape(1, -1)
        return _signal(between, arrivals.repeat(places).expand(batch, -1), reach.expand(batch, -1))
    above = _above(between).transpose(1, 2).contiguous()  # (B, P, E), falling over E
    smaller = torch.bucketize(above.detach(), arrivals)  # arrivals below each Lambda
    counts = torch.zeros(batch, places, ARRIVAL_NODES + 1, dtype=torch.int32, device=above.device)
    counts.scatter_add_(2, smaller, torch.ones_like(smaller, dtype=torch.int32))
    larger = signals - counts.cumsum(2, dtype=torch.int32)[..., :-1]  # rows of Lambda above each arrival
    row = (larger - 1).clamp(0, signals - 2).to(torch.int64)
    # A power law inside the cell: Lambda falls by a factor from node to node.
    logs = above.clamp_min(FEW).log()
    fall = (logs[..., :-1] - logs[..., 1:]).clamp_min(1e-6)
    within = (logs.gather(2, row) - arrivals.clamp_min(FEW).log()) / fall.gather(2, row)
    return (row + within.clamp(-FAINTER, 1.0)).flatten(1)


def _last_not_above(rising: Tensor, wanted: Tensor) -> Tensor:
    """Last of the cells ``(B, E, P)``, but for the end, that is not above each wanted value ``(B, E, n)``."""
    found = torch.searchsorted(rising.detach().contiguous(), wanted.detach().contiguous(), right=True) - 1
    return found.clamp(0, rising.shape[-1] - 2)


def _place(cells: Tensor, base: Tensor, wanted: Tensor, places: int, found: Tensor | None = None) -> Tensor:
    """Solve ``W(r) = wanted`` for the range, W being the cells from ``base`` on; its cell may be ``found`` already."""
    if found is None:
        found = last_below(lambda j: cells.gather(1, base + j) <= wanted, torch.zeros_like(base), places - 1)
    low, high = cells.gather(1, base + found), cells.gather(1, base + found + 1)
    return found + ((wanted - low) / (high - low).clamp_min(FEW)).clamp(0.0, 1.0)


def _above(between: Tensor) -> Tensor:
    """Lambda at the nodes, ``(B, E, P)``, from the numbers between them."""
    return between.flip(1).cumsum(1).flip(1)


def _floor(position: Tensor, nodes: int) -> Tensor:
    """Node at or below a place, such that there is one after it; floating point, which multiplies faster."""
    return position.detach().floor().clamp(0, nodes - 2)


def _index(node: Tensor) -> Tensor:
    return node.to(torch.int64)


def _below(position: Tensor, nodes: int) -> Tensor:
    return _index(_floor(position, nodes))


def _lerp(flat: Tensor, index: Tensor, share: Tensor) -> Tensor:
    return torch.lerp(flat.gather(1, index), flat[:, 1:].gather(1, index), share)


def last_below(holds: Callable[[Tensor], Tensor], first: Tensor, cells: int) -> Tensor:
    """Largest index below ``cells`` at which a condition holds that does so up to some index; ``first`` at least."""
    index = first
    step = 1 << (cells - 1).bit_length() >> 1
    exact = 2 * step == cells
    while step:
        ahead = index + step
        here = ahead if exact else ahead.clamp_max(cells - 1)
        found = holds(here) if exact else holds(here) & (ahead < cells)
        index = index + step * found
        step >>= 1
    return index
