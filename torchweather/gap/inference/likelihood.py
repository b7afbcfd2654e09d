"""Simulator likelihood: the simulator at a parameter point, response templates, nuisances, fits in the simulator.

All in whitened space (``simulated_distribution.py``), where a departure of length one is one standard deviation. What
must not be taken for an effect is a nuisance (``systematics.py``), in units of its standard deviations: the error of
the weather record of every condition, what whole frames do (``frame_random_effects.py``), and what the model leaves
open.

References:
    GAP.md 3 (4, 5, 6).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from collections.abc import Set as AbstractSet
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from torchweather.core.threads import side_by_side
from torchweather.gap.inference.config import NUMERICS, SCATTER
from torchweather.gap.inference.effect_forms import (
    catalogue_effect,
    complexity_penalty,
    effect_class,
    stands_at_a_place,
)
from torchweather.gap.inference.frame_density import density_errors, log_density_sd, without_density_errors
from torchweather.gap.inference.kept_frames import KeptFrames
from torchweather.gap.inference.response_templates import ResponseTemplate
from torchweather.gap.inference.simulated_distribution import (
    FrameModel,
    Observation,
    SimulatedDistribution,
    element_noise,
    simulated_distribution,
)
from torchweather.gap.inference.starting_points import ParameterGrid
from torchweather.gap.inference.systematics import BoundedStep, Bounds, Systematics, bounded_step, together
from torchweather.gap.statistics.frame_random_effects import clear_errors, clear_means, frame_departures, model_errors
from torchweather.gap.statistics.frame_statistics import COUNTED, TINY, Pool, Reduced
from torchweather.pipeline.effect import Effect

__all__ = ["Fit", "SimulatorLikelihood", "ParameterPoint"]

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class ParameterPoint:
    """Effects with their parameters, and the nuisances.

    Args:
        values: id of each effect to its parameters.
        log_intensity: condition to the logarithm of the weather's intensity over its record.
        open: name of what the model leaves open to its strength, in standard deviations.
    """

    values: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    log_intensity: Mapping[str, float] = field(default_factory=dict)
    open: Mapping[str, float] = field(default_factory=dict)

    def without(self, name: str) -> ParameterPoint:
        """The same without one effect."""
        return replace(self, values={one: given for one, given in self.values.items() if one != name})


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


class SimulatorLikelihood:
    """One study's conditions against one simulator.

    Args:
        model: simulates and reduces frames.
        measured: the conditions to be explained.
        seed: of everything random.
        pool_frames: simulated frames of each condition.
        max_frames: number of simulated frames from which no further candidate is fitted.
    """

    def __init__(
        self,
        model: FrameModel,
        measured: Sequence[Observation],
        seed: int,
        pool_frames: int = NUMERICS.pool_frames,
        max_frames: int | None = None,
    ) -> None:
        self.model, self.measured, self.seed, self.max_frames = model, list(measured), seed, max_frames
        self.least_frames = max((target.frames for target in measured), default=1)
        self.pool_frames = max(pool_frames, 2 * self.least_frames)
        self.kept = self._nothing_kept()
        self._portioned_frames = 0
        self.open = {k: low for target in self.measured for k, low in model.open(target.condition).items()}
        portions = _portions(self.measured)
        self.noise = element_noise(
            self.pools(ParameterPoint(), NUMERICS.portioned_frames, portions), self.measured, portions
        )
        self.frame_departures = frame_departures(model, self.measured)
        self.clear_means = clear_means(model, self.measured)
        self.start = self.at(ParameterPoint())
        self.origin = ParameterPoint()

    def _nothing_kept(self) -> dict[str, KeptFrames]:
        # Frames of a model in which they depend on each other are those of one number of frames.
        ends = (NUMERICS.screen_frames, NUMERICS.probe_frames, self.pool_frames) if self._frames_are_alone else ()
        most = NUMERICS.kept_frames // max(len(self.measured), 1)
        return {name: KeptFrames(ends, most) for name in self._names}

    @property
    def _frames_are_alone(self) -> bool:
        return bool(getattr(self.model, "each_frame_alone", False))

    @property
    def simulated_frames(self) -> int:
        """Number of frames that were simulated."""
        return self._portioned_frames + sum(one.simulated for one in self.kept.values())

    @property
    def exhausted(self) -> bool:
        """True where as many frames were simulated as the search may simulate."""
        return self.max_frames is not None and self.simulated_frames >= self.max_frames

    def begin(self) -> Fit:
        """Fit the nuisances of the model as it is; the search then starts from there."""
        profiled = self.profile(ParameterPoint())
        self.start, self.origin = profiled.base, profiled.point
        return replace(profiled, misfit=self.misfit(profiled.residual, profiled.nuisance))

    def effects(self, point: ParameterPoint) -> list[Effect]:
        """The stages of a point, in the form in which they are searched for."""
        return [effect_class(self.model, name)(**values) for name, values in point.values.items()]

    def catalogue_effects(self, point: ParameterPoint) -> list[Effect]:
        """The same as the catalogue has them."""
        return [catalogue_effect(effect) for effect in self.effects(point)]

    # ---- the simulator ---------------------------------------------------------------------------------------------

    def seeds(self, condition: int, number: int) -> list[int]:
        """Seeds of the frames of a condition: the same ones whatever the point.

        Modulo the number of clear frames they go round all of those: what the clear frames' own noise makes of a mean
        is then the same for every mean, and that of the measurement's reference.
        """
        generator = np.random.default_rng([self.seed, 7919, condition])
        clear = self.measured[condition].clear_frames
        order = generator.permutation(clear)
        drawn = generator.integers(0, 2**62 // clear, self.pool_frames)
        return [int(value) * clear + int(order[place % clear]) for place, value in enumerate(drawn[:number])]

    def pools(self, point: ParameterPoint, number: int, portions: int = 1) -> dict[str, Pool]:
        """Simulated frames of all conditions, in portions of their elements."""
        effects = self.effects(point)
        found: dict[str, Pool] = {}

        def simulate(place: int, target: Observation) -> None:
            name = target.condition.id
            seeds = self.seeds(place, number)
            log_intensity = point.log_intensity.get(name, 0.0)
            systematics = self.model.systematics(target.condition, point.open)

            def simulated(some: slice) -> Reduced:
                stages = [*effects, *systematics]
                return self.model.simulated(target.condition, stages, log_intensity, seeds[some], portions)

            if portions > 1:
                # Each frame has several rows, which are not looked at by the frame that they started from.
                found[name] = Pool(self.model.layout, simulated(slice(None)))
                return
            values = tuple((effect, *own.items()) for effect, own in point.values.items())
            strengths = tuple(point.open.get(one, 0.0) for one in self.open) if systematics else ()
            alike = None if self._frames_are_alone else number
            reduced = self.kept[name].first((values, log_intensity, strengths, alike), number, simulated)
            found[name] = Pool(self.model.layout, reduced, np.array(seeds) % target.clear_frames)

        side_by_side([partial(simulate, place, target) for place, target in enumerate(self.measured)])
        self._portioned_frames += number * len(self.measured) if portions > 1 else 0
        # In the order of the conditions, whichever thread was done first: random draws follow it.
        return {name: found[name] for name in self._names}

    def at(self, point: ParameterPoint) -> SimulatedDistribution:
        """The distribution of the vectors at a point; whitened as the model without effects is."""
        pools = self.pools(point, self.pool_frames)
        found = simulated_distribution(pools, self.measured, self.noise, getattr(self, "start", None), self.seed)
        unmodelled = {name for effect in point.values for name in effect_class(self.model, effect).unmodelled}
        found = self._loosened(found, unmodelled) if unmodelled else found
        if not self.log_density_sd(point):
            return found
        dense = {name for name in point.values if effect_class(self.model, name).frame_density}
        still = self.at(replace(point, values={one: own for one, own in point.values.items() if one not in dense}))
        errors = dict(zip(self._names, self._density_errors(point), strict=True))
        return without_density_errors(found, still, errors, self.model.layout)

    def log_density_sd(self, point: ParameterPoint) -> float:
        """Standard deviation of the logarithm of the density of the weather from frame to frame."""
        return log_density_sd((effect_class(self.model, name), values) for name, values in point.values.items())

    def _density_errors(self, point: ParameterPoint) -> list[tuple[Floats, Floats]]:
        """Changes ``(P,)`` of each condition's mean vector by what the densities of its few frames are off; none where
        all frames have one."""
        sd = self.log_density_sd(point)
        if not sd:
            return []
        low, middle, high = (self.mean(self._denser(point, off), NUMERICS.screen_frames) for off in (-sd, 0.0, sd))
        return [
            density_errors(target.frames, self.pool_frames, *ends)
            for target, *ends in zip(self.measured, low, middle, high, strict=True)
        ]

    def _denser(self, point: ParameterPoint, log_factor: float) -> ParameterPoint:
        """A point with the intensity of each condition times a factor."""
        return replace(
            point, log_intensity={name: point.log_intensity.get(name, 0.0) + log_factor for name in self._names}
        )

    def _loosened(self, base: SimulatedDistribution, unmodelled: AbstractSet[str]) -> SimulatedDistribution:
        """A distribution that knows to half what effects do to statistics of which their parameters say nothing."""
        open_entries = self.model.layout.each(lambda group: group.statistic in unmodelled)

        def wider(scatter: Mapping[str, Floats]) -> dict[str, Floats]:
            return {
                name: np.hypot(
                    own, SCATTER.unmodelled_share * np.where(open_entries, base.mean[name] - self.start.mean[name], 0.0)
                )
                for name, own in scatter.items()
            }

        return base.with_scatter(wider(base.sd), wider(base.total))

    def mean(self, point: ParameterPoint, frames: int = NUMERICS.probe_frames) -> list[Floats]:
        """Mean vectors at a point, from so many frames of each condition, no fewer than were measured."""
        frames = max(frames, self.least_frames)
        pools = self.pools(point, frames)
        found = []
        for number, target in enumerate(self.measured):
            generator = np.random.default_rng([self.seed, 104729, number])
            n = min(target.frames, frames)
            draws = NUMERICS.probe_draws if n < frames else 1
            index = np.argsort(generator.random((draws, frames)), 1)[:, :n]
            vectors = pools[target.condition.id].vectors(index, target.condition.time_s)
            found.append(vectors.mean(0))
        return found

    def whitened(self, base: SimulatedDistribution, differences: Sequence[Floats]) -> Floats:
        """Differences ``(..., P)`` of vectors, condition by condition, to one whitened vector ``(..., C P)``."""
        parts = [
            base.whitened(target.condition.id, difference)
            for target, difference in zip(self.measured, differences, strict=True)
        ]
        found = self._parted(base, np.stack(parts, -2), -0.5)
        return found.reshape(*found.shape[:-2], -1)

    @property
    def _names(self) -> list[str]:
        return [target.condition.id for target in self.measured]

    @property
    def _together(self) -> list[list[int]]:
        """Places of the conditions of each scene."""
        scenes = [target.condition.scene for target in self.measured]
        return [[k for k, one in enumerate(scenes) if one == scene] for scene in dict.fromkeys(scenes)]

    def _parted(self, base: SimulatedDistribution, values: Floats, power: float) -> Floats:
        """Values ``(..., C, P)`` times a power of ``1 + k k'``; k ``(C,)``, of each entry, is what a scene's share.

        That is the covariance of a scene's conditions, each with noise of its own and all with the clear mean's error:
        to the power -1/2 it makes them independent, to +1/2 undoes that.
        """
        found = values.copy()
        for places in self._together:
            names = [self._names[place] for place in places]
            shared = np.stack([base.shared[name] * base.used[name] for name in names])
            square = np.maximum((shared**2).sum(0), TINY)
            along = (values[..., places, :] * shared).sum(-2) * (((1.0 + square) ** power - 1.0) / square)
            found[..., places, :] += along[..., None, :] * shared
        return found

    def departure(self, base: SimulatedDistribution, mean: Sequence[Floats]) -> Floats:
        """The measured conditions' whitened departure ``(C P,)`` from mean vectors."""
        return self.whitened(base, [target.vector - one for target, one in zip(self.measured, mean, strict=True)])

    def residual(self, base: SimulatedDistribution) -> Floats:
        """The measured conditions' departure ``(C P,)`` from the simulator."""
        return self.departure(base, [base.mean[name] for name in self._names])

    def rewhitened(self, vectors: Floats, old: SimulatedDistribution, new: SimulatedDistribution) -> Floats:
        """Vectors ``(..., C P)`` that were whitened with one scatter, with another.

        What a residual is compared with must be in the units of the residual: of a shift by forty standard deviations
        that nuisances explain, a scatter that is off by a few percent leaves one or two. What did not count is 0.
        """
        old_sd, new_sd = (np.stack([base.sd[name] for name in self._names]) for base in (old, new))
        used = np.stack([new.used[name] for name in self._names])
        shaped = vectors.reshape(*vectors.shape[:-1], len(self._names), -1)
        scaled = old.whitening.undone(self._parted(old, shaped, 0.5))
        whitened = new.whitening(np.where(used, scaled * (old_sd / new_sd), 0.0))
        return self._parted(new, whitened, -0.5).reshape(vectors.shape)

    def nuisance_at(self, nuisance: Systematics, old: SimulatedDistribution, new: SimulatedDistribution) -> Systematics:
        """Nuisances in units of another scatter."""
        response = self.rewhitened(nuisance.response.T, old, new).T
        return Systematics(response, nuisance.offset, nuisance.moving, nuisance.precision, nuisance.behind)

    def templates_at(
        self,
        templates: Sequence[ResponseTemplate],
        base: SimulatedDistribution,
        old: SimulatedDistribution | None = None,
    ) -> list[ResponseTemplate]:
        """Responses in units of one scatter, of the model as it was where ``old`` is left out, in those of another."""
        if not templates:
            return []
        found = self.rewhitened(np.stack([template.response for template in templates]), old or self.start, base)
        return [replace(template, response=response) for template, response in zip(templates, found, strict=True)]

    def null_residuals(self, nuisance: Systematics, number: int, seed: int) -> Floats:
        """Departures ``(R, C P)`` of a measurement without a missing effect: noise of every entry, and the nuisances
        off by random draws.

        The measured frames' own noise is that of drawn simulated frames, tails and all. What else is expected of an
        entry, the errors of the simulated mean and of the clear frames, is that of others of them, as statistics go
        together in it; normal where simulated frames show little of it. So is the noise of elements, of which they show
        no more than their few clear frames.
        """
        generator = np.random.default_rng([seed, 15485863])
        expected = np.concatenate([self.start.expected[name] * self.start.used[name] for name in self._names])
        elements = self.model.layout.by_elements
        drawn = [np.where(elements, 0.0, self.start.draws[name] - self.start.mean[name]) for name in self._names]
        rows = [generator.integers(len(one), size=number) for one in drawn]
        own = self.whitened(self.start, [one[row] for one, row in zip(drawn, rows, strict=True)])
        shown = own.var(0)
        lacking = np.maximum(expected - shown, 0.0)
        alike = lacking < SCATTER.lacking_over_shown * shown
        another = own[generator.permutation(number)] / np.sqrt(np.where(alike, shown, 1.0))
        noise = own + np.sqrt(lacking) * np.where(alike, another, generator.normal(size=own.shape))
        found: Floats = noise + nuisance.drawn(generator, number)
        return found

    # ---- nuisances -------------------------------------------------------------------------------------------------

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

    # ---- responses and fits ----------------------------------------------------------------------------------------

    def templates(
        self, points: Sequence[tuple[ParameterGrid, int]], point: ParameterPoint, base: SimulatedDistribution
    ) -> list[ResponseTemplate]:
        """Response templates of points, each given by its grid and its place there, on top of a point."""
        before = self.mean(point, NUMERICS.screen_frames)
        found = []
        for grid, number in points:
            values = grid.points[number]
            tried = replace(point, values={**point.values, grid.effect.id: values})
            after = self.mean(tried, NUMERICS.screen_frames)
            change = [new - old for new, old in zip(after, before, strict=True)]
            found.append(ResponseTemplate(grid, number, values, self.whitened(base, change)))
        return found

    def fit(
        self,
        start: ParameterPoint,
        nuisance: Systematics,
        base: SimulatedDistribution,
        iterations: int = NUMERICS.max_iterations,
    ) -> Fit:
        """Parameters and nuisances that explain the measured conditions best, by Gauss-Newton in the simulator.

        Args:
            start: point to start from.
            nuisance: responses to the nuisances; renewed where no step helps any more.
            base: scatter that the steps are weighed with; the final misfit has that of the fitted point.
            iterations: at most; a step that does not help is shortened.
        """
        names = self._fitted_names(start)
        point = start
        mean = self.mean(point)
        here = self._nuisance_at(point, nuisance, base)
        residual = self.departure(base, mean)
        cost = here.cost(residual)
        begun = self.misfit(residual, here)
        covariance: Floats = np.zeros((len(names), len(names)))
        renewed = False
        for _ in range(iterations):
            best, covariance = self._step(point, names, residual, here, base)
            found = self._along(point, names, best, cost, base, here)
            gained = 0.0
            if found is not None:
                gained = cost - found[0]
                cost, point, mean = found
                residual, here = self.departure(base, mean), here.moved(self.offset(point))
            stalled = NUMERICS.stalled_chi2 + NUMERICS.stalled_share * cost
            if gained < stalled:
                if renewed:
                    break
                # The nuisances may do something else here than where the search began.
                here, renewed = self._renewed(here, point, base), True
                cost = here.cost(residual)
            elif gained > 10.0 * stalled:
                renewed = False
        end = self._fit_at(point, here, base, covariance, names)
        if end.misfit <= begun or point == start:
            return end
        # The scatter of where a step leads to is not known on the way: no fit ends worse than where it began.
        beginning = self._fit_at(start, nuisance, base, covariance, names)
        return min(end, beginning, key=lambda one: one.misfit)

    def promised(self, fit: Fit) -> float:
        """Misfit that a fit from here would leave if the simulator were linear as far as the bounds of parameters."""
        names = self._fitted_names(fit.point)
        step, _ = self._step(fit.point, names, fit.residual, fit.nuisance, fit.base, math.inf)
        return fit.misfit - max(self.misfit(fit.residual, fit.nuisance) - step.misfit, 0.0)

    def _fitted_names(self, point: ParameterPoint) -> list[tuple[str, str]]:
        """(Effect, parameter) of all that a fit moves."""
        return [
            (effect, parameter.name)
            for effect, values in point.values.items()
            for parameter in effect_class(self.model, effect).arguments
            if math.isfinite(values[parameter.name])
        ]

    def _step(
        self,
        point: ParameterPoint,
        names: Sequence[tuple[str, str]],
        residual: Floats,
        nuisance: Systematics,
        base: SimulatedDistribution,
        sizes: float = 2.0,
    ) -> tuple[BoundedStep, Floats]:
        """Step of Gauss and Newton from a point, and the covariance ``(K, K)`` of its parameters.

        No parameter is moved by more than so many typical ``sizes`` of it.
        """
        near = self.mean(point, NUMERICS.screen_frames)
        jacobian = np.stack([self._derivative(point, name, near, base) for name in names], 1)
        normal = jacobian.T @ nuisance(jacobian.T).T
        ridge = 1e-3 * np.diag(np.diag(normal)) + 1e-9 * np.eye(len(names))
        step = self._bounded(residual, nuisance, jacobian, self._limits(point, names, sizes), np.sqrt(np.diag(ridge)))
        covariance = np.asarray(np.linalg.pinv(normal + 1e-9 * np.eye(len(names))), dtype=np.float64)
        return step, covariance

    def _fit_at(
        self,
        point: ParameterPoint,
        nuisance: Systematics,
        base: SimulatedDistribution,
        covariance: Floats,
        names: Sequence[tuple[str, str]],
    ) -> Fit:
        """Value of a fit that ends at a point, with the scatter there; ``nuisance`` is in units of ``base``."""
        final = self.at(point)
        residual = self.residual(final)
        here = self.nuisance_at(self._nuisance_at(point, nuisance, base), base, final)
        misfit = self.misfit(residual, here) + self._wider(final)
        misfit += sum(complexity_penalty(self.model, name) for name in point.values)
        return Fit(point, final, residual, here, misfit, covariance, tuple(names))

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

    def _limits(self, point: ParameterPoint, names: Sequence[tuple[str, str]], sizes: float = 2.0) -> Bounds:
        """Changes that parameters may make at once: within their bounds, at most so many typical sizes.

        The azimuth of what stands somewhere stays: the vector does not tell in which part of a bin it is, the map did
        (``location_search.py``).
        """
        declared = [
            next(one for one in effect_class(self.model, effect).arguments if one.name == parameter)
            for effect, parameter in names
        ]
        values = np.array([point.values[effect][parameter] for effect, parameter in names])
        stays = [
            parameter == "azimuth_rad" and stands_at_a_place(effect_class(self.model, effect))
            for effect, parameter in names
        ]
        farthest = np.where(stays, 0.0, sizes * np.array([one.scale for one in declared]))
        low, high = (np.array([getattr(one, end) for one in declared]) - values for end in ("low", "high"))
        return Bounds(np.minimum(np.maximum(low, -farthest), 0.0), np.maximum(np.minimum(high, farthest), 0.0))

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

        Of counts up to that of counting, which is all that the first few of what there was nothing of before bring.
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

    def _derivative(
        self, point: ParameterPoint, name: tuple[str, str], mean: Sequence[Floats], base: SimulatedDistribution
    ) -> Floats:
        """Whitened change per unit of a parameter, by a step away from the nearer bound."""
        effect, parameter = name
        declared = next(one for one in effect_class(self.model, effect).arguments if one.name == parameter)
        value = point.values[effect][parameter]
        step = NUMERICS.derivative_step * (
            max(abs(value), 1e-3) if math.isinf(declared.identity or 0.0) else declared.scale
        )
        if declared.identity is not None and math.isfinite(declared.identity):
            # Counts go as the root of a probability: a step far beyond a weak one has another slope.
            step = min(
                step,
                max(
                    NUMERICS.weak_step_share * abs(value - declared.identity),
                    NUMERICS.least_step_share * declared.scale,
                ),
            )
        if parameter in ("azimuth_rad", "width_rad"):  # finer than the sector itself
            step = max(0.25 * point.values[effect].get("width_rad", 0.0), NUMERICS.angle_step_rad)
        step = min(step, 0.25 * (declared.high - declared.low))
        if value + step > declared.high:
            step = -step
        values = {**point.values, effect: {**point.values[effect], parameter: value + step}}
        after = self.mean(replace(point, values=values), NUMERICS.screen_frames)
        return self.whitened(base, [(new - old) / step for new, old in zip(after, mean, strict=True)])

    def _moved(self, point: ParameterPoint, names: Sequence[tuple[str, str]], step: Floats) -> ParameterPoint:
        values = {effect: dict(given) for effect, given in point.values.items()}
        for (effect, parameter), change in zip(names, step, strict=True):
            declared = next(one for one in effect_class(self.model, effect).arguments if one.name == parameter)
            # Not further than twice the typical size at once.
            limited = float(np.clip(change, -2.0 * declared.scale, 2.0 * declared.scale))
            moved = values[effect][parameter] + limited
            values[effect][parameter] = float(np.clip(moved, declared.low, declared.high))
        return replace(point, values=values)


def _portions(measured: Sequence[Observation]) -> int:
    """Portions of a frame: the more the fewer clear frames there are, each of which shows its noise but once."""
    clear = min((target.clear_frames for target in measured), default=NUMERICS.portioned_frames)
    return math.ceil(NUMERICS.portions * max(NUMERICS.portioned_frames / max(clear, 1), 1.0))
