"""One weather on all sensors of a sample, on photographs and on data sets; batches of clouds of different length."""

from torchweather.compose.batches import (
    collate_indexed,
    collate_list,
    collate_padded,
    join_indexed,
    split_indexed,
    split_padded,
)
from torchweather.compose.collate import CLOUDS_AS, Collate
from torchweather.compose.compose import Compose, Draw
from torchweather.compose.random_weather import RandomFog, RandomRain, RandomSnow, RandomWeather
from torchweather.compose.weather_dataset import WeatherDataset

__all__ = [
    "collate_indexed",
    "collate_list",
    "collate_padded",
    "join_indexed",
    "split_indexed",
    "split_padded",
    "CLOUDS_AS",
    "Collate",
    "Compose",
    "Draw",
    "RandomFog",
    "RandomRain",
    "RandomSnow",
    "RandomWeather",
    "WeatherDataset",
]
