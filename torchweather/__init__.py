"""Physically right rain, fog and snow on automotive camera, LiDAR and radar data."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from torchweather.atmosphere.conditions import RoadSpray, SnowCover, WetRoad, WetWindow
    from torchweather.atmosphere.weather import Fog, Mixture, Rain, Snow
    from torchweather.camera.night.lamps import Lamp, Night
    from torchweather.camera.particles.bank import DrawBank
    from torchweather.camera.rgb import AsBayer
    from torchweather.camera.sensor import Camera
    from torchweather.camera.transform import BayerFog, BayerRain, BayerSnow, BayerWeather, CameraResult
    from torchweather.compose import Compose, RandomFog, RandomRain, RandomSnow, RandomWeather, WeatherDataset
    from torchweather.core.distributions import Choice, LogUniform, Uniform
    from torchweather.evaluation.fit import fit_weather
    from torchweather.lidar.sensor import Lidar
    from torchweather.lidar.transform import LidarFog, LidarRain, LidarResult, LidarSnow, LidarWeather
    from torchweather.pipeline.point_kind import PointKind
    from torchweather.radar.map_transform import RadarMapResult, RadarMapWeather
    from torchweather.radar.sensor import Radar
    from torchweather.radar.transform import RadarAttenuation, RadarResult

__version__ = "0.1.0"

__all__ = [
    "AsBayer",
    "BayerFog",
    "BayerRain",
    "BayerSnow",
    "BayerWeather",
    "Camera",
    "CameraResult",
    "Choice",
    "Compose",
    "DrawBank",
    "Fog",
    "Lamp",
    "Lidar",
    "LidarFog",
    "LidarRain",
    "LidarResult",
    "LidarSnow",
    "LidarWeather",
    "LogUniform",
    "Mixture",
    "Night",
    "PointKind",
    "Radar",
    "RadarAttenuation",
    "RadarMapResult",
    "RadarMapWeather",
    "RadarResult",
    "Rain",
    "RandomFog",
    "RandomRain",
    "RandomSnow",
    "RandomWeather",
    "RoadSpray",
    "Snow",
    "SnowCover",
    "Uniform",
    "WeatherDataset",
    "WetRoad",
    "WetWindow",
    "__version__",
    "fit_weather",
]

# Where each public name lives. It is imported at its first use, so that `torchweather --help` does not load torch.
_HOMES = {
    "torchweather.camera.night.lamps": ("Lamp", "Night"),
    "torchweather.compose": ("Compose", "RandomFog", "RandomRain", "RandomSnow", "RandomWeather", "WeatherDataset"),
    "torchweather.core.distributions": ("Choice", "LogUniform", "Uniform"),
    "torchweather.evaluation.fit": ("fit_weather",),
    "torchweather.sensors": ("Camera", "Lidar", "Radar"),
    "torchweather.stages": ("PointKind",),
    "torchweather.transforms": (
        "AsBayer",
        "BayerFog",
        "BayerRain",
        "BayerSnow",
        "BayerWeather",
        "CameraResult",
        "DrawBank",
        "LidarFog",
        "LidarRain",
        "LidarResult",
        "LidarSnow",
        "LidarWeather",
        "RadarAttenuation",
        "RadarMapResult",
        "RadarMapWeather",
        "RadarResult",
    ),
    "torchweather.atmosphere.conditions": ("RoadSpray", "SnowCover", "WetRoad", "WetWindow"),
    "torchweather.atmosphere.weather": ("Fog", "Mixture", "Rain", "Snow"),
}
# Parts of the library that `torchweather.<part>` reaches without an import of its own.
_PARTS = frozenset(
    {
        *("camera", "compose", "evaluation", "export", "gap", "image", "io", "lidar", "metrics", "physics", "radar"),
        *("recipes", "robustness", "scenes", "stages", "sweep", "transforms"),
    }
)
_HOME_OF = {name: home for home, names in _HOMES.items() for name in names}


def __getattr__(name: str) -> Any:
    if name in _PARTS:
        return importlib.import_module(f"{__name__}.{name}")
    home = _HOME_OF.get(name)
    if home is None:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(importlib.import_module(home), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__, *_PARTS})
