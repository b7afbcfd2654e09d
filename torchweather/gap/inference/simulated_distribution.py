"""Distance of measured conditions from a simulator, in units of its own scatter.

A pool of simulated frames of each condition gives the distribution of its vector at the measured number of frames: its
mean and its scatter. How the scatter of one entry goes with that of another follows from the noise of portions of the
elements (beams, pixels, targets): simulated frames cannot tell it, they start from a handful of clear frames and know
only so many directions of noise. The residual is the measured vector's departure in those units, made independent
(whitened), so that each of its entries is about 1 if nothing is missing.

References:
    GAP.md 3 (2, 4). Shrinkage of a correlation matrix: Ledoit & Wolf 2004, Schaefer & Strimmer 2005.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from collections.abc import Set as AbstractSet
from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

from torchweather.gap.inference.calibrated_scatter import MeasuredSize, calibrated_scatter
from torchweather.gap.inference.config import NUMERICS, SCATTER
from torchweather.gap.inference.events_along_axes import EventsAlongAxes, events_along_axes
from torchweather.gap.statistics.frame_statistics import TINY, Layout, Pool, Reduced
from torchweather.gap.study.conditions import Condition
from torchweather.pipeline.effect import Effect

__all__ = [
    "SimulatedDistribution",
    "ElementNoise",
    "FrameModel",
    "Observation",
    "Whitening",
    "simulated_distribution",
    "element_noise",
    "observations",
]

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class ClearNoise:
    """Noise of clear frames in the means over the elements of frames in weather.

    Args:
        own: ``(P,)`` variance that a measured frame's noise makes of an entry, over that by which simulated frames of
            different clear frames differ: each is compared with the mean of the others.
        passed: ``(P,)`` variance that the noise of one clear frame makes of what is simulated from it, over that of a
            measured frame.
    """

    own: Floats
    passed: Floats


class FrameModel(Protocol):
    """Interface of a kind of sensor for the workflow: one file each."""

    @property
    def fit(self) -> Sequence[Condition]:
        """Conditions to be explained."""
        ...

    @property
    def holdout(self) -> Sequence[Condition]:
        """Conditions held out."""
        ...

    @property
    def clear_frames(self) -> Mapping[str, int]:
        """Number of clear frames of each scene."""
        ...

    @property
    def catalogue(self) -> Sequence[str]:
        """Ids of the effects that it can simulate."""
        ...

    @property
    def as_record(self) -> AbstractSet[str]:
        """Those that do what an error of the record does: none of them is named beside another."""
        ...

    layout: Layout
    effects: list[Effect]  # that it has already
    # Azimuth, rad, and range, m, of each cell of the map. A model that has them may say by ``standing(azimuth_rad,
    # range_m)`` where in and about one a thing stands in the measured frames: azimuth, range and width, or ``None``.
    # One that knows its elements from frame to frame says by ``repeated(condition)`` what ``MeasuredSize`` has so.
    map_cells: list[tuple[float, float]]
    sizes: Mapping[str, float | Sequence[float]]  # as in candidates.lines
    open_shifts: AbstractSet[str]  # statistics whose even shift by the clear frames' own error is among what is open

    def measured(self, condition: Condition) -> Reduced:
        """The condition's own frames."""
        ...

    def clear(self, scene_id: str, portions: int = 1) -> Reduced:
        """The clear frames of a scene, each compared with the others; each in so many portions of its elements."""
        ...

    def open(self, condition: Condition) -> Mapping[str, float]:
        """Names of what the model of a condition leaves open, with the least strength each can have."""
        ...

    def misplaced(self, condition: Condition) -> float:
        """Share of the particles of a condition that the model may put into a neighbouring bin of range."""
        ...

    def left_open(self, condition: Condition) -> Floats | float:
        """Scatter ``(P,)`` by what the clear frames leave open beside how they differ, one in all conditions of a
        scene."""
        ...

    def clear_noise(self, condition: Condition) -> ClearNoise | None:
        """Noise of clear frames, as far as it reaches a condition's; ``None`` where a frame has that of its own."""
        ...

    def render_near(self, condition: Condition, log_intensity: float) -> None:
        """Simulate the condition about this weather from here on."""
        ...

    def systematics(self, condition: Condition, strengths: Mapping[str, float]) -> list[Effect]:
        """Stages of what is left open, at strengths in standard deviations; none at 0."""
        ...

    def simulated(
        self,
        condition: Condition,
        effects: Sequence[Effect],
        log_intensity: float,
        seeds: Sequence[int],
        portions: int = 1,
    ) -> Reduced:
        """Simulated frames of the condition, one for each seed; each in so many portions of its elements.

        A model whose frames each depend on their own seed alone has ``each_frame_alone = True``: a few of them are then
        the first ones of many, and are simulated once.
        """
        ...


