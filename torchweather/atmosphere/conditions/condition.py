"""Condition: what rain and snow leave on roads, windows and objects; a part of a weather that is not in the air."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar, TypeVar

import torch
from torch import Tensor

from torchweather.atmosphere.weather import CONDITIONS, Rain, Weather
from torchweather.core.arguments import check_arguments
from torchweather.core.distributions import Distribution
from torchweather.core.errors import InputTypeError, InputValueError
from torchweather.core.fields import Range

__all__ = ["CONDITIONS", "Amount", "Condition", "condition_of", "rain_of", "register_condition"]

Amount = float | Distribution | tuple[float, float]
"""A number, or a distribution that is drawn for each sample; a pair is ``Uniform``, for the condition's amount."""
C = TypeVar("C", bound="Condition")


class Condition(Weather):
    """Water or snow on things. A subclass is a frozen dataclass of plain numbers with their ranges.

    Class attributes:
        kind: name in files and on the command line.
        intensity_name: field that is the amount; at 0 the condition does nothing.
        ranges: field name to the values that it takes.
        aliases: short names of fields that the command line takes.
        rain_field: field that is ``None`` where the rain of the mixture gives its value; empty where there is none.
    """

    ranges: ClassVar[Mapping[str, Range]] = {}
    aliases: ClassVar[Mapping[str, str]] = {}
    rain_field: ClassVar[str] = ""

    def __post_init__(self) -> None:
        if self._ends_are_good():
            return
        for name, within in self.ranges.items():
            value = getattr(self, name)
            if value is None and type(self).__dataclass_fields__[name].default is None:  # type: ignore[attr-defined]
                continue
            within.check(name, value, self)
            check_arguments(f"{type(self).__name__}({name}: float)", value)
            object.__setattr__(self, name, float(value))

    @property
    def parts(self) -> tuple[Weather, ...]:
        """Nothing: a condition is not in the air."""
        return ()

    @property
    def conditions(self) -> tuple[Weather, ...]:
        """The condition itself."""
        return (self,)

    @property
    def follows_rain(self) -> bool:
        """True where its values follow from the rain of the mixture."""
        return bool(self.rain_field) and getattr(self, self.rain_field) is None

    @property
    def is_nothing(self) -> bool:
        """True where the amount is 0."""
        return bool(getattr(self, self.intensity_name) == 0.0)


def register_condition(condition: type[C]) -> type[C]:
    """Class decorator: make a condition known under its kind, for files and the command line."""
    CONDITIONS[condition.kind] = condition
    return condition


def condition_of(weather: Weather, kind: type[C]) -> C | None:
    """The condition of a class in a weather; ``None`` where there is none.

    Example:
        >>> from torchweather.atmosphere.conditions import WetRoad
        >>> from torchweather.atmosphere.weather import Mixture, Rain
        >>> condition_of(Mixture(Rain(5), WetRoad(water_mm=1)), WetRoad).water_mm
        1.0
    """
    check_arguments("condition_of(weather: Weather)", weather)
    if not isinstance(kind, type):
        raise InputTypeError(f"condition_of: kind must be a class of a condition, such as WetRoad; got {kind!r:.100}.")
    return next((one for one in weather.conditions if isinstance(one, kind)), None)


def rain_of(weather: Weather, condition: Condition, field: str) -> Rain:
    """The rain of a weather.

    Args:
        weather: what is in the air.
        condition: that follows from it, for messages.
        field: of the condition that can be given in its place.

    Raises:
        InputValueError: there is none.

    Example:
        >>> from torchweather.atmosphere.conditions import WetRoad
        >>> rain_of(Rain(25), WetRoad(), "water_mm").rate_mm_per_h
        25
    """
    check_arguments(
        "rain_of(weather: Weather, condition: Condition, field: str)",
        weather,
        condition,
        field,
    )
    rain = next((part for part in weather.parts if isinstance(part, Rain)), None)
    if rain is None:
        name = type(condition).__name__
        raise InputValueError(
            f"{name}: it follows from rain, and the weather holds none. Give {name}({field}=...), or add Rain(...)."
        )
    return rain


def water_of(rain: Rain) -> tuple[Tensor, Tensor]:
    """Rate, mm/h, and water in the air, g/m^3, of a rain, flat, float64.

    Example:
        >>> [round(float(one), 2) for one in water_of(Rain(25))]
        [25.0, 1.33]
    """
    rate = torch.as_tensor(rain.intensity, dtype=torch.float64).reshape(-1)
    falls = rate > 0
    water = rain.distribution(torch.where(falls, rate, 1.0)).liquid_water_g_per_m3()
    return rate, torch.where(falls, water, 0.0)
