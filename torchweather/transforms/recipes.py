"""Recipes: ready-made pipelines as YAML files: a weather, a sensor and a transform with its options.

A recipe holds ``format: torchweather-recipe/1`` and

- ``title``: what it does, in words;
- ``transform``: ``BayerRain``, ``BayerFog``, ``BayerSnow`` or ``BayerWeather`` for a camera, ``LidarRain``,
  ``LidarFog``, ``LidarSnow`` or ``LidarWeather`` for a LiDAR, ``RadarAttenuation`` for a radar;
- ``weather``: ``kind`` and the weather's fields (``parts`` for a mixture);
- ``sensor``: ``kind``, and a ``preset`` or the sensor's fields; fields beside a preset replace the preset's;
- ``options``: keyword arguments of the transform; a camera's ``depth`` is a number of metres, ``ground``, or
  ``auto`` (guessed from the picture);
- ``rgb``: true for a camera's RGB images, by ``AsBayer`` (default false);
- ``through_mosaic``: true for RGB images by way of the camera's mosaic (default false).
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from torch import nn

from torchweather.camera.depth import AUTO, FlatGround
from torchweather.errors import TorchweatherError, nearest_name
from torchweather.sensors import SENSOR_CLASSES, Camera, Lidar, Radar, sensor_preset
from torchweather.transforms.as_bayer import AsBayer
from torchweather.transforms.camera import BayerWeather
from torchweather.transforms.lidar import LidarWeather
from torchweather.transforms.plans import TRANSFORMS, TransformClass, class_for, sensor_of
from torchweather.transforms.radar import RadarAttenuation
from torchweather.transforms.recipe_files import (
    PIPELINE,
    RECIPE,
    check_format,
    files_of,
    find,
    format_of,
    name_of,
    read_yaml,
    recipes_folder,
    refuse_unknown,
    write_yaml,
)
from torchweather.transforms.recipe_options import GROUND, OPTIONS, RecipeTransform, options_of, sensor_values
from torchweather.weather import Weather, parse_weather, weather_from_dict

__all__ = ["FORMAT", "Recipe", "list_recipes", "load_recipe", "read_recipe", "recipes_folder", "save_recipe"]

FORMAT = RECIPE + "1"
REQUIRED = ("format", "title", "transform", "weather", "sensor")
KEYS = (*REQUIRED, "options", "rgb", "through_mosaic")


@dataclass(frozen=True)
class Recipe:
    """A pipeline as its file states it.

    Args:
        name: path below the recipes' folder without its ending, such as ``camera/fog-30m``; for a file of one's own,
            its name.
        title: what it does.
        transform: name of the transform's class.
        weather: plain values, as ``weather_from_dict`` takes them.
        sensor: ``kind`` with ``preset`` or fields.
        options: keyword arguments of the transform.
        rgb: true for RGB images.
        through_mosaic: true for RGB images by way of the camera's mosaic.
        path: the file.
    """

    name: str
    title: str
    transform: str
    weather: Mapping[str, Any]
    sensor: Mapping[str, Any]
    options: Mapping[str, Any] = field(default_factory=dict)
    rgb: bool = False
    through_mosaic: bool = False
    path: Path | None = None

    @property
    def sensor_kind(self) -> str:
        """``camera``, ``lidar`` or ``radar``, as the transform wants it."""
        return kind_of(TRANSFORMS[self.transform])

    @property
    def sensor_name(self) -> str:
        """``kind:preset``, or the kind where the fields are given."""
        preset = self.sensor.get("preset")
        return f"{self.sensor['kind']}:{preset}" if preset else str(self.sensor["kind"])

    def build_weather(self) -> Weather:
        """The weather object."""
        return weather_from_dict(self.weather)

    def build_sensor(self) -> Camera | Lidar | Radar:
        """The sensor object."""
        return SENSOR_OF[self.sensor_kind](self.sensor)

    def build_camera(self) -> Camera:
        """The camera object."""
        return camera_of(self.sensor)


def list_recipes() -> list[Recipe]:
    """All ready-made recipes, by name.

    Example:
        >>> "camera/fog-30m" in [recipe.name for recipe in list_recipes()]
        True
    """
    return sorted((read_recipe(path) for path in files_of(RECIPE)), key=lambda recipe: recipe.name)


def read_recipe(name_or_path: str | os.PathLike[str]) -> Recipe:
    """A recipe by name (``camera/fog-30m``, or ``fog-30m`` where only one ends so) or from a file.

    Raises:
        ValueError: no recipe of this name.
        TorchweatherError: the file is missing, no YAML, of another format, or has unknown or missing keys.

    Example:
        >>> read_recipe("rain-25mm-per-h").weather["rate_mm_per_h"]
        25.0
    """
    path = find(name_or_path)
    return checked_recipe(read_yaml(path, "recipe"), path)


def load_recipe(name_or_path: str | os.PathLike[str], **overrides: Any) -> nn.Module:
    """The transform of a recipe, ready to call; of a pipeline (``transforms.pipelines``) its ``Compose``.

    Args:
        name_or_path: as in ``read_recipe``.
        overrides: ``weather`` (an object, text such as ``rain:rate=25``, or plain values), ``sensor`` (of the recipe's
            kind: an object, text such as ``camera:gopro-hero5-acdc``, or fields to replace), ``rgb``, or any option of
            the transform, such as ``depth``. Of a pipeline, what ``load_pipeline`` takes.

    Returns:
        ``BayerWeather`` or ``LidarWeather`` or one of their kinds, or ``RadarAttenuation``; inside ``AsBayer`` where
        the recipe is for RGB images.

    Example:
        >>> fog = load_recipe("fog-30m", depth=40.0, airlight=0.7)
        >>> fog.weather.mor_m
        30.0
    """
    if format_of(find(name_or_path, "recipe", RECIPE, PIPELINE)).startswith(PIPELINE):
        from torchweather.transforms.pipelines import load_pipeline  # which is made of recipes

        return load_pipeline(name_or_path, **overrides)
    recipe = read_recipe(name_or_path)
    refuse_overrides(overrides, ["weather", *overrides_of(recipe)], "load_recipe")
    weather = overrides.pop("weather", None)
    try:
        return built_recipe(recipe, recipe.build_weather() if weather is None else as_weather(weather), overrides)
    except (TypeError, ValueError) as error:
        raise TorchweatherError(f"{recipe.path or recipe.name}: {error}") from error


def overrides_of(recipe: Recipe) -> list[str]:
    """What ``load_recipe`` can be told of a recipe's sensor and transform."""
    kind = recipe.sensor_kind
    return ["sensor", *(["rgb", "through_mosaic"] if kind == "camera" else []), *OPTIONS[kind]]


