"""Plausible values of the defaults, each with its source."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from torchweather.atmosphere.weather import Fog, Rain, Snow, Weather
from torchweather.camera.sensor import Camera
from torchweather.core.arguments import check_arguments
from torchweather.lidar.sensor import Lidar
from torchweather.physics import FOG, RAIN, SNOW
from torchweather.radar.sensor import Radar

__all__ = ["Change", "changes"]

ASSUMED = "assumption"
Known = Camera | Lidar | Radar


@dataclass(frozen=True)
class Change:
    """One default at another value that is as plausible.

    Args:
        default: name of the default that is changed.
        value: in words.
        source: of the value.
        sensor, option, weather: fields of the sensor, options of the transform and fields of the weather that change.
    """

    default: str
    value: str
    source: str
    sensor: Mapping[str, Any] = field(default_factory=dict)
    option: Mapping[str, Any] = field(default_factory=dict)
    weather: Mapping[str, Any] = field(default_factory=dict)

    def of_sensor(self, sensor: Known) -> Known:
        """The sensor with this change."""
        return replace(sensor, **self.sensor)

    def of_weather(self, weather: Weather) -> Weather:
        """The weather with this change."""
        assert isinstance(weather, (Rain, Fog, Snow))  # `changes` knows no others
        return replace(weather, **self.weather)


def _near(value: str, source: str, start: float, full: float, power: float) -> Change:
    near = {"near_start_m": start, "near_full_m": full, "near_power": power}
    return Change("near response", value, source, sensor=near)


def _pairs(default: str, where: str, name: str, values: tuple[Any, ...], source: str, unit: str = "") -> list[Change]:
    found = []
    for value in values:
        text = value if isinstance(value, str) else f"{value:g}{unit}"
        parts: dict[str, Any] = {where: {name: value}}
        found.append(Change(default, text, source, **parts))
    return found


LIDAR = (
    _near("(R / 30 m)^2", "OS2, one frame (PHYSICS.md 10.13)", 0.0, 30.0, 2.0),
    _near("(R / 10 m)^2", "upper end of PHYSICS.md 10.13", 0.0, 10.0, 2.0),
    _near("full from 1 m", "Hahner et al. 2021 (PHYSICS.md 5.3)", 0.9, 1.0, 1.0),
    *_pairs("pulse width", "sensor", "pulse_width_ns", (5.0, 15.0), ASSUMED, " ns"),
    *_pairs("margin of returns", "sensor", "margin_db", (0.5, 3.0), ASSUMED, " dB"),
)
EFFICIENCY = "PHYSICS.md 3.2: diffracted light in the beam or not"
LIDAR_OF: Mapping[str, tuple[Change, ...]] = {
    "rain": (
        *_pairs("backscatter efficiency", "option", "q_back", (0.094, 0.6), "PHYSICS.md 3.2"),
        *_pairs("extinction efficiency", "option", "q_eff", (1.0, 2.0), EFFICIENCY),
    ),
    "snow": (
        *_pairs("flake reflectivity", "weather", "flake_reflectivity", (0.125, 0.5), "PHYSICS.md 10.3"),
        *_pairs("extinction efficiency", "option", "q_eff", (1.0, 2.0), EFFICIENCY),
    ),
    "fog": (
        *_pairs("receiver", "option", "receiver", ("matched",), "PHYSICS.md 10.5"),
        *_pairs("backscatter law", "option", "fog_backscatter", ("hahner",), "Hahner et al. 2021"),
    ),
}
CAMERA_OF: Mapping[str, tuple[Change, ...]] = {
    "rain": (*_pairs("exposure time", "sensor", "exposure_s", (0.001, 0.015), ASSUMED, " s"),),
    "snow": (
        *_pairs("exposure time", "sensor", "exposure_s", (0.001, 0.015), ASSUMED, " s"),
        *_pairs("albedo of a flake", "weather", "albedo", (0.85, 0.98), "PHYSICS.md 10.2"),
    ),
    "fog": (),
}
ALL_CAMERAS = (
    *_pairs("airlight", "option", "airlight", (0.3, 0.95), "range of the recipe training/camera"),
    *_pairs("lens blur", "sensor", "lens_blur_px", (1.8, 2.8), "PHYSICS.md 10.14", " px"),
)
RADAR_OF: Mapping[str, tuple[Change, ...]] = {
    "rain": (),
    "fog": (),
    "snow": (*_pairs("melted share", "weather", "melt_fraction", (0.05, 0.3), ASSUMED),),
}
RASMUSSEN = "Rasmussen et al. 1999: 3 to 10 times between snowfalls of one rate"
OF_ALL: Mapping[str, tuple[Change, ...]] = {
    "snow": (*_pairs("extinction at one rate", "weather", "visibility_spread", (0.3, 3.0), RASMUSSEN),),
}
Table = Mapping[str, tuple[Change, ...]]
# By the kind of the sensor: changes by weather.
OF_SENSOR: Mapping[str, tuple[Table, ...]] = {
    "lidar": (dict.fromkeys(("rain", "snow", "fog"), LIDAR), LIDAR_OF),
    "camera": (dict.fromkeys(("rain", "snow", "fog"), ALL_CAMERAS), CAMERA_OF),
    "radar": (RADAR_OF,),
}
FAMILIES = {"rain": RAIN, "snow": SNOW, "fog": FOG}


def changes(weather: Weather, sensor: Known) -> tuple[Change, ...]:
    """Plausible changes of defaults, one at a time.

    Args:
        weather: of one kind.
        sensor: a camera, LiDAR or radar.

    Example:
        >>> from torchweather.atmosphere.weather import Fog
        >>> [change.value for change in changes(Fog(100.0), Radar())][:2]
        ['advection', 'advection-liquid-water']
    """
    check_arguments("changes(weather: Weather)", weather)
    own = tuple(change for table in (*OF_SENSOR[sensor.kind], OF_ALL) for change in table.get(weather.kind, ()))
    given = getattr(weather, "size_distribution", None)
    others = tuple(each for each in FAMILIES[weather.kind] if each != given)
    return (
        *own,
        *_pairs("sizes", "weather", "size_distribution", others, "published distributions (PHYSICS.md 2, 10)"),
    )
