"""Calls of the compiled echoes: the returns of one kind of weather as compiled loops take them.

Results equal those of ``ReturnTable`` to rounding. Clouds in double precision, gradients, exported graphs and devices
other than the processor stay with torch.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from functools import partial
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from torchweather.core.compiled import uses_compiled
from torchweather.core.threads import side_by_side, threads_at_hand
from torchweather.lidar.beam import Beam
from torchweather.lidar.returns.beam_particles import BeamParticles
from torchweather.lidar.returns.soft_return import SoftReturn
from torchweather.lidar.returns.strongest import ARRIVAL_HIGH, ARRIVAL_LOW, ARRIVAL_NODES, PLACE_NODES, ReturnTable
from torchweather.pipeline.tiling import is_exporting

if TYPE_CHECKING:
    from torchweather.lidar.returns.compiled_echoes import Part

__all__ = [
    "FEWEST_BEAMS",
    "NO_MAP",
    "NO_ROW",
    "array_of",
    "compiled_echoes",
    "compiles",
    "is_plain",
    "no_part",
    "part_of",
]

FEWEST_BEAMS = 1 << 14  # of a thread of its own
LATE_STEP = math.log(ARRIVAL_HIGH / ARRIVAL_LOW) / (ARRIVAL_NODES - 1)
SLACK = 1e-3  # of the arrival from which on no echo counts, against rounding

Array = NDArray[np.float32]
NO_MAP: Array = np.zeros((0, 0), np.float32)
NO_ROW: Array = np.zeros(0, np.float32)


def is_plain(*tensors: Tensor | None) -> bool:
    """True where compiled loops may take tensors: single precision on the processor, no gradients, no tracing."""
    if is_exporting() or not uses_compiled():
        return False
    learns = torch.is_grad_enabled()
    return all(
        one is None or (one.device.type == "cpu" and one.dtype == torch.float32 and not (learns and one.requires_grad))
        for one in tensors
    )


def compiles(part: BeamParticles | SoftReturn, tensors: Iterable[Tensor | None]) -> bool:
    """True where compiled loops may draw the echoes of a part: single precision on the processor, no gradients.

    Args:
        part: what returns.
        tensors: inputs of the echoes.
    """
    return not (isinstance(part, BeamParticles) and part.published) and is_plain(*tensors)


def compiled_echoes(
    part: BeamParticles | SoftReturn,
    beam: Beam,
    reach_m: Tensor,
    arrival: Tensor,
    place: Tensor,
    table: ReturnTable,
    density: Tensor | None,
    faintest: Tensor | None,
) -> tuple[Tensor, Tensor]:
    """Range and signal, ``(B, N, echoes)``, of the strongest, the next strongest and so on; 0 where there is none.

    No more echoes than any beam has; the same on any number of threads.

    Args:
        part: what returns.
        beam: the sensor's.
        reach_m: ``(B, N)`` up to which it counts.
        arrival, place: ``(B, echoes, N)`` its variates.
        table: the solutions.
        density: ``(B or 1, N)`` of each beam over that of the weather; ``None`` is 1.
        faintest: signal of the faintest echo that counts; ``None`` counts every echo of the table.
    """
    from torchweather.lidar.returns.compiled_echoes import write_echoes

    batch, count = reach_m.shape
    ranges, signals = (torch.zeros(batch, arrival.shape[1], count) for _ in range(2))
    is_counted, densest = isinstance(part, BeamParticles), 1.0
    least = None if faintest is None else float(faintest)
    if density is not None and least is not None:
        # d times as many particles arrive d times as early; fog of that density is d times as bright.
        densest = max(float(density.max()), 1.0)
        least, densest = (least, densest) if is_counted else (least / densest, 1.0)
    reach = array_of(reach_m)
    of_beams = NO_MAP if density is None else array_of(density)
    shares = max(1, min(threads_at_hand(), count // FEWEST_BEAMS))
    edges = [count * share // shares for share in range(shares + 1)]
    counts = np.zeros((batch, count), np.int32)
    low = np.float32(0.0 if faintest is None else float(faintest))
    tasks = []
    is_shared, own = table.signal.stride(0) == 0, None  # one table of all samples
    for sample in range(batch):
        variates = array_of(arrival[sample]), array_of(place[sample])
        if own is not None and is_shared:
            own = own._replace(arrival=variates[0], at=variates[1])
        else:
            own = part_of(part, beam, table.of_sample(sample), *variates, least, densest)
        dense = of_beams[min(sample, len(of_beams) - 1)] if len(of_beams) else NO_ROW
        written = ranges[sample].numpy(), signals[sample].numpy(), counts[sample]
        call = partial(write_echoes, *written, reach[sample], dense, own, is_counted, low)
        tasks += [partial(call, first, last, 0) for first, last in pairwise(edges)]
    side_by_side(tasks)
    echoes = max(int(counts.max(initial=1)), 1)
    return ranges[:, :echoes].transpose(1, 2), signals[:, :echoes].transpose(1, 2)


def array_of(values: Tensor) -> Array:
    """A tensor's values as float32 in row-major order."""
    array: Array = values.detach().float().contiguous().numpy()
    return array


