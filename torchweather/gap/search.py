"""The search for missing effects: response curves, screening of singles and pairs, refits in the simulator.

All in whitened space (``baseline.py``), where a departure of length one is one standard deviation. The weather record's
error is a nuisance: for every condition the response to its knob is projected out, as far as its stated uncertainty
allows, and so is the error of the mean of the clear frames, which all conditions of a scene share:

    M = 1 - G (G'G + 1)^-1 G'   (G in units of its standard deviations),

so that ``x' M y`` is the inner product that is left.

References:
    GAP.md 3 (4, 5, 6). A matched filter for each distorted simulator: Anau Montel, Alvey & Weniger 2025.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial

import numpy as np
from numpy.typing import NDArray

from torchweather.gap.baseline import (
    PORTIONED_FRAMES,
    PORTIONS,
    Baseline,
    FrameModel,
    Target,
    baseline,
    element_noise,
)
from torchweather.gap.candidates import Line
from torchweather.gap.statistics import Pool
from torchweather.stages.effects import EFFECTS, Effect
from torchweather.threads import side_by_side

__all__ = ["Fit", "Node", "Nuisance", "Search", "Setting"]

Floats = NDArray[np.float64]

POOL_FRAMES = 48  # of each condition, for the scatter
SCREEN_FRAMES = 8  # of each condition, for a response in the screening; the first of the pool
PROBE_FRAMES = 16  # of each condition, for a derivative
PROBE_DRAWS = 32
AMPLITUDES = (0.0, 1.35)  # by which a response is scaled between settings
LEAST_KNOB_STEP = 0.03
STEP = 0.2  # of a derivative, over the parameter's typical size
ITERATIONS = 4


@dataclass(frozen=True)
class Setting:
    """Effects with their parameters.

    Args:
        values: id of each effect to its parameters.
        log_knob: condition to the logarithm of the weather's knob over its record.
    """

    values: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    log_knob: Mapping[str, float] = field(default_factory=dict)

    def effects(self) -> list[Effect]:
        """The stages."""
        return [EFFECTS[name](**values) for name, values in self.values.items()]


@dataclass(frozen=True)
class Node:
    """Response to one setting of one effect.

    Args:
        line: it belongs to.
        number: place in the line.
        values: the parameters.
        response: ``(C P,)`` whitened change of all vectors.
    """

    line: Line
    number: int
    values: Mapping[str, float]
    response: Floats

    @property
    def id(self) -> str:
        """Of the effect."""
        return self.line.effect.id


class Nuisance:
    """The projection that forgets what is not the model's fault: errors of the weather record and of the clear mean.

    Args:
        response: ``(C P, K)`` whitened change per standard deviation of each.
        knobs: ``(C,)`` standard deviation of the logarithm of each condition's knob; the first C columns are theirs.
    """

    def __init__(self, response: Floats, knobs: Floats) -> None:
        self.response, self.knobs = response, knobs
        normal = response.T @ response + np.eye(response.shape[1])
        self._solved = np.linalg.solve(normal, response.T)  # (K, C P)

    def __call__(self, vectors: Floats) -> Floats:
        """``M x`` of vectors ``(..., C P)``."""
        found: Floats = vectors - (vectors @ self._solved.T) @ self.response.T
        return found

    def log_knobs(self, vector: Floats) -> Floats:
        """``(C,)`` logarithms of the knobs over their records that explain a residual best, their prior counted."""
        found: Floats = (self._solved @ vector)[: len(self.knobs)] * self.knobs
        return found


@dataclass(frozen=True)
class Fit:
    """A setting, fitted in the simulator.

    Args:
        setting: effects, parameters, knobs.
        base: the simulator there.
        misfit: of the measured conditions, squared and summed, with the prior of the knobs.
        covariance: ``(K, K)`` of the parameters, least squares, in the order of ``names``.
        names: (effect, parameter) of each.
    """

    setting: Setting
    base: Baseline
    misfit: float
    covariance: Floats
    names: tuple[tuple[str, str], ...]


class Search:
    """One study's conditions against one simulator.

    Args:
        model: simulates and reduces frames.
        measured: the conditions to be explained.
        seed: of everything random.
        pool_frames: simulated frames of each condition.
    """

    def __init__(
        self, model: FrameModel, measured: Sequence[Target], seed: int, pool_frames: int = POOL_FRAMES
    ) -> None:
        self.model, self.measured, self.seed, self.pool_frames = model, list(measured), seed, pool_frames
        self.simulated_frames = 0
        self.noise = element_noise(self.pools(Setting(), PORTIONED_FRAMES, PORTIONS), self.measured)
        self.start = self.at(Setting())
        self.origin = Setting()

    def settle(self) -> float:
        """Fit the knobs of the model as it is; the search then starts from there. The misfit that is left."""
        settled = self.knob_fit(Setting())
        self.start, self.origin = settled.base, settled.setting
        return settled.misfit

    # ---- the simulator ---------------------------------------------------------------------------------------------

    def seeds(self, condition: int, number: int) -> list[int]:
        """Seeds of the frames of a condition: the same ones whatever the setting."""
        generator = np.random.default_rng([self.seed, 7919, condition])
        return [int(value) for value in generator.integers(0, 2**62, self.pool_frames)[:number]]

    def pools(
        self, setting: Setting, number: int, portions: int = 1, more: Mapping[str, Effect] | None = None
    ) -> dict[str, Pool]:
        """Simulated frames of all conditions, in portions of their elements; with one more stage in some conditions."""
        effects, more = setting.effects(), more or {}
        found: dict[str, Pool] = {}

        def simulate(place: int, target: Target) -> None:
            name = target.condition.id
            seeds = self.seeds(place, number)
            log_knob = setting.log_knob.get(name, 0.0)
            own = [*effects, more[name]] if name in more else effects
            reduced = self.model.simulated(target.condition, own, log_knob, seeds, portions)
            found[name] = Pool(self.model.layout, reduced)

        side_by_side([partial(simulate, place, target) for place, target in enumerate(self.measured)])
        self.simulated_frames += number * len(self.measured)
        return found

    def at(self, setting: Setting) -> Baseline:
        """The distribution of the vectors at a setting; whitened as the model without effects is."""
        pools = self.pools(setting, self.pool_frames)
        whitening = self.start.whitening if hasattr(self, "start") else None
        return baseline(pools, self.measured, self.noise, whitening, self.seed)

    def mean(
        self, setting: Setting, frames: int = PROBE_FRAMES, more: Mapping[str, Effect] | None = None
    ) -> list[Floats]:
        """Mean vectors at a setting, from so many frames of each condition; ``more`` as in ``pools``."""
        pools = self.pools(setting, frames, more=more)
        found = []
        for number, target in enumerate(self.measured):
            generator = np.random.default_rng([self.seed, 104729, number])
            n = min(target.frames, frames)
            draws = PROBE_DRAWS if n < frames else 1
            index = np.argsort(generator.random((draws, frames)), 1)[:, :n]
            vectors = pools[target.condition.id].vectors(index, target.condition.time_s)
            found.append(vectors.mean(0))
        return found

    def whitened(self, base: Baseline, differences: Sequence[Floats]) -> Floats:
        """Differences of vectors, condition by condition, to one whitened vector ``(C P,)``."""
        parts = [
            base.whitened(target.condition.id, difference)
            for target, difference in zip(self.measured, differences, strict=True)
        ]
        return np.concatenate(parts)

    def residual(self, base: Baseline) -> Floats:
        """The measured conditions' departure ``(C P,)``."""
        return np.concatenate([base.residual(target) for target in self.measured])

    def null_residuals(self, nuisance: Nuisance, number: int, seed: int) -> Floats:
        """Departures ``(R, C P)`` of a measurement without a missing effect: noise of every entry, and the record and
        the clear mean off by random draws."""
        generator = np.random.default_rng([seed, 15485863])
        counted = np.concatenate([self.start.used[target.condition.id] for target in self.measured])
        noise = generator.normal(size=(number, len(counted))) * counted
        off = generator.normal(size=(number, nuisance.response.shape[1]))
        found: Floats = noise + off @ nuisance.response.T
        return found

    # ---- responses -------------------------------------------------------------------------------------------------

    def knob_sd(self) -> Floats:
        """Stated uncertainty of the weather of each condition."""
        return np.array([target.knob_sd for target in self.measured])

    def nuisance(self, setting: Setting, base: Baseline) -> Nuisance:
        """Response to the knobs at a setting, by a difference of either side."""
        sd = self.knob_sd()
        steps = np.maximum(sd, LEAST_KNOB_STEP)
        ends = []
        for sign in (1.0, -1.0):
            log_knob = {
                target.condition.id: setting.log_knob.get(target.condition.id, 0.0) + sign * step
                for target, step in zip(self.measured, steps, strict=True)
            }
            ends.append(self.mean(Setting(setting.values, log_knob)))
        size = self.model.layout.size
        columns = []
        for number, (high, low, step) in enumerate(zip(*ends, steps, strict=True)):
            name = self.measured[number].condition.id
            column = np.zeros((len(self.measured), size))
            column[number] = base.whitened(name, (high - low) * (sd[number] / (2.0 * step)))
            columns.append(column.ravel())
        columns += self._clear_errors(base)
        columns += self._open_questions(setting, base)
        return Nuisance(np.stack(columns, 1), sd)

    def _open_questions(self, setting: Setting, base: Baseline) -> list[Floats]:
        """Columns of what the model leaves open, the same in all conditions."""
        each = {target.condition.id: self.model.nuisances(target.condition) for target in self.measured}
        names = dict.fromkeys(name for stages in each.values() for name in stages)
        before = self.mean(setting) if names else []
        columns = []
        for name in names:
            more = {condition: stages[name] for condition, stages in each.items() if name in stages}
            after = self.mean(setting, more=more)
            columns.append(self.whitened(base, [new - old for new, old in zip(after, before, strict=True)]))
        return columns

    def _clear_errors(self, base: Baseline) -> list[Floats]:
        """Columns of the error of each scene's clear mean: it moves means and spreads of all its conditions alike."""
        layout = self.model.layout
        moved = np.concatenate([np.full(group.bins, group.kind in ("mean", "spread")) for group in layout.groups])
        columns = []
        for scene in dict.fromkeys(target.condition.scene for target in self.measured):
            pool = Pool(layout, self.model.clear(scene))
            number = len(pool)
            if number < 2:
                continue
            each = pool.vectors(np.arange(number)[:, None])
            # From departures from the mean of the others to the scatter of the mean of all.
            apart = (each - each.mean(0)) * math.sqrt((number - 1) / number**3)
            for departure in apart:
                column = [
                    base.whitened(target.condition.id, np.where(moved, departure, 0.0))
                    if target.condition.scene == scene
                    else np.zeros(layout.size)
                    for target in self.measured
                ]
                columns.append(np.concatenate(column))
        return columns

    def nodes(self, lines: Sequence[Line], setting: Setting, base: Baseline) -> list[Node]:
        """Responses along lines of settings, on top of a setting."""
        before = self.mean(setting, SCREEN_FRAMES)
        found = []
        for line in lines:
            for number, values in enumerate(line.settings):
                tried = Setting({**setting.values, line.effect.id: values}, setting.log_knob)
                after = self.mean(tried, SCREEN_FRAMES)
                change = [new - old for new, old in zip(after, before, strict=True)]
                found.append(Node(line, number, values, self.whitened(base, change)))
        return found

    # ---- fits ------------------------------------------------------------------------------------------------------

    def fit(self, start: Setting, iterations: int = ITERATIONS) -> Fit:
        """Parameters and knobs that explain the measured conditions best, by Gauss-Newton in the simulator.

        The steps are weighed with the scatter of the start, the final misfit with that of the fitted setting. A step
        that does not help is shortened.
        """
        names = [
            (effect, parameter.name)
            for effect, values in start.values.items()
            for parameter in EFFECTS[effect].arguments
            if math.isfinite(values[parameter.name])
            and not (parameter.identity is not None and values[parameter.name] == parameter.identity)
        ]
        setting = start
        base = self.start
        mean = self.mean(setting)
        nuisance = self.nuisance(setting, base)
        misfit, left = self._misfit(mean, base, nuisance, setting)
        covariance: Floats = np.zeros((len(names), len(names)))
        for _ in range(iterations):
            jacobian = np.stack([self._derivative(setting, name, mean, base) for name in names], 1)
            projected = nuisance(jacobian.T).T
            normal = jacobian.T @ projected
            ridge = 1e-3 * np.diag(np.diag(normal)) + 1e-9 * np.eye(len(names))
            step: Floats = np.asarray(np.linalg.solve(normal + ridge, projected.T @ left), dtype=np.float64)
            covariance = np.asarray(np.linalg.pinv(normal + 1e-9 * np.eye(len(names))), dtype=np.float64)
            improved = False
            for share in (1.0, 0.4, 0.15):
                trial = self._moved(setting, names, share * step)
                knobs = nuisance.log_knobs(left - jacobian @ (share * step))
                trial = Setting(trial.values, self._knobs(setting, knobs))
                after = self.mean(trial)
                found, rest = self._misfit(after, base, nuisance, trial)
                if found < misfit - 1e-6:
                    gained = misfit - found
                    setting, mean, misfit, left = trial, after, found, rest
                    improved = True
                    break
            if not improved or gained < 0.5:
                break
        final = self.at(setting)
        _, prior = self._off(setting)
        whitened = self.residual(final)
        misfit = float(whitened @ self.nuisance(setting, final)(whitened)) + prior
        return Fit(setting, final, misfit, covariance, tuple(names))

    def knob_fit(self, setting: Setting, rounds: int = 2) -> Fit:
        """The knobs alone, fitted at a setting of effects; the misfit is without what the nuisance still explains."""
        for _ in range(rounds):
            base = self.at(setting)
            nuisance = self.nuisance(setting, base)
            more = nuisance.log_knobs(self.residual(base))
            setting = Setting(setting.values, self._knobs(setting, more))
            if np.abs(more).max(initial=0.0) < 0.01:
                break
        base = self.at(setting)
        residual = self.residual(base)
        return Fit(setting, base, float(residual @ nuisance(residual)), np.zeros((0, 0)), ())

    def _off(self, setting: Setting) -> tuple[Floats, float]:
        """The knobs' departures from the record, and their share of the misfit."""
        off = np.array([setting.log_knob.get(target.condition.id, 0.0) for target in self.measured])
        sd = self.knob_sd()
        return off, float(((off[sd > 0] / sd[sd > 0]) ** 2).sum())

    def _misfit(
        self, mean: Sequence[Floats], base: Baseline, nuisance: Nuisance, setting: Setting
    ) -> tuple[float, Floats]:
        """Squared residual with the knobs' prior, and the residual ``(C P,)``."""
        left = self.whitened(base, [t.vector - m for t, m in zip(self.measured, mean, strict=True)])
        _, prior = self._off(setting)
        return float(left @ nuisance(left)) + prior, left

    def _knobs(self, setting: Setting, more: Floats) -> dict[str, float]:
        sd = self.knob_sd()
        found = {}
        for number, target in enumerate(self.measured):
            name = target.condition.id
            limit = 4.0 * sd[number]
            found[name] = float(np.clip(setting.log_knob.get(name, 0.0) + more[number], -limit, limit))
        return found

    def _derivative(self, setting: Setting, name: tuple[str, str], mean: Sequence[Floats], base: Baseline) -> Floats:
        """Whitened change per unit of a parameter, by a step away from the nearer bound."""
        effect, parameter = name
        declared = next(one for one in EFFECTS[effect].arguments if one.name == parameter)
        value = setting.values[effect][parameter]
        step = STEP * declared.scale * (max(abs(value), 1.0) if math.isinf(declared.identity or 0.0) else 1.0)
        step = min(step, 0.25 * (declared.high - declared.low))
        if value + step > declared.high:
            step = -step
        values = {**setting.values, effect: {**setting.values[effect], parameter: value + step}}
        after = self.mean(Setting(values, setting.log_knob))
        return self.whitened(base, [(new - old) / step for new, old in zip(after, mean, strict=True)])

    def _moved(self, setting: Setting, names: Sequence[tuple[str, str]], step: Floats) -> Setting:
        values = {effect: dict(given) for effect, given in setting.values.items()}
        for (effect, parameter), change in zip(names, step, strict=True):
            declared = next(one for one in EFFECTS[effect].arguments if one.name == parameter)
            # Not further than twice the typical size at once.
            limited = float(np.clip(change, -2.0 * declared.scale, 2.0 * declared.scale))
            moved = values[effect][parameter] + limited
            values[effect][parameter] = float(np.clip(moved, declared.low, declared.high))
        return Setting(values, setting.log_knob)


def gains(nodes: Sequence[Node], residuals: Floats, nuisance: Nuisance) -> Floats:
    """By how much each node, scaled, lowers the squared residuals ``(R, C P)``: ``(R, nodes)``."""
    responses = np.stack([node.response for node in nodes])
    projected = nuisance(responses)
    norm = (responses * projected).sum(1)
    along = residuals @ projected.T
    amplitude = np.clip(along / np.maximum(norm, 1e-12), *AMPLITUDES)
    found: Floats = 2.0 * amplitude * along - amplitude**2 * norm
    return found
