"""Weathers that other packages add under a name: functions that build one of the library's weathers."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

from torchweather.core.distributions import with_distributions
from torchweather.core.errors import InputValueError, TorchweatherError, nearest_name
from torchweather.core.plugins import Plugin

__all__ = ["ALIASES", "INTENSITIES", "NamedWeather"]

INTENSITIES = ("rate_mm_per_h", "mor_m")
# Short names that the command line takes.
ALIASES = {
    "rate": "rate_mm_per_h",
    "mor": "mor_m",
    "visibility": "mor_m",
    "visibility_m": "mor_m",
    "patches": "patch_log_std",
    "patch_length": "patch_length_m",
}


@dataclass(frozen=True)
class NamedWeather:
    """A function of a package that builds a weather, in the place of a weather's class.

    Args:
        plugin: its entry point; the function is loaded when it is needed.
        expected: class of what it returns.
    """

    aliases: ClassVar[Mapping[str, str]] = ALIASES

    plugin: Plugin
    expected: type[Any]

    @property
    def intensity_name(self) -> str:
        """The argument that is a rate or a visibility; empty where there is none."""
        return next((name for name in INTENSITIES if name in self._parameters()), "")

    def from_dict(self, values: Mapping[str, Any]) -> Any:
        """The weather of plain values, ``kind`` among them; unknown ones are refused with the nearest name."""
        given = {key: value for key, value in values.items() if key != "kind"}
        known = self._parameters()
        for key in given:
            if key not in known:
                near = nearest_name(key, known)
                raise InputValueError(f"{self.plugin.name}: unknown field {key!r}; known are {', '.join(known)}.{near}")
        if missing := [name for name, one in known.items() if one.default is one.empty and name not in given]:
            raise InputValueError(f"{self.plugin.name}: {', '.join(missing)} must be given.")
        values = with_distributions(given, owner=self.plugin.name)
        try:
            weather = self._function()(**values)
        except TorchweatherError:
            raise  # of a value that was given
        except Exception as error:
            raise self.plugin.error(f"builds no weather: {type(error).__name__}: {error}") from error
        if not isinstance(weather, self.expected):
            raise self.plugin.error(f"is no weather: expected its function to return one; got {weather!r:.200}.")
        return weather

    def _function(self) -> Callable[..., Any]:
        found: Callable[..., Any] = self.plugin.load()
        if not callable(found):
            raise self.plugin.error(f"is no weather: expected a function that returns one; got {found!r:.200}.")
        return found

    def _parameters(self) -> Mapping[str, inspect.Parameter]:
        try:
            return inspect.signature(self._function()).parameters
        except (TypeError, ValueError) as error:
            raise self.plugin.error(f"is no weather: expected a function with named arguments: {error}") from error
