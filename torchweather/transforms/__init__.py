"""The ready-made transforms: short constructors over chains."""

from torchweather.transforms.as_bayer import AsBayer
from torchweather.transforms.camera import BayerFog, BayerRain, BayerSnow, BayerWeather, CameraResult
from torchweather.transforms.lidar import LidarFog, LidarRain, LidarResult, LidarSnow, LidarWeather
from torchweather.transforms.radar import RadarAttenuation, RadarResult

__all__ = [
    "AsBayer",
    "BayerFog",
    "BayerRain",
    "BayerSnow",
    "BayerWeather",
    "CameraResult",
    "LidarFog",
    "LidarRain",
    "LidarResult",
    "LidarSnow",
    "LidarWeather",
    "RadarAttenuation",
    "RadarResult",
]
