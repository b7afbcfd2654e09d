"""Statistics of frames along physical axes: sums per frame, and vectors of stabilised values from several frames.

A frame is reduced once, to sums over bins (weights, values, squares), a few scalars and a coarse map. A condition is a
handful of frames; its vector holds, with the variance of each entry made nearly independent of its size:

- ``share``: asin sqrt of the share, ``(sum v + 3/8) / (sum w + 3/4)``;
- ``count``: sqrt(sum v + 3/8), of so many frames;
- ``mean``: sum v / sum w;
- ``spread``: half the logarithm of the variance inside the bin;
- ``between``: logarithm of the standard deviation of a scalar from frame to frame;
- ``slope``: of a scalar over time, from the first frame to the last;
- ``persistence``: sqrt of the mean product of the maps of two different frames: what stays in its place.

References:
    GAP.md 3 (1). Anscombe 1948 (square root of counts), Freeman & Tukey 1950 (shares), Jaeckel 1972 (infinitesimal
    jackknife).
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from torchweather.gap.inference.config import NUMERICS, SCATTER
from torchweather.gap.statistics.counting import ANSCOMBE

__all__ = [
    "COUNTED",
    "COUNTING",
    "FEWEST",
    "PARTICLE_AXIS",
    "TINY",
    "Group",
    "Layout",
    "Pool",
    "Reduced",
]

Floats = NDArray[np.float64]

FEWEST = {"share": 20.0, "mean": 12.0, "spread": 30.0}
"""Least weight in a bin, over all frames of a condition, for which its entry counts."""
COUNTED = ("share", "count")  # kinds whose stated scatter is that of counting
COUNTING = 0.5  # scatter of a stabilised count
PARTICLE_AXIS = "particle_range_m"
TINY = 1e-12


@dataclass(frozen=True)
class Group:
    """Entries of one statistic along one axis.

    Args:
        statistic: what is looked at, such as ``log_intensity_ratio``.
        axis: along what, with its unit in the name, such as ``range_m``.
        kind: how sums become an entry (see the module).
        edges: of the bins; of a ``between``, ``slope`` or ``persistence`` group ``(0, 1)``.
        known_to: of a mean, standard deviation by which each of its elements may be another than the model's, in all
            frames alike; in units of the statistic.
    """

    statistic: str
    axis: str
    kind: str
    edges: tuple[float, ...]
    known_to: float = 0.0

    @property
    def bins(self) -> int:
        """Number of entries."""
        return len(self.edges) - 1

    def is_average_of(self, statistic: str) -> bool:
        """True where the entries are means of a statistic of the elements themselves, which a whole frame can move."""
        return self.statistic == statistic and self.kind == "mean" and self.axis != PARTICLE_AXIS


@dataclass(frozen=True)
class Layout:
    """Where each group stands in the vector.

    Args:
        binned: groups made from sums over bins.
        scalars: names of the scalars of a frame; each gives a ``between`` and a ``slope`` entry.
        steady: of each scalar, scatter from frame to frame below which frames are called alike.
        maps: names of the maps of a frame; each gives a ``persistence`` entry.
        from_clear: shares, counts and spreads of what happens in clear frames by chance, as often and as far as those
            tell: their error is one and the same in all conditions of a scene.
        about_own_mean: means of squares about an element's own mean over the frames: those of different frames go
            together.
        about_clear_mean: squares, or products of two elements, about the mean of the clear frames.
        scatter_share: statistics whose variance is not what portions, or simulated frames, tell: its ratio to that.
        same_events: counted statistics to another one that counts the same events.
        of_seen: statistics whose values also decide which elements are seen in weather.
        near_counts: scalars that are stabilised numbers of particles nearer than an edge of range.
    """

    binned: tuple[Group, ...]
    scalars: tuple[str, ...]
    steady: tuple[float, ...]
    maps: tuple[str, ...]
    from_clear: tuple[str, ...] = ()
    about_own_mean: tuple[str, ...] = ()
    about_clear_mean: tuple[str, ...] = ()
    scatter_share: Mapping[str, float] = field(default_factory=dict)
    same_events: Mapping[str, str] = field(default_factory=dict)
    of_seen: tuple[str, ...] = ()
    near_counts: tuple[str, ...] = ()

    @property
    def groups(self) -> tuple[Group, ...]:
        """All groups in the order of the vector."""
        between = [Group(name, "frame", "between", (0.0, 1.0)) for name in self.scalars]
        slope = [Group(name, "time", "slope", (0.0, 1.0)) for name in self.scalars]
        persistence = [Group(name, "place", "persistence", (0.0, 1.0)) for name in self.maps]
        return (*self.binned, *between, *slope, *persistence)

    @property
    def slices(self) -> list[slice]:
        """Place of each group."""
        ends = np.cumsum([0] + [group.bins for group in self.groups])
        return [slice(int(a), int(b)) for a, b in itertools.pairwise(ends)]

    @property
    def size(self) -> int:
        """Number of entries."""
        return sum(group.bins for group in self.groups)

    def each(self, of: Callable[[Group], Any]) -> NDArray[Any]:
        """Value of a group for each of its entries, ``(size,)``.

        Example:
            >>> layout = Layout((Group("ratio", "x", "mean", (0.0, 1.0, 2.0)),), ("ratio",), (1e-3,), ())
            >>> layout.each(lambda group: group.kind).tolist()
            ['mean', 'mean', 'between', 'slope']
        """
        return np.concatenate([np.full(group.bins, of(group)) for group in self.groups])

    @property
    def averages(self) -> NDArray[np.bool_]:
        """``(size,)`` entries that are means of elements (``Group.is_average_of``)."""
        return self.each(lambda group: group.is_average_of(group.statistic))

    @property
    def by_elements(self) -> NDArray[np.bool_]:
        """``(size,)`` entries whose scatter is that of the noise of elements: means of them, and what happens to them
        by chance in clear frames, but for counts."""
        from_clear = self.each(lambda group: group.statistic in self.from_clear)
        counted = self.each(lambda group: group.kind in COUNTED)
        return np.asarray((self.averages | from_clear) & ~counted, dtype=np.bool_)

    @property
    def bins(self) -> int:
        """Number of entries that come from sums over bins."""
        return sum(group.bins for group in self.binned)


@dataclass(frozen=True)
class Reduced:
    """Statistics that are kept of frames.

    Args:
        weight, value, square: ``(F, bins)`` sums over the elements of each bin of w, w v, w v^2.
        scalar: ``(F, scalars)``.
        maps: ``(F, maps, cells)``, of one number of cells.
    """

    weight: Floats
    value: Floats
    square: Floats
    scalar: Floats
    maps: Floats

    def __len__(self) -> int:
        return len(self.weight)

    def __getitem__(self, some: slice) -> Reduced:
        """Some of the frames."""
        return Reduced(*(values[some] for values in self._parts))

    @property
    def _parts(self) -> tuple[Floats, ...]:
        return self.weight, self.value, self.square, self.scalar, self.maps

    @classmethod
    def joined(cls, parts: Sequence[Reduced]) -> Reduced:
        """The frames of several, one after the other."""
        return cls(*(np.concatenate(of_all) for of_all in zip(*(part._parts for part in parts), strict=True)))


class Pool:
    """Frames of one condition, from which vectors are made.

    Args:
        layout: of the vector.
        frames: the reduced frames.
        start: ``(F,)`` the clear frame that each started from; ``None``: each from one of its own.
    """

    def __init__(self, layout: Layout, frames: Reduced, start: NDArray[np.intp] | None = None) -> None:
        self.layout, self.frames = layout, frames
        self.start = np.arange(len(frames)) if start is None else start

    def __len__(self) -> int:
        return len(self.frames)

    def vectors(self, index: NDArray[np.intp], time_s: Floats | None = None) -> Floats:
        """Vectors ``(R, size)`` of R draws of n frames each.

        Args:
            index: ``(R, n)`` frames of each draw, in the order of time.
            time_s: ``(n,)`` their times; ``None`` is evenly spaced.
        """
        frames, layout = self.frames, self.layout
        weight, value, square = (getattr(frames, name)[index].sum(1) for name in ("weight", "value", "square"))
        parts = []
        start = 0
        for group in layout.binned:
            part = slice(start, start + group.bins)
            start += group.bins
            parts.append(_entry(group.kind, weight[:, part], value[:, part], square[:, part]))
        scalar = frames.scalar[index]  # (R, n, S)
        parts += [_between(scalar, np.asarray(layout.steady)), _slope(scalar, time_s)]
        maps = frames.maps[index]  # (R, n, M, cells)
        parts.append(_persistence(maps))
        return np.concatenate(parts, 1)

    def averages(self, noise: Floats) -> dict[str, tuple[Floats, float]]:
        """Mean over all elements of each frame ``(F,)`` of every statistic that a whole frame can move.

        Args:
            noise: ``(size,)`` variance of each entry of one frame, independent from bin to bin.

        Returns:
            The means, and the variance that this noise gives them.
        """
        found: dict[str, tuple[Floats, float]] = {}
        start = 0
        for group in self.layout.binned:
            part = slice(start, start + group.bins)
            start += group.bins
            if group.is_average_of(group.statistic) and group.statistic not in found:
                weight, value = self.frames.weight[:, part], self.frames.value[:, part].sum(1)
                whole = np.maximum(weight.sum(1), TINY)
                share = (weight / whole[:, None]).mean(0)
                found[group.statistic] = value / whole, float((share**2 * noise[part]).sum())
        return found

    def influence(self, number: int) -> Floats:
        """Influence of each frame ``(F, size)`` on the vector of ``number`` frames; 0 of what is no sum over bins.

        The infinitesimal jackknife: derivative of the entry by the frame's departure from the mean frame.
        """
        parts = [getattr(self.frames, name) for name in ("weight", "value", "square")]
        found = np.zeros((len(self), self.layout.size))
        start = 0
        for group in self.layout.binned:
            part = slice(start, start + group.bins)
            start += group.bins
            means = [values[:, part].mean(0) for values in parts]
            here = [number * mean for mean in means]
            moved = [
                total + NUMERICS.linear_step * (values[:, part] - mean)
                for total, values, mean in zip(here, parts, means, strict=True)
            ]
            found[:, part] = (_entry(group.kind, *moved) - _entry(group.kind, *here)) / NUMERICS.linear_step
        return found

    def element_noise(self, portions: int, number: int, clear_frames: int) -> Floats:
        """Departures ``(frames, portions, size)`` of the vector of ``number`` frames by the noise of one portion of the
        elements alone: squared and summed over the portions, their mean over the frames is the noise of all elements.

        The infinitesimal jackknife, of each portion about its own mean over the frames: what differs from element to
        element in all frames alike is no noise. Entries that are not sums over bins come out 0: between frames nothing
        is known of them here.

        Args:
            portions: the rows of the pool are frames times so many.
            number: of frames of the vector.
            clear_frames: from which the pool's frames were made, in turn.
        """
        frames, bins = self.frames, self.layout.bins
        count = len(frames) // portions
        independent = min(count, clear_frames)
        scale = math.sqrt(number * independent / max(independent - 1, 1))
        totals, noises = [], []
        for name in ("weight", "value", "square"):
            shaped = getattr(frames, name).reshape(count, portions, bins)
            mean = shaped.mean(0)
            totals.append(number * mean.sum(0))
            noises.append(scale * (shaped - mean))
        found = np.zeros((count, portions, self.layout.size))
        start = 0
        for group in self.layout.binned:
            part = slice(start, start + group.bins)
            start += group.bins
            here = [total[part] for total in totals]
            moved = [
                total[part] + NUMERICS.linear_step * noise[..., part]
                for total, noise in zip(totals, noises, strict=True)
            ]
            found[..., part] = (_entry(group.kind, *moved) - _entry(group.kind, *here)) / NUMERICS.linear_step
        return found

    def independent_scatter(self, number: int) -> Floats:
        """Scatter ``(size,)`` of the entries of ``number`` frames whose elements are independent of each other; 0 of
        entries that are no sums over bins."""
        weight, value, square = (getattr(self.frames, name).mean(0) * number for name in ("weight", "value", "square"))
        found = np.zeros(self.layout.size)
        start = 0
        for group in self.layout.binned:
            part = slice(start, start + group.bins)
            start += group.bins
            found[part] = _independent_scatter(group.kind, weight[part], value[part], square[part])
        return found

    def scatter_of_few(self, number: int, prior: float) -> Floats:
        """Scatter ``(size,)`` of means of ``number`` frames whose elements are as different as all of their statistic,
        as much as so many elements weigh; 0 of other entries.

        The few elements of a bin may be one, seen again and again, and another one next time.

        Args:
            number: of frames.
            prior: number of elements that the variance over all bins weighs.
        """
        weight, value, square = (getattr(self.frames, name).mean(0) * number for name in ("weight", "value", "square"))
        found = np.zeros(self.layout.size)
        for group, part in zip(self.layout.binned, self.layout.slices, strict=False):
            if group.kind == "mean":
                some = np.maximum(weight[part], TINY)
                whole = max(float(weight[part].sum()), TINY)
                of_bin = np.maximum(square[part] / some - (value[part] / some) ** 2, 0.0)
                of_all = max(float(square[part].sum()) / whole - (float(value[part].sum()) / whole) ** 2, 0.0)
                variance = (weight[part] * of_bin + prior * of_all) / (weight[part] + prior)
                found[part] = np.sqrt(variance / np.maximum(weight[part], 1.0))
        return found

    def known_to(self, number: int, misplaced: float = 0.0) -> Floats:
        """Standard deviation ``(size,)`` to which a model of the sensor is known, however many frames there are.

        Args:
            number: of frames.
            misplaced: share of the particles that the model may put into a neighbouring bin of range.
        """
        weight, value = (getattr(self.frames, name).mean(0) * number for name in ("weight", "value"))
        found = []
        start = 0
        for group in self.layout.groups:
            if group.kind == "persistence":
                pattern = self.frames.maps[:, self.layout.maps.index(group.statistic)].mean(0)
                # Particles that all lie in the ring beside: at most so much of the root of the summed squares.
                share = math.hypot(SCATTER.persistence_rel_error, misplaced)
                known = share * float(np.sqrt((pattern**2).sum()))
                found.append(np.full(group.bins, known))
            elif group.kind == "slope":
                # Of n even steps from first to last the squares about their mean sum up to n / 12.
                steady = self.layout.steady[self.layout.scalars.index(group.statistic)]
                found.append(np.full(group.bins, steady / math.sqrt(max(number, 3) / 12.0)))
            elif group.kind == "between":
                found.append(np.full(group.bins, self._between_known_to(group.statistic, misplaced)))
            else:
                part = slice(start, start + group.bins)
                start += group.bins
                known_to = group.known_to / np.sqrt(np.maximum(weight[part] / number, 1.0))
                if group.kind == "spread":
                    known_to = np.hypot(known_to, SCATTER.log_spread_error)
                if group.axis == PARTICLE_AXIS and misplaced > 0:
                    known_to = np.hypot(known_to, _known_to(group.kind, weight[part], value[part], misplaced))
                found.append(known_to)
        return np.concatenate(found)

    def _between_known_to(self, scalar: str, misplaced: float) -> float:
        """Error that misplaced particles make in how a near number of them differs from frame to frame.

        As far as all of those may lie beyond the edge, frames may be alike.
        """
        if misplaced <= 0 or scalar not in self.layout.near_counts:
            return 0.0
        place = self.layout.scalars.index(scalar)
        near = float(np.maximum(self.frames.scalar[:, place] ** 2 - ANSCOMBE, 0.0).mean())
        number = sum(
            float(self.frames.value[:, part].sum(1).mean())
            for group, part in zip(self.layout.binned, self.layout.slices, strict=False)
            if group.kind == "count"
        )
        share = min(misplaced * number / max(near, TINY), 1.0) if near > 0 else 0.0
        return share * 0.5 * math.log1p((COUNTING / self.layout.steady[place]) ** 2)

    def enough(self, number: int) -> NDArray[np.bool_]:
        """Entries ``(size,)`` for which ``number`` frames hold enough to count."""
        weight = self.frames.weight.mean(0) * number
        found = []
        start = 0
        for group in self.layout.groups:
            if group.kind in ("between", "slope"):
                found.append(np.full(group.bins, number >= 3))
            elif group.kind == "persistence":
                found.append(np.full(group.bins, number >= 2))
            else:
                part = weight[start : start + group.bins]
                found.append(part >= FEWEST[group.kind] if group.kind in FEWEST else np.ones(group.bins, bool))
                start += group.bins
        return np.concatenate(found)

    def mostly_seen(self, clear: Pool) -> NDArray[np.bool_]:
        """Entries ``(size,)`` that are no mean over a selection of what clear frames see (``Layout.of_seen``).

        Where weather hides most of a bin, the mean of the rest is that of the nearest and the brightest. How many and
        which they are depends on a signal's noise at the threshold, which clear frames tell to their own noise only.
        """
        found = np.ones(self.layout.size, dtype=np.bool_)
        seen, all_of_them = self.frames.weight.mean(0), clear.frames.weight.mean(0)
        selected = self.layout.each(lambda group: group.is_average_of(group.statistic))[: self.layout.bins]
        selected &= self.layout.each(lambda group: group.statistic in self.layout.of_seen)[: self.layout.bins]
        found[: self.layout.bins] = ~selected | (seen >= SCATTER.mostly_seen_share * all_of_them)
        return found


def _known_to(kind: str, weight: Floats, value: Floats, misplaced: float) -> Floats:
    """Error that misplaced particles make in the entries of a group along the range of particles."""
    number = value if kind == "count" else weight
    beside = np.convolve(number, [1.0, 0.0, 1.0], "same")
    share = np.minimum(misplaced * (1.0 + beside / np.maximum(number, 1.0)), 1.0)  # of a bin's own particles
    if kind == "count":
        found: Floats = 0.5 * share * np.sqrt(number + ANSCOMBE)
    elif kind == "share":
        inside = (value + ANSCOMBE) / (weight + 2.0 * ANSCOMBE)
        found = np.abs(np.arcsin(np.sqrt(np.clip(inside - share, 0.0, 1.0))) - np.arcsin(np.sqrt(inside)))
    elif kind == "spread":
        found = np.hypot(share, SCATTER.log_read_spread_error)
    else:
        found = share
    return found


def _independent_scatter(kind: str, weight: Floats, value: Floats, square: Floats) -> Floats:
    """Scatter of an entry from the sums over its bin."""
    if kind == "count":
        return np.full(weight.shape, COUNTING)
    some = np.maximum(weight, 1.0)
    if kind == "share":
        found: Floats = COUNTING / np.sqrt(some)
    elif kind == "spread":
        found = np.sqrt(0.5 / some)
    else:
        mean = value / np.maximum(weight, TINY)
        found = np.sqrt(np.maximum(square / np.maximum(weight, TINY) - mean**2, TINY) / some)
    return found


def _entry(kind: str, weight: Floats, value: Floats, square: Floats) -> Floats:
    some = np.maximum(weight, TINY)
    if kind == "share":
        found: Floats = np.arcsin(np.sqrt((value + ANSCOMBE) / (weight + 2.0 * ANSCOMBE)))
    elif kind == "count":
        found = np.sqrt(value + ANSCOMBE)
    elif kind == "mean":
        found = value / some
    else:
        variance = np.maximum(square / some - (value / some) ** 2, TINY)
        found = 0.5 * np.log(variance)
    return found


def _between(scalar: Floats, steady: Floats) -> Floats:
    """Logarithm of the standard deviation over the frames, ``(R, S)``."""
    if scalar.shape[1] < 2:
        return np.zeros((len(scalar), scalar.shape[2]))
    found: Floats = 0.5 * np.log(scalar.var(1, ddof=1) + steady**2)
    return found


def _slope(scalar: Floats, time_s: Floats | None) -> Floats:
    """Change from the first frame to the last, by least squares, ``(R, S)``."""
    number = scalar.shape[1]
    if number < 3:
        return np.zeros((len(scalar), scalar.shape[2]))
    time = np.arange(number, dtype=np.float64) if time_s is None else np.asarray(time_s, dtype=np.float64)
    span = time.max() - time.min()
    centred = (time - time.mean()) / (span if span > 0 else 1.0)
    found: Floats = np.einsum("n,rns->rs", centred, scalar) / max(float(centred @ centred), TINY)
    return found


def _persistence(maps: Floats) -> Floats:
    """Root of the summed products of two different frames' maps, ``(R, M)``: what stays in its place."""
    number = maps.shape[1]
    if number < 2:
        return np.zeros((len(maps), maps.shape[2]))
    pairs = (maps.sum(1) ** 2 - (maps**2).sum(1)).sum(-1) / (number * (number - 1))
    found: Floats = np.sqrt(np.maximum(pairs, 0.0))
    return found