@dataclass(frozen=True)
class Observation:
    """A measured condition.

    Args:
        condition: of the study.
        vector: ``(P,)`` of its frames.
        enough: ``(P,)`` entries that hold enough to count.
        frames: their number.
        misplaced: as in ``FrameModel``.
        clear_frames: of its scene.
        left_open: as in ``FrameModel``.
        clear_noise: as in ``FrameModel``.
        repeated: as in ``MeasuredSize``.
    """

    condition: Condition
    vector: Floats
    enough: NDArray[np.bool_]
    frames: int
    misplaced: float = 0.0
    clear_frames: int = 1
    left_open: Floats | float = 0.0
    clear_noise: ClearNoise | None = None
    repeated: Floats | float = 1.0

    @property
    def intensity_sd(self) -> float:
        """Standard deviation of the logarithm of the weather's intensity, as the record states it."""
        return float(self.condition.rel_sd)


def observations(model: FrameModel, conditions: Sequence[Condition]) -> list[Observation]:
    """The measured vectors of conditions, their frames reduced once."""
    found = []
    for condition in conditions:
        pool = Pool(model.layout, model.measured(condition))
        number, clear = len(pool), model.clear_frames[condition.scene]
        vector = pool.vectors(np.arange(number)[None], condition.time_s)[0]
        known = (model.misplaced(condition), clear, model.left_open(condition), model.clear_noise(condition))
        enough = pool.enough(number) & pool.mostly_seen(Pool(model.layout, model.clear(condition.scene)))
        repeated = getattr(model, "repeated", lambda condition: 1.0)(condition)
        found.append(Observation(condition, vector, enough, number, *known, repeated))
    return found


@dataclass(frozen=True)
class ElementNoise:
    """Effect on the vector of the independent noise of a frame's elements (beams, pixels, targets).

    Args:
        scatter: condition to ``(P,)`` standard deviation of each entry; 0 where it tells nothing.
        correlation: ``(P, P)`` of the entries, common to the conditions.
        elements: condition to ``(P,)`` how many elements of a frame tell it; none where that is left out.
        degrees_of_freedom: condition to ``(P,)``, with which that scatter is known; exactly where left out.
        folds: ``(folds, P, P)`` parts of the correlation that each fold of the portions makes; none where left out.
    """

    scatter: Mapping[str, Floats]
    correlation: Floats
    elements: Mapping[str, Floats] = field(default_factory=dict)
    degrees_of_freedom: Mapping[str, Floats] = field(default_factory=dict)
    folds: Floats | None = None


@dataclass(frozen=True)
class Whitening:
    """Makes departures independent.

    Args:
        factor: ``(P, P)`` lower Cholesky factor of the correlations, shrunk.
    """

    factor: Floats

    @classmethod
    def of(
        cls, noise: ElementNoise, sd: Mapping[str, Floats], events: EventsAlongAxes, layout: Layout | None = None
    ) -> Whitening:
        """Correlations of entries whose scatter ``sd`` is the elements' and more that is each entry's own; of counts
        also as far as no event was simulated.

        An entry is made independent of those before it. Of correlations that few portions tell it then scatters by
        more than 1, and by less where shrinking keeps it from following the others. So each fold of the portions is
        whitened with the correlations of the other folds, and its mean square, group by group of the layout, is the
        variance that the entries have (cross-validation, Stone 1974).
        """
        names = list(noise.scatter)
        share = np.mean([noise.scatter[name] / np.maximum(sd[name], 1e-300) for name in names], 0)
        share = np.clip(share, 0.0, 1.0)
        factor = _shrunk_factor(events.mixed(noise.correlation, share))
        if noise.folds is None or layout is None:
            return cls(factor)
        left = np.zeros(len(factor))
        for fold in noise.folds:
            others = noise.correlation - fold
            spread = np.sqrt(np.maximum(np.diag(others), 1e-12))
            own = events.mixed(len(noise.folds) * fold, share)
            # What the elements do not tell of an entry's scatter is its own.
            np.fill_diagonal(own, np.diag(own) + 1.0 - np.diag(events.mixed(noise.correlation, share)))
            of_others = _shrunk_factor(events.mixed(others / np.outer(spread, spread), share))
            whitened = solve_triangular(of_others, own, lower=True)
            left += (solve_triangular(of_others, whitened.T, lower=True).diagonal()) / len(noise.folds)
        told = np.diag(noise.correlation) > 0.5
        for part in layout.slices:
            some = told[part]
            left[part] = left[part][some].mean() if some.any() else 1.0
        return cls(factor * np.sqrt(left))

    def __call__(self, scaled: Floats) -> Floats:
        """Departures ``(..., P)`` in units of their scatter to independent ones."""
        flat = scaled.reshape(-1, scaled.shape[-1])
        found: Floats = solve_triangular(self.factor, flat.T, lower=True).T.reshape(scaled.shape)
        return found

    def undone(self, independent: Floats) -> Floats:
        """Back to units of the scatter, ``(..., P)``."""
        found: Floats = independent @ self.factor.T
        return found


