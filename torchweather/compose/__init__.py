"""One weather on all sensors of a sample, on photographs, and on data sets."""

from torchweather.compose.compose import Compose, Draw
from torchweather.compose.random_weather import RandomFog, RandomRain, RandomSnow, RandomWeather
from torchweather.compose.weather_dataset import WeatherDataset

__all__ = [
    "Compose",
    "Draw",
    "RandomFog",
    "RandomRain",
    "RandomSnow",
    "RandomWeather",
    "WeatherDataset",
]
