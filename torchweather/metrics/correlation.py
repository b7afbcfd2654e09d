"""Correlation of metrics of degradation with a detector's performance."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from torchweather.core.arguments import check_arguments
from torchweather.core.errors import InputValueError, check_between
from torchweather.metrics.coefficients import INTERVAL, Coefficient, coefficients, undefined, weighted_spearman
from torchweather.metrics.condition_table import FEWEST, Conditions, join
from torchweather.metrics.d34_claim import HIGHLY, ClaimCheck, check_claim
from torchweather.metrics.level_model import PartialCorrelation, Prediction, partial_correlation, prediction

__all__ = ["Correlation", "MetricCorrelation", "correlate"]

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class MetricCorrelation:
    """One metric against the performance."""

    metric: str
    conditions: int
    """With a score, infinite ones included."""
    infinite: int
    """Of these, conditions with an infinite score (PSNR of equal images): ranks take them, straight lines do not."""
    pearson: Coefficient
    spearman: Coefficient
    kendall: Coefficient
    rank: int | None
    """Place by the size of Spearman's rho, 1 the largest; None without a value."""
    rank_interval: tuple[int, int] | None
    """95 % of the bootstrap samples put it between these places."""
    partial: PartialCorrelation
    """Given the kind of weather and its level: does the metric say more than the level itself? Straight lines."""
    partial_rank: PartialCorrelation
    """The same of ranks."""
    prediction: Prediction
    """Leaving out one condition at a time."""


@dataclass(frozen=True, eq=False)
class Correlation:
    """Metrics against the performance of a detector."""

    metrics: tuple[MetricCorrelation, ...]
    """In order of rank, those without one last."""
    claim: tuple[ClaimCheck, ...]
    """D3.4's claim about each image metric (``D34_CLAIM``) beside what is found."""
    highly: float
    """Size of Spearman's rho that counts as high."""
    resamples: int
    seed: int
    data: Conditions = field(repr=False)
    """The conditions themselves."""

    def to_dict(self) -> dict[str, Any]:
        """Everything as plain values, the conditions included."""
        return {
            "conditions": len(self.data.performance),
            "by": list(self.data.by),
            "scored_only": self.data.scored_only,
            "performed_only": self.data.performed_only,
            "resamples": self.resamples,
            "seed": self.seed,
            "metrics": [asdict(each) for each in self.metrics],
            "highly": self.highly,
            "claim": [asdict(each) for each in self.claim],
            "table": {
                **self.data.labels,
                "performance": self.data.performance.tolist(),
                **{f"score_{name}": values.tolist() for name, values in self.data.scores.items()},
            },
        }


