"""Remainder that the catalogue does not explain: its axis, its curve, a formula, and a stage that copies it."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaln
from scipy.stats import chi2

from torchweather.gap.inference.empirical_fit import Departures, NaturalCurve, empirical_stage, natural_curve
from torchweather.gap.inference.forward_selection import GapResult
from torchweather.gap.inference.likelihood import SimulatorLikelihood
from torchweather.gap.inference.simulated_distribution import SimulatedDistribution
from torchweather.gap.statistics.formula import Formula, simplest_formula
from torchweather.gap.statistics.frame_statistics import TINY, Group
from torchweather.gap.statistics.log_square import mean_log_square, spread_of_log_square
from torchweather.gap.study.conditions import Condition
from torchweather.lidar.effects.empirical import Empirical

__all__ = ["Unknown", "departures", "unknown"]

Floats = NDArray[np.float64]

MEAN_OF = {
    "log_intensity_spread": "log_intensity_ratio",
    "range_residual_spread": "range_residual_m",
    "log_particle_intensity_spread": "log_particle_intensity",
}
"""Spread inside the bins to the mean of the same quantity."""
DEEP = -600.0  # logarithms of a probability, from which the asymptote of the law is taken


@dataclass(frozen=True)
class Unknown:
    """The statistic that departs most after the best that the catalogue can do.

    Args:
        group: it, along its axis.
        place: bin that stands out most.
        z: of that bin, all conditions together, in standard deviations.
        curve: departure of the measurement from the model that is handed out, in natural units.
        formula: the simplest that describes the curve, or ``None``.
        empirical: the stage that copies it, or ``None``.
        why_not: why no stage can.
    """

    group: Group
    place: int
    z: float
    curve: NaturalCurve
    formula: Formula | None
    empirical: Empirical | None
    why_not: str | None

    def to_dict(self) -> dict[str, Any]:
        """Plain values, as ``gap.json`` holds them; ``None`` where nothing counts, in the formula's outside of that."""
        group, curve, formula = self.group, self.curve, self.formula
        described = None
        if formula is not None:
            known = np.flatnonzero(np.isfinite(curve.value))
            inside = (np.arange(group.bins) >= known[0]) & (np.arange(group.bins) <= known[-1])
            described = {
                "name": formula.name,
                "text": formula.text,
                "parameters": dict(formula.parameters),
                "chi2_per_dof": formula.chi2_per_dof,
                "values": _listed(np.where(inside, formula.values, np.nan)),
            }
        return {
            "statistic": group.statistic,
            "axis": group.axis,
            "from": group.edges[self.place],
            "to": group.edges[self.place + 1],
            "z": self.z,
            "curve": {
                "edges": list(curve.edges),
                "value": _listed(curve.value),
                "low": _listed(curve.low),
                "high": _listed(curve.high),
                "unit": curve.unit,
            },
            "formula": described,
            "empirical": None if self.empirical is None else self.empirical.config(),
            "why_not": self.why_not,
        }


def unknown(result: GapResult) -> Unknown | None:
    """Remainder of a result; ``None`` where no statistic counts.

    The statistic is chosen by what the best effects and the errors of the record and of the clear mean leave. A spread
    counts for what means along other axes do not explain: a ripple over the azimuth widens the spread at every range.
    The curve is the departure from the model that is handed out: without effects where none was named.
    """
    search = result.search
    base = search.start if result.fit is None else result.fit.base
    z, used = _unexplained(search, base, result.left)
    z = without_means(departures(search, base, base.sd), z)
    group, part = _most_significant(search, base, z, used)
    if not used[:, part].any():
        return None
    common = z[:, part].sum(0) / np.sqrt(np.maximum(used[:, part].sum(0), 1))
    place = int(np.abs(common).argmax())
    handed_out = base if result.verdict == "named_and_rest" else search.start
    found = departures(search, handed_out, handed_out.total)
    curve = natural_curve(found, group)
    formula = simplest_formula(group.edges, curve.value, curve.sd, group.axis) if group.bins > 1 else None
    stage = empirical_stage(found, group)
    copied = isinstance(stage, Empirical)
    return Unknown(
        group,
        place,
        float(common[place]),
        curve,
        formula,
        stage if isinstance(stage, Empirical) else None,
        None if copied else str(stage),
    )


