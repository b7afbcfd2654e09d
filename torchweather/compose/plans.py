"""How a transform is built: its class, sensor and options, so that the same can be built for another weather."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

from torch import nn

from torchweather.atmosphere.weather import Weather
from torchweather.camera.rgb import AsBayer
from torchweather.camera.sensor import Camera
from torchweather.camera.transform import BayerFog, BayerRain, BayerSnow, BayerWeather
from torchweather.core.errors import InputTypeError
from torchweather.lidar.sensor import Lidar
from torchweather.lidar.transform import LidarFog, LidarRain, LidarSnow, LidarWeather
from torchweather.pipeline.sensor_transform import WeatherTransform, class_for
from torchweather.radar.map_transform import RadarMapWeather
from torchweather.radar.sensor import Radar
from torchweather.radar.transform import RadarAttenuation

__all__ = ["TRANSFORMS", "Plan", "TransformClass", "class_for", "plan_of", "sensor_of"]

TransformClass = type[BayerWeather] | type[LidarWeather] | type[RadarAttenuation] | type[RadarMapWeather]
OF_CAMERA: tuple[TransformClass, ...] = (BayerRain, BayerFog, BayerSnow, BayerWeather)
OF_LIDAR: tuple[TransformClass, ...] = (LidarRain, LidarFog, LidarSnow, LidarWeather)
TRANSFORMS: dict[str, TransformClass] = {
    transform.__name__: transform for transform in (*OF_CAMERA, *OF_LIDAR, RadarAttenuation)
}
"""By name."""


def sensor_of(transform: WeatherTransform) -> Camera | Lidar | Radar:
    """The sensor that a transform was built for."""
    sensor = transform.own_sensor()
    assert isinstance(sensor, (Camera, Lidar, Radar))
    return sensor


@dataclass(frozen=True, eq=False)
class Plan:
    """All that a transform is but its weather.

    Args:
        kind: its class.
        sensor: that it was built for.
        options: keyword arguments of its constructor.
        rgb: whether it is inside ``AsBayer``.
        through_mosaic, method: of ``AsBayer``.
    """

    kind: TransformClass
    sensor: Camera | Lidar | Radar
    options: Mapping[str, Any]
    rgb: bool = False
    through_mosaic: bool = False
    method: str = "malvar"

    @property
    def dimensions(self) -> int:
        """Of the data of one sample: an image's, a map's, or those of a list of points."""
        if isinstance(self.sensor, Camera):
            return 3
        return len(self.options["axes"].dims) if issubclass(self.kind, RadarMapWeather) else 2

    def build(self, weather: Weather) -> Any:
        """The transform for a weather."""
        built = class_for(self.kind, weather)(weather, self.sensor, **self.options)
        if not self.rgb:
            return built
        assert isinstance(built, BayerWeather)
        return AsBayer(built, through_mosaic=self.through_mosaic, method=self.method)


def plan_of(transform: nn.Module) -> Plan:
    """How a ready-made transform, or ``AsBayer`` around one, was built.

    Raises:
        TypeError: it is none.
        ValueError: its chain was changed after it was built.
    """
    inner = transform.transform if isinstance(transform, AsBayer) else transform
    if not isinstance(inner, (BayerWeather, LidarWeather, RadarAttenuation, RadarMapWeather)):
        raise InputTypeError(
            f"wanted a transform of weather ({', '.join(TRANSFORMS)}, RadarMapWeather, or AsBayer around one "
            f"of a camera); got {type(transform).__name__}."
        )
    plan = Plan(type(inner), sensor_of(inner), inner.options.arguments())
    inner.refuse_changes()
    if isinstance(transform, AsBayer):
        return replace(plan, rgb=True, through_mosaic=transform.through_mosaic, method=transform.method)
    return plan
