"""Pipelines: one weather on several sensors, or one of several weathers, as YAML files that make a ``Compose``.

A pipeline holds ``format: torchweather-pipeline/1`` and

- ``title``: what it does, in words;
- ``weather``: a weather (``kind`` and its fields); or ``choice``, a list of weathers (``null`` is clear air), with or
  without ``weights``. A number may be ``{uniform: [low, high]}``, ``{log_uniform: [low, high]}`` or
  ``{choice: [...]}``;
- ``transforms``: key of the sample to ``transform``, ``sensor``, ``options``, ``rgb`` and
  ``through_mosaic``, as a recipe has them;
- ``p``, ``depth``, ``inputs``, ``mosaic_clear``: as ``Compose`` takes them.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from torchweather.atmosphere.weather import Weather, parse_weather, weather_from_dict
from torchweather.camera.rgb import AsBayer
from torchweather.compose.compose import Compose
from torchweather.core.distributions import Choice
from torchweather.core.errors import InputValueError, TorchweatherError
from torchweather.recipes.files import (
    PIPELINE,
    check_format,
    files_of,
    find,
    name_of,
    read_yaml,
    refuse_unknown,
    write_yaml,
)
from torchweather.recipes.options import options_of, sensor_values
from torchweather.recipes.recipe import FORMAT as RECIPE_FORMAT
from torchweather.recipes.recipe import Recipe, built_recipe, checked_recipe, overrides_of, refuse_overrides

__all__ = ["FORMAT", "Pipeline", "list_pipelines", "load_pipeline", "read_pipeline", "save_pipeline"]

FORMAT = PIPELINE + "1"
REQUIRED = ("format", "title", "weather", "transforms")
KEYS = (*REQUIRED, "p", "depth", "inputs", "mosaic_clear")
OF_A_TRANSFORM = ("transform", "sensor", "options", "rgb", "through_mosaic")
OVERRIDES = ("weather", "transforms", "keys", "p", "depth", "inputs", "seed", "sample_key", "history", "mosaic_clear")


@dataclass(frozen=True)
class Pipeline:
    """A pipeline as its file states it.

    Args:
        name: path below the recipes' folder without its ending, such as ``multi_sensor/training-mix``; for a file of
            one's own, its name.
        title: what it does.
        weather: plain values: a weather, or ``choice`` with or without ``weights``.
        transforms: key of the sample to how its transform is built.
        options: ``p``, ``depth`` and ``inputs`` where the file has them.
        path: the file.
    """

    name: str
    title: str
    weather: Mapping[str, Any]
    transforms: Mapping[str, Recipe]
    options: Mapping[str, Any] = field(default_factory=dict)
    path: Path | None = None

    @property
    def sensor_name(self) -> str:
        """Of each key, as ``image camera:lucid-triton``."""
        return ", ".join(f"{key} {recipe.sensor_name}" for key, recipe in self.transforms.items())

    def build_weather(self) -> Choice:
        """The weathers to choose from."""
        return _choice(self.weather)

    def build(self, **more: Any) -> Compose:
        """The pipeline, ready to call; ``more`` is what ``load_pipeline`` takes."""
        choice = _as_choice(more.pop("weather")) if "weather" in more else self.build_weather()
        first = _first(choice)
        changes, names = more.pop("transforms", None) or {}, more.pop("keys", None) or {}
        for given, what in ((changes, "transforms"), (names, "keys")):
            refuse_overrides(given, self.transforms, f"pipeline {self.name}: {what}")
        built, inputs = {}, {**self.options, **more}.get("inputs") or {}
        for key, recipe in self.transforms.items():
            change = changes.get(key, {})
            if change is None:
                continue
            refuse_overrides(change, overrides_of(recipe), f"pipeline {self.name}: transforms: {key!r}")
            if names.get(key, key) in built:
                raise InputValueError(
                    f"keys: two transforms would go to {names.get(key, key)!r}; give each a key of its own."
                )
            built[names.get(key, key)] = built_recipe(recipe, first, change)
        if "inputs" not in more:  # those of the file are by its own keys
            inputs = {names.get(key, key): one for key, one in inputs.items() if changes.get(key, {}) is not None}
        return Compose(built, weather=choice, **{**self.options, **more, "inputs": inputs})


def list_pipelines() -> list[Pipeline]:
    """All ready-made pipelines, by name.

    Example:
        >>> "multi_sensor/training-mix" in [pipeline.name for pipeline in list_pipelines()]
        True
    """
    return sorted((read_pipeline(path) for path in files_of(PIPELINE)), key=lambda pipeline: pipeline.name)


def read_pipeline(name_or_path: str | os.PathLike[str]) -> Pipeline:
    """A pipeline by name (``multi_sensor/training-mix``) or from a file.

    Raises:
        ValueError: no pipeline of this name.
        TorchweatherError: the file is missing, no YAML, of another format, or has unknown or missing keys.

    Example:
        >>> list(read_pipeline("multi_sensor/training-mix").transforms)
        ['image', 'points', 'radar']
    """
    path = find(name_or_path, "pipeline", PIPELINE)
    values = read_yaml(path, "pipeline")
    check_format(values, path, "pipeline", FORMAT, required=REQUIRED, known=KEYS)
    transforms, weather = values["transforms"], values["weather"]
    if not isinstance(transforms, Mapping) or not transforms or not isinstance(weather, Mapping):
        raise TorchweatherError(f"{path}: weather and transforms must be keys with values; got {weather!r}.")
    try:
        choice = _choice(weather)
        first = _first(choice)
    except (TypeError, ValueError, KeyError) as error:
        raise TorchweatherError(f"{path}: weather: {error}") from error
    recipes = {}
    for key, one in transforms.items():
        if not isinstance(one, Mapping):
            raise TorchweatherError(f"{path}: transforms.{key} must be keys with values; got {one!r}.")
        refuse_unknown(one, OF_A_TRANSFORM, path, f"key of transforms.{key}")
        for wanted in OF_A_TRANSFORM[:2]:
            if wanted not in one:
                raise TorchweatherError(f"{path}: transforms.{key} lacks {wanted!r}.")
        whole = {"format": RECIPE_FORMAT, "title": values["title"], "weather": first.to_dict(), **one}
        recipes[str(key)] = checked_recipe(whole, path)
    options = {key: values[key] for key in ("p", "depth", "inputs", "mosaic_clear") if key in values}
    inputs = options.get("inputs", {})
    if not isinstance(inputs, Mapping) or not all(isinstance(one, Mapping) for one in inputs.values()):
        raise TorchweatherError(f"{path}: inputs must be keys of transforms, each with arguments; got {inputs!r}.")
    if not isinstance(options.get("depth", ""), str):
        raise TorchweatherError(f"{path}: depth must be a key of the sample; got {options['depth']!r}.")
    return Pipeline(name_of(path), str(values["title"]), weather, recipes, options, path)


def load_pipeline(name_or_path: str | os.PathLike[str], **overrides: Any) -> Compose:
    """A pipeline, ready to call.

    Args:
        name_or_path: as in ``read_pipeline``.
        overrides: ``p``, ``depth``, ``inputs``, ``seed``, ``sample_key`` and ``history`` of ``Compose``; ``weather``
            (also text such as ``rain:rate=1..50``); ``transforms``, by the file's keys what ``load_recipe`` takes for
            one sensor (``sensor``, ``rgb``, options), or ``None`` to leave the key out; ``keys``, the file's keys to
            those of your samples.

    Example:
        >>> load_pipeline("multi_sensor/training-mix", p=0.5).p
        0.5
        >>> changes = {"points": {"sensor": "lidar:velodyne-hdl-32e"}, "radar": None}
        >>> mine = load_pipeline("multi_sensor/training-mix", transforms=changes, keys={"points": "LIDAR_TOP"})
        >>> list(mine.plans)
        ['image', 'LIDAR_TOP']
    """
    refuse_overrides(overrides, OVERRIDES, "load_pipeline")
    pipeline = read_pipeline(name_or_path)
    try:
        return pipeline.build(**overrides)
    except (TypeError, ValueError) as error:
        raise TorchweatherError(f"{pipeline.path}: {error}") from error


def save_pipeline(compose: Compose, path: str | os.PathLike[str], *, title: str) -> None:
    """Write a ``Compose`` as a pipeline, whole or not at all; ``seed``, ``sample_key`` and ``history`` stay out.

    Args:
        compose: what to write.
        path: the file, ending in ``.yaml``.
        title: what it does, in words.

    Raises:
        ValueError: something that a file cannot hold, such as a depth map.
    """
    first = _first(compose.weather)
    transforms = {}
    for key, plan in compose.plans.items():
        built = plan.build(first)
        inner = built.transform if isinstance(built, AsBayer) else built
        transforms[key] = {
            "transform": plan.kind.__name__,
            "sensor": sensor_values(plan.sensor),
            "options": options_of(inner),
            **({"rgb": True} if plan.rgb else {}),
            **({"through_mosaic": True} if plan.through_mosaic else {}),
        }
    alone = len(compose.weather.values) == 1
    values: dict[str, Any] = {
        "format": FORMAT,
        "title": str(title),
        "weather": first.to_dict() if alone else compose.weather.to_dict(),
        "transforms": transforms,
        "p": compose.p,
        "depth": compose.depth,
    }
    if compose.mosaic_clear:
        values["mosaic_clear"] = True
    if compose.inputs:
        values["inputs"] = compose.inputs
    write_yaml(values, path, owner="save_pipeline")


def _choice(values: Mapping[str, Any]) -> Choice:
    if "choice" not in values:
        return Choice([weather_from_dict(values)])
    refused = [key for key in values if key not in ("choice", "weights")]
    if refused or not isinstance(values["choice"], list):
        raise InputValueError(f"wanted choice, a list of weathers, and weights; got {', '.join(map(str, values))}.")
    return Choice([one if one is None else weather_from_dict(one) for one in values["choice"]], values.get("weights"))


def _as_choice(weather: Any) -> Choice:
    if isinstance(weather, Choice):
        return weather
    if isinstance(weather, str):
        return Choice([parse_weather(weather, random=True)])
    if isinstance(weather, Mapping):
        return _choice(weather)
    return Choice([weather] if isinstance(weather, Weather) else weather)


def _first(choice: Choice) -> Weather:
    """A weather of those to choose from."""
    for one in choice.values:
        if one is not None:
            found: Weather = one
            return found
    raise InputValueError("wanted at least one weather that is not null (clear air).")
