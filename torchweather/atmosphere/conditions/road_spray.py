"""RoadSpray: the spray of a vehicle ahead."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

from torchweather.atmosphere.conditions.condition import Amount, Condition, condition_of, register_condition
from torchweather.atmosphere.conditions.wet_road import WetRoad, water_on_road_mm
from torchweather.atmosphere.weather import Weather
from torchweather.core.errors import InputValueError
from torchweather.core.fields import Range, between
from torchweather.physics.road_spray import (
    SPEED_M_PER_S,
    TYRE_M,
    WATER_MM,
    spray_drop_mm,
    spray_length_m,
    spray_water_kg_per_m,
)

__all__ = ["RoadSpray", "spray_values"]


@register_condition
@dataclass(frozen=True)
class RoadSpray(Condition):
    """Spray that the tyres of a vehicle ahead throw up from a wet road.

    Args:
        speed_m_per_s: of that vehicle, 0 (none) to 60 m/s.
        distance_m: of its rear tyres, 2 to 150 m ahead.
        lateral_m: of its middle, to the left, -20 to 20 m.
        water_mm: on the road, 0 to 10 mm; ``None`` is that of the mixture's ``WetRoad``, or what its rain makes.
        tyre_m: width of the tyres of one side, 0.05 to 2 m; a car has 0.2, a lorry with twins 0.6 and more.
        height_m: over which the cloud thins out by e upwards, 0.1 to 5 m: a car 0.8, a lorry 1.5.
        uneven: spread of the logarithm of the density over its billows, 0 to 2.

    Example:
        >>> from torchweather.atmosphere.weather import Mixture, Rain
        >>> weather = Mixture(Rain(20), RoadSpray(speed_m_per_s=25, distance_m=20))
        >>> round(spray_values(weather.conditions[0], weather)["water_g_per_m"], 1)
        3.9
    """

    kind: ClassVar[str] = "road-spray"
    intensity_name: ClassVar[str] = "speed_m_per_s"
    rain_field: ClassVar[str] = "water_mm"
    ranges: ClassVar[Mapping[str, Range]] = {
        "speed_m_per_s": between(*SPEED_M_PER_S, "m/s"),
        "distance_m": between(2.0, 150.0, "m"),
        "lateral_m": between(-20.0, 20.0, "m"),
        "water_mm": between(*WATER_MM, "mm"),
        "tyre_m": between(*TYRE_M, "m"),
        "height_m": between(0.1, 5.0, "m"),
        "uneven": between(0.0, 2.0),
    }
    aliases: ClassVar[Mapping[str, str]] = {
        "speed": "speed_m_per_s",
        "distance": "distance_m",
        "lateral": "lateral_m",
        "water": "water_mm",
    }

    speed_m_per_s: Amount = 0.0
    distance_m: Amount = 15.0
    lateral_m: Amount = 0.0
    water_mm: Amount | None = None
    tyre_m: Amount = 0.2
    height_m: Amount = 0.8
    uneven: Amount = 0.5


def spray_values(spray: RoadSpray, weather: Weather) -> dict[str, float]:
    """Parameters of the effects of a spray, the same for all sensors.

    Args:
        spray: the condition.
        weather: that it is part of.

    Raises:
        InputValueError: the water follows from rains that differ between samples.
    """
    speed, height = float(spray.speed_m_per_s), float(spray.height_m)  # type: ignore[arg-type]
    if spray.water_mm is not None:
        water_mm = float(spray.water_mm)  # type: ignore[arg-type]
    else:
        road = condition_of(weather, WetRoad)
        depths = water_on_road_mm(WetRoad() if road is None else road, weather)
        if depths.numel() > 1 and bool((depths != depths[0]).any()):
            raise InputValueError(
                "RoadSpray: one cloud stands in all samples of a batch, and their rain differs. Give "
                "RoadSpray(water_mm=...), or one rate."
            )
        water_mm = float(depths[0])
    drop = spray_drop_mm(speed)
    return {
        "water_g_per_m": 1e3 * spray_water_kg_per_m(speed, water_mm, float(spray.tyre_m)),  # type: ignore[arg-type]
        "drop_mm": drop,
        "distance_m": float(spray.distance_m),  # type: ignore[arg-type]
        "lateral_m": float(spray.lateral_m),  # type: ignore[arg-type]
        "length_m": spray_length_m(speed, drop, height),
        "height_m": height,
        "uneven": float(spray.uneven),  # type: ignore[arg-type]
    }
