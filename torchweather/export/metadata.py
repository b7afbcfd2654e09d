"""What a graph says of itself in its model properties: version, transform, equations, units, seed protocol."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any

import torchweather
from torchweather.camera.rgb import AsBayer
from torchweather.camera.transform import BayerWeather
from torchweather.export.feed import METADATA_KEY, TRANSFORM_KEY, variates_to_metadata
from torchweather.export.traceable import Traceable
from torchweather.lidar.transform import LidarWeather
from torchweather.radar import RangeDopplerMap
from torchweather.radar.transform import RadarAttenuation

__all__ = ["model_properties", "set_properties"]

# Sections of docs/PHYSICS.md by the sensor and by the kind of weather.
OF_SENSOR = {"camera": "4", "lidar": "5", "radar": "6.2, 6.5-6.8"}
OF_WEATHER = {"rain": "2.2, 2.5, 3", "fog": "2.3, 3", "snow": "2.4, 2.5, 3"}
MAP_SECTION = "6.4"
UNITS = {
    "bayer": "linear in light: 0 black, 1 saturation",
    "rgb": "sRGB-encoded, 0 to 1; so is the output",
    "sky": "share of the pixel that shows the sky, 0 to 1",
    "near_mask": "share of the pixel that shows the own vehicle, 0 to 1",
    "depth": "m along the optical axis; inf is the sky",
    "fx": "px",
    "fy": "px",
    "cx": "px, the middle of the top-left pixel is 0",
    "cy": "px, the middle of the top-left pixel is 0",
    "directions": "unit vectors, x forward, y left, z up",
    "reach_m": "m, way of beams without return to their end",
    "rate_mm_per_h": "mm/h, liquid equivalent",
    "rain_rate_mm_per_h": "mm/h",
    "snow_rate_mm_per_h": "mm/h, liquid equivalent",
    "mor_m": "m, meteorological optical range (contrast 5 %)",
    "real": "V",
    "imaginary": "V",
}
POINTS = {
    "lidar": "x, y, z in m (x forward, y left, z up), intensity in the sensor's unit, further columns carried along",
    "radar": "x, y, z in m, radial speed in m/s, power in dB, cross section in dBsm, further columns carried along",
}
LAWS = {
    "uniform": "uniform in [0, 1)",
    "normal": "standard normal",
    "exponential": "exponential of mean 1",
    "points": "uniforms of a Poisson number of points; unused slots marked in the last column",
}
SEEDS = (
    "One integer a sample. Each noise input <stage>.<variate> has its own numpy Philox stream, key (seed mod 2^64, "
    "blake2b-64 of the input's name, little endian). torchweather.export.draw_feed fills the inputs with numpy alone."
)


def model_properties(transform: object, traceable: Traceable) -> dict[str, str]:
    """Name to text; what is not plain text is JSON."""
    weather = transform.transform if isinstance(transform, AsBayer) else transform
    found = {
        "torchweather_version": torchweather.__version__,
        TRANSFORM_KEY: json.dumps(_plain(weather, traceable)),
        "torchweather_equations": _equations(weather),
        "torchweather_units": json.dumps({name: _unit(name, weather, traceable) for name in traceable.inputs}),
        "torchweather_seeds": SEEDS,
    }
    return {**found, METADATA_KEY: variates_to_metadata(traceable.variates)}


def set_properties(model: Any, properties: Mapping[str, str]) -> None:
    """Put them into a model (``onnx.ModelProto``); those of the same name are replaced."""
    kept = [(entry.key, entry.value) for entry in model.metadata_props if entry.key not in properties]
    del model.metadata_props[:]
    for key, value in (*kept, *properties.items()):
        entry = model.metadata_props.add()
        entry.key, entry.value = key, value


def _kind(transform: object) -> str:
    if isinstance(transform, LidarWeather):
        return "lidar"
    return "camera" if isinstance(transform, BayerWeather) else "radar"


def _plain(transform: Any, traceable: Traceable) -> dict[str, Any]:
    if isinstance(transform, (LidarWeather, RadarAttenuation)):
        sensor = transform.sensor.to_dict()
    else:
        sensor = (transform.camera if isinstance(transform, BayerWeather) else transform.radar).to_dict()
    sensor.pop("directions", None)  # of the data; where they matter they are an input
    found = {"class": type(transform).__name__, "sensor": {"kind": _kind(transform), **sensor}}
    if isinstance(transform, BayerWeather):
        found["image"] = traceable.inputs[0]
    if not isinstance(transform, RangeDopplerMap):
        found["weather"] = transform.weather.to_dict()
        found["stages"] = list(transform.chain.stages)
    plain: dict[str, Any] = json.loads(json.dumps(found, default=_number))
    return plain


def _number(value: Any) -> Any:
    """A tensor (a knob) as numbers."""
    return value.tolist()


def _equations(transform: Any) -> str:
    if isinstance(transform, RangeDopplerMap):
        return f"docs/PHYSICS.md, section {MAP_SECTION}"
    kinds = [part.kind for part in transform.weather.parts]
    sections: Sequence[str] = [OF_SENSOR[_kind(transform)], *(OF_WEATHER[kind] for kind in kinds)]
    return "docs/PHYSICS.md, sections " + ", ".join(dict.fromkeys(", ".join(sections).split(", ")))


def _unit(name: str, transform: object, traceable: Traceable) -> str:
    if name in traceable.variates:
        return LAWS[traceable.variates[name].law]
    return POINTS[_kind(transform)] if name == "points" else UNITS[name]