def _shrunk_factor(correlation: Floats) -> Floats:
    """Lower Cholesky factor of correlations ``(P, P)``, shrunk towards zero."""
    found = (1.0 - SCATTER.shrinkage) * correlation
    np.fill_diagonal(found, 1.0)
    return np.asarray(np.linalg.cholesky(found), dtype=np.float64)


@dataclass(frozen=True)
class SimulatedDistribution:
    """The simulator at one setting.

    Args:
        mean, sd: condition to ``(P,)`` mean of the vector and its scatter at the measured number of frames, with the
            error of that mean; of means without what whole frames do, which is a nuisance (``search.py``), and without
            what is shared.
        total: the scatter with what whole frames do.
        used: condition to ``(P,)`` entries that count.
        whitening: common to all conditions.
        draws: condition to ``(DRAWS, P)`` vectors of the simulator itself.
        independent: condition to ``(P,)`` scatter that each entry would have if its elements were independent.
        shared: condition to ``(P,)`` what the error of its scene's clear mean adds, in units of ``sd``: it is the same
            one for all conditions of the scene (``search.py``).
        expected: condition to ``(P,)`` mean square of a departure by noise, in units of ``total``: 1, and less where
            hardly anything can happen.
        model: condition to ``(P,)`` share of that scatter squared that is the error of a model of the sensor.
        event: condition to ``(P,)`` square of one event beyond the expected ones, in the same units; 0 of what has
            none.
        degrees_of_freedom: condition to ``(P,)`` degrees of freedom with which that scatter is known.
        told_by_clear: condition to ``(P,)`` share of what is not known of it that is alike in all statistics: by the
            clear frames.
    """

    mean: Mapping[str, Floats]
    sd: Mapping[str, Floats]
    total: Mapping[str, Floats]
    used: Mapping[str, NDArray[np.bool_]]
    whitening: Whitening
    draws: Mapping[str, Floats]
    independent: Mapping[str, Floats]
    shared: Mapping[str, Floats]
    expected: Mapping[str, Floats]
    model: Mapping[str, Floats]
    event: Mapping[str, Floats]
    degrees_of_freedom: Mapping[str, Floats]
    told_by_clear: Mapping[str, Floats]

    def whitened(self, name: str, difference: Floats) -> Floats:
        """Whitened difference of vectors ``(..., P)``; entries that do not count are 0."""
        scaled = np.where(self.used[name], difference / self.sd[name], 0.0)
        return self.whitening(scaled)

    def with_scatter(self, sd: Mapping[str, Floats], total: Mapping[str, Floats]) -> SimulatedDistribution:
        """The same with another scatter; what a scene's conditions share stays what it is."""
        shared = {name: self.shared[name] * (self.sd[name] / np.maximum(sd[name], TINY)) for name in sd}
        return replace(self, sd=sd, total=total, shared=shared)

    def z(self, target: Observation) -> Floats:
        """Departure of each entry in units of its total scatter, 0 where it does not count."""
        name = target.condition.id
        found: Floats = np.where(self.used[name], (target.vector - self.mean[name]) / self.total[name], 0.0)
        return found


