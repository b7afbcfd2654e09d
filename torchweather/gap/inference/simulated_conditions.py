"""The simulator at a parameter point: frames of all measured conditions, their mean vectors and their distribution.

All departures are in whitened space (``simulated_distribution.py``), where a length of one is one standard deviation.

References:
    GAP.md 3 (2, 4).
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
from torchweather.gap.inference.effect_forms import catalogue_effect, effect_class
from torchweather.gap.inference.frame_density import density_errors, log_density_sd, without_density_errors
from torchweather.gap.inference.kept_frames import KeptFrames
from torchweather.gap.inference.simulated_distribution import (
    FrameModel,
    Observation,
    SimulatedDistribution,
    element_noise,
    simulated_distribution,
)
from torchweather.gap.inference.systematics import Systematics
from torchweather.gap.statistics.frame_statistics import TINY, Pool, Reduced
from torchweather.pipeline.effect import Effect

__all__ = ["ParameterPoint", "SimulatedConditions"]

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


class SimulatedConditions:
    """One study's measured conditions, simulated at parameter points: frames, mean vectors, distributions, whitening.

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

    def effects(self, point: ParameterPoint) -> list[Effect]:
        """The stages of a point, in the form in which they are searched for."""
        return [effect_class(self.model, name)(**values) for name, values in point.values.items()]

    def catalogue_effects(self, point: ParameterPoint) -> list[Effect]:
        """The same as the catalogue has them."""
        return [catalogue_effect(effect) for effect in self.effects(point)]

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


def _portions(measured: Sequence[Observation]) -> int:
    """Portions of a frame: the more the fewer clear frames there are, each of which shows its noise but once."""
    clear = min((target.clear_frames for target in measured), default=NUMERICS.portioned_frames)
    return math.ceil(NUMERICS.portions * max(NUMERICS.portioned_frames / max(clear, 1), 1.0))
