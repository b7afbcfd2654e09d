"""A recipe of kind transform: a weather, a sensor, and a transform with its options."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar

from torch import nn

from torchweather.atmosphere.weather import Weather, parse_weather, weather_from_dict
from torchweather.camera.depth import AUTO, FlatGround
from torchweather.camera.rgb import AsBayer
from torchweather.camera.sensor import Camera
from torchweather.compose.transform_spec import TRANSFORMS
from torchweather.core.distributions import with_distributions
from torchweather.core.errors import InputTypeError, InputValueError, TorchweatherError, nearest_name
from torchweather.core.schema import TEXT, Key, check_keys, check_value, field_keys, one_of, refuse_unknown
from torchweather.lidar.sensor import Lidar
from torchweather.pipeline.sensor_transform import WeatherTransform, class_for
from torchweather.radar.sensor import Radar
from torchweather.recipes.files import name_of
from torchweather.recipes.options import FLAGS, GROUND, OPTIONS, current_names
from torchweather.sensors import SENSOR_CLASSES, sensor_preset

__all__ = ["TransformRecipe", "checked_transform", "refuse_overrides", "transform_class"]

DEPTH = Key(f"metres, {GROUND!r} or {AUTO!r}", lambda value: not isinstance(value, str) or value in (GROUND, AUTO))
camera_of, lidar_of, radar_of = Camera.from_values, Lidar.from_values, Radar.from_values


@dataclass(frozen=True)
class TransformRecipe:
    """A weather on one sensor, as its file states it.

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

    kind: ClassVar[str] = "transform"
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
        """``camera``, ``lidar`` or ``radar``, as the transform takes it."""
        return TRANSFORMS[self.transform].sensor_class.kind

    @property
    def sensor_name(self) -> str:
        """``kind:preset``, or the kind where the fields are given."""
        preset = self.sensor.get("preset")
        return f"{self.sensor['kind']}:{preset}" if preset else str(self.sensor["kind"])

    @property
    def overrides(self) -> list[str]:
        """Names of what ``for_weather`` can replace."""
        return ["sensor", *FLAGS[self.sensor_kind], *OPTIONS[self.sensor_kind]]

    def build_weather(self) -> Weather:
        """The weather object."""
        return weather_from_dict(self.weather)

    def build_sensor(self) -> Camera | Lidar | Radar:
        """The sensor object."""
        return SENSOR_CLASSES[self.sensor_kind].from_values(self.sensor)

    def build_camera(self) -> Camera:
        """The camera object."""
        return camera_of(self.sensor)

    def build(self, **overrides: Any) -> nn.Module:
        """The transform, ready to call; the overrides are those of ``load_recipe``."""
        overrides = current_names(overrides, "load_recipe")
        refuse_overrides(overrides, ["weather", *self.overrides], "load_recipe")
        weather = overrides.pop("weather", None)
        try:
            return self.for_weather(self.build_weather() if weather is None else as_weather(weather), overrides)
        except (TypeError, ValueError) as error:
            raise TorchweatherError(f"{self.path or self.name}: {error}") from error

    def for_weather(self, weather: Weather, overrides: Mapping[str, Any]) -> nn.Module:
        """The transform for a weather, its sensor and options overridden."""
        options = with_depth_source({**self.options, **overrides})
        sensor, rgb = options.pop("sensor", None), bool(options.pop("rgb", self.rgb))
        mosaic = bool(options.pop("through_mosaic", self.through_mosaic))
        built = self.build_sensor() if sensor is None else self._as_sensor(sensor)
        transform: Any = transform_class(self, weather)(weather, built, **options)
        return AsBayer(transform, through_mosaic=mosaic) if rgb else transform

    def _as_sensor(self, sensor: Any) -> Camera | Lidar | Radar:
        kind = self.sensor_kind
        if isinstance(sensor, Mapping):
            base = {} if "preset" in sensor else self.sensor
            return SENSOR_CLASSES[kind].from_values({"kind": kind, **base, **sensor})
        built = sensor_preset(sensor)[1] if isinstance(sensor, str) else sensor
        if not isinstance(built, SENSOR_CLASSES[kind]):
            raise InputTypeError(f"sensor must be a {kind}; got {getattr(built, 'kind', type(built).__name__)}.")
        return built


def checked_transform(values: Mapping[str, Any], path: Path, at: str = "") -> TransformRecipe:
    """The recipe of a file's values, whose keys are of the schema.

    Args:
        values: of the file, or of one of its ``transforms`` with the title and a weather.
        path: the file.
        at: dotted key of the values in the file, with a dot at its end.

    Raises:
        TorchweatherError: with the file and the key.
    """
    transform = values["transform"]
    given = current_names(values.get("options") or {}, f"{path}: {at}options")
    options = {name: with_distributions(one, owner=f"{path}: {at}options.{name}") for name, one in given.items()}
    kind = TRANSFORMS[transform].sensor_class.kind
    check_keys(values["sensor"], sensor_keys(kind), str(path), f"{at}sensor")
    refuse_unknown(options, OPTIONS[kind], f"{at}options", str(path))
    check_value(options.get("depth"), DEPTH, str(path), f"{at}options.depth")
    for key in ("rgb", "through_mosaic"):
        if values.get(key, False) and key not in FLAGS[kind]:
            raise TorchweatherError(f"{path}: {at}{key} is for a camera; the transform is {transform}. Leave it out.")
    if values.get("through_mosaic", False) and not values.get("rgb", False):
        raise TorchweatherError(f"{path}: {at}through_mosaic is for RGB images; add rgb: true, or leave it out.")
    recipe = TransformRecipe(
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
    for key, build in (("weather", recipe.build_weather), ("sensor", recipe.build_sensor)):
        try:
            build()
        except (TypeError, ValueError, KeyError) as error:
            raise TorchweatherError(f"{path}: {at}{key}: {error}") from error
    return recipe


def transform_class(recipe: TransformRecipe, weather: Weather) -> type[WeatherTransform]:
    """The recipe's class; for a weather that it does not take, the one that takes any."""
    return class_for(TRANSFORMS[recipe.transform], weather)


def with_depth_source(options: Mapping[str, Any]) -> dict[str, Any]:
    """Options with the depth source that ``ground`` stands for; ``auto`` is known to the transform."""
    return {key: FlatGround() if key == "depth" and one == GROUND else one for key, one in options.items()}


def sensor_keys(kind: str) -> dict[str, Key]:
    """Keys of a recipe's ``sensor``."""
    return {"kind": one_of([kind]).needed, "preset": TEXT.or_null, **field_keys(SENSOR_CLASSES[kind])}


def as_weather(weather: Any) -> Weather:
    """A weather from an object, text such as ``rain:rate=25``, or plain values."""
    if isinstance(weather, str):
        return parse_weather(weather)
    built: Weather = weather_from_dict(weather) if isinstance(weather, Mapping) else weather
    return built


def refuse_overrides(given: Iterable[str], known: Iterable[str], owner: str) -> None:
    """Raise for an override that is not known, with the nearest one that is."""
    names = list(known)
    for key in given:
        if key not in names:
            raise InputValueError(
                f"{owner}: unknown override {key!r}; known are {', '.join(names)}.{nearest_name(key, names)}"
            )