def departures(search: SimulatorLikelihood, base: SimulatedDistribution, sd: Mapping[str, Floats]) -> Departures:
    """The measured conditions beside a simulation of them, with the scatter that counts."""
    measured = search.measured
    names = [target.condition.id for target in measured]
    # Only LiDARs tell spreads in units of their clear frames'.
    told: Callable[[Condition], Mapping[str, float]] = getattr(search.model, "clear_spread", lambda condition: {})
    clear = [told(target.condition) for target in measured]
    return Departures(
        layout=search.model.layout,
        measured=np.stack([target.vector for target in measured]),
        simulated=np.stack([base.mean[name] for name in names]),
        sd=np.stack([sd[name] for name in names]),
        used=np.stack([base.used[name] for name in names]),
        frames=np.array([target.frames for target in measured]),
        weight=np.stack([search.model.measured(target.condition).weight.mean(0) for target in measured]),
        clear_spread={name: np.array([one[name] for one in clear]) for name in clear[0]},
    )


def _unexplained(
    search: SimulatorLikelihood, base: SimulatedDistribution, left: Floats
) -> tuple[Floats, NDArray[np.bool_]]:
    """Departure of each entry ``(C, P)`` in units of its scatter, from the whitened one; and which entries count."""
    used = np.stack([base.used[target.condition.id] for target in search.measured])
    whitened = left.reshape(used.shape)
    return np.where(used, whitened @ base.whitening.factor.T, 0.0), used


def without_means(found: Departures, z: Floats) -> Floats:
    """Departures of spreads less what the means of the same quantity along other axes make of them.

    Law of total variance: a mean that varies by V along one axis adds V to the variance inside the bins of another.
    """
    groups = list(zip(found.layout.groups, found.layout.slices, strict=True))
    fewer = z.copy()
    for group, part in groups:
        along = [
            _variation(found, z, of)
            for mean, of in groups
            if mean.statistic == MEAN_OF.get(group.statistic) and mean.axis != group.axis and mean.kind == "mean"
        ]
        if along:
            less = z[:, part] - _made_by_means(found, group, part, np.max(along, 0)) / found.sd[:, part]
            fewer[:, part] = np.where(z[:, part] > 0, np.maximum(less, 0.0), z[:, part])
    return fewer


def _made_by_means(found: Departures, group: Group, part: slice, variance: Floats) -> Floats:
    """Part ``(C, bins)`` of the entries of a spread that a variance ``(C,)`` of means within its bins makes."""
    entry, clear = found.measured[:, part], found.clear_spread.get(group.statistic)
    unit = 1.0 if clear is None else clear[:, None]
    spread = unit * (np.exp(entry) if clear is None else spread_of_log_square(entry))
    share = np.clip(variance[:, None] / np.maximum(spread, TINY) ** 2, 0.0, 1.0 - 1e-9)
    less = np.sqrt(1.0 - share)
    if clear is None:
        made: Floats = -np.log(less)
        return made
    return entry - mean_log_square(less * spread / unit)


def _variation(found: Departures, z: Floats, part: slice) -> Floats:
    """Variance over the bins of a departure of means in each condition, ``(C,)``, without that of its own errors."""
    apart, error = z[:, part] * found.sd[:, part], found.sd[:, part]
    weight = np.where(found.used[:, part], found.weight[:, part], 0.0)
    weight = weight / np.maximum(weight.sum(1, keepdims=True), 1e-300)
    middle = (weight * apart).sum(1, keepdims=True)
    varied: Floats = np.maximum((weight * ((apart - middle) ** 2 - error**2)).sum(1), 0.0)
    return varied


def _most_significant(
    search: SimulatorLikelihood, base: SimulatedDistribution, z: Floats, used: NDArray[np.bool_]
) -> tuple[Group, slice]:
    """The group that is least likely to be chance, over all its bins and all conditions."""
    layout = search.model.layout
    correlation = base.whitening.factor @ base.whitening.factor.T
    found = []
    for group, part in zip(layout.groups, layout.slices, strict=True):
        total, count = 0.0, 0
        for own, counts in zip(z[:, part], used[:, part], strict=True):
            of = np.flatnonzero(counts)
            block = correlation[part, part][np.ix_(of, of)]
            total += float(own[of] @ np.linalg.solve(block, own[of])) if len(of) else 0.0
            count += len(of)
        found.append((log_chance(total, count), group, part))
    _, group, part = min(found, key=lambda one: one[0])
    return group, part


def log_chance(total: float, degrees_of_freedom: int) -> float:
    """Logarithm of the probability that a sum of so many squares is as large by chance.

    Example:
        >>> round(log_chance(3.84, 1), 2), round(log_chance(1e5, 2))
        (-2.99, -50000)
    """
    if degrees_of_freedom == 0:
        return 0.0
    found = float(chi2.logsf(total, degrees_of_freedom))
    if found > DEEP:
        return found
    # Leading terms of the incomplete gamma function for large arguments.
    half, shape = 0.5 * total, 0.5 * degrees_of_freedom
    return float(-half + (shape - 1.0) * math.log(half) - gammaln(shape) + math.log1p((shape - 1.0) / half))


def _listed(values: Floats) -> list[float | None]:
    return [float(one) if math.isfinite(one) else None for one in values]
