"""Where an effect with a place is: a step in azimuth has no derivative until a sector overlaps it.

A thing that stands in the scene is first tried where the maps of all measured frames have returns that the simulation
lacks; a sector is then moved and resized by steps that are halved, until no step helps. Of what stands somewhere the
map of returns counts beside the vector of statistics, whose bins in azimuth are four times as wide as the map's cells:
within one of them a narrow structure may stand anywhere.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from torchweather.gap.inference.config import NUMERICS
from torchweather.gap.inference.effect_forms import effect_class, stands_at_a_place
from torchweather.gap.inference.likelihood import SimulatorLikelihood
from torchweather.gap.inference.profiled_conditions import Fit
from torchweather.gap.inference.simulated_conditions import ParameterPoint
from torchweather.gap.inference.starting_points import ParameterGrid
from torchweather.pipeline.effect import Effect

__all__ = ["located", "standing_grids"]

Floats = NDArray[np.float64]

ANSCOMBE = 3.0 / 8.0


def standing_grids(
    search: SimulatorLikelihood, effects: Sequence[type[Effect]], point: ParameterPoint
) -> list[ParameterGrid]:
    """Points of effects with an azimuth, a range and a width, at the cell of the map where the simulation lacks most
    returns."""
    fitting = [one for one in effects if stands_at_a_place(one)]
    if not fitting:
        return []
    cells = search.model.map_cells
    total = np.zeros(len(cells))
    pools = search.pools(point, NUMERICS.location_frames)
    for target in search.measured:
        # The least of all frames: what stands is in each of them.
        measured = search.model.measured(target.condition).maps[:, 0].min(0)
        simulated = pools[target.condition.id].frames.maps[:, 0].mean(0)
        total += np.sqrt(measured + ANSCOMBE) - np.sqrt(simulated + ANSCOMBE)
    azimuth_rad, range_m = cells[int(total.argmax())]
    widths, shares = NUMERICS.location_widths_rad, NUMERICS.location_range_shares
    # A cell is wider than a thin thing: some models can say from the measured frames where in it that stands.
    standing = getattr(search.model, "standing", None)
    place = None if standing is None else standing(azimuth_rad, range_m)
    if place is not None:
        azimuth_rad, range_m, width_rad = place
        widths, shares = (width_rad,), (1.0,)
    return [
        ParameterGrid(one, ({"azimuth_rad": azimuth_rad, "range_m": range_m * share, "width_rad": width},))
        for one in fitting
        for width in widths
        for share in shares
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
    arguments = effect_class(search.model, name).arguments
    bounds = {one.name: (one.low, one.high) for one in arguments}
    width = point.values[name].get("width_rad", NUMERICS.location_widths_rad[-1])
    steps = {one: width if one == "azimuth_rad" else 0.5 * abs(point.values[name][one]) for one in bounds}
    stands = stands_at_a_place(effect_class(search.model, name))
    conditions = [one.condition for one in search.measured] if stands else []
    seen = {one.id: search.model.measured(one).maps[:, 0].mean(0) for one in conditions}

    def cost(tried: ParameterPoint) -> float:
        here = base.nuisance.moved(search.offset(tried))
        misfit = search.misfit(search.departure(base.base, search.mean(tried, NUMERICS.location_frames)), here)
        return misfit + _misfit_of_maps(search, tried, seen)

    def moved(by: Mapping[str, float]) -> ParameterPoint:
        values = {one: value + by.get(one, 0.0) for one, value in point.values[name].items()}
        values["azimuth_rad"] = math.remainder(values["azimuth_rad"], 2.0 * math.pi)
        values = {one: min(max(value, bounds[one][0]), bounds[one][1]) for one, value in values.items()}
        return replace(point, values={**point.values, name: values})

    best = cost(point)
    for _ in range(NUMERICS.location_halvings + NUMERICS.standing_halvings * stands):
        for _ in range(NUMERICS.location_passes):
            before = best
            for ways in _ways(steps, with_edges=stands):
                # All ways: a step to where nothing stands may help less than the step to the other side.
                found, tried = min(((cost(one), one) for one in map(moved, ways)), key=lambda one: one[0])
                if found < best:
                    point, best = tried, found
            if best == before:
                break
        steps = {parameter: 0.5 * step for parameter, step in steps.items()}
    return point


def _ways(steps: Mapping[str, float], with_edges: bool) -> list[list[dict[str, float]]]:
    """Changes of which the best is taken, one list after another: of each parameter, and of either edge alone.

    The middle of a sector that is too wide hardly moves while both edges do: one that is right would go.

    Example:
        >>> _ways({"azimuth_rad": 0.2, "width_rad": 0.1}, with_edges=True)[-1]
        [{'azimuth_rad': -0.05, 'width_rad': 0.1}, {'azimuth_rad': 0.05, 'width_rad': -0.1}]
    """
    found = [[{one: step}, {one: -step}] for one, step in steps.items()]
    if with_edges:
        for side in (0.5, -0.5):
            wider = {"azimuth_rad": side * steps["width_rad"], "width_rad": steps["width_rad"]}
            found.append([wider, {one: -change for one, change in wider.items()}])
    return found


def _misfit_of_maps(search: SimulatorLikelihood, point: ParameterPoint, seen: Mapping[str, Floats]) -> float:
    """Squared departure of the maps of returns at a point, in units of the noise of counts.

    Args:
        search: its simulator.
        point: that is simulated.
        seen: condition to the mean map ``(cells,)`` of its measured frames; of those that are left out nothing counts.
    """
    if not seen:
        return 0.0
    pools, total = search.pools(point, NUMERICS.location_frames), 0.0
    for target in search.measured:
        name = target.condition.id
        simulated = pools[name].frames.maps[:, 0].mean(0)
        apart = np.sqrt(seen[name] + ANSCOMBE) - np.sqrt(simulated + ANSCOMBE)
        total += 4.0 * float(apart @ apart) / (1.0 / target.frames + 1.0 / NUMERICS.location_frames)
    return total
