"""A recipe of kind multi_sensor: one weather on several sensors, or one of several weathers; it makes a ``Compose``."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar

from torchweather.atmosphere.weather import Weather, parse_weather, weather_from_dict
from torchweather.compose.compose import Compose
from torchweather.core.distributions import Choice
from torchweather.core.errors import InputValueError, TorchweatherError
from torchweather.core.schema import MAPPING, check_keys
from torchweather.recipes.files import name_of
from torchweather.recipes.schema import OF_A_SENSOR
from torchweather.recipes.transform import TransformRecipe, checked_transform, refuse_overrides

__all__ = ["MultiSensorRecipe", "checked_multi_sensor", "first_weather"]

OF_COMPOSE = ("p", "depth", "inputs", "mosaic_clear")
OVERRIDES = ("weather", "transforms", "keys", *OF_COMPOSE, "seed", "sample_key", "history")


@dataclass(frozen=True)
class MultiSensorRecipe:
    """Several sensors or weathers, as the file states them.

    Args:
        name: path below the recipes' folder without its ending, such as ``multi_sensor/training-mix``; for a file of
            one's own, its name.
        title: what it does.
        weather: plain values: a weather, or ``choice`` with or without ``weights``.
        transforms: key of the sample to how its transform is built.
        options: ``p``, ``depth`` and ``inputs`` where the file has them.
        path: the file.
    """

    kind: ClassVar[str] = "multi_sensor"
    name: str
    title: str
    weather: Mapping[str, Any]
    transforms: Mapping[str, TransformRecipe]
    options: Mapping[str, Any] = field(default_factory=dict)
    path: Path | None = None

    @property
    def sensor_name(self) -> str:
        """Of each key, as ``image camera:lucid-triton``."""
        return ", ".join(f"{key} {recipe.sensor_name}" for key, recipe in self.transforms.items())

    def build_weather(self) -> Choice:
        """The weathers to choose from."""
        return _choice(self.weather)

    def build(self, **overrides: Any) -> Compose:
        """The ``Compose``, ready to call; the overrides are those of ``load_recipe``."""
        refuse_overrides(overrides, OVERRIDES, "load_recipe")
        try:
            return self._built(**overrides)
        except (TypeError, ValueError) as error:
            raise TorchweatherError(f"{self.path}: {error}") from error

    def _built(self, **more: Any) -> Compose:
        choice = _as_choice(more.pop("weather")) if "weather" in more else self.build_weather()
        first = first_weather(choice)
        changes, names = more.pop("transforms", None) or {}, more.pop("keys", None) or {}
        for given, what in ((changes, "transforms"), (names, "keys")):
            refuse_overrides(given, self.transforms, f"recipe {self.name}: {what}")
        built, inputs = {}, {**self.options, **more}.get("inputs") or {}
        for key, recipe in self.transforms.items():
            change = changes.get(key, {})
            if change is None:
                continue
            refuse_overrides(change, recipe.overrides, f"recipe {self.name}: transforms: {key!r}")
            if names.get(key, key) in built:
                raise InputValueError(
                    f"keys: two transforms would go to {names.get(key, key)!r}; give each a key of its own."
                )
            built[names.get(key, key)] = recipe.for_weather(first, change)
        if "inputs" not in more:  # those of the file are by its own keys
            inputs = {names.get(key, key): one for key, one in inputs.items() if changes.get(key, {}) is not None}
        return Compose(built, weather=choice, **{**self.options, **more, "inputs": inputs})


def checked_multi_sensor(values: Mapping[str, Any], path: Path) -> MultiSensorRecipe:
    """The recipe of a file's values, whose keys are of the schema.

    Raises:
        TorchweatherError: with the file and the key.
    """
    weather, file = values["weather"], str(path)
    try:
        first = first_weather(_choice(weather))
    except (TypeError, ValueError, KeyError) as error:
        raise TorchweatherError(f"{path}: weather: {error}") from error
    recipes = {}
    for key, one in values["transforms"].items():
        check_keys(one, OF_A_SENSOR, file, f"transforms.{key}")
        whole = {"title": values["title"], "weather": first.to_dict(), **one}
        recipes[key] = checked_transform(whole, path, f"transforms.{key}.")
    options = {key: values[key] for key in OF_COMPOSE if key in values}
    inputs = options.get("inputs", {})
    check_keys(inputs, dict.fromkeys(recipes, MAPPING), file, "inputs")
    return MultiSensorRecipe(name_of(path), str(values["title"]), weather, recipes, options, path)


def first_weather(choice: Choice) -> Weather:
    """A weather of those to choose from."""
    for one in choice.values:
        if one is not None:
            found: Weather = one
            return found
    raise InputValueError("expected at least one weather that is not null (clear air).")


def _choice(values: Mapping[str, Any]) -> Choice:
    if "choice" not in values:
        return Choice([weather_from_dict(values)])
    refused = [key for key in values if key not in ("choice", "weights")]
    if refused or not isinstance(values["choice"], list):
        raise InputValueError(f"expected choice, a list of weathers, and weights; got {', '.join(map(str, values))}.")
    return Choice([one if one is None else weather_from_dict(one) for one in values["choice"]], values.get("weights"))


def _as_choice(weather: Any) -> Choice:
    if isinstance(weather, Choice):
        return weather
    if isinstance(weather, str):
        return Choice([parse_weather(weather, random=True)])
    if isinstance(weather, Mapping):
        return _choice(weather)
    return Choice([weather] if isinstance(weather, Weather) else weather)
