"""How a transform is built: its class, sensor and options, so that the same can be built for another weather."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

from torch import Tensor, nn

from torchweather.sensors import Camera, Lidar, Radar
from torchweather.transforms.as_bayer import AsBayer
from torchweather.transforms.camera import BayerFog, BayerRain, BayerSnow, BayerWeather
from torchweather.transforms.lidar import LidarFog, LidarRain, LidarSnow, LidarWeather
from torchweather.transforms.radar import RadarAttenuation
from torchweather.transforms.radar_map import RadarMapWeather
from torchweather.weather import Weather

__all__ = ["TRANSFORMS", "Plan", "TransformClass", "class_for", "plan_of", "sensor_of"]

TransformClass = type[BayerWeather] | type[LidarWeather] | type[RadarAttenuation] | type[RadarMapWeather]
OF_CAMERA: tuple[TransformClass, ...] = (BayerRain, BayerFog, BayerSnow, BayerWeather)
OF_LIDAR: tuple[TransformClass, ...] = (LidarRain, LidarFog, LidarSnow, LidarWeather)
TRANSFORMS: dict[str, TransformClass] = {
    transform.__name__: transform for transform in (*OF_CAMERA, *OF_LIDAR, RadarAttenuation)
}
"""By name."""


def class_for(kind: TransformClass, weather: Weather) -> TransformClass:
    """The class; for a weather that it does not take, the one that takes any."""
    if all(part.kind in kind.takes for part in weather.parts):
        return kind
    return TRANSFORMS[kind.takes_all]


def sensor_of(transform: BayerWeather | LidarWeather | RadarAttenuation | RadarMapWeather) -> Camera | Lidar | Radar:
    """The sensor that a transform was built for."""
    return transform.camera if isinstance(transform, BayerWeather) else transform.sensor


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
        built = class_for(self.kind, weather)(weather, self.sensor, **self.options)  # type: ignore[arg-type]
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
        raise TypeError(
            f"wanted a transform of weather ({', '.join(TRANSFORMS)}, RadarMapWeather, or AsBayer around one "
            f"of a camera); got {type(transform).__name__}."
        )
    plan = Plan(type(inner), sensor_of(inner), dict(inner.given))
    changed = _changed(inner, plan.build(inner.weather))
    if changed:
        raise ValueError(f"{type(inner).__name__}: {changed}; it cannot be built anew. Give changes as effects=[...].")
    if isinstance(transform, AsBayer):
        return replace(plan, rgb=True, through_mosaic=transform.through_mosaic, method=transform.method)
    return plan


def _changed(transform: Any, again: Any) -> str:
    """In words, what of a transform's chain is not what its constructor makes; empty where it is the same."""
    if list(again.chain.stages) != list(transform.chain.stages):
        return (
            f"the chain has the stages {', '.join(transform.chain.stages)}, the transform makes "
            f"{', '.join(again.chain.stages)}"
        )
    if again.chain.to_dict() != transform.chain.to_dict():
        return "a stage of the chain was changed after the transform was built"
    was, now = transform.state_dict(), again.state_dict()
    other = [name for name, value in now.items() if not _same(value, was[name])]
    if other:
        return f"{other[0].removeprefix('chain._stages.')} was changed after the transform was built"
    return ""


def _same(value: Tensor, was: Tensor) -> bool:
    """Whether a buffer is what the constructor made it, wherever the transform was moved since."""
    was = was.to(value)
    return value.shape == was.shape and bool(((value == was) | (value.isnan() & was.isnan())).all())
