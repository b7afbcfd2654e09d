"""Likelihood of a study's conditions: response templates, and fits of effects beside the nuisances.

Minus twice its logarithm, but for a constant, is the misfit: the square of the whitened departure that nuisances leave,
their prior, and the logarithm of the scatter. Effects are fitted in the simulator by Gauss-Newton.

References:
    GAP.md 3 (4, 5, 6).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from torchweather.gap.inference.config import NUMERICS
from torchweather.gap.inference.effect_forms import complexity_penalty, effect_class, stands_at_a_place
from torchweather.gap.inference.profiled_conditions import Fit, ProfiledConditions
from torchweather.gap.inference.response_templates import ResponseTemplate
from torchweather.gap.inference.simulated_conditions import ParameterPoint
from torchweather.gap.inference.simulated_distribution import SimulatedDistribution
from torchweather.gap.inference.starting_points import ParameterGrid
from torchweather.gap.inference.systematics import BoundedStep, Bounds, Systematics

__all__ = ["SimulatorLikelihood"]

Floats = NDArray[np.float64]


class SimulatorLikelihood(ProfiledConditions):
    """One study's conditions against a simulator in which effects are fitted; arguments of ``SimulatedConditions``."""

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
        if point == start:
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
        """Effect and name of every parameter that a fit moves."""
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
