"""Model properties of a graph: version, transform, equations, units, seed protocol."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

import torchweather
from torchweather.atmosphere.weather import Weather
from torchweather.export.feed import LEVELS_KEY, METADATA_KEY, TRANSFORM_KEY, UNITS_KEY, variates_to_metadata
from torchweather.export.traceable import Traceable
from torchweather.pipeline.sensor import Sensor
from torchweather.pipeline.sensor_transform import WeatherTransform

__all__ = ["described", "described_sensor", "model_properties", "sections_of", "set_properties"]

# Sections of docs/PHYSICS.md by the kind of weather.
OF_WEATHER = {"rain": "2.2, 2.5, 3", "fog": "2.3, 3", "snow": "2.4, 2.5, 3"}
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
LAWS = {
    "uniform": "uniform in [0, 1)",
    "normal": "standard normal",
    "tabulated_normal": "standard normal, one of 65,536 values",
    "exponential": "exponential of mean 1",
    "points": "uniforms of a Poisson number of points, in rising order of the last column, which marks unused slots",
}
SEEDS = (
    "One integer a sample. Each noise input <stage>.<variate> has its own numpy Philox stream, key (seed mod 2^64, "
    "blake2b-64 of the input's name, little endian). torchweather.export.draw_feed fills the inputs with numpy alone."
)


def model_properties(traceable: Traceable) -> dict[str, str]:
    """Name to text; what is not plain text is JSON."""
    sections = list(dict.fromkeys(", ".join(traceable.sections).split(", ")))
    named = "sections" if len(sections) > 1 else "section"
    units = {**UNITS, **{name: LAWS[variate.law] for name, variate in traceable.variates.items()}, **traceable.units}
    return {
        "torchweather_version": torchweather.__version__,
        TRANSFORM_KEY: json.dumps(traceable.described, default=_number),
        "torchweather_equations": f"docs/PHYSICS.md, {named} {', '.join(sections)}",
        UNITS_KEY: json.dumps({name: units[name] for name in traceable.inputs}),
        "torchweather_seeds": SEEDS,
        METADATA_KEY: variates_to_metadata(traceable.variates),
        LEVELS_KEY: json.dumps(traceable.levels),
    }


def set_properties(model: Any, properties: Mapping[str, str]) -> None:
    """Put them into a model (``onnx.ModelProto``); those of the same name are replaced."""
    kept = [(entry.key, entry.value) for entry in model.metadata_props if entry.key not in properties]
    del model.metadata_props[:]
    for key, value in (*kept, *properties.items()):
        entry = model.metadata_props.add()
        entry.key, entry.value = key, value


def described_sensor(name: str, sensor: Sensor) -> dict[str, Any]:
    """Name of a class of transforms and its sensor, as plain values."""
    values = sensor.to_dict()
    values.pop("directions", None)  # of the data; where they matter they are an input
    return {"class": name, "sensor": {"kind": sensor.kind, **values}}


def described(transform: WeatherTransform, **more: Any) -> dict[str, Any]:
    """A transform as plain values: class, sensor, what more is given, weather and stages."""
    own = described_sensor(type(transform).__name__, transform.own_sensor())
    return {**own, **more, "weather": transform.weather.to_dict(), "stages": list(transform.chain.stages)}


def sections_of(weather: Weather) -> list[str]:
    """Sections of docs/PHYSICS.md on a weather."""
    return [OF_WEATHER[part.kind] for part in weather.parts]


def _number(value: Any) -> Any:
    """A tensor (a weather intensity) as numbers."""
    return value.tolist()
