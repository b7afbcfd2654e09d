"""Global test: response templates of all effects against the nulls of a simulator without them.

References:
    GAP.md 3 (5, 7). Gumbel 1958 (largest of many).
"""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from torchweather.gap.inference.config import METHOD, NUMERICS, SCATTER
from torchweather.gap.inference.degrees_of_freedom import (
    StatisticDegrees,
    as_of_known_noise,
    beyond_known_noise,
)
from torchweather.gap.inference.likelihood import SimulatorLikelihood
from torchweather.gap.inference.location_search import standing_grids
from torchweather.gap.inference.profiled_conditions import Fit
from torchweather.gap.inference.residual_tests import ResidualTest, residual_test
from torchweather.gap.inference.response_templates import ResponseTemplate, delta_chi2
from torchweather.gap.inference.simulated_conditions import ParameterPoint
from torchweather.gap.inference.simulated_distribution import SimulatedDistribution
from torchweather.gap.inference.starting_points import PLACES, ParameterGrid, parameter_grids
from torchweather.pipeline.effect import Effect

__all__ = [
    "GlobalTest",
    "best_of_places",
    "counted_entries",
    "expected_square",
    "first_templates",
    "located_templates",
    "run_global_test",
]

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class GlobalTest:
    """Test of the whole model: is anything missing?

    Args:
        residual: ``(C P,)`` whitened departure of the measured conditions.
        misfit: its square, without what the nuisance explains.
        counted: number of entries.
        templates: responses.
        gains: ``(templates,)`` delta chi-square of each.
        best_null: ``(R,)`` largest gain of each null, of noise that is known.
        misfit_null: ``(R,)``.
        degrees_of_freedom: ``(templates,)`` of the noise along each response.
        degrees_of_all: the same of all statistics together.
        residual_test: noise of each statistic by itself.
        p_value: of the largest of the four departures: along a response, of all entries, of one statistic, of what all
            conditions have in common of one.
        common_p_value: the same of the last one alone.
    """

    residual: Floats
    misfit: float
    counted: int
    templates: tuple[ResponseTemplate, ...]
    gains: Floats
    best_null: Floats
    misfit_null: Floats
    degrees_of_freedom: Floats
    degrees_of_all: float
    residual_test: ResidualTest
    p_value: float
    common_p_value: float

    def raised(self, gain: float, effects: Collection[str]) -> GlobalTest:
        """With an alarm by effects that were fitted in the simulator, where that is the larger one."""
        along = (own for one, own in zip(self.templates, self.degrees_of_freedom, strict=True) if one.id in effects)
        degrees_of_freedom = min(along, default=self.degrees_of_all)
        tail = _tail(self.best_null, float(as_of_known_noise(max(gain, 0.0), degrees_of_freedom)))
        return replace(self, p_value=min(self.p_value, NUMERICS.departures * tail))

    @property
    def threshold(self) -> float:
        """Gain that noise seldom reaches."""
        known = float(np.quantile(self.best_null, 1.0 - METHOD.alarm_p))
        return beyond_known_noise(known, self.degrees_of_all)


def run_global_test(search: SimulatorLikelihood, effects: Sequence[type[Effect]], base: Fit, seed: int) -> GlobalTest:
    """Simulate the response templates of all effects and test whether anything stands out."""
    residual, nuisance = base.residual, base.nuisance
    places = azimuths(search, search.start)
    found = [grid for effect in effects for grid in parameter_grids(effect, places, search.model.sizes)]
    found += standing_grids(search, effects, search.origin)
    left = nuisance.left(residual)
    templates = first_templates(search, found, search.origin, search.start)
    gain = delta_chi2(templates, left[None], nuisance)[0]
    near = {
        id(template.grid)
        for template, one in zip(templates, gain, strict=True)
        if one >= NUMERICS.refined_share * gain.max()
    }
    remaining = [
        (grid, place)
        for grid in found
        if id(grid) in near
        for place in range(len(grid.points))
        if place not in grid.first
    ]
    templates += search.templates(remaining, search.origin, search.start)
    nulls = search.null_residuals(nuisance, NUMERICS.null_draws, seed)
    of_nulls = delta_chi2(templates, nuisance(nulls), nuisance)
    placed = np.array([any(one.name in PLACES for one in template.grid.effect.arguments) for template in templates])
    best_null = best_of_places(of_nulls, placed, _sectors(search), seed)
    misfit_null = np.einsum("rk,rk->r", nulls, nuisance(nulls))
    scenes = {target.condition.id: target.condition.scene for target in search.measured}
    known = StatisticDegrees(search.model.layout, search.start, scenes)
    degrees_of_freedom = np.array([known.of(template.response) for template in templates])
    gain = delta_chi2(templates, left[None], nuisance)[0]
    misfit = search.misfit(residual, nuisance)
    counted = counted_entries(search)
    p_gain = _tail(best_null, float(as_of_known_noise(gain, degrees_of_freedom).max()))
    of_all = min(known.of_all, SCATTER.known_degrees)
    unsure = np.random.default_rng([seed, 49979687]).chisquare(of_all, len(misfit_null)) / of_all
    p_misfit = _tail(misfit_null / unsure, misfit)
    each = residual_test(search, base)
    p_common = min(1.0, NUMERICS.departures * each.common_p_value(left))
    p_value = min(p_common, NUMERICS.departures * min(p_gain, p_misfit, each.p_value(left)))
    return GlobalTest(
        residual,
        misfit,
        counted,
        tuple(templates),
        gain,
        best_null,
        misfit_null,
        degrees_of_freedom,
        known.of_all,
        each,
        p_value,
        p_common,
    )


