"""The ready-made transforms: short constructors over chains."""

from torchweather.camera.hdr import HdrResult, HdrWeather
from torchweather.camera.particles.bank import DrawBank
from torchweather.camera.rgb import AsBayer
from torchweather.camera.thermal import ThermalWeather
from torchweather.camera.transform import BayerFog, BayerRain, BayerSnow, BayerWeather, CameraResult
from torchweather.core.moved import moved
from torchweather.lidar.transform import LidarFog, LidarRain, LidarResult, LidarSnow, LidarWeather
from torchweather.radar.map_transform import RadarMapResult, RadarMapWeather
from torchweather.radar.transform import RadarAttenuation, RadarResult

__all__ = [
    "AsBayer",
    "BayerFog",
    "BayerRain",
    "BayerSnow",
    "BayerWeather",
    "CameraResult",
    "DrawBank",
    "HdrResult",
    "HdrWeather",
    "LidarFog",
    "LidarRain",
    "LidarResult",
    "LidarSnow",
    "LidarWeather",
    "RadarAttenuation",
    "RadarMapResult",
    "RadarMapWeather",
    "RadarResult",
    "ThermalWeather",
]

__getattr__ = moved(
    __name__,
    {
        "torchweather.compose": (
            *("Compose", "Draw", "RandomFog", "RandomRain", "RandomSnow", "RandomWeather", "WeatherDataset"),
        )
    },
)
