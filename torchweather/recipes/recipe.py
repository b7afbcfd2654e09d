"""A recipe as its file states it: a weather, a sensor and a transform with its options.

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

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from torch import nn

from torchweather.atmosphere.weather import Weather, parse_weather, weather_from_dict
from torchweather.camera.depth import AUTO, FlatGround
from torchweather.camera.rgb import AsBayer
from torchweather.camera.sensor import Camera
from torchweather.camera.transform import BayerWeather
from torchweather.compose.plans import TRANSFORMS, TransformClass
from torchweather.core.errors import InputTypeError, InputValueError, TorchweatherError, nearest_name
from torchweather.lidar.sensor import Lidar
from torchweather.lidar.transform import LidarWeather
from torchweather.pipeline.sensor_transform import WeatherTransform, class_for
from torchweather.radar.sensor import Radar
from torchweather.radar.transform import RadarAttenuation
from torchweather.recipes.files import RECIPE, check_format, name_of, refuse_unknown
from torchweather.recipes.options import GROUND, OPTIONS
from torchweather.sensors import SENSOR_CLASSES, sensor_preset

__all__ = ["FORMAT", "Recipe", "as_weather", "built_recipe", "checked_recipe", "sensor_of_values"]

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
        return sensor_of_values(self.sensor, self.sensor_kind)

    def build_camera(self) -> Camera:
        """The camera object."""
        return camera_of(self.sensor)


def with_depth_source(options: Mapping[str, Any]) -> dict[str, Any]:
    """Options with the depth source that ``ground`` stands for; ``auto`` is known to the transform."""
    return {key: FlatGround() if key == "depth" and one == GROUND else one for key, one in options.items()}


def checked_recipe(values: Any, path: Path) -> Recipe:
    """The recipe that a file's values state; raises with file and key where they state none."""
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


def sensor_of_values(values: Mapping[str, Any], kind: str) -> Camera | Lidar | Radar:
    """The sensor of a recipe's ``sensor``: a preset with fields replaced, or all fields.

    Args:
        values: ``kind``, and ``preset`` or the sensor's fields.
        kind: that the transform takes: ``camera``, ``lidar`` or ``radar``.
    """
    fields = dict(values)
    given, preset = fields.pop("kind", None), fields.pop("preset", None)
    if given != kind:
        raise InputValueError(f"sensor.kind must be {kind}; got {given!r}.")
    # A list of YAML stands for a tuple of the dataclass.
    fields = {key: tuple(value) if isinstance(value, list) else value for key, value in fields.items()}
    sensor = SENSOR_CLASSES[kind]
    return sensor.from_dict(fields) if preset is None else sensor.preset(str(preset), **fields)


def camera_of(values: Mapping[str, Any]) -> Camera:
    """The camera of a recipe's ``sensor``."""
    built = sensor_of_values(values, "camera")
    assert isinstance(built, Camera)
    return built


def lidar_of(values: Mapping[str, Any]) -> Lidar:
    """The LiDAR of a recipe's ``sensor``."""
    built = sensor_of_values(values, "lidar")
    assert isinstance(built, Lidar)
    return built


def radar_of(values: Mapping[str, Any]) -> Radar:
    """The radar of a recipe's ``sensor``."""
    built = sensor_of_values(values, "radar")
    assert isinstance(built, Radar)
    return built


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
        return sensor_of_values({"kind": kind, **base, **sensor}, kind)
    built = sensor_preset(sensor)[1] if isinstance(sensor, str) else sensor
    if not isinstance(built, SENSOR_CLASSES[kind]):
        raise InputTypeError(f"sensor must be a {kind}; got {getattr(built, 'kind', type(built).__name__)}.")
    return built


def overrides_of(recipe: Recipe) -> list[str]:
    """What ``load_recipe`` can be told of a recipe's sensor and transform."""
    kind = recipe.sensor_kind
    return ["sensor", *(["rgb", "through_mosaic"] if kind == "camera" else []), *OPTIONS[kind]]


def refuse_overrides(given: Iterable[str], known: Iterable[str], owner: str) -> None:
    """Raise for an override that is not known, with the nearest one that is."""
    names = list(known)
    for key in given:
        if key not in names:
            raise InputValueError(
                f"{owner}: unknown override {key!r}; known are {', '.join(names)}.{nearest_name(key, names)}"
            )


def built_recipe(recipe: Recipe, weather: Weather, overrides: Mapping[str, Any]) -> nn.Module:
    """The transform of a recipe for a weather, its sensor and options overridden."""
    options = with_depth_source({**recipe.options, **overrides})
    sensor, rgb = options.pop("sensor", None), bool(options.pop("rgb", recipe.rgb))
    mosaic = bool(options.pop("through_mosaic", recipe.through_mosaic))
    built = recipe.build_sensor() if sensor is None else _as_sensor(sensor, recipe)
    transform = transform_class(recipe, weather)(weather, built, **options)
    if not rgb or not isinstance(transform, BayerWeather):
        return transform
    return AsBayer(transform, through_mosaic=mosaic)


def transform_class(recipe: Recipe, weather: Weather) -> type[WeatherTransform]:
    """The recipe's class; for a weather that it does not take, the one that takes any."""
    return class_for(TRANSFORMS[recipe.transform], weather)