def located_templates(search: SimulatorLikelihood, effects: Sequence[type[Effect]], fit: Fit) -> list[ResponseTemplate]:
    """Responses of effects that have a place, at the places where a fit leaves most, on top of it.

    The first effect of several drowns the place of another.
    """
    placed = [effect for effect in effects if any(one.name in PLACES for one in effect.arguments)]
    found = [
        grid for effect in placed for grid in parameter_grids(effect, azimuths(search, fit.base), search.model.sizes)
    ]
    found += standing_grids(search, placed, fit.point)
    return first_templates(search, found, fit.point, fit.base)


def first_templates(
    search: SimulatorLikelihood, grids: Sequence[ParameterGrid], point: ParameterPoint, base: SimulatedDistribution
) -> list[ResponseTemplate]:
    """Responses at the points that are tried first, on top of a point, of which not all need frames of their own.

    An effect that does nothing at a typical strength does nothing at a weak one; and a weak departure to one side of
    the identity does what one to the other side does, with the other sign.
    """
    strong = search.templates([(grid, grid.first[-1]) for grid in grids], point, base)
    weak = [(one.grid, place) for one in strong for place in one.grid.first[:-1]]
    active = {id(one.grid) for one in strong if one.response.any()}
    places = {(id(grid), place) for grid, place in weak}
    mirrored = {
        id(grid)
        for grid, place in weak
        if {id(grid), id(grid.mirror)} <= active and not grid.curved and (id(grid.mirror), place) in places
    }
    asked = [(grid, place) for grid, place in weak if id(grid) in active - mirrored]
    known = {(id(one.grid), one.number): one.response for one in search.templates(asked, point, base)}
    found = list(strong)
    for grid, place in weak:
        if id(grid) in mirrored:
            response = -known[id(grid.mirror), place]
        else:
            response = known.get((id(grid), place), np.zeros_like(strong[0].response))
        found.append(ResponseTemplate(grid, place, grid.points[place], response))
    return found


def azimuths(search: SimulatorLikelihood, base: SimulatedDistribution) -> list[float]:
    """Where in azimuth the measurement departs most: two places at which effects with a place are tried."""
    layout = search.model.layout
    total: dict[tuple[float, ...], Floats] = {}
    for target in search.measured:
        name = target.condition.id
        apart = (target.vector - base.mean[name]) / base.sd[name]
        z: Floats = np.where(base.used[name], apart, 0.0)
        for group, part in zip(layout.groups, layout.slices, strict=True):
            if group.axis == "azimuth_rad":
                common = float(np.median(z[part]))
                total.setdefault(group.edges, np.zeros(group.bins))
                total[group.edges] += np.abs(z[part] - common)
    found = []
    for edges, values in total.items():
        middles = 0.5 * (np.asarray(edges[1:]) + np.asarray(edges[:-1]))
        best = np.argsort(-values)
        found += [float(middles[best[0]])]
        elsewhere = [place for place in best[1:] if abs(middles[place] - middles[best[0]]) > 0.6]
        found += [float(middles[elsewhere[0]])] if elsewhere else []
    return found


def best_of_places(gains: Floats, placed: NDArray[np.bool_], places: int, seed: int) -> Floats:
    """Largest gain ``(R,)`` of each null where effects with a place are tried at the one of several that departs most.

    The templates at hand are of places at which the measurement departs, not of where a null would. So of each null
    the best of as many others stands for that: their gains at a place that nothing chose.

    Args:
        gains: ``(R, templates)`` of the nulls.
        placed: ``(templates,)`` those of effects with a place.
        places: number that there are to choose from.
        seed: of the choice of other nulls.
    """
    if not placed.any():
        return np.asarray(gains.max(1), dtype=np.float64)
    generator = np.random.default_rng([seed, 32452843])
    one_place = gains[:, placed].max(1)
    best = np.stack([generator.permutation(one_place) for _ in range(places)]).max(0)
    return np.asarray(np.maximum(best, gains[:, ~placed].max(1, initial=0.0)), dtype=np.float64)


def _sectors(search: SimulatorLikelihood) -> int:
    """Places in azimuth to choose from, over those that are looked at."""
    bins = max((group.bins for group in search.model.layout.groups if group.axis == "azimuth_rad"), default=1)
    return max(bins // NUMERICS.places_looked_at, 1)


def counted_entries(search: SimulatorLikelihood) -> int:
    """Number of statistics that hold enough to count, over all conditions."""
    return int(sum(search.start.used[target.condition.id].sum() for target in search.measured))


def expected_square(search: SimulatorLikelihood) -> float:
    """Summed squares that noise alone makes of a departure, over all conditions: less than the number of statistics, as
    in some of them hardly anything can happen."""
    start = search.start
    return float(sum((start.expected[t.condition.id] * start.used[t.condition.id]).sum() for t in search.measured))


def _tail(null: Floats, value: float) -> float:
    """Probability that a null exceeds a value: counted, and beyond those by a Gumbel law of their moments."""
    counted = float((null >= value).mean())
    if counted * len(null) >= 20:
        return counted
    scale = float(null.std()) * math.sqrt(6.0) / math.pi
    place = float(null.mean()) - 0.5772156649 * scale
    return float(-np.expm1(-np.exp(-min((value - place) / max(scale, 1e-12), 700.0))))
