"""Candidates: parameter points that response templates propose, fitted in the simulator.

References:
    GAP.md 3 (6).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from torchweather.gap.inference.config import NUMERICS
from torchweather.gap.inference.effect_forms import is_another
from torchweather.gap.inference.effect_sets import best_effect_pairs, best_single_effects
from torchweather.gap.inference.held_out import HeldOut
from torchweather.gap.inference.likelihood import SimulatorLikelihood
from torchweather.gap.inference.location_search import located
from torchweather.gap.inference.profiled_conditions import Fit
from torchweather.gap.inference.response_templates import ResponseTemplate, amplitudes, delta_chi2
from torchweather.gap.inference.simulated_conditions import ParameterPoint
from torchweather.gap.inference.starting_points import parameter_grids
from torchweather.gap.inference.systematics import Bounds, Systematics

__all__ = [
    "Candidate",
    "Proposal",
    "best_of_each_set",
    "best_templates",
    "fitted",
    "from_rest",
    "hidden_templates",
    "pairs_from_rest",
    "refined",
    "scattering",
    "stands_far",
    "unscaled_templates",
]

Floats = NDArray[np.float64]

Proposal = tuple[ParameterPoint, ResponseTemplate, float]
"""A parameter point, the template to put on top of it, and how much of its response is expected."""


@dataclass(frozen=True)
class Candidate:
    """An effect, fitted.

    Args:
        id: of the effect.
        fit: with it and what was found before.
        gain: by which it lowers the misfit.
        held, held_fit: departure of the held-out conditions with it, and their nuisances, where they were looked at.
        with_forms: misfit where the forms of the other effects may be in error; ``None`` where there are no others.
    """

    id: str
    fit: Fit
    gain: float
    held: HeldOut | None = None
    held_fit: Fit | None = None
    with_forms: float | None = None

    @property
    def misfit(self) -> float:
        """By which it is compared with its rivals."""
        return self.fit.misfit if self.with_forms is None else self.with_forms


def best_templates(
    templates: Sequence[ResponseTemplate], left: Floats, nuisance: Systematics
) -> list[tuple[ResponseTemplate, float]]:
    """The best template of each effect that is worth a fit, with its amplitude, best first."""
    gain = delta_chi2(templates, left[None], nuisance)[0]
    amplitude = amplitudes(templates, left[None], nuisance)[0][0]
    best: dict[str, int] = {}
    for place in np.argsort(-gain):
        best.setdefault(templates[place].id, int(place))
    worth = [place for place in best.values() if gain[place] >= NUMERICS.refit_share * gain.max()]
    return [(templates[place], float(amplitude[place])) for place in worth]


def unscaled_templates(
    templates: Sequence[ResponseTemplate],
    chosen: Sequence[tuple[ResponseTemplate, float]],
    left: Floats,
    nuisance: Systematics,
) -> list[tuple[ResponseTemplate, float]]:
    """Unscaled template that explains most, or spoils least, of each effect that begins at a threshold and whose chosen
    template would be scaled to much less.

    A share of the response to many strong ghosts is not the response to the first ones that are detected.
    """
    responses = np.stack([template.response for template in templates])
    gain = 2.0 * responses @ left - (responses * nuisance(responses)).sum(1)
    best: dict[str, int] = {}
    for place in np.argsort(-gain):
        best.setdefault(templates[place].id, int(place))
    scaled = [
        template for template, amplitude in chosen if template.grid.curved and amplitude < NUMERICS.threshold_amplitude
    ]
    return [(templates[best[template.id]], 1.0) for template in scaled]


def hidden_templates(
    templates: Sequence[ResponseTemplate], nuisance: Systematics, open_ones: slice
) -> list[tuple[ResponseTemplate, float]]:
    """Templates that the nuisances imitate: the most similar one of each effect, with its amplitude, best first.

    Such an effect gains nothing while the nuisances explain its part.

    Args:
        templates: responses.
        nuisance: where they stand.
        open_ones: places of what is left open among the nuisances.
    """
    done = nuisance.response[:, open_ones] @ nuisance.offset[open_ones]
    responses = np.stack([template.response for template in templates])
    norm = np.maximum((responses**2).sum(1), 1e-12)
    along = np.maximum(responses @ done, 0.0)
    best: dict[str, int] = {}
    for place in np.argsort(-(along**2 / norm)):
        best.setdefault(templates[place].id, int(place))
    return [
        (templates[place], float(min(along[place] / norm[place], NUMERICS.template_amplitudes[1])))
        for place in best.values()
    ]


def best_of_each_set(candidates: Sequence[Candidate]) -> list[Candidate]:
    """The best fit of each set of effects, best first: one that was fitted from two starts is no rival of itself."""
    found: dict[frozenset[str], Candidate] = {}
    for one in sorted(candidates, key=lambda one: one.fit.misfit):
        found.setdefault(frozenset(one.fit.point.values), one)
    return list(found.values())


def from_rest(
    search: SimulatorLikelihood, fit: Fit, templates: Sequence[ResponseTemplate]
) -> list[tuple[ResponseTemplate, float, float]]:
    """The best template of each effect on top of a fit, with what the model leaves open near where it belongs.

    Where that has gone far to stand for an effect, the effect's response explains little of what is left, and that of
    another which patches the rest explains more.

    Args:
        search: its simulator.
        fit: that something open has gone far in.
        templates: responses around it.

    Returns:
        Templates with their amplitudes and gains, best first: those that gain a good share of what the best one does.
    """
    bounds, opened = search.bounds(fit.nuisance), slice(len(search.measured), fit.nuisance.moving)
    low, high = bounds.low.copy(), bounds.high.copy()
    far = NUMERICS.far_sd
    low[opened], high[opened] = np.clip(low[opened], -far, far), np.clip(high[opened], -far, far)
    best = best_single_effects(templates, fit.residual, fit.nuisance, Bounds(low, high))
    worth = [one for one in best if one.gain >= NUMERICS.refit_share * best[0].gain]
    return [(one.templates[0], one.amplitudes[0], one.gain) for one in worth]


def pairs_from_rest(
    search: SimulatorLikelihood, base: Fit, best: Fit, templates: Sequence[ResponseTemplate], least: float
) -> list[Proposal]:
    """Pairs of effects that explain more than the best one by ``least``, best first, each to be fitted from rest.

    At rest the record is right and nothing that the model leaves open has moved. What a wrong effect has led the
    nuisances to is then no part of the start.

    Args:
        search: its simulator.
        base: the fit without effects.
        best: the fit with one effect; of a pair with that one the other is what is added.
        templates: responses around ``base``.
        least: that a pair must gain over the best single one.
    """
    found = []
    scored = best_effect_pairs(templates, base.residual, base.nuisance, search.bounds(base.nuisance), least)
    for pair in scored[: NUMERICS.pairs_refitted]:
        members = sorted(
            zip(pair.templates, pair.amplitudes, strict=True), key=lambda one: one[0].id not in best.point.values
        )
        (first, amplitude), (second, other) = members
        found.append((ParameterPoint({first.id: _start(first, amplitude)}), second, other))
    return found


def scattering(
    search: SimulatorLikelihood, base: Fit, templates: Sequence[ResponseTemplate], least: float
) -> list[tuple[Fit, Proposal]]:
    """The likeliest strength of each effect by which whole frames differ, and which other statistics than means show.

    The mean of a few such frames is off either way, by more than the mean response of many: its scatter explains that.

    Args:
        search: its simulator.
        base: the fit without effects.
        templates: responses.
        least: gain of a response in other statistics than means from which its effect is looked at.

    Returns:
        The simulator with each effect, to begin a fit from, and the proposal of that strength.
    """
    own = [template for template in templates if template.grid.effect.scatters]
    found = []
    for name in dict.fromkeys(template.id for template in own if _gain_beside_means(search, template) >= least):
        tried = []
        for grid in {id(template.grid): template.grid for template in own if template.id == name}.values():
            for number, values in enumerate(grid.points):
                fit = search.fit(replace(search.origin, values={name: values}), base.nuisance, base.base, 0)
                tried.append((fit, ResponseTemplate(grid, number, values, base.residual)))
        best, template = min(tried, key=lambda one: one[0].misfit)
        found.append((best, (search.origin, template, 1.0)))
    return found


def _gain_beside_means(search: SimulatorLikelihood, template: ResponseTemplate) -> float:
    """Decrease, by a scaled response, of the squares of departures in entries that are no means of elements."""
    there, here = (
        search.mean(replace(search.origin, values=values), NUMERICS.screen_frames)
        for values in ({template.id: template.values}, {})
    )
    along = norm = 0.0
    for target, moved, still in zip(search.measured, there, here, strict=True):
        name = target.condition.id
        counted = search.start.used[name] & ~search.model.layout.averages
        response = np.where(counted, (moved - still) / search.start.total[name], 0.0)
        along += float(response @ search.start.z(target))
        norm += float(response @ response)
    return max(along, 0.0) ** 2 / max(norm, 1e-12)


def stands_far(point: ParameterPoint) -> bool:
    """Check whether something that the model leaves open has moved by more than such things do by chance."""
    return any(abs(value) > NUMERICS.far_sd for value in point.open.values())


def fitted(
    search: SimulatorLikelihood,
    base: Fit,
    proposed: Sequence[Proposal],
    misfit: float,
    progress: Callable[[str], None],
    profiled: int = NUMERICS.profiled_beside,
) -> list[Candidate]:
    """Effects fitted in the simulator, each on top of its point; best first. One at least, and no further one once as
    many frames were simulated as may be. Beside the first few, ``profiled``, the nuisances are fitted anew."""
    found: list[Candidate] = []
    for place, (point, template, amplitude) in enumerate(proposed):
        if found and search.exhausted:
            break
        progress("fitting " + " and ".join([*point.values, template.id]))
        begun = _begun(search, base, point, template, amplitude)
        there = replace(base, base=begun.base, nuisance=begun.nuisance)
        starts = [(begun.point, begun.nuisance)]
        response = template.response
        shadowed = response @ base.nuisance(response) < NUMERICS.shadowed_shares[stands_far(point)] * (
            response @ response
        )
        if shadowed and place < profiled and not point.values:
            # The nuisances have moved to look like the effect while it was not there: profile over them beside it.
            start, nuisance = _profiled_along(search, base, point, template, misfit)
            starts.append((start, search.nuisance_at(nuisance, base.base, begun.base)))
        fits = []
        for start, nuisance in starts:
            start = located(search, start, template.id, there)
            fits.append(search.fit(start, nuisance, begun.base, NUMERICS.first_fit_steps))
        fit = min(fits, key=lambda one: one.misfit)
        if stands_far(fit.point) and place < profiled and not point.values:
            # The nuisances may have settled in a wrong place: profile over them from zero beside the effect as found.
            start, nuisance, _ = search.profile_beside(ParameterPoint(fit.point.values), base, NUMERICS.profile_rounds)
            fit = min(fit, search.fit(start, nuisance, base.base, NUMERICS.first_fit_steps), key=lambda one: one.misfit)
        found.append(Candidate(template.id, fit, misfit - fit.misfit))
    least = min(candidate.fit.misfit for candidate in found)
    for place, one in enumerate(found):
        if one.fit.misfit < least + NUMERICS.rival_chi2:
            progress("refining " + " and ".join(one.fit.point.values))
            fit = refined(search, one.fit)
            found[place] = Candidate(one.id, fit, misfit - fit.misfit)
    own = [one for one in found if not is_another(search.model, one.fit.point.values)]
    return sorted(own or found, key=lambda candidate: candidate.fit.misfit)


def _begun(
    search: SimulatorLikelihood, base: Fit, point: ParameterPoint, template: ResponseTemplate, amplitude: float
) -> Fit:
    """The simulator where a fit of an effect begins, with the scatter there: where as much of its template's response
    is expected as explains most, or at a weaker point of the template's grid where that is far from there.

    The scatter of the model without the effect is not that of the model with it: where counts of a few are new, they
    would be as many surprises, and a fit would take the effect away again.
    """
    grid = template.grid
    tried = [_start(template, amplitude)]
    if amplitude < NUMERICS.threshold_amplitude and not grid.effect.cuts:
        tried += [_start(replace(template, values=values), 1.0) for values in grid.points[: template.number]]
    best: Fit | None = None
    for values in tried:
        there = replace(point, values={**point.values, template.id: values})
        found = search.fit(there, base.nuisance, base.base, 0)
        if best is not None and found.misfit > best.misfit:
            break
        best = found
    assert best is not None
    return best


def refined(search: SimulatorLikelihood, fit: Fit) -> Fit:
    """Fitted on, with the scatter and the nuisances as they are where the fit stands, while that helps."""
    for _ in range(NUMERICS.reweightings):
        if search.exhausted:
            break
        found = search.fit(fit.point, search.nuisance(fit.point, fit.base), fit.base)
        gained = fit.misfit - found.misfit
        fit = found if gained > 0 else fit
        if gained < NUMERICS.converged_chi2:
            break
    return fit


def _profiled_along(
    search: SimulatorLikelihood, base: Fit, point: ParameterPoint, template: ResponseTemplate, misfit: float
) -> tuple[ParameterPoint, Systematics]:
    """Profile over the nuisances beside an effect, at the best of its weak strengths and at the least of a parabola
    through their misfits; the nuisances do not reach as far as a strong effect.

    Args:
        search: its simulator.
        base: the fit without effects.
        point: effects found before.
        template: of the effect.
        misfit: without the effect.

    Returns:
        The point, and the nuisances there.
    """

    def profiled(values: Mapping[str, float]) -> tuple[ParameterPoint, Systematics, float]:
        values = _start(replace(template, values=values), 1.0)
        return search.profile_beside(
            ParameterPoint({**point.values, template.id: values}), base, NUMERICS.profile_rounds
        )

    (name,) = [
        one.name for one in template.grid.effect.arguments if one.identity is not None and one.name in template.values
    ]
    declared = next(one for one in template.grid.effect.arguments if one.name == name)
    # Of either sign: while the nuisances look like the effect, its own may be the wrong one.
    curves = parameter_grids(template.grid.effect, [template.values.get("azimuth_rad", 0.0)], search.model.sizes)
    curves = [one for one in curves if name in one.points[0]]
    strengths = {values[name] for curve in curves for values in curve.points[: 2 if len(curves) > 1 else 3]}
    found = {strength: profiled({**template.values, name: strength}) for strength in sorted(strengths)}
    if declared.identity is not None and math.isfinite(declared.identity):
        for _ in range(NUMERICS.valley_steps):
            # Along a narrow valley, in which an effect and the record say nearly the same, no derivative leads.
            strength = min(found, key=lambda one: found[one][2])
            farther = declared.identity + NUMERICS.valley_factor * (strength - declared.identity)
            farther = min(max(farther, declared.low), declared.high)
            if any((one - strength) * (strength - declared.identity) > 0 for one in found) or farther == strength:
                break
            found[farther] = profiled({**template.values, name: farther})
        places = [declared.identity, *found]
        least = _least(np.array(places), np.array([misfit, *(one[2] for one in found.values())]))
        found[least] = profiled({**template.values, name: least})
    best = min(found.values(), key=lambda one: one[2])
    return best[0], best[1]


def _least(place: Floats, value: Floats) -> float:
    """Where a parabola through the least of some values and its neighbours has its own, not beyond those."""
    order = np.argsort(place)
    place, value = place[order], value[order]
    middle = min(max(int(value.argmin()), 1), len(place) - 2)
    near = slice(middle - 1, middle + 2)
    curvature, slope, _ = np.polyfit(place[near] - place[middle], value[near], 2)
    if curvature <= 0:
        return float(place[value.argmin()])
    return float(np.clip(place[middle] - 0.5 * slope / curvature, place[near][0], place[near][-1]))


def _start(template: ResponseTemplate, amplitude: float) -> dict[str, float]:
    """All parameters where an effect of so many times a template's response is expected."""
    found, effect = {}, template.grid.effect
    amplitude = 1.0 if effect.cuts else amplitude
    for one in effect.arguments:
        value = template.values.get(one.name, one.value)
        if one.identity is not None and math.isfinite(one.identity) and value != one.identity:
            value = one.identity + max(amplitude, NUMERICS.least_amplitude) * (value - one.identity)
        found[one.name] = min(max(value, one.low), one.high) if math.isfinite(value) else value
    return found
