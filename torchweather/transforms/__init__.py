"""The ready-made transforms: short constructors over chains."""

from torchweather.core.moved import moved
from torchweather.transforms.as_bayer import AsBayer
from torchweather.transforms.camera import BayerFog, BayerRain, BayerSnow, BayerWeather, CameraResult
from torchweather.transforms.lidar import LidarFog, LidarRain, LidarResult, LidarSnow, LidarWeather
from torchweather.transforms.radar import RadarAttenuation, RadarResult
from torchweather.transforms.radar_map import RadarMapResult, RadarMapWeather

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
    "RadarMapResult",
    "RadarMapWeather",
    "RadarResult",
]

__getattr__ = moved(
    __name__,
    {
        "torchweather.compose": (
            *("Compose", "Draw", "RandomFog", "RandomRain", "RandomSnow", "RandomWeather", "WeatherDataset"),
        )
    },
)
