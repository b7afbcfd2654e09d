"""Water and snow on things in the chain of a sensor: stages and effects that its folder makes of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from torchweather.atmosphere.weather import Weather
from torchweather.core.errors import InputValueError
from torchweather.pipeline.chain import Chain
from torchweather.pipeline.effect import Effect, effect_from_dict, with_effects
from torchweather.pipeline.registry import load_catalogue
from torchweather.pipeline.stage import Stage

__all__ = ["OfConditions", "with_conditions"]


@dataclass(frozen=True)
class OfConditions:
    """Stages and effects that a sensor makes of a weather's conditions.

    Args:
        effects: each with the condition that it is of.
        surfaces: by name, stages that the effects need in front of them.
    """

    effects: tuple[tuple[Weather, Effect], ...] = ()
    surfaces: Mapping[str, Stage] = field(default_factory=dict)


def with_conditions(
    chain: Chain, given: Sequence[Effect | Mapping[str, Any]], conditions: OfConditions, owner: object
) -> Chain:
    """A chain with the effects that were given and those of conditions.

    Args:
        chain: of a ready-made transform.
        given: effects, or their dictionaries.
        conditions: of the weather.
        owner: for messages.

    Raises:
        InputValueError: an effect is given and follows from a condition as well.
    """
    if conditions.effects:
        load_catalogue()
    effects = [one if isinstance(one, Effect) else effect_from_dict(one) for one in given]
    ids = {one.id for one in effects}
    for condition, effect in conditions.effects:
        if effect.id in ids:
            raise InputValueError(
                f"{type(owner).__name__}: effects=[...] holds {effect.id}, and {type(condition).__name__} in the "
                "weather makes one of its own. Leave out one of the two."
            )
    chain = with_effects(chain, [*effects, *(effect for _, effect in conditions.effects)])
    return Chain({**conditions.surfaces, **chain.stages}) if conditions.surfaces else chain
