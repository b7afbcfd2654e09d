"""How far a simulated score is from a measured one, in units of what chance can do."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy import stats

from torchweather.evaluation.validation.frame_scores import ScoreMeaning

__all__ = ["FAMILY_LEVEL", "Comparison", "Sample", "judged"]

# Chance that one or more of all comparisons of a study is called a difference where there is none. Each comparison
# gets an equal share of it (Bonferroni), which holds however they depend on each other.
FAMILY_LEVEL = 0.05
AGREES, DIFFERS, UNJUDGED = "agrees", "differs", "unjudged"


@dataclass(frozen=True)
class Sample:
    """The scores of several frames; a score that is not a number counts for nothing."""

    scores: tuple[float, ...]

    @property
    def there(self) -> tuple[float, ...]:
        """Those that are numbers."""
        return tuple(score for score in self.scores if not math.isnan(score))

    @property
    def mean(self) -> float:
        """Infinite where one is; not a number where none is."""
        return float(np.mean(self.there)) if self.there else math.nan

    @property
    def standard_error(self) -> float:
        """Of the mean, from the scatter between frames; not a number below two frames or where the mean is infinite."""
        if len(self.there) < 2 or not math.isfinite(self.mean):
            return math.nan
        return float(np.std(self.there, ddof=1)) / math.sqrt(len(self.there))

    def to_dict(self) -> dict[str, Any]:
        """Plain values."""
        return {"mean": self.mean, "standard_error": self.standard_error, "frames": list(self.scores)}


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
    """

    name: str
    meaning: ScoreMeaning
    measured: Sample
    simulated: Sample
    floor: Sample
    paired: bool = False
    level: float = FAMILY_LEVEL

    @property
    def gap(self) -> float:
        """Simulated less measured mean; 0 where both are infinite alike."""
        if self.simulated.mean == self.measured.mean:
            return 0.0
        return self.simulated.mean - self.measured.mean

    @property
    def error(self) -> float:
        """Standard error of the gap.

        Of the differences where paired; else of both means together, and of the floor's, because the clear frames
        that measured and simulated frames are held against, or start from, are few themselves.
        """
        return _combined(self._parts())[0]

    @property
    def bound(self) -> float:
        """Standard errors that chance alone exceeds with the probability ``level``: Student's t, two-sided."""
        return self._bound(self._parts())

    @property
    def in_errors(self) -> float:
        """Gap over its standard error; infinite where nothing scatters and the means differ."""
        return _ratio(self.gap, self.error)

    @property
    def verdict(self) -> str:
        """``agrees``, ``differs``, or ``unjudged`` where there are too few frames or some scores are infinite.

        Two frames or more that are all infinite differ from two or more that are all finite.
        """
        if math.isnan(self.in_errors):
            kinds = [{math.isinf(score) for score in each.there} for each in (self.measured, self.simulated)]
            enough = min(len(each.there) for each in (self.measured, self.simulated)) > 1
            return DIFFERS if enough and kinds in ([{True}, {False}], [{False}, {True}]) else UNJUDGED
        return DIFFERS if abs(self.in_errors) > self.bound else AGREES

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

    def _parts(self) -> list[tuple[float, int]]:
        if not self.paired:
            found = [_part(self.measured), _part(self.simulated)]
            # A single pair of clear frames has no scatter that could be known.
            return found if math.isnan(self.floor.standard_error) else [*found, _part(self.floor)]
        pairs = zip(self.simulated.scores, self.measured.scores, strict=True)
        return [_part(Sample(tuple(simulated - measured for simulated, measured in pairs)))]

    def _bound(self, parts: list[tuple[float, int]]) -> float:
        freedom = _combined(parts)[1]
        return float(stats.t.isf(self.level / 2, freedom)) if math.isfinite(freedom) else math.nan

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
        }


def judged(comparisons: list[Comparison]) -> list[Comparison]:
    """The comparisons of a study, each with its share of the level of all."""
    number = sum(each.verdict != UNJUDGED for each in comparisons)
    return [replace(each, level=FAMILY_LEVEL / max(number, 1)) for each in comparisons]


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