def simulated_distribution(
    pools: Mapping[str, Pool],
    measured: Sequence[Observation],
    noise: ElementNoise,
    start: SimulatedDistribution | None,
    seed: int,
) -> SimulatedDistribution:
    """The distribution of the vectors that pools of simulated frames give.

    Args:
        pools: condition to simulated frames.
        measured: the conditions, with their number of frames.
        noise: of the elements.
        start: the model without effects, whose whitening is kept; ``None`` where this is it. The noise of elements is
            its noise, and grows as the elements' own spread does.
        seed: of the draws.
    """
    layout = next(iter(pools.values())).layout
    independent = {t.condition.id: pools[t.condition.id].independent_scatter(t.frames) for t in measured}
    elements, least = {}, {}
    # Two frames about their mean differ alike in either order: the scatter of such squares is that of their law.
    of_squares = layout.each(
        lambda group: (
            (group.statistic in layout.from_clear and group.kind in ("spread", "mean"))
            or group.statistic in layout.about_clear_mean
        )
    )
    for target in measured:
        name = target.condition.id
        few = of_squares & (target.clear_frames < SCATTER.frames_for_spread)
        before = independent[name] if start is None else start.independent[name]
        grown = np.where(layout.averages, np.maximum(independent[name] / np.maximum(before, TINY), 1.0), 1.0)
        alike = math.sqrt(squares_about_clear_mean(target.frames, target.clear_frames))
        # Where far more elements are seen than when their noise was looked at, in other weather, those tell it.
        more = _elements(pools[name], 1) > SCATTER.more_elements * noise.elements.get(name, np.inf)
        of_few = pools[name].scatter_of_few(target.frames, SCATTER.counting_prior_frames)
        least[name] = np.where(more, np.maximum(independent[name], of_few), 0.0)
        own = np.maximum(noise.scatter[name] * np.where(more, 1.0, grown), least[name])
        elements[name] = np.where(few, independent[name] * alike, own)
    sizes = {
        t.condition.id: MeasuredSize(
            t.frames,
            t.clear_frames,
            t.condition.time_s,
            t.misplaced,
            1.0 if t.clear_noise is None else t.clear_noise.passed,
            t.repeated,
        )
        for t in measured
    }
    found = calibrated_scatter(pools, sizes, elements, seed, noise.degrees_of_freedom, least)
    sds, owns, totals, used, shared = {}, {}, {}, {}, {}
    for target in measured:
        name = target.condition.id
        found[name] = one = found[name].beside(target.left_open)
        clear = np.where(one.shared, one.clear, 0.0)
        apart = one.own + one.simulated + (one.clear - clear)
        sds[name], owns[name] = np.sqrt(np.maximum(apart, TINY**2)), np.sqrt(np.maximum(one.own, TINY**2))
        totals[name] = np.sqrt(np.maximum(apart + clear, TINY**2))
        shared[name] = np.sqrt(clear / np.maximum(apart, TINY**2))
        used[name] = target.enough & pools[name].enough(target.frames) & (apart > TINY**2)
    # The clear frames' noise is that of the same elements: it goes together as the frames' own does.
    whitening = (
        Whitening.of(noise, owns, events_along_axes(layout, pools), layout) if start is None else start.whitening
    )
    return SimulatedDistribution(
        mean={name: one.mean for name, one in found.items()},
        sd=sds,
        total=totals,
        used=used,
        whitening=whitening,
        draws={name: one.draws for name, one in found.items()},
        independent=independent,
        shared=shared,
        expected={name: one.expected for name, one in found.items()},
        model={name: one.model for name, one in found.items()},
        event={name: one.event for name, one in found.items()},
        degrees_of_freedom={name: one.degrees_of_freedom for name, one in found.items()},
        told_by_clear={name: one.told_by_clear for name, one in found.items()},
    )


