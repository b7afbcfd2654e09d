"""The ready-made transforms: short constructors over chains."""

from torchweather.transforms.as_bayer import AsBayer
from torchweather.transforms.camera import BayerFog, BayerRain, BayerSnow, BayerWeather, CameraResult
from torchweather.transforms.compose import Compose, Draw
from torchweather.transforms.lidar import LidarFog, LidarRain, LidarResult, LidarSnow, LidarWeather
from torchweather.transforms.radar import RadarAttenuation, RadarResult
from torchweather.transforms.radar_map import RadarMapResult, RadarMapWeather
from torchweather.transforms.random_weather import RandomFog, RandomRain, RandomSnow, RandomWeather
from torchweather.transforms.weather_dataset import WeatherDataset

__all__ = [
    "AsBayer",
    "BayerFog",
    "BayerRain",
    "BayerSnow",
    "BayerWeather",
    "CameraResult",
    "Compose",
    "Draw",
    "LidarFog",
    "LidarRain",
    "LidarResult",
    "LidarSnow",
    "LidarWeather",
    "RadarAttenuation",
    "RadarMapResult",
    "RadarMapWeather",
    "RadarResult",
    "RandomFog",
    "RandomRain",
    "RandomSnow",
    "RandomWeather",
    "WeatherDataset",
]
