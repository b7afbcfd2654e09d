"""Options have the names and the defaults of the constructor's keyword arguments."""

from __future__ import annotations

import inspect
from dataclasses import MISSING, fields

import pytest

from torchweather.camera.options import CameraOptions
from torchweather.camera.transform import BayerWeather
from torchweather.lidar.options import LidarOptions
from torchweather.lidar.transform import LidarWeather
from torchweather.pipeline.options import TransformOptions
from torchweather.pipeline.sensor_transform import WeatherTransform
from torchweather.radar.map_options import RadarMapOptions
from torchweather.radar.map_transform import RadarMapWeather
from torchweather.radar.options import RadarOptions
from torchweather.radar.transform import RadarAttenuation


@pytest.mark.parametrize(
    ("transform", "options"),
    [
        (BayerWeather, CameraOptions),
        (LidarWeather, LidarOptions),
        (RadarAttenuation, RadarOptions),
        (RadarMapWeather, RadarMapOptions),
    ],
)
def test_options_are_the_constructor_s(transform: type[WeatherTransform], options: type[TransformOptions]) -> None:
    parameters = inspect.signature(transform.__init__).parameters.values()
    keywords = {one.name: one.default for one in parameters if one.kind is inspect.Parameter.KEYWORD_ONLY}
    needed = {name for name, default in keywords.items() if default is inspect.Parameter.empty}
    assert options.defaults() == {name: default for name, default in keywords.items() if name not in needed}
    assert needed == {one.name for one in fields(options) if one.default is MISSING}
    made = options(**dict.fromkeys(needed))
    assert list(made.arguments()) == list(keywords)