def correlate(
    scores: Mapping[str, Sequence[Any]],
    performance: Mapping[str, Sequence[Any]] | Sequence[float],
    *,
    by: Sequence[str] | None = None,
    performance_column: str = "performance",
    resamples: int = 2000,
    seed: int = 0,
    highly: float = HIGHLY,
) -> Correlation:
    """Correlation of every metric with a detector's performance over conditions of weather.

    Args:
        scores: the table of a sweep, columns ``metric`` and ``score`` and some of ``subject, sensor, weather, knob,
            value, severity, seed``; or one sequence ``(n,)`` a metric, a condition each.
        performance: a table with the same condition columns, as far as they apply, and ``performance_column``; or,
            for scores by metric, a table of n rows or n numbers in their order. Any unit, larger is better or worse.
            NaN and None are no performance.
        by: condition columns that tell conditions apart; all that both tables have, but ``seed``.
        performance_column: its name.
        resamples: of the bootstrap.
        seed: of the bootstrap.
        highly: size of Spearman's rho that counts as high, for D3.4's claim.

    Returns:
        Coefficients with 95 % intervals, a ranking, partial correlations, errors of prediction, and the claim.

    Note:
        Rows are matched by all condition columns that both tables have; rows that match several times (classes of the
        detector, subjects that it does not tell apart) count with their mean. Then seeds are averaged: the bootstrap
        draws whole conditions, as many as there are, for all metrics together. Its percentile intervals are narrow for
        few conditions, and conditions that share a scene are not independent. p-values are scipy's, for Pearson's r and
        Spearman's rho from Student's t, good from about 10 conditions on.

        An infinite score (PSNR of equal images) is the largest rank for Spearman and Kendall; Pearson's r, the linear
        partial correlation and the prediction leave the condition out. A metric or performance that never changes has
        no coefficient: NaN, with the reason.

        The level is a straight line in the rank of severity (or of ``value``) for each kind of weather.

    References:
        Kendall 1945 (tau-b); Efron and Tibshirani 1993, 13.3 (percentile interval).

    Example:
        >>> ap = [0.9, 0.7, 0.6, 0.2, 0.1]
        >>> found = correlate({"ssim": [0.95, 0.9, 0.7, 0.5, 0.4], "gmsd": [0.1, 0.3, 0.2, 0.2, 0.4]}, ap)
        >>> [(each.metric, each.rank, round(each.spearman.value, 2)) for each in found.metrics]
        [('ssim', 1, 1.0), ('gmsd', 2, -0.67)]
    """
    check_arguments(
        "correlate(scores: Mapping[str], performance: Mapping[str] | Sequence[float], by: Sequence[str] | None, "
        "performance_column: str, resamples: int, seed: int, highly: float)",
        scores,
        performance,
        by,
        performance_column,
        resamples,
        seed,
        highly,
    )
    if resamples < 1:
        raise InputValueError(f"correlate: resamples must be 1 or more; got {resamples!r}.")
    check_between("resamples", resamples, 1, 10_000_000, owner="correlate")
    check_between("seed", seed, 0, 2**63, owner="correlate")
    resamples, seed = int(resamples), int(seed)
    check_between("highly", highly, 0.0, 1.0, owner="correlate")
    data = join(scores, performance, by, performance_column)
    number = len(data.performance)
    draws = np.random.default_rng(seed).multinomial(number, np.full(number, 1 / number), size=resamples)
    counts: Floats = draws.astype(np.float64)
    found = [_metric(name, values, data, counts) for name, values in data.scores.items()]
    ranked = sorted(_ranked(found, data, counts), key=lambda each: (each.rank is None, each.rank))
    claim = check_claim({each.metric: each.spearman for each in ranked}, highly=highly)
    return Correlation(tuple(ranked), claim, highly, resamples, seed, data)


def _metric(name: str, scores: Floats, data: Conditions, counts: Floats) -> MetricCorrelation:
    there = ~np.isnan(scores)
    x, y = scores[there], data.performance[there]
    kind = None if data.kind is None else [each for each, scored in zip(data.kind, there, strict=True) if scored]
    level = None if data.level is None else data.level[there]
    if len(x) < FEWEST:
        few = undefined(f"{len(x)} conditions with a score do not suffice, {FEWEST} would")
        values = {"pearson": few, "spearman": few, "kendall": few}
    else:
        values = coefficients(x, y, counts[:, there])
    return MetricCorrelation(
        metric=name,
        conditions=len(x),
        infinite=int(np.isinf(x).sum()),
        **values,
        rank=None,
        rank_interval=None,
        partial=partial_correlation(x, y, kind, level, ranks=False),
        partial_rank=partial_correlation(x, y, kind, level, ranks=True),
        prediction=prediction(x, y, kind, level),
    )


def _ranked(found: list[MetricCorrelation], data: Conditions, counts: Floats) -> list[MetricCorrelation]:
    """The metrics with their places by the size of Spearman's rho."""
    from scipy.stats import rankdata  # takes half a second, which only a correlation has to wait for

    with_value = [each for each in found if not math.isnan(each.spearman.value)]
    if not with_value:
        return found
    sizes = np.array([abs(each.spearman.value) for each in with_value])
    places = rankdata(-sizes, method="min")
    resampled = []
    for each in with_value:
        there = ~np.isnan(data.scores[each.metric])
        rho = weighted_spearman(data.scores[each.metric][there], data.performance[there], counts[:, there])
        resampled.append(np.nan_to_num(np.abs(rho), nan=0.0))
    low, high = np.quantile(rankdata(-np.array(resampled), method="min", axis=0), INTERVAL, 1, method="inverted_cdf")
    placed = {
        each.metric: replace(each, rank=int(places[k]), rank_interval=(int(low[k]), int(high[k])))
        for k, each in enumerate(with_value)
    }
    return [placed.get(each.metric, each) for each in found]
