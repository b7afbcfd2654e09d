"""Distance of a simulated score from a measured one, in units of what chance can do."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
from scipy import stats

from torchweather.evaluation.validation.frame_scores import ScoreMeaning
from torchweather.evaluation.validation.power import FACTOR, POWER, crossing, detection_probability, smallest

__all__ = ["FAMILY_LEVEL", "Comparison", "Sample", "Shift", "judged"]

# Chance that one or more of all comparisons of a study is called a difference where there is none. Each comparison
# gets an equal share of it (Bonferroni), which holds however they depend on each other.
FAMILY_LEVEL = 0.05
AGREES, DIFFERS, UNDECIDED, UNJUDGED = "agrees", "differs", "not decided", "unjudged"


@dataclass(frozen=True)
class Sample:
    """The scores of several frames; a score that is not a number counts for nothing."""

    scores: tuple[float, ...]

    @cached_property
    def there(self) -> tuple[float, ...]:
        """Those that are numbers."""
        return tuple(score for score in self.scores if not math.isnan(score))

    @cached_property
    def mean(self) -> float:
        """Infinite where one is; not a number where none is."""
        return float(np.mean(self.there)) if self.there else math.nan

    @cached_property
    def standard_error(self) -> float:
        """Of the mean, from the scatter between frames; not a number below two frames or where the mean is infinite."""
        if len(self.there) < 2 or not math.isfinite(self.mean):
            return math.nan
        return float(np.std(self.there, ddof=1)) / math.sqrt(len(self.there))

    def to_dict(self) -> dict[str, Any]:
        """Plain values."""
        return {"mean": self.mean, "standard_error": self.standard_error, "frames": list(self.scores)}


@dataclass(frozen=True)
class Shift:
    """Scores at another rate or visibility than the recorded one, or with an effect.

    Args:
        factor: by which the rate or the visibility is multiplied; of an effect its strength in typical sizes.
        recorded, changed: scores of simulated frames at the recorded weather and of the changed ones, frame by frame
            with the same clear frame and the same random numbers.
    """

    factor: float
    recorded: Sample
    changed: Sample

    @cached_property
    def mean(self) -> float:
        """Change of the score; infinite where all changed scores are and no recorded one is; else not a number."""
        finite = [
            (one, other)
            for one, other in zip(self.recorded.scores, self.changed.scores, strict=True)
            if math.isfinite(one) and math.isfinite(other)
        ]
        if len(finite) > 1:
            return float(np.mean([other - one for one, other in finite]))
        kinds = [{math.isinf(score) for score in each.there} for each in (self.recorded, self.changed)]
        return math.inf if kinds in ([{True}, {False}], [{False}, {True}]) else math.nan

    @cached_property
    def standard_deviation(self) -> float:
        """Between changed frames; not a number below two finite ones."""
        finite = [score for score in self.changed.scores if math.isfinite(score)]
        return float(np.std(finite, ddof=1)) if len(finite) > 1 else math.nan

    @cached_property
    def paired_deviation(self) -> float:
        """Of the change, between pairs."""
        pairs = zip(self.recorded.scores, self.changed.scores, strict=True)
        finite = [other - one for one, other in pairs if math.isfinite(one) and math.isfinite(other)]
        return float(np.std(finite, ddof=1)) if len(finite) > 1 else math.nan


@dataclass(frozen=True)
class Comparison:
    """One score of one condition: measured against clear beside simulated against clear.

    Args:
        name: of the score.
        meaning: of the score.
        measured, simulated: scores of the frames against clear frames.
        floor: scores of clear frames against other clear frames.
        paired: sample ``i`` of measured and simulated belong together (a link in the same rain), so that their
            differences are what scatters.
        level: chance of calling a difference where there is none.
        shifts: scores at other rates or visibilities, from which the power follows. Empty: the power is unknown, and
            nothing is decided but differences. ``None``: there is nothing to change, as in clear air.
        effects: scores with an effect, by its id, from which the power against it follows.
    """

    name: str
    meaning: ScoreMeaning
    measured: Sample
    simulated: Sample
    floor: Sample
    paired: bool = False
    level: float = FAMILY_LEVEL
    shifts: tuple[Shift, ...] | None = None
    effects: Mapping[str, tuple[Shift, ...]] = field(default_factory=dict)

    @property
    def gap(self) -> float:
        """Simulated less measured mean; 0 where both are infinite alike."""
        if self.simulated.mean == self.measured.mean:
            return 0.0
        return self.simulated.mean - self.measured.mean

    @cached_property
    def error(self) -> float:
        """Standard error of the gap.

        Of the differences where paired; else of both means together, and of the floor's, because the clear frames
        that measured and simulated frames are held against, or start from, are few themselves.
        """
        return _combined(self._parts)[0]

    @cached_property
    def bound(self) -> float:
        """Standard errors that chance alone exceeds with the probability ``level``: Student's t, two-sided."""
        return self._bound(self._parts)

    @cached_property
    def in_errors(self) -> float:
        """Gap over its standard error; infinite where nothing scatters and the means differ."""
        return _ratio(self.gap, self.error)

    @cached_property
    def verdict(self) -> str:
        """``agrees``, ``differs``, ``not decided``, or ``unjudged`` where frames are too few or some scores infinite.

        Two frames or more that are all infinite differ from two or more that are all finite. Agreement takes more than
        the absence of a difference: the same frames would have shown a rate or visibility wrong by a factor of 2,
        either way, with a power of 80 %; and the gap is beyond the bound from those that these changes would make.
        """
        if math.isnan(self.in_errors):
            kinds = [{math.isinf(score) for score in each.there} for each in (self.measured, self.simulated)]
            enough = min(len(each.there) for each in (self.measured, self.simulated)) > 1
            return DIFFERS if enough and kinds in ([{True}, {False}], [{False}, {True}]) else UNJUDGED
        if abs(self.in_errors) > self.bound:
            return DIFFERS
        return AGREES if self.shifts is None or self._excludes_the_factor() else UNDECIDED

    def power(self, factor: float) -> float:
        """Probability of a difference if the true rate or visibility were ``factor`` times the recorded one.

        By the noncentral t distribution at the study's own frame numbers. Between simulated factors, change and scatter
        are interpolated over the logarithm. The scatter is the larger one of measured and simulated frames.
        """
        return self._flagged(*self._if_changed(factor))

    def power_of_effect(self, effect: str, strength: float) -> float:
        """Probability of a difference if the measured frames had an effect that the simulation lacks.

        Args:
            effect: its id, one of ``effects``.
            strength: in typical sizes. Between simulated ones, change and scatter are interpolated.
        """
        return self._flagged(*self._if_shifted(strength, [(each.factor, each) for each in self.effects[effect]]))

    def smallest_strength(self, effect: str) -> float:
        """Strength of an effect, in typical sizes, that the frames would have flagged with 80 % power.

        Infinite where none of the simulated ones would have been.
        """
        strengths = [each.factor for each in self.effects[effect]]
        return smallest(strengths, lambda strength: self.power_of_effect(effect, strength))

    def _flagged(self, shift: float, error: float, freedom: float) -> float:
        """Probability that a change of the score is called a difference."""
        return detection_probability(shift, error, _bound(self.level, freedom), freedom)

    @cached_property
    def smallest_change(self) -> tuple[float, float] | None:
        """Factors below and above 1 nearest to it that the frames would have flagged with 80 % power.

        0 and infinity where no simulated factor would have been; ``None`` where there is nothing to change, or the
        power is not known.
        """
        if not self.shifts:
            return None
        factors = [each.factor for each in self.shifts]
        below, above = [each for each in factors if each < 1], [each for each in factors if each > 1]
        return crossing(below, self.power), crossing(above, self.power)

    def _excludes_the_factor(self) -> bool:
        there = {each.factor for each in self.shifts or ()}
        for factor in (1.0 / FACTOR, FACTOR):
            if factor not in there or self.power(factor) < POWER:
                return False
            # Frames of a true ``factor`` have their gap at -shift: simulated less measured.
            shift, error, _ = self._if_changed(factor)
            if abs(_ratio(self.gap + shift, error)) <= self.bound:
                return False
        return True

    def _if_changed(self, factor: float) -> tuple[float, float, float]:
        """Change of the score at a factor, standard error of the gap there, and degrees of freedom."""
        known = [(math.log(each.factor), each) for each in self.shifts or () if each.factor != 1]
        return self._if_shifted(math.log(factor), known)

    def _if_shifted(self, x: float, known: Sequence[tuple[float, Shift]]) -> tuple[float, float, float]:
        """The same at a place between those of simulated changes; nothing is changed at 0."""
        places = [0.0, *(place for place, _ in known)]
        values = [(0.0, self._deviation(None)), *((each.mean, self._deviation(each)) for _, each in known)]
        at_x = [value for place, value in zip(places, values, strict=True) if math.isclose(place, x, abs_tol=1e-9)]
        if at_x:
            shift, deviation = at_x[0]
        else:
            order = np.argsort(places)
            ends = [np.array(places)[order], *(np.array(column)[order] for column in zip(*values, strict=True))]
            with np.errstate(invalid="ignore"):
                shift, deviation = (float(np.interp(x, ends[0], column)) for column in ends[1:])
            # Between a finite score and an infinite one there is nothing to interpolate.
            shift = shift if math.isfinite(shift) else math.nan
        own = self._parts
        if self.paired:
            count = own[0][1] + 1
            parts = [(deviation / math.sqrt(count) if count > 1 else math.nan, count - 1)]
        else:
            count = len(self.measured.there)
            parts = [(deviation / math.sqrt(count) if count else math.nan, count - 1), *own[1:]]
        return shift, *_combined(parts)

    def _deviation(self, shift: Shift | None) -> float:
        """Scatter between frames (paired: of differences), at least that of the measured ones."""
        if self.paired:
            pairs = zip(self.simulated.scores, self.measured.scores, strict=True)
            own = _deviation(tuple(simulated - measured for simulated, measured in pairs))
            # A change that differs from pair to pair adds to the scatter of their differences.
            return own if shift is None else math.hypot(own, shift.paired_deviation)
        own = _deviation(self.measured.scores)
        return own if shift is None else max(own, shift.standard_deviation)

    def side_of_floor(self, which: str) -> str:
        """Where the ``measured`` or ``simulated`` frames are, seen from clear frames: ``worse``, ``at`` or ``better``.

        ``unjudged`` where there are too few frames.
        """
        sample = self.measured if which == "measured" else self.simulated
        parts = [_part(sample), _part(self.floor)]
        away = sample.mean - self.floor.mean if sample.mean != self.floor.mean else 0.0
        away = away if self.meaning.higher_is_better else -away
        ratio = _ratio(away, _combined(parts)[0])
        if math.isnan(ratio):
            return UNJUDGED
        if abs(ratio) <= self._bound(parts):
            return "at"
        return "better" if ratio > 0 else "worse"

    @property
    def share_of_effect(self) -> float:
        """Gap over what the weather did to the measured score (its distance from the floor)."""
        effect = self.measured.mean - self.floor.mean
        return self.gap / effect if effect and math.isfinite(effect) else math.nan

    @cached_property
    def _parts(self) -> list[tuple[float, int]]:
        if not self.paired:
            found = [_part(self.measured), _part(self.simulated)]
            # A single pair of clear frames has no scatter that could be known.
            return found if math.isnan(self.floor.standard_error) else [*found, _part(self.floor)]
        pairs = zip(self.simulated.scores, self.measured.scores, strict=True)
        return [_part(Sample(tuple(simulated - measured for simulated, measured in pairs)))]

    def _bound(self, parts: list[tuple[float, int]]) -> float:
        return _bound(self.level, _combined(parts)[1])

    def to_dict(self) -> dict[str, Any]:
        """Plain values."""
        return {
            "score": self.name,
            "unit": self.meaning.unit,
            "higher_is_better": self.meaning.higher_is_better,
            "measured": {**self.measured.to_dict(), "side_of_floor": self.side_of_floor("measured")},
            "simulated": {**self.simulated.to_dict(), "side_of_floor": self.side_of_floor("simulated")},
            "floor": self.floor.to_dict(),
            "gap": self.gap,
            "gap_standard_error": self.error,
            "gap_in_standard_errors": self.in_errors,
            "gap_bound_in_standard_errors": self.bound,
            "gap_share_of_effect": self.share_of_effect,
            "verdict": self.verdict,
            "power": self._power_dict(),
            "effects": {name: self._effect_dict(name) for name in self.effects},
        }

    def _effect_dict(self, name: str) -> dict[str, Any]:
        return {
            "smallest_strength": self.smallest_strength(name),
            "at_strengths": [
                {
                    "strength": each.factor,
                    "change_of_score": each.mean,
                    "power": self.power_of_effect(name, each.factor),
                }
                for each in self.effects[name]
            ],
        }

    def _power_dict(self) -> dict[str, Any] | None:
        changes = self.smallest_change
        if changes is None:
            return None
        return {
            "power": POWER,
            "smallest_factor_below": changes[0],
            "smallest_factor_above": changes[1],
            "at_factors": [
                {"factor": each.factor, "change_of_score": each.mean, "power": self.power(each.factor)}
                for each in self.shifts or ()
            ],
        }


