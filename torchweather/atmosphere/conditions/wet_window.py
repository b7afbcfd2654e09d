"""WetWindow: water on the windows of camera and LiDAR and on the cover of the radar."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor

from torchweather.atmosphere.conditions.condition import Amount, Condition, rain_of, register_condition, water_of
from torchweather.atmosphere.weather import Rain, Weather
from torchweather.core.fields import Range, between
from torchweather.physics.window_film import drop_cover, film_thickness_mm, impinging_rain_mm_per_h

__all__ = ["WetWindow", "drops_on_window", "film_on_window_mm"]

DRYING_MIN = 10.0  # in which a film dries to 1 / e, as in ``physics/wet_cover.py``


@register_condition
@dataclass(frozen=True)
class WetWindow(Condition):
    """Water on what sensors look through: drops on a camera's window, film and drops on those of LiDAR and radar.

    Args:
        wetness: of the water that the laws give, 0 (dry) to 2; below 1 for covers that repel water.
        speed_m_per_s: of the vehicle, 0 to 70 m/s; an upright window is hit by rain only while it moves.
        rain_mm_per_h: rain that wetted the window, 0 to 200 mm/h; ``None`` is the rain of the mixture.
        since_rain_min: minutes since that rain ended, 0 to 600; the window dries as ``exp(-t / 10 min)``.
        wiper_s: seconds since the wiper passed the camera's window, 0 to 3600; ``None``: it has none. LiDAR and radar
            have none in any case.

    Example:
        >>> from torchweather.atmosphere.weather import Mixture, Rain
        >>> weather = Mixture(Rain(25), WetWindow(speed_m_per_s=25, wiper_s=2))
        >>> round(float(drops_on_window(weather.conditions[0], weather, inclination_deg=30.0)), 2)
        0.15
    """

    kind: ClassVar[str] = "wet-window"
    intensity_name: ClassVar[str] = "wetness"
    rain_field: ClassVar[str] = "rain_mm_per_h"
    ranges: ClassVar[Mapping[str, Range]] = {
        "wetness": between(0.0, 2.0),
        "speed_m_per_s": between(0.0, 70.0, "m/s"),
        "rain_mm_per_h": between(0.0, 200.0, "mm/h"),
        "since_rain_min": between(0.0, 600.0, "min"),
        "wiper_s": between(0.0, 3600.0, "s"),
    }
    aliases: ClassVar[Mapping[str, str]] = {
        "speed": "speed_m_per_s",
        "rain": "rain_mm_per_h",
        "since_rain": "since_rain_min",
        "wiper": "wiper_s",
    }

    wetness: Amount = 1.0
    speed_m_per_s: Amount = 0.0
    rain_mm_per_h: Amount | None = None
    since_rain_min: Amount = 0.0
    wiper_s: Amount | None = None


def _impinging_mm_per_h(window: WetWindow, weather: Weather, inclination_deg: float) -> Tensor:
    """Rain that meets a window of an inclination, mm/h, scaled by the window's wetness and dryness."""
    given = window.rain_mm_per_h
    rate, water = water_of(rain_of(weather, window, "rain_mm_per_h") if given is None else Rain(given))
    met: Tensor = impinging_rain_mm_per_h(rate, water, window.speed_m_per_s, inclination_deg)  # type: ignore[arg-type]
    return float(window.wetness) * met  # type: ignore[arg-type]


def _dried(window: WetWindow) -> float:
    return math.exp(-float(window.since_rain_min) / DRYING_MIN)  # type: ignore[arg-type]


def film_on_window_mm(
    window: WetWindow, weather: Weather, *, length_m: float, inclination_deg: float, temperature_c: float = 10.0
) -> Tensor:
    """Mean thickness of the film on a cover, mm, one value or one for each sample, float64.

    Args:
        window: the condition.
        weather: that it is part of.
        length_m: height of the cover.
        inclination_deg: of the cover from the level.
        temperature_c: of the water.
    """
    met = _impinging_mm_per_h(window, weather, inclination_deg)
    return film_thickness_mm(met, length_m, inclination_deg, temperature_c) * _dried(window)


def drops_on_window(window: WetWindow, weather: Weather, *, inclination_deg: float, wiped: bool = True) -> Tensor:
    """Share of a window that drops cover, one value or one for each sample, float64.

    Args:
        window: the condition.
        weather: that it is part of.
        inclination_deg: of the window from the level.
        wiped: whether the wiper passes this window.
    """
    met = _impinging_mm_per_h(window, weather, inclination_deg)
    since_s = float(window.wiper_s) if wiped and window.wiper_s is not None else math.inf  # type: ignore[arg-type]
    water_mm = torch.where(met > 0, met * (since_s / 3600.0), 0.0)
    return drop_cover(water_mm) * _dried(window)
