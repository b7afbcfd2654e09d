"""Starting points of the search: grids of an effect's parameters, from weak to strong, of either sign.

Response curves come from finite points, refined near the identity and of both signs: gradients at the identity vanish
or are one-sided for half of the effects (GAP.md 3 (5)). An effect with a place (an azimuth) is tried where the residual
is largest.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from torchweather.gap.inference.config import NUMERICS
from torchweather.gap.inference.effect_forms import tried_values
from torchweather.pipeline.effect import Effect, Parameter

__all__ = ["ParameterGrid", "parameter_grids"]

PLACES = ("azimuth_rad",)  # parameters that say where


@dataclass(frozen=True)
class ParameterGrid:
    """Points of one effect along which it grows from its identity.

    Args:
        effect: its class.
        points: parameters from weak to strong, without the identity.
        mirror: the grid on the other side of the identity, whose weakest point departs by as much; ``None`` where none
            does.
    """

    effect: type[Effect]
    points: tuple[Mapping[str, float], ...]
    mirror: ParameterGrid | None = None

    @property
    def curved(self) -> bool:
        """True where no point predicts the next one, so that many are tried: of what cuts, or begins at a
        threshold, or has its identity infinitely far."""
        return len(self.points) > len(NUMERICS.start_steps)

    @property
    def first(self) -> tuple[int, ...]:
        """Places of the points that are tried at first: one of a typical size, and a weak one, as few counts go as
        the root and strong effects change other statistics as well; all where the identity is infinitely far."""
        number = len(self.points)
        if self.curved:
            return tuple(range(number))
        return (0, number // 2) if number > 2 else (number // 2,)


def _strengths(parameter: Parameter, size: float, steps: Sequence[float] = NUMERICS.start_steps) -> list[list[float]]:
    """Values on either side of the identity, from weak to strong in terms of a typical size, inside the bounds."""
    identity = parameter.identity
    assert identity is not None
    found = []
    for sign in (1.0, -1.0):
        if math.isinf(identity):
            values = [size * step for step in NUMERICS.start_steps_far] if sign > 0 else []
        elif identity > 0 and parameter.low >= 0:  # a factor
            values = [identity * math.exp(sign * size * step) for step in steps]
        else:
            values = [identity + sign * size * step for step in steps]
        inside = [value for value in values if parameter.low <= value <= parameter.high]
        if len(inside) < len(values) and values:
            bound = parameter.high if values[-1] > (identity if math.isfinite(identity) else 0.0) else parameter.low
            if math.isfinite(bound) and bound != identity and bound not in inside:
                inside.append(bound)
        if inside:
            found.append(inside)
    return found


def parameter_grids(
    effect: type[Effect], places: Sequence[float], sizes: Mapping[str, float | Sequence[float]] | None = None
) -> list[ParameterGrid]:
    """Grids of points of an effect.

    Args:
        effect: its class.
        places: azimuths, rad, at which it is tried if it has one.
        sizes: of parameters whose typical size is a matter of the data, such as an intensity; several are all values
            that are tried, from weak to strong.
    """
    deciding = [parameter for parameter in effect.arguments if parameter.identity is not None]
    telling = [parameter for parameter in effect.arguments if parameter.identity is None]
    choices: list[list[tuple[str, float]]] = []
    for parameter in telling:
        if parameter.name in PLACES:
            values = list(places)
        elif tried := tried_values(effect, parameter.name):
            values = list(tried)
        else:
            around = parameter.value
            alone = math.isinf(around) or around * 3.0 > parameter.high
            values = [around] if alone else [around, min(3.0 * around, parameter.high)]
        choices.append([(parameter.name, value) for value in values])
    found = []
    for fixed in itertools.product(*choices):
        for parameter in deciding:
            size = (sizes or {}).get(parameter.name, parameter.scale)
            if isinstance(size, Sequence):
                along = [list(size)]
            else:
                along = _strengths(
                    parameter, size, NUMERICS.start_steps_of_cuts if effect.cuts else NUMERICS.start_steps
                )
            sides: list[ParameterGrid] = []
            for values in along:
                points = tuple({**dict(fixed), parameter.name: value} for value in values)
                mirrored = sides and _mirrored(parameter, along[0][0], values[0])
                sides.append(ParameterGrid(effect, points, sides[0] if mirrored else None))
            found += sides
    return found


def _mirrored(parameter: Parameter, one: float, other: float) -> bool:
    """True where two values depart by as much to either side of the identity, in logarithm if that is a factor."""
    identity = parameter.identity
    if identity is None or math.isinf(identity):
        return False
    if identity > 0 and parameter.low >= 0:
        return math.isclose(one * other, identity**2)
    return math.isclose(one - identity, identity - other)
