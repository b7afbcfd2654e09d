"""Trends of scores as the weather gets worse."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from torchweather.core.arguments import check_arguments
from torchweather.core.errors import InputTypeError, InputValueError, check_between

__all__ = ["SceneTrends", "Trend", "expected_trends"]

DIRECTIONS = ("up", "down")
INTERVAL = (0.025, 0.975)

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Trend:
    """Trend of one metric with rising severity."""

    verdict: str
    """``expected`` (worse at every step), ``tied`` (never better, at least one tie), ``reversed`` (better at every
    step), ``broken`` (some better, some not) or ``unjudged`` (fewer than two levels have a score)."""
    levels: int
    """Levels that have a score."""
    missing: tuple[int, ...]
    """Positions of those that have none; the others are judged."""
    chance: float
    """Probability that scores in random order show the expected trend: ``1 / levels!``, a coin flip at two levels."""
    confidence: float | None
    """Share of the bootstrap samples in which the trend is the expected one; None without several frames per level."""


@dataclass(frozen=True)
class SceneTrends:
    """The metrics of one scene."""

    expected: int
    """Metrics with the expected trend."""
    out_of: int
    """Metrics that could be judged."""
    metrics: dict[str, Trend]
    interval: tuple[int, int] | None
    """95 % bootstrap interval of ``expected``; None unless every judged metric has several frames per level."""

    @property
    def coin_flip(self) -> bool:
        """True where a metric is judged on two levels only."""
        return any(trend.levels == 2 for trend in self.metrics.values())


def expected_trends(
    scores: Mapping[str, Mapping[str, Sequence[Any]]],
    direction: Mapping[str, str],
    *,
    tie_within: float = 0.0,
    paired: bool = False,
    resamples: int = 1000,
    seed: int = 0,
) -> dict[str, SceneTrends]:
    """Counts, per scene, the metrics that are strictly monotone toward worse quality with rising severity.

    Args:
        scores: scene, then metric, then one entry per level **in order of rising severity** (rate up, visibility
            down): a number, the scores ``(F,)`` of several frames, or None or NaN where there is none. The score of a
            level is the mean of its frames; frames of inf and of -inf have none.
        direction: of every metric, ``up`` where higher is better, ``down`` where lower is better.
        tie_within: scores that differ by no more are equal; 0 or more, in the unit of the metric.
        paired: frame ``i`` is the same scene at every level, so the bootstrap draws frames for all levels together.
        resamples: number of bootstrap samples; used where levels have several frames.
        seed: of the bootstrap.

    Returns:
        One ``SceneTrends`` per scene.

    Note:
        Frames that follow each other in time are not independent: the bootstrap is then too sure. Two levels make
        a trend a coin flip; four leave a chance of 1 in 24.

    References:
        METRICS.md 3; D3.4 Tables 12, 14, 15.

    Example:
        >>> found = expected_trends(
        ...     {"road": {"psnr": [30.0, 25.0, 21.0], "gmsd": [0.1, 0.2, 0.2]}}, {"psnr": "up", "gmsd": "down"}
        ... )["road"]
        >>> found.expected, found.out_of, found.metrics["gmsd"].verdict
        (1, 2, 'tied')
    """
    check_arguments(
        "expected_trends(scores: Mapping, direction: Mapping, tie_within: float, paired: bool, resamples: int, "
        "seed: int)",
        scores,
        direction,
        tie_within,
        paired,
        resamples,
        seed,
    )
    _check(tie_within, resamples)
    check_between("seed", seed, 0, 2**63, owner="expected_trends")
    return {
        scene: _scene(scene, metrics, direction, tie_within, paired, _Bootstrap(int(resamples), int(seed)))
        for scene, metrics in scores.items()
    }


class _Bootstrap:
    """Frames drawn with replacement; metrics with as many frames at a level share the draw."""

    def __init__(self, resamples: int, seed: int) -> None:
        self.resamples = resamples
        self.generator = np.random.default_rng(seed)
        self.drawn: dict[tuple[int, int], NDArray[np.intp]] = {}

    def means(self, frames: Floats, stream: int) -> Floats:
        """Mean scores ``(resamples,)`` of one level; levels of one ``stream`` draw the same frames."""
        key = (stream, len(frames))
        if key not in self.drawn:
            self.drawn[key] = self.generator.integers(len(frames), size=(self.resamples, len(frames)))
        return _mean(frames[self.drawn[key]])


def _check(tie_within: float, resamples: int) -> None:
    if not tie_within >= 0:
        raise InputValueError(f"expected_trends: tie_within must be 0 or more; got {tie_within!r}.")
    if resamples < 1:
        raise InputValueError(f"expected_trends: resamples must be 1 or more; got {resamples!r}.")
    check_between("resamples", resamples, 1, 10_000_000, owner="expected_trends")


def _scene(
    scene: str,
    metrics: Mapping[str, Sequence[Any]],
    direction: Mapping[str, str],
    tie_within: float,
    paired: bool,
    bootstrap: _Bootstrap,
) -> SceneTrends:
    check_arguments("expected_trends(scores: Mapping)", metrics)
    for metric, levels in metrics.items():
        if not (isinstance(levels, Sequence) or getattr(levels, "ndim", 0)) or isinstance(levels, str):
            raise InputTypeError(
                f"expected_trends: {scene}: {metric} must have one entry per level; got {levels!r:.200}."
            )
    counts = {len(levels) for levels in metrics.values()}
    if len(counts) > 1:
        raise InputValueError(
            f"expected_trends: {scene}: every metric must have one entry per level; got {sorted(counts)} entries. Put "
            "None where a score is missing."
        )
    trends: dict[str, Trend] = {}
    shown: list[NDArray[np.bool_] | None] = []
    for metric, levels in metrics.items():
        if not isinstance(direction.get(metric), str) or direction[metric] not in DIRECTIONS:
            raise InputValueError(
                f"expected_trends: direction of {metric} must be 'up' (higher is better) or 'down'; got "
                f"{direction.get(metric)!r}."
            )
        sign = 1.0 if direction[metric] == "down" else -1.0
        frames = [sign * _frames(level, f"{scene}: {metric}") for level in levels]
        trends[metric], samples = _trend(frames, tie_within, paired, bootstrap, f"{scene}: {metric}")
        if trends[metric].verdict != "unjudged":
            shown.append(samples)
    return SceneTrends(
        expected=sum(trend.verdict == "expected" for trend in trends.values()),
        out_of=len(shown),
        metrics=trends,
        interval=_interval(shown),
    )


def _frames(level: Any, where: str) -> Floats:
    """Scores ``(F,)`` of one level; NaN where there is none."""
    frames: Floats = np.atleast_1d(np.asarray(level, dtype=np.float64))
    if frames.ndim != 1:
        raise InputValueError(f"expected_trends: {where}: a level holds a number or scores (F,); got {frames.shape}.")
    return frames


def _mean(frames: Floats) -> Floats:
    """Mean over the last axis of what is not NaN; NaN where nothing is, or where both infinities are."""
    there = ~np.isnan(frames)
    number = there.sum(-1)
    with np.errstate(invalid="ignore"):
        total = np.where(there, frames, 0.0).sum(-1)
    found: Floats = np.where(number > 0, total / np.maximum(number, 1), np.nan)
    return found


def _trend(
    frames: list[Floats], tie_within: float, paired: bool, bootstrap: _Bootstrap, where: str
) -> tuple[Trend, NDArray[np.bool_] | None]:
    """The trend of scores that rise when quality falls, and whether each bootstrap sample shows it."""
    scores = np.array([float(_mean(level)) for level in frames])
    missing = tuple(int(place) for place in np.flatnonzero(np.isnan(scores)))
    there = [place for place in range(len(frames)) if place not in missing]
    samples = None
    if len(there) > 1 and all(np.sum(~np.isnan(frames[place])) > 1 for place in there):
        if paired and len({len(frames[place]) for place in there}) > 1:
            sizes = [len(frames[place]) for place in there]
            raise InputValueError(f"expected_trends: {where}: paired levels need as many frames each; got {sizes}.")
        drawn = [bootstrap.means(frames[place], 0 if paired else place) for place in there]
        samples = np.all(_worse(np.stack(drawn, -1), tie_within), axis=-1)
    trend = Trend(
        verdict=_verdict(scores[there], tie_within),
        levels=len(there),
        missing=missing,
        chance=1.0 / math.factorial(len(there)),
        confidence=None if samples is None else float(samples.mean()),
    )
    return trend, samples


def _worse(scores: Floats, tie_within: float) -> NDArray[np.bool_]:
    """Mask of the steps ``(..., L - 1)`` up by more than a tie; infinite scores may be equal, NaN is never worse."""
    before, after = scores[..., :-1], scores[..., 1:]
    with np.errstate(invalid="ignore"):
        found: NDArray[np.bool_] = (after > before) & ~(after - before <= tie_within)
    return found


def _verdict(scores: Floats, tie_within: float) -> str:
    if len(scores) < 2:
        return "unjudged"
    worse, better = _worse(scores, tie_within), _worse(-scores, tie_within)
    if worse.all():
        return "expected"
    if better.all():
        return "reversed"
    return "broken" if better.any() else "tied"


def _interval(shown: list[NDArray[np.bool_] | None]) -> tuple[int, int] | None:
    """Counts between which 95 % of the bootstrap samples lie."""
    samples = [each for each in shown if each is not None]
    if not samples or len(samples) < len(shown):
        return None
    low, high = np.quantile(np.sum(samples, axis=0), INTERVAL, method="inverted_cdf")
    return int(low), int(high)
