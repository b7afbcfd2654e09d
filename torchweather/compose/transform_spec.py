"""Specification of a transform: its class, sensor and options, from which it is built again for another weather."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Generic, TypeVar

from torch import nn

from torchweather.atmosphere.weather import Weather
from torchweather.camera.rgb import AsBayer
from torchweather.camera.transform import BayerFog, BayerRain, BayerSnow, BayerWeather
from torchweather.core.distributions import Distribution, with_drawn
from torchweather.core.errors import InputTypeError
from torchweather.lidar.transform import LidarFog, LidarRain, LidarSnow, LidarWeather
from torchweather.pipeline.sensor import Sensor
from torchweather.pipeline.sensor_transform import WeatherTransform, class_for
from torchweather.radar.transform import RadarAttenuation

__all__ = ["TRANSFORMS", "TransformClass", "TransformSpec", "class_for", "sensor_of", "spec_of"]

S = TypeVar("S", bound=Sensor)
TransformClass = type[WeatherTransform]
OF_CAMERA: tuple[TransformClass, ...] = (BayerRain, BayerFog, BayerSnow, BayerWeather)
OF_LIDAR: tuple[TransformClass, ...] = (LidarRain, LidarFog, LidarSnow, LidarWeather)
TRANSFORMS: dict[str, TransformClass] = {
    transform.__name__: transform for transform in (*OF_CAMERA, *OF_LIDAR, RadarAttenuation)
}
"""By name."""


def sensor_of(transform: WeatherTransform) -> Sensor:
    """The sensor that a transform was built for."""
    return transform.own_sensor()


@dataclass(frozen=True, eq=False)
class TransformSpec(Generic[S]):
    """Everything that a transform is built from but its weather.

    Args:
        kind: its class.
        sensor: that it was built for.
        options: keyword arguments of its constructor.
        data_shape: dimensions of the data of one sample.
        extra_inputs: arguments of a call beside the data and the noise, and their dimensions in one sample.
        rgb: whether it is inside ``AsBayer``.
        through_mosaic, method: of ``AsBayer``.
        nuisances: what is drawn for each sample among options, effects and the sensor's fields, by name.
    """

    kind: TransformClass
    sensor: S
    options: Mapping[str, Any]
    data_shape: tuple[str, ...]
    extra_inputs: Mapping[str, int]
    rgb: bool = False
    through_mosaic: bool = False
    method: str = "malvar"
    nuisances: Mapping[str, Distribution] = field(default_factory=dict)

    @property
    def by_look_ups(self) -> bool:
        """True where rain and snow come from a bank onto RGB images (``quality="training"``)."""
        return self.rgb and not self.through_mosaic and self.options["quality"] != "exact"

    def build(self, weather: Weather, drawn: Mapping[str, Any] | None = None) -> Any:
        """The transform for a weather.

        Args:
            weather: of the sample.
            drawn: values of ``nuisances`` by name.
        """
        kind: Any = class_for(self.kind, weather)
        values = {} if drawn is None else drawn
        options = {name: with_drawn(one, values, name) for name, one in self.options.items()}
        built = kind(weather, with_drawn(self.sensor, values, "sensor"), **options)
        return AsBayer(built, through_mosaic=self.through_mosaic, method=self.method) if self.rgb else built


def spec_of(transform: nn.Module) -> TransformSpec[Any]:
    """Specification of a ready-made transform, or of ``AsBayer`` around one.

    Raises:
        TypeError: it is none.
        ValueError: its chain was changed after it was built.
    """
    inner = transform.transform if isinstance(transform, AsBayer) else transform
    if not isinstance(inner, WeatherTransform):
        raise InputTypeError(
            f"expected a transform of weather ({', '.join(TRANSFORMS)}, RadarMapWeather, or AsBayer around one "
            f"of a camera); got {type(transform).__name__}."
        )
    nuisances = inner.nuisances
    outer = transform if isinstance(transform, AsBayer) else inner
    options = inner.options.arguments()
    spec: TransformSpec[Any] = TransformSpec(
        type(inner), inner.own_sensor(), options, outer.data_shape, outer.extra_inputs, nuisances=nuisances
    )
    inner.refuse_changes()
    if isinstance(transform, AsBayer):
        return replace(spec, rgb=True, through_mosaic=transform.through_mosaic, method=transform.method)
    return spec