def refuse_overrides(given: Iterable[str], known: Iterable[str], owner: str) -> None:
    """Raise for an override that is not known, with the nearest one that is."""
    names = list(known)
    for key in given:
        if key not in names:
            raise ValueError(
                f"{owner}: unknown override {key!r}; known are {', '.join(names)}.{nearest_name(key, names)}"
            )


def built_recipe(recipe: Recipe, weather: Weather, overrides: Mapping[str, Any]) -> nn.Module:
    """The transform of a recipe for a weather, its sensor and options overridden."""
    options = with_depth_source({**recipe.options, **overrides})
    sensor, rgb = options.pop("sensor", None), bool(options.pop("rgb", recipe.rgb))
    mosaic = bool(options.pop("through_mosaic", recipe.through_mosaic))
    built = recipe.build_sensor() if sensor is None else _as_sensor(sensor, recipe)
    transform = transform_class(recipe, weather)(weather, built, **options)  # type: ignore[arg-type]
    if not rgb or not isinstance(transform, BayerWeather):
        return transform
    return AsBayer(transform, through_mosaic=mosaic)


def transform_class(recipe: Recipe, weather: Weather) -> TransformClass:
    """The recipe's class; for a weather that it does not take, the one that takes any."""
    return class_for(TRANSFORMS[recipe.transform], weather)


def save_recipe(transform: nn.Module, path: str | os.PathLike[str], *, title: str) -> None:
    """Write a transform as a recipe, whole or not at all.

    Args:
        transform: ``BayerWeather``, ``LidarWeather`` or one of their kinds, ``RadarAttenuation``, or ``AsBayer``
            around one of a camera.
        path: the file, ending in ``.yaml``.
        title: what it does, in words.

    Raises:
        ValueError: something that a recipe cannot hold: a depth map or function, directions of beams, stages put in
            (``Chain.save`` holds those), another demosaicing.

    Example:
        >>> import tempfile
        >>> file = Path(tempfile.mkdtemp()) / "mine.yaml"
        >>> save_recipe(load_recipe("fog-30m", depth=40.0), file, title="My fog")
        >>> read_recipe(file).options
        {'depth': 40.0}
    """
    inner = transform.transform if isinstance(transform, AsBayer) else transform
    if not isinstance(inner, RecipeTransform) or type(inner).__name__ not in TRANSFORMS:
        raise TypeError(
            f"save_recipe: transform must be one of {', '.join(TRANSFORMS)}, or AsBayer around one; got "
            f"{type(inner).__name__}."
        )
    if isinstance(transform, AsBayer) and transform.method != "malvar":
        raise ValueError(f"save_recipe: a recipe demosaics with malvar; got method={transform.method!r}.")
    values: dict[str, Any] = {
        "format": FORMAT,
        "title": str(title),
        "transform": type(inner).__name__,
        "weather": inner.weather.to_dict(),
        "sensor": sensor_values(sensor_of(inner)),
        "options": options_of(inner),
    }
    if isinstance(transform, AsBayer):
        values["rgb"] = True
        if transform.through_mosaic:
            values["through_mosaic"] = True
    write_yaml(values, path, owner="save_recipe")


# ---- reading -------------------------------------------------------------------------------------------------------


def with_depth_source(options: Mapping[str, Any]) -> dict[str, Any]:
    """Options with the depth source that ``ground`` stands for; ``auto`` is known to the transform."""
    return {key: FlatGround() if key == "depth" and one == GROUND else one for key, one in options.items()}


