"""Scatter of measured vectors about the simulated mean, calibrated: a perfect model departs by 1 in the mean square.

Everything comes from paired simulated frames: from draws of as many as were measured, from their components within and
between clear frames (``frame_components.py``), and, of means of elements, from the noise of portions of the elements.
The law of counting is taken in where little was counted, as much as it differs from what the bins of that statistic
show together. Nothing is enlarged for safety; what a model of a sensor is known to is added by name.

References:
    GAP.md 3 (2). Wood 2010 (synthetic likelihood), Efron & Morris 1973 (estimates shrunk towards common ones).
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from functools import lru_cache, partial

import numpy as np
from numpy.typing import NDArray
from scipy.special import digamma, polygamma
from scipy.stats import chi2, norm

from torchweather.gap.inference.config import METHOD, NUMERICS, SCATTER
from torchweather.gap.inference.frame_components import FrameComponents, between_share, frame_components
from torchweather.gap.statistics.counting import (
    ANSCOMBE,
    counted_variance,
    expected_number,
    one_event_sd,
    unseen_events,
)
from torchweather.gap.statistics.frame_statistics import COUNTED, TINY, Group, Layout, Pool

__all__ = ["CalibratedScatter", "MeasuredSize", "calibrated_scatter", "log_sd_tail_variance", "log_sd_variance"]

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class MeasuredSize:
    """Amount that was measured of a condition.

    Args:
        frames: n, of the condition.
        clear_frames: K, of its scene.
        time_s: of the frames.
        misplaced: share of the particles that the model may put into a neighbouring bin of range.
        clear_noise: ``(P,)`` variance of means of elements by the noise of one clear frame, over that of a frame.
        repeated: ``(P,)`` measured frames in which the element of an event is counted, at the mean of all events: by so
            much more than independent ones do their sums scatter.
    """

    frames: int
    clear_frames: int
    time_s: Floats | None = None
    misplaced: float = 0.0
    clear_noise: Floats | float = 1.0
    repeated: Floats | float = 1.0


@dataclass(frozen=True)
class CalibratedScatter:
    """Of the vector of one condition; variances ``(P,)``.

    Args:
        mean, draws: of vectors of as many frames as were measured, ``(P,)`` and ``(R, P)``.
        own: of the measured frames.
        simulated: of the simulated mean.
        clear: by the error of the clear frames.
        shared: ``(P,)`` whether that error is the same in all conditions of a scene.
        expected: mean square of a departure that noise makes over the sum of the three: below 1 where hardly
            anything can happen.
        model: share of the sum of the three that is the error of a model of the sensor, alike in all conditions.
        event: square of a departure by one event beyond the expected ones, over the sum of the three; 0 of what has
            none.
        degrees_of_freedom: with which the sum of the three is known: of Student's law of a departure.
        told_by_clear: share of what is not known of it that clear frames make: it is the same in all statistics.
    """

    mean: Floats
    draws: Floats
    own: Floats
    simulated: Floats
    clear: Floats
    shared: NDArray[np.bool_]
    expected: Floats
    model: Floats
    event: Floats
    degrees_of_freedom: Floats
    told_by_clear: Floats

    def beside(self, left_open: Floats | float) -> CalibratedScatter:
        """With what clear frames leave open beside how they differ ``(P,)``: known, and one error of their scene."""
        more = np.where(self.shared, np.square(left_open), 0.0)
        if not more.any():
            return self
        whole = np.maximum(self.own + self.simulated + self.clear, TINY**2)
        kept = whole / (whole + more)
        return replace(
            self,
            clear=self.clear + more,
            expected=self.expected * kept + 1.0 - kept,
            model=self.model * kept,
            event=self.event * kept,
            # A sum of a variance that is known and one that is estimated (Satterthwaite 1946).
            degrees_of_freedom=self.degrees_of_freedom / kept**2,
        )


def calibrated_scatter(
    pools: Mapping[str, Pool],
    sizes: Mapping[str, MeasuredSize],
    elements: Mapping[str, Floats],
    seed: int,
    known: Mapping[str, Floats] | None = None,
    least: Mapping[str, Floats] | None = None,
) -> dict[str, CalibratedScatter]:
    """Scatter of the vectors of conditions.

    Args:
        pools: condition to simulated frames, each with the clear frame that it started from.
        sizes: how much was measured.
        elements: condition to ``(P,)`` scatter of the measured vector by the noise of elements.
        seed: of the draws.
        known: condition to ``(P,)`` degrees of freedom of the scatter by the noise of elements; exact where left out.
        least: condition to ``(P,)`` scatter of means below which none is taken, however alike simulated frames are.
    """
    layout = next(iter(pools.values())).layout
    components = {name: frame_components(pool, sizes[name].frames) for name, pool in pools.items()}
    share = between_share(layout, components)
    drawn = {name: _drawn(pool, sizes[name], seed, place) for place, (name, pool) in enumerate(pools.items())}
    unseen = _unseen(layout, pools.values())
    counted = {name: _Counted(layout, pool, sizes[name], share, unseen) for name, pool in pools.items()}
    variance = {name: _variance(layout, one, share, sizes[name].clear_frames) for name, one in drawn.items()}
    dispersion = _dispersion(layout, counted, variance)
    told = {name: _told(share, len(pool), sizes[name].clear_frames) for name, pool in pools.items()}
    laws = _spread_laws(layout, elements, variance, told)
    exact, none = np.full(layout.size, np.inf), np.zeros(layout.size)
    return {
        name: _scatter(
            pool,
            sizes[name],
            drawn[name],
            components[name],
            share,
            _ElementLaw(elements[name], (known or {}).get(name, exact), (least or {}).get(name, none)),
            counted[name],
            dispersion,
            laws,
        )
        for name, pool in pools.items()
    }


def _variance(layout: Layout, draws: Floats, share: Floats, clear: int) -> Floats:
    """Variance ``(P,)`` of vectors of endless clear frames: those of K differ from their mean by (K - 1) / K of it.

    What happens by chance in clear frames is drawn anew in each simulated one.
    """
    copied = share * ~layout.each(lambda group: group.statistic in layout.from_clear)
    found: Floats = draws.var(0, ddof=1) * (1.0 + copied / max(clear - 1, 1))
    return found


def _is_spread(statistic: str, group: Group) -> bool:
    return group.statistic == statistic and group.kind == "spread"


@dataclass(frozen=True)
class _ElementLaw:
    """Scatter of the measured vector by the noise of elements.

    Args:
        sd: ``(P,)``.
        degrees_of_freedom: ``(P,)`` with which it is known.
        least: ``(P,)`` scatter of means below which none is taken.
    """

    sd: Floats
    degrees_of_freedom: Floats
    least: Floats


@dataclass(frozen=True)
class _SpreadLaw:
    """Variance of a spread by the noise of its elements, and how many degrees of freedom that law is worth.

    Args:
        over: what simulated frames show over the law, over all bins and conditions of a statistic.
        degrees_of_freedom: by how far single bins keep to that, beyond what few clear frames make of them.
    """

    over: float
    degrees_of_freedom: float


def _spread_laws(
    layout: Layout, elements: Mapping[str, Floats], variance: Mapping[str, Floats], told: Mapping[str, Floats]
) -> dict[str, _SpreadLaw]:
    """Of each statistic that has spreads."""
    found: dict[str, _SpreadLaw] = {}
    for name in dict.fromkeys(group.statistic for group in layout.groups if group.kind == "spread"):
        own = layout.each(partial(_is_spread, name))
        law, shown, degrees_of_freedom = (
            np.concatenate([one[condition][own] for condition in elements]) for one in (elements, variance, told)
        )
        some = (law > TINY) & (shown > TINY**2)
        if some.sum() < 2:
            continue
        # The logarithm of an estimated variance has the mean and the variance of one of chi-square.
        half = 0.5 * degrees_of_freedom[some]
        ratio = np.log(shown[some] / law[some] ** 2) - (digamma(half) - np.log(half))
        beyond = float(ratio.var(ddof=1)) - float(polygamma(1, half).mean())
        most = SCATTER.element_law_degrees
        found[name] = _SpreadLaw(float(np.exp(ratio.mean())), min(2.0 / max(beyond, 2.0 / most), most))
    return found


def _told(share: Floats, frames: int, clear: int) -> Floats:
    """Degrees of freedom ``(P,)`` of a variance of which K clear frames tell a share, and N simulated ones the rest."""
    found: Floats = 1.0 / ((1.0 - share) / frames + share / max(min(clear, frames) - 1, 1))
    return found


def _drawn(pool: Pool, size: MeasuredSize, seed: int, place: int) -> Floats:
    """Vectors ``(R, P)`` of frames drawn from a pool, as many as were measured, about their mean as far apart as such
    of endless frames."""
    generator = np.random.default_rng([seed, place])
    count = len(pool)
    index = np.argsort(generator.random((NUMERICS.distribution_draws, count)), 1)[:, : min(size.frames, count)]
    vectors = pool.vectors(index, size.time_s)
    mean = vectors.mean(0)
    # Frames of a finite pool, none twice, have means that scatter less; changes over time do not.
    finite = pool.layout.each(lambda group: group.kind != "slope") * min(size.frames / count, 0.5)
    found: Floats = mean + (vectors - mean) / np.sqrt(1.0 - finite)
    return found


def _happened(group: Group, weight: Floats, value: Floats) -> Floats:
    """Events: of a share, what happens less often."""
    return value if group.kind == "count" else np.minimum(value, weight - value)


def _unseen(layout: Layout, pools: Collection[Pool]) -> dict[str, float]:
    """Events for which an empty bin of each counted statistic stands, over all bins and conditions."""
    counted: dict[str, list[Floats]] = {}
    for pool in pools:
        for group, part in zip(layout.binned, layout.slices, strict=False):
            if group.kind in COUNTED:
                weight, value = pool.frames.weight[:, part], pool.frames.value[:, part]
                there = weight.sum(0) > 0.0
                counted.setdefault(group.statistic, []).append(_happened(group, weight, value).sum(0)[there])
    return {name: unseen_events(np.concatenate(each)) for name, each in counted.items()}


class _Counted:
    """The law of counting of the entries of one condition that are counts or shares.

    Args:
        layout: of the vector.
        pool: simulated frames.
        size: how much was measured.
        share: ``(P,)`` of the variance between clear frames.
        unseen: statistic to the events for which an empty bin stands.
    """

    def __init__(
        self, layout: Layout, pool: Pool, size: MeasuredSize, share: Floats, unseen: Mapping[str, float]
    ) -> None:
        frames, number = len(pool), size.frames
        self.repeated = np.broadcast_to(size.repeated, layout.size)
        # Of what only K clear frames tell, frames of one clear frame are no further knowledge.
        self.independent = 1.0 / ((1.0 - share) / frames + share / min(size.clear_frames, frames))
        self.expected, self.variance = np.zeros(layout.size), np.zeros(layout.size)
        self.weight = np.zeros(layout.size)
        for group, part in zip(layout.binned, layout.slices, strict=False):
            if group.kind not in COUNTED:
                continue
            weight, value = (getattr(pool.frames, name)[:, part].mean(0) for name in ("weight", "value"))
            happened = _happened(group, weight, value)
            independent = self.independent[part]
            prior = np.where(happened > 0.0, SCATTER.jeffreys_events, unseen[group.statistic])
            expected = expected_number(happened * independent, independent, number, prior)
            self.expected[part], self.weight[part] = expected, number * weight
            self.variance[part] = counted_variance(group.kind, number * weight, expected)

    def told(self) -> Floats:
        """``(P,)`` one over the relative variance of the variance of a count that simulated frames tell themselves.

        With N of them that is ``(2 + 1 / lambda) / N``.
        """
        per_frame = 1.0 / np.maximum(self.expected, TINY)
        found: Floats = self.independent / (2.0 + per_frame)
        return found

    def prior(self) -> Floats:
        """``(P,)`` the same of the law of counting: less where many were counted, and simulated frames tell enough."""
        found: Floats = SCATTER.counting_prior_frames / (1.0 + (self.expected / SCATTER.counting_prior_frames) ** 2)
        return found

    def least(self, group: Group, part: slice, dispersion: float) -> Floats:
        """Variance below which one event more would count by more than the law of counting says of it.

        That law is as much narrower as the statistic's own frames are alike, but not where hardly any event is
        expected: of an unseen place nothing says how often it repeats itself. Where simulated events repeat themselves,
        a measured one that does so, such as a beam at the threshold that is lost in every frame, is no more than one.
        """
        expected = self.expected[part]
        narrower = (1.0 + min(dispersion, 1.0) * expected**2) / (1.0 + expected**2)
        allowed = np.minimum(one_event_sd(expected) / np.sqrt(narrower), SCATTER.one_event_sd)
        times = 1.0 + (self.repeated[part] - 1.0) * (1.0 - min(dispersion, 1.0))
        one, again = self.one_event(group, part), self.one_event(group, part, times)
        found: Floats = np.maximum(one / allowed**2, again / SCATTER.one_event_sd**2)
        return found

    def one_event(self, group: Group, part: slice, times: Floats | float = 1.0) -> Floats:
        """Square by which a stabilised count or share changes with an event beyond the expected ones, seen so often."""
        expected = self.expected[part]
        step = np.sqrt(expected + times + ANSCOMBE) - np.sqrt(expected + ANSCOMBE)
        found: Floats = step**2 if group.kind == "count" else step**2 / np.maximum(self.weight[part], 1.0)
        return found


def _counts(statistic: str, group: Group) -> bool:
    return group.statistic == statistic and group.kind in COUNTED


def _dispersion(layout: Layout, counted: Mapping[str, _Counted], variance: Mapping[str, Floats]) -> dict[str, float]:
    """Variance of each counted statistic over that of the law of counting, over all bins and conditions.

    A beam that is lost is lost in every frame: such shares scatter far less than independent ones would.
    """
    found: dict[str, float] = {}
    for name in dict.fromkeys(group.statistic for group in layout.binned if group.kind in COUNTED):
        over = whole = 0.0
        for condition, own in counted.items():
            entries = layout.each(partial(_counts, name))
            # Of those where the law is asked for.
            weight = own.expected[entries] * own.prior()[entries] / SCATTER.counting_prior_frames
            over += float((weight * variance[condition][entries] / np.maximum(own.variance[entries], TINY)).sum())
            whole += float(weight.sum())
        found[name] = (over + SCATTER.unseen_events) / (whole + SCATTER.unseen_events)
    return found


def log_sd_variance(number: int, variance: float, steady: float) -> float:
    """Variance of ``log(s^2 + steady^2) / 2``, s the standard deviation of so many normal values.

    Args:
        number: of values.
        variance: of each.
        steady: as in ``Layout``.

    Example:
        >>> round(log_sd_variance(6, 1.0, 0.0), 3)  # a quarter of the trigamma of 5/2
        0.122
    """
    return float(_log_sd(_squares_over_variance(max(number - 1, 1)), variance, steady).var())


def log_sd_tail_variance(number: int, variance: float, steady: float) -> float:
    """Variance of the normal law that has as far a tail as ``log(s^2 + steady^2) / 2``: where the probability of more
    is ``residual_p``.

    Beside a large ``steady`` that is a straight line of s squared, whose tail is that of chi-square.

    Args:
        number: of values.
        variance: of each.
        steady: as in ``Layout``.

    Example:
        >>> log_sd_variance(6, 1.0, 0.0) > log_sd_tail_variance(6, 1.0, 0.0)  # a logarithm has a short tail
        True
        >>> round(math.sqrt(log_sd_tail_variance(6, 1.0, 100.0) / log_sd_variance(6, 1.0, 100.0)), 2)
        1.77
    """
    values = _squares_over_variance(max(number - 1, 1))
    far = chi2.isf(METHOD.residual_p, max(number - 1, 1)) / max(number - 1, 1)
    beyond = _log_sd(far, variance, steady) - _log_sd(values, variance, steady).mean()
    return float((beyond / norm.isf(METHOD.residual_p)) ** 2)


def _log_sd(squares: Floats | float, variance: float, steady: float) -> Floats:
    found: Floats = 0.5 * np.log(np.asarray(squares) * variance + max(steady, TINY) ** 2)
    return found


@lru_cache(maxsize=64)
def _squares_over_variance(degrees_of_freedom: int) -> Floats:
    """Quantiles ``(NUMERICS.quantiles,)`` of an estimated variance over the true one."""
    found: Floats = (
        chi2.ppf((np.arange(NUMERICS.quantiles) + 0.5) / NUMERICS.quantiles, degrees_of_freedom) / degrees_of_freedom
    )
    found.flags.writeable = False
    return found


def _by_elements(scalar: str, pool: Pool, number: int, elements: Floats) -> float:
    """Variance from frame to frame of a scalar that is a mean of elements, by their noise; 0 of any other.

    Args:
        scalar: its name, that of the statistic along the axes.
        pool: simulated frames.
        number: n, of measured frames.
        elements: ``(P,)`` scatter of the mean of n frames in each bin.
    """
    for group, part in zip(pool.layout.binned, pool.layout.slices, strict=False):
        if group.statistic == scalar and group.kind == "mean":
            weight = pool.frames.weight[:, part].mean(0)
            return float(number * ((weight * elements[part]) ** 2).sum() / max(weight.sum(), TINY) ** 2)
    return 0.0


def _scatter(
    pool: Pool,
    size: MeasuredSize,
    draws: Floats,
    components: FrameComponents,
    share: Floats,
    by_law: _ElementLaw,
    counted: _Counted,
    dispersion: Mapping[str, float],
    laws: Mapping[str, _SpreadLaw],
) -> CalibratedScatter:
    layout, number, frames, clear = pool.layout, size.frames, len(pool), size.clear_frames
    # Mean of one over an estimated variance, over one over the true one.
    variance = _variance(layout, draws, share, clear) * (1.0 + np.minimum(components.unsure, SCATTER.most_unsure))
    told = _told(share, frames, clear)
    by_clear_frames = share * told / max(min(clear, frames) - 1, 1)
    elements, by_elements = by_law.sd, layout.by_elements
    degrees_of_freedom = np.where(by_elements, by_law.degrees_of_freedom, told)
    own, simulated, of_clear = np.zeros(layout.size), np.zeros(layout.size), np.zeros(layout.size)
    expected, event = np.ones(layout.size), np.zeros(layout.size)
    model_error = pool.known_to(number, size.misplaced) ** 2
    # Means of elements, and what happens by chance in clear frames: the noise of elements is known from the clear
    # frames of all scenes, and their own error is the same in all conditions of one.
    from_clear = layout.each(lambda group: group.statistic in layout.from_clear)
    # What happens by chance in clear frames is simulated as often as they show it: their error is all of it. The same
    # holds for squares about the mean of two frames, which are alike in both.
    squares = layout.each(lambda group: group.statistic in layout.about_clear_mean)
    passed = np.broadcast_to(size.clear_noise, layout.size)
    told_by_clear = np.where(from_clear | (squares & (clear < SCATTER.frames_for_spread)), 1.0, share)
    for group, part in zip(layout.groups, layout.slices, strict=True):
        if by_elements[part][0]:
            noise = elements[part] ** 2
            # The noise of elements holds that of the weather in them, not what it does to whole frames.
            own[part] = np.maximum(noise, components.within[part])
            simulated[part] = np.minimum(components.within[part], own[part]) * number / frames
            of_clear[part] = noise * told_by_clear[part] * passed[part] * number / clear
        elif group.kind in COUNTED:
            alike = dispersion[group.statistic]
            known, prior, least = counted.told()[part], counted.prior()[part], counted.least(group, part, alike)
            law = alike * counted.variance[part]
            mixed = (known * variance[part] + prior * law) / (known + prior)
            # A variance that is known to the relative variance v has 2 / v degrees of freedom.
            degrees_of_freedom[part] = 2.0 * (known + prior)
            share_of_null = layout.scatter_share.get(group.statistic, 1.0)
            mixed = mixed * share_of_null
            own[part] = np.maximum(mixed, least)
            seen = draws[:, part].var(0, ddof=1) * share_of_null
            shown = np.where(seen > TINY**2, seen, 0.5 * mixed)
            expected[part] = np.minimum(shown / np.maximum(own[part], TINY**2), 1.0)
            event[part] = counted.one_event(group, part)
            simulated[part] = own[part] * (1.0 - share[part]) * number / frames
            of_clear[part] = own[part] * told_by_clear[part] * number / clear
        elif group.kind == "between":
            scalar = layout.scalars.index(group.statistic)
            steady, by_clear = layout.steady[scalar], float(components.of_scalars[scalar])
            scatter = pool.frames.scalar[:, scalar].var() * (1.0 + by_clear / max(clear - 1, 1))
            # K clear frames that are alike by chance make no steady sensor: the noise of elements is there anyway, and
            # what all have in common is as large as it may well be.
            scatter *= 1.0 + by_clear * SCATTER.well_may_be_sd * math.sqrt(2.0 / max(clear - 1, 1))
            scatter = max(scatter, _by_elements(group.statistic, pool, number, elements))
            # As far as frames differ by clear ones, K of those tell no more of the scatter than K numbers do.
            of_clear_noise = log_sd_variance(number, scatter, steady)
            mixed = (1.0 - by_clear) * variance[part] + by_clear * of_clear_noise
            own[part] = np.maximum(mixed, log_sd_tail_variance(number, scatter, steady))
            simulated[part] = variance[part] * number / frames
            of_clear[part] = by_clear * log_sd_variance(clear, scatter, steady)
            degrees_of_freedom[part] = 1.0 / ((1.0 - by_clear) / frames + by_clear / max(clear - 1, 1))
            by_clear_frames[part] = by_clear * degrees_of_freedom[part] / max(clear - 1, 1)
        elif group.kind == "slope":
            by_clear = float(components.of_scalars[layout.scalars.index(group.statistic)])
            slope_unsure = 2.0 * ((1.0 - by_clear) / frames + by_clear / max(clear - 1, 1))
            own[part] = draws[:, part].var(0, ddof=1) * (1.0 + min(slope_unsure, SCATTER.most_unsure))
            degrees_of_freedom[part] = 2.0 / slope_unsure
            by_clear_frames[part] = by_clear * degrees_of_freedom[part] / max(clear - 1, 1)
        elif group.kind == "persistence":
            # Maps are nearly empty where little falls: one return that two frames share by chance is no discovery.
            least_sd = math.sqrt(2.0 / max(number * (number - 1), 2)) / SCATTER.one_event_sd
            own[part] = np.maximum(variance[part], least_sd**2)
            expected[part] = np.minimum(draws[:, part].var(0, ddof=1) / own[part], 1.0)
            event[part] = (SCATTER.one_event_sd * least_sd) ** 2
            simulated[part] = variance[part] * (1.0 - share[part]) * number / frames
            of_clear[part] = variance[part] * share[part] * number / clear
        else:
            of_spread = laws.get(group.statistic) if group.kind == "spread" else None
            if of_spread is None:
                own[part] = np.maximum(variance[part], by_law.least[part] ** 2 if group.kind == "mean" else 0.0)
            else:
                law = of_spread.over * elements[part] ** 2
                prior = np.where(law > TINY**2, of_spread.degrees_of_freedom, 0.0)
                own[part] = (told[part] * variance[part] + prior * law) / (told[part] + prior)
                degrees_of_freedom[part] += prior
            simulated[part] = own[part] * (1.0 - share[part]) * number / frames
            of_clear[part] = own[part] * share[part] * number / clear
    before = own + simulated + of_clear
    own = own + model_error
    whole = np.maximum(own + simulated + of_clear, TINY**2)
    expected *= before / whole
    return CalibratedScatter(
        mean=draws.mean(0),
        draws=draws,
        own=own,
        simulated=simulated,
        clear=of_clear,
        shared=layout.averages | from_clear | layout.each(lambda group: group.kind == "spread"),
        expected=np.minimum(expected, 1.0),
        model=model_error / whole,
        event=event / whole,
        degrees_of_freedom=degrees_of_freedom,
        told_by_clear=by_clear_frames,
    )