def element_noise(portioned: Mapping[str, Pool], measured: Sequence[Observation], portions: int) -> ElementNoise:
    """Scatter and correlations from the noise of portions of the elements.

    Args:
        portioned: condition to simulated frames times their portions.
        measured: the conditions.
        portions: of a frame.
    """
    size = next(iter(portioned.values())).layout.size
    folds = np.zeros((NUMERICS.whitening_folds, size, size))
    scatter, known = {}, {}
    layout = next(iter(portioned.values())).layout
    about_own = layout.each(lambda group: group.statistic in layout.about_own_mean)
    averages = layout.averages & ~about_own
    about_clear = layout.each(lambda group: group.statistic in layout.about_clear_mean)
    for target in measured:
        name, clear = target.condition.id, target.clear_frames
        apart = portioned[name].element_noise(portions, target.frames, clear)
        # Departures from the mean of the other clear frames are larger than those from the mean of all.
        of_others = (clear - 1) / clear if clear > 1 else 1.0
        own = of_others if target.clear_noise is None else np.sqrt(target.clear_noise.own)
        apart *= np.where(averages & ~about_clear, own, 1.0)
        apart *= np.where(about_clear, math.sqrt(squares_about_clear_mean(target.frames, clear)), 1.0)
        apart *= np.sqrt(layout.each(lambda group: layout.scatter_share.get(group.statistic, 1.0)))
        apart *= np.where(about_own, math.sqrt(squares_go_together(min(target.frames, clear), clear)), 1.0)
        scatter[name] = np.sqrt((apart**2).sum(1).mean(0))
        independent = min(len(apart), clear) - 1
        known[name] = _degrees_of_freedom((apart**2).mean(0), independent)
        unit = apart / np.where(scatter[name] > 0, scatter[name], 1.0)
        unit = np.where(target.enough, unit, 0.0)
        # Each fold has other portions of each frame: the measured frames have the same elements, with new noise. Of few
        # clear frames the noise of one follows from the others', so their folds are of portions alone.
        frame = np.arange(len(apart) if clear >= len(apart) else 1)[:, None]
        fold_of = np.broadcast_to((np.arange(portions) + frame) % len(folds), unit.shape[:2])
        for number in range(len(folds)):
            own_portions = unit[fold_of == number]
            folds[number] += own_portions.T @ own_portions / len(apart)
    spread = np.sqrt(np.diag(folds.sum(0)))
    folds /= np.maximum(np.outer(spread, spread), 1e-12)
    each = {target.condition.id: _elements(portioned[target.condition.id], portions) for target in measured}
    return ElementNoise(scatter, folds.sum(0), each, known, folds)


def _degrees_of_freedom(squares: Floats, independent: int) -> Floats:
    """Degrees of freedom ``(P,)`` of a variance that is a sum of those of portions.

    Of m independent frames a portion's variance q is known to 2 / m of its square, which is about ``q^2 m / (m + 2)``:
    all together have ``(m + 2) (sum q)^2 / sum q^2 - 2`` (Satterthwaite 1946; m where one portion makes all of it).

    Args:
        squares: ``(portions, P)`` q.
        independent: m.
    """
    uneven = (squares**2).sum(0)
    found = (independent + 2.0) * squares.sum(0) ** 2 / np.where(uneven > 0.0, uneven, 1.0) - 2.0
    return np.where(uneven > 0.0, found, np.inf)


def _elements(pool: Pool, portions: int) -> Floats:
    """Number of elements of a frame in the bin of each entry ``(P,)``; 0 of what has no bins."""
    found = np.zeros(pool.layout.size)
    found[: pool.layout.bins] = pool.frames.weight.mean(0) * portions
    return found


def squares_about_clear_mean(frames: int, clear: int) -> float:
    """Variance of a mean of squares of so many frames about the mean of K clear ones, over that of independent ones.

    Each departure has 1/K of its variance from the common mean, so two of them correlate by 1/K, their squares by
    ``1/K^2``; more than K frames lie about means of other clear frames.

    Example:
        >>> squares_about_clear_mean(2, 2), squares_about_clear_mean(6, 8)
        (1.25, 1.078125)
    """
    return 1.0 + (min(frames, clear) - 1) / clear**2


def squares_go_together(together: int, clear: int) -> float:
    """Variance of a sum of squares about an element's own mean, over what so many independent terms of the scatter that
    they have from frame to frame would give.

    With m frames about their mean the squares have the variance V and correlate by ``1 / (m - 1)^2``, so their sum has
    ``m V m / (m - 1)``; over K frames in blocks of m they scatter by ``V (1 - 1 / ((m - 1) (K - 1)))`` alone.

    Args:
        together: m, frames about whose mean they are.
        clear: K, clear frames from which frames are simulated.

    Returns:
        The ratio; 1 where two frames cannot tell it, as both squares are one number.

    Example:
        >>> squares_go_together(3, 3), squares_go_together(6, 6), squares_go_together(2, 2)
        (2.0, 1.25, 1.0)
    """
    if together < 2 or clear < 3:
        return 1.0
    m, k = float(together), float(clear)
    return m / (m - 1.0) / (1.0 - 1.0 / ((m - 1.0) * (k - 1.0)))