def no_part() -> Part:
    """The returns of no weather."""
    from torchweather.lidar.returns.compiled_echoes import Part

    return Part(NO_ROW, NO_ROW, NO_ROW, NO_MAP, NO_MAP, 2, 2, 2, 2, *([np.float32(0.0)] * 10))


def part_of(
    part: BeamParticles | SoftReturn,
    beam: Beam,
    table: ReturnTable,
    arrival: Array,
    place: Array,
    faintest: float | None,
    densest: float = 1.0,
) -> Part:
    """Returns of one kind of weather for one sample.

    Args:
        part: what returns.
        beam: the sensor's.
        table: of this sample.
        arrival, place: ``(echoes, N)`` its variates.
        faintest: signal of the faintest echo that counts; ``None`` counts every echo of the table.
        densest: largest density of a beam over that of the weather.
    """
    from torchweather.lidar.returns.compiled_echoes import Part

    grid = part.grid
    if isinstance(part, SoftReturn):
        photon_signal = float(beam.threshold / part.photons_at_threshold)
        low, step = part.root_low, part.root_step
    else:
        photon_signal, low, step = 0.0, part.log_low, part.log_step
    signal = array_of(table.signal[0])
    never = 2.0
    if faintest is not None:
        along = math.sqrt(faintest / photon_signal) if photon_signal > 0 else math.log(faintest)
        never = _never(signal.reshape(table.places, ARRIVAL_NODES), (along - low) / step, densest)
    axis = (
        *(1.0 / LATE_STEP, math.log(ARRIVAL_LOW) / LATE_STEP),
        *(grid.near_m, grid.scale_m, (grid.nodes - 1) / grid.stretch, grid.stretch / (grid.nodes - 1)),
        *(low, step, photon_signal, never),
    )
    flat = (signal, array_of(table.share[0]), array_of(table.place[0]), arrival, place)
    sizes = (table.places, table.signals, ARRIVAL_NODES, PLACE_NODES)
    return Part(*flat, *sizes, *(np.float32(value) for value in axis))


def _never(signal: Array, faintest: float, densest: float) -> float:
    """Variate of an arrival from which on no beam has an echo of a place on the axis of signals.

    Args:
        signal: ``(places, arrivals)``; it falls with the arrival.
        faintest: the place.
        densest: factor by which particles may arrive later than of the weather.
    """
    counts = np.flatnonzero(signal.max(0) >= faintest - SLACK)
    last = 1 + int(counts[-1]) if counts.size else 0
    if last >= ARRIVAL_NODES - 1:
        return 2.0
    arrival = ARRIVAL_LOW * math.exp(LATE_STEP * last) * (1.0 + SLACK) * densest
    return -math.expm1(-arrival) + 1e-7