def checked_recipe(values: Any, path: Path) -> Recipe:
    check_format(values, path, "recipe", FORMAT, required=REQUIRED, known=KEYS)
    options = values.get("options") or {}
    for key, value in (("weather", values["weather"]), ("sensor", values["sensor"]), ("options", options)):
        if not isinstance(value, Mapping):
            raise TorchweatherError(f"{path}: {key} must be keys with values; got {value!r}.")
    transform = values["transform"]
    if transform not in TRANSFORMS:
        raise TorchweatherError(
            f"{path}: transform must be one of {', '.join(TRANSFORMS)}; got {transform!r}."
            f"{nearest_name(transform, TRANSFORMS)}"
        )
    kind = kind_of(TRANSFORMS[transform])
    refuse_unknown(options, OPTIONS[kind], path, "option")
    depth = options.get("depth")
    if isinstance(depth, str) and depth not in (GROUND, AUTO):
        raise TorchweatherError(
            f"{path}: options.depth must be a number of metres, {GROUND!r} or {AUTO!r}; got {depth!r}."
        )
    for key in ("rgb", "through_mosaic"):
        if not isinstance(values.get(key, False), bool):
            raise TorchweatherError(f"{path}: {key} must be true or false; got {values[key]!r}.")
        if values.get(key, False) and kind != "camera":
            raise TorchweatherError(f"{path}: {key} belongs to a camera; the transform is {transform}. Leave it out.")
    if values.get("through_mosaic", False) and not values.get("rgb", False):
        raise TorchweatherError(f"{path}: through_mosaic is for RGB images; add rgb: true, or leave it out.")
    recipe = Recipe(
        name=name_of(path),
        title=str(values["title"]),
        transform=transform,
        weather=dict(values["weather"]),
        sensor=dict(values["sensor"]),
        options=dict(options),
        rgb=values.get("rgb", False),
        through_mosaic=values.get("through_mosaic", False),
        path=path,
    )
    try:
        recipe.build_weather()
        recipe.build_sensor()
    except (TypeError, ValueError, KeyError) as error:
        raise TorchweatherError(f"{path}: {error}") from error
    return recipe


def kind_of(transform: TransformClass) -> str:
    """Kind of the sensor that a transform takes."""
    if issubclass(transform, RadarAttenuation):
        return "radar"
    return "lidar" if issubclass(transform, LidarWeather) else "camera"


def camera_of(values: Mapping[str, Any]) -> Camera:
    """The camera of a recipe's ``sensor``: a preset with fields replaced, or all fields."""
    preset, fields = _preset_and_fields(values, "camera")
    return Camera.from_dict(fields) if preset is None else Camera.preset(preset, **fields)


def lidar_of(values: Mapping[str, Any]) -> Lidar:
    """The LiDAR of a recipe's ``sensor``: a preset with fields replaced, or all fields."""
    preset, fields = _preset_and_fields(values, "lidar")
    return Lidar.from_dict(fields) if preset is None else Lidar.preset(preset, **fields)


def radar_of(values: Mapping[str, Any]) -> Radar:
    """The radar of a recipe's ``sensor``: a preset with fields replaced, or all fields."""
    preset, fields = _preset_and_fields(values, "radar")
    return Radar.from_dict(fields) if preset is None else Radar.preset(preset, **fields)


SENSOR_OF: dict[str, Callable[[Mapping[str, Any]], Camera | Lidar | Radar]] = {
    "camera": camera_of,
    "lidar": lidar_of,
    "radar": radar_of,
}


def _preset_and_fields(values: Mapping[str, Any], wanted: str) -> tuple[str | None, dict[str, Any]]:
    fields = dict(values)
    kind, preset = fields.pop("kind", None), fields.pop("preset", None)
    if kind != wanted:
        raise ValueError(f"sensor.kind must be {wanted}; got {kind!r}.")
    # A list of YAML stands for a tuple of the dataclass.
    fields = {key: tuple(value) if isinstance(value, list) else value for key, value in fields.items()}
    return None if preset is None else str(preset), fields


def as_weather(weather: Any) -> Weather:
    """A weather from an object, text such as ``rain:rate=25``, or plain values."""
    if isinstance(weather, str):
        return parse_weather(weather)
    built: Weather = weather_from_dict(weather) if isinstance(weather, Mapping) else weather
    return built


def _as_sensor(sensor: Any, recipe: Recipe) -> Camera | Lidar | Radar:
    kind = recipe.sensor_kind
    if isinstance(sensor, Mapping):
        base = {} if "preset" in sensor else recipe.sensor
        return SENSOR_OF[kind]({"kind": kind, **base, **sensor})
    built = sensor_preset(sensor)[1] if isinstance(sensor, str) else sensor
    if not isinstance(built, SENSOR_CLASSES[kind]):
        raise TypeError(f"sensor must be a {kind}; got {getattr(built, 'kind', type(built).__name__)}.")
    return built