def judged(comparisons: list[Comparison]) -> list[Comparison]:
    """The comparisons of a study, each with its share of the level of all."""
    number = sum(each.verdict != UNJUDGED for each in comparisons)
    return [replace(each, level=FAMILY_LEVEL / max(number, 1)) for each in comparisons]


def _deviation(scores: tuple[float, ...]) -> float:
    there = Sample(scores).there
    return float(np.std(there, ddof=1)) if len(there) > 1 and all(map(math.isfinite, there)) else math.nan


@lru_cache(maxsize=4096)
def _bound(level: float, freedom: float) -> float:
    """Standard errors that chance alone exceeds with a probability: Student's t, two-sided."""
    return float(stats.t.isf(level / 2, freedom)) if math.isfinite(freedom) else math.nan


def _part(sample: Sample) -> tuple[float, int]:
    """Standard error and degrees of freedom."""
    return sample.standard_error, len(sample.there) - 1


def _combined(parts: list[tuple[float, int]]) -> tuple[float, float]:
    """Standard error of a sum and its degrees of freedom (Welch 1947, Satterthwaite 1946)."""
    variances = [error**2 for error, _ in parts]
    total = sum(variances)
    if math.isnan(total):
        return math.nan, math.nan
    if total == 0:
        return 0.0, float(sum(freedom for _, freedom in parts))
    spent = sum(variance**2 / freedom for variance, (_, freedom) in zip(variances, parts, strict=True))
    # Scatter so small that its fourth power is zero: as many as the smallest sample has.
    freedom = total**2 / spent if spent > 0 else float(min(freedom for _, freedom in parts))
    return math.sqrt(total), freedom


def _ratio(gap: float, error: float) -> float:
    if math.isnan(gap) or math.isinf(gap) or math.isnan(error):
        return math.nan
    if gap == 0:
        return 0.0
    return gap / error if error > 0 else math.copysign(math.inf, gap)
