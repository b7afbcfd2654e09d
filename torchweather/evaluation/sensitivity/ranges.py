"""Results of a weather on a sensor, and how far each plausible default moves them."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import torch

from torchweather.atmosphere.weather import Weather, parse_weather
from torchweather.camera.sensor import Camera
from torchweather.camera.transform import BayerWeather
from torchweather.core.arguments import check_arguments
from torchweather.core.errors import InputValueError
from torchweather.evaluation.sensitivity.change import Change, changes
from torchweather.explain import explain
from torchweather.lidar.open_air import open_air_share
from torchweather.lidar.receiver_numbers import backscatter_efficiency
from torchweather.lidar.sensor import CALIBRATION_REFLECTIVITY, Lidar
from torchweather.lidar.transform import LidarWeather
from torchweather.physics import Q_EFF, rain_q_back
from torchweather.radar.sensor import Radar
from torchweather.sensors import sensor_preset

__all__ = ["Moved", "printed_uncertainty", "results", "sensitivity", "uncertainty"]

# A grey wall in an even light: what particles and airlight add is seen alone.
WALL_PX, WALL_M, WALL_LIGHT, WALL_AIRLIGHT, SEEDS = (128, 96), 50.0, 0.1, 0.6, 2
OBJECT_M = 20.0
LEAST_SHARE = 1e-3  # shares below count as none
SHARES = ("false returns of beams into open air", f"lost returns of objects of 10 % at {OBJECT_M:g} m")

Sensor = Camera | Lidar | Radar


@dataclass(frozen=True)
class Moved:
    """One result of one change.

    Args:
        change: of a default.
        result: name of the result.
        before, after: its value by default and with the change.
    """

    change: Change
    result: str
    before: float
    after: float

    @property
    def factor(self) -> float:
        """After over before; 1 for two shares below 0.001, infinite where there was nothing before."""
        if self.result in SHARES and max(self.before, self.after) < LEAST_SHARE:
            return 1.0
        if self.before == 0.0:
            return 1.0 if self.after == 0.0 else math.inf
        return self.after / self.before


def results(weather: Weather, sensor: Sensor, options: Mapping[str, Any] | None = None) -> dict[str, float]:
    """Results of a weather on a sensor, by name.

    Args:
        weather: of one kind, with a single number.
        sensor: a camera (rendered extinction; brightness and its deviation on a grey wall at 50 m), a LiDAR (effective
            extinction, shares of false and of lost returns) or a radar (attenuation, backscatter).
        options: of the sensor's transform.

    Example:
        >>> from torchweather.atmosphere.weather import Rain
        >>> {name: round(value, 2) for name, value in results(Rain(25.0), Radar()).items()}
        {'attenuation dB/km': 11.41, 'backscatter 1/(m sr)': 0.0}
    """
    check_arguments("results(weather: Weather)", weather)
    return RESULTS[sensor.kind](weather, sensor, dict(options or {}))


def _of_lidar(weather: Weather, lidar: Lidar, options: dict[str, Any]) -> dict[str, float]:
    transform = LidarWeather(weather, replace(lidar, intensity_unit="reflectivity"), **options)
    with torch.no_grad():
        _, seen = transform.expected(torch.tensor([[OBJECT_M, 0.0, 0.0, CALIBRATION_REFLECTIVITY]]))
    shares = (open_air_share(transform), float(1.0 - seen[0]))
    return {
        "effective extinction 1/m": float(transform.extinction_per_m.sum()),
        **dict(zip(SHARES, shares, strict=True)),
    }


def _of_radar(weather: Weather, radar: Radar, options: dict[str, Any]) -> dict[str, float]:
    assert not options  # no change of a radar's transform is listed
    band = explain(weather, radar)["bands"][0]
    return {"attenuation dB/km": band["attenuation_db_per_km"], "backscatter 1/(m sr)": band["backscatter_per_m_sr"]}


def _of_camera(weather: Weather, camera: Camera, options: dict[str, Any]) -> dict[str, float]:
    small = replace(camera.resized(*WALL_PX), response_knots=None)
    transform = BayerWeather(weather, small, depth=WALL_M, **{"airlight": WALL_AIRLIGHT, **options})
    wall = torch.full((1, WALL_PX[1], WALL_PX[0]), WALL_LIGHT)
    with torch.no_grad():
        frames = torch.stack([transform(wall, seed=seed) for seed in range(SEEDS)])
    return {
        "rendered extinction 1/m": explain(weather, camera)["bands"][0]["extinction_rendered_per_m"],
        "brightness added to a wall at 50 m": float(frames.mean() - WALL_LIGHT),
        "deviation of its pixels": float(frames.std()),
    }


RESULTS: Mapping[str, Callable[[Weather, Any, dict[str, Any]], dict[str, float]]] = {
    "lidar": _of_lidar,
    "radar": _of_radar,
    "camera": _of_camera,
}


def sensitivity(weather: Weather | str, sensor: Sensor | str) -> tuple[Moved, ...]:
    """Every result with every default at its other plausible values, one at a time.

    Args:
        weather: of one kind, or its text such as ``rain:rate=25``.
        sensor: or its text such as ``lidar:ouster-os1-128``.
    """
    weather, sensor = _given(weather, sensor)
    before = results(weather, sensor)
    found = []
    for change in changes(weather, sensor):
        after = results(change.of_weather(weather), change.of_sensor(sensor), change.option)
        found += [Moved(change, name, before[name], after[name]) for name in before]
    return tuple(found)


def uncertainty(weather: Weather | str, sensor: Sensor | str) -> dict[str, tuple[float, float, float]]:
    """Each result by default, and its least and largest value as the defaults are varied one at a time.

    Args:
        weather, sensor: as in ``sensitivity``.

    Returns:
        Name to ``(default, least, largest)``. Defaults that vary together may go further.

    Example:
        >>> found = uncertainty("rain:rate=25", "radar")
        >>> value, least, largest = found["attenuation dB/km"]
        >>> least <= value <= largest
        True
    """
    ranges: dict[str, tuple[float, float, float]] = {}
    for moved in sensitivity(weather, sensor):
        _, least, largest = ranges.get(moved.result, (moved.before, moved.before, moved.before))
        ranges[moved.result] = (moved.before, min(least, moved.after), max(largest, moved.after))
    return ranges


def printed_uncertainty(
    weather: Weather | str, sensor: Sensor | str, numbers: Mapping[str, Any]
) -> dict[str, tuple[float, float, float]]:
    """Each number that ``explain`` prints, and its least and largest value as defaults are varied one at a time.

    Args:
        weather, sensor: as in ``sensitivity``.
        numbers: of ``explain`` for them.

    Returns:
        Name to ``(default, least, largest)``, all three alike where no default without a measurement moves the number;
        then the results of ``uncertainty``.
    """
    weather, sensor = _given(weather, sensor)
    before = printed(numbers)
    ranges = {name: (value, value, value) for name, value in before.items()}
    bands = numbers["bands"]
    only = {"wavelength_nm": bands[0]["wavelength_nm"]} if len(bands) == 1 and "wavelength_nm" in bands[0] else {}
    only |= {name: bands[0][name] for name in ("frequency_ghz", "polarisation") if name in bands[0]}
    for change in changes(weather, sensor):
        after = printed(explain(change.of_weather(weather), change.of_sensor(sensor), **only))
        # Options of the transform are no arguments of explain; efficiencies scale what is printed.
        for option, names in (("q_eff", EFFECTIVE), ("q_back", BACKSCATTER)):
            if option in change.option:
                scale = change.option[option] / DEFAULT_OF[option](weather, bands[0])
                after |= {name: scale * value for name, value in after.items() if name.startswith(names)}
        after |= {RECEIVER[name]: float(value) for name, value in change.sensor.items() if name in RECEIVER}
        if "receiver" in numbers:
            lidar = Lidar.of(sensor)
            efficiency = backscatter_efficiency(change.of_weather(weather), lidar, change.option.get("q_back"))
            after[f"backscatter efficiency, {weather.kind}"] = efficiency
        for name, value in after.items():
            if name in ranges:
                given, least, largest = ranges[name]
                ranges[name] = (given, min(least, value), max(largest, value))
    further = uncertainty(weather, sensor)  # what is simulated, and printed of no band
    return ranges | {name: value for name, value in further.items() if name not in OF_BAND.values()}


EFFECTIVE, BACKSCATTER = "effective extinction 1/m", "backscatter 1/(m sr)"
DEFAULT_OF: Mapping[str, Callable[[Weather, Mapping[str, Any]], float]] = {
    "q_eff": lambda weather, band: Q_EFF[weather.kind],
    "q_back": lambda weather, band: float(rain_q_back(band["wavelength_nm"])),
}
# Printed of a LiDAR's receiver: field of the sensor to its name.
RECEIVER = {
    "range_at_10_percent_m": "range at 10 % m",
    "near_start_m": "near response from m",
    "near_full_m": "near response full at m",
    "near_power": "near response power",
    "pulse_width_ns": "pulse width ns",
    "margin_db": "margin of returns dB",
}
OF_BAND = {
    "extinction_per_m": "extinction 1/m",
    "backscatter_per_m_sr": BACKSCATTER,
    "extinction_effective_per_m": EFFECTIVE,
    "extinction_rendered_per_m": "rendered extinction 1/m",
    "attenuation_db_per_km": "attenuation dB/km",
}
OF_WEATHER = {
    "mor_m": "visibility (Mie) m",
    "mor_nominal_m": "visibility, the fog's own parameter m",
    "particles_per_m3": "particles per m^3",
    "liquid_water_g_per_m3": "liquid water g/m^3",
}
OF_PART = {
    "median_volume_diameter_mm": "median volume diameter mm",
    "rate_carried_mm_per_h": "rate carried mm/h",
}


def printed(numbers: Mapping[str, Any]) -> dict[str, float]:
    """The printed numbers of ``explain`` by name, those of bands with the band."""
    found = {
        f"{name}, {band['name']}": band[key]
        for band in numbers["bands"]
        for key, name in OF_BAND.items()
        if key in band
    }
    found |= {name: numbers[key] for key, name in OF_WEATHER.items() if key in numbers}
    found |= {
        name: part[key] for part in numbers["parts"] for key, name in OF_PART.items() if part.get(key) is not None
    }
    receiver = numbers.get("receiver", {})
    found |= {f"backscatter efficiency, {kind}": value for kind, value in receiver.get("q_back", {}).items()}
    return found | {name: receiver[key] for key, name in RECEIVER.items() if key in receiver}


def _given(weather: Weather | str, sensor: Sensor | str) -> tuple[Weather, Sensor]:
    if isinstance(weather, str):
        weather = parse_weather(weather)
    if len(weather.parts) != 1:
        raise InputValueError(f"sensitivity: expected rain, fog or snow alone; got {weather!r}. Give one at a time.")
    return weather.parts[0], sensor_preset(sensor)[1] if isinstance(sensor, str) else sensor
