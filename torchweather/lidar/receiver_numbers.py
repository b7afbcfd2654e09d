"""Numbers of a LiDAR's receiver that decide what is seen of a weather, for ``torchweather explain``."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import torch

from torchweather.atmosphere.weather import Fog, Rain, Snow, Weather
from torchweather.core.arguments import check_arguments
from torchweather.lidar.open_air import UNMEASURED, open_air_returns
from torchweather.lidar.sensor import CALIBRATION_REFLECTIVITY, Lidar
from torchweather.lidar.transform import LidarWeather
from torchweather.physics import backscatter_per_m_sr, extinction_per_m, rain_q_back

__all__ = ["receiver_numbers"]


def receiver_numbers(weather: Weather, lidar: Lidar, **options: Any) -> dict[str, Any]:
    """Assumed numbers of the receiver, and what they make of a weather.

    Args:
        weather: with single numbers.
        lidar: the sensor.
        options: of ``LidarWeather``, such as ``q_back``.

    Returns:
        ``range_at_10_percent_m``, ``near_start_m``, ``near_full_m``, ``near_power``, ``near_is_generic``,
        ``pulse_width_ns``, ``margin_db`` of the sensor; ``q_back``, by weather the backscatter efficiency
        ``4 pi beta / (N pi D^2 / 4)``; ``false_return_share`` of beams into open air; ``object_range_m``, half of the
        range at 10 %, and ``lost_share`` of objects of 10 % there.

    Example:
        >>> from torchweather.atmosphere.weather import Rain
        >>> numbers = receiver_numbers(Rain(10.0), Lidar.preset("ouster-os1-128"))
        >>> numbers["near_full_m"], numbers["near_is_generic"], numbers["q_back"]
        (10.0, True, {'rain': 0.2})
    """
    check_arguments("receiver_numbers(weather: Weather, lidar: Lidar)", weather, lidar)
    transform = LidarWeather(weather, replace(lidar, intensity_unit="reflectivity"), **options)
    open_air = open_air_returns(transform)
    range_m = lidar.range_at_10_percent_m
    assert isinstance(range_m, (int, float))
    with torch.no_grad():
        _, seen = transform.expected(torch.tensor([[0.5 * range_m, 0.0, 0.0, CALIBRATION_REFLECTIVITY]]))
    names = ("range_at_10_percent_m", "near_start_m", "near_full_m", "near_power", "pulse_width_ns", "margin_db")
    return {
        **{name: getattr(lidar, name) for name in names},
        "near_is_generic": (lidar.near_start_m, lidar.near_full_m, lidar.near_power) == UNMEASURED,
        "q_back": {part.kind: backscatter_efficiency(part, lidar, options.get("q_back")) for part in weather.parts},
        "false_return_share": open_air.share,
        "object_range_m": 0.5 * range_m,
        "lost_share": float(1.0 - seen[0]),
    }


def backscatter_efficiency(part: Weather, lidar: Lidar, given: Any = None) -> float:
    """Backscatter efficiency of a weather's particles, by default or as given for rain.

    Args:
        part: rain, fog or snow.
        lidar: whose wavelength counts.
        given: of rain; ``None`` is ``rain_q_back``.
    """
    if isinstance(part, Rain):
        return float(given) if isinstance(given, (int, float)) else float(rain_q_back(lidar.wavelength_nm))
    if isinstance(part, Snow):
        return 4.0 * part.reflectivity_at(lidar.wavelength_nm)
    assert isinstance(part, Fog)
    drops = part.distribution()
    if not float(drops.total_per_m3) > 0.0:
        return 0.0
    area = extinction_per_m(drops, lidar.wavelength_nm, q_ext=1.0)
    return 4.0 * math.pi * float(backscatter_per_m_sr(drops, lidar.wavelength_nm)) / float(area)
