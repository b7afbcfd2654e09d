"""Scores of a series that get worse as its weather does."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.stats import page_trend_test

from torchweather.evaluation.sweep.series import Floats, Series
from torchweather.metrics import expected_trends
from torchweather.metrics.trends import Trend

__all__ = ["BY_RANKS", "SIGNIFICANT", "Judgement", "SeriesTrends", "judged", "page_p"]

BY_RANKS = ("hd",)
"""Metrics that one point decides, judged by the agreement of the seeds."""

SIGNIFICANT = 0.05
"""Probability up to which the agreement of the seeds is no chance."""


@dataclass(frozen=True)
class Judgement:
    """Trend of one metric."""

    metric: str
    follows: bool
    """True where it shows the expected trend."""
    trend: Trend
    """Of the means, strictly."""
    page_p: float | None
    """Of Page's test, for a metric in ``BY_RANKS``; None where it was not needed or has too few seeds."""


@dataclass(frozen=True)
class SeriesTrends:
    """The metrics of one series."""

    expected: int
    """Metrics with the expected trend."""
    out_of: int
    """Metrics that could be judged."""
    interval: tuple[int, int] | None
    """95 % bootstrap interval of ``expected`` over subjects and seeds; None with a single one."""
    metrics: Mapping[str, Judgement]


def judged(series: Series, *, resamples: int = 1000, seed: int = 0) -> SeriesTrends:
    """Counts the metrics of a series that get worse at every step of severity.

    The rule is that of ``expected_trends``: the mean over subjects and seeds is strictly monotone toward worse quality.
    The Hausdorff distance (``hd``) is the distance of a single point, so one stray flake moves its mean by metres. It
    follows, too, where its mean is not monotone but the seeds agree in rising: by Page's test, for which every subject
    and seed ranks the levels, the order would come about by chance in at most 5 % (``SIGNIFICANT``). Ranks do not care
    how far the stray point is.

    Args:
        series: of one scene in one weather.
        resamples, seed: of the bootstrap.

    Returns:
        Counts and judgements. In the bootstrap a metric in ``BY_RANKS`` counts as it was judged.

    Note:
        Levels of one seed share their random field, which is what makes their ranks comparable. Page's test takes
        three levels and two samples or more; with fewer, the strict rule stands alone.

    References:
        METRICS.md 3; Page 1963, Ordered hypotheses for multiple treatments.
    """
    scores = {metric: list(values) for metric, values in series.scores.items()}
    found = expected_trends({series.scene: scores}, series.directions, paired=True, resamples=resamples, seed=seed)[
        series.scene
    ]
    metrics = {metric: _judgement(metric, trend, series) for metric, trend in found.metrics.items()}
    by_mean = {metric: values for metric, values in scores.items() if metric not in BY_RANKS}
    interval = None
    if by_mean and found.interval is not None:
        rest = expected_trends({series.scene: by_mean}, series.directions, paired=True, resamples=resamples, seed=seed)[
            series.scene
        ]
        more = sum(metrics[metric].follows for metric in metrics if metric in BY_RANKS)
        assert rest.interval is not None
        interval = (rest.interval[0] + more, rest.interval[1] + more)
    return SeriesTrends(sum(one.follows for one in metrics.values()), found.out_of, interval, metrics)


def _judgement(metric: str, trend: Trend, series: Series) -> Judgement:
    follows = trend.verdict == "expected"
    if follows or metric not in BY_RANKS:
        return Judgement(metric, follows, trend, None)
    p = page_p(series.worsening(metric))
    return Judgement(metric, p is not None and p <= SIGNIFICANT, trend, p)


def page_p(worsening: Floats) -> float | None:
    """Probability of Page's test that seeds which rank the levels at random agree as much in rising.

    Args:
        worsening: scores ``(L, S)`` that rise when quality falls; lightest level first.

    Returns:
        One-sided probability; None with fewer than three levels or two samples. Ties take the mean of their ranks,
        which makes it a little too large.

    Example:
        >>> page_p(np.array([[1.0, 1.1], [2.0, 4.0], [3.0, 9.0]])) < 0.05, page_p(np.ones((3, 2)))
        (True, 1.0)
    """
    if worsening.shape[0] < 3 or worsening.shape[1] < 2 or bool(np.isnan(worsening).any()):
        return None
    if bool((worsening == worsening[:1]).all()):
        return 1.0
    return float(page_trend_test(worsening.T).pvalue)
