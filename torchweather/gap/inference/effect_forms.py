"""Effects in the form in which they are searched for.

The search moves single numbers. An effect of the catalogue that takes one number for each of so many classes is
searched for in a form of its own, which a model of a sensor's frames may have under ``forms``: id to the class, with
one parameter for each number. What is handed out is the catalogue's effect again.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import ClassVar

from torchweather.gap.inference.config import METHOD
from torchweather.pipeline.effect import Effect, effect_from_dict
from torchweather.stages.catalogue import EFFECTS

__all__ = [
    "SearchForm",
    "catalogue_effect",
    "counted_form",
    "effect_class",
    "complexity_penalty",
    "is_another",
    "searched_effects",
    "stands_at_a_place",
    "tried_values",
]


class SearchForm(Effect):
    """An effect of the catalogue with other parameters; its ``to_dict`` is that of the catalogue's.

    Class attributes:
        complexity_penalty: by how much it must lower the misfit more than others do, as it has more parameters.
        tried: values of parameters that say which or where, at which response curves begin.
        another_from: values of parameters from which on it is another effect of the catalogue.
    """

    complexity_penalty: ClassVar[float] = 0.0
    tried: ClassVar[Mapping[str, tuple[float, ...]]] = {}
    another_from: ClassVar[Mapping[str, float]] = {}


def counted_form(effect: type[Effect]) -> type[Effect]:
    """An effect that must explain more than one with a single parameter, as each further one can explain noise.

    Example:
        >>> counted_form(EFFECTS["camera.ego_blur"]).complexity_penalty
        5.0
    """
    return type(
        effect.__name__,
        (SearchForm, effect),
        {"complexity_penalty": METHOD.parameter_penalty * (len(effect.arguments) - 1)},
    )


def searched_effects(sensor: str, named: Sequence[str] = ()) -> list[str]:
    """Ids of a sensor's effects that are searched for: the catalogue's, and those of water and snow that are named.

    Args:
        sensor: ``lidar``, ``camera`` or ``radar``.
        named: ids that the caller names.

    Example:
        >>> set(searched_effects("radar", ["radar.road_spray"])) - set(searched_effects("radar"))
        {'radar.road_spray'}
    """
    return [
        name for name, effect in EFFECTS.items() if name.startswith(f"{sensor}.") and (effect.searched or name in named)
    ]


def effect_class(model: object, name: str) -> type[Effect]:
    """The class of an effect as a model of frames is searched with it."""
    forms: Mapping[str, type[Effect]] = getattr(model, "forms", {})
    return forms.get(name, EFFECTS[name])


def stands_at_a_place(effect: type[Effect]) -> bool:
    """Check whether an effect is a thing that stands in the scene: it has an azimuth, a range and a width.

    Example:
        >>> stands_at_a_place(EFFECTS["lidar.static_structure"]), stands_at_a_place(EFFECTS["lidar.sector_loss"])
        (True, False)
    """
    return {"azimuth_rad", "range_m", "width_rad"} <= {one.name for one in effect.arguments}


def tried_values(effect: type[Effect], name: str) -> tuple[float, ...]:
    """Values of a parameter that a form of an effect wants tried; none: the usual ones."""
    return effect.tried.get(name, ()) if issubclass(effect, SearchForm) else ()


def complexity_penalty(model: object, name: str) -> float:
    """Amount by which an effect must lower the misfit more than others."""
    found = effect_class(model, name)
    return found.complexity_penalty if issubclass(found, SearchForm) else 0.0


def is_another(model: object, values: Mapping[str, Mapping[str, float]]) -> bool:
    """Check whether one of some effects, each with its parameters, is where it is another one."""
    for name, own in values.items():
        found = effect_class(model, name)
        limits = found.another_from if issubclass(found, SearchForm) else {}
        if any(own[parameter] >= limit for parameter, limit in limits.items()):
            return True
    return False


def catalogue_effect(effect: Effect) -> Effect:
    """The effect as the catalogue has it."""
    return effect_from_dict(effect.to_dict()) if isinstance(effect, SearchForm) else effect
