"""The ready-made transforms: short constructors over chains."""

from torchweather.transforms.as_bayer import AsBayer
from torchweather.transforms.camera import BayerFog, BayerRain, BayerSnow, BayerWeather, CameraResult

__all__ = ["AsBayer", "BayerFog", "BayerRain", "BayerSnow", "BayerWeather", "CameraResult"]
