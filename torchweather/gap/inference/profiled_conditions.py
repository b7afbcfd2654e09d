"""Nuisances: what must not be taken for an effect, and the profile over it.

A nuisance (``systematics.py``) is the error of the weather record of every condition, what whole frames do
(``frame_random_effects.py``), or what the model leaves open; in units of its standard deviation.

References:
    GAP.md 3 (4).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np
from numpy.typing import NDArray

from torchweather.gap.inference.config import NUMERICS, SCATTER
from torchweather.gap.inference.effect_forms import effect_class
from torchweather.gap.inference.simulated_conditions import ParameterPoint, SimulatedConditions
from torchweather.gap.inference.simulated_distribution import SimulatedDistribution
from torchweather.gap.inference.systematics import BoundedStep, Bounds, Systematics, bounded_step, together
from torchweather.gap.statistics.frame_random_effects import (
    FrameDeparture,
    clear_errors,
    clear_means,
    frame_departures,
    model_errors,
)
from torchweather.gap.statistics.frame_statistics import COUNTED

__all__ = ["Fit", "ProfiledConditions"]

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Fit:
    """A parameter point, fitted in the simulator.

    Args:
        point: effects, parameters, nuisances.
        base: the simulator there.
        residual: ``(C P,)`` of the measured conditions there.
        nuisance: there.
        misfit: of the measured conditions with the prior of the nuisances, and the logarithm of the scatter over that
            of the start: minus twice the logarithm of the likelihood, but for a constant.
        covariance: ``(K, K)`` of the parameters, least squares, in the order of ``names``.
        names: (effect, parameter) of each.
    """

    point: ParameterPoint
    base: SimulatedDistribution
    residual: Floats
    nuisance: Systematics
    misfit: float
    covariance: Floats
    names: tuple[tuple[str, str], ...]


class ProfiledConditions(SimulatedConditions):
    """One study's conditions, with a profile over their nuisances; arguments of ``SimulatedConditions``."""

    @cached_property
    def frame_departures(self) -> list[FrameDeparture]:
        """Departures by whole frames, which the clear frames show."""
        return frame_departures(self.model, self.measured)

    @cached_property
    def clear_means(self) -> dict[str, Floats]:
        """Vector ``(P,)`` of all clear frames of each scene."""
        return clear_means(self.model, self.measured)

    def intensity_sd(self) -> Floats:
        """Stated uncertainty of the weather of each condition: standard deviation of its logarithm."""
        return np.array([target.intensity_sd for target in self.measured])

    def offset(self, point: ParameterPoint) -> Floats:
        """Where the nuisances that move stand at a point, in standard deviations: intensities, and what is open."""
        sd = self.intensity_sd()
        off = np.array([point.log_intensity.get(target.condition.id, 0.0) for target in self.measured])
        intensities = np.where(sd > 0, off / np.where(sd > 0, sd, 1.0), 0.0)
        opened = np.array([point.open.get(name, 0.0) for name in self.open])
        return np.concatenate([intensities, opened])

    def bounds(self, nuisance: Systematics) -> Bounds:
        """Where nuisances may stand, in standard deviations; those that no simulator moves may anywhere."""
        number = len(self.measured)
        low, high = np.full(len(nuisance.offset), -np.inf), np.full(len(nuisance.offset), np.inf)
        low[: nuisance.moving], high[: nuisance.moving] = -SCATTER.nuisance_bound_sd, SCATTER.nuisance_bound_sd
        low[number : nuisance.moving] = np.maximum(low[number : nuisance.moving], list(self.open.values()))
        return Bounds(low, high)

    def shifted(self, point: ParameterPoint, step: Floats) -> ParameterPoint:
        """A point with its nuisances moved by a step ``(K,)``."""
        sd, number = self.intensity_sd(), len(self.measured)
        offset = self.offset(point)
        place = np.clip(offset + step[: len(offset)], -SCATTER.nuisance_bound_sd, SCATTER.nuisance_bound_sd)
        place[number : number + len(self.open)] = np.maximum(
            place[number : number + len(self.open)], list(self.open.values())
        )
        intensities = {t.condition.id: float(place[k] * sd[k]) for k, t in enumerate(self.measured)}
        opened = {name: float(place[number + k]) for k, name in enumerate(self.open)}
        return replace(point, log_intensity=intensities, open=opened)

    def nuisance(self, point: ParameterPoint, base: SimulatedDistribution) -> Systematics:
        """Responses to the nuisances at a point: differences in the simulator."""
        slopes = self._slopes(point)
        columns = [
            self._column(base, {number: slope * sd})
            for number, (slope, sd) in enumerate(zip(slopes, self.intensity_sd(), strict=True))
        ]
        columns += self._open_columns(point, base)
        whitened = partial(self._column, base)
        fixed = clear_errors(self.frame_departures, self.measured, self.model.open_shifts, whitened)
        fixed += model_errors(self.model.layout, self.measured, base, self.clear_means, whitened)
        for number, errors in enumerate(self._density_errors(point)):
            fixed += [self._column(base, {number: error}) for error in errors]
        response = np.stack([*columns, *fixed], 1)
        # A gauge that reads too low may do so in every condition.
        precision = together(response.shape[1], len(self.measured))
        offset = np.concatenate([self.offset(point), np.zeros(len(fixed))])
        return Systematics(response, offset, len(columns), precision)

    def nuisance_at(self, nuisance: Systematics, old: SimulatedDistribution, new: SimulatedDistribution) -> Systematics:
        """Nuisances in units of another scatter."""
        response = self.rewhitened(nuisance.response.T, old, new).T
        return Systematics(response, nuisance.offset, nuisance.moving, nuisance.precision, nuisance.behind)

    def _nuisance_at(self, point: ParameterPoint, nuisance: Systematics, base: SimulatedDistribution) -> Systematics:
        """Nuisances as they stand at a point: new ones where the densities of frames differ by what the point says."""
        if self.log_density_sd(point):
            return self._renewed(nuisance, point, base)
        return nuisance.moved(self.offset(point))

    def _slopes(self, point: ParameterPoint) -> list[Floats]:
        """Change ``(P,)`` of each condition's mean vector per unit of the logarithm of its intensity."""
        steps = np.maximum(NUMERICS.intensity_step_sd * self.intensity_sd(), NUMERICS.least_intensity_step)
        ends = []
        for sign in (1.0, -1.0):
            log_intensity = {
                target.condition.id: point.log_intensity.get(target.condition.id, 0.0) + sign * step
                for target, step in zip(self.measured, steps, strict=True)
            }
            ends.append(self.mean(replace(point, log_intensity=log_intensity), NUMERICS.screen_frames))
        return [(high - low) / (2.0 * step) for high, low, step in zip(*ends, steps, strict=True)]

    def _renewed(self, nuisance: Systematics, point: ParameterPoint, base: SimulatedDistribution) -> Systematics:
        """Nuisances as they are at a point, with the errors of forms that are behind them."""
        return self.nuisance(point, base).beside(nuisance.response[:, nuisance.response.shape[1] - nuisance.behind :])

    def _open_columns(self, point: ParameterPoint, base: SimulatedDistribution) -> list[Floats]:
        """Responses to what the model leaves open, per standard deviation; at once where no condition has two of it."""
        if not self.open:
            return []
        before = self.mean(point, NUMERICS.screen_frames)
        places = {
            name: [k for k, target in enumerate(self.measured) if name in self.model.open(target.condition)]
            for name in self.open
        }
        columns: dict[str, Floats] = {}
        while len(columns) < len(self.open):
            steps: dict[str, float] = {}
            taken: set[int] = set()
            for name in self.open:
                if name in columns or taken & set(places[name]):
                    continue
                taken |= set(places[name])
                strength = point.open.get(name, 0.0)
                # A short one would be noise alone.
                steps[name] = (
                    NUMERICS.systematic_step_sd
                    if strength + NUMERICS.systematic_step_sd <= SCATTER.nuisance_bound_sd
                    else -NUMERICS.systematic_step_sd
                )
            moved = {name: point.open.get(name, 0.0) + step for name, step in steps.items()}
            after = self.mean(replace(point, open={**point.open, **moved}), NUMERICS.screen_frames)
            for name, step in steps.items():
                columns[name] = self._column(base, {k: (after[k] - before[k]) / step for k in places[name]})
        return [columns[name] for name in self.open]

    def _column(self, base: SimulatedDistribution, departures: Mapping[int, Floats]) -> Floats:
        """Whitened departures of some conditions, 0 in the others, ``(C P,)``."""
        nothing = np.zeros(self.model.layout.size)
        return self.whitened(base, [departures.get(place, nothing) for place in range(len(self.measured))])

    def _along(
        self,
        point: ParameterPoint,
        names: Sequence[tuple[str, str]],
        step: BoundedStep,
        cost: float,
        base: SimulatedDistribution,
        nuisance: Systematics,
    ) -> tuple[float, ParameterPoint, list[Floats]] | None:
        """The best of a few shares of a step that cost less than before: cost, point and mean vectors there.

        Along a valley in which an effect and the record say nearly the same, a step from finite differences is short.
        A parabola through the cost before, its slope there and the cost behind the whole step says whether: where its
        least lies beyond the step, the step is doubled while that helps.

        Args:
            point: to start from.
            names: parameters that move.
            step: change of the parameters and of the nuisances, and the misfit that a linear simulator has behind it.
            cost: at the start.
            base: scatter.
            nuisance: at the start.
        """

        def tried(share: float) -> tuple[float, ParameterPoint, list[Floats]]:
            there = self.shifted(self._moved(point, names, share * step.amplitudes), share * step.aside)
            mean = self.mean(there)
            return nuisance.moved(self.offset(there)).cost(self.departure(base, mean)), there, mean

        best = None
        for share in NUMERICS.step_shares:
            found = tried(share)
            if found[0] < cost - 1e-6:
                best = found
                break
        if (
            best is None
            or share != NUMERICS.step_shares[0]
            or cost - best[0] < NUMERICS.doubled_from * (cost - step.misfit)
        ):
            return best
        longer = 2.0
        while longer <= NUMERICS.longest_step:
            found = tried(longer)
            if found[0] >= best[0]:
                break
            best, longer = found, 2.0 * longer
        return best

    def _moved(self, point: ParameterPoint, names: Sequence[tuple[str, str]], step: Floats) -> ParameterPoint:
        values = {effect: dict(given) for effect, given in point.values.items()}
        for (effect, parameter), change in zip(names, step, strict=True):
            declared = next(one for one in effect_class(self.model, effect).arguments if one.name == parameter)
            # Not further than twice the typical size at once.
            limited = float(np.clip(change, -2.0 * declared.scale, 2.0 * declared.scale))
            moved = values[effect][parameter] + limited
            values[effect][parameter] = float(np.clip(moved, declared.low, declared.high))
        return replace(point, values=values)

    def _bounded(
        self,
        residual: Floats,
        nuisance: Systematics,
        columns: Floats | None = None,
        limits: Bounds | None = None,
        ridge: Floats | float = 0.0,
    ) -> BoundedStep:
        """The best explanation of a residual within the bounds of the nuisances, with columns or none."""
        columns = np.zeros((len(residual), 0)) if columns is None else columns
        limits = limits or Bounds(np.zeros(0), np.zeros(0))
        return bounded_step(residual, nuisance, self.bounds(nuisance), columns, limits, ridge)

    def misfit(self, residual: Floats, nuisance: Systematics) -> float:
        """Square of the residual, with the cost of nuisances that are moved within their bounds."""
        return self._bounded(residual, nuisance).misfit

    def _wider(self, base: SimulatedDistribution) -> float:
        """Twice the logarithm of the scatter over that of the start, of all entries.

        Counts are charged only for what exceeds the scatter of counting: the first few of an empty bin have that.
        """
        counts = self.model.layout.each(lambda group: group.kind in COUNTED)
        total = 0.0
        for target in self.measured:
            name = target.condition.id
            used = self.start.used[name] & base.used[name]
            free = np.where(counts, self.start.independent[name], 0.0)
            wider = np.maximum(base.sd[name], free) / np.maximum(self.start.sd[name], free)
            total += 2.0 * float(np.log(wider[used]).sum())
        return total

    def begin(self) -> Fit:
        """Fit the nuisances of the model as it is; the search then starts from there."""
        profiled = self.profile(ParameterPoint())
        self.start, self.origin = profiled.base, profiled.point
        return replace(profiled, misfit=self.misfit(profiled.residual, profiled.nuisance))

    def profile(self, point: ParameterPoint) -> Fit:
        """Profile over the nuisances at a point of effects; the intensities are first looked for on a grid."""
        point = self._scanned(point, NUMERICS.intensity_halvings_sd)
        base = self.at(point)
        point, nuisance, _ = self._profiled(point, base, self.nuisance(point, base), NUMERICS.nuisance_rounds)
        if not point.values:
            for target in self.measured:
                self.model.render_near(target.condition, point.log_intensity.get(target.condition.id, 0.0))
        final = self.at(point)
        residual, nuisance = self.residual(final), self.nuisance_at(nuisance, base, final)
        misfit = self.misfit(residual, nuisance) + self._wider(final)
        return Fit(point, final, residual, nuisance, misfit, np.zeros((0, 0)), ())

    def profile_beside(
        self, point: ParameterPoint, like: Fit, rounds: int
    ) -> tuple[ParameterPoint, Systematics, float]:
        """The same beside a weak effect, with the scatter and, at first, the nuisances of a fit without it.

        Args:
            point: of the effect; the intensities are looked for.
            like: the fit without it.
            rounds: at most.

        Returns:
            The point, the nuisances there, and the misfit.
        """
        point = self._scanned(point)
        here = like.nuisance.moved(self.offset(point))
        found, nuisance, residual = self._profiled(point, like.base, here, rounds, NUMERICS.kept_while_gained)
        return found, nuisance, self.misfit(residual, nuisance)

    def _profiled(
        self,
        point: ParameterPoint,
        base: SimulatedDistribution,
        nuisance: Systematics,
        rounds: int,
        kept_while_gained: float = math.inf,
    ) -> tuple[ParameterPoint, Systematics, Floats]:
        """The point with its nuisances moved, the nuisances, and the residual there.

        Responses are renewed behind a step that gained less than such a share of what they promised, as in the chord
        method: they cost more frames than a step.
        """
        residual = self.departure(base, self.mean(point))
        cost = nuisance.cost(residual)
        for _ in range(rounds):
            step = self._bounded(residual, nuisance)
            found = self._along(point, (), step, cost, base, nuisance)
            if found is None:
                break
            gained, promised = cost - found[0], cost - step.misfit
            cost, point, mean = found
            residual = self.departure(base, mean)
            if gained < NUMERICS.converged_chi2 + NUMERICS.stalled_share * cost:
                break
            if gained < kept_while_gained * promised:
                nuisance = self.nuisance(point, base)
            nuisance = nuisance.moved(self.offset(point))
            cost = nuisance.cost(residual)
        return point, nuisance.moved(self.offset(point)), residual

    def _scanned(self, point: ParameterPoint, halvings: Sequence[float] = ()) -> ParameterPoint:
        """A point with each condition's intensity where its own vector is met best, of a few over the record.

        Fog whose echo lies at the threshold is seen by all beams or by none: no derivative leads from one to the other,
        and from a tenth of a visibility away the first step takes the brightness of fog as far off as it may.

        Args:
            point: to begin from.
            halvings: distances to either side of the best of those, in standard deviations, that are tried after them.
        """
        sd = self.intensity_sd()
        best = self.offset(point)[: len(sd)]
        least = self._cost_of_intensities(point, best)
        for place in NUMERICS.intensity_grid_sd:
            best, least = self._better(point, best, least, np.full(len(sd), place))
        for step in halvings:
            middle = best
            for sign in (-1.0, 1.0):
                best, least = self._better(point, best, least, middle + sign * step)
        intensities = {t.condition.id: float(best[k] * sd[k]) for k, t in enumerate(self.measured)}
        return replace(point, log_intensity=intensities)

    def _better(self, point: ParameterPoint, best: Floats, least: Floats, place: Floats) -> tuple[Floats, Floats]:
        """Of each condition the better of two intensities ``(C,)``, in standard deviations, and what it leaves."""
        cost = self._cost_of_intensities(point, place)
        return np.where(cost < least, place, best), np.minimum(cost, least)

    def _cost_of_intensities(self, point: ParameterPoint, place: Floats) -> Floats:
        """``(C,)`` square that each condition's vector leaves at an intensity, with that of the record."""
        sd = self.intensity_sd()
        intensities = {target.condition.id: float(place[k] * sd[k]) for k, target in enumerate(self.measured)}
        mean = self.mean(replace(point, log_intensity=intensities), NUMERICS.screen_frames)
        residuals = [
            self.start.whitened(target.condition.id, target.vector - one)
            for target, one in zip(self.measured, mean, strict=True)
        ]
        found: Floats = (np.stack(residuals) ** 2).sum(1) + place**2
        return found
