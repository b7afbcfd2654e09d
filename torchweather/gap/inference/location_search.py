"""Where an effect with a place is: a step in azimuth has no derivative until a sector overlaps it.

A thing that stands in the scene is first tried where the maps of all measured frames have returns that the simulation
lacks; a sector is then moved and resized by steps that are halved, until no step helps.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from torchweather.gap.inference.config import METHOD
from torchweather.gap.inference.effect_forms import effect_class
from torchweather.gap.inference.likelihood import Fit, ParameterPoint, SimulatorLikelihood
from torchweather.gap.inference.starting_points import ParameterGrid
from torchweather.pipeline.effect import Effect

__all__ = ["located", "standing_grids"]

HALVINGS, PASSES = 5, 2
ANSCOMBE = 3.0 / 8.0


def standing_grids(
    search: SimulatorLikelihood, effects: Sequence[type[Effect]], point: ParameterPoint
) -> list[ParameterGrid]:
    """Points of effects with an azimuth, a range and a width, at the cell of the map where the simulation lacks most
    returns."""
    fitting = [one for one in effects if {"azimuth_rad", "range_m", "width_rad"} <= {p.name for p in one.arguments}]
    if not fitting:
        return []
    cells = search.model.map_cells
    total = np.zeros(len(cells))
    pools = search.pools(point, METHOD.location_frames)
    for target in search.measured:
        # The least of all frames: what stands is in each of them.
        measured = search.model.measured(target.condition).maps[:, 0].min(0)
        simulated = pools[target.condition.id].frames.maps[:, 0].mean(0)
        total += np.sqrt(measured + ANSCOMBE) - np.sqrt(simulated + ANSCOMBE)
    azimuth_rad, range_m = cells[int(total.argmax())]
    return [
        ParameterGrid(one, ({"azimuth_rad": azimuth_rad, "range_m": range_m * share, "width_rad": width},))
        for one in fitting
        for width in METHOD.location_widths_rad
        for share in METHOD.location_range_shares
    ]


def located(search: SimulatorLikelihood, point: ParameterPoint, name: str, base: Fit) -> ParameterPoint:
    """A point with one of its effects better placed, if that effect has a place.

    Args:
        search: its simulator.
        point: to start from.
        name: id of the effect.
        base: the model as it is.
    """
    if "azimuth_rad" not in point.values[name]:
        return point
    bounds = {one.name: (one.low, one.high) for one in effect_class(search.model, name).arguments}
    width = point.values[name].get("width_rad", METHOD.location_widths_rad[-1])
    steps = {one: width if one == "azimuth_rad" else 0.5 * abs(point.values[name][one]) for one in bounds}

    def cost(tried: ParameterPoint) -> float:
        here = base.nuisance.moved(search.offset(tried))
        return search.misfit(search.departure(base.base, search.mean(tried, METHOD.location_frames)), here)

    best = cost(point)
    for _ in range(HALVINGS):
        for _ in range(PASSES):
            before = best
            for parameter, step in steps.items():
                low, high = bounds[parameter]
                beside = []
                # Both ways: a step to where nothing stands may help less than the step to the other side.
                for sign in (1.0, -1.0):
                    value = point.values[name][parameter] + sign * step
                    if parameter == "azimuth_rad":
                        value = math.remainder(value, 2.0 * math.pi)
                    moved = {**point.values[name], parameter: min(max(value, low), high)}
                    tried = replace(point, values={**point.values, name: moved})
                    beside.append((cost(tried), tried))
                found, tried = min(beside, key=lambda one: one[0])
                if found < best:
                    point, best = tried, found
            if best == before:
                break
        steps = {parameter: 0.5 * step for parameter, step in steps.items()}
    return point
